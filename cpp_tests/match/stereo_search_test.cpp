// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/match/stereo_search.hpp"

#include <catch2/catch.hpp>

#include "match/stereo_scene.hpp"
#include "sweepkit/core/simd.hpp"

using namespace sweepkit;

namespace {

/// The definition: every right key point is looked at for every left one.
std::vector<StereoMatch> slow_match(const StereoRig& rig, const StereoSearchOptions& o,
                                    const Features<256>& left, const Features<256>& right,
                                    const std::vector<float>& prior) {
  const auto scale = [&](int octave) { return static_cast<float>(std::pow(o.scale_factor, octave)); };
  const auto rectify = [&](Side side, const KeyPoint& k) { return rig.rectify_fast(side, {k.x, k.y}); };
  const auto focal = static_cast<float>(rig.focal());
  const auto accepts = [&](std::size_t i, std::size_t j) {
    const auto l = rectify(Side::left, left.keypoints[i]), r = rectify(Side::right, right.keypoints[j]);
    if (!l || !r) return false;
    const int octave = left.keypoints[i].octave;
    if (std::abs(octave - right.keypoints[j].octave) > o.max_octave_difference) return false;
    if (std::abs(r->y() - l->y()) > static_cast<float>(o.row_tolerance) * scale(octave)) return false;
    float low = 0, high = focal;
    if (!prior.empty() && prior[i] > 0) {
      low = std::max(prior[i] - static_cast<float>(o.threshold), 0.0f);
      high = std::min(prior[i] + static_cast<float>(o.threshold), focal);
    }
    return r->x() >= l->x() - high && (low > 0 ? r->x() <= l->x() - low : r->x() < l->x());
  };
  std::vector<StereoMatch> matches(left.size());
  for (std::size_t i = 0; i < left.size(); ++i) {
    const auto l = rectify(Side::left, left.keypoints[i]);
    if (!l) continue;
    matches[i] = {.u_left = l->x(), .v_left = l->y(), .rectified = 1};
    int best = -1, best_distance = 1000;
    for (std::size_t j = 0; j < right.size(); ++j) {
      const int distance = hamming_distance(left.descriptors[i], right.descriptors[j]);
      if (accepts(i, j) && distance < best_distance) {
        best = static_cast<int>(j);
        best_distance = distance;
      }
    }
    if (best < 0 || best_distance > o.max_distance) continue;
    const float u_best = rectify(Side::right, right.keypoints[best])->x();
    bool good = true;
    for (std::size_t j = 0; j < right.size() && o.ratio < 1; ++j)
      if (accepts(i, j) && std::abs(rectify(Side::right, right.keypoints[j])->x() - u_best) >
                               2 * scale(left.keypoints[i].octave))
        good = good && static_cast<float>(best_distance) <=
                           static_cast<float>(o.ratio) * static_cast<float>(hamming_distance(
                                                             left.descriptors[i], right.descriptors[j]));
    for (std::size_t k = 0; k < left.size() && o.left_right_check; ++k)
      if (k != i && accepts(k, best)) {
        const int distance = hamming_distance(left.descriptors[k], right.descriptors[best]);
        good = good && (distance > best_distance || (distance == best_distance && k > i));
      }
    if (!good) continue;
    matches[i].right = best;
    matches[i].u_right = u_best;
    matches[i].disparity = l->x() - u_best;
    matches[i].sigma = static_cast<float>(o.sigma) * scale(left.keypoints[i].octave);
    matches[i].distance = best_distance;
  }
  return matches;
}

}  // namespace

TEST_CASE("stereo search finds what looking at every pair finds, at every SIMD level") {
  Random random(5);
  for (const StereoRig& rig : {rectified_rig(), unrectified_rig()}) {
    const PointScene scene = point_scene(random, rig, 250, 50, 0.5);
    std::vector<float> prior;
    for (const auto& uvd : scene.uvd_left)
      prior.push_back(random.uniform() < 0.3 ? -1.0f : static_cast<float>(uvd.z() + random.normal(0, 8)));
    for (const bool check : {false, true})
      for (const double ratio : {0.8, 1.0})
        for (const bool with_prior : {false, true}) {
          // Many rows and octaves, so that many compete.
          const StereoSearchOptions options{.row_tolerance = 6,
                                            .threshold = 10,
                                            .max_distance = 110,
                                            .max_octave_difference = 2,
                                            .ratio = ratio,
                                            .left_right_check = check};
          const std::vector<float> p = with_prior ? prior : std::vector<float>();
          const auto expected = slow_match(rig, options, scene.left, scene.right, p);
          StereoSearch search(rig, options);
          std::vector<StereoMatch> fast, portable;
          const int found = search.match(scene.left, scene.right, p, fast);
          {
            const ScopedSimdLevel level(SimdLevel::portable);
            search.match(scene.left, scene.right, p, portable);
          }
          CHECK(fast == expected);
          CHECK(portable == expected);
          CHECK(found == std::ranges::count_if(fast, &StereoMatch::found));
          CHECK(found > 100);
        }
  }
}

TEST_CASE("known points come out of two distorted unrectified cameras") {
  Random random(8);
  const StereoRig rig = unrectified_rig();
  const PointScene scene = point_scene(random, rig, 600, 30, 0.2);
  StereoSearch search(rig);
  std::vector<StereoMatch> matches;
  search.match(scene.left, scene.right, {}, matches);
  int right = 0, wrong = 0, there = 0;
  for (std::size_t i = 0; i < matches.size(); ++i) {
    REQUIRE(matches[i].rectified);
    CHECK(std::abs(matches[i].u_left - scene.uvd_left[i].x()) < 1.5);
    CHECK(std::abs(matches[i].v_left - scene.uvd_left[i].y()) < 1.5);
    there += scene.right_of_left[i] >= 0;
    if (!matches[i].found()) continue;
    if (matches[i].right == scene.right_of_left[i]) {
      ++right;
      CHECK(std::abs(matches[i].disparity - scene.uvd_left[i].z()) < 2.0);
    } else {
      ++wrong;
    }
  }
  CHECK(right > 0.97 * there);
  CHECK(wrong == 0);
}

TEST_CASE("rows, octaves, priors and the sign of the disparity restrict the search") {
  const StereoRig rig = rectified_rig();
  Features<256> left, right;
  left.keypoints = {{.x = 300, .y = 200, .octave = 1}};
  left.descriptors.resize(1);
  right.descriptors.resize(1);
  const auto finds = [&](float x, float y, int octave, std::vector<float> prior = {}) {
    right.keypoints = {{.x = x, .y = y, .octave = octave}};
    std::vector<StereoMatch> matches;
    return StereoSearch(rig, {.threshold = 10}).match(left, right, prior, matches) == 1;
  };
  CHECK(finds(280, 200, 1));
  CHECK(finds(280, 202.39f, 1));  // 2 * 1.2
  CHECK_FALSE(finds(280, 202.41f, 1));
  CHECK_FALSE(finds(280, 197.5f, 1));
  CHECK(finds(280, 200, 0));
  CHECK(finds(280, 200, 2));
  CHECK_FALSE(finds(280, 200, 3));
  CHECK_FALSE(finds(300, 200, 1));
  CHECK_FALSE(finds(310, 200, 1));
  CHECK(finds(299.9f, 200, 1));
  CHECK(finds(-119, 200, 1));  // disparity 419 of focal length 420
  CHECK_FALSE(finds(-121, 200, 1));
  CHECK(finds(280, 200, 1, {29}));
  CHECK_FALSE(finds(280, 200, 1, {31}));
  CHECK_FALSE(finds(280, 200, 1, {9}));
  CHECK(finds(280, 200, 1, {-1}));
  CHECK_FALSE(finds(300, 200, 1, {5}));
}

TEST_CASE("stereo search takes empty input and refuses what does not fit") {
  StereoSearch search(unrectified_rig());
  Random random(1);
  const Features<256> some = random_features(random, 20), none;
  std::vector<StereoMatch> matches;
  CHECK(search.match(none, none, {}, matches) == 0);
  CHECK(matches.empty());
  CHECK(search.match(none, some, {}, matches) == 0);
  CHECK(search.match(some, none, {}, matches) == 0);
  CHECK(matches.size() == 20);
  const std::vector<float> prior(3);
  CHECK_THROWS_AS(search.match(some, some, prior, matches), Error);
  Features<256> wrong = some;
  wrong.descriptors.pop_back();
  CHECK_THROWS_AS(search.match(wrong, some, {}, matches), Error);
  wrong = some;
  wrong.keypoints[3].octave = 32;
  CHECK_THROWS_AS(search.match(some, wrong, {}, matches), Error);
  CHECK_THROWS_AS(StereoSearch(rectified_rig(), {.ratio = 2}), Error);
}
