// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/slam/loop_correction.hpp"

#include <catch2/catch.hpp>
#include <cmath>
#include <numbers>
#include <vector>

#include "sweepkit/core/random.hpp"

using namespace sweepkit;

namespace {

constexpr RectifiedCamera kCamera{.focal = 350, .cx = 319.5, .cy = 199.5, .baseline = 0.1};
constexpr int kRound = 24;  // keyframes of a round
constexpr int kBlindFrom = 9, kBlindTo = 13;

// A camera that looks outward on its way around a circle.
SE3d true_pose(int k) {
  const double angle = 2 * std::numbers::pi * k / kRound;
  const Vec3<double> out(std::cos(angle), std::sin(angle), 0);
  Mat3<double> R;  // columns: the camera's axes in the world
  R.col(2) = out;
  R.col(1) = -Vec3<double>::UnitZ();
  R.col(0) = R.col(1).cross(R.col(2));
  return SE3d(SO3d(R), 1.5 * out).inverse();
}

struct Ring {
  Map map;
  std::vector<KeyframeId> ids;
  std::vector<SE3d> first_poses;  // with drift, T_camera_world

  // A little more than a round with an error at each step, half a millimetre and 0.1 degrees, or with `blind`
  // one large one in a stretch where nothing is seen. What is seen again after a round is not recognized.
  explicit Ring(bool blind, std::uint64_t seed) {
    Random random(seed);
    std::vector<Vec3<double>> points;
    for (int i = 0; i < 900; ++i) {
      const double angle = 2 * std::numbers::pi * random.uniform();
      const double radius = random.uniform(3, 5);
      points.emplace_back(radius * std::cos(angle), radius * std::sin(angle), random.uniform(-1, 1));
    }
    const MapId id = map.add_map();
    std::vector<PointId> known[2];
    for (auto& of_round : known) of_round.resize(points.size());
    for (int k = 0; k < kRound + 4; ++k) {
      const bool dark = blind && k >= kBlindFrom && k <= kBlindTo;
      Vec6<double> error = Vec6<double>::Zero();
      for (int i = 0; i < 6; ++i) error[i] = random.normal() * (i < 3 ? 0.0005 : 0.002);
      if (blind) error *= 0.05;
      if (dark) error += Vec6<double>{0.02, 0.01, 0.03, 0.004, 0.008, -0.006};
      Keyframe keyframe;
      keyframe.map = id;
      keyframe.t = k * kNsPerSecond;
      if (k == 0) {
        keyframe.T_camera_world = true_pose(0);
      } else {
        const SE3d step = true_pose(k) * true_pose(k - 1).inverse();
        const SE3d moved = SE3d::exp(error) * step;
        keyframe.parent = ids.back();
        keyframe.T_camera_world = moved * first_poses.back();
        UncertainMotion<double> odometry{moved.inverse(), Mat6<double>::Identity() * 1e-4};
        if (dark) odometry.covariance *= 10;
        keyframe.odometry = OdometryEdge{ids.back(), odometry};
      }
      std::vector<std::size_t> seen;
      for (std::size_t p = 0; p < points.size() && !dark; ++p) {
        const auto uvr = kCamera.project_stereo(true_pose(k) * points[p]);
        if (!uvr || uvr->x() < 0 || uvr->x() > 640 || uvr->y() < 0 || uvr->y() > 400) continue;
        Measurement m;
        m.u = static_cast<float>(uvr->x());
        m.v = static_cast<float>(uvr->y());
        m.u_right = static_cast<float>(uvr->z());
        m.sigma = 0.5F;
        m.sigma_right = 0.3F;
        keyframe.measurements.push_back(m);
        seen.push_back(p);
      }
      keyframe.descriptors.resize(keyframe.measurements.size());
      first_poses.push_back(keyframe.T_camera_world);
      ids.push_back(map.add_keyframe(keyframe));
      const SE3d T_world_camera = first_poses.back().inverse() * true_pose(k);
      for (std::uint32_t i = 0; i < seen.size(); ++i) {
        PointId& point = known[k >= kRound - 3][seen[i]];
        if (point.valid())
          map.add_observation(point, ids.back(), i);
        else
          point = map.add_point(T_world_camera * points[seen[i]], ids.back(), i);
      }
    }
    for (std::uint32_t p = 0; p < map.point_id_end(); ++p)
      map.set_appearance(PointId{p}, {}, Vec3<float>::UnitX(), 0.5F, 10.0F);
  }

  double error(int k) const {
    return (map.T_camera_world(ids[static_cast<std::size_t>(k)]) * true_pose(k).inverse()).log().norm();
  }
  double worst() const {
    double most = 0;
    for (int k = 0; k < static_cast<int>(ids.size()); ++k) most = std::max(most, error(k));
    return most;
  }
  double squares() const {
    double sum = 0;
    for (int k = 0; k < static_cast<int>(ids.size()); ++k) sum += std::pow(error(k), 2);
    return sum;
  }
  PlaceMatch match(int query, int candidate, const SE3d& wrong = SE3d()) const {
    PlaceMatch match;
    match.query = ids[static_cast<std::size_t>(query)];
    match.candidate = ids[static_cast<std::size_t>(candidate)];
    match.map = map.keyframe(match.candidate).map;
    match.T_query_candidate = wrong * true_pose(query) * true_pose(candidate).inverse();
    match.T_camera_world = match.T_query_candidate * map.T_camera_world(match.candidate);
    match.covariance = Mat6<double>::Identity() * 1e-6;
    return match;
  }
};

}  // namespace

TEST_CASE("a loop bends the whole round back", "[loop_correction]") {
  Ring ring(false, 1);
  REQUIRE_FALSE(ring.map.broken_invariant());
  const double before = ring.worst();
  REQUIRE(before > 0.01);
  // What the first keyframe of each point sees of it stays.
  std::vector<Vec3<double>> p_camera;
  for (std::uint32_t i = 0; i < ring.map.point_id_end(); ++i) {
    const MapPoint& point = ring.map.point(PointId{i});
    p_camera.push_back(ring.map.T_camera_world(point.observations.front().keyframe) * point.p_world);
  }
  const PlaceMatch match = ring.match(kRound, 0);
  const LoopCorrection correction = correct_loop(ring.map, kCamera, match, {});
  CHECK(correction.accepted);
  CHECK_FALSE(correction.joined);
  CHECK(ring.error(kRound) < 0.005);
  CHECK(ring.error(0) == 0);
  CHECK_FALSE(ring.map.broken_invariant());
  for (std::uint32_t i = 0; i < ring.map.point_id_end(); ++i) {
    const MapPoint& point = ring.map.point(PointId{i});
    CHECK(
        (ring.map.T_camera_world(point.observations.front().keyframe) * point.p_world - p_camera[i]).norm() <
        1e-9);
  }
  const SE3d T_moved = ring.map.T_camera_world(match.query).inverse() * ring.first_poses[kRound];
  CHECK((correction.T_new_old * T_moved.inverse()).log().norm() < 1e-12);
}

// Squared errors of a random walk grow with its length; of one whose end is known they are a third of that.
TEST_CASE("loops make rounds better on average", "[loop_correction]") {
  double before = 0, after = 0;
  for (std::uint64_t seed = 1; seed <= 10; ++seed) {
    Ring ring(false, seed);
    before += ring.squares();
    CHECK(correct_loop(ring.map, kCamera, ring.match(kRound, 0), {}).accepted);
    after += ring.squares();
  }
  CAPTURE(before, after);
  CHECK(after < 0.5 * before);
}

TEST_CASE("a loop that the map contradicts changes nothing", "[loop_correction]") {
  Ring ring(false, 2);
  for (const Vec6<double>& wrong : {Vec6<double>{0.6, 0, 0.3, 0, 0, 0}, Vec6<double>{0, 0, 0, 0, 0.6, 0},
                                    Vec6<double>{0, 0.5, 0, 0, 0, 0.4}}) {
    const LoopCorrection correction =
        correct_loop(ring.map, kCamera, ring.match(kRound, 0, SE3d::exp(wrong)), {});
    CHECK_FALSE(correction.accepted);
    CHECK(correction.contradiction > 100);
    for (std::size_t k = 0; k < ring.ids.size(); ++k)
      CHECK(ring.map.T_camera_world(ring.ids[k]).matrix() == ring.first_poses[k].matrix());
  }
}

TEST_CASE("a blind stretch takes the error that was made in it", "[loop_correction]") {
  Ring ring(true, 3);
  const double before = ring.worst();
  REQUIRE(before > 0.1);
  REQUIRE(ring.map.keyframe(ring.ids[kBlindFrom]).blind());
  const LoopCorrection correction = correct_loop(ring.map, kCamera, ring.match(kRound, 0), {});
  CHECK(correction.accepted);
  CHECK_FALSE(ring.map.broken_invariant());
  for (int k = 0; k < kRound; ++k) {
    CAPTURE(k);
    CHECK(ring.error(k) < (k < kBlindFrom || k > kBlindTo ? 0.2 : 0.6) * before);
  }
}

TEST_CASE("a map that meets another is joined into its frame", "[loop_correction]") {
  Ring ring(false, 4);
  // The same round again in a map whose frame is elsewhere.
  const SE3d T_other_world = SE3d::exp(Vec6<double>{3, -2, 0.5, 0.1, 0.2, 2.0});
  const MapId other = ring.map.add_map();
  KeyframeId parent;
  std::vector<KeyframeId> ids;
  for (int k = 0; k < 4; ++k) {
    Keyframe keyframe;
    keyframe.map = other;
    keyframe.parent = parent;
    keyframe.T_camera_world = true_pose(k) * T_other_world.inverse();
    ids.push_back(parent = ring.map.add_keyframe(keyframe));
  }
  PlaceMatch match = ring.match(2, 2);
  match.query = ids[2];
  const LoopCorrection correction = correct_loop(ring.map, kCamera, match, {});
  CHECK(correction.accepted);
  CHECK(correction.joined);
  CHECK_FALSE(ring.map.broken_invariant());
  CHECK(ring.map.maps().size() == 1);
  const SE3d T_query_candidate =
      ring.map.T_camera_world(ids[2]) * ring.map.T_camera_world(ring.ids[2]).inverse();
  CHECK(T_query_candidate.log().norm() < 1e-6);
  for (int k = 0; k < 4; ++k) {
    const SE3d apart = ring.map.T_camera_world(ids[static_cast<std::size_t>(k)]) *
                       ring.map.T_camera_world(ids[2]).inverse() * true_pose(2) * true_pose(k).inverse();
    CHECK(apart.log().norm() < 1e-6);
  }
}
