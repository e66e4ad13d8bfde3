// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
// How PlaceRecognizer locates frames of which none alone tells the place.
#include <algorithm>
#include <limits>
#include <map>
#include <numbers>
#include <utility>

#include "sweepkit/slam/place_recognition.hpp"

namespace sweepkit {
namespace {

constexpr double kDegree = std::numbers::pi / 180;
// A pooled pose may be off by this before it was refined in one of the images.
constexpr double kCoarseDistance = 0.25;  // [m]
constexpr double kCoarseAngle = 4;        // [deg]
constexpr std::size_t kFewPairs = 5;      // fewer points say nothing of where an image is
constexpr std::size_t kTries = 4;         // so many images without points are enough to give up
constexpr std::size_t kManyPairs = 20;    // so many, on another pose, deny

double degrees(const SE3d& T) { return T.rotation().angle() / kDegree; }

}  // namespace

// Groups of maps not yet known that look like one of the images, by their likeness to all of them.
std::vector<PlaceGroup> PlaceRecognizer::groups_of(std::span<const Seen* const> seen, const Map& map,
                                                   std::span<const MapId> known) const {
  std::map<KeyframeId, PlaceGroup> groups;
  for (const Seen* one : seen)
    for (const PlaceGroup& group : one->groups) {
      if (!map.find(group.best) || std::find(known.begin(), known.end(), group.map) != known.end()) continue;
      PlaceGroup& sum =
          groups.try_emplace(group.best, PlaceGroup{group.best, group.map, 0, {}}).first->second;
      sum.score += group.score;
    }
  std::vector<PlaceGroup> out;
  out.reserve(groups.size());
  for (auto& [id, group] : groups) out.push_back(std::move(group));
  std::stable_sort(out.begin(), out.end(), [](const auto& a, const auto& b) { return a.score > b.score; });
  if (out.size() > static_cast<std::size_t>(options_.database.max_candidates))
    out.resize(static_cast<std::size_t>(options_.database.max_candidates));
  return out;
}

PlaceRecognizer::Pooled PlaceRecognizer::examine_together(const Map& map, std::span<const Seen* const> seen,
                                                          MapId target, const SE3d& T_first_world,
                                                          const Vec3<double>& gravity_world) {
  const SE3d T_odom_first = seen.front()->T_camera_odom->inverse();
  const auto check_view = [&](const Seen& one, const SE3d& T_world) {
    const SE3d T_view_first = *one.T_camera_odom * T_odom_first;
    PlaceHints hints;
    hints.gravity_world = gravity_world;
    hints.gravity_camera = one.gravity_camera;
    return std::pair(T_view_first, check_at(map, one.image, T_view_first * T_world, target, hints));
  };
  const auto error = [](const PlaceCheck& check, const SE3d& T_expected) {
    return check.match.T_camera_world * T_expected.inverse();
  };

  // What the images find near the proposal makes it exact.
  Pooled pooled;
  std::vector<PlaceView> views;
  std::vector<std::vector<PlacePair>> pairs;
  bool any = false;
  for (const Seen* one : seen) {
    if (!any && views.size() >= kTries) break;
    auto [T_view_first, check] = check_view(*one, T_first_world);
    views.push_back({&one->image, T_view_first});
    pairs.emplace_back();
    if (!check || check->match.pairs.size() < kFewPairs) continue;
    const SE3d off = error(*check, T_view_first * T_first_world);
    if (off.translation().norm() > kCoarseDistance || degrees(off) > kCoarseAngle) continue;
    pairs.back() = std::move(check->match.pairs);
    any = true;
  }
  if (!any) return pooled;
  const SE3d T_world = verifier_.refine_together(views, pairs, map, T_first_world);

  double predicted = 0, agreeing = 0;
  std::size_t anchor_pairs = 0;
  for (const Seen* one : seen) {
    auto [T_view_first, check] = check_view(*one, T_world);
    if (!check) continue;
    const SE3d T_expected = T_view_first * T_world;
    PlaceMatch& match = check->match;
    const std::size_t pairs = match.pairs.size();
    predicted += match.predicted;
    if (pairs < kFewPairs) continue;
    if (!same_place(match.T_camera_world, T_expected, T_view_first.translation().norm())) {
      pooled.denials += pairs >= kManyPairs;
      continue;
    }
    pooled.confirming.push_back(T_expected);
    pooled.inliers += static_cast<int>(pairs);
    pooled.off_plane += match.off_plane;
    pooled.cells |= match.cells;
    pooled.most_cells = std::max(pooled.most_cells, match.cells.count());
    pooled.inverse_share += match.inverse_share * match.predicted;
    pooled.contradictions += match.contradictions;
    agreeing += match.predicted;
    // The newest image speaks for itself if it can.
    const bool itself = one == seen.front() && check->ok();
    if (itself || pairs > anchor_pairs) {
      anchor_pairs = itself ? std::numeric_limits<std::size_t>::max() : pairs;
      const SE3d T_first_view = T_view_first.inverse();
      pooled.anchor = match;
      pooled.match = std::move(match);
      if (one == seen.front()) continue;
      // On from there by odometry.
      pooled.match.T_camera_world = T_first_view * pooled.match.T_camera_world;
      pooled.match.T_query_candidate = T_first_view * pooled.match.T_query_candidate;
      const Mat6<double> adjoint = T_first_view.adjoint();
      pooled.match.covariance = adjoint * pooled.match.covariance * adjoint.transpose();
      const double drift = options_.drift * T_first_view.translation().norm();
      pooled.match.covariance.diagonal().head<3>().array() += drift * drift;
      pooled.match.pairs.clear();
    }
  }
  pooled.seen_share = pooled.inliers / std::max(1.0, predicted);
  pooled.inverse_share /= std::max(1.0, agreeing);
  pooled.contradictions /= std::max<double>(1, static_cast<double>(pooled.confirming.size()));
  pooled.match.confirmations = pooled.anchor.confirmations = static_cast<int>(pooled.confirming.size());
  return pooled;
}

PlaceRejection PlaceRecognizer::judge(const Pooled& pooled) const {
  const PlaceVerifierOptions& verifier = options_.verifier;
  if (pooled.inliers < options_.sure_inliers) return PlaceRejection::few_inliers;
  // Where the camera turns, a thing passes through all cells.
  if (static_cast<int>(pooled.most_cells) < verifier.min_cells ||
      static_cast<int>(pooled.cells.count()) < options_.sure_cells)
    return PlaceRejection::concentrated;
  const bool deep = pooled.off_plane >= verifier.min_off_plane &&
                    pooled.off_plane >= options_.pooled_off_plane * pooled.inliers;
  if (!deep && pooled.off_plane < options_.sure_off_plane) return PlaceRejection::flat;
  if (pooled.seen_share < (deep ? options_.pooled_seen_share : verifier.min_seen_share))
    return PlaceRejection::not_seen;
  if (pooled.inverse_share < options_.pooled_inverse_share) return PlaceRejection::not_seen_there;
  if (pooled.contradictions > verifier.max_contradictions) return PlaceRejection::contradicted;
  if (!verifier_.certain(pooled.anchor.covariance)) return PlaceRejection::uncertain;
  if (pooled.denials > 0 && 3 * pooled.denials >= static_cast<int>(pooled.confirming.size()))
    return PlaceRejection::inconsistent;
  if (static_cast<int>(pooled.confirming.size()) < options_.confirmations || !far_apart(pooled.confirming))
    return PlaceRejection::unconfirmed;
  return PlaceRejection::none;
}

// The newest comes first; all have odometry and gravity.
std::optional<PlaceRecognizer::Pooled> PlaceRecognizer::locate_together(const Map& map,
                                                                        std::span<const Seen* const> seen,
                                                                        std::span<const MapId> known,
                                                                        const Vec3<double>& gravity_world) {
  if (static_cast<int>(seen.size()) < options_.confirmations) return std::nullopt;
  const Seen& now = *seen.front();
  std::vector<PlaceView> views;
  views.reserve(seen.size());
  for (const Seen* one : seen)
    views.push_back({&one->image, *one->T_camera_odom * now.T_camera_odom->inverse()});

  std::vector<std::pair<MapId, SE3d>> proposed;
  std::vector<Pooled> places;  // believed or not
  std::optional<std::size_t> best;
  for (const PlaceGroup& group : groups_of(seen, map, known)) {
    const auto proposal =
        verifier_.propose(views, map, database_, group.best, *now.gravity_camera, gravity_world);
    if (!proposal) continue;
    if (std::any_of(proposed.begin(), proposed.end(), [&](const auto& p) {
          return p.first == group.map && same_place(p.second, proposal->T_first_world, 0);
        }))
      continue;
    proposed.emplace_back(group.map, proposal->T_first_world);
    places.push_back(examine_together(map, seen, group.map, proposal->T_first_world, gravity_world));
    const PlaceRejection rejection = judge(places.back());
    if (rejection != PlaceRejection::none)
      reject(rejection);
    else if (!best || places[*best].inliers < places.back().inliers)
      best = places.size() - 1;
  }
  if (!best) return std::nullopt;
  // A rival need not be believed to speak against the best.
  for (const Pooled& other : places)
    if (other.match.map == places[*best].match.map &&
        other_place(other.match.T_camera_world, places[*best].match.T_camera_world) &&
        other.inliers >= options_.rival_share * places[*best].inliers) {
      reject(PlaceRejection::ambiguous);
      return std::nullopt;
    }
  ++counts_.accepted;
  return std::move(places[*best]);
}

std::optional<PlaceMatch> PlaceRecognizer::locate_together(const Map& map, const Seen& now,
                                                           const Vec3<double>& gravity_world) {
  if (!now.T_camera_odom || !now.gravity_camera) return std::nullopt;
  std::vector<const Seen*> seen{&now};
  for (auto one = seen_.rbegin(); one != seen_.rend(); ++one)
    if (one->T_camera_odom && one->gravity_camera) seen.push_back(&*one);
  auto pooled = locate_together(map, seen, {}, gravity_world);
  if (!pooled) return std::nullopt;
  return std::move(pooled->match);
}

// The keyframe is the newest of those fed. Its map is their odometry.
std::optional<PlaceMatch> PlaceRecognizer::feed_together(const Map& map, const Keyframe& keyframe,
                                                         std::span<const MapId> known,
                                                         const Vec3<double>& gravity_world) {
  std::vector<const Seen*> seen;
  for (auto one = fed_.rbegin(); one != fed_.rend(); ++one) {
    const Keyframe* other = map.find(one->image.keyframe);
    if (!other || other->map != keyframe.map) continue;
    one->T_camera_odom = other->T_camera_world;
    one->gravity_camera = other->T_camera_world.rotation() * gravity_world;
    seen.push_back(&*one);
  }
  auto pooled = locate_together(map, seen, known, gravity_world);
  if (!pooled) return std::nullopt;
  return std::move(pooled->anchor);
}

}  // namespace sweepkit
