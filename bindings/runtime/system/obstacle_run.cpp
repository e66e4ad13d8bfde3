// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/system/obstacle_run.hpp"

#include <bit>
#include <cmath>
#include <cstring>
#include <exception>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <numbers>
#include <set>

#include "canvas.hpp"
#include "sweepkit/core/option_text.hpp"
#include "sweepkit/core/version.hpp"
#include "sweepkit/data/image_file.hpp"

namespace sweepkit {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

constexpr double kDegree = std::numbers::pi / 180;
constexpr Color kNew{250, 220, 40}, kConfirmed{240, 60, 50}, kHole{70, 130, 255}, kHorizon{60, 210, 90};

Json list_of(const Vec3<double>& p) { return {p.x(), p.y(), p.z()}; }

Json json_of(const FloorBox& box) {
  return {{"centre", {box.centre.x(), box.centre.y()}},
          {"yaw_deg", box.yaw / kDegree},
          {"length", box.length},
          {"width", box.width},
          {"bottom", box.bottom},
          {"top", box.top}};
}

Json json_of(const StageTimes& times) {
  return {{"median_ms", times.median_ms},
          {"p95_ms", times.p95_ms},
          {"max_ms", times.max_ms},
          {"count", times.count}};
}

/// Times of a step, of which StageClock has no name.
class StepTimes {
 public:
  void add(double ms) { clock_.add(Stage::obstacles, ms); }
  StageTimes times() const { return clock_.times(Stage::obstacles); }

 private:
  StageClock clock_;
};

template <class T>
void append(std::string& bytes, T value) {
  char raw[sizeof(T)];
  std::memcpy(raw, &value, sizeof(T));
  if constexpr (std::endian::native == std::endian::big) std::reverse(raw, raw + sizeof(T));
  bytes.append(raw, sizeof(T));
}

void write_bytes(const fs::path& file, const std::string& bytes) {
  std::ofstream out(file, std::ios::binary);
  out << bytes;
  out.close();
  if (!out) throw Error(ErrorKind::io, file.string(), "cannot be written");
}

/// The points of all obstacle and hole pixels.
std::string ply_of(const ObstacleFrame& frame, const RectifiedCamera& camera,
                   const std::optional<SE3d>& T_odom_camera) {
  std::string points;
  std::size_t count = 0;
  for (int v = 0; v < frame.mask.height; ++v)
    for (int u = 0; u < frame.mask.width; ++u) {
      const auto label = static_cast<FloorLabel>(frame.mask(u, v));
      if (label != FloorLabel::obstacle && label != FloorLabel::hole) continue;
      const double scale = camera.baseline / (frame.disparity(u, v) * kDisparityUnit<std::int16_t>);
      Vec3<double> p(scale * (u - camera.cx), scale * (v - camera.cy), scale * camera.focal);
      if (T_odom_camera) p = *T_odom_camera * p;
      for (int k = 0; k < 3; ++k) append(points, static_cast<float>(p[k]));
      append(points, frame.mask(u, v));
      append(points, frame.regions(u, v));
      ++count;
    }
  return "ply\nformat binary_little_endian 1.0\ncomment frame " +
         std::string(T_odom_camera ? "odom" : "rectified left camera") +
         " [m]; label 2 obstacle, 3 hole; region 0 none, else number in obstacles.jsonl plus one\n"
         "element vertex " +
         std::to_string(count) +
         "\nproperty float x\nproperty float y\nproperty float z\nproperty uchar label\nproperty ushort "
         "region\nend_header\n" +
         points;
}

/// Outlines of what was found; boxes red once confirmed, yellow before; holes blue; the floor's horizon
/// green.
void write_picture(const fs::path& file, const ObstacleFrame& frame, const FloorDisparity& floor) {
  Canvas canvas(frame.left, 0.8);
  const auto& regions = frame.regions;
  std::vector<Color> colors(frame.obstacles.size(), kNew);
  for (std::size_t k = 0; k < colors.size(); ++k)
    if (frame.obstacles[k].kind == ObstacleKind::hole) colors[k] = kHole;
  for (const TrackedObstacle& thing : frame.tracked)
    if (thing.confirmed && thing.kind == ObstacleKind::obstacle && thing.last >= 0)
      colors[static_cast<std::size_t>(thing.last)] = kConfirmed;
  if (floor.along_v > 0) {
    const double at_left = -floor.at_origin / floor.along_v;
    const double at_right = -(floor.at_origin + floor.along_u * frame.left.width) / floor.along_v;
    canvas.line(0, at_left, frame.left.width, at_right, kHorizon);
  }
  for (int v = 1; v + 1 < regions.height; ++v)
    for (int u = 1; u + 1 < regions.width; ++u) {
      const int region = regions(u, v);
      if (region && (regions(u - 1, v) != region || regions(u + 1, v) != region ||
                     regions(u, v - 1) != region || regions(u, v + 1) != region))
        canvas.dot(u, v, colors[static_cast<std::size_t>(region - 1)]);
    }
  for (std::size_t k = 0; k < colors.size(); ++k) {
    const PixelBox& b = frame.obstacles[k].image;
    canvas.line(b.u_min - 2, b.v_min - 2, b.u_max + 2, b.v_min - 2, colors[k]);
    canvas.line(b.u_min - 2, b.v_max + 2, b.u_max + 2, b.v_max + 2, colors[k]);
    canvas.line(b.u_min - 2, b.v_min - 2, b.u_min - 2, b.v_max + 2, colors[k]);
    canvas.line(b.u_max + 2, b.v_min - 2, b.u_max + 2, b.v_max + 2, colors[k]);
  }
  canvas.write(file);
}

class Run {
 public:
  Run(const ObstacleRunOptions& options, const ObstacleHooks& hooks)
      : options_(options),
        hooks_(hooks),
        recording_(open_recording(options.data_path, options.recording)),
        rig_(recording_->rig().stereo()),
        detector_(rig_, options.floor.seed(recording_->rig()), options.detector),
        odometry_(recording_->rig().motion(), options.odometry) {
    if (options_.save_path.empty()) return;
    const fs::path folder = options_.save_path;
    for (const char* name : {"masks", "clouds", "pictures"}) fs::create_directories(folder / name);
    lines_.open(folder / "obstacles.jsonl", std::ios::binary);
    if (!lines_) throw Error(ErrorKind::io, (folder / "obstacles.jsonl").string(), "cannot be written");
  }

  ObstacleRunResult operator()() {
    std::exception_ptr damage;
    try {
      play();
    } catch (const Error&) {
      damage = std::current_exception();
    }
    result_.confirmed = static_cast<std::int64_t>(confirmed_.size());
    result_.times = all_.times();
    if (!options_.save_path.empty()) write_summary(fs::path(options_.save_path) / "summary.json");
    if (damage) std::rethrow_exception(damage);
    return result_;
  }

 private:
  void play() {
    const auto total = static_cast<std::int64_t>(recording_->info().images);
    for (;;) {
      if (hooks_.stop && hooks_.stop()) {
        result_.stopped = true;
        return;
      }
      const std::optional<Sample> sample = recording_->next();
      if (!sample) return;
      if (const auto* imu = std::get_if<ImuSample>(&*sample)) odometry_.add(*imu);
      if (const auto* wheels = std::get_if<WheelSample>(&*sample)) odometry_.add(*wheels);
      if (const auto* image = std::get_if<StereoImage>(&*sample)) {
        look(*image);
        if (hooks_.progress) hooks_.progress(result_.frames + result_.frames_missing, total);
      }
    }
  }

  std::optional<SE3d> T_odom_camera(TimeNs t) {
    if (!odometry_.usable()) return std::nullopt;
    if (!odometry_.started()) odometry_.start(t);
    odometry_.advance(t);
    odometry_.take_events();
    return odometry_.pose().T * rig_.T_body_camera();
  }

  void look(const StereoImage& image) {
    ObstaclePose pose;
    pose.T_odom_camera = T_odom_camera(image.t);
    if (image.left.empty() || image.right.empty()) {
      ++result_.frames_missing;
      return;
    }
    const ObstacleFrame& frame = detector_.detect(image.t, image.left.view, image.right.view, pose);
    ++result_.frames;
    result_.planes_measured += frame.plane.measured();
    for (const Obstacle& o : frame.obstacles)
      ++(o.kind == ObstacleKind::hole ? result_.holes : result_.obstacles);
    for (const TrackedObstacle& thing : frame.tracked)
      if (thing.confirmed) confirmed_.insert(thing.id);
    all_.add(frame.times.total());
    disparity_.add(frame.times.disparity);
    plane_.add(frame.times.plane);
    mask_.add(frame.times.mask);
    things_.add(frame.times.obstacles);
    if (hooks_.frame) hooks_.frame(frame);
    if (options_.save_path.empty()) return;
    write_line(frame, pose.T_odom_camera);
    if (next_ && image.t < *next_) return;
    next_ = image.t + from_seconds(options_.every);
    const fs::path folder = options_.save_path;
    const std::string stem = std::to_string(image.t);
    GrayImage shown(frame.mask.width, frame.mask.height);
    for (int v = 0; v < shown.height(); ++v)
      for (int u = 0; u < shown.width(); ++u) shown(u, v) = static_cast<std::uint8_t>(85 * frame.mask(u, v));
    write_png(folder / "masks" / (stem + ".png"), std::as_const(shown).view());
    write_bytes(folder / "clouds" / (stem + ".ply"), ply_of(frame, detector_.camera(), pose.T_odom_camera));
    write_picture(folder / "pictures" / (stem + ".png"), frame,
                  frame.plane.plane.disparity(detector_.camera()));
  }

  void write_line(const ObstacleFrame& frame, const std::optional<SE3d>& T_odom_camera) {
    const GroundPlaneResult& plane = frame.plane;
    Json line = {{"t", to_seconds(frame.t)},
                 {"stamp", frame.t},
                 {"plane",
                  {{"state", to_string(plane.state)},
                   {"reason", to_string(plane.reason)},
                   {"pitch_down_deg", pitch_down(plane.plane) / kDegree},
                   {"roll_deg", roll(plane.plane) / kDegree},
                   {"height_m", plane.plane.height}}}};
    Json obstacles = Json::array(), tracked = Json::array();
    for (const Obstacle& o : frame.obstacles) {
      Json entry = {{"kind", to_string(o.kind)},
                    {"p_camera", list_of(o.p_camera)},
                    {"sigma_m", std::sqrt(o.covariance.trace())},
                    {"distance_m", o.distance},
                    {"box", json_of(o.box)},
                    {"pixels", o.pixels},
                    {"clear", o.clear},
                    {"image", {o.image.u_min, o.image.v_min, o.image.u_max, o.image.v_max}}};
      if (T_odom_camera) entry["p_odom"] = list_of(*T_odom_camera * o.p_camera);
      obstacles.push_back(std::move(entry));
    }
    for (const TrackedObstacle& thing : frame.tracked)
      tracked.push_back({{"id", thing.id},
                         {"kind", to_string(thing.kind)},
                         {"confirmed", thing.confirmed},
                         {"confidence", thing.confidence()},
                         {"hits", thing.hits},
                         {"seen", thing.last},
                         {"p_odom", list_of(thing.p_world)},
                         {"box", json_of(thing.box)}});
    line["obstacles"] = std::move(obstacles);
    line["tracked"] = std::move(tracked);
    lines_ << line.dump() << '\n';
    if (!lines_)
      throw Error(ErrorKind::io, (fs::path(options_.save_path) / "obstacles.jsonl").string(),
                  "cannot be written");
  }

  void write_summary(const fs::path& file) {
    ObstacleRunOptions used = options_;
    const Json summary = {{"version", version()},
                          {"recording", recording_->info().path.string()},
                          {"missing_sensors", recording_->info().missing_sensors},
                          {"frames", result_.frames},
                          {"frames_missing", result_.frames_missing},
                          {"planes_measured", result_.planes_measured},
                          {"obstacles", result_.obstacles},
                          {"holes", result_.holes},
                          {"confirmed", result_.confirmed},
                          {"stages",
                           {{"obstacles", json_of(all_.times())},
                            {"obstacles.disparity", json_of(disparity_.times())},
                            {"obstacles.plane", json_of(plane_.times())},
                            {"obstacles.mask", json_of(mask_.times())},
                            {"obstacles.things", json_of(things_.times())}}},
                          {"options", Json::parse(options_to_json(list_options(used)))}};
    write_bytes(file, summary.dump(2, ' ', false, Json::error_handler_t::replace) + "\n");
  }

  const ObstacleRunOptions options_;
  const ObstacleHooks& hooks_;
  std::unique_ptr<Recording> recording_;
  const StereoRig rig_;
  ObstacleDetector detector_;
  OdometryBridge odometry_;
  std::ofstream lines_;
  std::optional<TimeNs> next_;
  std::set<std::int64_t> confirmed_;
  StepTimes all_, disparity_, plane_, mask_, things_;
  ObstacleRunResult result_;
};

}  // namespace

ObstacleRunResult detect_obstacles(const ObstacleRunOptions& options, const ObstacleHooks& hooks) {
  check_options(options);
  if (options.data_path.empty()) throw Error(ErrorKind::option, "data_path", "must be given");
  if (options.only_obs_det == 0)
    throw Error(ErrorKind::option, "only_obs_det",
                "must be 1: objects with classes are not available, only obstacles", "0");
  return Run(options, hooks)();
}

}  // namespace sweepkit
