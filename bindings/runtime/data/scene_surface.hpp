// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "scene_solid.hpp"
#include "scene_texture.hpp"
#include "sweepkit/data/scene.hpp"

namespace sweepkit {

/// A piece of surface with coordinates (s, t) on it [m] that carries one texture and one table of light: a
/// plane or the side of a round body.
struct Patch {
  enum class Shape : std::uint8_t { plane, frustum, ellipsoid };
  Shape shape = Shape::plane;
  SceneLabel label = SceneLabel::background;
  Detail detail = Detail::none;
  bool shadow = true;     ///< whether it keeps light away from others
  float emission = 0;     ///< radiance of its own
  bool daylight = false;  ///< whether that goes with daylight rather than with the lamps
  float detail_strength = 0;
  const Texture* texture = nullptr;
  float u_s = 0, u_t = 0, u_0 = 0, v_s = 0, v_t = 0, v_0 = 0;  ///< texture coordinates [periods] from s, t
  float extent_s = 0, extent_t = 0;                            ///< (s, t) lies in [0, extent]

  // Where (s, t) lies. Plane: origin + s axis_s + t axis_t. Round: about the origin, axes as columns of R.
  Vec3<double> origin, axis_s, axis_t, normal;
  Mat3<double> R;
  Vec3<double> half;

  // Table of light: texels from `light` on.
  std::uint32_t light = 0;
  int light_width = 0, light_height = 0;
  float texel = 0.03f;  ///< wanted distance of texels [m]

  /// A point of the surface and the normal there.
  void at(double s, double t, Vec3<double>& point, Vec3<double>& direction) const;
};

/// A corner of the triangle mesh.
struct MeshVertex {
  float x, y, z;
};

/// All surfaces of a scene as triangles. s and t are affine functions of the position within each.
struct SurfaceMesh {
  struct Triangle {
    std::uint32_t vertex[3];
    std::uint32_t patch;
    float grad_s[3], s0, grad_t[3], t0;  ///< s = grad_s . p + s0
    float normal[3];
  };
  std::vector<MeshVertex> vertices;
  std::vector<Triangle> triangles;
  std::vector<Patch> patches;
  std::vector<std::shared_ptr<const Texture>> textures;  ///< kept alive
  std::vector<std::uint32_t> windows;                    ///< patches that let daylight in
};

/// @param floor_texel distance of points of light on floors [m]; other surfaces take twice as much
SurfaceMesh build_surfaces(const Scene& scene, double floor_texel);

}  // namespace sweepkit
