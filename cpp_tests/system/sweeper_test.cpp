// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/system/sweeper.hpp"

#include <Eigen/Eigenvalues>
#include <atomic>
#include <catch2/catch.hpp>
#include <chrono>
#include <cmath>
#include <limits>
#include <numbers>
#include <thread>

#include "system/event_record.hpp"
#include "system/room.hpp"

using namespace sweepkit;

namespace {

SweeperOptions small_options(bool realtime = false) {
  SweeperOptions options;
  options.realtime = realtime;
  options.frontend.orb.count = 500;
  return options;
}

SE3d true_pose(int image) { return drive_pose(0).inverse() * drive_pose(image); }

double angle_deg(const SE3d& T) { return T.rotation().log().norm() * 180 / std::numbers::pi; }

void check_near_truth(const SE3d& T, int image, double metres, double degrees) {
  const SE3d difference = true_pose(image).inverse() * T;
  CAPTURE(image, difference.translation().transpose(), angle_deg(difference));
  CHECK(difference.translation().norm() < metres);
  CHECK(angle_deg(difference) < degrees);
}

bool same_bits(const SE3d& a, const SE3d& b) { return a.matrix() == b.matrix(); }

bool finite(const SE3d& T) { return T.matrix().allFinite(); }

}  // namespace

// 320x200 pixels, f = 175 px: a pixel is a third of a degree.
TEST_CASE("Sweeper follows a drive", "[sweeper]") {
  EventRecord events;
  Sweeper sweeper(Room().rig(), small_options(), &events);
  for (const StereoImage& image : drive_images()) sweeper.feed(image);
  sweeper.finish();

  const std::vector<TrackedImage> images = sweeper.images();
  REQUIRE(images.size() == drive_images().size());
  CHECK(same_bits(images.front().T_map_body, SE3d()));
  for (std::size_t i = 0; i < images.size(); ++i) {
    CHECK(images[i].t == drive_images()[i].t);
    CHECK(images[i].basis == PoseBasis::vision);
    check_near_truth(images[i].T_map_body, static_cast<int>(i), 0.04, 1);
    check_near_truth(sweeper.optimized_pose(images[i]), static_cast<int>(i), 0.04, 1);
    if (i == 0) continue;
    const Eigen::SelfAdjointEigenSolver<Mat6<double>> eigen(images[i].covariance);
    CHECK(eigen.eigenvalues().minCoeff() > 0);
    CHECK(eigen.eigenvalues().maxCoeff() < 1e-3);
  }
  const SweeperCounts counts = sweeper.counts();
  CHECK(counts.images_lost == 0);
  CHECK(counts.images_dropped == 0);
  CHECK(counts.keyframes_made >= 2);
  CHECK(sweeper.map().keyframe_count() >= 2);
  CHECK_FALSE(sweeper.map().broken_invariant());
  CHECK(events.all().front().name == "started");
  CHECK(events.named("map_created").size() == 1);
  CHECK(events.all().back().name == "stopped");
  CHECK(sweeper.images(images.size() - 2).size() == 2);
  CHECK(sweeper.images(images.size() + 5).empty());
}

TEST_CASE("a Sweeper forgets old images as it was told to", "[sweeper]") {
  SweeperOptions options = small_options();
  Sweeper whole(Room().rig(), options);
  options.history = 5;
  Sweeper brief(Room().rig(), options);
  const std::vector<StereoImage> drive = drive_images();
  for (const StereoImage& image : drive) {
    whole.feed(image);
    brief.feed(image);
  }
  const std::vector<TrackedImage> all = whole.images(), kept = brief.images();
  REQUIRE(kept.size() == 5);
  for (std::size_t k = 0; k < kept.size(); ++k) CHECK(kept[k].t == all[all.size() - 5 + k].t);
  CHECK(brief.images(all.size() - 2).front().t == all[all.size() - 2].t);
  CHECK(brief.images(all.size()).empty());
  CHECK_FALSE(brief.pose_at(all[all.size() - 6].t));
  CHECK(brief.pose_at(kept.front().t)->T_frame_body.matrix() ==
        whole.pose_at(kept.front().t)->T_frame_body.matrix());
}

TEST_CASE("Sweeper in line repeats itself to the bit", "[sweeper]") {
  EventRecord events[2];
  std::vector<TrackedImage> images[2];
  std::vector<Vec3<double>> points[2];
  for (int run = 0; run < 2; ++run) {
    Sweeper sweeper(Room().rig(), small_options(), &events[run]);
    for (const StereoImage& image : drive_images()) sweeper.feed(image);
    sweeper.finish();
    images[run] = sweeper.images();
    for (std::uint32_t i = 0; i < sweeper.map().point_id_end(); ++i)
      if (const MapPoint* point = sweeper.map().find(PointId{i})) points[run].push_back(point->p_world);
  }
  REQUIRE(images[0].size() == images[1].size());
  for (std::size_t i = 0; i < images[0].size(); ++i) {
    CHECK(same_bits(images[0][i].T_map_body, images[1][i].T_map_body));
    CHECK(same_bits(images[0][i].T_odom_body, images[1][i].T_odom_body));
    CHECK(images[0][i].covariance == images[1][i].covariance);
  }
  CHECK(points[0] == points[1]);
  CHECK(events[0].text() == events[1].text());
}

TEST_CASE("Sweeper::pose_at answers from the first image to the newest sample", "[sweeper]") {
  Sweeper sweeper(Room().rig(), small_options());
  CHECK_FALSE(sweeper.pose_at(kFirstImage));
  for (const StereoImage& image : drive_images()) sweeper.feed(image);
  const TimeNs last = drive_images().back().t;
  const std::vector<TrackedImage> images = sweeper.images();

  CHECK_FALSE(sweeper.pose_at(kFirstImage - 1));
  CHECK_FALSE(sweeper.pose_at(last + 1));
  CHECK(same_bits(sweeper.pose_at(last)->T_frame_body, images.back().T_odom_body));
  CHECK(same_bits(sweeper.pose_at(last, Frame::map)->T_frame_body, images.back().T_map_body));

  // Halfway between two images it is halfway between their poses.
  const SE3d& a = images[10].T_odom_body;
  const SE3d& b = images[11].T_odom_body;
  const SE3d middle = sweeper.pose_at(images[10].t + kImagePeriod / 2)->T_frame_body;
  CHECK(((a.inverse() * middle).log() - (middle.inverse() * b).log()).norm() < 1e-9);

  // A newer sample of any sensor lets it look ahead, as a guess that goes on moving.
  sweeper.feed(ImuSample{last + kImagePeriod, {0, 0, 0}, {0, 0, 9.81}});
  const auto ahead = sweeper.pose_at(last + kImagePeriod);
  REQUIRE(ahead);
  CHECK(ahead->basis == PoseBasis::guess);
  check_near_truth(ahead->T_frame_body, static_cast<int>(images.size()), 0.06, 2);
  CHECK_FALSE(sweeper.pose_at(last + kImagePeriod + 1));
}

TEST_CASE("Sweeper drops what it cannot use, says so, and goes on", "[sweeper]") {
  EventRecord events;
  Sweeper sweeper(Room().rig(), small_options(), &events);
  const std::vector<StereoImage>& drive = drive_images();
  for (int i = 0; i < 8; ++i) sweeper.feed(drive[i]);

  const auto dropped_as = [&](const std::string& sensor, const std::string& reason) {
    const std::vector<Event> dropped = events.named("sample_dropped");
    if (dropped.empty()) return false;
    const std::string line = to_json(dropped.back());
    CAPTURE(line);
    CHECK(line.find("\"sensor\": \"" + sensor + "\"") != std::string::npos);
    CHECK(line.find(reason) != std::string::npos);
    return sweeper.counts().samples_dropped == static_cast<std::int64_t>(dropped.size());
  };
  sweeper.feed(drive[7]);
  CHECK(dropped_as("cameras", "time does not advance"));
  sweeper.feed(drive[3]);
  CHECK(dropped_as("cameras", "time does not advance"));
  StereoImage bad = drive[8];
  bad.right = Room::black(Room::kWidth / 2, Room::kHeight);
  sweeper.feed(bad);
  CHECK(dropped_as("cam1", "160x200"));
  bad = drive[8];
  bad.left = Room::black(Room::kWidth, Room::kHeight + 1);
  sweeper.feed(bad);
  CHECK(dropped_as("cam0", "320x201"));

  const double nan = std::numeric_limits<double>::quiet_NaN();
  const TimeNs t = drive[8].t;
  sweeper.feed(ImuSample{t, {0, nan, 0}, {0, 0, 9.81}});
  CHECK(dropped_as("imu", "not finite"));
  sweeper.feed(ImuSample{t, {0, 0, 0}, {0, 0, 9.81}});
  sweeper.feed(ImuSample{t, {0, 0, 0}, {0, 0, 9.81}});
  CHECK(dropped_as("imu", "time does not advance"));
  sweeper.feed(WheelSample{t, WheelReading::ticks, std::numeric_limits<double>::infinity(), 0});
  CHECK(dropped_as("wheels", "not finite"));
  sweeper.feed(WheelSample{t, WheelReading::ticks, 1, 2});
  sweeper.feed(WheelSample{t - 1, WheelReading::ticks, 1, 2});
  CHECK(dropped_as("wheels", "time does not advance"));
  CHECK(sweeper.counts().samples_dropped == 8);
  CHECK(sweeper.counts().imu_samples == 1);
  CHECK(sweeper.counts().wheel_samples == 1);
  CHECK(sweeper.images().size() == 8);

  // The image whose first copies were refused is still welcome.
  for (std::size_t i = 8; i < drive.size(); ++i) sweeper.feed(drive[i]);
  sweeper.finish();
  CHECK(sweeper.counts().images_lost == 0);
  check_near_truth(sweeper.images().back().T_map_body, static_cast<int>(drive.size()) - 1, 0.04, 1);
  for (const TrackedImage& image : sweeper.images()) CHECK(finite(image.T_map_body));

  StereoImage late = drive.back();
  late.t += kImagePeriod;
  sweeper.feed(late);
  CHECK(dropped_as("cameras", "finished"));
  sweeper.feed(ImuSample{late.t, {0, 0, 0}, {0, 0, 9.81}});
  CHECK(dropped_as("imu", "finished"));
  sweeper.finish();
  CHECK(events.named("stopped").size() == 1);
}

TEST_CASE("Sweeper carries the pose on while a camera gives nothing", "[sweeper]") {
  EventRecord events;
  Sweeper sweeper(Room().rig(), small_options(), &events);
  for (int i = 0; i < 24; ++i) {
    StereoImage image = drive_images()[i];
    if (i == 12) image.right = {};
    if (i == 13) image.left = {};
    if (i == 14) image.left = image.right = {};
    sweeper.feed(image);
  }
  sweeper.finish();
  CHECK(sweeper.counts().images_missing == 3);
  const std::vector<Event> missing = events.named("image_missing");
  REQUIRE(missing.size() == 3);
  CHECK(to_json(missing[0]).find("cam1") != std::string::npos);
  CHECK(to_json(missing[1]).find("cam0") != std::string::npos);
  const std::vector<TrackedImage> images = sweeper.images();
  REQUIRE(images.size() == 24);
  for (int i = 12; i < 15; ++i) {
    CHECK(images[i].basis == PoseBasis::guess);
    check_near_truth(images[i].T_map_body, i, 0.12, 3);
  }
  check_near_truth(images[23].T_map_body, 23, 0.04, 1);
}

TEST_CASE("Sweeper says when it is lost and when it is back", "[sweeper]") {
  EventRecord events;
  Sweeper sweeper(Room().rig(), small_options(), &events);
  for (int i = 0; i < 24; ++i) {
    StereoImage image = drive_images()[i];
    if (i >= 10 && i < 12) image.left = image.right = Room::black();
    sweeper.feed(image);
  }
  sweeper.finish();
  REQUIRE(events.named("lost").size() == 1);
  CHECK(events.named("lost")[0].t == drive_images()[10].t);
  REQUIRE(events.named("recovered").size() == 1);
  CHECK(events.named("recovered")[0].t == drive_images()[12].t);
  CHECK(sweeper.counts().images_lost == 2);
  const std::vector<TrackedImage> images = sweeper.images();
  REQUIRE(images.size() == 24);
  for (int i = 10; i < 12; ++i) {
    CHECK(images[i].basis != PoseBasis::vision);
    CHECK(finite(images[i].T_map_body));
    // It stays near where it was last seen: 4 cm an image.
    CHECK((images[i].T_map_body.translation() - images[9].T_map_body.translation()).norm() < 0.15);
  }
  // The map is still there: back in place, at first by the few points that are still in view.
  for (int i = 12; i < 24; ++i)
    check_near_truth(images[i].T_map_body, i, i < 18 ? 0.05 : 0.04, i < 18 ? 1.5 : 1);
}

TEST_CASE("Sweeper starts again at the last pose after a long darkness", "[sweeper]") {
  EventRecord events;
  Sweeper sweeper(Room().rig(), small_options(), &events);
  const auto& drive = drive_images();
  TimeNs t = kFirstImage;
  for (int i = 0; i < 10; ++i, t += kImagePeriod) sweeper.feed(drive[i]);
  for (int i = 0; i < 8; ++i, t += kImagePeriod) sweeper.feed({t, Room::black(), Room::black()});
  // The robot was carried off in the dark: nothing looks as before.
  const Room room;
  const SE3d elsewhere(SO3d::exp({0, 0, 2.6}), {0.3, -0.4, 0});
  for (int i = 0; i < 6; ++i, t += kImagePeriod) sweeper.feed(room.see(t, elsewhere * drive_pose(2 + i)));
  sweeper.finish();
  REQUIRE(events.named("recovered").size() == 1);
  CHECK(to_json(events.named("recovered")[0]).find("\"restarted\": true") != std::string::npos);
  const std::vector<TrackedImage> images = sweeper.images();
  REQUIRE(images.size() == 24);
  CHECK(images.back().basis == PoseBasis::vision);
  for (const TrackedImage& image : images) CHECK(finite(image.T_map_body));
  // Continuous: no step is longer than a drive's would be.
  for (std::size_t i = 1; i < images.size(); ++i)
    CHECK((images[i].T_odom_body.translation() - images[i - 1].T_odom_body.translation()).norm() < 0.15);
  CHECK_FALSE(sweeper.map().broken_invariant());
}

TEST_CASE("Sweeper never starts on black images, and has no pose to be wrong about", "[sweeper]") {
  EventRecord events;
  Sweeper sweeper(Room().rig(), small_options(), &events);
  for (int i = 0; i < 5; ++i) sweeper.feed({kFirstImage + i * kImagePeriod, Room::black(), Room::black()});
  sweeper.finish();
  CHECK(sweeper.counts().keyframes_made == 0);
  CHECK(sweeper.counts().images_lost == 0);
  CHECK(events.named("map_created").empty());
  for (const TrackedImage& image : sweeper.images()) {
    CHECK(same_bits(image.T_map_body, SE3d()));
    CHECK(image.basis == PoseBasis::guess);
  }
}

TEST_CASE("Sweeper refuses options out of range", "[sweeper]") {
  SweeperOptions options;
  options.image_queue = 0;
  CHECK_THROWS_AS(Sweeper(Room().rig(), options), Error);
  options = {};
  options.tracker.search_radius = std::numeric_limits<double>::quiet_NaN();
  CHECK_THROWS_AS(Sweeper(Room().rig(), options), Error);
}

TEST_CASE("Sweeper in real time is fed from three threads and read from a fourth", "[sweeper][realtime]") {
  EventRecord events;
  SweeperOptions options = small_options(true);
  options.image_queue = 1000;  // so that none is dropped, however slow the machine
  Sweeper sweeper(Room().rig(), options, &events);
  const TimeNs begin = kFirstImage, end = drive_images().back().t;
  std::atomic<bool> done = false;
  std::thread imu([&] {
    for (TimeNs t = begin; t <= end; t += kNsPerSecond / 200)
      sweeper.feed(ImuSample{t, {0, 0, 0}, {0, 0, 9.81}});
  });
  std::thread wheels([&] {
    for (TimeNs t = begin; t <= end; t += kNsPerSecond / 50)
      sweeper.feed(WheelSample{t, WheelReading::ticks, 0, 0});
  });
  std::thread cameras([&] {
    for (const StereoImage& image : drive_images()) sweeper.feed(image);
  });
  int answers = 0, wrong = 0;
  std::thread reader([&] {
    while (!done) {
      for (TimeNs t = begin; t <= end; t += kNsPerSecond / 100) {
        const auto pose = sweeper.pose_at(t);
        if (!pose) continue;
        ++answers;
        wrong += pose->t != t || !finite(pose->T_frame_body) || !pose->covariance.allFinite();
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
  const SweeperCounts counts = sweeper.counts();
  CHECK(counts.images == static_cast<std::int64_t>(drive_images().size()));
  CHECK(counts.imu_samples == (end - begin) / (kNsPerSecond / 200) + 1);
  CHECK(counts.wheel_samples == (end - begin) / (kNsPerSecond / 50) + 1);
  CHECK(counts.samples_dropped == 0);
  CHECK(counts.images_dropped == 0);
  // Fed all at once, mapping lags behind by as much as the machine decides; frames are tracked from one to
  // the next.
  const std::vector<TrackedImage> images = sweeper.images();
  for (std::size_t i = 0; i < images.size(); ++i) {
    CHECK(images[i].t == drive_images()[i].t);
    if (images[i].basis == PoseBasis::vision)
      check_near_truth(images[i].T_map_body, static_cast<int>(i), 0.06, 2);
  }
  CHECK_FALSE(sweeper.map().broken_invariant());
}

TEST_CASE("Sweeper in real time drops images that come too fast, and says how many", "[sweeper][realtime]") {
  EventRecord events;
  SweeperOptions options = small_options(true);
  options.image_queue = 1;
  Sweeper sweeper(Room().rig(), options, &events);
  for (const StereoImage& image : drive_images()) sweeper.feed(image);
  sweeper.finish();
  const SweeperCounts counts = sweeper.counts();
  // All at once: far faster than any machine tracks.
  CHECK(counts.images_dropped > 0);
  CHECK(counts.images + counts.images_dropped == static_cast<std::int64_t>(drive_images().size()));
  const std::vector<Event> overload = events.named("overload");
  REQUIRE(static_cast<std::int64_t>(overload.size()) == counts.images_dropped);
  CHECK(to_json(overload.back()).find("\"images_dropped\": " + std::to_string(counts.images_dropped)) !=
        std::string::npos);
  // The newest image is never the one that goes.
  CHECK(sweeper.images().back().t == drive_images().back().t);
  // Every image has a pose: those dropped a guess.
  const std::vector<TrackedImage> images = sweeper.images();
  REQUIRE(images.size() == drive_images().size());
  for (std::size_t i = 0; i < images.size(); ++i) {
    CHECK(images[i].t == drive_images()[i].t);
    CHECK(finite(images[i].T_map_body));
  }
}

TEST_CASE("Sweeper ends at once with images still queued", "[sweeper][realtime]") {
  SweeperOptions options = small_options(true);
  options.image_queue = 1000;
  Sweeper sweeper(Room().rig(), options);
  for (const StereoImage& image : drive_images()) sweeper.feed(image);
}
