// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/system/obstacle_run.hpp"

#include <catch2/catch.hpp>
#include <cstdlib>
#include <fstream>
#include <iterator>

#include "scratch_folder.hpp"
#include "sweepkit/core/error.hpp"
#include "sweepkit/data/image_file.hpp"
#include "sweepkit/system/obstacle_stage.hpp"

using namespace sweepkit;
namespace fs = std::filesystem;

namespace {

std::optional<fs::path> dev01() {
  const char* data = std::getenv("SWEEPKIT_DATA");
  if (!data) {
    WARN("skipped: SWEEPKIT_DATA is unset");
    return std::nullopt;
  }
  return fs::path(data) / "sweephome/dev01";
}

std::string text_of(const fs::path& file) {
  std::ifstream in(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

}  // namespace

TEST_CASE("obstacles of a recording are found and written, twice the same") {
  const auto data = dev01();
  if (!data) return;
  const ScratchFolder scratch;
  ObstacleRunOptions options;
  options.data_path = data->string();
  options.save_path = (scratch.path() / "a").string();
  options.recording.start = 4;
  options.recording.duration = 0.7;
  options.every = 0.5;
  std::int64_t seen = 0;
  ObstacleHooks hooks;
  hooks.frame = [&](const ObstacleFrame& frame) { seen += frame.mask.width == 640; };
  const ObstacleRunResult result = detect_obstacles(options, hooks);
  CHECK(result.frames == 8);
  CHECK(seen == 8);
  CHECK(result.planes_measured >= 6);
  CHECK(result.obstacles >= 8);
  CHECK(result.confirmed >= 1);
  CHECK(result.times.count == 8);
  const fs::path a = options.save_path;
  CHECK(fs::exists(a / "summary.json"));
  for (const char* kind : {"masks", "clouds", "pictures"})
    CHECK(std::distance(fs::directory_iterator(a / kind), {}) == 2);
  const SharedGray mask = read_gray(fs::directory_iterator(a / "masks")->path());
  CHECK(mask.view.width == 640);
  CHECK(mask.view.height == 400);
  const std::string ply = text_of(fs::directory_iterator(a / "clouds")->path());
  CHECK(ply.rfind("ply\nformat binary_little_endian", 0) == 0);
  const auto vertices = std::stoul(ply.substr(ply.find("element vertex ") + 15));
  CHECK(vertices > 1000);
  CHECK(ply.size() - (ply.find("end_header\n") + 11) == 15 * vertices);

  options.save_path = (scratch.path() / "b").string();
  detect_obstacles(options);
  CHECK(text_of(a / "obstacles.jsonl") == text_of(scratch.path() / "b/obstacles.jsonl"));

  const auto stopped = detect_obstacles(options, {[] { return true; }, {}, {}});
  CHECK(stopped.stopped);
  CHECK(stopped.frames == 0);
}

TEST_CASE("wrong options of an obstacle run are refused") {
  ObstacleRunOptions options;
  CHECK_THROWS_AS(detect_obstacles(options), Error);
  options.data_path = "/nowhere";
  options.only_obs_det = 0;
  CHECK_THROWS_WITH(detect_obstacles(options), Catch::Contains("objects with classes are not available"));
  options.only_obs_det = 1;
  options.detector.obstacles.min_height = 0;
  CHECK_THROWS_WITH(detect_obstacles(options), Catch::Contains("min_height"));
}

TEST_CASE("without wheels the camera's height must be told") {
  FloorMountingOptions floor;
  CHECK_THROWS_WITH(floor.seed({}), Catch::Contains("floor.camera_height"));
  floor.camera_height = 0.2;
  floor.pitch_down = 10;
  const GroundPlane plane = floor.seed({}).plane;
  CHECK(plane.height == Approx(0.2));
  CHECK(pitch_down(plane) == Approx(0.17453293));
}

TEST_CASE("a stage gives in line what the detector gives, and never waits in real time") {
  const auto data = dev01();
  if (!data) return;
  RecordingOptions read;
  read.start = 4;
  read.duration = 0.4;
  const auto recording = open_recording(*data, read);
  const StereoRig rig = recording->rig().stereo();
  const GroundPlaneSeed seed = FloorMountingOptions().seed(recording->rig());
  std::vector<StereoImage> images;
  while (const auto sample = recording->next())
    if (const auto* image = std::get_if<StereoImage>(&*sample)) images.push_back(*image);
  REQUIRE(images.size() == 5);

  StageClock clock;
  ObstacleStage inline_stage(rig, seed, {}, false, &clock);
  CHECK(inline_stage.latest() == nullptr);
  ObstacleDetector detector(rig, seed);
  for (const StereoImage& image : images) {
    inline_stage.feed(image, SE3d());
    ObstaclePose pose;
    pose.T_odom_camera = rig.T_body_camera();
    const ObstacleFrame& frame = detector.detect(image.t, image.left.view, image.right.view, pose);
    const auto report = inline_stage.latest();
    REQUIRE(report);
    CHECK(report->t == image.t);
    REQUIRE(report->obstacles.size() == frame.obstacles.size());
    for (std::size_t i = 0; i < report->obstacles.size(); ++i)
      CHECK(report->obstacles[i].p_camera == frame.obstacles[i].p_camera);
    CHECK(report->tracked.size() == frame.tracked.size());
  }
  CHECK(clock.times(Stage::obstacles).count == 5);
  // Out of order, or one side only: counted, nothing else.
  inline_stage.feed(images[0], SE3d());
  inline_stage.feed({images[4].t + 1, images[4].left, {}}, SE3d());
  CHECK(inline_stage.counts().images == 5);
  CHECK(inline_stage.counts().skipped == 2);

  ObstacleStage stage(rig, seed, {}, true);
  for (const StereoImage& image : images) stage.feed(image, SE3d());
  stage.finish();
  // The newest is never the one that is skipped.
  REQUIRE(stage.latest());
  CHECK(stage.latest()->t == images.back().t);
  CHECK(stage.counts().images + stage.counts().skipped == 5);
}
