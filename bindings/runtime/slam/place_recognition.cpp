// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/slam/place_recognition.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

namespace sweepkit {
namespace {

constexpr double kDegree = std::numbers::pi / 180;
// Keyframes farther away than this, or turned by more, do not show what a pose looks at.
constexpr double kNearDistance = 2.5;  // [m]
constexpr double kNearAngle = 50;      // [deg]
constexpr double kAngleForMetre = 60;  // how much turn is as bad as a metre [deg]
constexpr int kEnoughPredicted = 60;   // points that can be compared, of which some must be found
// From so near a keyframe its points should be seen, if any are comparable.
constexpr double kCloseDistance = 0.5;   // [m]
constexpr double kCloseAngle = 20;       // [deg]
constexpr int kSameGroup = 30;           // shared points of keyframes that show the same
constexpr double kSameFrameTime = 0.15;  // frames nearer in time that did not move say the same [s]
constexpr double kSameFrameDistance = 0.03, kSameFrameAngle = 3;  // [m], [deg]

double degrees(const SE3d& T) { return T.rotation().angle() / kDegree; }

Vec3<double> center(const SE3d& T_camera_world) { return T_camera_world.inverse().translation(); }

// Poses farther apart than this, or turned by more, are different views.
constexpr double kOtherView = 0.25;     // [m]
constexpr double kOtherViewAngle = 20;  // [deg]
// So many views that confirm outweigh one that doubts, or denies.
constexpr std::size_t kPerDoubt = 2, kPerDenial = 8;
// Places of one image are two if they are farther apart than this.
constexpr double kOtherPlace = 0.5;      // [m]
constexpr double kOtherPlaceAngle = 10;  // [deg]

bool same_view(const SE3d& T_a_world, const SE3d& T_b_world) {
  return (center(T_a_world) - center(T_b_world)).norm() < kOtherView &&
         degrees(T_a_world * T_b_world.inverse()) < kOtherViewAngle;
}

// How many views that differ are among them: many from one spot say no more than one.
std::size_t count_views(std::span<const SE3d> poses) {
  std::vector<const SE3d*> views;
  for (const SE3d& pose : poses)
    if (std::none_of(views.begin(), views.end(), [&](const SE3d* view) { return same_view(*view, pose); }))
      views.push_back(&pose);
  return views.size();
}

// How far the farthest two are apart, and turned [m, deg].
std::pair<double, double> spread_of(std::span<const SE3d> poses) {
  double travel = 0, turn = 0;
  for (const SE3d& a : poses)
    for (const SE3d& b : poses) {
      travel = std::max(travel, (center(a) - center(b)).norm());
      turn = std::max(turn, degrees(a * b.inverse()));
    }
  return {travel, turn};
}

// The keyframe of a map whose view is most like that from a pose; none if none is like it.
KeyframeId nearest_view(const Map& map, MapId id, const SE3d& T_camera_world, KeyframeId self) {
  KeyframeId best;
  double least = 1e300;
  const Vec3<double> c = center(T_camera_world);
  const Vec3<double> forward = T_camera_world.rotation().inverse() * Vec3<double>::UnitZ();
  for (std::uint32_t i = 0; i < map.keyframe_id_end(); ++i) {
    const Keyframe* keyframe = map.find(KeyframeId{i});
    if (!keyframe || keyframe->map != id || keyframe->blind()) continue;
    if (self.valid() && (keyframe->id == self || map.shared_points(keyframe->id, self) > 0)) continue;
    const double distance = (center(keyframe->T_camera_world) - c).norm();
    if (distance > kNearDistance) continue;
    const Vec3<double> other = keyframe->T_camera_world.rotation().inverse() * Vec3<double>::UnitZ();
    const double angle = std::atan2(forward.cross(other).norm(), forward.dot(other)) / kDegree;
    if (angle > kNearAngle) continue;
    const double cost = distance + angle / kAngleForMetre;
    if (cost < least) {
      least = cost;
      best = keyframe->id;
    }
  }
  return best;
}

}  // namespace

PlaceRecognizer::PlaceRecognizer(const RectifiedCamera& camera, const StereoRig::Bounds& view,
                                 const ScaleLevels& levels, std::shared_ptr<const OrbVocabulary> vocabulary,
                                 const PlaceRecognizerOptions& options)
    : options_(options),
      database_(std::move(vocabulary), options.database),
      verifier_(camera, view, levels, options.verifier) {
  check_options(options_);
}

void PlaceRecognizer::reject(PlaceRejection rejection) {
  ++counts_.rejected[static_cast<std::size_t>(rejection)];
  last_ = std::max(last_, rejection);
}

void PlaceRecognizer::forget() { seen_.clear(); }

bool PlaceRecognizer::other_place(const SE3d& T_a_world, const SE3d& T_b_world) {
  const SE3d T_a_b = T_a_world * T_b_world.inverse();
  return T_a_b.translation().norm() > kOtherPlace || degrees(T_a_b) > kOtherPlaceAngle;
}

bool PlaceRecognizer::same_place(const SE3d& T_a_world, const SE3d& T_b_world, double travelled) const {
  const SE3d T_a_b = T_a_world * T_b_world.inverse();
  return T_a_b.translation().norm() <= options_.consistent_distance + options_.drift * travelled &&
         degrees(T_a_b) <= options_.consistent_angle;
}

std::optional<PlaceMatch> PlaceRecognizer::best_candidate(const Map& map, const PlaceImage& image,
                                                          std::span<const PlaceGroup> groups,
                                                          PlaceHints hints, MapId own_map,
                                                          std::span<const MapId> one_frame) {
  ++counts_.queries;
  last_ = PlaceRejection::none;
  const std::optional<PlacePrior> prior = hints.prior;
  std::vector<PlaceMatch> verified;
  for (const PlaceGroup& group : groups) {
    ++counts_.candidates;
    // A group that shares points with one already verified would say the same.
    if (std::any_of(verified.begin(), verified.end(), [&](const PlaceMatch& match) {
          return match.candidate == group.best ||
                 map.shared_points(match.candidate, group.best) >= kSameGroup;
        }))
      continue;
    const bool expected =
        group.map == own_map || std::find(one_frame.begin(), one_frame.end(), group.map) != one_frame.end();
    hints.prior = expected ? prior : std::nullopt;
    PlaceCheck check = verifier_.verify(image, map, database_, group.best, hints);
    if (check.ok())
      verified.push_back(std::move(check.match));
    else
      reject(check.rejection);
  }
  if (image.keyframe.valid())
    for (const PlaceMatch& match : verified) {
      claims_.push_back({image.keyframe, match.map, match.T_camera_world});
      if (claims_.size() > static_cast<std::size_t>(options_.stranger_history)) claims_.pop_front();
    }
  if (verified.empty()) return std::nullopt;
  const auto best = std::max_element(verified.begin(), verified.end(), [](const auto& a, const auto& b) {
    return a.pairs.size() < b.pairs.size();
  });
  for (const PlaceMatch& other : verified)
    if (other.map == best->map && !same_place(other.T_camera_world, best->T_camera_world, 0) &&
        static_cast<double>(other.pairs.size()) >=
            options_.rival_share * static_cast<double>(best->pairs.size())) {
      reject(PlaceRejection::ambiguous);
      return std::nullopt;
    }
  return *best;
}

std::optional<PlaceCheck> PlaceRecognizer::check_at(const Map& map, const PlaceImage& image,
                                                    const SE3d& T_camera_world, MapId target,
                                                    const PlaceHints& hints) {
  const KeyframeId near = nearest_view(map, target, T_camera_world, image.keyframe);
  if (!near.valid()) return std::nullopt;
  return verifier_.verify_at(image, map, near, T_camera_world, hints);
}

PlaceRecognizer::Witness PlaceRecognizer::ask(const Map& map, const PlaceImage& image,
                                              const SE3d& T_camera_world, MapId target, double travelled,
                                              const PlaceHints& hints, double* contradictions) {
  const KeyframeId near = nearest_view(map, target, T_camera_world, image.keyframe);
  if (!near.valid()) return Witness::silent;
  const PlaceCheck check = verifier_.verify_at(image, map, near, T_camera_world, hints);
  if (contradictions) *contradictions = check.match.contradictions;
  if (check.ok())
    return same_place(check.match.T_camera_world, T_camera_world, travelled) ? Witness::confirms
                                                                             : Witness::denies;
  if (check.rejection == PlaceRejection::contradicted) return Witness::denies;
  // From elsewhere the view may be blocked, or too different.
  const SE3d T_near = T_camera_world * map.keyframe(near).T_camera_world.inverse();
  const bool should_see = T_near.translation().norm() < kCloseDistance && degrees(T_near) < kCloseAngle &&
                          check.match.predicted >= kEnoughPredicted;
  const bool nothing_found = check.rejection == PlaceRejection::few_inliers ||
                             check.rejection == PlaceRejection::not_seen ||
                             check.rejection == PlaceRejection::inlier_share;
  if (!should_see) return Witness::silent;
  if (check.rejection == PlaceRejection::concentrated) return Witness::doubts;
  return nothing_found ? Witness::denies : Witness::silent;
}

bool PlaceRecognizer::far_apart(std::span<const SE3d> poses) const {
  const auto [travel, turn] = spread_of(poses);
  return travel >= options_.min_travel || turn >= options_.min_turn;
}

bool PlaceRecognizer::convinced(const std::vector<SE3d>& confirming, int denials, PlaceMatch& match) {
  match.confirmations = static_cast<int>(confirming.size());
  if (denials > 0 && 3 * denials >= match.confirmations) {
    reject(PlaceRejection::inconsistent);
    return false;
  }
  const bool sure = static_cast<int>(match.pairs.size()) >= options_.sure_inliers &&
                    static_cast<int>(match.cells.count()) >= options_.sure_cells &&
                    match.off_plane >= options_.sure_off_plane;
  if (!sure && (match.confirmations < options_.confirmations || !far_apart(confirming))) {
    reject(PlaceRejection::unconfirmed);
    return false;
  }
  ++counts_.accepted;
  return true;
}

bool PlaceRecognizer::convinced_of_stranger(const Testimony& testimony, PlaceMatch& match) {
  match.confirmations = static_cast<int>(testimony.confirming.size());
  const std::size_t confirming = count_views(testimony.confirming);
  double contradictions = match.contradictions;
  for (const double share : testimony.contradictions) contradictions += share;
  contradictions /= static_cast<double>(testimony.contradictions.size() + 1);
  if (kPerDoubt * count_views(testimony.doubting) > confirming ||
      kPerDenial * count_views(testimony.denying) > confirming ||
      contradictions > options_.stranger_contradictions) {
    reject(PlaceRejection::inconsistent);
    return false;
  }
  const auto [travel, turn] = spread_of(testimony.confirming);
  if (confirming < static_cast<std::size_t>(options_.stranger_views) ||
      (travel < options_.stranger_travel && turn < options_.stranger_turn)) {
    reject(PlaceRejection::unconfirmed);
    return false;
  }
  ++counts_.accepted;
  return true;
}

std::optional<PlaceMatch> PlaceRecognizer::feed(const Map& map, KeyframeId id, const Vec3<double>* gravity,
                                                std::span<const MapId> one_frame) {
  const Keyframe& keyframe = map.keyframe(id);
  if (keyframe.blind()) return std::nullopt;
  const PlaceImage image = database_.image(keyframe);
  database_.add(image);
  PlaceHints hints;
  if (gravity) {
    hints.gravity_world = *gravity;
    hints.gravity_camera = keyframe.T_camera_world.rotation() * *gravity;
  }
  hints.prior = PlacePrior{keyframe.T_camera_world, keyframe.covariance};
  std::vector<PlaceGroup> groups = database_.candidates(image, map);
  const bool pool = options_.pool && !options_.twins && gravity;
  std::vector<MapId> known(one_frame.begin(), one_frame.end());
  known.push_back(keyframe.map);
  if (pool) {
    // Its neighbours, which may stand close, set no standard of likeness for maps that it knows no way to.
    std::erase_if(groups, [&](const PlaceGroup& group) {
      return std::find(known.begin(), known.end(), group.map) == known.end();
    });
    for (PlaceGroup& group : database_.candidates(image, map, known)) groups.push_back(std::move(group));
    fed_.push_back(
        {.image = image, .T_camera_odom = {}, .gravity_camera = {}, .match = {}, .groups = groups});
    if (fed_.size() > static_cast<std::size_t>(options_.history)) fed_.pop_front();
  }
  auto match = best_candidate(map, image, groups, hints, keyframe.map, one_frame);
  if (match) match = confirmed(map, keyframe, *match, gravity, one_frame);
  if (!match && pool) match = feed_together(map, keyframe, known, *gravity);
  if (match) claims_.clear();
  return match;
}

// The same match, if the keyframes around do not contradict it.
std::optional<PlaceMatch> PlaceRecognizer::confirmed(const Map& map, const Keyframe& keyframe,
                                                     PlaceMatch match, const Vec3<double>* gravity,
                                                     std::span<const MapId> one_frame) {
  // What this match says of all keyframes around, those must not contradict.
  const SE3d T_own_target = keyframe.T_camera_world.inverse() * match.T_camera_world;
  const bool stranger = options_.twins && match.map != keyframe.map &&
                        std::find(one_frame.begin(), one_frame.end(), match.map) == one_frame.end();
  const int history = stranger ? options_.stranger_history : options_.history;
  Testimony testimony{
      .confirming = {match.T_camera_world}, .doubting = {}, .denying = {}, .contradictions = {}};
  int denials = 0, asked = 0;
  std::vector<SE3d> views{keyframe.T_camera_world};
  for (std::uint32_t i = keyframe.id.value; i-- > 0 && asked < history;) {
    const Keyframe* other = map.find(KeyframeId{i});
    if (!other || other->map != keyframe.map || other->blind()) continue;
    if (!stranger && to_seconds(keyframe.t - other->t) > options_.history_time) break;
    if (stranger) {
      const SE3d& view = other->T_camera_world;
      if (std::any_of(views.begin(), views.end(), [&](const SE3d& v) { return same_view(v, view); }))
        continue;
      views.push_back(view);
    }
    ++asked;
    const SE3d T_predicted = other->T_camera_world * T_own_target;
    PlaceHints other_hints;
    if (gravity) {
      other_hints.gravity_world = *gravity;
      other_hints.gravity_camera = other->T_camera_world.rotation() * *gravity;
    }
    const double travelled = (center(other->T_camera_world) - center(keyframe.T_camera_world)).norm();
    double contradictions = 0;
    const Witness witness =
        ask(map, database_.image(*other), T_predicted, match.map, travelled, other_hints, &contradictions);
    if (witness == Witness::confirms) testimony.confirming.push_back(T_predicted);
    if (witness == Witness::doubts) testimony.doubting.push_back(T_predicted);
    if (witness == Witness::denies) testimony.denying.push_back(T_predicted);
    if (witness != Witness::silent) testimony.contradictions.push_back(contradictions);
    denials += witness == Witness::denies;
  }
  if (!stranger) {
    if (!convinced(testimony.confirming, denials, match)) return std::nullopt;
  } else {
    // Another place that one of these keyframes was verified at speaks against this one.
    for (const Claim& claim : claims_) {
      const Keyframe* other = map.find(claim.keyframe);
      if (!other || other->map != keyframe.map || claim.map != match.map) continue;
      const SE3d T_predicted = other->T_camera_world * T_own_target;
      if (other_place(claim.T_camera_world, T_predicted)) testimony.denying.push_back(T_predicted);
    }
    if (!convinced_of_stranger(testimony, match)) return std::nullopt;
  }
  return match;
}

std::optional<PlaceMatch> PlaceRecognizer::locate(const Map& map, const StereoFrame& frame,
                                                  const Vec3<double>* gravity_camera,
                                                  const Vec3<double>* gravity_world,
                                                  const SE3d* T_camera_odom) {
  Seen now{
      .image = database_.image(frame), .T_camera_odom = {}, .gravity_camera = {}, .match = {}, .groups = {}};
  if (T_camera_odom) now.T_camera_odom = *T_camera_odom;
  if (gravity_camera) now.gravity_camera = *gravity_camera;
  PlaceHints hints;
  if (gravity_world) hints.gravity_world = *gravity_world;
  hints.gravity_camera = now.gravity_camera;
  now.groups = database_.candidates(now.image, map);
  now.match = best_candidate(map, now.image, now.groups, hints, MapId{});
  while (!seen_.empty() && (to_seconds(now.image.t - seen_.front().image.t) > options_.history_time ||
                            seen_.front().image.t > now.image.t))
    seen_.pop_front();
  std::optional<PlaceMatch> match = now.match;
  if (match) {
    std::vector<SE3d> confirming{match->T_camera_world};
    int denials = 0;
    for (const Seen& other : seen_) {
      if (now.T_camera_odom && other.T_camera_odom) {
        const SE3d T_other_now = *other.T_camera_odom * now.T_camera_odom->inverse();
        hints.gravity_camera = other.gravity_camera;
        const SE3d T_predicted = T_other_now * match->T_camera_world;
        const Witness witness =
            ask(map, other.image, T_predicted, match->map, T_other_now.translation().norm(), hints);
        if (witness == Witness::confirms) confirming.push_back(T_predicted);
        denials += witness == Witness::denies;
      } else if (other.match && other.match->map == match->map) {
        const double dt = to_seconds(now.image.t - other.image.t);
        const SE3d T_now_other = match->T_camera_world * other.match->T_camera_world.inverse();
        if (T_now_other.translation().norm() <= options_.consistent_distance + options_.max_speed * dt &&
            degrees(T_now_other) <= options_.consistent_angle + options_.max_turn_rate * dt)
          confirming.push_back(other.match->T_camera_world);
        else
          ++denials;
      }
    }
    if (!convinced(confirming, denials, *match)) match.reset();
  }
  if (!match && options_.pool && gravity_world) match = locate_together(map, now, *gravity_world);
  remember(std::move(now));
  return match;
}

void PlaceRecognizer::remember(Seen&& now) {
  if (!seen_.empty()) {
    Seen& last = seen_.back();
    bool moved = to_seconds(now.image.t - last.image.t) > kSameFrameTime;
    if (now.T_camera_odom && last.T_camera_odom) {
      const SE3d T = *now.T_camera_odom * last.T_camera_odom->inverse();
      moved = T.translation().norm() > kSameFrameDistance || degrees(T) > kSameFrameAngle;
    }
    if (!moved) return;
  }
  seen_.push_back(std::move(now));
  if (seen_.size() > static_cast<std::size_t>(options_.history)) seen_.pop_front();
}

}  // namespace sweepkit
