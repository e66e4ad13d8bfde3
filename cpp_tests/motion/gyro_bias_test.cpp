// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/motion/gyro_bias.hpp"

#include <catch2/catch.hpp>
#include <limits>

#include "sweepkit/core/random.hpp"
#include "sweepkit/motion/imu_preintegration.hpp"

using namespace sweepkit;

namespace {

using Vec3d = Vec3<double>;

const Vec3d kBias(0.004, -0.02, 0.075);
constexpr ImuNoise kNoise{2e-4, 2e-5, 2e-3, 3e-3};
constexpr double kDegree = 0.017453292519943295;

Vec3d draw(Random& random, double sigma) {
  return {random.normal(0, sigma), random.normal(0, sigma), random.normal(0, sigma)};
}

struct Flight {
  std::vector<ImuSample> imu;
  std::vector<SO3d> attitudes;  // at each sample
};

Flight fly(double seconds, double noise, std::uint64_t seed = 1, double motion = 1.0) {
  Random random(seed);
  Flight flight;
  SO3d R;
  const auto rate = [&](double t) -> Vec3d {
    return motion * Vec3d(0.6 * std::sin(2 * t), 0.4 * std::cos(3 * t + 1), 0.8 * std::sin(t + 0.3));
  };
  const auto count = static_cast<int>(seconds * 200);
  for (int k = 0; k <= count; ++k) {
    const double t = k * 0.005;
    flight.imu.push_back(
        {from_seconds(t), rate(t) + kBias + draw(random, noise * std::sqrt(200.0)), {0, 0, 9.81}});
    flight.attitudes.push_back(R);
    for (int i = 0; i < 10; ++i) R = R * SO3d::exp(rate(t + (i + 0.5) * 0.0005) * 0.0005);
  }
  return flight;
}

std::vector<TurnPair> make_pairs(const Flight& flight, int every, const Vec3d& start, double vision_sigma,
                                 std::uint64_t seed = 2) {
  Random random(seed);
  std::vector<SO3d> seen;
  for (std::size_t k = 0; k < flight.imu.size(); k += every)
    seen.push_back(flight.attitudes[k] * SO3d::exp(draw(random, vision_sigma)));
  std::vector<TurnPair> pairs;
  for (std::size_t j = 0; j + 1 < seen.size(); ++j)
    pairs.push_back(
        {seen[j].inverse() * seen[j + 1],
         integrate_gyro(flight.imu, flight.imu[j * every].t, flight.imu[(j + 1) * every].t, start, kNoise)
             .value()});
  return pairs;
}

}  // namespace

TEST_CASE("the gyro alone integrates as the whole IMU does", "[motion][gyro]") {
  const Flight flight = fly(2, 0);
  const Vec3d bias(0.01, -0.02, 0.03);
  const TimeNs begin = 212'345'678, end = 1'765'432'100;
  const GyroDelta gyro = integrate_gyro(flight.imu, begin, end, bias, kNoise).value();
  const ImuDelta imu = preintegrate<CubicRule>(flight.imu, begin, end, {bias, {}}, kNoise).value();
  CHECK((gyro.R.inverse() * imu.R).angle() < 1e-5);
  CHECK((gyro.R_gyro - imu.R_gyro).norm() < 1e-5);
  CHECK(gyro.variance == Approx(imu.covariance(0, 0)));
  CHECK(gyro.uncovered == 0);
  constexpr double h = 1e-5;
  for (int i = 0; i < 3; ++i) {
    Vec3d more = bias, less = bias;
    more[i] += h;
    less[i] -= h;
    const SO3d a = integrate_gyro(flight.imu, begin, end, more, kNoise)->R;
    const SO3d b = integrate_gyro(flight.imu, begin, end, less, kNoise)->R;
    CHECK((((gyro.R.inverse() * a).log() - (gyro.R.inverse() * b).log()) / (2 * h) - gyro.R_gyro.col(i))
              .norm() < 1e-5);
  }
}

TEST_CASE("bad gyro samples", "[motion][gyro]") {
  const Flight flight = fly(2, 0);
  const GyroDelta clean = integrate_gyro(flight.imu, 0, kNsPerSecond, kBias, kNoise).value();
  auto bad = flight.imu;
  bad.insert(bad.begin() + 50, bad[20]);
  bad[90].gyro.y() = std::numeric_limits<double>::quiet_NaN();
  const GyroDelta mended = integrate_gyro(bad, 0, kNsPerSecond, kBias, kNoise).value();
  CHECK((mended.R.inverse() * clean.R).angle() < 1e-4);
  bad = flight.imu;
  bad.erase(bad.begin() + 40, bad.begin() + 140);
  const GyroDelta hole = integrate_gyro(bad, 0, kNsPerSecond, kBias, kNoise).value();
  CHECK(hole.uncovered == Approx(0.505));
  CHECK(std::sqrt(hole.variance) == Approx(0.505).epsilon(0.01));
  CHECK(hole.R.quaternion().coeffs().allFinite());
  CHECK(integrate_gyro(flight.imu, -kNsPerSecond, 0, kBias, kNoise)->uncovered == Approx(1));
  CHECK_FALSE(integrate_gyro({}, 0, 1, kBias, kNoise));
  CHECK_FALSE(integrate_gyro(flight.imu, 5, 5, kBias, kNoise));
}

TEST_CASE("the window finds the bias exactly without noise, from far away", "[motion][gyro]") {
  const Flight flight = fly(5, 0);
  for (const Vec3d& start : {Vec3d(0, 0, 0), Vec3d(0.2, -0.1, 0.3), kBias}) {
    const auto estimate = solve_gyro_bias(make_pairs(flight, 100, start, 0));
    REQUIRE(estimate);
    CHECK((estimate->bias - kBias).norm() < 2e-4);
  }
  CHECK((solve_gyro_bias(make_pairs(flight, 100, kBias, 0))->bias - kBias).norm() < 2e-6);
  CHECK_FALSE(solve_gyro_bias({}));
}

TEST_CASE("the window's covariance is honest", "[motion][gyro]") {
  GyroBiasWindowOptions options;
  options.vision_sigma = 0.1;
  options.outlier_sigmas = 1e6;
  double sum = 0;
  constexpr int kTrials = 100;
  for (std::uint64_t seed = 1; seed <= kTrials; ++seed) {
    const Flight flight = fly(5, kNoise.gyro_noise_density, seed, 0.3);
    const auto estimate =
        solve_gyro_bias(make_pairs(flight, 100, kBias, 0.1 * kDegree, seed + 1000), options).value();
    const Vec3d e = estimate.bias - kBias;
    sum += e.dot(estimate.covariance.ldlt().solve(e)) / kTrials;
  }
  CHECK(sum == Approx(3).margin(0.75));  // three dimensions; deviates by sqrt(6 / 100)
}

TEST_CASE("a wrong attitude hardly moves the window", "[motion][gyro]") {
  const Flight flight = fly(10, kNoise.gyro_noise_density);
  auto pairs = make_pairs(flight, 100, kBias, 0.05 * kDegree);
  pairs[7].R_vision = pairs[7].R_vision * SO3d::exp({0.2, 0.1, -0.1});
  CHECK((solve_gyro_bias(pairs)->bias - kBias).norm() < 0.05 * kDegree);
}

TEST_CASE("each step works alone", "[motion][gyro]") {
  CHECK((limit_change({1, 0, 0}, {1.5, 0, 0}, 1) - Vec3d(1.5, 0, 0)).norm() == 0);
  CHECK((limit_change({1, 0, 0}, {4, 4, 0}, 1) - Vec3d(1.6, 0.8, 0)).norm() < 1e-15);

  // The low pass settles as it should once it is older than its time constant.
  FirstOrderFilter filter(2.0);
  filter.update({0, 0, 0}, 0);
  for (int i = 0; i < 400; ++i) filter.update({0, 0, 0}, 0.01);
  for (int i = 0; i < 200; ++i) filter.update({1, 0, 0}, 0.01);
  CHECK(filter.value()->x() == Approx(1 - std::exp(-1.0)));
  FirstOrderFilter open(0.0);
  open.update({0, 0, 0}, 0);
  CHECK(open.update({5, 0, 0}, 0.1).x() == 5);

  // Inverse variances, and the covariance of the sum.
  const GyroBiasEstimate a{{1, 1, 1}, Vec3d(1, 2, 1e-6).asDiagonal()},
      b{{3, 4, 9}, Vec3d(3, 2, 1).asDiagonal()};
  const GyroBiasEstimate c = blend(a, b);
  CHECK((c.bias - Vec3d(1.5, 2.5, 1.000008)).norm() < 1e-6);
  CHECK(c.covariance(0, 0) == Approx(0.75));
  CHECK(c.covariance(1, 1) == Approx(1));
}

TEST_CASE("at standstill the mean is as good as the noise allows", "[motion][gyro]") {
  double sum = 0;
  constexpr int kTrials = 200;
  for (std::uint64_t seed = 1; seed <= kTrials; ++seed) {
    Random random(seed);
    StandstillBias stand(kNoise);
    CHECK_FALSE(stand.estimate());
    for (int k = 0; k < 400; ++k)
      stand.add(
          {k * 5'000'000, kBias + draw(random, kNoise.gyro_noise_density * std::sqrt(200.0)), {0, 0, 9.81}});
    CHECK(stand.seconds() == Approx(2));
    const auto estimate = stand.estimate().value();
    sum += (estimate.bias - kBias).squaredNorm() / 3 / kTrials;
    CHECK(std::sqrt(estimate.covariance(0, 0)) ==
          Approx(kNoise.gyro_noise_density / std::sqrt(2.0)).epsilon(0.01));
  }
  CHECK(std::sqrt(sum) == Approx(kNoise.gyro_noise_density / std::sqrt(2.0)).epsilon(0.1));
}

TEST_CASE("the estimator follows the bias through a flight", "[motion][gyro]") {
  const Flight flight = fly(40, kNoise.gyro_noise_density);
  for (const bool wrong_start : {false, true}) {
    GyroBiasEstimator estimator(kNoise, {}, wrong_start ? Vec3d(0, 0, 0) : kBias);
    Random random(5);
    for (std::size_t k = 0; k < flight.imu.size(); ++k) {
      CHECK(estimator.add(flight.imu[k]));
      if (k % 50 == 0) {
        estimator.add_attitude(flight.imu[k].t,
                               flight.attitudes[k] * SO3d::exp(draw(random, 0.05 * kDegree)));
        if (k > 4000) CHECK((estimator.bias() - kBias).norm() < 0.03 * kDegree);
      }
    }
    CHECK(estimator.known());
  }
}

TEST_CASE("the estimator with standstill, losses and bad input", "[motion][gyro]") {
  const Flight flight = fly(20, kNoise.gyro_noise_density, 3, 0.0);
  GyroBiasOptions options;
  options.time_constant = 0;
  options.max_change = 10;
  GyroBiasEstimator estimator(kNoise, options);
  estimator.set_standing(true);
  for (int k = 0; k < 400; ++k) estimator.add(flight.imu[k]);
  CHECK_FALSE(estimator.known());
  estimator.set_standing(false);
  CHECK(estimator.known());
  CHECK((estimator.bias() - kBias).norm() < 4 * kNoise.gyro_noise_density / std::sqrt(2.0));
  CHECK_FALSE(estimator.add(flight.imu[0]));
  ImuSample bad = flight.imu[401];
  bad.gyro.setConstant(std::numeric_limits<double>::quiet_NaN());
  CHECK_FALSE(estimator.add(bad));
  // Attitudes that jump while vision was lost are not paired.
  for (int k = 400; k < 4000; ++k) {
    estimator.add(flight.imu[k]);
    if (k == 2000) estimator.break_attitudes();
    if (k % 40 == 0) estimator.add_attitude(flight.imu[k].t, SO3d::exp({0, 0, k < 2000 ? 0.0 : 1.5}));
    if (k == 1000) estimator.add_attitude(0, SO3d::exp({1, 0, 0}));
  }
  CHECK((estimator.bias() - kBias).norm() < 0.02 * kDegree);
  // Nothing moves it faster than the limit.
  options.max_change = 0.01;
  GyroBiasEstimator slow(kNoise, options, kBias);
  Vec3d last = kBias;
  for (int k = 0; k < 4000; ++k) {
    slow.add(flight.imu[k]);
    if (k % 40 == 0)
      slow.add_attitude(flight.imu[k].t, SO3d::exp({0, 0, k < 2000 ? 0.0 : 0.01 * (k - 2000) / 40}));
    if (slow.known() && k > 1000) CHECK((slow.bias() - last).norm() < 0.0101 * kDegree);
    last = slow.bias();
  }
}
