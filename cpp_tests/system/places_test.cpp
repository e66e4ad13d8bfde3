// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
// Places known again, through the whole system.
#include <algorithm>
#include <catch2/catch.hpp>
#include <chrono>
#include <cmath>
#include <numbers>
#include <thread>
#include <vector>

#include "scratch_folder.hpp"
#include "sweepkit/bow/default_vocabulary.hpp"
#include "sweepkit/core/error.hpp"
#include "sweepkit/data/atlas_file.hpp"
#include "sweepkit/system/sweeper.hpp"
#include "system/event_record.hpp"
#include "system/room.hpp"

using namespace sweepkit;

namespace {

constexpr int kFirst = 36, kDark = 6, kSecond = 32;  // images of a first drive, between, of a second

SweeperOptions small_options(bool realtime = false) {
  SweeperOptions options;
  options.realtime = realtime;
  options.frontend.orb.count = 700;
  return options;
}

/// The drive, and then a turn on the spot until it looks at another wall.
SE3d first_pose(int i) {
  return drive_pose(std::min(i, 23)) * SE3d(SO3d::exp({0, 0, 0.16 * std::max(i - 23, 0)}), {0, 0, 0});
}

/// Through views that the first drive saw, a little beside its path; it takes a long turn to be believed.
SE3d second_pose(int i) { return first_pose(4 + i) * SE3d(SO3d::exp({0, 0, 0.03}), {0.01, 0.03, 0}); }

/// The first drive, darkness, the second drive.
const std::vector<StereoImage>& all_images() {
  static const std::vector<StereoImage> images = [] {
    const Room room;
    std::vector<StereoImage> drawn = drive_images();
    const auto now = [&] { return kFirstImage + static_cast<TimeNs>(drawn.size()) * kImagePeriod; };
    for (int i = 24; i < kFirst; ++i) drawn.push_back(room.see(now(), first_pose(i)));
    for (int i = 0; i < kDark; ++i) drawn.push_back({now(), Room::black(), Room::black()});
    for (int i = 0; i < kSecond; ++i) drawn.push_back(room.see(now(), second_pose(i)));
    return drawn;
  }();
  return images;
}
std::vector<StereoImage> second_images() {
  return {all_images().begin() + kFirst + kDark, all_images().end()};
}

SE3d in_map(const SE3d& T_room_body) { return drive_pose(0).inverse() * T_room_body; }

void check_near(const SE3d& T_map_body, const SE3d& T_room_body) {
  const SE3d difference = in_map(T_room_body).inverse() * T_map_body;
  CAPTURE(difference.translation().transpose());
  CHECK(difference.translation().norm() < 0.05);
  CHECK(difference.rotation().angle() * 180 / std::numbers::pi < 1.5);
}

}  // namespace

TEST_CASE("a robot carried off in the dark finds back into its map", "[places]") {
  EventRecord events;
  Sweeper sweeper(Room().rig(), small_options(), &events);
  for (const StereoImage& image : all_images()) sweeper.feed(image);
  sweeper.finish();
  INFO(events.text());

  REQUIRE(events.named("map_created").size() == 2);
  CHECK(to_json(events.named("map_created")[1]).find("\"reason\": \"lost\"") != std::string::npos);
  REQUIRE(events.named("maps_joined").size() == 1);
  REQUIRE(events.named("relocalized").size() == 1);
  CHECK(sweeper.counts().maps_joined == 1);
  CHECK(sweeper.map().maps().size() == 1);
  CHECK_FALSE(sweeper.map().broken_invariant());
  CHECK(sweeper.place_counts().accepted >= 1);

  const std::vector<TrackedImage> images = sweeper.images();
  check_near(images.back().T_map_body, second_pose(kSecond - 1));
  for (int i = 0; i < kSecond; ++i) {
    CAPTURE(i);
    check_near(sweeper.optimized_pose(images[static_cast<std::size_t>(kFirst + kDark + i)]), second_pose(i));
  }
  // The map jumps; odom goes on as the robot does.
  for (std::size_t i = 1; i < images.size(); ++i)
    CHECK((images[i].T_odom_body.translation() - images[i - 1].T_odom_body.translation()).norm() < 0.15);
}

TEST_CASE("where twins are not feared a robot finds back sooner, and looks closely until it has",
          "[places]") {
  struct Outcome {
    TimeNs found = 0;
    int before = 0, after = 0;  // keyframes of the second drive
  };
  const TimeNs begin = second_images().front().t;
  const auto run = [&](bool twins, double seek_time) {
    EventRecord events;
    SweeperOptions options = small_options();
    options.places.recognizer.twins = twins;
    options.places.seek_time = seek_time;
    Sweeper sweeper(Room().rig(), options, &events);
    for (const StereoImage& image : all_images()) sweeper.feed(image);
    sweeper.finish();
    INFO(events.text());
    REQUIRE(events.named("relocalized").size() == 1);
    check_near(sweeper.images().back().T_map_body, second_pose(kSecond - 1));
    Outcome outcome{.found = events.named("relocalized")[0].t, .before = 0, .after = 0};
    for (std::uint32_t k = 0; k < sweeper.map().keyframe_id_end(); ++k)
      if (const Keyframe* keyframe = sweeper.map().find(KeyframeId{k}); keyframe && keyframe->t >= begin)
        ++(keyframe->t <= outcome.found ? outcome.before : outcome.after);
    return outcome;
  };
  const Outcome feared = run(true, 10), seeking = run(false, 10), casual = run(false, 0);
  CHECK(seeking.found < feared.found);
  CHECK(seeking.found <= casual.found);
  const auto pace = [&](const Outcome& outcome) {
    return outcome.before / (1 + to_seconds(outcome.found - begin) / to_seconds(kImagePeriod));
  };
  CHECK(pace(seeking) > pace(feared));
  // Once it has, keyframes are as far apart as ever.
  const double left = kSecond - to_seconds(seeking.found - begin) / to_seconds(kImagePeriod);
  CHECK(seeking.after / left < pace(seeking));
  CHECK(run(true, 0).before == feared.before);
}

TEST_CASE("without places known again maps stay apart", "[places]") {
  SweeperOptions options = small_options();
  options.places.enabled = false;
  Sweeper sweeper(Room().rig(), options);
  for (const StereoImage& image : all_images()) sweeper.feed(image);
  sweeper.finish();
  CHECK(sweeper.map().maps().size() == 2);
  CHECK(sweeper.place_counts().queries == 0);
}

TEST_CASE("a second run finds its way in the atlas of the first", "[places]") {
  const ScratchFolder folder;
  const std::string file = (folder / "home.swk").string();
  {
    Sweeper first(Room().rig(), small_options());
    first.save_atlas(file);  // an empty one, in any state
    for (int i = 0; i < kFirst; ++i) first.feed(all_images()[static_cast<std::size_t>(i)]);
    first.finish();
    first.save_atlas(file);
    CHECK(read_atlas(file).info.vocabulary_checksum == default_orb_vocabulary()->info().checksum);
  }
  const auto run = [&] {
    EventRecord events;
    Sweeper second(Room().rig(), small_options(), &events);
    second.resume(read_atlas(file), file);
    for (const StereoImage& image : second_images()) second.feed(image);
    second.finish();
    INFO(events.text());
    CHECK(events.named("maps_joined").size() == 1);
    CHECK(second.map().maps().size() == 1);
    CHECK_FALSE(second.map().broken_invariant());
    const std::vector<TrackedImage> images = second.images();
    REQUIRE(images.size() == kSecond);
    std::vector<SE3d> poses;
    for (int i = 0; i < kSecond; ++i) {
      poses.push_back(second.optimized_pose(images[static_cast<std::size_t>(i)]));
      check_near(poses.back(), second_pose(i));
    }
    second.save_atlas(file + ".2");
    return poses;
  };
  const std::vector<SE3d> once = run(), again = run();
  for (std::size_t i = 0; i < once.size(); ++i) CHECK(once[i].matrix() == again[i].matrix());
  CHECK(read_atlas(file + ".2").map.keyframe_count() > read_atlas(file).map.keyframe_count());
}

TEST_CASE("an atlas that cannot serve is refused", "[places]") {
  const Room room;
  const auto other_rig = [&] {
    Rig rig = room.rig(MotionSensors{});
    rig.right->T_body_camera = rig.right->T_body_camera * SE3d(SO3d(), Vec3<double>(0.01, 0, 0));
    return rig.stereo();
  };
  Sweeper first(other_rig(), small_options());
  for (int i = 0; i < 3; ++i) first.feed(drive_images()[static_cast<std::size_t>(i)]);
  first.finish();
  const ScratchFolder folder;
  const std::string file = (folder / "home.swk").string();
  first.save_atlas(file);

  Sweeper second(room.rig(), small_options());
  CHECK_THROWS_WITH(second.resume(read_atlas(file), file), Catch::Contains("home.swk") &&
                                                               Catch::Contains("another rig") &&
                                                               Catch::Contains("right"));
  Sweeper empty(room.rig(), small_options());
  empty.save_atlas(file);
  CHECK_NOTHROW(second.resume(read_atlas(file), file));
  second.feed(drive_images()[0]);
  CHECK_THROWS_AS(second.resume(read_atlas(file), file), Error);
  second.finish();
  CHECK(second.map().keyframe_count() == 1);
  CHECK_THROWS_AS(second.save_atlas((folder / "no_such_folder/home.swk").string()), Error);

  SweeperOptions options = small_options();
  options.places.vocabulary = file;
  CHECK_THROWS_AS(Sweeper(room.rig(), options), Error);
}

TEST_CASE("maps are joined in real time too, and saved meanwhile", "[places][realtime]") {
  const ScratchFolder folder;
  const std::string file = (folder / "home.swk").string();
  SweeperOptions options = small_options(true);
  options.image_queue = 100;
  Sweeper sweeper(Room().rig(), options);
  std::thread saver([&] {
    for (int i = 0; i < 20; ++i) {
      sweeper.save_atlas(file);
      std::this_thread::sleep_for(std::chrono::milliseconds(20));
    }
  });
  for (const StereoImage& image : all_images()) sweeper.feed(image);
  saver.join();
  sweeper.finish();
  CHECK_FALSE(sweeper.map().broken_invariant());
  CHECK(sweeper.images().size() == all_images().size());
  CHECK_NOTHROW(read_atlas(file));
  for (const TrackedImage& image : sweeper.images()) {
    CHECK(image.T_map_body.matrix().allFinite());
    CHECK(sweeper.optimized_pose(image).matrix().allFinite());
  }
}
