// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/image/dense_disparity.hpp"

#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <opencv2/core.hpp>
#include <vector>

#include "image/random_image.hpp"
#include "sweepkit/core/error.hpp"
#include "sweepkit/core/random.hpp"

using namespace sweepkit;

namespace {

constexpr int kWidth = 320, kHeight = 160;

struct Pair {
  GrayImage left, right;
};

/// A texture that can be sampled anywhere.
class Texture {
 public:
  explicit Texture(std::uint64_t seed) {
    Random random(seed);
    for (auto& wave : waves_)
      wave = {random.uniform(-1.2, 1.2), random.uniform(-0.8, 0.8), random.uniform(0, 6.3)};
  }
  std::uint8_t operator()(double x, double y) const {
    double sum = 128;
    for (const Wave& w : waves_) sum += 11 * std::sin(w.a * x + w.b * y + w.c);
    return static_cast<std::uint8_t>(std::clamp(std::lround(sum), 0l, 255l));
  }

 private:
  struct Wave {
    double a, b, c;
  };
  Wave waves_[24];
};

/// A scene whose disparity depends on the row alone.
template <class DisparityOfRow>
Pair textured(const DisparityOfRow& disparity) {
  const Texture texture(7);
  Pair pair{GrayImage(kWidth, kHeight), GrayImage(kWidth, kHeight)};
  for (int v = 0; v < kHeight; ++v)
    for (int u = 0; u < kWidth; ++u) {
      pair.right(u, v) = texture(u, v);
      pair.left(u, v) = texture(u - disparity(v), v);
    }
  return pair;
}

struct Outcome {
  double density, median, spread;
};

template <class DisparityOfRow>
Outcome compare(DisparityView found, const DisparityOfRow& truth) {
  std::vector<double> errors;
  int seen = 0;
  for (int v = 12; v < kHeight - 12; ++v)
    for (int u = static_cast<int>(truth(v)) + 12; u < kWidth - 12; ++u) {
      ++seen;
      if (found(u, v) > 0) errors.push_back(found(u, v) / 16.0 - truth(v));
    }
  REQUIRE(errors.size() > 100);
  const auto median = [&] {
    std::nth_element(errors.begin(), errors.begin() + errors.size() / 2, errors.end());
    return errors[errors.size() / 2];
  };
  Outcome outcome{static_cast<double>(errors.size()) / seen, median(), 0};
  for (double& e : errors) e = std::abs(e - outcome.median);
  outcome.spread = median();
  return outcome;
}

bool equal(DisparityView a, DisparityView b) {
  bool same = a.width == b.width && a.height == b.height;
  for (int v = 0; same && v < a.height; ++v) same = std::equal(a.row(v), a.row(v) + a.width, b.row(v));
  return same;
}

DisparityOptions options_of(DisparityMethod method) {
  DisparityOptions options;
  options.method = method;
  options.disparities = 64;
  return options;
}

constexpr DisparityMethod kMethods[] = {DisparityMethod::bm, DisparityMethod::sgbm,
                                        DisparityMethod::sgbm_3way, DisparityMethod::sgbm_8way};

}  // namespace

TEST_CASE("Every method finds a constant disparity") {
  const DisparityMethod method = GENERATE(from_range(std::begin(kMethods), std::end(kMethods)));
  const double d = GENERATE(3.0, 20.5, 50.25);
  const auto truth = [&](int) { return d; };
  const Pair pair = textured(truth);
  DenseMatcher matcher(options_of(method));
  const Outcome outcome = compare(matcher.match(pair.left, pair.right), truth);
  CHECK(outcome.density > 0.9);
  CHECK(std::abs(outcome.median) < 0.15);
  CHECK(outcome.spread < 0.2);
}

TEST_CASE("A floor is matched better when it is expected, and what is not there just as well") {
  const DisparityMethod method = GENERATE(from_range(std::begin(kMethods), std::end(kMethods)));
  const DisparityRamp ramp{-20, 0.5};
  DenseMatcher matcher(options_of(method));
  const auto floor = [](int v) { return std::max(2.0, -20 + 0.5 * v); };
  const Pair slope = textured(floor);
  const Outcome plain = compare(matcher.match(slope.left, slope.right), floor);
  const Outcome expected = compare(matcher.match(slope.left, slope.right, ramp), floor);
  CHECK(expected.density > 0.9);
  CHECK(expected.density > plain.density - 0.01);
  CHECK(std::abs(expected.median) < 0.1);
  CHECK(expected.spread < 0.2);
  // Nearer and farther than the ramp: an obstacle, and a step down by up to 16 px.
  for (const double off : {25.0, -9.0}) {
    const auto other = [&](int v) { return std::max(3.0, floor(v) + off); };
    const Pair pair = textured(other);
    const Outcome outcome = compare(matcher.match(pair.left, pair.right, ramp), other);
    CHECK(outcome.density > 0.8);
    CHECK(std::abs(outcome.median) < 0.2);
  }
}

TEST_CASE("Near disparities go on to twice as many and leave the others alone") {
  const DisparityMethod method = GENERATE(DisparityMethod::sgbm, DisparityMethod::sgbm_3way);
  DisparityOptions options = options_of(method), near = options;
  near.near = true;
  DenseMatcher plain(options), twice(near);
  const auto close = [](int) { return 95.0; };
  const Pair pair = textured(close);
  const Outcome outcome = compare(twice.match(pair.left, pair.right), close);
  CHECK(outcome.density > 0.8);
  CHECK(std::abs(outcome.median) < 0.25);
  CHECK(outcome.spread < 0.5);
  // Farther ones are those of the whole images.
  const auto far = [](int) { return 20.5; };
  const Pair other = textured(far);
  Image<std::int16_t> expected;
  expected.assign(plain.match(other.left, other.right));
  const DisparityView found = twice.match(other.left, other.right);
  int differ = 0;
  for (int v = 0; v < kHeight; ++v)
    for (int u = 0; u < kWidth; ++u) differ += found(u, v) != expected(u, v);
  CHECK(differ < kWidth * kHeight / 1000);
  // And relative to a ramp.
  const DisparityRamp ramp{-20, 0.5};
  const auto above = [](int v) { return std::max(0.0, -20 + 0.5 * v) + 90; };
  const Pair sloped = textured(above);
  const Outcome lifted = compare(twice.match(sloped.left, sloped.right, ramp), above);
  CHECK(lifted.density > 0.7);
  CHECK(std::abs(lifted.median) < 0.4);
}

TEST_CASE("The left columns are matched as far as the right image reaches") {
  const auto truth = [](int) { return 6.0; };
  const Pair pair = textured(truth);
  for (const bool left_border : {true, false}) {
    DisparityOptions options = options_of(DisparityMethod::sgbm);
    options.left_border = left_border;
    DenseMatcher matcher(options);
    const DisparityView found = matcher.match(pair.left, pair.right);
    int known = 0;
    for (int v = 0; v < kHeight; ++v) {
      known +=
          static_cast<int>(std::count_if(found.row(v) + 12, found.row(v) + 60, [](int d) { return d > 0; }));
      for (int u = 0; u < kWidth; ++u) CHECK_FALSE(found(u, v) > 16 * u);
    }
    CHECK((known > 0.9 * 48 * kHeight) == left_border);
    if (!left_border) CHECK(known == 0);
  }
}

TEST_CASE("Images without contrast give no disparity") {
  const DisparityMethod method = GENERATE(from_range(std::begin(kMethods), std::end(kMethods)));
  DenseMatcher matcher(options_of(method));
  for (const int value : {0, 3, 128, 255}) {
    GrayImage flat(kWidth, kHeight);
    flat.fill(static_cast<std::uint8_t>(value));
    for (const DisparityRamp ramp : {DisparityRamp{}, DisparityRamp{-20, 0.5}}) {
      const DisparityView found = matcher.match(flat, flat, ramp);
      for (int v = 0; v < kHeight; ++v)
        CHECK_FALSE(std::count(found.row(v), found.row(v) + kWidth, 0) != kWidth);
    }
  }
}

TEST_CASE("Images that have nothing to do with each other give few disparities") {
  DenseMatcher matcher(options_of(DisparityMethod::sgbm));
  const GrayImage left = random_image(kWidth, kHeight, 1), right = random_image(kWidth, kHeight, 2);
  const DisparityView found = matcher.match(left, right);
  int known = 0;
  for (int v = 0; v < kHeight; ++v)
    known +=
        static_cast<int>(std::count_if(found.row(v), found.row(v) + kWidth, [](int d) { return d > 0; }));
  CHECK(known < kWidth * kHeight / 20);
}

TEST_CASE("Disparities do not depend on threads, nor on what was matched before") {
  const DisparityMethod method = GENERATE(from_range(std::begin(kMethods), std::end(kMethods)));
  const DisparityRamp ramp{-20, 0.5};
  const Pair pair = textured([](int v) { return v < 80 ? 30.0 : -20 + 0.5 * v; });
  DisparityOptions options = options_of(method);
  DenseMatcher matcher(options);
  const Image<std::int16_t> expected(matcher.match(pair.left, pair.right, ramp));
  matcher.match(pair.right, pair.left);
  CHECK(equal(matcher.match(pair.left, pair.right, ramp), expected));
  options.parallel = false;
  DenseMatcher alone(options);
  CHECK(equal(alone.match(pair.left, pair.right, ramp), expected));
  const int before = cv::getNumThreads();
  for (const int threads : {1, 2}) {
    cv::setNumThreads(threads);
    CHECK(equal(matcher.match(pair.left, pair.right, ramp), expected));
  }
  cv::setNumThreads(before);
}

TEST_CASE("Smoothing takes noise away, keeps edges of the image and invents only when told to") {
  const auto truth = [](int v) { return v < 80 ? 12.0 : 30.0; };
  Pair pair = textured(truth);
  Random random(3);
  // Noise makes the disparities vary; a brighter upper half is an edge where they step.
  for (GrayImage* image : {&pair.left, &pair.right})
    for (int v = 0; v < kHeight; ++v)
      for (int u = 0; u < kWidth; ++u)
        (*image)(u, v) = static_cast<std::uint8_t>(
            std::clamp((*image)(u, v) / 4 + (v < 80 ? 150 : 20) + random.normal(0, 3), 0.0, 255.0));
  DisparityOptions options = options_of(DisparityMethod::sgbm);
  const Image<std::int16_t> plain(DenseMatcher(options).match(pair.left, pair.right));
  options.smooth.enabled = true;
  options.smooth.smoothness = 0;
  CHECK(equal(DenseMatcher(options).match(pair.left, pair.right), plain));
  options.smooth.smoothness = 200;
  options.smooth.sigma = 12;
  const Image<std::int16_t> smooth(DenseMatcher(options).match(pair.left, pair.right));
  double squares[2] = {};
  int filled = 0, changed = 0, far_off = 0, seen = 0;
  options.smooth.fill = true;
  const Image<std::int16_t> full(DenseMatcher(options).match(pair.left, pair.right));
  for (int v = 0; v < kHeight; ++v)
    for (int u = 0; u < kWidth; ++u) {
      changed += (plain(u, v) > 0) != (smooth(u, v) > 0);
      filled += plain(u, v) == 0 && full(u, v) > 0;
      if (smooth(u, v) == 0) continue;
      if (std::abs(v - 80) > 40) {
        squares[0] += std::pow(plain(u, v) / 16.0 - truth(v), 2);
        squares[1] += std::pow(smooth(u, v) / 16.0 - truth(v), 2);
      }
      if (std::abs(v - 80) > 12) continue;
      ++seen;
      far_off += std::abs(smooth(u, v) / 16.0 - truth(v)) > std::abs(plain(u, v) / 16.0 - truth(v)) + 4;
    }
  CHECK(squares[1] < 0.5 * squares[0]);
  CHECK(changed == 0);
  CHECK(filled > 0);
  CHECK(far_off < seen / 50);
}

TEST_CASE("Wrong images and options are refused") {
  DenseMatcher matcher;
  const GrayImage a(100, 50), b(101, 50), small(4, 4);
  CHECK_THROWS_WITH(matcher.match(a, b), Catch::Contains("100x50") && Catch::Contains("101x50"));
  CHECK_THROWS_AS(matcher.match({}, {}), Error);
  CHECK_THROWS_AS(matcher.match(a, {}), Error);
  CHECK_THROWS_AS(matcher.match(small, small), Error);
  CHECK_THROWS_AS(matcher.match(a, a, {0, std::numeric_limits<double>::quiet_NaN()}), Error);
  DisparityOptions options;
  options.disparities = 100;
  CHECK_THROWS_WITH(DenseMatcher(options), Catch::Contains("disparities") && Catch::Contains("100"));
  options = {};
  options.block_size = 6;
  CHECK_THROWS_WITH(DenseMatcher(options), Catch::Contains("block_size"));
}

TEST_CASE("What lies outside the raw images has no disparity") {
  const Camera left({300, 300, 155, 81}, Distortion::none, {}, kWidth, kHeight);
  const Camera right({299, 299, 164, 78}, Distortion::none, {}, kWidth, kHeight);
  const StereoRig rig(left, right, SE3d(),
                      SE3d(SO3d::exp(Vec3<double>(0.02, -0.03, 0.12)), {0.06, 0.001, -0.002}));
  StereoDisparity source(rig, options_of(DisparityMethod::sgbm));
  const GrayImage a = random_image(kWidth, kHeight, 1);
  const DisparityView found = source.match(a, a);
  const GrayView seen[2] = {source.rectifier().seen(Side::left), source.rectifier().seen(Side::right)};
  int unseen = 0;
  for (int v = 0; v < kHeight; ++v)
    for (int u = 0; u < kWidth; ++u) {
      unseen += seen[0](u, v) == 0;
      const int d = found(u, v);
      CHECK_FALSE((d > 0 && (!seen[0](u, v) || !seen[1](u - ((d + 8) >> 4), v))));
    }
  CHECK(unseen > 0);
  CHECK_THROWS_AS(source.match(GrayImage(kWidth, kHeight - 1), a), Error);
}
