// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
// Puts a robot into mapped flats at random moments of recordings and counts how often it knows where it is,
// does not know, or is wrong. The map has keyframes at their true poses, so that what is measured is place
// recognition and not mapping.
#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <numbers>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "sweepkit/core/option_text.hpp"
#include "sweepkit/core/random.hpp"
#include "sweepkit/data/recording.hpp"
#include "sweepkit/data/trajectory.hpp"
#include "sweepkit/map/map.hpp"
#include "sweepkit/match/projection.hpp"
#include "sweepkit/slam/frontend.hpp"
#include "sweepkit/slam/place_recognition.hpp"

namespace {

using namespace sweepkit;

constexpr double kDegree = std::numbers::pi / 180;

double degrees(const SE3d& T) { return T.rotation().angle() / kDegree; }

struct Options {
  std::string vocabulary = "tools/initial/orb.swv";
  int kidnaps = 100;
  double seconds = 3;
  int seed = 1;
  bool odometry = true;
  bool gravity = true;
  bool anywhere = false;
  bool put_down = false;
  bool verbose = false;
  PlaceRecognizerOptions recognizer;
};

// PATH or PATH@FROM-TO, seconds since the first image.
struct Part {
  std::string path;
  double from = 0, to = 1e9;

  explicit Part(std::string_view text) : path(text) {
    const std::size_t at = text.find('@');
    if (at == std::string_view::npos) return;
    path = text.substr(0, at);
    const std::string range(text.substr(at + 1));
    const std::size_t dash = range.find('-');
    from = std::stod(range.substr(0, dash));
    if (dash + 1 < range.size()) to = std::stod(range.substr(dash + 1));
  }
};

struct SeenFrames {
  StereoRig rig;
  std::vector<StereoFrame> frames;  // at their true poses
};

SeenFrames read_frames(const Part& part, double every) {
  const auto recording = open_recording(part.path);
  const Trajectory truth = read_trajectory(recording->info().truth);
  SeenFrames seen{recording->rig().stereo(), {}};
  Frontend frontend(seen.rig, {});
  std::optional<TimeNs> first;
  double last = -1e9;
  while (const auto sample = recording->next()) {
    const StereoImage* image = std::get_if<StereoImage>(&*sample);
    if (!image || image->left.empty() || image->right.empty()) continue;
    if (!first) first = image->t;
    const double t = to_seconds(image->t - *first);
    if (t < part.from || t > part.to || t < last + every) continue;
    const auto T_world_body = interpolate(truth, image->t);
    if (!T_world_body) continue;
    last = t;
    StereoFrame& frame = seen.frames.emplace_back();
    frame.t = image->t;
    frontend.extract(image->left.view, image->right.view);
    frontend.match(frame);
    frame.T_camera_world = (*T_world_body * seen.rig.T_body_camera()).inverse();
    frame.points.assign(frame.measurements.size(), PointId{});
  }
  return seen;
}

// Keyframes at true poses: points of neighbours observed again where they are found, and new ones.
class TrueMap {
 public:
  explicit TrueMap(const StereoRig& rig)
      : camera_{rig.focal(), rig.center().x(), rig.center().y(), rig.baseline()},
        view_(rig.bounds()),
        id_(map.add_map()) {}

  void add_if_new(const StereoFrame& frame) {
    if (last_.valid()) {
      const SE3d T = frame.T_camera_world * map.keyframe(last_).T_camera_world.inverse();
      if (T.translation().norm() < 0.25 && degrees(T) < 12) return;
    }
    Keyframe keyframe;
    keyframe.map = id_;
    keyframe.t = frame.t;
    keyframe.T_camera_world = frame.T_camera_world;
    keyframe.measurements = frame.measurements;
    keyframe.descriptors = frame.descriptors;
    keyframe.parent = last_;
    const KeyframeId id = map.add_keyframe(std::move(keyframe));
    observe_again(id, frame);
    for (std::uint32_t i = 0; i < frame.measurements.size(); ++i) {
      const Measurement& m = frame.measurements[i];
      if (map.keyframe(id).points[i].valid() || !m.stereo() || m.sigma_right > 0.2 * m.disparity()) continue;
      const Vec3<double> p_camera =
          camera_.depth(m.disparity()) *
          Vec3<double>((m.u - camera_.cx) / camera_.focal, (m.v - camera_.cy) / camera_.focal, 1);
      const PointId point = map.add_point(frame.T_camera_world.inverse() * p_camera, id, i);
      describe(point);
    }
    last_ = id;
  }

  Map map;

 private:
  void observe_again(KeyframeId id, const StereoFrame& frame) {
    const Vec3<double> center = frame.T_camera_world.inverse().translation();
    std::vector<PointId> asked;
    std::vector<ProjectionQuery> queries;
    std::vector<OrbDescriptor> descriptors;
    for (std::uint32_t k = 0; k < map.point_id_end(); ++k) {
      const MapPoint* point = map.find(PointId{k});
      if (!point) continue;
      const auto uvr = camera_.project_stereo(frame.T_camera_world * point->p_world);
      if (!uvr || uvr->x() < view_.u_min || uvr->x() > view_.u_max || uvr->y() < view_.v_min ||
          uvr->y() > view_.v_max)
        continue;
      const Vec3<double> to_camera = center - point->p_world;
      const double distance = to_camera.norm();
      if (distance < 0.8 * point->min_distance || distance > 1.2 * point->max_distance) continue;
      if (to_camera.dot(point->normal.cast<double>()) < 0.5 * distance) continue;
      const int octave = levels_.octave(point->max_distance, distance);
      asked.push_back(point->id);
      queries.push_back({.u = static_cast<float>(uvr->x()),
                         .v = static_cast<float>(uvr->y()),
                         .u_right = static_cast<float>(uvr->z()),
                         .radius = static_cast<float>(3 * levels_.scale(octave)),
                         .min_octave = octave - 1,
                         .max_octave = octave + 1});
      descriptors.push_back(point->descriptor);
    }
    std::vector<Match> matches(queries.size());
    matcher_.match(queries, descriptors, frame.grid, std::span<const Measurement>(frame.measurements),
                   frame.descriptors, matches);
    for (std::size_t k = 0; k < matches.size(); ++k)
      if (matches[k].found() &&
          map.add_observation(asked[k], id, static_cast<std::uint32_t>(matches[k].index)))
        describe(asked[k]);
  }

  void describe(PointId id) {
    const MapPoint& point = map.point(id);
    Vec3<double> normal = Vec3<double>::Zero();
    for (const Observation& o : point.observations)
      normal +=
          (map.keyframe(o.keyframe).T_camera_world.inverse().translation() - point.p_world).normalized();
    const Observation& first = point.observations.front();
    const Keyframe& keyframe = map.keyframe(first.keyframe);
    const double farthest = (keyframe.T_camera_world.inverse().translation() - point.p_world).norm() *
                            levels_.scale(keyframe.measurements[first.index].octave);
    const Observation& last = point.observations.back();
    const OrbDescriptor descriptor = map.keyframe(last.keyframe).descriptors[last.index];
    map.set_appearance(id, descriptor, normal.normalized().cast<float>(),
                       static_cast<float>(farthest / levels_.coarsest()), static_cast<float>(farthest));
  }

  RectifiedCamera camera_;
  StereoRig::Bounds view_;
  ScaleLevels levels_;
  MapId id_;
  KeyframeId last_;
  ProjectionMatcher matcher_{{.max_distance = 50}};
};

// What share of a frame's stereo points was seen before by keyframes within 2 m and 30 degrees: in their view
// and not behind something that they measured nearer.
class SeenBefore {
 public:
  SeenBefore(const Map& map, const RectifiedCamera& camera, const StereoRig::Bounds& view)
      : map_(map), camera_(camera), view_(view), grids_(map.keyframe_id_end()) {
    for (std::uint32_t k = 0; k < map.keyframe_id_end(); ++k)
      grids_[k].build(map.keyframe(KeyframeId{k}).measurements);
  }

  double operator()(const StereoFrame& frame) const {
    std::vector<std::uint32_t> near;
    for (std::uint32_t k = 0; k < map_.keyframe_id_end(); ++k) {
      const SE3d T = map_.keyframe(KeyframeId{k}).T_camera_world * frame.T_camera_world.inverse();
      if (T.translation().norm() < 2 && degrees(T) < 30) near.push_back(k);
    }
    int points = 0, seen = 0;
    for (const Measurement& m : frame.measurements) {
      if (!m.stereo() || m.sigma_right > 0.2 * m.disparity()) continue;
      ++points;
      const Vec3<double> p =
          camera_.depth(m.disparity()) *
          Vec3<double>((m.u - camera_.cx) / camera_.focal, (m.v - camera_.cy) / camera_.focal, 1);
      const Vec3<double> p_world = frame.T_camera_world.inverse() * p;
      seen += std::any_of(near.begin(), near.end(), [&](std::uint32_t k) { return sees(k, p_world); });
    }
    return points > 0 ? static_cast<double>(seen) / points : 0;
  }

 private:
  bool sees(std::uint32_t k, const Vec3<double>& p_world) const {
    constexpr float kBeside = 25;         // [px]
    constexpr double kNearerShare = 1.2;  // of the disparity
    const Keyframe& keyframe = map_.keyframe(KeyframeId{k});
    const auto uvr = camera_.project_stereo(keyframe.T_camera_world * p_world);
    if (!uvr || uvr->x() <= view_.u_min || uvr->x() >= view_.u_max || uvr->y() <= view_.v_min ||
        uvr->y() >= view_.v_max)
      return false;
    std::vector<std::int32_t> beside;
    grids_[k].query(static_cast<float>(uvr->x()), static_cast<float>(uvr->y()), kBeside, 0, 31, beside);
    int stereo = 0, nearer = 0;
    for (const std::int32_t i : beside) {
      const Measurement& other = keyframe.measurements[static_cast<std::size_t>(i)];
      if (!other.stereo()) continue;
      ++stereo;
      nearer += other.disparity() - 3 * other.sigma_right > kNearerShare * (uvr->x() - uvr->z());
    }
    return stereo == 0 || nearer < stereo;
  }

  const Map& map_;
  RectifiedCamera camera_;
  StereoRig::Bounds view_;
  std::vector<KeypointGrid> grids_;
};

// A view counts as mapped if so much of it was seen before; counts are given for each.
constexpr std::array<double, 4> kSeenShares = {0.3, 0.5, 0.7, 0.9};

struct Outcome {
  int right = 0, wrong = 0, unknown = 0;
  std::array<int, kSeenShares.size()> kidnaps_seen{}, right_seen{};  // with at least that share
  std::vector<double> seconds, errors_mm, call_ms;
  PlaceCounts counts;
};

double quantile(std::vector<double> values, double q) {
  if (values.empty()) return 0;
  std::sort(values.begin(), values.end());
  return values[static_cast<std::size_t>(q * static_cast<double>(values.size() - 1))];
}

// The first images after the robot was in the air: more than 3 cm above where it began, higher than any sill.
std::vector<bool> put_down(const std::vector<StereoFrame>& frames) {
  constexpr double kAir = 0.03;  // [m]
  const auto height = [](const StereoFrame& frame) {
    return frame.T_camera_world.inverse().translation().z();
  };
  std::vector<bool> out(frames.size(), false);
  for (std::size_t i = 1; i < frames.size(); ++i)
    out[i] =
        height(frames[i - 1]) > height(frames[0]) + kAir && height(frames[i]) <= height(frames[0]) + kAir;
  return out;
}

Outcome kidnap(const SeenFrames& mapped, const SeenFrames& queries, const Options& options) {
  TrueMap truth(mapped.rig);
  for (const StereoFrame& frame : mapped.frames) truth.add_if_new(frame);
  const StereoRig& rig = queries.rig;
  PlaceRecognizer recognizer({rig.focal(), rig.center().x(), rig.center().y(), rig.baseline()}, rig.bounds(),
                             {}, open_place_vocabulary(options.vocabulary), options.recognizer);
  recognizer.database().follow(truth.map);
  fmt::print(stderr, "{} keyframes, {} points, {:.1f} MB of words\n", truth.map.keyframe_count(),
             truth.map.point_count(), 1e-6 * static_cast<double>(recognizer.database().memory_bytes()));
  std::vector<std::size_t> starts;
  const SeenBefore seen_before(truth.map, {rig.focal(), rig.center().x(), rig.center().y(), rig.baseline()},
                               rig.bounds());
  std::size_t mapped_views = 0, asked_views = 0;
  const std::vector<bool> landed = put_down(queries.frames);
  std::vector<double> seen_share;
  for (std::size_t i = 0; i < queries.frames.size(); ++i) {
    seen_share.push_back(seen_before(queries.frames[i]));
    const bool is_mapped = seen_share.back() >= kSeenShares.front();
    if (options.put_down && !landed[i]) continue;
    ++asked_views;
    mapped_views += is_mapped;
    if (options.anywhere || is_mapped) starts.push_back(i);
  }
  fmt::print(stderr, "{} of {} views were seen before\n", mapped_views, asked_views);
  if (starts.empty()) return {};
  // The same moments whatever the recognizer does.
  Random random(static_cast<std::uint64_t>(options.seed));
  if (options.kidnaps > 0) {
    std::vector<std::size_t> drawn;
    drawn.reserve(static_cast<std::size_t>(options.kidnaps));
    for (int k = 0; k < options.kidnaps; ++k) drawn.push_back(starts[random.index(starts.size())]);
    starts = drawn;
  }
  Outcome outcome;
  const Vec3<double> gravity_world(0, 0, -1);
  for (std::size_t k = 0; k < starts.size(); ++k) {
    const std::size_t start = starts[k];
    for (std::size_t s = 0; s < kSeenShares.size(); ++s)
      outcome.kidnaps_seen[s] += seen_share[start] >= kSeenShares[s];
    recognizer.forget();
    std::optional<PlaceMatch> found;
    std::size_t i = start;
    for (; i < queries.frames.size(); ++i) {
      const StereoFrame& frame = queries.frames[i];
      if (to_seconds(frame.t - queries.frames[start].t) > options.seconds) break;
      // A tenth of a degree of error in gravity; odometry in a frame of its own.
      const Vec3<double> gravity_camera =
          SO3<double>::exp(Vec3<double>(random.normal(), random.normal(), random.normal()) * 0.1 * kDegree) *
          (frame.T_camera_world.rotation() * gravity_world);
      const SE3d T_camera_odom = frame.T_camera_world * SE3d::exp(Vec6<double>{1, 2, 0, 0, 0, 0.5});
      const auto begin = std::chrono::steady_clock::now();
      found = recognizer.locate(truth.map, frame, options.gravity ? &gravity_camera : nullptr,
                                options.gravity ? &gravity_world : nullptr,
                                options.odometry ? &T_camera_odom : nullptr);
      outcome.call_ms.push_back(
          std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - begin).count());
      if (found) break;
    }
    if (!found) {
      ++outcome.unknown;
      if (options.verbose)
        fmt::print("  {:3} frame {:4}: unknown, {} ({:.0f} % seen before)\n", k, start,
                   to_string(recognizer.last_rejection()), 100 * seen_share[start]);
      continue;
    }
    const StereoFrame& frame = queries.frames[i];
    const SE3d error = frame.T_camera_world * found->T_camera_world.inverse();
    const bool right = error.translation().norm() < 0.1 && degrees(error) < 5;
    ++(right ? outcome.right : outcome.wrong);
    for (std::size_t s = 0; s < kSeenShares.size(); ++s)
      outcome.right_seen[s] += right && seen_share[start] >= kSeenShares[s];
    outcome.seconds.push_back(to_seconds(frame.t - queries.frames[start].t));
    outcome.errors_mm.push_back(1e3 * error.translation().norm());
    if (options.verbose || !right)
      fmt::print(
          "  {:3} frame {:4}: {} after {:.1f} s, {:.0f} mm {:.2f} deg off, {} points ({} of {}), "
          "seen {:.2f}, back {:.2f}, contradicted {:.3f}, {} cells, {} confirm\n",
          k, start, right ? "right" : "WRONG", outcome.seconds.back(), outcome.errors_mm.back(),
          degrees(error), found->pairs.size(), found->found, found->predicted, found->seen_share,
          found->inverse_share, found->contradictions, found->cells.count(), found->confirmations);
  }
  outcome.counts = recognizer.counts();
  return outcome;
}

}  // namespace

int main(int argc, char** argv) {
  try {
    Options options;
    std::vector<Part> parts;
    for (int i = 1; i < argc; ++i) {
      const std::string_view text = argv[i];
      const auto value = [&] { return i + 1 < argc ? std::string(argv[++i]) : std::string(); };
      if (text == "--vocabulary")
        options.vocabulary = value();
      else if (text == "--kidnaps")
        options.kidnaps = std::atoi(value().c_str());
      else if (text == "--seconds")
        options.seconds = std::atof(value().c_str());
      else if (text == "--seed")
        options.seed = std::atoi(value().c_str());
      else if (text == "--set")
        set_option(list_options(options.recognizer), value(), "--set");
      else if (text == "--no-odometry")
        options.odometry = false;
      else if (text == "--no-gravity")
        options.gravity = false;
      else if (text == "--anywhere")
        options.anywhere = true;
      else if (text == "--put-down")
        options.put_down = true;
      else if (text == "--verbose")
        options.verbose = true;
      else
        parts.emplace_back(text);
    }
    if (parts.empty() || parts.size() % 2 != 0) {
      fmt::print(stderr,
                 "usage: kidnap [--kidnaps N] [--seconds S] [--seed N] [--no-odometry] [--no-gravity] "
                 "[--vocabulary FILE] [--set OPTION=VALUE] [--anywhere] [--put-down] [--verbose] "
                 "MAPPED QUERIES [MAPPED QUERIES ...]\n"
                 "N kidnaps at random moments, 0: one at each. A kidnap begins where 30 % of the view was "
                 "seen before, from within 2 m and 30 degrees, or --anywhere;\n"
                 "with --put-down only where the robot had been carried to.\n"
                 "Recordings with truth in one world frame; PATH@FROM-TO takes a part of one [s].\n");
      return 2;
    }
    fmt::print("{:<44} {:>5} {:>5} {:>7} {:>9} {:>9} {:>8} {:>8}\n", "mapped, asked", "right", "wrong",
               "unknown", "after s", "p95 s", "error mm", "call ms");
    for (std::size_t i = 0; i < parts.size(); i += 2) {
      const SeenFrames mapped = read_frames(parts[i], 0.2), queries = read_frames(parts[i + 1], 0);
      const Outcome o = kidnap(mapped, queries, options);
      const auto name = [](const std::string& path) { return path.substr(path.find_last_of('/') + 1); };
      fmt::print("{:<44} {:>5} {:>5} {:>7} {:>9.2f} {:>9.2f} {:>8.1f} {:>8.1f}\n",
                 name(parts[i].path) + ", " + name(parts[i + 1].path), o.right, o.wrong, o.unknown,
                 quantile(o.seconds, 0.5), quantile(o.seconds, 0.95), quantile(o.errors_mm, 0.5),
                 quantile(o.call_ms, 0.5));
      std::string reasons;
      for (std::size_t r = 1; r < kPlaceRejections; ++r)
        if (o.counts.rejected[r] > 0)
          reasons += fmt::format(" {} {},", to_string(static_cast<PlaceRejection>(r)), o.counts.rejected[r]);
      std::string seen;
      for (std::size_t s = 0; s < kSeenShares.size(); ++s)
        seen += fmt::format(" {:.0f} %: {} of {},", 100 * kSeenShares[s], o.right_seen[s], o.kidnaps_seen[s]);
      fmt::print("  right, of views with so much seen before:{}\n", seen.substr(0, seen.size() - 1));
      fmt::print("  {} images asked, {} candidates;{}\n", o.counts.queries, o.counts.candidates, reasons);
    }
  } catch (const Error& error) {
    fmt::print(stderr, "kidnap: {}\n", error.what());
    return 3;
  }
  return 0;
}
