// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/slam/place_verification.hpp"

#include <catch2/catch.hpp>
#include <numbers>

#include "slam/place_world.hpp"

using namespace sweepkit;

namespace {

// One room, seen by a drive of keyframes along its middle that look at the wall at x = 2.
struct OneRoom {
  PlaceWorld world;
  Map map;
  MapId map_id;
  std::vector<KeyframeId> keyframes;
  std::unique_ptr<PlaceDatabase> database;
  PlaceVerifier verifier{PlaceWorld::camera(), PlaceWorld::view(), PlaceWorld::levels()};

  explicit OneRoom(std::uint64_t seed = 1) {
    world.add_room(0, 0, 1600, seed);
    map_id = map.add_map();
    for (int k = 0; k < 5; ++k) {
      const SE3d T = PlaceWorld::level_view(-1, -0.4 + 0.2 * k, 0.05 * k);
      keyframes.push_back(
          world.add_keyframe(map, map_id, T, T, 10 + static_cast<std::uint64_t>(k), k * 1000000000LL));
    }
    database = std::make_unique<PlaceDatabase>(world.vocabulary());
    database->follow(map);
  }
};

double degrees(const SE3d& T) { return T.rotation().angle() * 180 / std::numbers::pi; }

}  // namespace

TEST_CASE("A place is known again from elsewhere, within its covariance", "[place]") {
  OneRoom room;
  double sum = 0;
  int count = 0;
  for (int k = 0; k < 12; ++k) {
    const double turn = -0.3 + 0.05 * k;
    const SE3d T_true = PlaceWorld::level_view(-0.8 + 0.05 * k, 0.5 - 0.1 * k, turn);
    const StereoFrame frame = room.world.see(T_true, 100 + static_cast<std::uint64_t>(k));
    const PlaceImage image = room.database->image(frame);
    const PlaceCheck check = room.verifier.verify(image, room.map, *room.database, room.keyframes[2], {});
    CAPTURE(k, to_string(check.rejection), check.match.matches, check.match.predicted, check.match.found,
            check.match.pairs.size(), check.match.seen_share, check.match.inverse_share,
            check.match.contradictions, check.match.cells);
    REQUIRE(check.ok());
    const SE3d error = T_true * check.match.T_camera_world.inverse();
    CHECK(error.translation().norm() < 0.03);
    CHECK(degrees(error) < 0.5);
    const Vec6<double> xi = error.log();
    sum += xi.dot(check.match.covariance.ldlt().solve(xi));
    ++count;
    // Every pair shows the right point.
    for (const PlacePair& pair : check.match.pairs) {
      const auto uvr = PlaceWorld::camera().project_stereo(check.match.T_camera_world *
                                                           room.map.point(pair.point).p_world);
      REQUIRE(uvr);
      CHECK(std::abs(uvr->x() - image.measurements[pair.measurement].u) < 4);
    }
  }
  // Chi-square with six degrees of freedom: the mean of 12 lies below 6 + 5 sigma.
  CHECK(sum / count < 6 + 5 * std::sqrt(12.0 / count));
}

TEST_CASE("With gravity the same place is found, and a tilt that contradicts it is refused", "[place]") {
  OneRoom room;
  const SE3d T_true = PlaceWorld::level_view(-0.5, 0.3, 0.15, 0.1);
  const PlaceImage image = room.database->image(room.world.see(T_true, 77));
  const auto free = room.verifier.verify(image, room.map, *room.database, room.keyframes[2], {});
  PlaceHints hints;
  hints.gravity_world = PlaceWorld::gravity();
  hints.gravity_camera = T_true.rotation() * PlaceWorld::gravity();
  const auto upright = room.verifier.verify(image, room.map, *room.database, room.keyframes[2], hints);
  REQUIRE(free.ok());
  REQUIRE(upright.ok());
  const SE3d difference = free.match.T_camera_world * upright.match.T_camera_world.inverse();
  CHECK(difference.translation().norm() < 0.005);
  CHECK(degrees(difference) < 0.1);

  hints.gravity_camera = SO3<double>::exp({0.06, 0, 0}) * *hints.gravity_camera;
  const auto tilted = room.verifier.verify(image, room.map, *room.database, room.keyframes[2], hints);
  CAPTURE(to_string(tilted.rejection));
  CHECK_FALSE(tilted.ok());
}
