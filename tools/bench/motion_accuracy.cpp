// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
// What the whole system knows of motion at the end of a recording in the layout of EuRoC, against its truth,
// and whether its covariances hold. For each recording:
//   NEES       mean over the images of e^T P^-1 e, e the error of the live pose with the first poses laid
//   over each other,
//              P its covariance; 6 would be exact. Also of the position and of the rotation alone (3 each)
//   gyro bias  largest difference of an axis to the truth's bias at the last image [deg/s]
//   up         angle between the estimated vertical and the true one at the end, and three times its sigma
//   [deg] wheels     radii (the worse one) and track width against truth.yaml [%] blind      stretches
//   without vision of a second or more: way, error when it comes back [mm], the same as
//              standard deviations of the predicted covariance
#include <fmt/format.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <fstream>
#include <numbers>
#include <sstream>

#include "sweepkit/data/recording.hpp"
#include "sweepkit/data/trajectory.hpp"
#include "sweepkit/system/sweeper.hpp"

using namespace sweepkit;

namespace {

constexpr double kDegree = std::numbers::pi / 180;

struct Truth {
  Trajectory poses;

  SE3d at(TimeNs t) const {
    const auto after = std::lower_bound(poses.begin(), poses.end(), t,
                                        [](const StampedPose& pose, TimeNs key) { return pose.t < key; });
    if (after == poses.begin()) return poses.front().T_world_body;
    if (after == poses.end()) return poses.back().T_world_body;
    const auto before = after - 1;
    return interpolate(before->T_world_body, after->T_world_body,
                       to_seconds(t - before->t) / to_seconds(after->t - before->t));
  }
};

// The gyro bias in the last line of EuRoC's truth.
std::optional<Vec3<double>> true_gyro_bias(const std::filesystem::path& file) {
  std::ifstream stream(file);
  std::string line, last;
  while (std::getline(stream, line))
    if (!line.empty()) last = line;
  std::replace(last.begin(), last.end(), ',', ' ');
  std::istringstream fields(last);
  std::vector<double> values;
  for (double value; fields >> value;) values.push_back(value);
  if (values.size() < 14) return std::nullopt;
  return Vec3<double>(values[11], values[12], values[13]);
}

// A number after a key, wherever it stands in truth.yaml.
std::optional<double> number_after(const std::string& text, const std::string& key) {
  const std::size_t place = text.find(key + ": ");
  if (place == std::string::npos) return std::nullopt;
  return std::strtod(text.c_str() + place + key.size() + 2, nullptr);
}

std::string percent(const std::string& text, const std::string& key, double estimate) {
  const auto truth = number_after(text, key);
  return truth ? fmt::format("{:.2f}", 100 * std::abs(estimate / *truth - 1)) : "-";
}

void report(const std::filesystem::path& folder) {
  const auto recording = open_recording(folder);
  const Truth truth{read_trajectory(folder)};
  Sweeper sweeper(recording->rig());
  while (auto sample = recording->next())
    std::visit([&](auto&& s) { sweeper.feed(std::forward<decltype(s)>(s)); }, *std::move(sample));
  sweeper.finish();
  const std::vector<TrackedImage> images = sweeper.images();
  if (images.empty()) return fmt::print("{}: no images\n", folder.string());

  const SE3d T_map_truth = images.front().T_map_body * truth.at(images.front().t).inverse();
  double nees = 0, nees_position = 0, nees_rotation = 0;
  for (std::size_t i = 1; i < images.size(); ++i) {
    const Vec6<double> e = (images[i].T_map_body.inverse() * T_map_truth * truth.at(images[i].t)).log();
    const Mat6<double>& P = images[i].covariance;
    nees += e.dot(P.ldlt().solve(e));
    nees_position += e.head<3>().dot(P.topLeftCorner<3, 3>().ldlt().solve(e.head<3>()));
    nees_rotation += e.tail<3>().dot(P.bottomRightCorner<3, 3>().ldlt().solve(e.tail<3>()));
  }
  const double count = std::max<double>(1, static_cast<double>(images.size()) - 1);
  fmt::print("{}\n  NEES {:.2f} of 6, position {:.2f}, rotation {:.2f}\n", folder.string(), nees / count,
             nees_position / count, nees_rotation / count);

  if (const auto state = sweeper.navigation()) {
    std::ifstream file(folder / "truth.yaml");
    const std::string text{std::istreambuf_iterator<char>(file), {}};
    if (recording->rig().imu) {
      const auto bias = true_gyro_bias(recording->info().truth);
      const Vec3<double> up = T_map_truth.rotation() * Vec3<double>::UnitZ();
      const double sigma =
          std::sqrt(state->covariance.block<2, 2>(NavigationState::kUp, NavigationState::kUp).trace());
      fmt::print(
          "  gyro bias off by {} deg/s; up off by {:.3f} deg, three sigma {:.3f}\n",
          bias ? fmt::format("{:.4f}", (state->gyro_bias - *bias).cwiseAbs().maxCoeff() / kDegree) : "-",
          std::acos(std::clamp(up.dot(state->up), -1.0, 1.0)) / kDegree, 3 * sigma / kDegree);
    }
    if (const auto& wheels = recording->rig().wheels) {
      const WheelGeometry& g = wheels->geometry;
      const Vec3<double> measures =
          state->wheel_scales.array().exp() * Eigen::Array3d(g.wheel_radius, g.wheel_radius, g.track_width);
      fmt::print("  wheels off by {} % left, {} % right, track {} %\n",
                 percent(text, "true_radius_left_m", measures[0]),
                 percent(text, "true_radius_right_m", measures[1]),
                 percent(text, "true_track_width_m", measures[2]));
    }
  }
  for (std::size_t i = 1; i < images.size(); ++i) {
    if (images[i].basis == PoseBasis::vision) continue;
    std::size_t end = i;
    double way = 0;
    while (end < images.size() && images[end].basis != PoseBasis::vision) {
      way += (truth.at(images[end].t).translation() - truth.at(images[end - 1].t).translation()).norm();
      ++end;
    }
    if (end < images.size() && images[end].t - images[i - 1].t >= kNsPerSecond) {
      const TrackedImage &a = images[i - 1], &b = images[end];
      const SE3d T_a_b = a.T_odom_body.inverse() * b.T_odom_body;
      const Vec6<double> e = (T_a_b.inverse() * truth.at(a.t).inverse() * truth.at(b.t)).log();
      const Vec6<double> blind_sigma = images[end - 1].covariance.diagonal().cwiseSqrt();
      fmt::print(
          "  blind for {:.1f} s and {:.2f} m: off by {:.1f} mm, asked {:.1f}; {:.1f} predicted sigmas\n",
          to_seconds(b.t - a.t), way, 1e3 * e.head<3>().norm(), 10 * way + 10,
          e.head<3>().norm() / blind_sigma.head<3>().norm());
    }
    i = end;
  }
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 2) {
    fmt::print(stderr, "usage: motion_accuracy RECORDING...\n");
    return 2;
  }
  try {
    for (int i = 1; i < argc; ++i) report(argv[i]);
  } catch (const std::exception& error) {
    fmt::print(stderr, "motion_accuracy: {}\n", error.what());
    return 3;
  }
  return 0;
}
