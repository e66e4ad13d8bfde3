// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
// What speaks for and against a pose that PlaceVerifier has found.
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "sweepkit/core/random.hpp"
#include "sweepkit/slam/place_verification.hpp"

namespace sweepkit {
namespace {

constexpr double kDegree = std::numbers::pi / 180;
// Nearer than this two key points are taken to show one surface, at octave 0 [px].
constexpr double kSameSurface = 8;
// Fewer points in the other's view say nothing of how many should be found.
constexpr int kFewPredicted = 20;
// How a plane is looked for, and how far off it a point still lies on it [m].
constexpr int kPlaneSamples = 60;
constexpr double kPlaneThickness = 0.02;

bool inside(const StereoRig::Bounds& view, double u, double v) {
  return u >= view.u_min && u <= view.u_max && v >= view.v_min && v <= view.v_max;
}

double largest_sigma(const Mat3<double>& covariance) {
  const Eigen::SelfAdjointEigenSolver<Mat3<double>> solver(covariance, Eigen::EigenvaluesOnly);
  return std::sqrt(std::max(0.0, solver.eigenvalues().maxCoeff()));
}

}  // namespace

std::string_view to_string(PlaceRejection rejection) {
  static constexpr std::array<std::string_view, kPlaceRejections> kNames = {
      "none",           "few_matches", "no_pose",        "few_inliers",  "inlier_share", "concentrated",
      "flat",           "not_seen",    "not_seen_there", "contradicted", "uncertain",    "tilted",
      "far_from_prior", "ambiguous",   "inconsistent",   "unconfirmed"};
  const auto i = static_cast<std::size_t>(rejection);
  return i < kNames.size() ? kNames[i] : "unknown";
}

int PlaceVerifier::count_off_plane() const {
  std::vector<const PoseObservation*> points;
  for (std::size_t k = 0; k < observations_.size(); ++k)
    if (inlier_[k]) points.push_back(&observations_[k]);
  if (points.size() < 4) return 0;
  Random random(1);
  std::array<std::size_t, 3> sample;
  std::size_t most = 0;
  for (int k = 0; k < kPlaneSamples; ++k) {
    random.sample(points.size(), std::span<std::size_t>(sample));
    const Vec3<double>& a = points[sample[0]]->p_world;
    const Vec3<double> normal =
        (points[sample[1]]->p_world - a).cross(points[sample[2]]->p_world - a).normalized();
    if (!(normal.squaredNorm() > 0.5)) continue;
    const auto on_plane = [&](const PoseObservation* o) {
      const double spread = std::abs(normal.dot(o->p_world_spread.cast<double>()));
      return std::abs(normal.dot(o->p_world - a)) < kPlaneThickness + 3 * spread;
    };
    most = std::max(most, static_cast<std::size_t>(std::count_if(points.begin(), points.end(), on_plane)));
  }
  return static_cast<int>(points.size() - most);
}

KeyframeId PlaceVerifier::most_seen(const Map& map) const {
  std::vector<int> seen(group_.size(), 0);
  for (std::size_t k = 0; k < observed_.size(); ++k) {
    if (!inlier_[k]) continue;
    for (const Observation& o : map.point(observed_[k].point).observations) {
      const auto it = std::find(group_.begin(), group_.end(), o.keyframe);
      if (it != group_.end()) ++seen[static_cast<std::size_t>(it - group_.begin())];
    }
  }
  return group_[static_cast<std::size_t>(std::max_element(seen.begin(), seen.end()) - seen.begin())];
}

double PlaceVerifier::inverse_share(const PlaceImage& image, const Keyframe& candidate,
                                    const SE3d& T_candidate_camera) {
  queries_.clear();
  query_descriptors_.clear();
  for (std::size_t i = 0; i < image.measurements.size(); ++i) {
    const Measurement& m = image.measurements[i];
    if (!m.stereo() || m.sigma_right > options_.max_depth_uncertainty * m.disparity()) continue;
    const Vec3<double> p = back_project(m);
    const Vec3<double> q = T_candidate_camera * p;
    const auto uvr = camera_.project_stereo(q);
    if (!uvr || !inside(view_, uvr->x(), uvr->y())) continue;
    const int octave =
        m.octave + static_cast<int>(std::lround(std::log(p.norm() / q.norm()) / std::log(levels_.factor)));
    if (octave < 0 || octave >= levels_.count) continue;
    queries_.push_back({.u = static_cast<float>(uvr->x()),
                        .v = static_cast<float>(uvr->y()),
                        .u_right = static_cast<float>(uvr->z()),
                        .radius = static_cast<float>(options_.radius * levels_.scale(octave)),
                        .min_octave = octave - 1,
                        .max_octave = octave + 1});
    query_descriptors_.push_back(image.descriptors[i]);
  }
  grid_.build(candidate.measurements);
  if (queries_.size() < static_cast<std::size_t>(kFewPredicted)) return 1;
  matches_.resize(queries_.size());
  const int found = projection_.match(queries_, query_descriptors_, grid_,
                                      std::span<const Measurement>(candidate.measurements),
                                      candidate.descriptors, matches_);
  return static_cast<double>(found) / std::max(1, count_comparable(candidate.measurements, grid_));
}

int PlaceVerifier::count_comparable(std::span<const Measurement> measurements, const KeypointGrid& grid) {
  int count = 0;
  for (const ProjectionQuery& q : queries_) {
    near_.clear();
    grid.query(q.u, q.v, q.radius, q.min_octave, q.max_octave, near_);
    count += std::any_of(near_.begin(), near_.end(), [&](std::int32_t i) {
      const Measurement& m = measurements[static_cast<std::size_t>(i)];
      return !m.stereo() || q.u_right < 0 || std::abs(m.u_right - q.u_right) <= q.radius;
    });
  }
  return count;
}

Vec3<double> PlaceVerifier::back_project(const Measurement& m) const {
  return camera_.depth(m.disparity()) *
         Vec3<double>((m.u - camera_.cx) / camera_.focal, (m.v - camera_.cy) / camera_.focal, 1);
}

double PlaceVerifier::contradictions(const PlaceImage& image, const Keyframe& candidate,
                                     const SE3d& T_candidate_camera) {
  int through = 0, agree = 0;
  std::vector<std::int32_t> near;
  // Do the stereo points of `from`, in the axes of `to`, lie where `to` sees something farther?
  const auto look = [&](std::span<const Measurement> from, const SE3d& T_to_from,
                        std::span<const Measurement> to, const KeypointGrid& grid) {
    for (const Measurement& m : from) {
      if (!m.stereo() || m.sigma_right > options_.max_depth_uncertainty * m.disparity()) continue;
      const auto uvr = camera_.project_stereo(T_to_from * back_project(m));
      if (!uvr || !inside(view_, uvr->x(), uvr->y())) continue;
      near.clear();
      grid.query(static_cast<float>(uvr->x()), static_cast<float>(uvr->y()), static_cast<float>(kSameSurface),
                 0, 31, near);
      const double disparity = uvr->x() - uvr->z();
      int farther = 0, nearer = 0, same = 0;
      for (const std::int32_t j : near) {
        const Measurement& other = to[static_cast<std::size_t>(j)];
        if (!other.stereo()) continue;
        const double tolerance = options_.depth_tolerance * disparity +
                                 3 * std::hypot(other.sigma_right, m.sigma_right * disparity / m.disparity());
        const double difference = other.disparity() - disparity;
        ++(difference < -tolerance ? farther : difference > tolerance ? nearer : same);
      }
      // Beside an edge a key point may lie on either side: one that agrees is enough.
      if (same > 0)
        ++agree;
      else if (farther > 0 && nearer == 0)
        ++through;
    }
  };
  look(candidate.measurements, T_candidate_camera.inverse(), image.measurements, image.grid);
  look(image.measurements, T_candidate_camera, candidate.measurements, grid_);
  return static_cast<double>(through) / std::max(1, through + agree);
}

bool PlaceVerifier::certain(const Mat6<double>& covariance) const {
  return largest_sigma(covariance.topLeftCorner<3, 3>()) <= options_.max_position_sigma &&
         largest_sigma(covariance.bottomRightCorner<3, 3>()) <= options_.max_rotation_sigma * kDegree;
}

PlaceRejection PlaceVerifier::judge(const PlaceHints& hints, const PlaceMatch& match) const {
  const auto inliers = static_cast<int>(match.pairs.size());
  if (inliers < options_.min_inliers) return PlaceRejection::few_inliers;
  if (inliers < options_.min_inlier_share * match.found) return PlaceRejection::inlier_share;
  if (static_cast<int>(match.cells.count()) < options_.min_cells) return PlaceRejection::concentrated;
  if (match.off_plane < options_.min_off_plane) return PlaceRejection::flat;
  if (match.seen_share < options_.min_seen_share) return PlaceRejection::not_seen;
  if (match.inverse_share < options_.min_inverse_share) return PlaceRejection::not_seen_there;
  if (match.contradictions > options_.max_contradictions) return PlaceRejection::contradicted;
  if (!certain(match.covariance)) return PlaceRejection::uncertain;
  if (hints.gravity_camera && hints.gravity_world) {
    const Vec3<double> turned = match.T_camera_world.rotation() * hints.gravity_world->normalized();
    const Vec3<double> known = hints.gravity_camera->normalized();
    if (std::atan2(turned.cross(known).norm(), turned.dot(known)) > options_.max_tilt * kDegree)
      return PlaceRejection::tilted;
  }
  if (hints.prior) {
    Mat6<double> covariance = hints.prior->covariance + match.covariance;
    const double rotation = options_.prior_rotation_floor * kDegree;
    covariance.diagonal().head<3>().array() += options_.prior_position_floor * options_.prior_position_floor;
    covariance.diagonal().tail<3>().array() += rotation * rotation;
    const Vec6<double> error = (match.T_camera_world * hints.prior->T_camera_world.inverse()).log();
    const double distance2 = error.dot(covariance.ldlt().solve(error));
    if (!(distance2 <= options_.max_prior_distance * options_.max_prior_distance))
      return PlaceRejection::far_from_prior;
  }
  return PlaceRejection::none;
}

}  // namespace sweepkit
