// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
// How LocalMapper moves its keyframes and points: bundle adjustment around a keyframe and of a whole map, and
// places known again.
#include <algorithm>
#include <cmath>
#include <utility>

#include "sweepkit/slam/local_mapper.hpp"

namespace sweepkit {
namespace {

// How much less than its own observations say a window knows of the disparities' bias, beside the overlap.
constexpr double kBiasRepeats = 4;
// How far the bias may wander from keyframe to keyframe: cameras warm up [px].
constexpr double kBiasWalk = 0.002;

}  // namespace

// What wheels get wrong of a distance they get wrong alike in all edges of a window, which count as
// independent. Stereo knows the scale: between keyframes that see, wheels shall not tell it.
Mat6<double> LocalMapper::odometry_covariance(KeyframeId id) const {
  const Keyframe& keyframe = map_.keyframe(id);
  Mat6<double> covariance = keyframe.odometry->motion.covariance;
  const auto sees = [&](const Keyframe& k) {
    return std::count_if(k.points.begin(), k.points.end(), [](PointId p) { return p.valid(); }) >=
           options_.scale_points;
  };
  if (!sees(keyframe) || !sees(map_.keyframe(keyframe.odometry->from))) return covariance;
  const SE3d& T = keyframe.odometry->motion.T;
  const Vec3<double> way = options_.odometry_scale_sigma * (T.rotation().inverse() * T.translation());
  covariance.topLeftCorner<3, 3>() += way * way.transpose();
  return covariance;
}

std::vector<KeyframeId> LocalMapper::adjustment_window(KeyframeId id) const {
  std::vector<KeyframeId> window{id};
  for (const Covisible& c : map_.best_covisible(id, static_cast<std::size_t>(options_.window - 1)))
    window.push_back(c.keyframe);
  std::sort(window.begin(), window.end());
  // A blind stretch before one of them hangs on both its ends.
  for (std::size_t i = 0; i < window.size(); ++i) {
    const auto& edge = map_.keyframe(window[i]).odometry;
    if (edge && map_.keyframe(edge->from).blind() &&
        std::find(window.begin(), window.end(), edge->from) == window.end())
      window.push_back(edge->from);
  }
  std::sort(window.begin(), window.end());
  return window;
}

std::vector<KeyframeId> LocalMapper::fixed_around(const std::vector<KeyframeId>& window) const {
  std::vector<int> shared(map_.keyframe_id_end(), 0);
  for (const PointId point : points_of(window))
    for (const Observation& o : map_.point(point).observations)
      if (!std::binary_search(window.begin(), window.end(), o.keyframe)) ++shared[o.keyframe.value];
  std::vector<Covisible> others;
  for (std::uint32_t i = 0; i < shared.size(); ++i)
    if (shared[i] > 0) others.push_back({KeyframeId{i}, shared[i]});
  std::stable_sort(others.begin(), others.end(), [](auto& a, auto& b) { return a.points > b.points; });
  if (others.size() > static_cast<std::size_t>(options_.fixed_window))
    others.resize(static_cast<std::size_t>(options_.fixed_window));
  std::vector<KeyframeId> fixed;
  fixed.reserve(others.size() + window.size());
  for (const Covisible& o : others) fixed.push_back(o.keyframe);
  for (const KeyframeId keyframe : window)
    if (const auto& edge = map_.keyframe(keyframe).odometry)
      if (!std::binary_search(window.begin(), window.end(), edge->from) &&
          std::find(fixed.begin(), fixed.end(), edge->from) == fixed.end())
        fixed.push_back(edge->from);
  return fixed;
}

std::vector<PointId> LocalMapper::points_of(const std::vector<KeyframeId>& keyframes) const {
  std::vector<PointId> points;
  for (const KeyframeId keyframe : keyframes)
    for (const PointId point : map_.keyframe(keyframe).points)
      if (point.valid() && map_.point(point).observations.size() >= 2) points.push_back(point);
  std::sort(points.begin(), points.end());
  points.erase(std::unique(points.begin(), points.end()), points.end());
  return points;
}

MapBundle LocalMapper::bundle_of(const std::vector<KeyframeId>& window, const std::vector<KeyframeId>& fixed,
                                 std::vector<PointId>&& points) const {
  MapBundle bundle;
  bundle.points = std::move(points);
  bundle.keyframes = window;
  bundle.keyframes.insert(bundle.keyframes.end(), fixed.begin(), fixed.end());
  BundleProblem& problem = bundle.problem;
  std::vector<int> pose_of(map_.keyframe_id_end(), -1);
  bool anchored = false;
  for (std::size_t i = 0; i < bundle.keyframes.size(); ++i) {
    const Keyframe& keyframe = map_.keyframe(bundle.keyframes[i]);
    const bool hold = i >= window.size() || !keyframe.parent.valid();
    anchored |= hold;
    pose_of[keyframe.id.value] = static_cast<int>(i);
    problem.T_camera_world.push_back(keyframe.T_camera_world);
    problem.fixed.push_back(hold);
  }
  if (!anchored) problem.fixed.front() = 1;  // the oldest of the window
  for (std::size_t i = 0; i < bundle.keyframes.size(); ++i)
    if (const auto& edge = map_.keyframe(bundle.keyframes[i]).odometry;
        edge && pose_of[edge->from.value] >= 0)
      problem.relative_poses.push_back({.a = pose_of[edge->from.value],
                                        .b = static_cast<int>(i),
                                        .T_a_b = edge->motion.T,
                                        .information = odometry_covariance(bundle.keyframes[i]).inverse()});
  for (std::size_t p = 0; p < bundle.points.size(); ++p) {
    const MapPoint& point = map_.point(bundle.points[p]);
    problem.points.push_back(point.p_world);
    for (const Observation& o : point.observations) {
      const int pose = pose_of[o.keyframe.value];
      if (pose < 0) continue;
      const Measurement& m = map_.keyframe(o.keyframe).measurements[o.index];
      problem.observations.push_back({.pose = pose,
                                      .point = static_cast<int>(p),
                                      .u = m.u,
                                      .v = m.v,
                                      .u_right = m.u_right,
                                      .sigma = m.sigma,
                                      .sigma_disparity = m.sigma_right});
      bundle.observed.emplace_back(point.id, o.keyframe);
    }
  }
  return bundle;
}

void LocalMapper::drop_outliers(const MapBundle& bundle) {
  for (std::size_t i = 0; i < bundle.observed.size(); ++i)
    if (const auto& [point, keyframe] = bundle.observed[i]; bundle.result.outlier[i] && map_.find(point))
      map_.remove_observation(point, keyframe);
}

// Variable poses, the points they see, and the other keyframes that see these points, which stay fixed.
void LocalMapper::adjust(KeyframeId id, const std::atomic<bool>* stop) {
  const std::vector<KeyframeId> window = adjustment_window(id);
  MapBundle bundle = bundle_of(window, fixed_around(window), points_of(window));
  BundleProblem& problem = bundle.problem;
  if (std::all_of(problem.fixed.begin(), problem.fixed.end(), [](auto f) { return f != 0; })) return;
  // What a window says of the bias, the next ones say again, and its errors go together: it counts for less.
  if (options_.disparity_bias_sigma > 0)
    problem.disparity_bias_sigma = std::sqrt(disparity_bias_variance_ / (kBiasRepeats * options_.window));
  bundle.result = solve_bundle(camera_, problem, options_.bundle, stop);
  for (std::size_t i = 0; i < window.size(); ++i)
    if (!problem.fixed[i]) map_.set_pose(window[i], problem.T_camera_world[i]);
  for (std::size_t p = 0; p < bundle.points.size(); ++p)
    map_.set_position(bundle.points[p], problem.points[p]);
  drop_outliers(bundle);
  for (const PointId point : bundle.points)
    if (map_.find(point)) refresh_appearance(point);
  disparity_bias_ += problem.disparity_bias;
  disparity_bias_variance_ = 1 / (1 / disparity_bias_variance_ + bundle.result.disparity_bias_information /
                                                                     (kBiasRepeats * options_.window)) +
                             kBiasWalk * kBiasWalk;
  map_.shift_disparities(problem.disparity_bias);
}

GlobalAdjustment LocalMapper::begin_global_adjustment() const {
  GlobalAdjustment global;
  global.corrections = corrections_;
  std::vector<KeyframeId> keyframes;
  for (std::uint32_t i = 0; i < map_.keyframe_id_end(); ++i)
    if (const Keyframe* keyframe = map_.find(KeyframeId{i}); keyframe && keyframe->map == current_)
      keyframes.push_back(keyframe->id);
  if (!keyframes.empty()) global.t = map_.keyframe(keyframes.back()).t;
  global.bundle = bundle_of(keyframes, {}, choose_points(map_, keyframes, view_, options_.global_points));
  // All keyframes together know the bias better than the windows did one after the other.
  global.bundle.problem.disparity_bias_sigma = options_.disparity_bias_sigma;
  global.disparity_bias = disparity_bias_;
  return global;
}

std::shared_ptr<const LocalMap> LocalMapper::finish_global_adjustment(const GlobalAdjustment& global) {
  if (!global.solved || global.corrections != corrections_ || !current_.valid()) return nullptr;
  const MapBundle& bundle = global.bundle;
  std::vector<int> pose_of(map_.keyframe_id_end(), -1);
  for (std::size_t i = 0; i < bundle.keyframes.size(); ++i)
    pose_of[bundle.keyframes[i].value] = static_cast<int>(i);
  // Keyframes made meanwhile stay as they are to their parents.
  std::vector<KeyframeId> moved;
  std::vector<SE3d> T_world_camera;
  for (std::uint32_t i = 0; i < map_.keyframe_id_end(); ++i) {
    const Keyframe* keyframe = map_.find(KeyframeId{i});
    if (!keyframe || keyframe->map != current_) continue;
    const Keyframe* known = keyframe;
    while (known && pose_of[known->id.value] < 0)
      known = known->parent.valid() ? map_.find(known->parent) : nullptr;
    if (!known) continue;
    const SE3d T_keyframe_known = keyframe->T_camera_world * known->T_camera_world.inverse();
    const SE3d& T_known_world =
        bundle.problem.T_camera_world[static_cast<std::size_t>(pose_of[known->id.value])];
    moved.push_back(keyframe->id);
    T_world_camera.push_back((T_keyframe_known * T_known_world).inverse());
  }
  move_keyframes(map_, moved, T_world_camera);
  for (std::size_t p = 0; p < bundle.points.size(); ++p)
    if (map_.find(bundle.points[p])) map_.set_position(bundle.points[p], bundle.problem.points[p]);
  drop_outliers(bundle);
  // Windows may have moved the bias meanwhile.
  const double shift = global.disparity_bias + bundle.problem.disparity_bias - disparity_bias_;
  disparity_bias_ += shift;
  map_.shift_disparities(shift);
  ++corrections_;
  return copy_newest();
}

LoopCorrection LocalMapper::take_place(const PlaceMatch& match) {
  const LoopCorrection correction = correct_loop(map_, camera_, match, options_.loop);
  if (!correction.accepted) return correction;
  ++corrections_;
  if (match.query.value < map_.keyframe_id_end() && map_.keyframe(match.query).map != current_)
    current_ = map_.keyframe(match.query).map;
  T_now_begun_ = correction.T_new_old * T_now_begun_;
  fuse_place(match);
  adjust(match.query, nullptr);
  return correction;
}

// Both sides of the seam see what the other knows.
void LocalMapper::fuse_place(const PlaceMatch& match) {
  for (const PlacePair& pair : match.pairs) {
    const PointId theirs = map_.resolve(pair.point);
    const PointId own = map_.keyframe(match.query).points[pair.measurement];
    if (!theirs.valid() || own == theirs) continue;
    if (own.valid()) {
      const bool keep_own = map_.point(own).observations.size() > map_.point(theirs).observations.size();
      map_.merge_points(keep_own ? theirs : own, keep_own ? own : theirs);
    } else {
      map_.add_observation(theirs, match.query, pair.measurement);
    }
  }
  const auto around = [&](KeyframeId id) {
    std::vector<KeyframeId> group{id};
    for (const Covisible& c : map_.best_covisible(id, static_cast<std::size_t>(options_.fuse_keyframes)))
      group.push_back(c.keyframe);
    return group;
  };
  const std::vector<KeyframeId> here = around(match.query), there = around(match.candidate);
  const auto fuse_all = [&](const std::vector<KeyframeId>& from, const std::vector<KeyframeId>& into) {
    const std::vector<PointId> points = points_of(from);
    for (const KeyframeId id : into) fuse_into(id, points);
  };
  fuse_all(there, here);
  fuse_all(here, there);
}

}  // namespace sweepkit
