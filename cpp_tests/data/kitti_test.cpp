// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/data/kitti.hpp"

#include <catch2/catch.hpp>
#include <cstdlib>

#include "data/error_text.hpp"
#include "data/recording_files.hpp"

using namespace sweepkit;

namespace {

const char* const kP0 = "P0: 20 0 16 0 0 20 12 0 0 0 1 0\n";
const char* const kP1 = "P1: 20 0 16 -10 0 20 12 0 0 0 1 0\n";

void write_kitti(const ScratchFolder& folder, const std::string& calib = std::string(kP0) + kP1) {
  std::string times;
  for (int i = 0; i < 4; ++i) {
    const std::string name = "/00000" + std::to_string(i) + ".png";
    write_gray_png(folder / ("image_0" + name), 10 + i);
    write_gray_png(folder / ("image_1" + name), 100 + i);
    times += std::to_string(0.103737 * i) + "\n";
  }
  folder.write("times.txt", times);
  folder.write("calib.txt", calib);
}

}  // namespace

TEST_CASE("a KITTI sequence is read, its rig being rectified already") {
  const ScratchFolder folder;
  write_kitti(folder);
  const auto recording = open_recording(folder.path());
  const RecordingInfo& info = recording->info();
  CHECK(info.format == "KITTI odometry");
  CHECK(info.images == 4);
  CHECK(info.missing_sensors == std::vector<std::string>{"imu0", "odom0"});
  const Rig& rig = recording->rig();
  CHECK(rig.left->T_body_camera.log().norm() == 0);
  CHECK(rig.right->T_body_camera.translation() == Vec3<double>(0.5, 0, 0));
  CHECK(rig.left->camera.width() == kWidth);
  CHECK(rig.stereo().is_rectified());
  CHECK(rig.stereo().baseline() == 0.5);
  const auto images = only<StereoImage>(read_all(*recording));
  REQUIRE(images.size() == 4);
  CHECK(images[3].t == 311211000);
  CHECK(images[3].left.view(0, 0) == 13);
  CHECK(images[3].right.view(0, 0) == 103);
}

TEST_CASE("a frame with one image is delivered, one with none is an error") {
  const ScratchFolder folder;
  write_kitti(folder);
  std::filesystem::remove(folder / "image_1/000002.png");
  const auto recording = open_recording(folder.path());
  CHECK(recording->info().right_missing == 1);
  CHECK(only<StereoImage>(read_all(*recording))[2].right.empty());
  std::filesystem::remove(folder / "image_0/000002.png");
  CHECK(error_text([&] { open_recording(folder.path()); }) ==
        "data: " + (folder / "times.txt").string() + ":3: there is no image of this frame (got 000002)");
  std::filesystem::remove_all(folder / "image_1");
  write_gray_png(folder / "image_0/000002.png", 1);
  CHECK(open_recording(folder.path())->info().missing_sensors.back() == "cam1");
}

TEST_CASE("a calibration or stamps that cannot be are refused with file and line") {
  const ScratchFolder folder;
  const auto complaint = [&](const std::string& calib) {
    write_kitti(folder, calib);
    std::string text = error_text([&] { open_recording(folder.path()); });
    const std::string path = (folder / "calib.txt").string();
    const std::size_t at = text.find(path);
    return at == std::string::npos ? text : text.erase(at, path.size());
  };
  CHECK(complaint("") == "calibration: : has no line P0:");
  CHECK(complaint(kP0) == "calibration: : has no line P1:");
  CHECK(complaint("P0: 1 2 3\n") ==
        "calibration: :1: P0: must have 12 numbers, a 3x4 matrix by rows (got 3)");
  CHECK(complaint("P0: 0 0 16 0 0 20 12 0 0 0 1 0\n").find("the matrix is singular") != std::string::npos);
  CHECK(complaint("P0: 20 1 16 0 0 20 12 0 0 0 1 0\n").find("must have the form") != std::string::npos);
  CHECK(complaint("P0: nan 0 16 0 0 20 12 0 0 0 1 0\n").find("is not a finite number (got nan)") !=
        std::string::npos);
  CHECK(complaint(std::string(kP0) + "P1: 20 0 16 0 0 20 12 0 0 0 1 0\n").find("the baseline") !=
        std::string::npos);

  write_kitti(folder);
  folder.write("times.txt", "0\n0.2\n0.1\n0.3\n");
  CHECK(error_text([&] { open_recording(folder.path()); }).find("times.txt:3: time goes backwards") !=
        std::string::npos);
  folder.write("times.txt", "");
  CHECK(error_text([&] { open_recording(folder.path()); }).find("holds no stamps") != std::string::npos);
  write_kitti(folder);
  write_gray_png(folder / "image_1/000002.png", 1, 10, 10);
  CHECK(error_text([&] { read_all(*open_recording(folder.path())); })
            .find("times.txt:3: " + (folder / "image_1/000002.png").string() +
                  ": the image must be 32x24 pixels (got 10x10)") != std::string::npos);
}

TEST_CASE("KITTI 06 is read") {
  const char* data = std::getenv("SWEEPKIT_DATA");
  if (!data) {
    WARN("skipped: SWEEPKIT_DATA is not set");
    return;
  }
  RecordingOptions options;
  options.duration = 1.0;
  const auto recording = open_recording(std::filesystem::path(data) / "kitti" / "06_first51", options);
  CHECK(recording->info().images == 10);
  CHECK(recording->rig().stereo().is_rectified());
  CHECK(recording->rig().stereo().baseline() == Approx(0.5372).margin(1e-4));
  CHECK(only<StereoImage>(read_all(*recording)).size() == 10);
}
