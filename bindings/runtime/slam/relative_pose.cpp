// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/slam/relative_pose.hpp"

#include <algorithm>
#include <limits>
#include <span>

namespace sweepkit {
namespace {

// Stereo points of a frame with what is needed to find them in another.
struct StereoPoints {
  std::vector<Vec3<double>> p_camera;
  std::vector<Vec3<float>> spread;
  std::vector<std::uint32_t> measurement;
  std::vector<OrbDescriptor> descriptors;
};

StereoPoints stereo_points(const RectifiedCamera& camera, const StereoFrame& frame,
                           double max_depth_uncertainty) {
  StereoPoints points;
  for (std::uint32_t i = 0; i < frame.measurements.size(); ++i) {
    const Measurement& m = frame.measurements[i];
    if (!m.stereo() || m.sigma_right > max_depth_uncertainty * m.disparity()) continue;
    const Vec3<double> p = camera.depth(m.disparity()) * Vec3<double>((m.u - camera.cx) / camera.focal,
                                                                      (m.v - camera.cy) / camera.focal, 1);
    points.p_camera.push_back(p);
    points.spread.push_back((p * (m.sigma_right / m.disparity())).cast<float>());
    points.measurement.push_back(i);
    points.descriptors.push_back(frame.descriptors[i]);
  }
  return points;
}

std::optional<SE3d> coarse_pose(const RectifiedCamera& camera, const StereoPoints& a, const StereoFrame& b,
                                const RelativePoseOptions& options) {
  std::vector<Match> matches;
  BruteForceMatcher(options.brute_force).match(a.descriptors, b.descriptors, matches);
  std::vector<Vec3<double>> points;
  std::vector<Vec2<double>> rays;
  std::vector<double> right_x, sigmas;
  for (std::size_t k = 0; k < matches.size(); ++k) {
    if (!matches[k].found()) continue;
    const Measurement& m = b.measurements[static_cast<std::size_t>(matches[k].index)];
    points.push_back(a.p_camera[k]);
    rays.emplace_back((m.u - camera.cx) / camera.focal, (m.v - camera.cy) / camera.focal);
    right_x.push_back(m.stereo() ? (m.u_right - camera.cx) / camera.focal
                                 : std::numeric_limits<double>::quiet_NaN());
    sigmas.push_back(m.sigma);
  }
  PnpOptions pnp = options.pnp;
  pnp.min_inliers = std::min(pnp.min_inliers, options.min_inliers);
  const auto found = solve_pnp({.points = points,
                                .rays = rays,
                                .right_x = right_x,
                                .sigmas = sigmas,
                                .focal = camera.focal,
                                .baseline = camera.baseline},
                               pnp);
  if (!found) return std::nullopt;
  return found->T_world_camera.inverse();
}

// Where a's points should be seen in b, and those of b's key points that look like them there.
std::vector<PoseObservation> observations_near(const RectifiedCamera& camera, const StereoFrame& a,
                                               const StereoPoints& points, const StereoFrame& b,
                                               const SE3d& T_b_a, const RelativePoseOptions& options) {
  std::vector<ProjectionQuery> queries;
  std::vector<OrbDescriptor> descriptors;
  std::vector<std::size_t> asked;
  // The radius grows with the octave as sigma does.
  float finest = std::numeric_limits<float>::infinity();
  for (const Measurement& m : a.measurements) finest = std::min(finest, m.sigma);
  for (std::size_t k = 0; k < points.p_camera.size(); ++k) {
    const auto uvr = camera.project_stereo(T_b_a * points.p_camera[k]);
    if (!uvr) continue;
    const Measurement& m = a.measurements[points.measurement[k]];
    queries.push_back({.u = static_cast<float>(uvr->x()),
                       .v = static_cast<float>(uvr->y()),
                       .u_right = static_cast<float>(uvr->z()),
                       .radius = static_cast<float>(options.search_radius) * m.sigma / finest,
                       .angle = m.angle});
    descriptors.push_back(points.descriptors[k]);
    asked.push_back(k);
  }
  std::vector<Match> matches(queries.size());
  ProjectionMatcher(options.projection)
      .match(queries, descriptors, b.grid, std::span<const Measurement>(b.measurements), b.descriptors,
             matches);
  std::vector<PoseObservation> observations;
  for (std::size_t q = 0; q < matches.size(); ++q) {
    if (!matches[q].found()) continue;
    const Measurement& m = b.measurements[static_cast<std::size_t>(matches[q].index)];
    observations.push_back({.p_world = points.p_camera[asked[q]],
                            .u = m.u,
                            .v = m.v,
                            .u_right = m.u_right,
                            .sigma = m.sigma,
                            .sigma_disparity = m.sigma_right,
                            .p_world_spread = points.spread[asked[q]]});
  }
  return observations;
}

}  // namespace

std::optional<RelativePoseEstimate> relative_pose(const RectifiedCamera& camera, const StereoFrame& a,
                                                  const StereoFrame& b, const RelativePoseOptions& options) {
  check_options(options);
  const StereoPoints points = stereo_points(camera, a, options.max_depth_uncertainty);
  const std::optional<SE3d> T_b_a = coarse_pose(camera, points, b, options);
  if (!T_b_a) return std::nullopt;
  const std::vector<PoseObservation> observations = observations_near(camera, a, points, b, *T_b_a, options);
  std::vector<std::uint8_t> inlier;
  const PoseResult pose = solve_pose(camera, *T_b_a, observations, options.pose, inlier);
  if (!pose.usable() || pose.inliers < options.min_inliers) return std::nullopt;
  return RelativePoseEstimate{.T_a_b = pose.T_camera_world.inverse(),
                              .covariance = pose.covariance,
                              .matches = static_cast<int>(observations.size()),
                              .inliers = pose.inliers};
}

}  // namespace sweepkit
