// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/slam/place_recognition.hpp"

#include <catch2/catch.hpp>
#include <initializer_list>
#include <numbers>
#include <utility>

#include "slam/place_world.hpp"

using namespace sweepkit;

namespace {

constexpr TimeNs kSecond = 1000000000LL;

double degrees(const SE3d& T) { return T.rotation().angle() * 180 / std::numbers::pi; }

// A drive of keyframes along the middle of a room.
SE3d drive_view(double x, double y, int k) {
  return PlaceWorld::level_view(x - 1 + 0.05 * k, y - 0.4 + 0.12 * k, 0.04 * k);
}

// Options with which one image is never enough.
PlaceRecognizerOptions careful() {
  PlaceRecognizerOptions options;
  options.sure_inliers = 100000;
  return options;
}

PlaceRecognizer recognizer(const PlaceWorld& world, const PlaceRecognizerOptions& options = {}) {
  return PlaceRecognizer(PlaceWorld::camera(), PlaceWorld::view(), PlaceWorld::levels(), world.vocabulary(),
                         options);
}

// A map of eight keyframes in each of the rooms about these x.
Map mapped(PlaceWorld& world, std::initializer_list<double> rooms) {
  Map map;
  const MapId id = map.add_map();
  int seed = 0;
  for (const double x : rooms)
    for (int k = 0; k < 8; ++k, ++seed) {
      const SE3d T = drive_view(x, 0, k);
      world.add_keyframe(map, id, T, T, static_cast<std::uint64_t>(seed), seed * kSecond);
    }
  return map;
}

}  // namespace

TEST_CASE("A loop is found in the keyframe's own map, with its drift", "[place]") {
  PlaceWorld world;
  world.add_room(0, 0, 1400, 1);
  world.add_room(10, 0, 1400, 2);
  Map map;
  const MapId id = map.add_map();
  PlaceRecognizer places = recognizer(world, careful());
  const Vec3<double> gravity = PlaceWorld::gravity();
  std::uint64_t seed = 1;
  TimeNs t = 0;
  for (int k = 0; k < 8; ++k, t += kSecond) {
    const SE3d T = drive_view(0, 0, k);
    CHECK_FALSE(places.feed(map, world.add_keyframe(map, id, T, T, seed++, t), &gravity));
  }
  for (int k = 0; k < 8; ++k, t += kSecond) {
    const SE3d T = drive_view(10, 0, k);
    CHECK_FALSE(places.feed(map, world.add_keyframe(map, id, T, T, seed++, t), &gravity));
  }
  // Back in the first room, 20 cm and 2 degrees wrong by now: T_camera_map = T_camera_true * drift.
  const SE3d drift(SO3<double>::exp({0, 0, 0.035}), {0.15, -0.13, 0.02});
  std::optional<PlaceMatch> found;
  int fed = 0;
  for (int k = 0; k < 8 && !found; ++k, t += kSecond, ++fed) {
    const SE3d T = drive_view(0.1, 0.1, k);
    const KeyframeId keyframe = world.add_keyframe(map, id, T, T * drift, seed++, t, k == 0);
    found = places.feed(map, keyframe, &gravity);
    if (!found) continue;
    CHECK(found->query == keyframe);
    CHECK(found->map == id);
    CHECK(found->candidate.value < 8);
    CHECK(found->confirmations >= 3);
    const SE3d error = T * found->T_camera_world.inverse();
    CHECK(error.translation().norm() < 0.02);
    CHECK(degrees(error) < 0.5);
    const SE3d relative = map.keyframe(found->candidate).T_camera_world;
    CHECK((found->T_query_candidate * relative * found->T_camera_world.inverse()).log().norm() < 1e-9);
  }
  REQUIRE(found);
  CHECK(fed <= 4);
  CHECK(places.counts().accepted == 1);
  CHECK(places.counts().of(PlaceRejection::unconfirmed) > 0);
  CHECK_FALSE(map.broken_invariant());
}

TEST_CASE("A room that looks like another of the same map is no loop: odometry knows better", "[place]") {
  PlaceWorld world;
  world.add_room(0, 0, 1400, 1);
  world.add_room(6, 0, 1400, 1);
  Map map;
  const MapId id = map.add_map();
  PlaceRecognizer places = recognizer(world);
  const Vec3<double> gravity = PlaceWorld::gravity();
  std::uint64_t seed = 1;
  for (int k = 0; k < 16; ++k) {
    const SE3d T = drive_view(k < 8 ? 0 : 6, 0, k % 8);
    const KeyframeId keyframe = world.add_keyframe(map, id, T, T, seed++, k * 2 * kSecond, k == 8);
    CHECK_FALSE(places.feed(map, keyframe, &gravity));
  }
  CHECK(places.counts().of(PlaceRejection::far_from_prior) > 0);
  CHECK(places.counts().accepted == 0);
}

TEST_CASE("A sub-map is joined to an older one, later where odometry knows no way and twins are feared",
          "[place]") {
  for (const auto [one_frame, twins] : {std::pair{true, true}, {false, true}, {false, false}}) {
    PlaceWorld world;
    world.add_room(0, 0, 1400, 1);
    Map map;
    const MapId first = map.add_map();
    PlaceRecognizerOptions options = careful();
    options.twins = twins;
    PlaceRecognizer places = recognizer(world, options);
    std::uint64_t seed = 1;
    for (int k = 0; k < 14; ++k) {
      const SE3d T = drive_view(0, -0.4, k);
      places.feed(map, world.add_keyframe(map, first, T, T, seed++, k * kSecond));
    }
    const MapId second = map.add_map();
    const SE3d T_first_second = one_frame ? SE3d(SO3<double>::exp({0, 0, 0.02}), {0.05, -0.04, 0})
                                          : SE3d(SO3<double>::exp({0, 0, 2}), {3, -4, 0.1});
    const std::vector<MapId> known = one_frame ? std::vector<MapId>{first} : std::vector<MapId>{};
    std::optional<PlaceMatch> found;
    int k = 0;
    for (; k < 14 && !found; ++k) {
      const SE3d T = drive_view(0.1, -0.3, k);
      const KeyframeId keyframe =
          world.add_keyframe(map, second, T, T * T_first_second, seed++, (20 + k) * kSecond);
      found = places.feed(map, keyframe, nullptr, known);
      if (!found) continue;
      CHECK(found->map == first);
      const SE3d error = T * found->T_camera_world.inverse();
      CHECK(error.translation().norm() < 0.02);
      CHECK(degrees(error) < 0.5);
    }
    CAPTURE(one_frame, twins, k, to_string(places.last_rejection()));
    REQUIRE(found);
    // 0.13 m from one keyframe to the next.
    if (one_frame || !twins)
      CHECK(k <= 5);
    else
      CHECK(k >= 8);
  }
}

TEST_CASE("A map that was found elsewhere in another before is not joined to it", "[place]") {
  PlaceWorld world;
  world.add_room(0, 0, 1400, 1);
  world.add_room(6, 0, 1400, 2);
  Map map;
  const MapId first = map.add_map();
  PlaceRecognizer places = recognizer(world, careful());
  std::uint64_t seed = 1;
  for (int k = 0; k < 28; ++k) {
    const SE3d T = drive_view(k < 14 ? 0 : 6, -0.4, k % 14);
    places.feed(map, world.add_keyframe(map, first, T, T, seed++, k * kSecond, k == 14));
  }
  const MapId second = map.add_map();
  // It drives on in one room and sees the other for a moment: one of both is a twin.
  for (int k = 0; k < 14; ++k) {
    const SE3d T_own = drive_view(0.1, -0.3, k);
    const SE3d T = k == 2 ? drive_view(6.1, -0.3, k) : T_own;
    const KeyframeId keyframe = world.add_keyframe(map, second, T, T_own, seed++, (40 + k) * kSecond);
    CHECK_FALSE(places.feed(map, keyframe));
  }
  CHECK(places.counts().of(PlaceRejection::inconsistent) > 0);
}

TEST_CASE("A frame is located by odometry's help or without, at once where it is sure", "[place]") {
  PlaceWorld world;
  world.add_room(0, 0, 1400, 1);
  const Map map = mapped(world, {0});
  for (const bool odometry : {true, false}) {
    PlaceRecognizer places = recognizer(world, careful());
    places.database().follow(map);
    std::optional<PlaceMatch> found;
    int frames = 0;
    for (; frames < 12 && !found; ++frames) {
      const SE3d T = PlaceWorld::level_view(-0.9, -0.3 + 0.04 * frames, 0.1);
      const SE3d T_camera_odom = T * SE3d(SO3<double>::exp({0, 0, 1}), {5, 6, 0});
      const StereoFrame frame =
          world.see(T, 100 + static_cast<std::uint64_t>(frames), 0.4, (50 + frames) * kSecond / 5);
      found = places.locate(map, frame, nullptr, nullptr, odometry ? &T_camera_odom : nullptr);
      if (found) {
        CHECK((T * found->T_camera_world.inverse()).translation().norm() < 0.02);
        CHECK_FALSE(found->query.valid());
      }
    }
    CAPTURE(odometry, to_string(places.last_rejection()));
    REQUIRE(found);
    CHECK(frames >= 3);
    places.forget();
  }
  PlaceRecognizerOptions options;
  options.sure_inliers = 40;
  options.sure_cells = 8;
  options.sure_off_plane = 0;
  PlaceRecognizer places = recognizer(world, options);
  places.database().follow(map);
  CHECK(places.locate(map, world.see(drive_view(0.05, 0.05, 3), 500)));
}

TEST_CASE("Frames that none alone tells the place of are located together", "[place]") {
  PlaceWorld world;
  world.add_room(0, 0, 300, 1);
  const Map map = mapped(world, {0});
  const Vec3<double> gravity = PlaceWorld::gravity();
  const auto drive = [&](const PlaceRecognizerOptions& options, bool with_gravity, bool odometry_holds) {
    PlaceRecognizer places = recognizer(world, options);
    places.database().follow(map);
    for (int k = 0; k < 8; ++k) {
      const SE3d T = drive_view(0.1, 0.1, k);
      // Two of three key points look like another one of the same image.
      const StereoFrame frame = PlaceWorld::confuse(
          world.see(T, 200 + static_cast<std::uint64_t>(k), 0.4, (50 + k) * kSecond / 4), 0.33, 7);
      const Vec3<double> gravity_camera = T.rotation() * gravity;
      const SE3d slip(SO3<double>::exp({0, 0, odometry_holds ? 0 : 0.5 * k}),
                      {0, odometry_holds ? 0 : 0.4 * k, 0});
      const SE3d T_camera_odom = T * SE3d(SO3<double>::exp({0, 0, 1}), {5, 6, 0}) * slip;
      const auto found = places.locate(map, frame, with_gravity ? &gravity_camera : nullptr,
                                       with_gravity ? &gravity : nullptr, &T_camera_odom);
      if (!found) continue;
      const SE3d error = T * found->T_camera_world.inverse();
      CHECK(error.translation().norm() < 0.03);
      CHECK(degrees(error) < 0.5);
      CHECK(found->confirmations >= 3);
      return true;
    }
    return false;
  };
  PlaceRecognizerOptions alone;
  alone.pool = false;
  CHECK_FALSE(drive(alone, true, true));
  CHECK(drive({}, true, true));
  CHECK_FALSE(drive({}, false, true));
  CHECK_FALSE(drive({}, true, false));
}

TEST_CASE("Keyframes that none alone tells the place of join another map together where twins are not feared",
          "[place]") {
  const Vec3<double> gravity = PlaceWorld::gravity();
  const auto drive = [&](bool twins, bool pool) {
    PlaceWorld world;
    world.add_room(0, 0, 300, 1);
    Map map;
    PlaceRecognizerOptions options;
    options.twins = twins;
    options.pool = pool;
    PlaceRecognizer places = recognizer(world, options);
    const MapId first = map.add_map(), second = map.add_map();
    for (int k = 0; k < 8; ++k) {
      const SE3d T = drive_view(0, 0, k);
      places.feed(map, world.add_keyframe(map, first, T, T, static_cast<std::uint64_t>(k), k * kSecond),
                  &gravity);
    }
    // The second map stands elsewhere, but upright. A third of what it sees looks as it did.
    const SE3d T_first_second(SO3<double>::exp({0, 0, 2}), {3, -4, 0.1});
    for (int k = 0; k < 8; ++k) {
      const SE3d T = drive_view(0.1, 0.1, k);
      const KeyframeId keyframe =
          world.add_keyframe(map, second, T, T * T_first_second, 200 + static_cast<std::uint64_t>(k),
                             (50 + k) * kSecond, true, 0.33);
      const auto found = places.feed(map, keyframe, &gravity);
      if (!found) continue;
      CHECK(found->map == first);
      REQUIRE(map.find(found->query));
      CHECK(map.keyframe(found->query).map == second);
      CHECK(found->pairs.size() >= 5);
      for (const PlacePair& pair : found->pairs)
        CHECK(map.keyframe(map.point(pair.point).observations.front().keyframe).map == first);
      const SE3d T_true = map.keyframe(found->query).T_camera_world * T_first_second.inverse();
      const SE3d error = T_true * found->T_camera_world.inverse();
      CHECK(error.translation().norm() < 0.03);
      CHECK(degrees(error) < 0.5);
      CHECK(found->confirmations >= 3);
      const SE3d T_candidate = map.keyframe(found->candidate).T_camera_world;
      CHECK((found->T_query_candidate * T_candidate * found->T_camera_world.inverse()).log().norm() < 1e-9);
      return true;
    }
    return false;
  };
  CHECK(drive(false, true));
  CHECK_FALSE(drive(false, false));
  CHECK_FALSE(drive(true, true));
}

TEST_CASE("Frames located together are of one of two places that fit: none is named", "[place]") {
  PlaceWorld world;
  world.add_room(0, 0, 170, 1);
  world.add_room(6, 0, 170, 1);
  const Map map = mapped(world, {0, 6});
  PlaceRecognizer places = recognizer(world);
  places.database().follow(map);
  const Vec3<double> gravity = PlaceWorld::gravity();
  for (int k = 0; k < 8; ++k) {
    const SE3d T = drive_view(0.1, 0.1, k);
    const StereoFrame frame = PlaceWorld::confuse(
        world.see(T, 200 + static_cast<std::uint64_t>(k), 0.4, (50 + k) * kSecond / 4), 0.33, 7);
    const Vec3<double> gravity_camera = T.rotation() * gravity;
    CHECK_FALSE(places.locate(map, frame, &gravity_camera, &gravity, &T));
  }
  CHECK(places.counts().of(PlaceRejection::ambiguous) > 0);
}

TEST_CASE("Where two places fit, none is named", "[place]") {
  PlaceWorld world;
  world.add_room(0, 0, 1400, 1);
  world.add_room(6, 0, 1400, 1);
  const Map map = mapped(world, {0, 6});
  PlaceRecognizer places = recognizer(world);
  places.database().follow(map);
  for (int k = 0; k < 6; ++k)
    CHECK_FALSE(places.locate(map, world.see(drive_view(0.05, 0.05, k), 500 + static_cast<std::uint64_t>(k),
                                             0.4, (50 + k) * kSecond)));
  CHECK(places.counts().of(PlaceRejection::ambiguous) > 0);
  CHECK(places.counts().accepted == 0);
}

TEST_CASE("The same frames give the same answers", "[place]") {
  PlaceWorld world;
  world.add_room(0, 0, 1400, 1);
  const Map map = mapped(world, {0});
  const auto run = [&] {
    PlaceRecognizer places = recognizer(world, careful());
    places.database().follow(map);
    std::vector<double> out;
    for (int k = 0; k < 5; ++k) {
      const auto found = places.locate(
          map,
          world.see(drive_view(0.05, 0, k), 300 + static_cast<std::uint64_t>(k), 0.4, (50 + k) * kSecond));
      if (!found) continue;
      for (const double x : found->T_camera_world.log()) out.push_back(x);
      out.push_back(static_cast<double>(found->pairs.size()));
    }
    return out;
  };
  const std::vector<double> first = run();
  CHECK_FALSE(first.empty());
  CHECK(first == run());
}
