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
            check.match.contradictions, check.match.cells.count());
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

TEST_CASE("What is too large or too small for what it looks like is not matched", "[place]") {
  OneRoom room;
  const SE3d T_true = PlaceWorld::level_view(-0.5, 0.3, 0.15);
  const auto matches = [&](int octaves, double max_difference) {
    StereoFrame frame = room.world.see(T_true, 77);
    for (Measurement& m : frame.measurements) m.octave += octaves;
    PlaceVerifierOptions options;
    options.max_size_difference = max_difference;
    PlaceVerifier verifier(PlaceWorld::camera(), PlaceWorld::view(), PlaceWorld::levels(), options);
    return verifier.verify(room.database->image(frame), room.map, *room.database, room.keyframes[2], {})
        .match.matches;
  };
  const int all = matches(0, 100);
  REQUIRE(all > 50);
  // Octaves are rounded in both images, so that a size may be off by one.
  CHECK(matches(0, 1.5) == all);
  // Few points are so far that they have no depth; these may have any size.
  CHECK(10 * matches(3, 1.5) < all);
  CHECK(matches(3, 100) == all);
}

TEST_CASE("Several images together fix a pose that is exact without noise, wherever the world lies",
          "[place]") {
  OneRoom room;
  const Vec3<double> gravity = PlaceWorld::gravity();
  std::vector<PlaceImage> images;
  std::vector<SE3d> poses;
  for (int k = 0; k < 5; ++k) {
    poses.push_back(PlaceWorld::level_view(-0.8 + 0.1 * k, 0.5 - 0.1 * k, 0.05 * k, 0.03 * k));
    images.push_back(room.database->image(
        PlaceWorld::confuse(room.world.see(poses.back(), 100 + static_cast<std::uint64_t>(k)), 0.15, 3)));
  }
  std::vector<PlaceView> views;
  for (std::size_t k = 0; k < images.size(); ++k)
    views.push_back({&images[k], poses[k] * poses[0].inverse()});
  const auto proposal = room.verifier.propose(views, room.map, *room.database, room.keyframes[2],
                                              poses[0].rotation() * gravity, gravity);
  REQUIRE(proposal);
  const SE3d error = poses[0] * proposal->T_first_world.inverse();
  CHECK(error.translation().norm() < 0.05);
  CHECK(degrees(error) < 1);
  CHECK(proposal->inliers < proposal->matches / 2);

  // Exact measurements of the map's points: the refined pose is exact from where the proposal was.
  std::vector<std::vector<PlacePair>> pairs(images.size());
  for (std::size_t k = 0; k < images.size(); ++k) {
    std::vector<Measurement> exact;
    for (std::uint32_t i = 0; i < room.map.point_id_end() && exact.size() < 30; ++i) {
      const MapPoint* point = room.map.find(PointId{i});
      const auto uvr = point ? PlaceWorld::camera().project_stereo(poses[k] * point->p_world) : std::nullopt;
      if (!uvr || uvr->x() < 0 || uvr->x() >= PlaceWorld::kWidth) continue;
      Measurement m;
      m.u = static_cast<float>(uvr->x());
      m.v = static_cast<float>(uvr->y());
      m.u_right = static_cast<float>(uvr->z());
      pairs[k].push_back({static_cast<std::uint32_t>(exact.size()), point->id});
      exact.push_back(m);
    }
    images[k].measurements = exact;
  }
  const SE3d refined = room.verifier.refine_together(views, pairs, room.map, proposal->T_first_world);
  const SE3d left = poses[0] * refined.inverse();
  CHECK(left.translation().norm() < 1e-4);
  CHECK(degrees(left) < 1e-2);
}
