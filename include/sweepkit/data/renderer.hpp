// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "sweepkit/core/options.hpp"
#include "sweepkit/data/scene.hpp"
#include "sweepkit/geometry/camera.hpp"
#include "sweepkit/geometry/se3.hpp"
#include "sweepkit/image/image.hpp"

namespace sweepkit {

/// How scenes are drawn.
struct RendererOptions {
  int samples = 4;
  double light_texel = 0.015;
  int light_rays = 48;
  int threads = 0;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(samples, "samples", "", range(1, 64), "rays a pixel; 4 or more keep edges smooth");
    v(light_texel, "light_texel", "m", range(0.002, 0.2),
      "distance between points of floors where light is computed; other surfaces take twice as much");
    v(light_rays, "light_rays", "", range(4, 1024),
      "directions in which each of these points looks for light");
    v(threads, "threads", "", range(0, 256), "0: as many as the machine has; images do not depend on it");
  }
};

/// A rod with round ends.
struct Capsule {
  Vec3<double> a = Vec3<double>::Zero(),
               b = Vec3<double>::Zero();  ///< ends of its axis, in its thing's frame
  double radius = 0.05;
  double albedo = 0.3;
};

/// Something that moves, at one instant; its pixels are labelled SceneLabel::moving.
struct MovingThing {
  std::vector<Capsule> parts;
  SE3d T_world_thing;
};

/// A person in mid stride, x forward, standing on z = 0: shoes, legs, body, arms.
/// @param phase of the stride, one for two steps (0.75 m each)
MovingThing walking_person(const SE3d& T_world_person, double phase);

/// What is to be drawn.
struct ViewRequest {
  SE3d T_world_camera;        ///< at the middle of the exposure
  SE3d T_world_camera_open;   ///< when the shutter opens; used if `blur`
  SE3d T_world_camera_close;  ///< when it closes
  bool blur = false;
  double lamps = 1.0;     ///< factor on all lamps; 0: switched off
  double daylight = 1.0;  ///< factor on windows and sun
  std::vector<MovingThing> moving;
  bool radiance = true;  ///< whether RenderedView::radiance is wanted
  bool depth = false;    ///< whether depth and label are wanted
};

/// What a camera sees, unrectified.
struct RenderedView {
  Image<float> radiance;      ///< linear; white paper in a lit room is about 1
  Image<float> depth;         ///< z of the camera's frame at the centre of each pixel [m]; 0: none
  Image<std::uint8_t> label;  ///< SceneLabel at the centre of each pixel
};

/// A camera of any model with one ray for each sample, worked out once.
class RayTable {
 public:
  /// @throws Error(calibration) if the model sees nothing in half of the image's pixels or more
  RayTable(const Camera& camera, int samples);
  ~RayTable();
  RayTable(RayTable&&) noexcept;
  RayTable& operator=(RayTable&&) noexcept;

  int width() const;
  int height() const;

 private:
  friend class Renderer;
  struct Rays;
  std::unique_ptr<const Rays> rays_;
};

/// Draws a scene by casting rays. Light (lamps and windows with soft shadows, one bounce) is worked out once
/// for all surfaces, at construction, which takes about a second for each room; so are textures. Each
/// texture is filtered to the size of a sample's footprint, so that it looks the same from near and far.
/// Immutable; any number of threads may draw with one. Images are the same for every number of threads.
class Renderer {
 public:
  /// @throws Error(data) if the scene does not pass check()
  explicit Renderer(const Scene& scene, const RendererOptions& options = {});
  ~Renderer();
  Renderer(Renderer&&) noexcept;
  Renderer& operator=(Renderer&&) noexcept;

  const RendererOptions& options() const;

  /// @param rays of the camera; made with options().samples
  void render(const RayTable& rays, const ViewRequest& request, RenderedView& view) const;
  /// One view, with the table made for it.
  void render(const Camera& camera, const SE3d& T_world_camera, RenderedView& view) const;

 private:
  struct World;
  std::unique_ptr<const World> world_;
};

}  // namespace sweepkit
