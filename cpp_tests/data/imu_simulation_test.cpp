// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/data/imu_simulation.hpp"

#include <catch2/catch.hpp>

#include "data/moving_body.hpp"

using namespace sweepkit;
using Vector = Vec3<double>;

namespace {

struct Navigated {
  SO3d R;
  Vector v, p;
};

// The method of Runge and Kutta of fourth order over pairs of intervals.
Navigated integrate(const std::vector<ImuSample>& samples, const MotionState& start, double gravity) {
  struct Rates {
    Eigen::Vector4d q;
    Vector v, p;
  };
  const auto rates = [&](const Eigen::Vector4d& q, const Vector& v, const ImuSample& s) {
    const Eigen::Quaterniond Q(q), w(0, s.gyro.x(), s.gyro.y(), s.gyro.z());
    return Rates{0.5 * (Q * w).coeffs(), Q.normalized() * s.accel - Vector(0, 0, gravity), v};
  };
  Eigen::Vector4d q = start.T_world_body.rotation().quaternion().coeffs();
  Vector v = start.velocity, p = start.T_world_body.translation();
  for (std::size_t i = 2; i < samples.size(); i += 2) {
    const double h = to_seconds(samples[i].t - samples[i - 2].t);
    const Rates a = rates(q, v, samples[i - 2]);
    const Rates b = rates(q + 0.5 * h * a.q, v + 0.5 * h * a.v, samples[i - 1]);
    const Rates c = rates(q + 0.5 * h * b.q, v + 0.5 * h * b.v, samples[i - 1]);
    const Rates d = rates(q + h * c.q, v + h * c.v, samples[i]);
    p += h / 6.0 * (a.p + 2.0 * b.p + 2.0 * c.p + d.p);
    v += h / 6.0 * (a.v + 2.0 * b.v + 2.0 * c.v + d.v);
    q = (q + h / 6.0 * (a.q + 2.0 * b.q + 2.0 * c.q + d.q)).normalized();
  }
  return {SO3d(Eigen::Quaterniond(q)), v, p};
}

}  // namespace

TEST_CASE("ideal readings at 2 kHz bring back the truth after a minute", "[imu_simulation]") {
  ImuSimulationOptions options;
  options.rate_hz = 2000;
  options.rotation_deg = {178, 3, -40};
  options = options.ideal();
  for (const bool flat : {true, false}) {
    const PoseSpline base = flat ? test::flat_drive(60.0) : test::tumble(60.0);
    const ImuStream stream = simulate_imu(base, 1'000'000'000, options, 1);
    REQUIRE(stream.samples.size() == 120001);
    const MotionState start = base.at(0).of(options.T_base_imu()),
                      end = base.at(60.0).of(options.T_base_imu());
    const Navigated n = integrate(stream.samples, start, options.gravity);
    const double position = (n.p - end.T_world_body.translation()).norm();
    const double angle = (n.R.inverse() * end.T_world_body.rotation()).angle() * 57.29577951308232;
    CAPTURE(flat, position, angle);
    CHECK(position < 1e-4);
    CHECK(angle < 0.001);
  }
}

TEST_CASE("at rest an inertial unit feels gravity upwards and no turn", "[imu_simulation]") {
  const PoseSpline rest(std::vector<SE3d>(200, SE3d(SO3d::exp({0, 0, 1}), {1, 2, 0})), 0.01);
  const ImuSimulationOptions options = ImuSimulationOptions().ideal();
  for (const ImuSample& s : simulate_imu(rest, 0, options, 1).samples) {
    CHECK((options.T_base_imu().rotation() * s.accel - Vector(0, 0, 9.81)).norm() < 1e-9);
    CHECK(s.gyro.norm() < 1e-9);
  }
}

TEST_CASE("noise and biases are as they were asked for", "[imu_simulation]") {
  const PoseSpline rest(std::vector<SE3d>(40001, SE3d()), 0.01);  // 400 s
  ImuSimulationOptions options;
  options.gyro_noise_density = 3e-4;
  options.accel_noise_density = 4e-3;
  options.gyro_random_walk = 5e-4;
  options.accel_random_walk = 2e-2;
  const ImuStream stream = simulate_imu(rest, 0, options, 7);
  const ImuStream clean = simulate_imu(rest, 0, options.ideal(), 7);
  const std::size_t n = stream.samples.size();
  REQUIRE(n == 80001);
  double gyro = 0, accel = 0, gyro_walk = 0, accel_walk = 0, neighbours = 0;
  for (std::size_t i = 0; i < n; ++i) {
    const Vector w = stream.samples[i].gyro - clean.samples[i].gyro - stream.gyro_bias[i];
    const Vector a = stream.samples[i].accel - clean.samples[i].accel - stream.accel_bias[i];
    gyro += w.squaredNorm() / 3.0;
    accel += a.squaredNorm() / 3.0;
    if (i + 1 == n) break;
    gyro_walk += (stream.gyro_bias[i + 1] - stream.gyro_bias[i]).squaredNorm() / 3.0;
    accel_walk += (stream.accel_bias[i + 1] - stream.accel_bias[i]).squaredNorm() / 3.0;
    neighbours +=
        w.dot(stream.samples[i + 1].gyro - clean.samples[i + 1].gyro - stream.gyro_bias[i + 1]) / 3.0;
  }
  const double count = static_cast<double>(n), rate = options.rate_hz;
  // The standard error of these is 0.2 %.
  CHECK(std::sqrt(gyro / count / rate) == Approx(3e-4).epsilon(0.01));
  CHECK(std::sqrt(accel / count / rate) == Approx(4e-3).epsilon(0.01));
  CHECK(std::sqrt(gyro_walk / count * rate) == Approx(5e-4).epsilon(0.01));
  CHECK(std::sqrt(accel_walk / count * rate) == Approx(2e-2).epsilon(0.01));
  CHECK(std::abs(neighbours / gyro) < 0.02);  // white

  double spread = 0;
  for (std::uint64_t seed = 0; seed < 300; ++seed) {
    const PoseSpline moment(std::vector<SE3d>(2, SE3d()), 0.01);
    spread += simulate_imu(moment, 0, options, seed).gyro_bias[0].squaredNorm() / 900.0;
  }
  CHECK(std::sqrt(spread) == Approx(options.gyro_bias_sigma).epsilon(0.1));
}

TEST_CASE("readings end at the limits and come in steps", "[imu_simulation]") {
  const PoseSpline base = test::tumble(5.0);
  ImuSimulationOptions options;
  options.gyro_limit = 0.5;
  options.accel_limit = 8.0;
  options.gyro_resolution = 0.01;
  bool met = false;
  for (const ImuSample& s : simulate_imu(base, 0, options, 1).samples) {
    CHECK(s.gyro.cwiseAbs().maxCoeff() <= 0.5);
    CHECK(s.accel.cwiseAbs().maxCoeff() <= 8.0);
    CHECK(std::abs(s.gyro.x() / 0.01 - std::round(s.gyro.x() / 0.01)) < 1e-9);
    met = met || s.accel.cwiseAbs().maxCoeff() == 8.0;
  }
  CHECK(met);
}

TEST_CASE("one seed gives one stream", "[imu_simulation]") {
  const PoseSpline base = test::tumble(2.0);
  const auto a = simulate_imu(base, 5, {}, 9), b = simulate_imu(base, 5, {}, 9),
             c = simulate_imu(base, 5, {}, 10);
  REQUIRE(a.samples.size() == b.samples.size());
  for (std::size_t i = 0; i < a.samples.size(); ++i) REQUIRE(a.samples[i].gyro == b.samples[i].gyro);
  CHECK(a.samples[3].gyro != c.samples[3].gyro);
  CHECK(a.samples[0].t == 5);
  CHECK(a.samples[1].t == 5'000'005);
}

TEST_CASE("impossible inertial units are refused", "[imu_simulation]") {
  const PoseSpline base = test::tumble(1.0);
  ImuSimulationOptions options;
  options.rate_hz = 0;
  CHECK_THROWS_AS(simulate_imu(base, 0, options, 1), Error);
  options = {};
  options.position = {1, 2};
  CHECK_THROWS_AS(simulate_imu(base, 0, options, 1), Error);
}
