// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/data/simulate.hpp"

#include <sys/resource.h>

#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <csignal>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <map>
#include <string>

#include "data/error_text.hpp"
#include "scratch_folder.hpp"
#include "sweepkit/data/recording.hpp"
#include "sweepkit/data/trajectory.hpp"

using namespace sweepkit;
namespace fs = std::filesystem;

namespace {

const std::string kRoom = R"(
name: box
rooms:
  - {name: room, rect: [0, 0, 4, 3], floor: oak, walls: wallpaper}
objects:
  - {kind: cabinet, at: [2, 2.6], size: [1.0, 0.4, 0.9]}
  - {kind: carton, at: [3.3, 1.6], yaw: 20, size: [0.4, 0.3, 0.3]}
lights:
  - {at: [2, 1.5, 2.3], power: 4}
)";

const std::string kSmall = R"(
sensors:
  cameras:
    width: 96
    height: 64
    left: {intrinsics: [60, 60, 47, 32]}
    right: {intrinsics: [60, 60, 48, 31]}
)";

const std::string kDrive = R"(
drive:
  start: [1, 1, 10]
  steps:
    - stand: 0.5
    - drive: [[2.2, 1.1]]
)";

struct Made {
  SimulatedScene scene;
  SimulationOptions options;
};

Made made_of(const std::string& text) {
  Made m;
  m.options.renderer.light_rays = 8;
  m.options.renderer.light_texel = 0.1;
  m.scene = parse_simulated_scene(text, "scene.yaml", m.options);
  return m;
}

std::string refused(const std::string& text) {
  return error_text([&] { made_of(text); });
}

std::map<std::string, std::string> files_of(const fs::path& folder) {
  std::map<std::string, std::string> files;
  for (const auto& entry : fs::recursive_directory_iterator(folder)) {
    if (!entry.is_regular_file()) continue;
    std::ifstream stream(entry.path(), std::ios::binary);
    files[fs::relative(entry.path(), folder).string()] =
        std::string(std::istreambuf_iterator<char>(stream), {});
  }
  return files;
}

}  // namespace

TEST_CASE("one seed gives the same files whatever the number of threads", "[simulate]") {
  const ScratchFolder folder;
  Made m = made_of(kRoom + kSmall + kDrive +
                   "events:\n  - {kind: missing, start: 0.2, seconds: 1, sensor: left, share: 0.5}\n");
  m.options.duration = 1.5;
  m.options.depth_every = 5;
  const auto run = [&](const char* name, int threads, int seed) {
    m.options.save_path = (folder / name).string();
    m.options.renderer.threads = threads;
    m.options.seed = seed;
    simulate(m.scene, m.options);
    return files_of(folder / name);
  };
  const auto one = run("one", 1, 4), three = run("three", 3, 4), other = run("other", 2, 5);
  REQUIRE(one.size() > 30);
  REQUIRE(one.size() == three.size());
  for (const auto& [name, bytes] : one) {
    CAPTURE(name);
    REQUIRE(three.count(name) == 1);
    CHECK(three.at(name) == bytes);
  }
  CHECK(other.at("mav0/imu0/data.csv") != one.at("mav0/imu0/data.csv"));
  CHECK(other.at("mav0/cam1/data/1700000000050000000.png") !=
        one.at("mav0/cam1/data/1700000000050000000.png"));
}

TEST_CASE("what is written reads back as the recording and its truth", "[simulate]") {
  const ScratchFolder folder;
  Made m = made_of(kRoom + kSmall + kDrive);
  m.options.save_path = (folder / "made").string();
  m.options.duration = 2.0;
  m.options.depth_every = 4;
  const SimulationResult result = simulate(m.scene, m.options);
  CHECK(result.frames == 20);
  for (const char* name :
       {"truth.yaml", "floor_occupancy.png", "floor_occupancy.yaml", "plan.svg", "contact_sheet.png"})
    CHECK(fs::exists(folder / "made" / name));

  const auto recording = open_recording(folder / "made");
  const Rig& rig = recording->rig();
  CHECK(rig.has_stereo());
  const Rig meant = m.options.sensors.rig();
  CHECK((rig.left->T_body_camera.matrix() - meant.left->T_body_camera.matrix()).norm() < 1e-9);
  CHECK((rig.wheels->T_body_base.matrix() - meant.wheels->T_body_base.matrix()).norm() < 1e-9);
  int images = 0, imu = 0, wheels = 0;
  while (const auto sample = recording->next()) {
    images += std::holds_alternative<StereoImage>(*sample);
    imu += std::holds_alternative<ImuSample>(*sample);
    wheels += std::holds_alternative<WheelSample>(*sample);
  }
  CHECK(images == 20);
  CHECK(imu == 401);
  CHECK(wheels == 101);

  const Trajectory truth = read_trajectory(folder / "made");
  CHECK(truth.size() == 401);
  const FloorPlan plan(m.scene.scene);
  // Truth is of the body, whose place on the base the files tell.
  const SE3d start = truth.front().T_world_body * rig.wheels->T_body_base;
  CHECK((start.translation() - Vec3<double>(1, 1, 0)).norm() < 1e-6);
}

TEST_CASE("JPEG images are written on request", "[simulate]") {
  const ScratchFolder folder;
  Made m = made_of(kRoom + kSmall + kDrive);
  m.options.save_path = (folder / "made").string();
  m.options.duration = 0.3;
  m.options.format = ImageFormat::jpeg;
  simulate(m.scene, m.options);
  CHECK(fs::exists(folder / "made/mav0/cam0/data/1700000000050000000.jpg"));
  CHECK(open_recording(folder / "made")->info().images == 3);
}

TEST_CASE("lost samples are absent, late ones late", "[simulate]") {
  const ScratchFolder folder;
  Made m = made_of(kRoom + kSmall + kDrive + R"(
events:
  - {kind: missing, start: 0.5, seconds: 0.5, sensor: cameras}
  - {kind: missing, start: 1.0, seconds: 0.5, sensor: imu}
  - {kind: late, start: 0.6, seconds: 0.2, sensor: wheels, delay: 0.013}
)");
  m.options.save_path = (folder / "made").string();
  m.options.duration = 2.0;
  simulate(m.scene, m.options);
  const auto recording = open_recording(folder / "made");
  int images = 0, imu = 0, late = 0;
  while (const auto sample = recording->next()) {
    images += std::holds_alternative<StereoImage>(*sample);
    imu += std::holds_alternative<ImuSample>(*sample);
    late += std::holds_alternative<WheelSample>(*sample) && stamp(*sample) % 20'000'000 != 0;
  }
  CHECK(images == 15);
  CHECK(imu == 401 - 100);
  CHECK(late == 10);
}

TEST_CASE("a simulated recording is replaced, anything else is left alone", "[simulate]") {
  const ScratchFolder folder;
  Made m = made_of(kRoom + kSmall + kDrive);
  m.options.save_path = (folder / "made").string();
  m.options.duration = 0.2;
  simulate(m.scene, m.options);
  m.options.duration = 0.4;
  simulate(m.scene, m.options);
  CHECK(open_recording(folder / "made")->info().images == 4);
  CHECK(!fs::exists(folder / "made.partial"));

  fs::create_directory(folder / "precious");
  std::ofstream(folder / "precious" / "thesis.tex") << "x";
  m.options.save_path = (folder / "precious").string();
  CHECK(error_text([&] { simulate(m.scene, m.options); }).find("left as it is") != std::string::npos);
  CHECK(fs::exists(folder / "precious" / "thesis.tex"));
}

TEST_CASE("a disk that is full leaves nothing and is told", "[simulate]") {
  const ScratchFolder folder;
  Made m = made_of(kRoom + kSmall + kDrive);
  m.options.save_path = (folder / "made").string();
  m.options.duration = 2.0;
  // No file may grow beyond 16 kB: the IMU's cannot be written to its end.
  std::signal(SIGXFSZ, SIG_IGN);
  rlimit before{};
  getrlimit(RLIMIT_FSIZE, &before);
  rlimit tight = before;
  tight.rlim_cur = 16 << 10;
  setrlimit(RLIMIT_FSIZE, &tight);
  const std::string text = error_text([&] { simulate(m.scene, m.options); });
  setrlimit(RLIMIT_FSIZE, &before);
  CHECK(text.substr(0, 2) == "io");
  CHECK(text.find("cannot be written") != std::string::npos);
  CHECK(!fs::exists(folder / "made"));
  CHECK(!fs::exists(folder / "made.partial"));
}

TEST_CASE("an interrupted run leaves nothing", "[simulate]") {
  const ScratchFolder folder;
  Made m = made_of(kRoom + kSmall + kDrive);
  m.options.save_path = (folder / "made").string();
  int asked = 0;
  CHECK(simulate(m.scene, m.options, {[&] { return ++asked > 3; }, {}}).stopped);
  CHECK(!fs::exists(folder / "made"));
  CHECK(!fs::exists(folder / "made.partial"));
}

TEST_CASE("scene files that cannot be are refused with the place", "[simulate]") {
  const auto has = [](const std::string& text, const std::string& part) {
    INFO(text);
    CHECK(text.find(part) != std::string::npos);
  };
  has(refused(kRoom + "robot:\n  radios: 0.2\n"), "radius");
  has(refused(kRoom + "robot:\n  radius: -1\n"), "scene.yaml:11");
  has(refused(kRoom + "sensors:\n  cameras: {width: 3.5}\n"), "width");
  has(refused(kRoom + "drive:\n  steps:\n    - fly: 3\n"), "scene.yaml:12");
  has(refused(kRoom + "drive:\n  steps:\n    - {stand: 1, turn: 3}\n"), "one key");
  has(refused(kRoom + "drive:\n  steps:\n    - dance\n"), "dance");
  has(refused(kRoom + "drive:\n  start: [1]\n"), "[x, y, yaw]");
  has(refused(kRoom + "events:\n  - {kind: storm, start: 1, seconds: 1}\n"), "scene.yaml:11");
  has(refused(kRoom + "events:\n  - {kind: dark, start: 1}\n"), "seconds");
  has(refused(kRoom + "events:\n  - {kind: person, start: 1, seconds: 2, path: [[1, 1]]}\n"), "two points");
  has(refused(kRoom + "drives:\n  start: [1, 1]\n"), "drive");
  has(error_text([] {
        SimulationOptions options;
        read_simulated_scene("/nowhere/flat.yaml", options);
      }),
      "/nowhere/flat.yaml");

  const ScratchFolder folder;
  const auto run = [&](const std::string& text) {
    return error_text([&] {
      Made m = made_of(text);
      m.options.save_path = (folder / "made").string();
      m.options.duration = 5;
      simulate(m.scene, m.options);
    });
  };
  has(run(kRoom + kSmall + "drive:\n  start: [1, 1]\n  steps:\n    - drive: [[2, 2.6]]\n"),
      "near the cabinet");
  has(run(kRoom + kSmall + kDrive +
          "events:\n  - {kind: person, start: 0, seconds: 3, path: [[0.3, 1], [3, 1]]}\n"),
      "walks into the robot");
  has(run(kRoom + "sensors:\n  cameras:\n    left: {position: [0.5, 0.03, 0.08]}\n" + kDrive), "outline");
  has(run(kRoom +
          "sensors:\n  cameras:\n    left: {position: [0.1, -0.03, 0.08]}\n    right: {position: [0.1, 0.03, "
          "0.08]}\n" +
          kDrive),
      "calibration");
  CHECK(!fs::exists(folder / "made"));
}
