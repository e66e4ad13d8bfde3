// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
// The program itself, on a small recording: exit codes, messages, what is left behind.
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <catch2/catch.hpp>
#include <chrono>
#include <fstream>
#include <nlohmann/json.hpp>
#include <sstream>
#include <thread>

#include "scratch_folder.hpp"
#include "sweepkit/data/image_file.hpp"
#include "sweepkit/data/trajectory.hpp"
#include "system/room.hpp"

using namespace sweepkit;
namespace fs = std::filesystem;

namespace {

// Programs and tests lie in one folder.
fs::path program() { return fs::read_symlink("/proc/self/exe").parent_path() / "sweeper_robot"; }

bool program_is_there() {
  if (fs::exists(program())) return true;
  WARN("skipped: " << program() << " was not built");
  return false;
}

std::string content(const fs::path& file) {
  std::ifstream stream(file, std::ios::binary);
  std::stringstream text;
  text << stream.rdbuf();
  return text.str();
}

struct Outcome {
  int code;
  std::string out, err;
};

// A running program, its output in files.
class Process {
 public:
  Process(const ScratchFolder& folder, std::vector<std::string> arguments)
      : out_(folder / "stdout.txt"), err_(folder / "stderr.txt") {
    arguments.insert(arguments.begin(), program().string());
    std::vector<char*> argv;
    argv.reserve(arguments.size() + 1);
    for (std::string& argument : arguments) argv.push_back(argument.data());
    argv.push_back(nullptr);
    pid_ = fork();
    if (pid_ == 0) {
      if (std::freopen(out_.c_str(), "w", stdout) && std::freopen(err_.c_str(), "w", stderr))
        execv(argv[0], argv.data());
      _exit(99);
    }
  }
  void signal(int number) const { kill(pid_, number); }
  Outcome wait() const {
    int status = 0;
    waitpid(pid_, &status, 0);
    return {WIFEXITED(status) ? WEXITSTATUS(status) : -1, content(out_), content(err_)};
  }

 private:
  fs::path out_, err_;
  pid_t pid_;
};

Outcome run(const ScratchFolder& folder, const std::vector<std::string>& arguments) {
  return Process(folder, arguments).wait();
}

bool has(const std::string& text, const std::string& part) { return text.find(part) != std::string::npos; }

std::string sensor_yaml(const std::string& T_BS, const std::string& rest) {
  return "T_BS:\n  cols: 4\n  rows: 4\n  data: [" + T_BS + "]\nrate_hz: 10\nresolution: [320, 200]\n" + rest;
}

std::string matrix_text(const SE3d& T) {
  std::ostringstream text;
  text.precision(12);
  const Eigen::Matrix4d M = T.matrix();
  for (int i = 0; i < 16; ++i) text << (i ? ", " : "") << M(i / 4, i % 4);
  return text.str();
}

const std::string kIntrinsics =
    "intrinsics: [175, 175, 161, 99]\ndistortion_model: radial-tangential\n"
    "distortion_coefficients: [-0.1, 0.01, 0, 0]\n";
const std::string kIntrinsicsRight =
    "intrinsics: [174, 174, 158.5, 101]\ndistortion_model: radial-tangential\n"
    "distortion_coefficients: [-0.09, 0.01, 0, 0]\n";

constexpr int kImages = 16;

std::string stamp_of(int i) { return std::to_string(drive_images()[i].t); }

// The drive in the room as a recording of two cameras alone, at "data".
void write_recording(const ScratchFolder& folder) {
  const StereoRig rig = Room().rig();
  std::string csv = "#timestamp [ns],filename\n";
  for (int i = 0; i < kImages; ++i) {
    csv += stamp_of(i) + "," + stamp_of(i) + ".png\n";
    for (const Side side : {Side::left, Side::right}) {
      const std::string camera = side == Side::left ? "cam0" : "cam1";
      const fs::path images = folder / ("data/mav0/" + camera + "/data");
      fs::create_directories(images);
      write_png(images / (stamp_of(i) + ".png"),
                (side == Side::left ? drive_images()[i].left : drive_images()[i].right).view);
    }
  }
  for (const char* camera : {"cam0", "cam1"})
    folder.write(std::string("data/mav0/") + camera + "/data.csv", csv);
  folder.write("data/mav0/cam0/sensor.yaml",
               sensor_yaml(matrix_text(rig.T_body_raw(Side::left)), kIntrinsics));
  folder.write("data/mav0/cam1/sensor.yaml",
               sensor_yaml(matrix_text(rig.T_body_raw(Side::right)), kIntrinsicsRight));
}

std::vector<std::string> usual(const ScratchFolder& folder, std::vector<std::string> more = {}) {
  std::vector<std::string> arguments = {"--data", (folder / "data").string(),
                                        "--out",  (folder / "out").string(),
                                        "--set",  "frontend.orb.count=500"};
  arguments.insert(arguments.end(), more.begin(), more.end());
  return arguments;
}

}  // namespace

TEST_CASE("sweeper_robot runs a recording, twice the same", "[program]") {
  if (!program_is_there()) return;
  const ScratchFolder folder;
  write_recording(folder);
  const Outcome first = run(folder, usual(folder));
  CAPTURE(first.err);
  CHECK(first.code == 0);
  CHECK(has(first.out, "16 in"));
  CHECK(has(first.err, "\"sensor_missing\", \"sensor\": \"imu0\""));
  CHECK(has(first.err, "odom0"));
  CHECK(has(content(folder / "out/events.jsonl"), "sensor_missing"));
  const Trajectory live = read_tum(folder / "out/trajectory_live.tum");
  REQUIRE(live.size() == kImages);
  const SE3d truth = drive_pose(0).inverse() * drive_pose(kImages - 1);
  CHECK((truth.inverse() * live.back().T_world_body).translation().norm() < 0.04);
  const auto summary = nlohmann::json::parse(content(folder / "out/summary.json"));
  CHECK(summary["stages"]["read"]["count"] == kImages);
  CHECK(summary["options"]["data_path"] == (folder / "data").string());
  CHECK(summary["ended"] == "end of recording");

  std::vector<std::string> names;
  for (const auto& entry : fs::directory_iterator(folder / "out"))
    names.push_back(entry.path().filename().string());
  std::sort(names.begin(), names.end());
  CHECK(names == std::vector<std::string>{"atlas.swk", "events.jsonl", "keyframes.tum", "map.ply", "map.svg",
                                          "summary.json", "trajectory_live.tum", "trajectory_odom.tum",
                                          "trajectory_optimized.tum"});
  std::vector<std::string> contents;
  contents.reserve(names.size());
  for (const std::string& name : names) contents.push_back(content(folder / ("out/" + name)));
  CHECK(run(folder, usual(folder)).code == 0);
  for (std::size_t i = 0; i < names.size(); ++i) {
    if (names[i] == "summary.json") continue;  // has times
    CAPTURE(names[i]);
    CHECK(contents[i] == content(folder / ("out/" + names[i])));
  }

  // A part of it, with pictures.
  CHECK(run(folder, usual(folder, {"--start", "0.5", "--duration", "0.6", "--set", "pictures.every=0.3"}))
            .code == 0);
  std::size_t pictures = 0;
  for (const auto& entry : fs::directory_iterator(folder / "out/pictures")) {
    ++pictures;
    const SharedGray picture = read_gray(entry.path());
    CHECK(picture.view.width == Room::kWidth);
    CHECK(picture.view.height == Room::kHeight);
  }
  CHECK(pictures == 3);
  const Trajectory part = read_tum(folder / "out/trajectory_live.tum");
  REQUIRE(part.size() == 7);
  CHECK(part.front().t == live[5].t);
}

TEST_CASE("sweeper_robot refuses wrong usage with code 2", "[program]") {
  if (!program_is_there()) return;
  const ScratchFolder folder;
  const std::string out = (folder / "out").string();
  Outcome outcome = run(folder, {"--out", out});
  CHECK(outcome.code == 2);
  CHECK(has(outcome.err, "data_path"));
  outcome = run(folder, {"--data", "somewhere"});
  CHECK(outcome.code == 2);
  CHECK(has(outcome.err, "save_path"));
  outcome = run(folder, {"--data", "a", "--out", out, "--set", "frontend.orb.cuont=5"});
  CHECK(outcome.code == 2);
  CHECK(has(outcome.err, "frontend.orb.count"));
  outcome = run(folder, {"--data", "a", "--out", out, "--set", "tracker.search_radius=nan"});
  CHECK(outcome.code == 2);
  CHECK(has(outcome.err, "tracker.search_radius"));
  CHECK(run(folder, {"--data", "a", "--out", out, "--no-such-flag"}).code == 2);
  folder.write("config.yaml", "trackr:\n  search_radius: 5\n");
  outcome = run(folder, {(folder / "config.yaml").string(), "--data", "a", "--out", out});
  CHECK(outcome.code == 2);
  CHECK(has(outcome.err, "config.yaml:1"));
  CHECK(has(outcome.err, "tracker"));
  CHECK_FALSE(fs::exists(out));
  CHECK(run(folder, {"--help"}).code == 0);
  CHECK(has(run(folder, {"--version"}).out, "sweeper_robot "));
}

TEST_CASE("sweeper_robot never initialised is code 1", "[program]") {
  if (!program_is_there()) return;
  const ScratchFolder folder;
  write_recording(folder);
  for (int i = 0; i < kImages; ++i)
    for (const char* camera : {"cam0", "cam1"})
      write_png(folder / ("data/mav0/" + std::string(camera) + "/data/" + stamp_of(i) + ".png"),
                Room::black().view);
  const Outcome outcome = run(folder, usual(folder));
  CHECK(outcome.code == 1);
  CHECK(has(outcome.err, "never initialised"));
  CHECK(fs::exists(folder / "out/summary.json"));
}

TEST_CASE("sweeper_robot names damage in a recording and keeps what came before", "[program]") {
  if (!program_is_there()) return;
  const ScratchFolder folder;
  write_recording(folder);
  const fs::path image = folder / ("data/mav0/cam1/data/" + stamp_of(10) + ".png");
  std::string place;
  SECTION("a missing image") {
    fs::remove(image);
    place = stamp_of(10) + ".png";
  }
  SECTION("a truncated image") {
    fs::resize_file(image, fs::file_size(image) / 2);
    place = stamp_of(10) + ".png";
  }
  SECTION("an image of another size") {
    write_png(image, Room::black(Room::kWidth, Room::kHeight / 2).view);
    place = stamp_of(10) + ".png";
  }
  const Outcome outcome = run(folder, usual(folder));
  CAPTURE(outcome.err);
  CHECK(outcome.code == 3);
  CHECK(has(outcome.err, place));
  CHECK(read_tum(folder / "out/trajectory_live.tum").size() == 10);
  CHECK(read_tum(folder / "out/trajectory_optimized.tum").size() == 10);
  const auto summary = nlohmann::json::parse(content(folder / "out/summary.json"));
  CHECK(summary["frames"] == 10);
  CHECK(has(summary["ended"].get<std::string>(), place));
}

TEST_CASE("sweeper_robot refuses recordings that cannot be, with code 3", "[program]") {
  if (!program_is_there()) return;
  const ScratchFolder folder;
  write_recording(folder);
  const SE3d T_left = Room().rig().T_body_raw(Side::left);
  std::string place;
  SECTION("no folder") {
    fs::remove_all(folder / "data");
    place = "data";
  }
  SECTION("an empty data.csv") {
    folder.write("data/mav0/cam0/data.csv", "");
    place = "cam0/data.csv";
  }
  SECTION("a singular matrix") {
    folder.write("data/mav0/cam0/sensor.yaml",
                 sensor_yaml("0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1", kIntrinsics));
    place = "cam0/sensor.yaml";
  }
  SECTION("a matrix of the wrong size") {
    folder.write("data/mav0/cam1/sensor.yaml", sensor_yaml("1, 0, 0, 0, 0, 1", kIntrinsics));
    place = "cam1/sensor.yaml";
  }
  SECTION("no baseline") {
    folder.write("data/mav0/cam1/sensor.yaml", sensor_yaml(matrix_text(T_left), kIntrinsicsRight));
    place = "baseline";
  }
  SECTION("no focal length") {
    folder.write("data/mav0/cam1/sensor.yaml",
                 sensor_yaml(matrix_text(T_left), "intrinsics: [0, 0, 160, 100]\n"));
    place = "cam1/sensor.yaml";
  }
  SECTION("one camera alone") {
    fs::remove_all(folder / "data/mav0/cam1");
    place = "cam1";
  }
  SECTION("time that goes backwards") {
    std::string csv = "#timestamp [ns],filename\n";
    for (const int i : {0, 1, 3, 2}) csv += stamp_of(i) + "," + stamp_of(i) + ".png\n";
    folder.write("data/mav0/cam0/data.csv", csv);
    place = "cam0/data.csv:5";
  }
  const Outcome outcome = run(folder, usual(folder));
  CAPTURE(outcome.err);
  CHECK(outcome.code == 3);
  CHECK(has(outcome.err, place));
}

TEST_CASE("sweeper_robot goes on where one camera gives nothing", "[program]") {
  if (!program_is_there()) return;
  const ScratchFolder folder;
  write_recording(folder);
  std::string csv = "#timestamp [ns],filename\n";
  for (int i = 0; i < kImages; ++i)
    if (i != 6 && i != 7) csv += stamp_of(i) + "," + stamp_of(i) + ".png\n";
  folder.write("data/mav0/cam1/data.csv", csv);
  const Outcome outcome = run(folder, usual(folder));
  CHECK(outcome.code == 0);
  CHECK(read_tum(folder / "out/trajectory_live.tum").size() == kImages);
  const std::string events = content(folder / "out/events.jsonl");
  CHECK(has(events, "\"image_missing\", \"camera\": \"cam1\""));
  CHECK(nlohmann::json::parse(content(folder / "out/summary.json"))["frames_missing_a_camera"] == 2);
}

TEST_CASE("sweeper_robot plays at sensor time, and Ctrl-C leaves the results so far", "[program][realtime]") {
  if (!program_is_there()) return;
  const ScratchFolder folder;
  write_recording(folder);
  Process process(folder, usual(folder, {"--realtime"}));
  const fs::path live = folder / "out/trajectory_live.tum";
  for (int i = 0; i < 3000; ++i) {
    if (fs::exists(live) && fs::file_size(live) > 0) break;
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  process.signal(SIGINT);
  const Outcome outcome = process.wait();
  CAPTURE(outcome.err);
  CHECK(outcome.code == 130);
  const std::size_t images = read_tum(live).size();
  CHECK(images >= 1);
  CHECK(read_tum(folder / "out/trajectory_optimized.tum").size() == images);
  const auto summary = nlohmann::json::parse(content(folder / "out/summary.json"));
  CHECK(summary["ended"] == "interrupted");
  CHECK(summary["options"]["realtime"] == true);
}

TEST_CASE("The shipped configuration holds the defaults", "[program]") {
  if (!program_is_there()) return;
  fs::path shipped;
  for (fs::path folder = fs::path(__FILE__).parent_path(); folder.has_relative_path();
       folder = folder.parent_path())
    if (fs::exists(folder / "tools/initial/sweeper_config.yaml"))
      shipped = folder / "tools/initial/sweeper_config.yaml";
  REQUIRE_FALSE(shipped.empty());
  const ScratchFolder folder;
  const Outcome with = run(folder, {shipped.string(), "--dump-config"});
  const Outcome without = run(folder, {"--dump-config", "--data", "recording", "--out", "results"});
  CAPTURE(with.err);
  CHECK(with.code == 0);
  CHECK(with.out == without.out);
}
