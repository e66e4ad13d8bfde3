// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
// real_floor on pairs with true disparities; see real_floor.cpp.

#include "real_floor.hpp"

#include <fmt/format.h>

#include <Eigen/Cholesky>
#include <cmath>
#include <cstdint>

#include "sweepkit/core/random.hpp"
#include "sweepkit/data/image_file.hpp"
#include "sweepkit/floor/obstacle_mask.hpp"

namespace real_floor {
namespace {

struct Pair {
  const char* name;
  double unit;  // of disp_left.png [1/px]
};
constexpr Pair kPairs[] = {{"teddy", 4},   {"cones", 4},    {"art", 3},
                           {"laundry", 3}, {"reindeer", 3}, {"aloe", 2}};

/// The plane that most true disparities of the lower third lie within 1 px of, of 2000 through three that may
/// be a floor: looked down on by 45 degrees at most, rolled by 10.
FloorDisparity fit(const GrayView& truth, double unit, const RectifiedCamera& camera, double& share) {
  Random random(1);
  const int top = truth.height * 2 / 3;
  std::vector<Vec3<double>> points;
  for (int v = top; v < truth.height; v += 2)
    for (int u = 0; u < truth.width; u += 2)
      if (truth(u, v)) points.emplace_back(u, v, truth(u, v) / unit);
  FloorDisparity best;
  std::size_t most = 0;
  const auto pick = [&] { return points[random.index(points.size())]; };
  const auto inliers = [&](const FloorDisparity& floor) {
    std::vector<Vec3<double>> on;
    for (const Vec3<double>& p : points)
      if (std::abs(floor(p.x(), p.y()) - p.z()) < 1) on.push_back(p);
    return on;
  };
  const auto solve = [](const std::vector<Vec3<double>>& on) {
    Mat3<double> A = Mat3<double>::Zero();
    Vec3<double> b = Vec3<double>::Zero();
    for (const Vec3<double>& p : on) {
      const Vec3<double> row(1, p.x(), p.y());
      A += row * row.transpose();
      b += row * p.z();
    }
    const Vec3<double> x = A.ldlt().solve(b);
    return FloorDisparity{x[0], x[1], x[2]};
  };
  for (int k = 0; k < 2000; ++k) {
    const Vec3<double> a = pick(), b = pick(), c = pick();
    if (std::abs((b - a).head<2>().x() * (c - a).y() - (b - a).y() * (c - a).x()) < 500) continue;
    const FloorDisparity floor = solve({a, b, c});
    const GroundPlane plane = GroundPlane::of(floor, camera);
    if (std::abs(pitch_down(plane)) > 45 * kDegree || std::abs(roll(plane)) > 10 * kDegree) continue;
    if (const std::size_t count = inliers(floor).size(); count > most) {
      most = count;
      best = floor;
    }
  }
  best = solve(inliers(best));
  share = static_cast<double>(most) / static_cast<double>(points.size());
  return best;
}

}  // namespace

void middlebury(const std::filesystem::path& folder, const Settings& settings) {
  fmt::print("{:<17}{:>6}{:>6}  {:<25}{:>6}{:>9}{:>6}{:>6}{:>6}{:>8}{:>4}{:>7}{:>9}\n", "Middlebury, %",
             "found", "bad1", "plane", "pitch", "carried", "floor", "obst.", "hole", "unknown", "n", "agree",
             "invented");
  for (const Pair& pair : kPairs) {
    const SharedGray left = read_gray(folder / pair.name / "left.png"),
                     right = read_gray(folder / pair.name / "right.png"),
                     truth = read_gray(folder / pair.name / "disp_left.png");
    const GrayView& t = truth.view;
    // 3740 px at the full size of about 1300 px; the principal point is not known.
    const double focal = 3740.0 * t.width / 1390;
    RectifiedCamera camera{focal, 0.5 * (t.width - 1), 0.5 * (t.height - 1), 1.0};
    std::vector<double> lowest;
    for (int v = t.height - 5; v < t.height; ++v)
      for (int u = 0; u < t.width; ++u)
        if (t(u, v)) lowest.push_back(t(u, v) / pair.unit);
    const double at_bottom = median(lowest);
    const double per_row = at_bottom / (t.height - 1 - camera.cy);
    double share = 0;
    const FloorDisparity level{-per_row * camera.cy, 0, per_row}, fitted = fit(t, pair.unit, camera, share);
    for (const FloorDisparity* seed : {&level, &fitted}) {
      camera.baseline = 1;
      camera.baseline = kRobotHeight / GroundPlane::of(*seed, camera).height;
      const GroundPlane plane = GroundPlane::of(*seed, camera);
      const Camera pinhole({focal, focal, camera.cx, camera.cy}, Distortion::none, {}, t.width, t.height);
      const StereoRig rig(pinhole, pinhole, SE3d(), SE3d(SO3d(), Vec3<double>(camera.baseline, 0, 0)));
      const GroundPlaneSeed from = GroundPlaneSeed::from_height(plane.down_camera, plane.height);
      ObstacleDetector detector(rig, from, settings.detector({"plane.min_disparity=8"}));
      const ObstacleFrame& frame = detector.detect(1, left.view, right.view);
      const FloorDisparity floor = frame.plane.plane.disparity(camera);
      std::size_t known = 0, found = 0, bad = 0, low = 0, carried = 0, compared = 0, agree = 0, invented = 0;
      std::vector<float> disparities(static_cast<std::size_t>(t.width) * t.height);
      for (int v = 0; v < t.height; ++v)
        for (int u = 0; u < t.width; ++u)
          disparities[static_cast<std::size_t>(v) * t.width + u] = static_cast<float>(t(u, v) / pair.unit);
      std::vector<std::uint8_t> true_labels(disparities.size());
      const View2d<std::uint8_t> true_mask{true_labels.data(), t.width, t.height};
      obstacle_mask(View2d<const float>{disparities.data(), t.width, t.height}, *seed, frame.tolerance,
                    true_mask);
      for (int v = 0; v < t.height; ++v)
        for (int u = 0; u < t.width; ++u) {
          const double d = t(u, v) / pair.unit;
          if (d <= 0) continue;
          if (v >= t.height * 2 / 3) {
            ++low;
            carried += std::abs(floor(u, v) - d) < 1;
          }
          if (frame.mask(u, v) && true_mask(u, v)) {
            ++compared;
            agree += frame.mask(u, v) == true_mask(u, v);
            invented += frame.mask(u, v) == 1 && true_mask(u, v) != 1;
          }
          if (d > u) continue;
          ++known;
          if (frame.disparity(u, v) <= 0) continue;
          ++found;
          bad += std::abs(frame.disparity(u, v) / 16.0 - d) > 1;
        }
      std::size_t labels[4] = {};
      for (int v = 0; v < t.height; ++v)
        for (int u = 0; u < t.width; ++u) ++labels[frame.mask(u, v)];
      const auto percent = [](std::size_t part, std::size_t all) {
        return all ? 100.0 * static_cast<double>(part) / static_cast<double>(all) : 0.0;
      };
      const bool is_level = seed == &level;
      const std::size_t all = labels[0] + labels[1] + labels[2] + labels[3];
      fmt::print(
          "{:<10}{:<7}{:>6.1f}{:>6.1f}  "
          "{:<25}{:>6.1f}{:>9.1f}{:>6.1f}{:>6.1f}{:>6.1f}{:>8.1f}{:>4}{:>7.1f}{:>9.1f}\n",
          pair.name, is_level ? "level" : "fitted", percent(found, known), percent(bad, found),
          fmt::format("{} ({})", to_string(frame.plane.state), to_string(frame.plane.reason)),
          pitch_down(plane) / kDegree, percent(carried, low), percent(labels[1], all),
          percent(labels[2], all), percent(labels[3], all), percent(labels[0], all), frame.obstacles.size(),
          percent(agree, compared), percent(invented, compared));
      draw(settings, fmt::format("{}_{}", pair.name, is_level ? "level" : "fitted"), frame);
    }
  }
}

}  // namespace real_floor
