// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

#include "ray_caster.hpp"
#include "scene_surface.hpp"
#include "sweepkit/data/scene.hpp"

namespace sweepkit {

/// Irradiance, so scaled that white paper in the light 1 has the radiance 1.
struct Irradiance {
  float lamps = 0, day = 0;
};

/// Light on all surfaces, a grid of texels for each patch, as the patches' `light` and sizes say.
class LightTable {
 public:
  /// Works the light out: lamps, sun and windows with shadows, and what comes by way of other surfaces; sets
  /// the patches' light, light_width and light_height.
  /// @param rays directions for light by way of other surfaces
  LightTable(const Scene& scene, SurfaceMesh& mesh, const RayCaster& caster, int rays, int threads);

  /// Between the texels around (s, t).
  Irradiance at(const Patch& patch, float s, float t) const {
    const float x = std::clamp(s / patch.extent_s * static_cast<float>(patch.light_width) - 0.5f, 0.0f,
                               static_cast<float>(patch.light_width - 1));
    const float y = std::clamp(t / patch.extent_t * static_cast<float>(patch.light_height) - 0.5f, 0.0f,
                               static_cast<float>(patch.light_height - 1));
    const int x0 = static_cast<int>(x), y0 = static_cast<int>(y);
    const float ax = x - static_cast<float>(x0), ay = y - static_cast<float>(y0);
    const Irradiance* top =
        texels_.data() + patch.light + static_cast<std::size_t>(y0 * patch.light_width + x0);
    const Irradiance* bottom = y0 + 1 < patch.light_height ? top + patch.light_width : top;
    const int right = x0 + 1 < patch.light_width ? 1 : 0;
    const auto mix = [&](float Irradiance::*part) {
      const float a = top->*part + ax * ((top + right)->*part - top->*part);
      const float b = bottom->*part + ax * ((bottom + right)->*part - bottom->*part);
      return a + ay * (b - a);
    };
    return {mix(&Irradiance::lamps), mix(&Irradiance::day)};
  }

  /// The mean over all floors: light for what has no table.
  Irradiance mean() const { return mean_; }
  std::size_t size() const { return texels_.size(); }

 private:
  std::vector<Irradiance> texels_;
  Irradiance mean_;
};

}  // namespace sweepkit
