// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <string_view>
#include <vector>

#include "sweepkit/core/options.hpp"
#include "sweepkit/floor/ground_plane.hpp"
#include "sweepkit/geometry/rectified_camera.hpp"
#include "sweepkit/geometry/se3.hpp"
#include "sweepkit/image/disparity.hpp"
#include "sweepkit/image/image.hpp"

namespace sweepkit {

/// What is in the robot's way.
enum class ObstacleKind : std::uint8_t {
  obstacle,  ///< rises above the floor
  hole,      ///< lies below it: a hole or a step down
};

constexpr std::string_view to_string(ObstacleKind kind) {
  return kind == ObstacleKind::obstacle ? "obstacle" : "hole";
}

/// A box that stands on a floor, turned about the vertical only.
struct FloorBox {
  Vec2<double> centre = Vec2<double>::Zero();  ///< x, y of the floor's frame [m]
  double yaw = 0.0;     ///< of its long side, counter-clockwise seen from above, in (-pi/2, pi/2] [rad]
  double length = 0.0;  ///< of its long side [m]
  double width = 0.0;   ///< across [m]
  double bottom = 0.0;  ///< height of its lowest part above the floor [m]; negative in holes
  double top = 0.0;     ///< height of its highest part [m]
};

/// The frame of a floor seen from a camera: x forward and y left along the floor, z up; its origin is the
/// point of the floor below the camera. T_floor_camera takes points of the camera into it. A camera that
/// looks straight down has its upper edge forward.
SE3d floor_frame(const GroundPlane& plane);

/// A box in another frame with z up. @param T_to_floor takes points of the box's frame to the new one; what
/// is not level in it is left out
FloorBox moved(const FloorBox& box, const SE3d& T_to_floor);

/// The smallest rectangle of pixels that holds an obstacle, borders included.
struct PixelBox {
  int u_min = 0, v_min = 0, u_max = 0, v_max = 0;
};

/// One thing in the way, as one image shows it: its visible side only.
struct Obstacle {
  ObstacleKind kind = ObstacleKind::obstacle;
  /// Mean of its pixels' points in the rectified left camera's frame [m]; of a hole, mean of the points where
  /// its pixels' rays meet the floor's plane: the opening.
  Vec3<double> p_camera = Vec3<double>::Zero();
  /// Of p_camera [m^2]. Disparities of one thing err together: it does not shrink with the number of pixels.
  Mat3<double> covariance = Mat3<double>::Zero();
  FloorBox box;           ///< in floor_frame() of the image's ground plane
  double distance = 0.0;  ///< along the floor from the camera to its nearest part [m]
  int pixels = 0;
  /// Whether the images show it beyond doubt: it would stand out, too, if the floor lay off its plane by what
  /// is to be expected. Far and low things become clear when the robot comes nearer.
  bool clear = true;
  PixelBox image;
};

/// What counts as an obstacle or a hole.
struct ObstacleOptions {
  double min_height = 0.014;
  double max_height = 0.3;
  double clearance = 0.12;
  double max_range = 3.0;
  double link_gap = 0.03;
  double link_disparity = 1.0;
  int link_pixels = 2;
  int min_pixels = 16;
  double min_area = 0.3;
  double min_top = 0.0165;
  double carpet_top = 0.022;
  double carpet_size = 0.12;
  double max_length = 0.8;
  double hole_depth = 0.03;
  int hole_pixels = 200;
  double hole_area = 15.0;
  double disparity_sigma = 0.5;
  double likeness = 0.6;
  double image_noise = 1.5;
  double clear_margin = 1.0;
  double clear_angle = 15.0;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(min_height, "min_height", "m", range(0.001, 1.0), "what rises less is no obstacle: carpets, low sills");
    v(max_height, "max_height", "m", range(0.01, 10.0), "what is higher above the floor is not looked at");
    v(clearance, "clearance", "m", range(0.01, 10.0), "what begins higher lets the robot pass below");
    v(max_range, "max_range", "m", range(0.1, 100.0), "depth up to which obstacles are looked for");
    v(link_gap, "link_gap", "m", range(0.001, 1.0),
      "neighbouring pixels whose depths differ by less are of one thing");
    v(link_disparity, "link_disparity", "px", range(0.0, 16.0),
      "or whose disparities do: far away noise exceeds that depth");
    v(link_pixels, "link_pixels", "px", range(1, 8), "how far apart neighbours may be");
    v(min_pixels, "min_pixels", "px", range(1, 100000), "fewer pixels are no obstacle");
    v(min_area, "min_area", "cm^2", range(0.0, 1000.0), "nor is what shows the camera less");
    v(min_top, "min_top", "m", range(0.001, 1.0), "nor is what has less than a tenth of it above this");
    v(carpet_top, "carpet_top", "m", range(0.0, 1.0),
      "what is lower than this and wider than carpet_size both ways is a carpet or a sill, no obstacle");
    v(carpet_size, "carpet_size", "m", range(0.0, 10.0), "see carpet_top");
    v(max_length, "max_length", "m", range(0.05, 100.0), "longer ones are cut: walls into pieces");
    v(hole_depth, "hole_depth", "m", range(0.001, 10.0),
      "what lies less below is no hole: bare floor seen from a carpet");
    v(hole_pixels, "hole_pixels", "px", range(1, 100000), "fewer pixels are no hole");
    v(hole_area, "hole_area", "cm^2", range(0.0, 10000.0), "nor is a smaller opening in the floor");
    v(disparity_sigma, "disparity_sigma", "px", range(0.01, 10.0),
      "standard deviation of the error that a thing's disparities share, for covariances");
    v(likeness, "likeness", "", range(0.0, 10.0),
      "the images must differ at a thing's disparities by this part at most of how they differ if its pixels "
      "lie on the floor");
    v(image_noise, "image_noise", "grey levels", range(0.1, 100.0), "noise of the images, for likeness");
    v(clear_margin, "clear_margin", "px", range(0.0, 16.0),
      "by which the floor's disparities may be off; what the images do not tell from that is not clear");
    v(clear_angle, "clear_angle", "deg", range(0.0, 80.0),
      "nor is a thing whose edges in the image run more level than this, in the mean of squares");
  }
};

/// What is known against a ground plane.
struct FloorDoubt {
  double sigma_tilt = 0.0;    ///< standard deviation of its pitch and roll [rad]
  bool contradicted = false;  ///< the image shows another surface instead: it may be the floor
};

/// Gathers the pixels that stand out of the floor to things. Pixels of the mask that are high enough are
/// joined with neighbours of about the same depth (union-find over the image); what lies below such a pixel
/// in its column at the same depth belongs to it: its foot. Dense matching smears edges and errs in blocks;
/// hence each thing is tested on the images themselves: if its pixels fit as well on the floor, or a carpet's
/// height above it, it is none. Only measured disparities count: where there are
/// none nothing is concluded, so that dark or plain carpets are neither obstacles nor holes. Same input, same
/// result. Keeps its memory; not thread-safe.
class ObstacleFinder {
 public:
  /// @throws Error(option) for options out of range
  explicit ObstacleFinder(const ObstacleOptions& options = {});

  const ObstacleOptions& options() const { return options_; }

  /// The obstacles and holes of an image, from near to far; valid until the next call.
  /// @param disparity of the rectified left image
  /// @param mask a FloorLabel a pixel, as obstacle_mask gives it; of the same size, else Error(argument)
  /// @param left, right the rectified images, to test each thing against the floor (see
  ///   ObstacleOptions::likeness); without them no such test is made
  /// @param doubt what is known against the plane, for Obstacle::clear
  template <DisparityPixel D>
  const std::vector<Obstacle>& find(View2d<const D> disparity, GrayView mask, const RectifiedCamera& camera,
                                    const GroundPlane& plane, GrayView left = {}, GrayView right = {},
                                    const FloorDoubt& doubt = {});

  /// A pixel of the last image: 0, or one more than the index of the obstacle it belongs to.
  View2d<const std::uint16_t> regions() const { return regions_.view(); }

 private:
  struct Pixel {
    std::int16_t u, v;
    float disparity, height;
  };

  template <DisparityPixel D>
  void link(View2d<const D> disparity, GrayView mask, ObstacleKind kind);
  template <DisparityPixel D>
  void add_feet(View2d<const D> disparity, GrayView mask);
  void take_things(ObstacleKind kind);
  void take(std::vector<Pixel>& pixels, ObstacleKind kind);
  enum class Evidence { none, faint, clear };
  Evidence evidence(const std::vector<Pixel>& pixels, ObstacleKind kind) const;
  std::int32_t root(std::int32_t i);

  ObstacleOptions options_;
  RectifiedCamera camera_;
  GroundPlane plane_;
  FloorDisparity floor_;
  GrayView left_, right_;
  FloorDoubt doubt_;
  double margin_ = 0.0;  // by which the floor's disparities may be off [px]
  SE3d T_floor_camera_;
  std::vector<Obstacle> obstacles_;
  Image<std::uint16_t> regions_;
  Image<std::int32_t> nodes_;  // index of the node of a pixel, -1: none
  std::vector<std::int32_t> parents_;
  std::vector<Pixel> pixels_;
  std::vector<std::int32_t> starts_, nexts_, order_;
  std::vector<Vec2<float>> places_;
  std::vector<float> sorted_;
};

}  // namespace sweepkit
