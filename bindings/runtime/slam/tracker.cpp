// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/slam/tracker.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <tuple>
#include <utility>

namespace sweepkit {
namespace {

constexpr double kDegree = std::numbers::pi / 180;
// If fewer of the points looked for are found, the prediction was probably wrong and not just the scene hard.
constexpr double kFoundShare = 0.35;
// A prediction this far outside the image still counts as inside [px].
constexpr double kViewMargin = 1.0;
// By how much the search widens when the first finds too little.
constexpr double kWiderSearch = 3;

bool inside(const StereoRig::Bounds& view, double u, double v) {
  return u > view.u_min - kViewMargin && u < view.u_max + kViewMargin && v > view.v_min - kViewMargin &&
         v < view.v_max + kViewMargin;
}

}  // namespace

Tracker::Tracker(const RectifiedCamera& camera, const StereoRig::Bounds& view, const ScaleLevels& levels,
                 const TrackerOptions& options, const SE3d& T_camera_world_start)
    : camera_(camera),
      view_(view),
      levels_(levels),
      options_(options),
      T_start_(T_camera_world_start),
      projection_(options.projection),
      brute_force_(options.brute_force) {}

void Tracker::set_local_map(std::shared_ptr<const LocalMap> map) {
  map_ = std::move(map);
  for (Measurement& m : last_.measurements) m.shift_disparity(map_->disparity_bias - last_.disparity_bias);
  last_.disparity_bias = map_->disparity_bias;
  if (map_->newest_t == last_.t) {  // the last frame has become this keyframe
    last_.points = map_->newest_points;
    last_.reference = map_->newest;
    last_.T_camera_reference = SE3d();
  }
  if (const SE3d* T_reference_world = map_->find(last_.reference))
    last_.T_camera_world = last_.T_camera_reference * *T_reference_world;
}

TrackResult Tracker::track(StereoFrame& frame, const MotionPrior* prior) {
  frame.points.assign(frame.measurements.size(), PointId{});
  prior_ = prior;
  if (!map_) return start(frame);

  const SE3d T_predicted = prior ? prior->T_camera_world : *predict(frame.t);
  collect_last_points();
  PoseResult pose = find_pose(frame, T_predicted);
  TrackResult result;
  if (pose.usable()) {
    pose = refine_by_local_map(frame, pose);
    for (const PointId point : frame.points) result.points += point.valid();
  }
  if (!pose.usable() || pose.inliers < needed_points()) {
    prior_ = prior;
    return lose(frame);
  }

  frame.T_camera_world = pose.T_camera_world;
  frame.covariance = pose.covariance;
  std::tie(frame.reference, frame.T_camera_reference) = refer(frame.T_camera_world);
  result.state = TrackingState::tracking;
  result.wants_keyframe =
      frame.reference.valid() && options_.keyframe.wants_keyframe(situation(frame, result.points));
  keep_as_last(frame);
  return result;
}

TrackResult Tracker::start(StereoFrame& frame) {
  frame.T_camera_world = prior_ ? prior_->T_camera_world : T_start_;
  if (prior_) frame.covariance = prior_->covariance;
  if (count_certain(frame) < options_.min_start_points) return {};
  // Until the mapper has made a copy, frames are tracked against the one before.
  map_ = std::make_shared<LocalMap>();
  keep_as_last(frame);
  return {.state = TrackingState::tracking, .wants_keyframe = true, .starts_map = true};
}

bool Tracker::begin_map(StereoFrame& frame) {
  if (count_certain(frame) < options_.min_start_points) return false;
  // As at the start: until the mapper has made a copy, frames are tracked against the one before.
  map_ = std::make_shared<LocalMap>();
  std::fill(frame.points.begin(), frame.points.end(), PointId{});
  frame.reference = KeyframeId{};
  frame.T_camera_reference = SE3d();
  keep_as_last(frame);
  return true;
}

TrackResult Tracker::lose(StereoFrame& frame) {
  ++lost_frames_;
  std::fill(frame.points.begin(), frame.points.end(), PointId{});
  frame.T_camera_world = prior_ ? prior_->T_camera_world : last_.T_camera_world;
  if (prior_) frame.covariance = prior_->covariance;
  std::tie(frame.reference, frame.T_camera_reference) = refer(frame.T_camera_world);
  TrackResult result{.state = TrackingState::lost};
  if ((prior_ || lost_frames_ >= options_.restart_after) &&
      count_certain(frame) >= options_.min_start_points) {
    result.wants_keyframe = result.starts_map = true;
    keep_as_last(frame);
  } else if (prior_ && frame.reference.valid()) {
    result.wants_keyframe = result.blind = options_.blind_keyframe.wants_keyframe(situation(frame, 0));
  }
  velocity_.setZero();
  return result;
}

std::pair<KeyframeId, SE3d> Tracker::refer(const SE3d& T_camera_world) const {
  const SE3d* T_reference_world = map_ ? map_->find(map_->newest) : nullptr;
  if (!T_reference_world) return {};
  return {map_->newest, T_camera_world * T_reference_world->inverse()};
}

void Tracker::keep_as_last(const StereoFrame& frame) {
  if (last_.t != 0 && frame.t > last_.t)
    velocity_ = (frame.T_camera_world * last_.T_camera_world.inverse()).log() / to_seconds(frame.t - last_.t);
  last_ = frame;
  lost_frames_ = 0;
}

std::optional<SE3d> Tracker::predict(TimeNs t) const {
  if (!map_) return std::nullopt;
  return SE3d::exp(velocity_ * to_seconds(t - last_.t)) * last_.T_camera_world;
}

bool Tracker::certain(const Measurement& m) const {
  return m.stereo() && m.sigma_right < options_.max_depth_uncertainty * m.disparity();
}

int Tracker::count_certain(const StereoFrame& frame) const {
  return static_cast<int>(std::count_if(frame.measurements.begin(), frame.measurements.end(),
                                        [&](auto& m) { return certain(m); }));
}

void Tracker::collect_last_points() {
  last_targets_.clear();
  last_index_.clear();
  const SE3d T_world_camera = last_.T_camera_world.inverse();
  for (std::uint32_t i = 0; i < last_.measurements.size(); ++i) {
    const Measurement& m = last_.measurements[i];
    if (const LocalPoint* point = last_.points[i].valid() ? map_->find(last_.points[i]) : nullptr) {
      last_targets_.push_back({point->p_world, point->spread, point->id});
    } else if (certain(m)) {
      const double depth = camera_.depth(m.disparity());
      const Vec3<double> p_camera =
          depth * Vec3<double>((m.u - camera_.cx) / camera_.focal, (m.v - camera_.cy) / camera_.focal, 1);
      const Vec3<double> spread = T_world_camera.rotation() * (p_camera * (m.sigma_right / m.disparity()));
      last_targets_.push_back({T_world_camera * p_camera, spread.cast<float>(), PointId{}});
    } else {
      continue;
    }
    last_index_.push_back(i);
  }
}

PoseResult Tracker::find_pose(const StereoFrame& frame, const SE3d& T_predicted) {
  PoseResult pose;
  const int needed = prior_ ? needed_points() : std::max(options_.min_points, 20);
  double radius = options_.search_radius;
  for (int attempt = 0; attempt < 2; ++attempt, radius *= kWiderSearch) {
    const int searched = match_last_frame(frame, T_predicted, radius);
    pose = solve(frame, T_predicted);
    // Once lost, a prediction without odometry is not to be trusted even where it seems to hold.
    if ((prior_ || lost_frames_ == 0) && pose.usable() && pose.inliers >= needed &&
        pose.inliers > kFoundShare * searched)
      return pose;
  }
  const std::optional<SE3d> T_found = find_without_prior(frame);
  if (!T_found) return pose;
  // Odometry is not believed against what most of a picture says: wheels slip.
  const MotionPrior* believed = std::exchange(prior_, nullptr);
  const std::vector<Target> by_projection = matched_;
  const std::vector<std::uint8_t> taken = taken_;
  const std::vector<std::uint32_t> observed = observed_;
  const std::vector<std::uint8_t> inlier = inlier_;
  const int searched = match_last_frame(frame, *T_found, options_.search_radius);
  const PoseResult other = solve(frame, *T_found);
  const bool better = believed
                          ? other.inliers >= std::max({options_.min_points, 2 * pose.inliers, searched / 2})
                          : !pose.usable() || other.inliers > pose.inliers;
  if (other.usable() && better) return other;
  prior_ = believed;
  matched_ = by_projection;
  taken_ = taken;
  observed_ = observed;
  inlier_ = inlier;
  return pose;
}

int Tracker::match_last_frame(const StereoFrame& frame, const SE3d& T_camera_world, double radius) {
  begin_queries();
  for (std::size_t k = 0; k < last_targets_.size(); ++k) {
    const Measurement& m = last_.measurements[last_index_[k]];
    const auto uvr = camera_.project_stereo(T_camera_world * last_targets_[k].p_world);
    if (!uvr || !inside(view_, uvr->x(), uvr->y())) continue;
    targets_.push_back(last_targets_[k]);
    queries_.push_back({.u = static_cast<float>(uvr->x()),
                        .v = static_cast<float>(uvr->y()),
                        .u_right = static_cast<float>(uvr->z()),
                        .radius = static_cast<float>(radius * levels_.scale(m.octave)),
                        .min_octave = m.octave - 1,
                        .max_octave = m.octave + 1,
                        .angle = m.angle});
    query_descriptors_.push_back(last_.descriptors[last_index_[k]]);
  }
  matched_.assign(frame.measurements.size(), Target{});
  taken_.assign(frame.measurements.size(), 0);
  run_queries(frame);
  return static_cast<int>(queries_.size());
}

void Tracker::begin_queries() {
  targets_.clear();
  queries_.clear();
  query_descriptors_.clear();
}

void Tracker::run_queries(const StereoFrame& frame) {
  matches_.resize(queries_.size());
  projection_.match(queries_, query_descriptors_, frame.grid,
                    std::span<const Measurement>(frame.measurements), frame.descriptors, matches_, taken_);
  for (std::size_t k = 0; k < matches_.size(); ++k)
    if (matches_[k].found()) take(matches_[k].index, targets_[k]);
}

void Tracker::take(std::int32_t measurement, const Target& target) {
  matched_[static_cast<std::size_t>(measurement)] = target;
  taken_[static_cast<std::size_t>(measurement)] = 1;
}

PoseResult Tracker::solve(const StereoFrame& frame, const SE3d& T_start) {
  observations_.clear();
  observed_.clear();
  for (std::uint32_t i = 0; i < taken_.size(); ++i) {
    if (!taken_[i]) continue;
    const Measurement& m = frame.measurements[i];
    observations_.push_back({.p_world = matched_[i].p_world,
                             .u = m.u,
                             .v = m.v,
                             .u_right = m.u_right,
                             .sigma = m.sigma,
                             .sigma_disparity = m.sigma_right,
                             .p_world_spread = matched_[i].spread});
    observed_.push_back(i);
  }
  // Noisier eyes are the same as a firmer prior, but for the scale of the covariance.
  const double scale = options_.vision_noise * options_.vision_noise;
  PosePrior prior;
  if (prior_) prior = {prior_->T_camera_world, scale * prior_->covariance.inverse()};
  PoseResult result = solve_pose(camera_, T_start, observations_, options_.pose, inlier_,
                                 prior_ ? &prior : nullptr, &workspace_);
  if (result.usable()) result.covariance *= scale;
  return result;
}

std::optional<SE3d> Tracker::find_without_prior(const StereoFrame& frame) {
  // Descriptors of the last frame's points against all of this one, then a pose that many of the matches
  // agree on.
  query_descriptors_.clear();
  for (const std::uint32_t i : last_index_) query_descriptors_.push_back(last_.descriptors[i]);
  brute_force_.match(query_descriptors_, frame.descriptors, matches_);
  std::vector<Vec3<double>> points;
  std::vector<Vec2<double>> rays;
  std::vector<double> right_x, sigmas;
  for (std::size_t k = 0; k < matches_.size(); ++k) {
    if (!matches_[k].found()) continue;
    const Measurement& m = frame.measurements[static_cast<std::size_t>(matches_[k].index)];
    points.push_back(last_targets_[k].p_world);
    rays.emplace_back((m.u - camera_.cx) / camera_.focal, (m.v - camera_.cy) / camera_.focal);
    right_x.push_back(m.stereo() ? (m.u_right - camera_.cx) / camera_.focal : std::nan(""));
    sigmas.push_back(m.sigma);
  }
  const auto found = solve_pnp({.points = points,
                                .rays = rays,
                                .right_x = right_x,
                                .sigmas = sigmas,
                                .focal = camera_.focal,
                                .baseline = camera_.baseline},
                               options_.pnp);
  if (!found) return std::nullopt;
  return found->T_world_camera.inverse();
}

PoseResult Tracker::refine_by_local_map(StereoFrame& frame, const PoseResult& coarse) {
  // Outliers of the coarse pose are free again.
  std::vector<PointId>& found = found_points_;
  found.clear();
  for (std::size_t k = 0; k < observed_.size(); ++k) {
    if (!inlier_[k])
      taken_[observed_[k]] = 0;
    else if (matched_[observed_[k]].point.valid())
      found.push_back(matched_[observed_[k]].point);
  }
  std::sort(found.begin(), found.end());

  begin_queries();
  const SE3d& T_camera_world = coarse.T_camera_world;
  const Vec3<double> center = T_camera_world.inverse().translation();
  const double min_cosine = std::cos(options_.view_angle * kDegree);
  predicted_points_ = found;
  for (const LocalPoint& point : map_->points) {
    const Vec3<double> p_camera = T_camera_world * point.p_world;
    const auto uvr = camera_.project_stereo(p_camera);
    if (!uvr || !inside(view_, uvr->x(), uvr->y())) continue;
    const Vec3<double> to_camera = center - point.p_world;
    const double distance = to_camera.norm();
    if (distance < 0.8 * point.min_distance || distance > 1.2 * point.max_distance) continue;
    const double cosine = to_camera.dot(point.normal.cast<double>()) / distance;
    if (cosine < min_cosine) continue;
    if (std::binary_search(found.begin(), found.end(), point.id)) continue;
    predicted_points_.push_back(point.id);
    const int octave = levels_.octave(point.max_distance, distance);
    targets_.push_back({point.p_world, point.spread, point.id});
    queries_.push_back({.u = static_cast<float>(uvr->x()),
                        .v = static_cast<float>(uvr->y()),
                        .u_right = static_cast<float>(uvr->z()),
                        .radius = static_cast<float>(options_.map_search_radius * levels_.scale(octave)),
                        .min_octave = octave - 1,
                        .max_octave = octave + 1});
    query_descriptors_.push_back(point.descriptor);
  }
  run_queries(frame);
  const PoseResult pose = solve(frame, T_camera_world);
  if (!pose.usable()) return pose;

  for (std::size_t k = 0; k < observed_.size(); ++k)
    if (inlier_[k]) frame.points[observed_[k]] = matched_[observed_[k]].point;
  for (const PointId point : predicted_points_) counts_.push_back({point, 1, 0});
  for (const PointId point : frame.points)
    if (point.valid()) counts_.push_back({point, 0, 1});
  return pose;
}

KeyframeSituation Tracker::situation(const StereoFrame& frame, int tracked_points) const {
  KeyframeSituation s;
  s.tracked_points = tracked_points;
  s.reference_points = map_->reference_points;
  for (std::size_t i = 0; i < frame.measurements.size(); ++i)
    if (certain(frame.measurements[i])) ++(frame.points[i].valid() ? s.near_tracked : s.near_untracked);
  s.distance = frame.T_camera_reference.translation().norm();
  s.angle = frame.T_camera_reference.rotation().angle();
  s.seconds = to_seconds(frame.t - map_->newest_t);
  return s;
}

std::vector<PointCount> Tracker::take_counts() {
  std::vector<PointCount> counts;
  std::sort(counts_.begin(), counts_.end(), [](const auto& a, const auto& b) { return a.point < b.point; });
  for (const PointCount& count : counts_) {
    if (counts.empty() || counts.back().point != count.point) {
      counts.push_back(count);
    } else {
      counts.back().predicted += count.predicted;
      counts.back().found += count.found;
    }
  }
  counts_.clear();
  return counts;
}

}  // namespace sweepkit
