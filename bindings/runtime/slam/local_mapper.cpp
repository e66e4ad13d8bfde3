// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/slam/local_mapper.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

#include "sweepkit/core/error.hpp"
#include "sweepkit/geometry/triangulation.hpp"

namespace sweepkit {
namespace {

constexpr double kDegree = std::numbers::pi / 180;
// 95 % of chi-square with two and three degrees of freedom.
constexpr double kChi2Mono = 5.99;
constexpr double kChi2Stereo = 7.81;

// A map that begins where vision was lost without odometry may be anywhere nearby [m, rad].
constexpr double kUnmooredPosition = 1;
constexpr double kUnmooredAngle = 0.5;

Vec3<double> camera_center(const SE3d& T_camera_world) { return T_camera_world.inverse().translation(); }

/// The angle between the optical axes of two cameras [rad].
double angle_between_views(const SE3d& T_a_world, const SE3d& T_b_world) {
  const Vec3<double> axis_a = T_a_world.rotation().inverse() * Vec3<double>::UnitZ();
  const Vec3<double> axis_b = T_b_world.rotation().inverse() * Vec3<double>::UnitZ();
  return std::acos(std::clamp(axis_a.dot(axis_b), -1.0, 1.0));
}

template <class T>
void sort_unique(std::vector<T>& values) {
  std::sort(values.begin(), values.end());
  values.erase(std::unique(values.begin(), values.end()), values.end());
}

}  // namespace

LocalMapper::LocalMapper(const RectifiedCamera& camera, const StereoRig::Bounds& view,
                         const ScaleLevels& levels, const LocalMapperOptions& options)
    : camera_(camera),
      view_(view),
      levels_(levels),
      options_(options),
      disparity_bias_variance_(options.disparity_bias_sigma * options.disparity_bias_sigma),
      matcher_({.max_distance = options.fuse_distance, .ratio = 1}),
      triangulation_matcher_(options.triangulation) {}

void LocalMapper::resume(Map&& map, double disparity_bias, double disparity_bias_sigma) {
  require(map_.keyframe_id_end() == 0, "LocalMapper::resume", "comes before the first keyframe",
          map_.keyframe_id_end());
  map_ = std::move(map);
  disparity_bias_ = disparity_bias;
  if (disparity_bias_sigma > 0) disparity_bias_variance_ = disparity_bias_sigma * disparity_bias_sigma;
}

std::shared_ptr<const LocalMap> LocalMapper::process(KeyframeCandidate&& candidate,
                                                     const std::atomic<bool>* stop) {
  for (const PointCount& count : candidate.counts) {
    const PointId id = map_.resolve(count.point);
    if (id.valid()) map_.count_prediction(id, count.predicted, count.found);
  }
  const KeyframeId id = insert(std::move(candidate));
  cull_points(id);
  add_stereo_points(id);
  triangulate(id);
  fuse(id);
  adjust(id, stop);
  cull_keyframes(id);
  keep_caps(id);
#ifndef NDEBUG
  if (const auto broken = map_.broken_invariant())
    throw Error(ErrorKind::argument, "LocalMapper::process", *broken);
#endif
  return copy(id);
}

KeyframeId LocalMapper::insert(KeyframeCandidate&& candidate) {
  StereoFrame& frame = candidate.frame;
  const KeyframeId before_all = newest_before(KeyframeId{map_.keyframe_id_end()});
  if (candidate.begins_map || !current_.valid()) {
    current_ = map_.add_map();
    begun_ = candidate.begun;
    T_now_begun_ = SE3d();
    std::fill(frame.points.begin(), frame.points.end(), PointId{});
    frame.reference = KeyframeId{};
  }
  const bool first = map_.find(before_all) == nullptr || map_.keyframe(before_all).map != current_;

  // The parent is the keyframe that shares most of the tracked points.
  std::vector<KeyframeId> seers;
  for (PointId& point : frame.points) {
    point = map_.resolve(point);
    if (!point.valid()) continue;
    for (const Observation& o : map_.point(point).observations) seers.push_back(o.keyframe);
  }
  std::sort(seers.begin(), seers.end());
  KeyframeId parent;
  std::ptrdiff_t most = 0;
  for (auto it = seers.begin(); it != seers.end();) {
    const auto next = std::upper_bound(it, seers.end(), *it);
    if (next - it >= most) {
      most = next - it;
      parent = *it;
    }
    it = next;
  }
  if (!parent.valid() && map_.find(frame.reference)) parent = frame.reference;
  // Nothing ties it to the map but time: the newest keyframe.
  const KeyframeId before = first ? KeyframeId{} : before_all;
  if (!parent.valid()) parent = before;

  Keyframe keyframe;
  keyframe.map = current_;
  keyframe.t = frame.t;
  // What was tracked against a map that has moved since moves with its reference.
  keyframe.T_camera_world = frame.reference.valid() && map_.keyframe_id_end() > frame.reference.value
                                ? frame.T_camera_reference * map_.T_camera_world(frame.reference)
                                : frame.T_camera_world * T_now_begun_.inverse();
  keyframe.measurements = std::move(frame.measurements);
  for (Measurement& m : keyframe.measurements) m.shift_disparity(disparity_bias_ - frame.disparity_bias);
  keyframe.descriptors = std::move(frame.descriptors);
  keyframe.parent = parent;
  if (candidate.odometry && before.valid()) keyframe.odometry = {before, *candidate.odometry};
  // What was not seen hangs on the keyframe before by odometry; what was, on its parent by points.
  const bool tracked = most > 0 || !keyframe.odometry;
  // The first of another map came along from the keyframe before, whatever held for that.
  const bool moored = candidate.odometry && before_all.valid();
  if (first && candidate.begins_map && !moored) {
    keyframe.covariance.diagonal() << Vec3<double>::Constant(std::pow(kUnmooredPosition, 2)),
        Vec3<double>::Constant(std::pow(kUnmooredAngle, 2));
  } else if (const KeyframeId since = !first   ? (tracked ? parent : before)
                                      : moored ? before_all
                                               : KeyframeId{};
             since.valid()) {
    const Keyframe& from = map_.keyframe(since);
    const Mat6<double> Ad = (keyframe.T_camera_world * from.T_camera_world.inverse()).adjoint();
    keyframe.covariance =
        Ad * from.covariance * Ad.transpose() +
        (tracked ? options_.drift_factor * frame.covariance : keyframe.odometry->motion.covariance);
  }
  const KeyframeId id = map_.add_keyframe(std::move(keyframe));
  for (std::uint32_t i = 0; i < frame.points.size(); ++i)
    if (frame.points[i].valid() && map_.add_observation(frame.points[i], id, i))
      refresh_appearance(frame.points[i]);
  return id;
}

void LocalMapper::add_stereo_points(KeyframeId id) {
  const Keyframe& keyframe = map_.keyframe(id);
  const SE3d T_world_camera = keyframe.T_camera_world.inverse();
  for (std::uint32_t i = 0; i < keyframe.measurements.size(); ++i) {
    const Measurement& m = keyframe.measurements[i];
    if (keyframe.points[i].valid() || !m.stereo()) continue;
    if (m.sigma_right > options_.max_depth_uncertainty * m.disparity()) continue;
    const auto point = camera_.back_project(m.u, m.v, m.disparity(), m.sigma, m.sigma_right);
    if (!point) continue;
    const PointId added = map_.add_point(T_world_camera * point->p_camera, id, i);
    refresh_appearance(added);
    recent_points_.push_back(added);
  }
}

bool LocalMapper::agrees(const Measurement& m, const Vec3<double>& p_camera) const {
  const auto uvr = camera_.project_stereo(p_camera);
  if (!uvr) return false;
  double chi2 = (std::pow(uvr->x() - m.u, 2) + std::pow(uvr->y() - m.v, 2)) / (m.sigma * m.sigma);
  if (m.stereo()) chi2 += std::pow((uvr->x() - uvr->z() - m.disparity()) / m.sigma_right, 2);
  return chi2 <= (m.stereo() ? kChi2Stereo : kChi2Mono);
}

void LocalMapper::triangulate(KeyframeId id) {
  struct Free {
    std::vector<std::uint32_t> indices;
    std::vector<OrbDescriptor> descriptors;
  };
  const auto free_of = [](const Keyframe& keyframe) {
    Free free;
    for (std::uint32_t i = 0; i < keyframe.points.size(); ++i) {
      if (keyframe.points[i].valid()) continue;
      free.indices.push_back(i);
      free.descriptors.push_back(keyframe.descriptors[i]);
    }
    return free;
  };
  const auto bearing = [&](const Measurement& m) {
    return Vec3<double>((m.u - camera_.cx) / camera_.focal, (m.v - camera_.cy) / camera_.focal, 1)
        .normalized()
        .eval();
  };
  const Keyframe& a = map_.keyframe(id);
  for (const Covisible& neighbour :
       map_.best_covisible(id, static_cast<std::size_t>(options_.triangulate_keyframes))) {
    const Keyframe& b = map_.keyframe(neighbour.keyframe);
    const SE3d T_a_b = a.T_camera_world * b.T_camera_world.inverse();
    const Free free_a = free_of(a), free_b = free_of(b);
    triangulation_matcher_.match(free_a.descriptors, free_b.descriptors, matches_);
    for (std::size_t k = 0; k < matches_.size(); ++k) {
      if (!matches_[k].found()) continue;
      const std::uint32_t i = free_a.indices[k],
                          j = free_b.indices[static_cast<std::size_t>(matches_[k].index)];
      const Measurement &m_a = a.measurements[i], &m_b = b.measurements[j];
      const double sigma = std::max(m_a.sigma, m_b.sigma) / camera_.focal;
      const auto found = triangulate_inverse_depth(T_a_b, bearing(m_a), bearing(m_b), sigma);
      if (!found || !found->in_front || found->parallax < options_.min_parallax * kDegree) continue;
      if (!agrees(m_a, found->point) || !agrees(m_b, T_a_b.inverse() * found->point)) continue;
      const PointId added = map_.add_point(a.T_camera_world.inverse() * found->point, id, i);
      map_.add_observation(added, neighbour.keyframe, j);
      refresh_appearance(added);
      recent_points_.push_back(added);
    }
  }
}

void LocalMapper::fuse(KeyframeId id) {
  const auto neighbours = map_.best_covisible(id, static_cast<std::size_t>(options_.fuse_keyframes));
  // Own points into the neighbours, then theirs into the new keyframe.
  for (const Covisible& neighbour : neighbours) {
    std::vector<PointId> own;
    for (const PointId point : map_.keyframe(id).points)
      if (point.valid()) own.push_back(point);
    fuse_into(neighbour.keyframe, own);
  }
  std::vector<PointId> theirs;
  for (const Covisible& neighbour : neighbours)
    for (const PointId point : map_.keyframe(neighbour.keyframe).points)
      if (point.valid()) theirs.push_back(point);
  sort_unique(theirs);
  fuse_into(id, theirs);
}

void LocalMapper::fuse_into(KeyframeId target, const std::vector<PointId>& points) {
  const Keyframe& keyframe = map_.keyframe(target);
  const Vec3<double> center = camera_center(keyframe.T_camera_world);
  std::vector<PointId> asked;
  std::vector<ProjectionQuery> queries;
  std::vector<OrbDescriptor> descriptors;
  for (const PointId id : points) {
    const MapPoint* point = map_.find(id);
    if (!point || std::any_of(point->observations.begin(), point->observations.end(),
                              [&](const Observation& o) { return o.keyframe == target; }))
      continue;
    const auto uvr = camera_.project_stereo(keyframe.T_camera_world * point->p_world);
    if (!uvr || uvr->x() < view_.u_min || uvr->x() > view_.u_max || uvr->y() < view_.v_min ||
        uvr->y() > view_.v_max)
      continue;
    const Vec3<double> to_camera = center - point->p_world;
    const double distance = to_camera.norm();
    if (distance < 0.8 * point->min_distance || distance > 1.2 * point->max_distance) continue;
    if (to_camera.dot(point->normal.cast<double>()) < 0.5 * distance) continue;
    const int octave = levels_.octave(point->max_distance, distance);
    asked.push_back(id);
    queries.push_back({.u = static_cast<float>(uvr->x()),
                       .v = static_cast<float>(uvr->y()),
                       .u_right = static_cast<float>(uvr->z()),
                       .radius = static_cast<float>(options_.fuse_radius * levels_.scale(octave)),
                       .min_octave = octave - 1,
                       .max_octave = octave + 1});
    descriptors.push_back(point->descriptor);
  }
  grid_.build(keyframe.measurements);
  matches_.resize(queries.size());
  matcher_.match(queries, descriptors, grid_, std::span<const Measurement>(keyframe.measurements),
                 keyframe.descriptors, matches_);
  for (std::size_t k = 0; k < asked.size(); ++k) {
    if (!matches_[k].found()) continue;
    const auto index = static_cast<std::uint32_t>(matches_[k].index);
    if (!agrees(keyframe.measurements[index], keyframe.T_camera_world * map_.point(asked[k]).p_world))
      continue;
    const PointId other = keyframe.points[index];
    if (!other.valid()) {
      map_.add_observation(asked[k], target, index);
    } else if (other != asked[k]) {
      const bool keep_other =
          map_.point(other).observations.size() > map_.point(asked[k]).observations.size();
      map_.merge_points(keep_other ? asked[k] : other, keep_other ? other : asked[k]);
    }
    if (map_.find(asked[k]))
      refresh_appearance(asked[k]);
    else
      refresh_appearance(map_.resolve(asked[k]));
  }
}

void LocalMapper::cull_points(KeyframeId newest) {
  std::vector<PointId> still_recent;
  for (const PointId id : recent_points_) {
    const MapPoint* point = map_.find(id);
    if (!point) continue;
    const std::uint32_t age = newest.value - point->first_keyframe.value;
    const bool missed = point->found < options_.cull_found_ratio * point->predicted;
    const bool lonely = age >= 3 && point->observations.size() < 2;
    if (missed || lonely)
      map_.remove_point(id);
    else if (age < 4)
      still_recent.push_back(id);
  }
  recent_points_ = std::move(still_recent);
}

KeyframeId LocalMapper::newest_before(KeyframeId id) const {
  for (std::uint32_t i = id.value; i-- > 0;)
    if (map_.find(KeyframeId{i})) return KeyframeId{i};
  return {};
}

KeyframeId LocalMapper::last_seeing(KeyframeId id) const {
  while (map_.keyframe(id).blind() && map_.keyframe(id).odometry) id = map_.keyframe(id).odometry->from;
  return id;
}

void LocalMapper::cull_keyframes(KeyframeId newest) {
  const std::vector<Covisible> candidates = map_.keyframe(newest).covisible;
  for (const Covisible& candidate : candidates) {
    const Keyframe& keyframe = map_.keyframe(candidate.keyframe);
    if (!keyframe.parent.valid() || newest.value - keyframe.id.value < 3) continue;
    int seen = 0, redundant = 0;
    for (std::size_t i = 0; i < keyframe.points.size(); ++i) {
      if (!keyframe.points[i].valid()) continue;
      const MapPoint& point = map_.point(keyframe.points[i]);
      ++seen;
      int others = 0;
      for (const Observation& o : point.observations)
        others += o.keyframe != keyframe.id && map_.keyframe(o.keyframe).measurements[o.index].octave <=
                                                   keyframe.measurements[i].octave + 1;
      redundant += others >= options_.cull_observations;
    }
    if (seen == 0 || redundant > options_.cull_redundancy * seen) map_.remove_keyframe(candidate.keyframe);
  }
}

void LocalMapper::keep_caps(KeyframeId newest) {
  for (const KeyframeId id : choose_culls(map_, options_.caps, neighbourhood(newest)))
    map_.remove_keyframe(id);
}

void LocalMapper::refresh_appearance(PointId id) {
  const MapPoint& point = map_.point(id);
  // The medoid of the descriptors: the one with the least median distance to the others, in Hamming space.
  const auto descriptor_of = [&](const Observation& o) -> const OrbDescriptor& {
    return map_.keyframe(o.keyframe).descriptors[o.index];
  };
  const std::size_t count = point.observations.size();
  std::size_t best = 0;
  if (count > 2) {
    int least = 257;
    std::vector<int> distances(count);
    for (std::size_t i = 0; i < count; ++i) {
      for (std::size_t j = 0; j < count; ++j)
        distances[j] =
            hamming_distance(descriptor_of(point.observations[i]), descriptor_of(point.observations[j]));
      std::nth_element(distances.begin(), distances.begin() + static_cast<std::ptrdiff_t>(count / 2),
                       distances.end());
      if (distances[count / 2] < least) {
        least = distances[count / 2];
        best = i;
      }
    }
  } else {
    best = count - 1;  // the newest
  }
  Vec3<double> normal = Vec3<double>::Zero();
  for (const Observation& o : point.observations)
    normal += (camera_center(map_.keyframe(o.keyframe).T_camera_world) - point.p_world).normalized();
  const Observation& first = point.observations.front();
  const Keyframe& keyframe = map_.keyframe(first.keyframe);
  const double distance = (camera_center(keyframe.T_camera_world) - point.p_world).norm();
  const double max_distance = distance * levels_.scale(keyframe.measurements[first.index].octave);
  map_.set_appearance(id, descriptor_of(point.observations[best]), normal.normalized().cast<float>(),
                      static_cast<float>(max_distance / levels_.coarsest()),
                      static_cast<float>(max_distance));
}

std::vector<KeyframeId> LocalMapper::neighbourhood(KeyframeId id) const {
  const auto limit = static_cast<std::size_t>(options_.local_keyframes);
  std::vector<KeyframeId> chosen{id};
  std::vector<bool> taken(map_.keyframe_id_end(), false);
  taken[id.value] = true;
  const auto take = [&](KeyframeId keyframe) {
    if (chosen.size() >= limit || taken[keyframe.value]) return;
    taken[keyframe.value] = true;
    chosen.push_back(keyframe);
  };
  // Of a blind one, what its last predecessor that saw had around it.
  const KeyframeId seeing = last_seeing(id);
  take(seeing);
  const auto nearest = map_.best_covisible(seeing, limit);
  for (const Covisible& c : nearest) take(c.keyframe);
  // Places seen long ago, where the robot looks at them again.
  const Keyframe& keyframe = map_.keyframe(id);
  const Vec3<double> here = camera_center(keyframe.T_camera_world);
  std::vector<std::pair<double, KeyframeId>> revisited;
  for (std::uint32_t i = 0; i < map_.keyframe_id_end(); ++i) {
    const Keyframe* other = map_.find(KeyframeId{i});
    if (!other || taken[i] || other->map != keyframe.map) continue;
    const double distance = (camera_center(other->T_camera_world) - here).norm();
    if (distance <= options_.revisit_distance &&
        angle_between_views(other->T_camera_world, keyframe.T_camera_world) <=
            options_.revisit_angle * kDegree)
      revisited.emplace_back(distance, other->id);
  }
  std::sort(revisited.begin(), revisited.end());
  for (const auto& [distance, other] : revisited) take(other);
  return chosen;
}

Vec3<float> LocalMapper::spread(const MapPoint& point) const {
  // Depth is what a stereo point is uncertain of; further views average it down.
  const Observation& o = point.observations.front();
  const Keyframe& keyframe = map_.keyframe(o.keyframe);
  const Measurement& m = keyframe.measurements[o.index];
  if (!m.stereo()) return Vec3<float>::Zero();
  const Vec3<double> ray = point.p_world - camera_center(keyframe.T_camera_world);
  const double share =
      m.sigma_right / m.disparity() / std::sqrt(static_cast<double>(point.observations.size()));
  return (share * ray).cast<float>();
}

std::shared_ptr<const LocalMap> LocalMapper::copy_newest() const {
  const KeyframeId newest = newest_before(KeyframeId{map_.keyframe_id_end()});
  return newest.valid() && map_.keyframe(newest).map == current_ ? copy(newest) : nullptr;
}

std::shared_ptr<const LocalMap> LocalMapper::copy(KeyframeId newest) const {
  const Keyframe& keyframe = map_.keyframe(newest);
  auto local = std::make_shared<LocalMap>();
  local->begun = begun_;
  local->corrections = corrections_;
  local->newest = newest;
  local->newest_t = keyframe.t;
  local->newest_points = keyframe.points;
  local->anchor = last_seeing(newest);
  local->anchor_covariance = map_.keyframe(local->anchor).covariance;
  local->disparity_bias = disparity_bias_;
  std::vector<KeyframeId> keyframes = neighbourhood(newest);
  std::sort(keyframes.begin(), keyframes.end());
  std::vector<PointId> ids;
  for (const KeyframeId id : keyframes) {
    const Keyframe& near = map_.keyframe(id);
    local->keyframes.emplace_back(id, near.T_camera_world);
    for (const PointId point : near.points)
      if (point.valid()) ids.push_back(point);
  }
  sort_unique(ids);
  local->points.reserve(ids.size());
  for (const PointId id : ids) {
    const MapPoint& point = map_.point(id);
    local->points.push_back({.id = id,
                             .p_world = point.p_world,
                             .normal = point.normal,
                             .min_distance = point.min_distance,
                             .max_distance = point.max_distance,
                             .spread = spread(point),
                             .descriptor = point.descriptor,
                             .observations = static_cast<int>(point.observations.size())});
  }
  for (const PointId point : keyframe.points)
    if (point.valid()) local->reference_points += map_.point(point).observations.size() >= 2;
  return local;
}

}  // namespace sweepkit
