// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/data/euroc.hpp"

#include <catch2/catch.hpp>
#include <cstdlib>

#include "data/error_text.hpp"
#include "data/recording_files.hpp"

using namespace sweepkit;

TEST_CASE("all sensors come in the order of time, at equal stamps IMU, wheels, images") {
  const ScratchFolder folder;
  write_euroc(folder);
  for (const int prefetch : {0, 1, 4}) {
    RecordingOptions options;
    options.prefetch = prefetch;
    const auto recording = open_recording(folder.path(), options);
    const RecordingInfo& info = recording->info();
    CHECK(info.format == "EuRoC ASL");
    CHECK(info.images == 5);
    CHECK(info.begin == 1'000'000'000);
    CHECK(info.end == 1'400'000'000);
    CHECK(info.missing_sensors.empty());
    CHECK(info.truth.empty());

    const auto samples = read_all(*recording);
    CHECK(samples.size() == 50 + 21 + 5);
    for (std::size_t i = 1; i < samples.size(); ++i) {
      REQUIRE(stamp(samples[i - 1]) <= stamp(samples[i]));
      if (stamp(samples[i - 1]) == stamp(samples[i])) REQUIRE(samples[i - 1].index() < samples[i].index());
    }
    const auto imu = only<ImuSample>(samples);
    CHECK(imu[0].t == 950'000'000);
    CHECK(imu[3].gyro == Eigen::Vector3d(0.1, 0.2, 0.3));
    CHECK(imu[3].accel == Eigen::Vector3d(0, 0, 9.81));
    const auto wheels = only<WheelSample>(samples);
    CHECK(wheels[2].reading == WheelReading::ticks);
    CHECK(wheels[2].left == 14);
    CHECK(wheels[2].right == 116);
    const auto images = only<StereoImage>(samples);
    for (int i = 0; i < 5; ++i) {
      CHECK(images[i].left.view(31, 23) == 10 + i);
      CHECK(images[i].right.view(0, 0) == 100 + i);
    }
    CHECK_FALSE(recording->next());

    const Rig& rig = recording->rig();
    CHECK(rig.left->camera.distortion() == Distortion::radial_tangential);
    CHECK(rig.left->rate_hz == 10);
    CHECK(rig.right->T_body_camera.translation().x() == 0.1);
    CHECK(rig.imu->noise.gyro_noise_density == 1.5e-4);
    CHECK(rig.wheels->geometry.track_width == 0.3);
    CHECK(rig.stereo().baseline() == Approx(0.1));
  }
}

TEST_CASE("a recording may be left half read") {
  const ScratchFolder folder;
  write_euroc(folder);
  for (int i = 0; i < 20; ++i) {
    const auto recording = open_recording(folder.path());
    for (int k = 0; k < i; ++k) recording->next();
  }
}

TEST_CASE("start and duration select, and sensors can be left out") {
  const ScratchFolder folder;
  write_euroc(folder);
  RecordingOptions options;
  options.start = 0.1;
  options.duration = 0.2;
  options.use_wheels = false;
  const auto recording = open_recording(folder / "mav0", options);
  CHECK(recording->info().images == 3);
  const auto samples = read_all(*recording);
  CHECK(only<StereoImage>(samples).front().left.view(0, 0) == 11);
  CHECK(only<StereoImage>(samples).back().left.view(0, 0) == 13);
  CHECK(only<WheelSample>(samples).empty());
  CHECK_FALSE(recording->rig().wheels);
  CHECK(only<ImuSample>(samples).front().t == 1'100'000'000);
  CHECK(only<ImuSample>(samples).back().t == 1'300'000'000);
  options.start = 5;
  CHECK(error_text([&] { open_recording(folder.path(), options); }).find("option: start: nothing of") == 0);
  options.start = std::nan("");
  CHECK(error_text([&] { open_recording(folder.path(), options); }) ==
        "option: start: must be a finite number (got nan)");
}

TEST_CASE("one camera dropping out is no error: its images are absent and counted") {
  const ScratchFolder folder;
  write_euroc(folder);
  folder.write("mav0/cam1/data.csv",
               "1000000000,1000000000.png\n1300000000,1300000000.png\n1500000000,1400000000.png\n");
  const auto recording = open_recording(folder.path());
  CHECK(recording->info().images == 6);
  CHECK(recording->info().right_missing == 3);
  CHECK(recording->info().left_missing == 1);
  const auto images = only<StereoImage>(read_all(*recording));
  CHECK_FALSE(images[0].right.empty());
  CHECK(images[1].right.empty());
  CHECK_FALSE(images[1].left.empty());
  CHECK_FALSE(images[3].right.empty());
  CHECK(images[5].left.empty());
}

TEST_CASE("stamps that differ are paired where that is wanted") {
  const ScratchFolder folder;
  write_euroc(folder);
  std::string csv;
  for (const int i : {0, 1, 3, 4})
    csv += std::to_string(1'007'000'000LL + i * 100'000'000LL) + "," +
           std::to_string(1'000'000'000LL + i * 100'000'000LL) + ".png\n";
  folder.write("mav0/cam1/data.csv", csv);
  CHECK(error_text([&] { open_recording(folder.path()); }).find("pairing: nearest") != std::string::npos);
  RecordingOptions options;
  options.pairing = Pairing::nearest;
  const auto images = only<StereoImage>(read_all(*open_recording(folder.path(), options)));
  REQUIRE(images.size() == 5);
  for (int i = 0; i < 5; ++i) {
    CHECK(images[i].t == 1'000'000'000LL + i * 100'000'000LL);
    CHECK(images[i].right.empty() == (i == 2));
    if (i != 2) CHECK(images[i].right.view(0, 0) == 100 + i);
  }
}

TEST_CASE("sensors may be absent, and that is said") {
  const ScratchFolder folder;
  write_euroc(folder);
  std::filesystem::remove_all(folder / "mav0/imu0");
  std::filesystem::remove_all(folder / "mav0/cam1");
  auto recording = open_recording(folder.path());
  CHECK(recording->info().missing_sensors == std::vector<std::string>{"cam1", "imu0"});
  CHECK_FALSE(recording->rig().has_stereo());
  CHECK(error_text([&] { recording->rig().stereo(); }) ==
        "calibration: cam1: is missing: two cameras are needed");
  CHECK(only<StereoImage>(read_all(*recording)).size() == 5);
  std::filesystem::remove_all(folder / "mav0/cam0");
  recording = open_recording(folder.path());
  CHECK(recording->info().images == 0);
  CHECK(read_all(*recording).size() == 21);
  std::filesystem::remove_all(folder / "mav0/odom0");
  CHECK(error_text([&] { open_recording(folder.path()); }).find("io: ") == 0);
  CHECK(error_text([&] { open_recording(folder / "nowhere"); }).find("there is no such folder") !=
        std::string::npos);
}

TEST_CASE("mountings are carried over into the frame of the IMU") {
  const ScratchFolder folder;
  write_euroc(folder);
  folder.write("mav0/imu0/sensor.yaml", "T_BS: [0, -1, 0, 1,  1, 0, 0, 2,  0, 0, 1, 3,  0, 0, 0, 1]\n");
  const auto recording = open_recording(folder.path());
  const Rig& rig = recording->rig();
  CHECK(rig.imu->T_body_imu.log().norm() == 0.0);
  const SE3d T_given_imu(SO3d::exp({0, 0, std::acos(0.0)}), {1, 2, 3});
  const SE3d T_given_right(SO3d(), {0.1, 0, 0});
  CHECK((rig.right->T_body_camera.inverse() * T_given_imu.inverse() * T_given_right).log().norm() < 1e-12);
  CHECK((rig.wheels->T_body_base.inverse() * T_given_imu.inverse()).log().norm() < 1e-12);
}

TEST_CASE("damaged images are an error at their turn, with file and line; what came before is delivered") {
  const ScratchFolder folder;
  for (const int prefetch : {0, 4}) {
    RecordingOptions options;
    options.prefetch = prefetch;
    const auto read_until_error = [&](std::size_t images_before) {
      const auto recording = open_recording(folder.path(), options);
      std::size_t images = 0;
      std::string text;
      for (bool more = true; more && text.empty();)
        text = error_text([&] {
          const auto sample = recording->next();
          more = sample.has_value();
          images += more && std::holds_alternative<StereoImage>(*sample);
        });
      CHECK(images == images_before);
      CHECK(error_text([&] { recording->next(); }) == text);  // it stays so
      return text;
    };
    const std::string image = (folder / "mav0/cam1/data/1200000000.png").string();
    const std::string place = (folder / "mav0/cam1/data.csv").string() + ":4: " + image;
    write_euroc(folder);
    std::filesystem::remove(image);
    CHECK(read_until_error(2) == "io: " + place + ": cannot be opened: No such file or directory");
    write_euroc(folder);
    std::filesystem::resize_file(image, std::filesystem::file_size(image) - 20);
    CHECK(read_until_error(2).find("data: " + place + ": is truncated or damaged") == 0);
    write_euroc(folder);
    write_gray_png(image, 5, 30, 24);
    CHECK(read_until_error(2) == "data: " + place + ": the image must be 32x24 pixels (got 30x24)");
  }
}

TEST_CASE("damaged tables are refused with file, line and value") {
  const ScratchFolder folder;
  const auto complaint = [&](const std::string& file, const std::string& content) {
    write_euroc(folder);
    folder.write(file, content);
    std::string text = error_text([&] { read_all(*open_recording(folder.path())); });
    const std::string path = (folder / file).string();
    const std::size_t at = text.find(path);
    return at == std::string::npos ? text : text.erase(at, path.size());
  };
  CHECK(complaint("mav0/cam0/data.csv", "") == "data: : lists no images");
  CHECK(complaint("mav0/cam0/data.csv", "#timestamp [ns],filename\n") == "data: : lists no images");
  CHECK(complaint("mav0/cam0/data.csv", "#t\n1000000000\n") ==
        "data: :2: needs 2 columns, has 1 (got 1000000000)");
  CHECK(complaint("mav0/cam0/data.csv", "#t\n2,a\n\n1,b\n") ==
        "data: :4: time goes backwards: the stamp before is 2 ns (got 1 ns)");
  CHECK(complaint("mav0/cam0/data.csv", "#t\n1e9,a\n") ==
        "data: :2: is not a stamp in whole nanoseconds (got 1e9)");
  CHECK(complaint("mav0/cam0/data.csv", "99999999999999999999,a\n") ==
        "data: :1: is not a stamp in whole nanoseconds (got 99999999999999999999)");
  CHECK(complaint("mav0/imu0/data.csv", "") == "data: : holds no samples");
  CHECK(complaint("mav0/imu0/data.csv", "1,0,0,0,0,0,0\n2,0,0,0,nan,0,0\n") ==
        "data: :2: is not a finite number (got nan)");
  CHECK(complaint("mav0/imu0/data.csv", "1,0,0,0,0,0,0\n1,0,0,0,0,0,0\n") ==
        "data: :2: time goes backwards: the stamp before is 1 ns (got 1 ns)");
  CHECK(complaint("mav0/imu0/data.csv", "1,0,0,0,0,0\n") ==
        "data: :1: needs 7 columns, has 6 (got 1,0,0,0,0,0)");
  CHECK(complaint("mav0/odom0/data.csv", "#t\n1,0,\n") == "data: :2: needs 3 columns, has 2 (got 1,0,)");
  CHECK(complaint("mav0/odom0/data.csv", "") == "data: : holds no samples");
}

TEST_CASE("a calibration that cannot be is refused with file, line and key") {
  const ScratchFolder folder;
  const auto complaint = [&](const std::string& file, const std::string& content) {
    write_euroc(folder);
    folder.write(file, content);
    std::string text = error_text([&] { open_recording(folder.path()); });
    const std::string path = (folder / file).string();
    for (std::size_t at = text.find(path); at != std::string::npos; at = text.find(path))
      text.erase(at, path.size());
    return text;
  };
  const auto changed = [](const std::string& from, const std::string& to) {
    std::string yaml = camera_yaml(0.0);
    const std::size_t at = yaml.find(from);
    REQUIRE(at != std::string::npos);
    return yaml.replace(at, from.size(), to);
  };
  const std::string cam0 = "mav0/cam0/sensor.yaml";
  CHECK(complaint(cam0, changed("0, 0, 1, 0,", "0, 0, 0, 0,")) ==
        "calibration: :3: T_BS: the rotation is singular (got determinant 0)");
  CHECK(complaint(cam0, changed("0, 0, 1, 0,", "0, 0, 2, 0,"))
            .find("calibration: :3: T_BS: the upper left 3x3") == 0);
  CHECK(complaint(cam0, changed("0, 0, 1, 0,", "")) ==
        "calibration: :3: T_BS: must have 16 numbers, a 4x4 matrix by rows (got 12)");
  CHECK(complaint(cam0, changed("rows: 4", "rows: 3")) == "calibration: :3: T_BS: must have 4 rows (got 3)");
  CHECK(complaint(cam0, changed("0, 0, 0, 1]", "0, 0, 1, 1]")) ==
        "calibration: :3: T_BS: the last row must be 0 0 0 1");
  CHECK(complaint(cam0, changed("0, 1, 0, 0,", "0, .nan, 0, 0,")) ==
        "calibration: :3: T_BS: number 6 is not a finite number (got .nan)");
  CHECK(complaint(cam0, changed("T_BS", "T_SB")) == "calibration: : T_BS: is missing");
  CHECK(complaint(cam0, changed("[32, 24]", "[32]")) ==
        "calibration: :11: resolution: must have two numbers, width and height");
  CHECK(complaint(cam0, changed("[32, 24]", "[32, -24]")).find("calibration: :11: resolution: ") == 0);
  CHECK(complaint(cam0, changed("pinhole", "omni")) ==
        "calibration: :12: camera_model: must be pinhole (got omni)");
  CHECK(complaint(cam0, changed("radial-tangential", "fov"))
            .find("calibration: :14: distortion_model: must be") == 0);
  CHECK(complaint(cam0, changed("[20, 20, 16, 12]", "[0, 20, 16, 12]")).find("calibration: ") == 0);
  CHECK(complaint(cam0, changed("[20, 20, 16, 12]", "[20, 20, 16]")).find("calibration: ") == 0);
  CHECK(complaint(cam0, "a: [1\n").find("calibration: :2: is no YAML") == 0);
  CHECK(complaint(cam0, "") == "calibration: : holds no keys: a sensor description is expected");
  CHECK(complaint("mav0/cam1/sensor.yaml", camera_yaml(0.0)) ==
        "calibration: : T_BS: the baseline, the distance to cam0, must be above zero (got 0 m)");
  CHECK(complaint("mav0/odom0/sensor.yaml", std::string(kIdentity) + "track_width: 0\n") ==
        "calibration: :2: track_width: must be above zero (got 0)");
}

TEST_CASE("logs of wheel speeds can stand for odom0") {
  const ScratchFolder folder;
  write_euroc(folder);
  folder.write("mav0/odom0/data.csv", "t_s, v, omega\n1.000000001, 0.5, 0.2\n1.1,0.5,-0.2\n");
  folder.write("mav0/odom0/sensor.yaml", std::string(kIdentity) + "track_width: 0.3\n");
  const auto wheels = only<WheelSample>(read_all(*open_recording(folder.path())));
  REQUIRE(wheels.size() == 2);
  CHECK(wheels[0].t == 1'000'000'001);
  CHECK(wheels[0].reading == WheelReading::speeds);
  CHECK(wheels[0].left == Approx(0.47));
  CHECK(wheels[0].right == Approx(0.53));
  const auto file = folder.write("w.csv", "t_s,v_left_mps,v_right_mps\n0.5,1,2\n");
  CHECK(read_wheel_log(file)[0].right == 2);
  CHECK(error_text([&] { read_wheel_log(folder.write("w.csv", "t_s,a,b\n0.5,1,2\n")); }).find("data: ") == 0);
  CHECK(error_text([&] { read_wheel_log(folder.write("w.csv", "0.5,1,2\n")); }).find("needs a header") !=
        std::string::npos);
  CHECK(error_text([&] {
          read_wheel_log(folder.write("w.csv", "t_s,v,omega\n"));
        }).find("holds no samples") != std::string::npos);
}

TEST_CASE("the recordings at hand are read") {
  const char* data = std::getenv("SWEEPKIT_DATA");
  if (!data) {
    WARN("skipped: SWEEPKIT_DATA is not set");
    return;
  }
  const std::filesystem::path folder(data);
  RecordingOptions two_seconds;
  two_seconds.duration = 2.0;
  const auto dev01 = open_recording(folder / "sweephome" / "dev01", two_seconds);
  CHECK(dev01->info().images == 21);
  CHECK(dev01->rig().stereo().baseline() == Approx(0.0599).margin(1e-4));
  CHECK(dev01->rig().wheels->geometry.ticks_per_revolution == 1560);
  const auto samples = read_all(*dev01);
  CHECK(only<StereoImage>(samples).size() == 21);
  CHECK(only<ImuSample>(samples).front().t == 1701775511000000000);
  const auto still = open_recording(folder / "euroc_still", two_seconds);
  CHECK(still->info().missing_sensors == std::vector<std::string>{"odom0"});
  CHECK(still->rig().stereo().baseline() == Approx(0.110).margin(1e-3));
  CHECK(still->info().truth.filename() == "data.csv");
  const auto flight = open_recording(folder / "euroc_inertial" / "V1_01_easy");
  CHECK(read_all(*flight).size() == 29120);
  CHECK(read_wheel_log(folder / "tuc_labyrinth" / "wheels.csv").size() > 200);
  CHECK(read_wheel_log(folder / "mrclam" / "d7_robot1" / "odometry.csv").size() > 20000);
}
