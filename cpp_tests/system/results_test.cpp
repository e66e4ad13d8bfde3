// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/system/results.hpp"

#include <catch2/catch.hpp>
#include <cstring>
#include <fstream>
#include <nlohmann/json.hpp>
#include <sstream>

#include "scratch_folder.hpp"
#include "sweepkit/core/option_text.hpp"
#include "system/room.hpp"

using namespace sweepkit;

namespace {

std::string content(const std::filesystem::path& file) {
  std::ifstream stream(file, std::ios::binary);
  std::stringstream text;
  text << stream.rdbuf();
  return text.str();
}

std::size_t lines(const std::string& text) {
  return static_cast<std::size_t>(std::count(text.begin(), text.end(), '\n'));
}

}  // namespace

TEST_CASE("ResultWriter writes every file of a run", "[results]") {
  const ScratchFolder folder;
  folder.write("out/summary.json", "of an earlier run");
  SweeperOptions options;
  options.frontend.orb.count = 500;
  const std::filesystem::path out = folder / "out";
  ResultWriter writer(out);
  CHECK_FALSE(std::filesystem::exists(out / "summary.json"));
  Sweeper sweeper(Room().rig(), options, &writer);
  std::size_t written = 0;
  for (int i = 0; i < 16; ++i) {
    sweeper.feed(drive_images()[i]);
    const auto images = sweeper.images(written);
    writer.write(images);
    written += images.size();
    // As the run goes: all is in the file already.
    CHECK(lines(content(out / "trajectory_live.tum")) == static_cast<std::size_t>(i + 1));
  }
  CHECK(content(out / "events.jsonl").find("\"map_created\"") != std::string::npos);
  sweeper.finish();
  RunRecord record;
  record.options_json = options_to_json(list_options(options));
  record.recording.missing_sensors = {"imu0", "odom0"};
  record.ended = "end of recording";
  writer.finish(sweeper, record);

  const Trajectory live = read_tum(out / "trajectory_live.tum");
  const Trajectory odom = read_tum(out / "trajectory_odom.tum");
  const Trajectory optimized = read_tum(out / "trajectory_optimized.tum");
  REQUIRE(live.size() == 16);
  REQUIRE(odom.size() == 16);
  REQUIRE(optimized.size() == 16);
  const std::vector<TrackedImage> images = sweeper.images();
  for (std::size_t i = 0; i < 16; ++i) {
    CHECK(live[i].t == images[i].t);
    CHECK(optimized[i].t == images[i].t);
    CHECK((live[i].T_world_body.inverse() * images[i].T_map_body).log().norm() < 1e-7);
    CHECK((odom[i].T_world_body.inverse() * images[i].T_odom_body).log().norm() < 1e-7);
    CHECK((optimized[i].T_world_body.inverse() * sweeper.optimized_pose(images[i])).log().norm() < 1e-7);
  }

  // keyframes.tum: a keyframe's pose is its image's after all corrections.
  CHECK(content(out / "keyframes.tum").rfind("# map 0: ", 0) == 0);
  const Trajectory keyframes = read_tum(out / "keyframes.tum");
  CHECK(keyframes.size() == sweeper.map().keyframe_count());
  for (const StampedPose& keyframe : keyframes) {
    const auto at = std::find_if(optimized.begin(), optimized.end(),
                                 [&](const StampedPose& pose) { return pose.t == keyframe.t; });
    REQUIRE(at != optimized.end());
    CHECK((at->T_world_body.inverse() * keyframe.T_world_body).log().norm() < 1e-3);
  }

  // map.ply: header, then 16 bytes a point, each inside the room.
  const std::string ply = content(out / "map.ply");
  const std::string end = "end_header\n";
  const std::size_t head = ply.find(end) + end.size();
  const std::size_t count = sweeper.map().point_count();
  CHECK(ply.find("element vertex " + std::to_string(count) + "\n") < head);
  REQUIRE(ply.size() == head + 16 * count);
  REQUIRE(count > 100);
  std::size_t inside = 0;
  for (std::size_t i = 0; i < count; ++i) {
    float p[3];
    std::memcpy(p, ply.data() + head + 16 * i, sizeof(p));
    inside += p[0] > 0 && p[0] < 3.2F && std::abs(p[1]) < 2.2F && p[2] > -0.3F && p[2] < 1.8F;
  }
  CHECK(inside > count * 9 / 10);

  const std::string svg = content(out / "map.svg");
  CHECK(svg.rfind("<svg", 0) == 0);
  CHECK(svg.find("nan") == std::string::npos);
  CHECK(svg.find("inf") == std::string::npos);

  const auto summary = nlohmann::json::parse(content(out / "summary.json"));
  CHECK(summary["frames"] == 16);
  CHECK(summary["frames_lost"] == 0);
  CHECK(summary["maps"] == 1);
  CHECK(summary["path_m"].get<double>() == Approx(0.04 * 13).margin(0.03));
  CHECK(summary["options"]["frontend"]["orb"]["count"] == 500);
  CHECK(summary["recording"]["missing_sensors"] == nlohmann::json({"imu0", "odom0"}));
  CHECK(summary["peak_memory_mb"].get<double>() > 1);
  CHECK(summary["version"].get<std::string>().find('.') != std::string::npos);
  for (const char* stage : {"extract", "stereo", "track", "frame"}) {
    CHECK(summary["stages"][stage]["count"] == 16);
    CHECK(summary["stages"][stage]["median_ms"].get<double>() > 0);
    CHECK(summary["stages"][stage]["max_ms"] >= summary["stages"][stage]["median_ms"]);
  }
  CHECK(summary["stages"]["local_ba"]["count"] == summary["keyframes_made"]);
  CHECK_FALSE(summary["stages"].contains("loop"));
}

TEST_CASE("A run without any image has whole files too", "[results]") {
  const ScratchFolder folder;
  ResultWriter writer(folder / "out");
  Sweeper sweeper(Room().rig(), {}, &writer);
  sweeper.finish();
  writer.finish(sweeper, {});
  CHECK(content(folder / "out/trajectory_optimized.tum").empty());
  CHECK(content(folder / "out/keyframes.tum").empty());
  CHECK(content(folder / "out/map.ply").find("element vertex 0\n") != std::string::npos);
  CHECK(content(folder / "out/map.svg").find("nan") == std::string::npos);
  CHECK(nlohmann::json::parse(content(folder / "out/summary.json"))["frames"] == 0);
}

TEST_CASE("ResultWriter says where it cannot write", "[results]") {
  const ScratchFolder folder;
  folder.write("file", "in the way");
  CHECK_THROWS_AS(ResultWriter(folder / "file/out"), Error);

  // On a full disk an event does no harm in the thread that tells it; the next call of the owner says it.
  if (std::filesystem::exists("/dev/full")) {
    std::filesystem::create_directories(folder / "full");
    std::filesystem::create_symlink("/dev/full", folder / "full/events.jsonl");
    ResultWriter writer(folder / "full");
    CHECK_NOTHROW(writer.on_event(Event(1, "started")));
    CHECK_THROWS_AS(writer.write({}), Error);
  }
}
