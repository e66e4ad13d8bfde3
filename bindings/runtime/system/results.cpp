// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/system/results.hpp"

#include <fmt/format.h>

#include <bit>
#include <cmath>
#include <cstring>
#include <fstream>
#include <nlohmann/json.hpp>
#include <numbers>
#include <utility>

#include "sweepkit/core/memory.hpp"
#include "sweepkit/core/version.hpp"

namespace sweepkit {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

constexpr const char* kFinalFiles[] = {"trajectory_optimized.tum",
                                       "keyframes.tum",
                                       "map.ply",
                                       "map.svg",
                                       "summary.json",
                                       "atlas.swk",
                                       "grid.yaml",
                                       "grid.pgm",
                                       "grid.png"};

fs::path prepared(fs::path folder) {
  std::error_code error;
  fs::create_directories(folder, error);
  if (error) throw Error(ErrorKind::io, folder.string(), "cannot be made: " + error.message());
  for (const char* name : kFinalFiles) fs::remove(folder / name, error);
  return folder;
}

// Whoever reads the file meanwhile sees the old one or the new one, never a part.
void write_whole(const fs::path& file, const std::string& content) {
  const fs::path part = file.string() + ".part";
  {
    std::ofstream stream(part, std::ios::binary);
    stream.write(content.data(), static_cast<std::streamsize>(content.size()));
    stream.close();
    if (!stream) throw Error(ErrorKind::io, part.string(), "cannot be written");
  }
  std::error_code error;
  fs::rename(part, file, error);
  if (error) throw Error(ErrorKind::io, file.string(), "cannot be written: " + error.message());
}

template <class T>
void append_little_endian(std::string& bytes, T value) {
  char raw[sizeof(T)];
  std::memcpy(raw, &value, sizeof(T));
  if constexpr (std::endian::native == std::endian::big) std::reverse(raw, raw + sizeof(T));
  bytes.append(raw, sizeof(T));
}

std::string text_of(std::span<const StampedPose> trajectory) {
  std::string text;
  for (const StampedPose& pose : trajectory) text += tum_line(pose);
  return text;
}

Json to_json(const StageTimes& times) {
  return {{"median_ms", times.median_ms},
          {"p95_ms", times.p95_ms},
          {"max_ms", times.max_ms},
          {"count", times.count}};
}

constexpr double kDegrees = 180 / std::numbers::pi;

Json direction_json(const Sweeper& sweeper) {
  const auto found = sweeper.main_direction();
  if (!found) return nullptr;
  return {{"angle_deg", found->run_angle * kDegrees},
          {"confidence", found->confidence},
          {"window_begin", to_seconds(found->window_begin)},
          {"window_angle_deg", found->angle * kDegrees}};
}

Json places_json(const PlaceCounts& counts) {
  Json rejected = Json::object();
  for (std::size_t i = 1; i < kPlaceRejections; ++i)
    if (counts.rejected[i] > 0)
      rejected[std::string(to_string(static_cast<PlaceRejection>(i)))] = counts.rejected[i];
  return {{"queries", counts.queries},
          {"candidates", counts.candidates},
          {"accepted", counts.accepted},
          {"rejected", rejected}};
}

// What was known of the sensors that do not see, at the last image.
Json motion_json(const Sweeper& sweeper) {
  const auto state = sweeper.navigation();
  if (!state) return nullptr;
  using Place = NavigationState;
  const auto sigma = [&](int place) { return std::sqrt(state->covariance(place, place)); };
  const auto list = [](const Vec3<double>& v) { return Json::array({v.x(), v.y(), v.z()}); };
  const Vec3<double> scales = state->wheel_scales.array().exp();
  return {{"gyro_bias_deg_s", list(state->gyro_bias * kDegrees)},
          {"accel_bias_m_s2", list(state->accel_bias)},
          {"up", list(state->up)},
          {"up_sigma_deg", std::hypot(sigma(Place::kUp), sigma(Place::kUp + 1)) * kDegrees},
          {"wheel_radius_left_over_nominal", scales[0]},
          {"wheel_radius_right_over_nominal", scales[1]},
          {"track_width_over_nominal", scales[2]},
          {"wheel_sigmas",
           Json::array({sigma(Place::kWheels), sigma(Place::kWheels + 1), sigma(Place::kWheels + 2)})}};
}

}  // namespace

ResultWriter::ResultWriter(fs::path folder)
    : folder_(prepared(std::move(folder))),
      events_(folder_ / "events.jsonl"),
      live_(folder_ / "trajectory_live.tum"),
      odom_(folder_ / "trajectory_odom.tum") {}

void ResultWriter::on_event(const Event& event) {
  try {
    events_.on_event(event);
  } catch (...) {
    const std::scoped_lock lock(mutex_);
    if (!event_error_) event_error_ = std::current_exception();
  }
}

void ResultWriter::rethrow_event_error() {
  const std::scoped_lock lock(mutex_);
  if (event_error_) std::rethrow_exception(event_error_);
}

void ResultWriter::write(std::span<const TrackedImage> images) {
  rethrow_event_error();
  if (images.empty()) return;
  for (const TrackedImage& image : images) {
    live_.write({image.t, image.T_map_body});
    odom_.write({image.t, image.T_odom_body});
  }
  live_.flush();
  odom_.flush();
}

void ResultWriter::finish(const Sweeper& sweeper, const RunRecord& record) {
  rethrow_event_error();
  const Trajectory path = optimized_trajectory(sweeper);
  const SE3d& T_body_camera = sweeper.rig().T_body_camera();
  write_whole(folder_ / "trajectory_optimized.tum", text_of(path));
  write_whole(folder_ / "keyframes.tum", keyframes_tum(sweeper.map(), T_body_camera));
  write_whole(folder_ / "map.ply", map_ply(sweeper.map()));
  write_whole(folder_ / "map.svg", map_svg(sweeper.map(), T_body_camera, path));
  if (const auto grid = sweeper.grid()) write_grid_results(folder_, *grid, path);
  write_whole(folder_ / "summary.json", summary_json(sweeper, record));
}

Trajectory optimized_trajectory(const Sweeper& sweeper) {
  Trajectory trajectory;
  for (const TrackedImage& image : sweeper.images())
    trajectory.push_back({image.t, sweeper.optimized_pose(image)});
  return trajectory;
}

std::string keyframes_tum(const Map& map, const SE3d& T_body_camera) {
  std::string text;
  for (const MapId id : map.maps()) {
    std::string lines;
    int count = 0;
    for (std::uint32_t k = 0; k < map.keyframe_id_end(); ++k) {
      const Keyframe* keyframe = map.find(KeyframeId{k});
      if (!keyframe || keyframe->map != id) continue;
      ++count;
      lines += tum_line({keyframe->t, (T_body_camera * keyframe->T_camera_world).inverse()});
    }
    text += fmt::format("# map {}: {} keyframes\n{}", id.value, count, lines);
  }
  return text;
}

std::string map_ply(const Map& map) {
  std::string bytes = fmt::format(
      "ply\nformat binary_little_endian 1.0\ncomment points of the map [m]\nelement vertex {}\n"
      "property float x\nproperty float y\nproperty float z\nproperty int observations\nend_header\n",
      map.point_count());
  for (std::uint32_t i = 0; i < map.point_id_end(); ++i) {
    const MapPoint* point = map.find(PointId{i});
    if (!point) continue;
    for (int k = 0; k < 3; ++k) append_little_endian(bytes, static_cast<float>(point->p_world[k]));
    append_little_endian(bytes, static_cast<std::int32_t>(point->observations.size()));
  }
  return bytes;
}

std::string summary_json(const Sweeper& sweeper, const RunRecord& record) {
  const SweeperCounts counts = sweeper.counts();
  const Map& map = sweeper.map();
  Json stages = Json::object();
  for (std::size_t i = 0; i < kStageNames.size(); ++i) {
    const auto stage = static_cast<Stage>(i);
    const StageTimes times = stage == Stage::read ? record.read : sweeper.stage_clock().times(stage);
    if (times.count > 0) stages[std::string(kStageNames[i])] = to_json(times);
  }
  Json libraries = Json::object();
  for (const auto& [name, number] : library_versions()) libraries[name] = number;
  const Json summary = {
      {"version", version()},
      {"libraries", libraries},
      {"recording",
       {{"format", record.recording.format},
        {"path", record.recording.path.string()},
        {"images", record.recording.images},
        {"seconds", to_seconds(record.recording.end - record.recording.begin)},
        {"missing_sensors", record.recording.missing_sensors}}},
      {"ended", record.ended},
      {"frames", counts.images},
      {"frames_lost", counts.images_lost},
      {"frames_dropped", counts.images_dropped},
      {"frames_missing_a_camera", counts.images_missing},
      {"samples_dropped", counts.samples_dropped},
      {"imu_samples", counts.imu_samples},
      {"wheel_samples", counts.wheel_samples},
      {"maps", map.maps().size()},
      {"maps_joined", counts.maps_joined},
      {"loops_closed", counts.loops_closed},
      {"loops_rejected", counts.loops_rejected},
      {"places", places_json(sweeper.place_counts())},
      {"keyframes", map.keyframe_count()},
      {"keyframes_made", counts.keyframes_made},
      {"points", map.point_count()},
      {"path_m", path_length(optimized_trajectory(sweeper))},
      {"main_direction", direction_json(sweeper)},
      {"motion", motion_json(sweeper)},
      {"seconds", record.seconds},
      {"peak_memory_mb", peak_memory_mb()},
      {"stages", stages},
      {"options", record.options_json.empty() ? Json::object() : Json::parse(record.options_json)}};
  return summary.dump(2, ' ', false, Json::error_handler_t::replace) + "\n";
}

}  // namespace sweepkit
