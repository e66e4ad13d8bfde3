// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <atomic>
#include <catch2/catch.hpp>
#include <chrono>
#include <cmath>
#include <limits>
#include <memory>
#include <optional>
#include <thread>
#include <utility>
#include <vector>

#include "motion/body_signals.hpp"
#include "sweepkit/system/sweeper.hpp"
#include "system/event_record.hpp"
#include "system/room.hpp"

using namespace sweepkit;
using test::BodySignals;

namespace {

constexpr int kImages = 31, kDarkFrom = 12, kDarkTo = 19;
constexpr double kBegin = 1.0, kPeriod = 0.1;

double image_time(int image) { return kBegin + kPeriod * image; }

/// Stands, drives 60 cm on an arc of 2 m radius from 1.2 s to 3.6 s, stands.
SE3d T_room_base(double t) {
  constexpr double r = 2.0;
  const double angle = 0.6 * test::smooth(t, 1.2, 3.6) / r;
  return SE3d(SO3d::exp({0, 0, angle}), {r * std::sin(angle), r * (1 - std::cos(angle)), 0});
}

struct Drive {
  BodySignals signals;
  std::vector<StereoImage> images, dark;  // the same, some of them black

  Drive() {
    signals.T_body_base = SE3d(SO3d(), {-0.03, 0.0, 0.0});
    signals.T_world_base = T_room_base;
    signals.make(image_time(kImages - 1) + 0.25);
    const Room room;
    for (int i = 0; i < kImages; ++i)
      images.push_back(room.see(from_seconds(image_time(i)), signals.T_world_body(image_time(i))));
    dark = images;
    for (int i = kDarkFrom; i < kDarkTo; ++i)
      dark[static_cast<std::size_t>(i)].left = dark[static_cast<std::size_t>(i)].right = Room::black();
  }
  SE3d motion_until(double t) const {
    return signals.T_world_body(image_time(0)).inverse() * signals.T_world_body(t);
  }
};

const Drive& drive() {
  static const Drive made;
  return made;
}

SweeperOptions small_options(bool realtime = false) {
  SweeperOptions options;
  options.realtime = realtime;
  options.frontend.orb.count = 500;
  return options;
}

/// Feeds all in the order of the stamps; samples beyond the last image only on demand.
void feed(Sweeper& sweeper, const BodySignals& signals, const std::vector<StereoImage>& images) {
  std::size_t i = 0, w = 0;
  for (const StereoImage& image : images) {
    for (; i < signals.imu.size() && signals.imu[i].t <= image.t; ++i) sweeper.feed(signals.imu[i]);
    for (; w < signals.wheels.size() && signals.wheels[w].t <= image.t; ++w) sweeper.feed(signals.wheels[w]);
    sweeper.feed(image);
  }
}

Vec6<double> error_of(const SE3d& T_frame_body, const SE3d& T_frame_first, double t) {
  return test::difference(T_frame_first * drive().motion_until(t), T_frame_body);
}

bool sound(const Mat6<double>& covariance) {
  return covariance.allFinite() &&
         Eigen::SelfAdjointEigenSolver<Mat6<double>>(covariance).eigenvalues().minCoeff() > -1e-12;
}

void check_sound(const std::vector<TrackedImage>& images) {
  for (const TrackedImage& image : images) {
    REQUIRE(image.T_map_body.matrix().allFinite());
    REQUIRE(image.T_odom_body.matrix().allFinite());
    REQUIRE(sound(image.covariance));
  }
}

}  // namespace

TEST_CASE("Sweeper with odometry has a pose at every image, also in the dark", "[motion]") {
  for (const auto& [imu, wheels] : {std::pair{true, true}, std::pair{false, true}, std::pair{true, false}}) {
    CAPTURE(imu, wheels);
    EventRecord events;
    Sweeper sweeper(Room().rig(drive().signals.sensors(imu, wheels)), small_options(), &events);
    feed(sweeper, drive().signals, drive().dark);
    sweeper.finish();
    const std::vector<TrackedImage> images = sweeper.images();
    REQUIRE(images.size() == kImages);
    check_sound(images);
    const SE3d T_first = images[0].T_map_body;
    double seen = 0, blind = 0, turned = 0;
    for (int i = 0; i < kImages; ++i) {
      const TrackedImage& image = images[static_cast<std::size_t>(i)];
      const bool dark = i >= kDarkFrom && i < kDarkTo;
      CAPTURE(i);
      CHECK(image.basis == (dark ? PoseBasis::odometry : PoseBasis::vision));
      const Vec6<double> e = error_of(image.T_map_body, T_first, image_time(i));
      (dark ? blind : seen) = std::max(dark ? blind : seen, e.head<3>().norm());
      turned = std::max(turned, e.tail<3>().norm());
      // Between keyframes without wheels only the turn is measured: in the dark their places are what lies
      // between the ends.
      const SE3d T_corrected = sweeper.optimized_pose(image);
      CHECK(error_of(T_corrected, T_first, image_time(i)).head<3>().norm() < (dark && !wheels ? 0.06 : 0.03));
      CHECK(test::difference(image.T_odom_body, T_first * drive().motion_until(image_time(i)))
                .head<3>()
                .norm() < 0.04);
    }
    CHECK(seen < 0.03);
    CHECK(blind < 0.03);
    CHECK(turned < 0.02);
    REQUIRE(events.named("dark").size() == 1);
    CHECK(events.named("dark")[0].t == drive().images[kDarkFrom].t);
    REQUIRE(events.named("lost").size() == 1);
    CHECK(events.named("lost")[0].t == drive().images[kDarkFrom].t);
    REQUIRE(events.named("recovered").size() == 1);
    CHECK(events.named("recovered")[0].t == drive().images[kDarkTo].t);
    for (const char* name : {"slip", "lifted", "free_spin", "sensor_gap", "sample_dropped"}) {
      CAPTURE(name);
      CHECK(events.named(name).empty());
    }
    CHECK_FALSE(sweeper.map().broken_invariant());
    const auto navigation = sweeper.navigation();
    REQUIRE(navigation);
    CHECK(navigation->t == drive().images.back().t);
    CHECK(navigation->velocity.norm() < 0.02);
    CHECK(std::acos(std::min(1.0, navigation->up.z())) < 0.05);
  }
}

TEST_CASE("Sweeper without odometry goes on without it", "[motion]") {
  Sweeper sweeper(Room().rig(MotionSensors{}), small_options());
  feed(sweeper, drive().signals, drive().images);
  sweeper.finish();
  const std::vector<TrackedImage> images = sweeper.images();
  REQUIRE(images.size() == kImages);
  check_sound(images);
  CHECK_FALSE(sweeper.navigation());
  CHECK(images[0].T_map_body.matrix() == SE3d().matrix());
  for (int i = 0; i < kImages; ++i) {
    const TrackedImage& image = images[static_cast<std::size_t>(i)];
    CHECK(image.basis == PoseBasis::vision);
    CHECK(error_of(image.T_map_body, SE3d(), image_time(i)).head<3>().norm() < 0.04);
  }
}

TEST_CASE("Sweeper with odometry repeats itself to the bit", "[motion]") {
  const auto run = [](EventRecord& events) {
    auto sweeper = std::make_unique<Sweeper>(Room().rig(drive().signals.sensors()), small_options(), &events);
    feed(*sweeper, drive().signals, drive().dark);
    sweeper->finish();
    return sweeper;
  };
  EventRecord events_a, events_b;
  const auto a = run(events_a), b = run(events_b);
  CHECK(events_a.text() == events_b.text());
  const auto images_a = a->images(), images_b = b->images();
  REQUIRE(images_a.size() == images_b.size());
  for (std::size_t i = 0; i < images_a.size(); ++i) {
    CHECK(images_a[i].T_map_body.matrix() == images_b[i].T_map_body.matrix());
    CHECK(images_a[i].covariance == images_b[i].covariance);
    CHECK(a->optimized_pose(images_a[i]).matrix() == b->optimized_pose(images_b[i]).matrix());
  }
  CHECK(a->navigation()->covariance == b->navigation()->covariance);
  CHECK(a->navigation()->gyro_bias == b->navigation()->gyro_bias);
}

TEST_CASE("Sweeper::pose_at answers at the rate of the sensors, beyond the last image too", "[motion]") {
  for (const auto& [imu, wheels] : {std::pair{true, true}, std::pair{false, true}, std::pair{true, false}}) {
    CAPTURE(imu, wheels);
    Sweeper sweeper(Room().rig(drive().signals.sensors(imu, wheels)), small_options());
    // In the middle of the drive: 0.45 m/s.
    constexpr int kLast = 16;
    const std::vector<StereoImage> first(drive().images.begin(), drive().images.begin() + kLast + 1);
    feed(sweeper, drive().signals, first);
    const TimeNs last = first.back().t, end = last + from_seconds(0.2);
    for (const ImuSample& s : drive().signals.imu)
      if (s.t > last && s.t <= end) sweeper.feed(s);
    for (const WheelSample& s : drive().signals.wheels)
      if (s.t > last && s.t <= end) sweeper.feed(s);
    const SE3d T_first = sweeper.images()[0].T_map_body;
    std::optional<SE3d> before;
    for (TimeNs t = first.front().t; t <= end; t += kNsPerSecond / 200) {
      for (const Frame frame : {Frame::odom, Frame::map}) {
        const auto pose = sweeper.pose_at(t, frame);
        REQUIRE(pose);
        CHECK(pose->t == t);
        CHECK(sound(pose->covariance));
        CAPTURE(to_seconds(t));
        const Vec6<double> e = error_of(pose->T_frame_body, T_first, to_seconds(t));
        CHECK(e.head<3>().norm() < 0.03);
        CHECK(e.tail<3>().norm() < 0.02);
        if (t > last) CHECK(pose->basis == PoseBasis::odometry);
        if (t <= last || frame == Frame::map) continue;
        // It moves on at every sample: 2 mm each, and never jumps.
        if (before) {
          const double step = (before->inverse() * pose->T_frame_body).translation().norm();
          CHECK(step > 0.0005);
          CHECK(step < 0.006);
        }
        before = pose->T_frame_body;
      }
    }
    CHECK_FALSE(sweeper.pose_at(end + kNsPerSecond / 50));
    CHECK_FALSE(sweeper.pose_at(first.front().t - 1));
  }
}

TEST_CASE("Sweeper with odometry in real time, fed from three threads", "[motion][realtime]") {
  EventRecord events;
  SweeperOptions options = small_options(true);
  options.image_queue = 1000;
  Sweeper sweeper(Room().rig(drive().signals.sensors()), options, &events);
  std::atomic<bool> done = false;
  std::thread imu([&] {
    for (const ImuSample& s : drive().signals.imu) sweeper.feed(s);
  });
  std::thread wheels([&] {
    for (const WheelSample& s : drive().signals.wheels) sweeper.feed(s);
  });
  std::thread cameras([&] {
    for (const StereoImage& image : drive().dark) sweeper.feed(image);
  });
  int wrong = 0;
  std::thread reader([&] {
    while (!done) {
      for (double t = kBegin; t < image_time(kImages); t += 0.01) {
        const auto pose = sweeper.pose_at(from_seconds(t));
        wrong += pose && !(pose->T_frame_body.matrix().allFinite() && pose->covariance.allFinite());
      }
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
  });
  imu.join();
  wheels.join();
  cameras.join();
  sweeper.finish();
  done = true;
  reader.join();
  CHECK(wrong == 0);
  const std::vector<TrackedImage> images = sweeper.images();
  REQUIRE(images.size() == kImages);
  check_sound(images);
  CHECK(sweeper.counts().samples_dropped == 0);
  // Which samples had come when an image was tracked is the machine's: where vision saw, it is right.
  for (int i = 0; i < kImages; ++i) {
    const TrackedImage& image = images[static_cast<std::size_t>(i)];
    if (image.basis == PoseBasis::vision)
      CHECK(error_of(image.T_odom_body, images[0].T_odom_body, image_time(i)).head<3>().norm() < 0.1);
  }
  CHECK_FALSE(sweeper.map().broken_invariant());
}

TEST_CASE("Sweeper bears what sensors of motion do wrong", "[motion]") {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const auto run = [&](const BodySignals& signals, std::int64_t dropped, double metres,
                       const std::vector<StereoImage>& images = drive().images) {
    EventRecord events;
    Sweeper sweeper(Room().rig(signals.sensors()), small_options(), &events);
    feed(sweeper, signals, images);
    sweeper.finish();
    CHECK(sweeper.counts().samples_dropped == dropped);
    CHECK(events.named("sample_dropped").size() == static_cast<std::size_t>(dropped));
    const std::vector<TrackedImage> tracked = sweeper.images();
    REQUIRE(tracked.size() == images.size());
    check_sound(tracked);
    double worst = 0;
    for (int i = 0; i < kImages; ++i)
      worst = std::max(worst, error_of(tracked[static_cast<std::size_t>(i)].T_map_body, tracked[0].T_map_body,
                                       image_time(i))
                                  .head<3>()
                                  .norm());
    CHECK(worst < metres);
    return events.named("sensor_gap").size();
  };
  const auto between = [](const auto& s, double a, double b) {
    return to_seconds(s.t) > a && to_seconds(s.t) < b;
  };
  BodySignals signals = drive().signals;

  SECTION("not a number, twice, and time backwards: dropped and told") {
    signals.imu[400].gyro.x() = nan;
    signals.imu[410].accel.z() = std::numeric_limits<double>::infinity();
    signals.imu[420].t = signals.imu[419].t;
    signals.imu[430].t -= from_seconds(0.5);
    signals.wheels[110].left = nan;
    signals.wheels[120].t = signals.wheels[119].t;
    signals.wheels[130].t -= from_seconds(0.5);
    run(signals, 7, 0.03);
  }
  SECTION("a second of silence of the IMU") {
    std::erase_if(signals.imu, [&](const auto& s) { return between(s, 2, 3); });
    CHECK(run(signals, 0, 0.03) == 1);
  }
  SECTION("a second of silence of the wheels") {
    std::erase_if(signals.wheels, [&](const auto& s) { return between(s, 2, 3); });
    CHECK(run(signals, 0, 0.03) == 1);
  }
  SECTION("a second of silence of both") {
    std::erase_if(signals.imu, [&](const auto& s) { return between(s, 2, 3); });
    std::erase_if(signals.wheels, [&](const auto& s) { return between(s, 2, 3); });
    CHECK(run(signals, 0, 0.04) == 2);
  }
  SECTION("counters that begin anew, and wrap, in the dark") {
    const WheelSample at = signals.wheels[115];
    for (WheelSample& s : signals.wheels) {
      if (between(s, 2.3, 9)) s.left -= at.left, s.right -= at.right;
      if (between(s, 2.6, 9)) s.left -= 0x1p16, s.right -= 0x1p16;
    }
    run(signals, 0, 0.04, drive().dark);
  }
  SECTION("saturation") {
    for (ImuSample& s : signals.imu)
      if (between(s, 2.0, 2.02)) s.gyro.setConstant(1e5), s.accel.setConstant(-1e7);
    run(signals, 0, 0.04);
  }
  SECTION("wheels late and early by 50 ms") {
    for (const double shift : {-0.05, 0.05}) {
      BodySignals shifted = drive().signals;
      for (WheelSample& s : shifted.wheels) s.t += from_seconds(shift);
      run(shifted, 0, 0.05, drive().dark);
    }
  }
}
