// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/slam/place_verification.hpp"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <bitset>
#include <cmath>
#include <limits>
#include <numbers>
#include <tuple>

#include "sweepkit/core/random.hpp"
#include "sweepkit/geometry/impl/pnp.hpp"
#include "sweepkit/geometry/ransac.hpp"
#include "sweepkit/geometry/upright_p2p.hpp"

namespace sweepkit {
namespace {

constexpr double kDegree = std::numbers::pi / 180;
constexpr int kColumns = 8, kRows = 5;
// Nearer than this two key points are taken to show one surface, at octave 0 [px].
constexpr double kSameSurface = 8;
// Fewer points in the other's view say nothing of how many should be found.
constexpr int kFewPredicted = 20;
// How a plane is looked for, and how far off it a point still lies on it [m].
constexpr int kPlaneSamples = 60;
constexpr double kPlaneThickness = 0.02;

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

void PlaceVerifier::match_descriptors(const PlaceImage& image, const Map& map,
                                      const PlaceDatabase& database) {
  descriptor_matches_.clear();
  const std::size_t count = std::min(group_.size(), static_cast<std::size_t>(options_.match_keyframes));
  for (std::size_t k = 0; k < count; ++k) {
    const DirectIndex* index = database.index(group_[k]);
    if (index) match_keyframe(image, map.keyframe(group_[k]), *index);
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

void PlaceVerifier::match_keyframe(const PlaceImage& image, const Keyframe& keyframe,
                                   const DirectIndex& index) {
  constexpr std::uint64_t kNone = std::numeric_limits<std::uint64_t>::max();
  const auto key = [](int distance, std::uint32_t i) {
    return static_cast<std::uint64_t>(distance) << 32 | i;
  };
  keyframe_matches_.clear();
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
  std::bitset<kColumns * kRows> cells;
  for (std::size_t k = 0; k < observed_.size(); ++k) {
    if (!inlier_[k]) continue;
    match.pairs.push_back(observed_[k]);
    const Measurement& m = image.measurements[observed_[k].measurement];
    const auto cell = [](double x, double low, double high, int count) {
      return std::clamp(static_cast<int>((x - low) / (high - low) * count), 0, count - 1);
    };
    cells.set(static_cast<std::size_t>(cell(m.v, view_.v_min, view_.v_max, kRows) * kColumns +
                                       cell(m.u, view_.u_min, view_.u_max, kColumns)));
  }
  match.cells = static_cast<int>(cells.count());
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

PlaceRejection PlaceVerifier::judge(const PlaceHints& hints, const PlaceMatch& match) const {
  const auto inliers = static_cast<int>(match.pairs.size());
  if (inliers < options_.min_inliers) return PlaceRejection::few_inliers;
  if (inliers < options_.min_inlier_share * match.found) return PlaceRejection::inlier_share;
  if (match.cells < options_.min_cells) return PlaceRejection::concentrated;
  if (match.off_plane < options_.min_off_plane) return PlaceRejection::flat;
  if (match.seen_share < options_.min_seen_share) return PlaceRejection::not_seen;
  if (match.inverse_share < options_.min_inverse_share) return PlaceRejection::not_seen_there;
  if (match.contradictions > options_.max_contradictions) return PlaceRejection::contradicted;
  if (largest_sigma(match.covariance.topLeftCorner<3, 3>()) > options_.max_position_sigma ||
      largest_sigma(match.covariance.bottomRightCorner<3, 3>()) > options_.max_rotation_sigma * kDegree)
    return PlaceRejection::uncertain;
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
