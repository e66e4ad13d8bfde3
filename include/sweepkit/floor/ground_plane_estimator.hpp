// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <memory>
#include <optional>
#include <string_view>

#include "sweepkit/core/options.hpp"
#include "sweepkit/core/view.hpp"
#include "sweepkit/floor/ground_plane.hpp"
#include "sweepkit/geometry/se3.hpp"

namespace sweepkit {

/// What calibration says of the floor: where the camera stands above it when all wheels are on one surface.
struct GroundPlaneSeed {
  GroundPlane plane;
  /// Where the drive wheels touch the floor, in the middle between them, in the camera's frame [m]. When the
  /// robot tilts at a sill it turns about that point. It lies on the plane.
  Vec3<double> wheels_camera = Vec3<double>::Zero();

  /// From where the rectified left camera is mounted on the robot's base (x forward, y left, z up, on the
  /// floor in the middle between the drive wheels).
  /// @throws Error(argument) unless the camera is above the floor
  static GroundPlaneSeed from_base(const SE3d& T_base_camera);
  /// From the direction down in the camera's frame (any length) and the camera's height [m]; the wheels are
  /// taken to be below the camera.
  /// @throws Error(argument) unless the height is positive and the direction is one
  static GroundPlaneSeed from_height(const Vec3<double>& down_camera, double height);
};

/// How the ground plane is estimated.
struct GroundPlaneOptions {
  double mounting_angle = 0.5;
  double mounting_height = 0.001;
  double ride_angle = 0.07;
  double ride_height = 0.0005;
  double view_angle = 0.1;
  double view_height = 0.0007;
  double view_time = 2.0;
  double settle_time = 1.0;
  double max_tilt = 12.0;
  double max_climb = 0.03;
  double floor_slope = 0.5;
  double disparity_noise = 0.4;
  double disparity_bias = 0.15;
  double min_disparity = 40.0;
  int step_u = 8;
  int step_v = 4;
  int min_pixels = 60;
  double min_share = 0.3;
  double max_angle_error = 0.3;
  double max_height_error = 0.003;
  double consistency = 16.3;
  int hypotheses = 64;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(mounting_angle, "mounting_angle", "deg", range(0.001, 10),
      "standard deviation of the seed's pitch and roll");
    v(mounting_height, "mounting_height", "m", range(1e-5, 0.1), "standard deviation of the seed's height");
    v(ride_angle, "ride_angle", "deg", range(0.001, 10),
      "how far the robot rocks about its mean pitch and roll on one surface");
    v(ride_height, "ride_height", "m", range(1e-5, 0.05), "the same of the height");
    v(view_angle, "view_angle", "deg", range(0.0, 10),
      "how far the floor in view differs in pitch and roll from that under the wheels");
    v(view_height, "view_height", "m", range(0.0, 0.05), "the same of the height");
    v(view_time, "view_time", "s", range(0.01, 100), "how long such a difference stays in view");
    v(settle_time, "settle_time", "s", range(0.01, 100),
      "a tilt at a sill or the edge of a carpet is expected to fade within about that time");
    v(max_tilt, "max_tilt", "deg", range(0.1, 45),
      "tilted by more against its mounting the robot is not taken to stand on a floor");
    v(max_climb, "max_climb", "m", range(0.001, 1),
      "risen or sunk by more since the floor was seen, without tilting, the robot is taken to be lifted");
    v(floor_slope, "floor_slope", "deg", range(0.01, 20),
      "standard deviation of a floor's slope, where the vertical is told");
    v(disparity_noise, "disparity_noise", "px", range(0.01, 10),
      "standard deviation of disparities on a textured floor");
    v(disparity_bias, "disparity_bias", "px", range(0, 10),
      "standard deviation of an error that all disparities have in common");
    v(min_disparity, "min_disparity", "px", range(0.5, 1000),
      "floor with less is left out: seen so flat, its disparities are drawn to those of what stands on it");
    v(step_u, "step_u", "px", range(1, 64), "columns from one pixel that is looked at to the next");
    v(step_v, "step_v", "px", range(1, 64), "rows from one pixel that is looked at to the next");
    v(min_pixels, "min_pixels", "", range(3, 1000000),
      "of the pixels looked at, so many must show the floor");
    v(min_share, "min_share", "", range(0, 1),
      "of the pixels that may show the floor or a surface a little above or below it, this share must lie on "
      "the plane");
    v(max_angle_error, "max_angle_error", "deg", range(0.001, 10),
      "a frame that tells pitch or roll with a larger standard deviation is not enough");
    v(max_height_error, "max_height_error", "m", range(1e-5, 0.1), "the same of the height");
    v(consistency, "consistency", "", range(1, 1000),
      "squared Mahalanobis distance (3 degrees of freedom) beyond which a plane contradicts the prediction");
    v(hypotheses, "hypotheses", "", range(1, 10000), "planes through three pixels that are tried");
  }
};

/// What is known of the robot's motion since the last frame; anything may be unknown.
struct GroundPlaneStep {
  double seconds = 0.1;  ///< since the last frame, positive

  /// How the camera moved, for instance from an IMU, wheels or visual odometry. T_now_before takes points of
  /// the last frame's camera to this frame's; `covariance` is that of xi in T_now_before * Exp(xi),
  /// translation first [m^2, rad^2]. An unknown translation is told by a large covariance.
  struct Motion {
    SE3d T_now_before;
    Mat6<double> covariance = Mat6<double>::Identity();
  };
  std::optional<Motion> motion;

  /// The direction of gravity in this frame's camera.
  struct Vertical {
    Vec3<double> down_camera = Vec3<double>::UnitY();  ///< any length
    double sigma = 0.01;                               ///< of its direction [rad]
  };
  std::optional<Vertical> vertical;
};

enum class GroundPlaneState {
  measured,   ///< this frame shows the floor, and it agrees with what was known
  predicted,  ///< this frame shows no floor, or too little: the plane is what is known without it
  refused,    ///< this frame shows a surface that cannot be the floor under the wheels; plane as predicted
};

/// Why a plane was not measured.
enum class GroundPlaneReason {
  none,           ///< it was measured
  no_disparity,   ///< too few valid disparities where a floor could be
  no_floor,       ///< too few of them near the floor
  too_narrow,     ///< the floor that is seen does not fix pitch, roll and height
  contradiction,  ///< what is seen lies farther off than motion permits: a carpet, a sill, a lower floor
  lifted,         ///< motion says that the robot does not stand on the floor
};

constexpr std::string_view to_string(GroundPlaneState state) {
  switch (state) {
    case GroundPlaneState::measured:
      return "measured";
    case GroundPlaneState::predicted:
      return "predicted";
    case GroundPlaneState::refused:
      return "refused";
  }
  return "unknown";
}

constexpr std::string_view to_string(GroundPlaneReason reason) {
  switch (reason) {
    case GroundPlaneReason::none:
      return "none";
    case GroundPlaneReason::no_disparity:
      return "no_disparity";
    case GroundPlaneReason::no_floor:
      return "no_floor";
    case GroundPlaneReason::too_narrow:
      return "too_narrow";
    case GroundPlaneReason::contradiction:
      return "contradiction";
    case GroundPlaneReason::lifted:
      return "lifted";
  }
  return "unknown";
}

/// The ground plane of a frame, always a plane that can be used, and how far to trust it.
struct GroundPlaneResult {
  GroundPlane plane;
  /// Of (pitch, roll, height) of the plane [rad^2, rad m, m^2].
  Mat3<double> covariance = Mat3<double>::Zero();
  GroundPlaneState state = GroundPlaneState::predicted;
  GroundPlaneReason reason = GroundPlaneReason::no_disparity;
  int pixels = 0;      ///< valid disparities looked at where a floor can be
  int inliers = 0;     ///< of these, on the plane that was fitted
  double noise = 0.0;  ///< standard deviation of the inliers' disparities about that plane [px]

  bool measured() const { return state == GroundPlaneState::measured; }
};

/// The angle by which the camera looks down at a plane [rad]; positive downwards.
inline double pitch_down(const GroundPlane& plane) {
  return std::asin(std::clamp(plane.down_camera.z(), -1.0, 1.0));
}
/// The angle by which a plane's normal is turned about the viewing axis [rad], towards +x.
inline double roll(const GroundPlane& plane) {
  return std::atan2(plane.down_camera.x(), plane.down_camera.y());
}

/// Estimates the floor under the wheels from disparity images, frame by frame.
///
/// A floor's disparity is linear in the pixel: d = s . r with the ray r = (x, y, 1) and s = focal * baseline
/// * down / height. A Kalman filter holds s as the mounting, which hardly changes, and a tilt that fades
/// away; the seed is its prior, motion turns the tilt about the wheels, and each image gives s by a robust
/// fit (MSAC of Torr and Zisserman 2000, then Tukey's biweight) to the pixels that may be floor. A fit is
/// taken only if enough pixels carry it, if they fix all three numbers, if no other plane explains the image
/// much better, and if it lies where prediction and motion allow. Else the prediction stands: a wall, a
/// carpet ahead, darkness or a hand that lifts the robot do not move the plane. Deterministic; one thread at
/// a time.
class GroundPlaneEstimator {
 public:
  /// @throws Error(option) for options out of range, Error(argument) for a camera or seed that cannot be
  GroundPlaneEstimator(const RectifiedCamera& camera, const GroundPlaneSeed& seed,
                       const GroundPlaneOptions& options = {});
  ~GroundPlaneEstimator();
  GroundPlaneEstimator(GroundPlaneEstimator&&) noexcept;
  GroundPlaneEstimator& operator=(GroundPlaneEstimator&&) noexcept;

  /// Takes the next frame.
  /// @param disparity of the rectified left image, of any size, in 1/16 px; not positive: invalid. May be
  ///   empty
  /// @throws Error(argument) for a step whose time is not positive, or whose motion is not finite
  GroundPlaneResult estimate(View2d<const std::int16_t> disparity, const GroundPlaneStep& step = {});
  /// The same with disparities in px; not positive, infinite or NaN: invalid.
  GroundPlaneResult estimate(View2d<const float> disparity, const GroundPlaneStep& step = {});

  /// The mounting as learned so far: the plane while all wheels are on one surface.
  GroundPlane mounting() const;
  /// Forgets all but the seed.
  void reset();

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace sweepkit
