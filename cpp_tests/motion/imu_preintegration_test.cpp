// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/motion/imu_preintegration.hpp"

#include <catch2/catch.hpp>
#include <limits>
#include <numbers>

#include "sweepkit/core/random.hpp"

using namespace sweepkit;

namespace {

using Vec3d = Vec3<double>;

constexpr ImuNoise kNoise{1e-3, 2e-5, 1e-2, 3e-3};

ImuSample smooth(double t) {
  ImuSample s;
  s.t = from_seconds(t);
  s.gyro = {0.8 * std::sin(3 * t), 0.6 * std::cos(5 * t + 1), 1.1 * std::sin(2 * t + 0.3)};
  s.accel = {1.5 * std::cos(4 * t), -2 * std::sin(3 * t + 0.2), 9.81 + std::sin(6 * t)};
  return s;
}

std::vector<ImuSample> smooth_samples(double rate, double from, double to) {
  std::vector<ImuSample> samples;
  const auto count = static_cast<int>(std::lround((to - from) * rate));
  for (int i = 0; i <= count; ++i) samples.push_back(smooth(from + i / rate));
  return samples;
}

/// By the definition, in tiny steps: dR' = dR [w]x, dv' = dR a, dp' = dv (Runge-Kutta of fourth order).
ImuDelta fine_reference(double begin, double end) {
  constexpr int kSteps = 4000;
  const double h = (end - begin) / kSteps;
  ImuDelta d;
  d.begin = from_seconds(begin);
  d.end = from_seconds(end);
  Mat3<double> R = Mat3<double>::Identity();
  Vec3d v = Vec3d::Zero(), p = Vec3d::Zero();
  for (int k = 0; k < kSteps; ++k) {
    const double t = begin + k * h;
    struct Slope {
      Mat3<double> R;
      Vec3d v, p;
    };
    const auto slope = [&](double at, const Mat3<double>& R_at, const Vec3d& v_at) {
      const ImuSample s = smooth(at);
      // Not through `t` in nanoseconds: rounding would show.
      return Slope{R_at * SO3d::hat(s.gyro), R_at * s.accel, v_at};
    };
    const Slope k1 = slope(t, R, v);
    const Slope k2 = slope(t + h / 2, R + h / 2 * k1.R, v + h / 2 * k1.v);
    const Slope k3 = slope(t + h / 2, R + h / 2 * k2.R, v + h / 2 * k2.v);
    const Slope k4 = slope(t + h, R + h * k3.R, v + h * k3.v);
    R += h / 6 * (k1.R + 2 * k2.R + 2 * k3.R + k4.R);
    p += h / 6 * (k1.p + 2 * k2.p + 2 * k3.p + k4.p);
    v += h / 6 * (k1.v + 2 * k2.v + 2 * k3.v + k4.v);
  }
  d.R = SO3d(R);
  d.v = v;
  d.p = p;
  return d;
}

struct Difference {
  double R, v, p;
  double worst() const { return std::max({R, v, p}); }
};
Difference difference(const ImuDelta& a, const ImuDelta& b) {
  return {(a.R.inverse() * b.R).angle(), (a.v - b.v).norm(), (a.p - b.p).norm()};
}

template <class Rule>
ImuDelta integrate(std::span<const ImuSample> samples, double begin, double end, const ImuBias& bias = {}) {
  return preintegrate<Rule>(samples, from_seconds(begin), from_seconds(end), bias, kNoise).value();
}

}  // namespace

TEMPLATE_TEST_CASE("constant signals by hand", "[motion][imu]", MidpointRule, ClosedFormRule, CubicRule) {
  // a = 0.1 along x, w = pi / 100 about z, 0.5 s: an arc whose velocity turns with the body.
  const double a = 0.1, w = std::numbers::pi / 100, dt = 0.5, angle = w * dt;
  std::vector<ImuSample> samples;
  for (int i = 0; i <= 100; ++i) samples.push_back({from_seconds(0.005 * i), {0, 0, w}, {a, 0, 0}});
  const ImuDelta d = integrate<TestType>(samples, 0, dt);
  const double tolerance = std::is_same_v<TestType, MidpointRule> ? 1e-9 : 1e-13;
  CHECK(d.R.log().x() == Approx(0).margin(1e-15));
  CHECK(d.R.log().z() == Approx(0.015707963267948967).epsilon(1e-13));
  CHECK(d.v.x() == Approx(a / w * std::sin(angle)).margin(tolerance));
  CHECK(d.v.y() == Approx(a / w * (1 - std::cos(angle))).margin(tolerance));
  CHECK(d.p.x() == Approx(a / (w * w) * (1 - std::cos(angle))).margin(10 * tolerance));
  CHECK(d.p.y() == Approx(a / (w * w) * (angle - std::sin(angle))).margin(10 * tolerance));
  CHECK(d.p.z() == 0);
  // Without rotation: a t and a t^2 / 2.
  for (auto& s : samples) s.gyro.setZero();
  const ImuDelta straight = integrate<TestType>(samples, 0, dt);
  CHECK(straight.v.x() == Approx(0.05).epsilon(1e-13));
  CHECK(straight.p.x() == Approx(0.0125).epsilon(1e-13));
  CHECK(straight.R.angle() == 0);
}

TEST_CASE("the closed form is exact however far apart constant samples are", "[motion][imu]") {
  const Vec3d w(0.5, -1.2, 0.8), a(1, -2, 9.5);
  std::vector<ImuSample> coarse, fine;
  for (int i = 0; i <= 4; ++i) coarse.push_back({from_seconds(0.25 * i), w, a});
  for (int i = 0; i <= 2000; ++i) fine.push_back({from_seconds(0.0005 * i), w, a});
  ImuPreintegrationOptions options;
  options.max_gap = 1.0;
  const auto d = preintegrate<ClosedFormRule>(coarse, 0, kNsPerSecond, {}, kNoise, options).value();
  CHECK(difference(d, integrate<ClosedFormRule>(fine, 0, 1)).worst() < 1e-12);
  // Also where the angle of a step is large, by the other branch of the coefficients.
  CHECK(d.uncovered == 0);
}

TEST_CASE("cubics beat the midpoint rule tenfold after 1 s at 200 Hz", "[motion][imu]") {
  for (const double begin : {0.0, 0.7, 3.1}) {
    const ImuDelta truth = fine_reference(begin, begin + 1);
    const auto samples = smooth_samples(200, begin, begin + 1);
    const auto midpoint = difference(integrate<MidpointRule>(samples, begin, begin + 1), truth);
    const auto closed = difference(integrate<ClosedFormRule>(samples, begin, begin + 1), truth);
    const auto cubic = difference(integrate<CubicRule>(samples, begin, begin + 1), truth);
    CHECK(midpoint.worst() < 3e-4);
    CHECK(closed.worst() < 3e-4);
    CHECK(cubic.R < 0.1 * midpoint.R);
    CHECK(cubic.v < 0.1 * midpoint.v);
    CHECK(cubic.p < 0.1 * midpoint.p);
    // The order: half the interval, a fourth and a sixteenth of the error.
    const auto dense = smooth_samples(400, begin, begin + 1);
    const auto midpoint2 = difference(integrate<MidpointRule>(dense, begin, begin + 1), truth);
    const auto cubic2 = difference(integrate<CubicRule>(dense, begin, begin + 1), truth);
    CHECK(midpoint.v / midpoint2.v == Approx(4).margin(1));
    CHECK(cubic.v / cubic2.v > 8);
  }
}

TEMPLATE_TEST_CASE("derivatives with respect to the bias by central differences", "[motion][imu]",
                   MidpointRule, ClosedFormRule, CubicRule) {
  const auto samples = smooth_samples(200, 0, 1.2);
  // The closed form's are exact; those of the others are taken to be the same, right to the order of the
  // rule.
  const double tolerance = std::is_same_v<TestType, ClosedFormRule> ? 2e-8 : 3e-5;
  const ImuBias bias{{0.02, -0.01, 0.03}, {0.1, 0.05, -0.2}};
  const ImuDelta d = integrate<TestType>(samples, 0.0123, 1.0377, bias);
  constexpr double h = 1e-4;
  for (int i = 0; i < 3; ++i) {
    ImuBias more = bias, less = bias;
    more.gyro[i] += h;
    less.gyro[i] -= h;
    ImuDelta p = integrate<TestType>(samples, 0.0123, 1.0377, more);
    ImuDelta m = integrate<TestType>(samples, 0.0123, 1.0377, less);
    const Vec3d R = ((d.R.inverse() * p.R).log() - (d.R.inverse() * m.R).log()) / (2 * h);
    CHECK((R - d.R_gyro.col(i)).norm() < tolerance);
    CHECK(((p.v - m.v) / (2 * h) - d.v_gyro.col(i)).norm() < 10 * tolerance);
    CHECK(((p.p - m.p) / (2 * h) - d.p_gyro.col(i)).norm() < 10 * tolerance);
    more = less = bias;
    more.accel[i] += h;
    less.accel[i] -= h;
    p = integrate<TestType>(samples, 0.0123, 1.0377, more);
    m = integrate<TestType>(samples, 0.0123, 1.0377, less);
    CHECK(((p.v - m.v) / (2 * h) - d.v_accel.col(i)).norm() < tolerance);
    CHECK(((p.p - m.p) / (2 * h) - d.p_accel.col(i)).norm() < tolerance);
  }
}

TEST_CASE("bias is corrected to first order, and beyond a threshold by integrating again", "[motion][imu]") {
  const auto samples = smooth_samples(200, 0, 1);
  BasicImuPreintegration<ClosedFormRule> kept(samples, 0, kNsPerSecond, {}, kNoise);
  const ImuBias small{{0.004, -0.002, 0.003}, {0.05, 0.02, -0.03}};
  const ImuBias large{{0.04, -0.02, 0.03}, {0.05, 0.02, -0.03}};
  const ImuDelta first_order = kept.at(small);
  CHECK(kept.integrations() == 1);
  const double error = difference(first_order, integrate<ClosedFormRule>(samples, 0, 1, small)).worst();
  const ImuBias half{0.5 * small.gyro, 0.5 * small.accel};
  const double error_half = difference(kept.at(half), integrate<ClosedFormRule>(samples, 0, 1, half)).worst();
  CHECK(error < 3e-4);
  CHECK(error / error_half == Approx(4).margin(0.2));
  const ImuDelta again = kept.at(large);
  CHECK(kept.integrations() == 2);
  CHECK(difference(again, integrate<ClosedFormRule>(samples, 0, 1, large)).worst() == 0);
  CHECK(kept.at(large).R.angle() == again.R.angle());
  CHECK(kept.integrations() == 2);
  CHECK_THROWS_AS(ImuPreintegration(samples, 5, 5, {}, kNoise), Error);
  CHECK_THROWS_AS(ImuPreintegration({}, 0, 5, {}, kNoise), Error);
}

TEMPLATE_TEST_CASE("the covariance is that of many noisy samples", "[motion][imu]", MidpointRule,
                   ClosedFormRule, CubicRule) {
  constexpr double kRate = 200;
  const auto samples = smooth_samples(kRate, 0, 1);
  const ImuDelta d = integrate<TestType>(samples, 0, 1);
  Random random(1);
  Eigen::Matrix<double, 9, 9> spread = Eigen::Matrix<double, 9, 9>::Zero();
  constexpr int kTrials = 2000;
  auto noisy = samples;
  for (int n = 0; n < kTrials; ++n) {
    for (std::size_t k = 0; k < samples.size(); ++k)
      for (int i = 0; i < 3; ++i) {
        noisy[k].gyro[i] =
            samples[k].gyro[i] + random.normal(0, kNoise.gyro_noise_density * std::sqrt(kRate));
        noisy[k].accel[i] =
            samples[k].accel[i] + random.normal(0, kNoise.accel_noise_density * std::sqrt(kRate));
      }
    const ImuDelta other = integrate<TestType>(noisy, 0, 1);
    Eigen::Matrix<double, 9, 1> e;
    e << (d.R.inverse() * other.R).log(), other.v - d.v, other.p - d.p;
    spread += e * e.transpose() / kTrials;
  }
  const Eigen::Matrix<double, 9, 9> L =
      d.covariance.llt().matrixL().solve(Eigen::Matrix<double, 9, 9>::Identity());
  CHECK((L * spread * L.transpose() - Eigen::Matrix<double, 9, 9>::Identity()).cwiseAbs().maxCoeff() < 0.17);
  CHECK((d.covariance - d.covariance.transpose()).norm() == 0);
}

TEST_CASE("the covariance without matrix products is the textbook's", "[motion][imu]") {
  // P' = A P A^T + Q with dense 9 x 9 matrices, errors of the rotation in the body, in 20 substeps of each
  // interval, so that noise within it counts.
  const auto samples = smooth_samples(100, 0, 1);
  const ImuDelta d = integrate<ClosedFormRule>(samples, 0, 1);
  using Mat9 = Eigen::Matrix<double, 9, 9>;
  Mat9 P = Mat9::Zero();
  SO3d R;
  constexpr int kParts = 20;
  for (std::size_t k = 0; k + 1 < samples.size(); ++k) {
    const double h = 0.01 / kParts;
    const Vec3d w = 0.5 * (samples[k].gyro + samples[k + 1].gyro);
    const Vec3d a = 0.5 * (samples[k].accel + samples[k + 1].accel);
    for (int i = 0; i < kParts; ++i) {
      const SO3d middle = R * SO3d::exp(0.5 * h * w);
      Mat9 A = Mat9::Identity();
      A.block<3, 3>(0, 0) = SO3d::exp(-h * w).matrix();
      A.block<3, 3>(3, 0) = -middle.matrix() * SO3d::hat(a) * h;
      A.block<3, 3>(6, 0) = 0.5 * h * A.block<3, 3>(3, 0);
      A.block<3, 3>(6, 3) = h * Mat3<double>::Identity();
      Mat9 Q = Mat9::Zero();
      Q.block<3, 3>(0, 0).diagonal().setConstant(std::pow(kNoise.gyro_noise_density, 2) * h);
      Q.block<3, 3>(3, 3).diagonal().setConstant(std::pow(kNoise.accel_noise_density, 2) * h);
      P = A * P * A.transpose() + Q;
      R = R * SO3d::exp(h * w);
    }
  }
  const Mat9 L = P.llt().matrixL().solve(Mat9::Identity());
  CHECK((L * d.covariance * L.transpose() - Mat9::Identity()).cwiseAbs().maxCoeff() < 0.01);
}

TEST_CASE("prediction from two deltas is that from the whole", "[motion][imu]") {
  const auto samples = smooth_samples(200, 0, 1);
  const Vec3d g(0, 0, -9.81);
  ImuState state{SO3d::exp({0.1, 0.2, 0.3}), {0.3, 0, 0.1}, {1, 2, 3}};
  const ImuState whole = integrate<ClosedFormRule>(samples, 0, 1).predict(state, g);
  ImuState parts = integrate<ClosedFormRule>(samples, 0, 0.4).predict(state, g);
  parts = integrate<ClosedFormRule>(samples, 0.4, 1).predict(parts, g);
  CHECK((whole.position - parts.position).norm() < 1e-12);
  CHECK((whole.velocity - parts.velocity).norm() < 1e-12);
  CHECK((whole.R_world_body.inverse() * parts.R_world_body).angle() < 1e-12);
  // Lying still: the specific force holds against gravity.
  std::vector<ImuSample> still;
  for (int i = 0; i <= 20; ++i) still.push_back({from_seconds(0.01 * i), Vec3d::Zero(), {0, 0, 9.81}});
  const ImuState rest = integrate<ClosedFormRule>(still, 0, 0.2).predict({}, g);
  CHECK(rest.velocity.norm() < 1e-14);
  CHECK(rest.position.norm() < 1e-14);
}

TEMPLATE_TEST_CASE("bad samples never break a delta", "[motion][imu]", MidpointRule, ClosedFormRule,
                   CubicRule) {
  const auto good = smooth_samples(200, 0, 1);
  const ImuDelta clean = integrate<TestType>(good, 0, 1);
  const auto check_sane = [&](const ImuDelta& d, double tolerance) {
    CHECK(d.R.quaternion().coeffs().allFinite());
    CHECK(d.v.allFinite());
    CHECK(d.covariance.allFinite());
    CHECK(d.covariance.ldlt().isPositive());
    CHECK(difference(d, clean).worst() < tolerance);
  };
  SECTION("duplicates and steps back in time are left out") {
    auto bad = good;
    bad.insert(bad.begin() + 50, bad[49]);
    bad.insert(bad.begin() + 100, bad[60]);
    bad[100].gyro.setConstant(100);
    check_sane(integrate<TestType>(bad, 0, 1), 0.0 + 1e-15);
  }
  SECTION("not a number is left out") {
    auto bad = good;
    bad[30].gyro.x() = std::numeric_limits<double>::quiet_NaN();
    bad[90].accel.z() = std::numeric_limits<double>::infinity();
    const ImuDelta d = integrate<TestType>(bad, 0, 1);
    check_sane(d, 1e-3);
    CHECK(d.uncovered == 0);
  }
  SECTION("all bad") {
    auto bad = good;
    for (auto& s : bad) s.accel.y() = std::numeric_limits<double>::quiet_NaN();
    CHECK_FALSE(preintegrate<TestType>(bad, 0, kNsPerSecond, {}, kNoise));
    CHECK_FALSE(preintegrate<TestType>({}, 0, kNsPerSecond, {}, kNoise));
    CHECK_FALSE(preintegrate<TestType>(good, 5, 5, {}, kNoise));
    CHECK_FALSE(preintegrate<TestType>(good, 5, 4, {}, kNoise));
  }
  SECTION("a second of silence: the covariance covers what is not known") {
    auto bad = smooth_samples(200, 0, 3);
    const ImuDelta truth = integrate<TestType>(bad, 0, 3);
    bad.erase(bad.begin() + 201, bad.begin() + 400);
    const ImuDelta d = integrate<TestType>(bad, 0, 3);
    CHECK(d.uncovered == Approx(1.0));
    CHECK(std::sqrt(d.covariance(0, 0)) == Approx(1.0).epsilon(0.01));
    Eigen::Matrix<double, 9, 1> e;
    e << (d.R.inverse() * truth.R).log(), truth.v - d.v, truth.p - d.p;
    CHECK(e.dot(d.covariance.ldlt().solve(e)) < 27.9);  // chi-square, 9 degrees of freedom, 0.1 %
  }
  SECTION("before the first and after the last sample they are held") {
    const ImuDelta d = integrate<TestType>(good, -0.1, 1.2);
    CHECK(d.uncovered == Approx(0.3));
    CHECK(d.covariance.ldlt().isPositive());
    const ImuDelta beyond = integrate<TestType>(good, 2, 2.1);
    CHECK(beyond.uncovered == Approx(0.1));
    const ImuDelta one = integrate<TestType>(std::span(good).first(1), 0, 0.01);
    CHECK(one.uncovered == Approx(0.01));
    CHECK((one.v - 0.01 * good[0].accel).norm() < 1e-3);
  }
  SECTION("saturation is told and felt") {
    auto bad = good;
    for (int i = 40; i < 60; ++i) bad[i].gyro = bad[i].gyro.cwiseMax(-0.5).cwiseMin(0.5);
    ImuPreintegrationOptions options;
    options.gyro_range = 0.5;
    for (int i = 0; i < 201; ++i)
      if (i < 40 || i >= 60) bad[i].gyro *= 0.4;
    const auto d = preintegrate<TestType>(bad, 0, kNsPerSecond, {}, kNoise, options).value();
    CHECK(d.saturated > 0.05);
    CHECK(d.saturated < 0.12);
    CHECK(d.covariance(0, 0) > 1e-3);
  }
}
