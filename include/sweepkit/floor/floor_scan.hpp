// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cmath>
#include <concepts>
#include <cstdint>
#include <limits>
#include <numbers>
#include <vector>

#include "sweepkit/core/options.hpp"
#include "sweepkit/core/view.hpp"
#include "sweepkit/floor/floor_tolerance.hpp"
#include "sweepkit/floor/ground_plane.hpp"
#include "sweepkit/geometry/se3.hpp"
#include "sweepkit/image/disparity.hpp"

namespace sweepkit {

/// A part of a ray that runs over the floor from the point below the camera.
struct FloorStretch {
  std::uint16_t bearing = 0;             ///< index of the ray
  std::uint16_t from = 0;                ///< distance along the floor [mm]
  std::uint16_t to = 0;                  ///< [mm], at least `from`
  FloorLabel label = FloorLabel::floor;  ///< floor that was seen, or where an obstacle or a hole begins
  std::uint8_t rows = 0;                 ///< of the image that say so, 255 for more

  friend bool operator==(const FloorStretch&, const FloorStretch&) = default;
};

/// What one image says of the floor, small enough to be kept for as long as the map lives: eight bytes for
/// each stretch, one to three stretches a ray (2 to 5 kB for 90 degrees at the default step). Its frame lies
/// on the floor below the camera: x where the camera looks, y to the left, z up.
struct FloorScan {
  double first_bearing = 0.0;  ///< of ray 0, counter-clockwise from x [rad]
  double bearing_step = 0.0;   ///< from a ray to the next [rad]
  int bearings = 0;            ///< number of rays
  /// A distance r measured by disparity has the standard deviation range_noise * r * r [1/m].
  double range_noise = 0.0;
  /// The disc that the robot itself stands on: free. None if the radius is zero [m].
  Vec2<double> footprint = Vec2<double>::Zero();
  double footprint_radius = 0.0;
  std::vector<FloorStretch> stretches;  ///< by ray; of a ray from near to far, obstacles and holes last

  double bearing(int ray) const { return first_bearing + ray * bearing_step; }
  std::size_t bytes() const { return sizeof(*this) + stretches.capacity() * sizeof(FloorStretch); }
};

struct FloorScanOptions {
  double bearing_step = 0.5;
  double max_range = 3.0;
  double max_disparity = 120.0;
  double max_height = 0.1;
  double disparity_noise = 0.3;
  int min_rows = 3;
  int min_hole_rows = 4;
  double max_gap = 0.05;
  double footprint_radius = 0.15;
  FloorNoise noise = drivable_noise();

  /// What a robot drives over (carpets, sills, shallow joints) is floor.
  static FloorNoise drivable_noise() {
    FloorNoise noise;
    noise.factor = 3.0;
    noise.min_height = 0.016;
    noise.min_depth = 0.02;
    return noise;
  }

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(bearing_step, "bearing_step", "deg", range(0.05, 10), "from a ray over the floor to the next");
    v(max_range, "max_range", "m", range(0.2, 60), "what is farther is left to later images");
    v(max_disparity, "max_disparity", "px", range(1, 10000),
      "floor so near that its disparity is larger is not judged: matching does not look there");
    v(max_height, "max_height", "m", range(0.01, 2), "what hangs higher is passed under");
    v(disparity_noise, "disparity_noise", "px", range(0.01, 5),
      "standard deviation of an obstacle's disparity, neighbours' errors being alike");
    v(min_rows, "min_rows", "", range(1, 100), "an obstacle is seen in so many rows of a ray");
    v(min_hole_rows, "min_hole_rows", "", range(1, 100), "a hole is seen in so many rows of a ray");
    v(max_gap, "max_gap", "m", range(0, 1),
      "between two places where floor is seen, so short a stretch without disparity is floor too");
    v(footprint_radius, "footprint_radius", "m", range(0, 2),
      "of the disc about the robot's centre that is free because the robot stands there");
    v.group(noise, "noise", "what counts as floor");
  }
};

/// From the frame of a scan made with this plane to the camera's: origin on the floor below the camera, x
/// along what it looks at, z up. Nothing to look along the floor (a camera that looks straight down): x is
/// the image's upward direction then.
inline SE3d camera_from_scan(const GroundPlane& plane) {
  const Vec3<double> up = -plane.down_camera;
  Vec3<double> forward = Vec3<double>::UnitZ() - up.z() * up;
  if (forward.squaredNorm() < 1e-12) forward = -Vec3<double>::UnitY() + up.y() * up;
  forward.normalize();
  Mat3<double> R;
  R << forward, up.cross(forward), up;
  return {SO3<double>(R), plane.height * plane.down_camera};
}

namespace impl {

/// A pixel's line in the image: what all vertical planes through the camera's centre look like.
struct FloorRay {
  double u0, du;  // u = u0 + du * v
  double a0, da;  // of the viewing ray at row v, its part along the bearing
  double n0, dn;  // and its part along down

  FloorRay(const RectifiedCamera& camera, const GroundPlane& plane, const Vec3<double>& direction) {
    // Points of the plane are height * down + r * direction; two of them tell the line.
    const auto pixel = [&](const Vec3<double>& p) {
      return Vec2<double>(camera.cx + camera.focal * p.x() / p.z(), camera.cy + camera.focal * p.y() / p.z());
    };
    const Vec2<double> far = pixel(direction);
    const Vec2<double> near = pixel(direction + 0.5 * plane.down_camera);
    du = (near.x() - far.x()) / (near.y() - far.y());
    u0 = far.x() - du * far.y();
    const auto part = [&](const Vec3<double>& axis, double& at0, double& slope) {
      slope = (axis.x() * du + axis.y()) / camera.focal;
      at0 = (axis.x() * (u0 - camera.cx) - axis.y() * camera.cy) / camera.focal + axis.z();
    };
    part(direction, a0, da);
    part(plane.down_camera, n0, dn);
  }

  double horizon() const { return -n0 / dn; }
};

/// A run of rows with about one inverse distance.
struct RunningObstacle {
  double sum = 0.0;  // of inverse distances
  int rows = 0;

  double mean() const { return sum / rows; }
};

inline std::uint16_t millimetres(double metres) {
  return static_cast<std::uint16_t>(std::clamp(1000.0 * metres + 0.5, 0.0, 65535.0));
}

}  // namespace impl

/// Makes scans of the floor from disparity images. Keeps its memory from image to image.
///
/// Each ray over the floor is a line in the image (the vertical plane through it and the camera's centre),
/// walked from the lower edge upwards. A disparity within the tolerance of the floor's is floor seen; a
/// larger one that belongs to a point below max_height is an obstacle, at the distance that the disparity
/// tells; a smaller one is a hole, which begins where the viewing ray meets the floor. No disparity is no
/// evidence, but for rays that see nothing at the camera's height between two that do: they are taken to meet
/// a flat face there, and floor behind it is left out.
class FloorScanner {
 public:
  /// @throws Error(option)
  explicit FloorScanner(const FloorScanOptions& options = {}) : options_(options) { check_options(options); }

  const FloorScanOptions& options() const { return options_; }

  /// @param base_camera the robot's centre in the camera's frame, for the footprint [m]
  template <DisparityPixel D>
  void scan(View2d<const D> disparity, const RectifiedCamera& camera, const GroundPlane& plane,
            const Vec3<double>& base_camera, FloorScan& scan) {
    const SE3d T_camera_scan = camera_from_scan(plane);
    const Mat3<double> R = T_camera_scan.rotation().matrix();
    const double step = options_.bearing_step * std::numbers::pi / 180.0;
    const FloorTolerance tolerance = FloorTolerance::of(options_.noise, plane, camera);
    scan.stretches.clear();
    scan.bearing_step = step;
    scan.range_noise = options_.disparity_noise / (camera.focal * camera.baseline);
    const Vec3<double> base = T_camera_scan.inverse() * base_camera;
    scan.footprint = base.head<2>();
    scan.footprint_radius = options_.footprint_radius;
    const double left = std::atan(camera.cx / camera.focal);
    const double right = std::atan((disparity.width - 1 - camera.cx) / camera.focal);
    const int to_right = std::max(0, static_cast<int>(right / step)),
              to_left = std::max(0, static_cast<int>(left / step));
    scan.bearings = to_right + to_left + 1;
    scan.first_bearing = -to_right * step;
    limits_.assign(static_cast<std::size_t>(scan.bearings), 0.0);
    for (int i = 0; i < scan.bearings; ++i) {
      const double bearing = scan.bearing(i);
      const Vec3<double> direction = std::cos(bearing) * R.col(0) + std::sin(bearing) * R.col(1);
      if (direction.z() < 0.05) continue;
      walk(disparity, camera, plane, tolerance, impl::FloorRay(camera, plane, direction), i, scan);
    }
    end_below_faces(scan);
  }

 private:
  template <DisparityPixel D>
  void walk(View2d<const D> disparity, const RectifiedCamera& camera, const GroundPlane& plane,
            const FloorTolerance& tolerance, const impl::FloorRay& ray, int index, FloorScan& scan);

  static constexpr int kAheadRows = 12;      // above the horizon
  static constexpr double kNearest = 0.1;    // of an obstacle taller than the camera [m]
  static constexpr double kOvershoot = 1.4;  // of floor behind an obstacle's foot

  /// Leaves floor out that lies behind what stands or hangs at the camera's height. Between two rays that see
  /// something there, those that see nothing are taken to meet a flat face without texture that joins the
  /// two: the front of a cabinet on legs, below which the floor goes on.
  void end_below_faces(FloorScan& scan);
  static std::size_t at(int ray) { return static_cast<std::size_t>(ray); }

  FloorScanOptions options_;
  // Of one ray: its obstacles and holes, and inverse distances at the camera's height.
  std::vector<FloorStretch> obstacles_;
  std::vector<double> ahead_;
  // Of all rays, inverse distances of what stands at the camera's height, 0 where nothing is seen there; and
  // what follows for those.
  std::vector<double> limits_, hidden_;
};

template <DisparityPixel D>
void FloorScanner::walk(View2d<const D> disparity, const RectifiedCamera& camera, const GroundPlane& plane,
                        const FloorTolerance& tolerance, const impl::FloorRay& ray, int index,
                        FloorScan& scan) {
  const double H = plane.height, fb = camera.focal * camera.baseline;
  const double max_range = options_.max_range, max_ratio = options_.max_height / H;
  // Where the viewing ray at a row meets the floor; infinite at and above the horizon.
  const auto floor_range = [&](double v) {
    const double n = ray.n0 + v * ray.dn;
    return n > 1e-9 ? H * (ray.a0 + v * ray.da) / n : std::numeric_limits<double>::infinity();
  };
  const auto put = [&](std::vector<FloorStretch>& out, double from, double to, FloorLabel label, int rows) {
    out.push_back({static_cast<std::uint16_t>(index), impl::millimetres(from), impl::millimetres(to), label,
                   static_cast<std::uint8_t>(std::min(rows, 255))});
  };
  obstacles_.clear();
  ahead_.clear();
  const std::size_t first = scan.stretches.size();
  double from = 0.0, to = -1.0;  // the floor that is being walked over; to < from: none
  int floor_rows = 0, hole_rows = 0;
  double hole_from = 0.0;
  int last_row = 0;
  impl::RunningObstacle obstacle;
  const auto end_floor = [&] {
    if (to > from) put(scan.stretches, from, std::min(to, max_range), FloorLabel::floor, floor_rows);
    from = 0.0;
    to = -1.0;
    floor_rows = 0;
  };
  const auto end_obstacle = [&] {
    if (obstacle.rows >= options_.min_rows && 1.0 <= obstacle.mean() * max_range)
      put(obstacles_, 1.0 / obstacle.mean(), 1.0 / obstacle.mean(), FloorLabel::obstacle, obstacle.rows);
    obstacle = {};
  };
  for (int v = disparity.height - 1; v >= 0; --v) {
    const double n = ray.n0 + v * ray.dn;
    // Above the camera only what is near is still low enough.
    if (-n * kNearest > std::max(options_.max_height - H, 0.0) && v < ray.horizon() - kAheadRows) break;
    const int u = static_cast<int>(std::lround(ray.u0 + v * ray.du));
    if (u < 0 || u >= disparity.width) continue;
    const double d = static_cast<double>(disparity(u, v)) * kDisparityUnit<D>;
    if (!(d > 0 && d < std::numeric_limits<float>::infinity())) continue;
    const double floor = fb * n / H;
    if (floor > options_.max_disparity) continue;
    if (n <= 0 && v >= ray.horizon() - kAheadRows) ahead_.push_back(d / (fb * (ray.a0 + v * ray.da)));
    const double excess = d - std::max(floor, 0.0);
    if (excess > tolerance.towards(floor)) {
      if (1.0 - floor / d > max_ratio) continue;  // height over the camera's
      const double inverse = d / (fb * (ray.a0 + v * ray.da));
      if (obstacle.rows > 0 && std::abs(inverse - obstacle.mean()) * fb > 1.0 + 0.05 * d) end_obstacle();
      obstacle.sum += inverse;
      ++obstacle.rows;
      continue;
    }
    const double near = floor_range(v + 0.5), far = floor_range(v - 0.5);
    if (near > max_range) continue;
    if (excess < -tolerance.away(floor)) {
      if (hole_rows++ == 0) hole_from = near;
      if (hole_rows == options_.min_hole_rows)
        put(obstacles_, hole_from, hole_from, FloorLabel::hole, hole_rows);
      continue;
    }
    hole_rows = 0;
    if (to < from || near - to > options_.max_gap) {
      end_floor();
      from = near;
    }
    to = far;
    last_row = v;
    ++floor_rows;
  }
  end_obstacle();
  // Where nothing is known above the last rows of floor they may be the foot of something that cannot be told
  // from the floor yet. What is seen at the camera's height stands where it is seen.
  const bool ahead = static_cast<int>(ahead_.size()) >= kAheadRows / 3;
  if (!ahead && to > from && to < max_range) {
    const double per_row = fb * ray.dn / H;
    const double floor = fb * (ray.n0 + last_row * ray.dn) / H;
    const double doubtful = (tolerance.base + tolerance.slope * floor) / per_row;
    to = floor_range(last_row - 0.5 + doubtful);
  }
  end_floor();
  // The lowest rows of an obstacle's face differ from the floor by less than the tolerance: floor that seems
  // to reach a little behind it ends before it, by a standard deviation of the distance.
  const auto cut = [&](double r, double until) {
    const std::uint16_t end = impl::millimetres(r - scan.range_noise * r * r);
    for (std::size_t i = first; i < scan.stretches.size(); ++i) {
      FloorStretch& s = scan.stretches[i];
      if (1e-3 * s.from < r && s.to > end && 1e-3 * s.to < until) s.to = end;
    }
  };
  for (const FloorStretch& o : obstacles_) cut(1e-3 * o.from, kOvershoot * 1e-3 * o.from);
  if (ahead) {
    const auto middle = ahead_.begin() + static_cast<std::ptrdiff_t>(ahead_.size() / 2);
    std::nth_element(ahead_.begin(), middle, ahead_.end());
    limits_[at(index)] = *middle;
  }
  const auto own = scan.stretches.begin() + static_cast<std::ptrdiff_t>(first);
  scan.stretches.erase(
      std::remove_if(own, scan.stretches.end(), [](const FloorStretch& s) { return s.to <= s.from; }),
      scan.stretches.end());
  scan.stretches.insert(scan.stretches.end(), obstacles_.begin(), obstacles_.end());
}

inline void FloorScanner::end_below_faces(FloorScan& scan) {
  // A flat face has an inverse depth that is linear in the column, which goes with the bearing's tangent.
  const auto column = [&](int ray) { return std::tan(scan.bearing(ray)); };
  const auto inverse_depth = [&](int ray) { return limits_[at(ray)] / std::cos(scan.bearing(ray)); };
  hidden_ = limits_;
  int last = -1;
  for (int i = 0; i <= scan.bearings; ++i) {
    if (i < scan.bearings && limits_[at(i)] == 0.0) continue;
    const bool from = last >= 0, to = i < scan.bearings;
    for (int k = last + 1; k < i; ++k) {
      if (from && to) {
        const double w = (column(k) - column(last)) / (column(i) - column(last));
        hidden_[at(k)] = std::cos(scan.bearing(k)) * ((1.0 - w) * inverse_depth(last) + w * inverse_depth(i));
      } else if (from || to) {
        hidden_[at(k)] = limits_[at(from ? last : i)];
      }
    }
    last = i;
  }
  for (FloorStretch& s : scan.stretches) {
    const double inverse = hidden_[at(s.bearing)];
    if (s.label != FloorLabel::floor || inverse <= 0.0) continue;
    const double end = (1.0 - scan.range_noise / inverse) / inverse;
    s.to = 1e-3 * s.from * inverse >= 1.0 ? s.from : std::min(s.to, impl::millimetres(end));
  }
  std::erase_if(scan.stretches,
                [](const FloorStretch& s) { return s.label == FloorLabel::floor && s.to <= s.from; });
}

}  // namespace sweepkit
