// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/match/lines.hpp"

#include <catch2/catch.hpp>
#include <cmath>
#include <limits>
#include <set>
#include <vector>

#include "match/stereo_scene.hpp"

using namespace sweepkit;

namespace {

struct LineScene {
  LineFeatures<256> left, right;
  std::vector<int> right_of_left;
  std::vector<Segment3d> truth;  // of the left ones' ends, in the rectified left camera
};

Segment3d between(const Vec3<double>& p, const Vec3<double>& q) {
  Segment3d segment;
  segment.p1 = p;
  segment.p2 = q;
  return segment;
}

LineDescriptor random_code(Random& random) {
  LineDescriptor d;
  for (auto& word : d.words) word = random();
  return d;
}

LineDescriptor flipped(LineDescriptor d, Random& random, int bits) {
  for (int i = 0; i < bits; ++i) d.words[random.index(4)] ^= std::uint64_t{1} << random.index(64);
  return d;
}

/// Random edges before both cameras. The right camera sees another stretch of each, and some not at all; ends
/// are off across the edge by normal noise.
LineScene line_scene(Random& random, const StereoRig& rig, int count, double noise) {
  LineScene scene;
  const SE3d T_left_camera = rig.T_body_raw(Side::left).inverse() * rig.T_body_camera();
  const SE3d T_right_camera = rig.T_body_raw(Side::right).inverse() * rig.T_body_camera();
  const auto image_of = [&](Side side, const Vec3<double>& p,
                            const Vec3<double>& q) -> std::optional<LineSegment> {
    const SE3d& T = side == Side::left ? T_left_camera : T_right_camera;
    const Camera& camera = rig.camera(side);
    const auto a = camera.project(T * p), b = camera.project(T * q);
    if (!a || !b || !camera.contains(*a, 2) || !camera.contains(*b, 2)) return std::nullopt;
    LineSegment s;
    const Vec2<double> n = Vec2<double>(a->y() - b->y(), b->x() - a->x()).normalized();
    const double e1 = noise * random.normal(), e2 = noise * random.normal();
    s.x1 = static_cast<float>(a->x() + e1 * n.x());
    s.y1 = static_cast<float>(a->y() + e1 * n.y());
    s.x2 = static_cast<float>(b->x() + e2 * n.x());
    s.y2 = static_cast<float>(b->y() + e2 * n.y());
    s.octave = static_cast<std::int32_t>(random.index(2));
    return s;
  };
  while (static_cast<int>(scene.left.size()) < count) {
    const double z = 1 / random.uniform(1 / 6.0, 1 / 0.8);
    const Vec3<double> middle(z * random.uniform(-0.6, 0.6), z * random.uniform(-0.4, 0.4), z);
    const Vec3<double> half =
        0.12 * z *
        Vec3<double>(random.uniform(-0.7, 0.7), random.uniform(0.5, 1) * (random.index(2) ? 1 : -1),
                     random.uniform(-0.5, 0.5));
    const auto left = image_of(Side::left, middle - half, middle + half);
    const auto right = image_of(Side::right, middle - random.uniform(0.7, 1.0) * half,
                                middle + random.uniform(0.7, 1.0) * half);
    if (!left || !right || left->length() < 15) continue;
    const LineDescriptor code = random_code(random);
    scene.left.segments.push_back(*left);
    scene.left.descriptors.push_back(flipped(code, random, 15));
    scene.truth.push_back(between(middle - half, middle + half));
    if (random.uniform() < 0.2) {
      scene.right_of_left.push_back(-1);
      continue;
    }
    scene.right_of_left.push_back(static_cast<int>(scene.right.size()));
    scene.right.segments.push_back(*right);
    scene.right.segments.back().octave = left->octave;
    scene.right.descriptors.push_back(flipped(code, random, 15));
  }
  return scene;
}

double off_line(const Segment3d& s, const Vec3<double>& p) { return (p - s.p1).cross(s.direction()).norm(); }

}  // namespace

TEST_CASE("Segments are paired as they belong, and stand in space where they are") {
  for (const bool raw : {false, true}) {
    Random random(raw ? 3 : 4);
    const StereoRig rig = raw ? unrectified_rig() : rectified_rig();
    // Ends are off by `noise`, not fits of many points: sigma of such a fit's end is 2 sigma / sqrt(length).
    const double noise = 0.15;
    const LineScene scene = line_scene(random, rig, 250, noise);
    LineStereoMatcher matcher(rig);
    std::vector<LineStereoMatch> matches;
    const int count = matcher.match(scene.left, scene.right, matches);
    REQUIRE(matches.size() == 250);
    int right = 0, wrong = 0, possible = 0, triangulated = 0, within = 0;
    double squares = 0;
    for (std::size_t i = 0; i < matches.size(); ++i) {
      possible += scene.right_of_left[i] >= 0;
      if (!matches[i].found()) continue;
      if (matches[i].right != scene.right_of_left[i]) {
        ++wrong;
        continue;
      }
      ++right;
      CHECK(matches[i].sigma1 > 0);
      const auto uvd = rig.project_stereo(scene.truth[i].p1);
      REQUIRE(uvd);
      CHECK(std::abs(matches[i].disparity1 - uvd->z()) < 6 * matches[i].sigma1 + 1);
      const auto segment = matcher.triangulate(matches[i]);
      if (!segment) continue;
      ++triangulated;
      // Across the edge, in units of what the covariance says.
      const Vec3<double> truth = scene.truth[i].direction();
      for (const auto& [p, covariance] :
           {std::pair{segment->p1, segment->covariance1}, {segment->p2, segment->covariance2}}) {
        const Vec3<double> error = (p - scene.truth[i].p1) - truth * truth.dot(p - scene.truth[i].p1);
        const Vec3<double> u = truth.unitOrthogonal(), v = truth.cross(u);
        Eigen::Matrix<double, 2, 3> across;
        across << u.transpose(), v.transpose();
        const Eigen::Matrix2d S = across * covariance * across.transpose();
        const Eigen::Vector2d e = across * error;
        squares += e.dot(S.inverse() * e);
      }
      within += off_line(scene.truth[i], segment->p1) < 0.03 * segment->p1.z();
    }
    CAPTURE(raw, count, right, wrong, possible, triangulated, within, squares / (2 * triangulated));
    CHECK(count == right + wrong);
    CHECK(wrong <= 2);
    CHECK(right > 0.9 * possible);
    CHECK(triangulated == right);
    CHECK(within > 0.85 * triangulated);
    // Two degrees of freedom each: the mean of their squares is 2 where covariances are right.
    CHECK(squares / (2 * triangulated) > 0.7);
    CHECK(squares / (2 * triangulated) < 4);
  }
}

TEST_CASE("Segments along the baseline, turned, of other polarity or out of range are not paired") {
  const StereoRig rig = rectified_rig();
  LineStereoMatcher matcher(rig);
  std::vector<LineStereoMatch> matches;
  const auto match = [&](const LineSegment& a, const LineSegment& b) {
    LineFeatures<256> left{{a}, {LineDescriptor{}}}, right{{b}, {LineDescriptor{}}};
    return matcher.match(left, right, matches);
  };
  const LineSegment a{200, 100, 210, 160};
  CHECK(match(a, {190, 100, 200, 160}) == 1);
  CHECK(matches[0].disparity1 == Approx(10));
  CHECK(matches[0].disparity2 == Approx(10));
  CHECK(match(a, {190, 130, 195, 160}) == 1);                     // half of it
  CHECK(match(a, {210, 100, 220, 160}) == 0);                     // negative disparity
  CHECK(match(a, {200, 160, 190, 100}) == 0);                     // the other side dark
  CHECK(match(a, {190, 200, 200, 260}) == 0);                     // other rows
  CHECK(match(a, {130, 100, 200, 160}) == 0);                     // turned too far
  CHECK(match({200, 100, 300, 101}, {190, 100, 290, 101}) == 0);  // along the baseline
  CHECK(matches[0].rectified == 1);
  CHECK_FALSE(matcher.triangulate(matches[0]));
  CHECK(match({600, 100, 610, 160}, {10, 100, 20, 160}) == 0);  // beyond max_disparity
  const float nan = std::numeric_limits<float>::quiet_NaN(), inf = std::numeric_limits<float>::infinity();
  CHECK(match({nan, 100, 210, 160}, {190, 100, 200, 160}) == 0);
  CHECK(match(a, {190, inf, 200, 160}) == 0);
  CHECK(match({200, 100, 200, 100}, {190, 100, 190, 100}) == 0);  // points
  CHECK(match(a, {1e30f, 100, 200, 1e30f}) == 0);
  // None, and all the same.
  CHECK(matcher.match({}, {}, matches) == 0);
  CHECK(matches.empty());
  LineFeatures<256> same;
  same.segments.assign(20, a);
  same.descriptors.assign(20, {});
  CHECK(matcher.match(same, {}, matches) == 0);
  CHECK(matches.size() == 20);
  LineFeatures<256> shifted = same;
  for (LineSegment& s : shifted.segments) s.x1 -= 10, s.x2 -= 10;
  CHECK(matcher.match(same, shifted, matches) > 0);
  same.descriptors.pop_back();
  CHECK_THROWS_AS(matcher.match(same, shifted, matches), Error);
  LineStereoOptions options;
  options.ratio = 0;
  CHECK_THROWS_AS(LineStereoMatcher(rig, options), Error);
}

TEST_CASE("Lines of the frame before are found again with a prior of the motion") {
  Random random(8);
  const RectifiedCamera camera{420, 319.5, 199.5, 0.11};
  const SE3d T_now_before(SO3d::exp(Vec3<double>(0.02, -0.05, 0.01)), {0.03, -0.01, -0.08});
  const SE3d prior(SO3d::exp(Vec3<double>(0.004, -0.003, 0.002)) * T_now_before.rotation(),
                   T_now_before.translation() + Vec3<double>(0.01, 0, -0.01));
  std::vector<LineQuery> queries;
  std::vector<LineDescriptor> codes, found_codes;
  std::vector<Segment2d> segments;
  std::vector<std::int32_t> octaves;
  std::vector<int> truth;
  while (queries.size() < 200) {
    const double z = random.uniform(1, 6);
    const Vec3<double> middle(z * random.uniform(-0.6, 0.6), z * random.uniform(-0.4, 0.4), z);
    const Vec3<double> half =
        0.15 * z * Vec3<double>(random.normal(), random.normal(), random.normal()).normalized();
    const Segment3d segment = between(middle - half, middle + half);
    const auto query = predict_line(camera, prior, segment, 12);
    const auto seen = predict_line(camera, T_now_before, segment, 0);
    if (!query || !seen || seen->predicted.length() < 15) continue;
    const LineDescriptor code = random_code(random);
    queries.push_back(*query);
    codes.push_back(flipped(code, random, 20));
    truth.push_back(random.uniform() < 0.2 ? -1 : static_cast<int>(segments.size()));
    if (truth.back() < 0) continue;
    segments.push_back(seen->predicted);
    found_codes.push_back(flipped(code, random, 20));
    octaves.push_back(static_cast<std::int32_t>(random.index(3)));
  }
  LineProjectionMatcher matcher;
  std::vector<Match> matches;
  const int count = matcher.match(queries, codes, segments, octaves, found_codes, matches);
  int right = 0, possible = 0;
  std::set<int> used;
  for (std::size_t i = 0; i < queries.size(); ++i) {
    possible += truth[i] >= 0;
    if (!matches[i].found()) continue;
    right += matches[i].index == truth[i];
    CHECK(used.insert(matches[i].index).second);
  }
  CHECK(right == count);
  CHECK(right > 0.9 * possible);
  // Octaves and lengths of arguments count.
  for (LineQuery& q : queries) q.min_octave = 3;
  CHECK(matcher.match(queries, codes, segments, octaves, found_codes, matches) == 0);
  CHECK(matcher.match({}, {}, {}, {}, {}, matches) == 0);
  CHECK(matches.empty());
  CHECK_THROWS_AS(matcher.match(queries, {}, segments, octaves, found_codes, matches), Error);
  octaves.pop_back();
  CHECK_THROWS_AS(matcher.match(queries, codes, segments, octaves, found_codes, matches), Error);
}

TEST_CASE("A prediction is cut off at the camera and is nothing behind it") {
  const RectifiedCamera camera{400, 320, 200, 0.1};
  const auto at = [&](const Vec3<double>& p, const Vec3<double>& q) {
    return predict_line(camera, SE3d(), between(p, q), 5);
  };
  CHECK_FALSE(at({0, 0, -1}, {1, 0, -2}));
  const auto whole = at({-1, 0, 2}, {1, 0, 2});
  REQUIRE(whole);
  CHECK(whole->predicted == Segment2d{120, 200, 520, 200});
  const auto cut = at({0.5, 0.5, 2}, {0.5, 0.5, -2});
  REQUIRE(cut);
  CHECK(cut->predicted.u1 == Approx(420));
  CHECK(cut->predicted.u2 > 5000);  // towards where the ray through the camera leads
  CHECK_FALSE(at({std::nan(""), 0, 1}, {0, 0, 1}));
}

TEST_CASE("The grid gives what crosses a rectangle, each once") {
  Random random(2);
  std::vector<Segment2d> segments;
  for (int i = 0; i < 300; ++i) {
    const auto c = [&](double low, double high) { return static_cast<float>(random.uniform(low, high)); };
    const Segment2d s{c(-50, 700), c(-50, 450), c(-50, 700), c(-50, 450)};
    segments.push_back(i % 3 ? s : Segment2d{s.u1, s.v1, s.u1 + 0.05f * s.du(), s.v1 + 0.05f * s.dv()});
  }
  segments.push_back({1e30f, -1e30f, 5, 5});
  segments.push_back({100, 100, 100, 100});
  SegmentGrid grid;
  grid.build(segments);
  for (int k = 0; k < 50; ++k) {
    const float u = static_cast<float>(random.uniform(-60, 600)),
                v = static_cast<float>(random.uniform(-60, 400));
    std::multiset<int> found;
    grid.for_each(u, u + 60, v, v + 40, [&](std::int32_t i) { found.insert(i); });
    for (int i = 0; i < 300; ++i) {
      bool crosses = false;
      for (int t = 0; t <= 400 && !crosses; ++t) {
        const float x = segments[i].u1 + segments[i].du() * t / 400,
                    y = segments[i].v1 + segments[i].dv() * t / 400;
        crosses = x >= u && x <= u + 60 && y >= v && y <= v + 40;
      }
      const bool right = found.count(i) <= 1 && (!crosses || found.count(i) == 1);
      CHECK_FALSE(!right);
    }
  }
  std::vector<std::uint8_t> skip(segments.size(), 1);
  grid.build(segments, skip);
  int visited = 0;
  grid.for_each(-1e9f, 1e9f, -1e9f, 1e9f, [&](std::int32_t) { ++visited; });
  CHECK(visited == 0);
  CHECK_THROWS_AS(grid.build(segments, std::vector<std::uint8_t>(3)), Error);
}
