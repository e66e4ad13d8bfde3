// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/slam/place_verification.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <tuple>

#include "pooled_pose.hpp"
#include "sweepkit/geometry/impl/pnp.hpp"
#include "sweepkit/geometry/ransac.hpp"
#include "sweepkit/geometry/upright_p2p.hpp"

namespace sweepkit {
namespace {

constexpr double kDegree = std::numbers::pi / 180;
constexpr int kColumns = 8, kRows = 5;  // cells of the image

// Two points and gravity instead of three points; the rest as without gravity.
class UprightPnpEstimator : public impl::PnpEstimator<PnpMatches> {
 public:
  static constexpr int kSampleSize = 2;
  static constexpr int kMaxModels = 2;

  UprightPnpEstimator(const PnpMatches& matches, const PnpOptions& options, const Vec3<double>& down_world,
                      const Vec3<double>& down_camera)
      : PnpEstimator(matches, options.threshold, options.huber_width),
        matches_(matches),
        down_world_(down_world),
        down_camera_(down_camera) {}

  int solve(std::span<const int, 2> sample, std::span<impl::PnpPose, 2> models) const {
    std::array<Vec3<double>, 2> points;
    std::array<Vec2<double>, 2> rays;
    for (std::size_t k = 0; k < 2; ++k) {
      points[k] = matches_.points[static_cast<std::size_t>(sample[k])];
      rays[k] = matches_.rays[static_cast<std::size_t>(sample[k])];
    }
    std::array<SE3d, 2> poses;
    const int count = solve_upright_p2p(points, rays, down_world_, down_camera_, poses);
    for (std::size_t k = 0; k < static_cast<std::size_t>(count); ++k)
      models[k] = {poses[k].rotation().matrix(), poses[k].translation()};
    return count;
  }

 private:
  const PnpMatches& matches_;
  Vec3<double> down_world_, down_camera_;
};

bool inside(const StereoRig::Bounds& view, double u, double v) {
  return u >= view.u_min && u <= view.u_max && v >= view.v_min && v <= view.v_max;
}

}  // namespace

PlaceVerifier::PlaceVerifier(const RectifiedCamera& camera, const StereoRig::Bounds& view,
                             const ScaleLevels& levels, const PlaceVerifierOptions& options)
    : camera_(camera), view_(view), levels_(levels), options_(options), projection_(options.projection) {
  check_options(options_);
}

PlaceCheck PlaceVerifier::verify(const PlaceImage& image, const Map& map, const PlaceDatabase& database,
                                 KeyframeId candidate, const PlaceHints& hints) {
  PlaceCheck check;
  check.match.query = image.keyframe;
  check.match.candidate = candidate;
  check.match.map = map.keyframe(candidate).map;
  collect_group(map, candidate, image);
  match_descriptors(image, map, database);
  const auto matches = static_cast<int>(descriptor_matches_.size());
  check.match.matches = matches;
  if (matches < options_.min_matches) return check;
  const std::optional<SE3d> T_camera_world = coarse_pose(image, map, hints);
  check.rejection = PlaceRejection::no_pose;
  if (!T_camera_world) return check;
  examine(image, map, *T_camera_world, hints, check);
  return check;
}

PlaceCheck PlaceVerifier::verify_at(const PlaceImage& image, const Map& map, KeyframeId candidate,
                                    const SE3d& T_camera_world, const PlaceHints& hints) {
  PlaceCheck check;
  check.match.query = image.keyframe;
  check.match.candidate = candidate;
  check.match.map = map.keyframe(candidate).map;
  collect_group(map, candidate, image);
  examine(image, map, T_camera_world, hints, check);
  return check;
}

PooledMatch PlaceVerifier::pooled_match(std::size_t view, const Measurement& m,
                                        const Vec3<double>& p_world) const {
  PooledMatch match;
  match.view = view;
  match.p_world = p_world;
  match.ray = {(m.u - camera_.cx) / camera_.focal, (m.v - camera_.cy) / camera_.focal};
  if (m.stereo()) match.right_x = (m.u_right - camera_.cx) / camera_.focal;
  match.sigma = m.sigma;
  match.sigma_disparity = m.sigma_right;
  return match;
}

SE3d PlaceVerifier::refine_together(std::span<const PlaceView> views,
                                    std::span<const std::vector<PlacePair>> pairs, const Map& map,
                                    const SE3d& T_first_world) const {
  std::vector<PooledMatch> pooled;
  std::vector<SE3d> T_view_first;
  for (std::size_t v = 0; v < views.size(); ++v) {
    T_view_first.push_back(views[v].T_view_first);
    for (const PlacePair& pair : pairs[v])
      pooled.push_back(
          pooled_match(v, views[v].image->measurements[pair.measurement], map.point(pair.point).p_world));
  }
  return refine_pooled_pose(
      pooled, {.T_view_first = T_view_first, .focal = camera_.focal, .baseline = camera_.baseline},
      T_first_world, options_.pooled);
}

std::optional<PlaceProposal> PlaceVerifier::propose(std::span<const PlaceView> views, const Map& map,
                                                    const PlaceDatabase& database, KeyframeId candidate,
                                                    const Vec3<double>& gravity_first,
                                                    const Vec3<double>& gravity_world) {
  std::vector<PooledMatch> pooled;
  std::vector<SE3d> T_view_first;
  if (views.empty()) return std::nullopt;
  collect_group(map, candidate, *views.front().image);
  for (const PlaceView& view : views) {
    match_descriptors(*view.image, map, database);
    for (const DescriptorMatch& match : descriptor_matches_) {
      pooled.push_back(pooled_match(T_view_first.size(), view.image->measurements[match.measurement],
                                    map.point(match.point).p_world));
    }
    T_view_first.push_back(view.T_view_first);
  }
  const auto found = solve_pooled_pose(pooled,
                                       {.T_view_first = T_view_first,
                                        .gravity_first = gravity_first.normalized(),
                                        .gravity_world = gravity_world.normalized(),
                                        .focal = camera_.focal,
                                        .baseline = camera_.baseline},
                                       options_.pooled);
  if (!found) return std::nullopt;
  return PlaceProposal{found->T_first_world, static_cast<int>(pooled.size()), found->inliers};
}

void PlaceVerifier::collect_group(const Map& map, KeyframeId candidate, const PlaceImage& image) {
  group_.assign(1, candidate);
  for (const Covisible& c : map.best_covisible(candidate, static_cast<std::size_t>(options_.group_keyframes)))
    if (c.keyframe != image.keyframe && group_.size() < static_cast<std::size_t>(options_.group_keyframes))
      group_.push_back(c.keyframe);
  std::vector<PointId> ids;
  for (const KeyframeId id : group_)
    for (const PointId point : map.keyframe(id).points)
      if (point.valid()) ids.push_back(point);
  std::sort(ids.begin(), ids.end());
  ids.erase(std::unique(ids.begin(), ids.end()), ids.end());
  pool_.clear();
  for (const PointId id : ids) {
    const MapPoint& point = map.point(id);
    const Observation* first = nullptr;
    bool own = false;
    for (const Observation& o : point.observations) {
      own = own || (image.keyframe.valid() && o.keyframe == image.keyframe);
      if (!first && map.keyframe(o.keyframe).measurements[o.index].stereo()) first = &o;
    }
    if (own) continue;
    PoolPoint& p = pool_.emplace_back();
    p = {.id = id,
         .p_world = point.p_world,
         .spread = Vec3<float>::Zero(),
         .normal = point.normal,
         .min_distance = point.min_distance,
         .max_distance = point.max_distance,
         .descriptor = point.descriptor,
         .noise = static_cast<float>(std::sqrt(1 + 1 / static_cast<double>(point.observations.size())))};
    if (!(point.max_distance > 0)) {  // nobody described it yet
      const Observation& o = point.observations.front();
      p.descriptor = map.keyframe(o.keyframe).descriptors[o.index];
    }
    if (!first) continue;
    // Depth is what a stereo point is uncertain of; further views average it down.
    const Keyframe& keyframe = map.keyframe(first->keyframe);
    const Measurement& m = keyframe.measurements[first->index];
    const double share =
        m.sigma_right / m.disparity() / std::sqrt(static_cast<double>(point.observations.size()));
    p.spread = (share * (point.p_world - keyframe.T_camera_world.inverse().translation())).cast<float>();
  }
}

// How large what a key point shows is, in levels of the pyramid: it does not depend on where it is seen from.
float PlaceVerifier::size_level(int octave, double distance) const {
  return static_cast<float>(octave + std::log(distance) / std::log(levels_.factor));
}

void PlaceVerifier::match_descriptors(const PlaceImage& image, const Map& map,
                                      const PlaceDatabase& database) {
  descriptor_matches_.clear();
  image_sizes_.clear();
  for (const Measurement& m : image.measurements)
    image_sizes_.push_back(m.stereo() && m.sigma_right <= options_.max_depth_uncertainty * m.disparity()
                               ? size_level(m.octave, back_project(m).norm())
                               : std::numeric_limits<float>::quiet_NaN());
  const std::size_t count = std::min(group_.size(), static_cast<std::size_t>(options_.match_keyframes));
  for (std::size_t k = 0; k < count; ++k) {
    const DirectIndex* index = database.index(group_[k]);
    if (index) match_keyframe(image, map, map.keyframe(group_[k]), *index);
  }
  // Of what several keyframes say the nearest in descriptor, one point for a measurement and back.
  auto& all = descriptor_matches_;
  std::sort(all.begin(), all.end(), [](const DescriptorMatch& a, const DescriptorMatch& b) {
    return std::tie(a.measurement, a.distance, a.point) < std::tie(b.measurement, b.distance, b.point);
  });
  all.erase(std::unique(all.begin(), all.end(),
                        [](const auto& a, const auto& b) { return a.measurement == b.measurement; }),
            all.end());
  std::sort(all.begin(), all.end(), [](const DescriptorMatch& a, const DescriptorMatch& b) {
    return std::tie(a.point, a.distance, a.measurement) < std::tie(b.point, b.distance, b.measurement);
  });
  all.erase(
      std::unique(all.begin(), all.end(), [](const auto& a, const auto& b) { return a.point == b.point; }),
      all.end());
}

void PlaceVerifier::match_keyframe(const PlaceImage& image, const Map& map, const Keyframe& keyframe,
                                   const DirectIndex& index) {
  constexpr std::uint64_t kNone = std::numeric_limits<std::uint64_t>::max();
  const auto key = [](int distance, std::uint32_t i) {
    return static_cast<std::uint64_t>(distance) << 32 | i;
  };
  keyframe_matches_.clear();
  const Vec3<double> center = keyframe.T_camera_world.inverse().translation();
  keyframe_sizes_.assign(keyframe.measurements.size(), 0);
  for (std::size_t j = 0; j < keyframe.points.size(); ++j)
    if (keyframe.points[j].valid())
      keyframe_sizes_[j] = size_level(keyframe.measurements[j].octave,
                                      (map.point(keyframe.points[j]).p_world - center).norm());
  const auto max_difference = static_cast<float>(options_.max_size_difference);
  best_of_keyframe_.assign(keyframe.measurements.size(), kNone);
  // The candidates of each feature of the image; those of the keyframe choose after all have been seen.
  struct Found {
    std::uint32_t measurement, other;
    int distance;
  };
  std::vector<Found> found;
  std::size_t a = 0, b = 0;
  while (a < image.index.size() && b < index.size()) {
    if (image.index.nodes[a] != index.nodes[b]) {
      image.index.nodes[a] < index.nodes[b] ? ++a : ++b;
      continue;
    }
    for (const std::uint32_t i : image.index.features_of(a)) {
      std::uint64_t best = kNone;
      int second = std::numeric_limits<int>::max();
      for (const std::uint32_t j : index.features_of(b)) {
        if (j >= keyframe.points.size() || !keyframe.points[j].valid()) continue;
        // Without depth it may have any size.
        if (std::abs(image_sizes_[i] - keyframe_sizes_[j]) > max_difference) continue;
        const int distance = hamming_distance(image.descriptors[i], keyframe.descriptors[j]);
        best_of_keyframe_[j] = std::min(best_of_keyframe_[j], key(distance, i));
        if (key(distance, j) < best) {
          if (best != kNone) second = static_cast<int>(best >> 32);
          best = key(distance, j);
        } else {
          second = std::min(second, distance);
        }
      }
      if (best == kNone) continue;
      const auto distance = static_cast<int>(best >> 32);
      if (distance > options_.max_distance || distance > options_.ratio * second) continue;
      found.push_back({i, static_cast<std::uint32_t>(best), distance});
    }
    ++a;
    ++b;
  }
  orientation_.clear();
  for (const Found& f : found) {
    if (static_cast<std::uint32_t>(best_of_keyframe_[f.other]) != f.measurement) continue;
    keyframe_matches_.push_back({f.measurement, keyframe.points[f.other], f.distance});
    orientation_.add(keyframe.measurements[f.other].angle, image.measurements[f.measurement].angle);
  }
  if (options_.check_orientation) orientation_.finish();
  for (std::size_t i = 0; i < keyframe_matches_.size(); ++i)
    if (!options_.check_orientation || orientation_.agrees(i))
      descriptor_matches_.push_back(keyframe_matches_[i]);
}

std::optional<SE3d> PlaceVerifier::coarse_pose(const PlaceImage& image, const Map& map,
                                               const PlaceHints& hints) {
  std::vector<Vec3<double>> points;
  std::vector<Vec2<double>> rays;
  std::vector<double> right_x, sigmas;
  for (const DescriptorMatch& match : descriptor_matches_) {
    const Measurement& m = image.measurements[match.measurement];
    points.push_back(map.point(match.point).p_world);
    rays.emplace_back((m.u - camera_.cx) / camera_.focal, (m.v - camera_.cy) / camera_.focal);
    right_x.push_back(m.stereo() ? (m.u_right - camera_.cx) / camera_.focal
                                 : std::numeric_limits<double>::quiet_NaN());
    sigmas.push_back(m.sigma);
  }
  const PnpMatches matches{.points = points,
                           .rays = rays,
                           .right_x = right_x,
                           .sigmas = sigmas,
                           .focal = camera_.focal,
                           .baseline = camera_.baseline};
  if (!hints.gravity_camera || !hints.gravity_world) {
    const auto found = solve_pnp(matches, options_.pnp);
    if (!found) return std::nullopt;
    return found->T_world_camera.inverse();
  }
  const UprightPnpEstimator estimator(matches, options_.pnp, hints.gravity_world->normalized(),
                                      hints.gravity_camera->normalized());
  const auto found = ransac(estimator, options_.pnp.ransac);
  if (!found || static_cast<int>(found->inliers.size()) < options_.pnp.min_inliers) return std::nullopt;
  impl::PnpPose pose = found->model;
  impl::fit_pnp(matches, found->inliers, 1, options_.pnp.huber_width, options_.pnp.refine_iterations, pose);
  if (!pose.R.allFinite() || !pose.t.allFinite()) return std::nullopt;
  return pose.T_world_camera().inverse();
}

PoseResult PlaceVerifier::match_projected(const PlaceImage& image, const SE3d& T_camera_world,
                                          double radius) {
  queries_.clear();
  query_descriptors_.clear();
  asked_.clear();
  const Vec3<double> center = T_camera_world.inverse().translation();
  const double min_cosine = std::cos(options_.view_angle * kDegree);
  for (std::size_t k = 0; k < pool_.size(); ++k) {
    const PoolPoint& point = pool_[k];
    const auto uvr = camera_.project_stereo(T_camera_world * point.p_world);
    if (!uvr || !inside(view_, uvr->x(), uvr->y())) continue;
    int octave = 0, reach = 31;
    if (point.max_distance > 0) {
      const Vec3<double> to_camera = center - point.p_world;
      const double distance = to_camera.norm();
      if (distance < 0.8 * point.min_distance || distance > 1.2 * point.max_distance) continue;
      if (to_camera.dot(point.normal.cast<double>()) < min_cosine * distance) continue;
      octave = levels_.octave(point.max_distance, distance);
      reach = 1;
    }
    queries_.push_back({.u = static_cast<float>(uvr->x()),
                        .v = static_cast<float>(uvr->y()),
                        .u_right = static_cast<float>(uvr->z()),
                        .radius = static_cast<float>(radius * levels_.scale(octave)),
                        .min_octave = octave - reach,
                        .max_octave = octave + reach});
    query_descriptors_.push_back(point.descriptor);
    asked_.push_back(static_cast<std::uint32_t>(k));
  }
  matches_.resize(queries_.size());
  projection_.match(queries_, query_descriptors_, image.grid,
                    std::span<const Measurement>(image.measurements), image.descriptors, matches_);
  observations_.clear();
  observed_.clear();
  for (std::size_t q = 0; q < matches_.size(); ++q) {
    if (!matches_[q].found()) continue;
    const auto i = static_cast<std::uint32_t>(matches_[q].index);
    const Measurement& m = image.measurements[i];
    const PoolPoint& point = pool_[asked_[q]];
    observations_.push_back({.p_world = point.p_world,
                             .u = m.u,
                             .v = m.v,
                             .u_right = m.u_right,
                             .sigma = m.sigma * point.noise,
                             .sigma_disparity = m.sigma_right * point.noise,
                             .p_world_spread = point.spread});
    observed_.push_back({i, point.id});
  }
  return solve_pose(camera_, T_camera_world, observations_, options_.pose, inlier_, nullptr, &workspace_);
}

void PlaceVerifier::examine(const PlaceImage& image, const Map& map, const SE3d& T_start,
                            const PlaceHints& hints, PlaceCheck& check) {
  PlaceMatch& match = check.match;
  check.rejection = PlaceRejection::few_inliers;
  PoseResult pose = match_projected(image, T_start, options_.first_radius);
  if (pose.usable()) pose = match_projected(image, pose.T_camera_world, options_.radius);
  match.predicted = count_comparable(image.measurements, image.grid);
  match.found = static_cast<int>(observed_.size());
  if (!pose.usable()) return;

  match.T_camera_world = pose.T_camera_world;
  match.covariance = pose.covariance;
  for (std::size_t k = 0; k < observed_.size(); ++k) {
    if (!inlier_[k]) continue;
    match.pairs.push_back(observed_[k]);
    const Measurement& m = image.measurements[observed_[k].measurement];
    const auto cell = [](double x, double low, double high, int count) {
      return std::clamp(static_cast<int>((x - low) / (high - low) * count), 0, count - 1);
    };
    match.cells.set(static_cast<std::size_t>(cell(m.v, view_.v_min, view_.v_max, kRows) * kColumns +
                                             cell(m.u, view_.u_min, view_.u_max, kColumns)));
  }
  match.off_plane = count_off_plane();
  std::sort(match.pairs.begin(), match.pairs.end(),
            [](const PlacePair& a, const PlacePair& b) { return a.measurement < b.measurement; });
  const Keyframe& candidate = map.keyframe(most_seen(map));
  match.candidate = candidate.id;
  match.T_query_candidate = match.T_camera_world * candidate.T_camera_world.inverse();
  match.seen_share = static_cast<double>(match.pairs.size()) / std::max(1, match.predicted);
  const SE3d T_candidate_camera = match.T_query_candidate.inverse();
  match.inverse_share = inverse_share(image, candidate, T_candidate_camera);
  match.contradictions = contradictions(image, candidate, T_candidate_camera);
  check.rejection = judge(hints, match);
}

}  // namespace sweepkit
