// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/motion/navigation_filter.hpp"

#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <limits>
#include <numbers>
#include <tuple>
#include <type_traits>
#include <utility>
#include <vector>

#include "motion/drive_simulation.hpp"

using namespace sweepkit;
using sweepkit::test::DriveSimulation;

namespace {

using Place = NavigationState;
using Covariance = NavigationState::Covariance;
constexpr double kDegree = std::numbers::pi / 180;
constexpr int kSize = NavigationState::kSize;

Vec6<double> difference(const SE3d& a, const SE3d& b) { return (a.inverse() * b).log(); }

/// Finite, symmetric, and positive definite once each variable is measured in its own sigma.
void check_sound(const NavigationState& state) {
  const Covariance& P = state.covariance;
  REQUIRE(state.T_world_body.matrix().allFinite());
  REQUIRE(state.velocity.allFinite());
  REQUIRE(state.gyro_bias.allFinite());
  REQUIRE(state.accel_bias.allFinite());
  REQUIRE(state.wheel_scales.allFinite());
  REQUIRE(std::abs(state.up.norm() - 1) < 1e-9);
  REQUIRE(P.allFinite());
  REQUIRE(P.diagonal().minCoeff() > 0);
  const Eigen::Matrix<double, kSize, 1> s = P.diagonal().cwiseSqrt().cwiseInverse();
  const Covariance correlation = s.asDiagonal() * P * s.asDiagonal();
  REQUIRE((correlation - correlation.transpose()).cwiseAbs().maxCoeff() < 1e-9);
  const Eigen::SelfAdjointEigenSolver<Covariance> eigen(correlation);
  REQUIRE(eigen.eigenvalues().minCoeff() > -1e-9);
}

MotionSensors sensors_of(const DriveSimulation& sim, bool imu, bool wheels) {
  MotionSensors sensors;
  if (imu) {
    ImuNoise noise{.gyro_noise_density = std::max(sim.gyro_noise, 1e-5),
                   .gyro_random_walk = 0,
                   .accel_noise_density = std::max(sim.accel_noise, 1e-5),
                   .accel_random_walk = 0};
    sensors.imu = MountedImu{.T_body_imu = {}, .noise = noise, .rate_hz = 200};
  }
  if (wheels)
    sensors.wheels = MountedWheels{.T_body_base = sim.T_body_base, .geometry = sim.geometry, .rate_hz = 50};
  return sensors;
}

DriveSimulation perfect_drive() {
  DriveSimulation sim;
  sim.wheels = WheelParameters::nominal(sim.geometry);
  sim.gyro_bias.setZero();
  sim.accel_bias.setZero();
  sim.gyro_noise = sim.accel_noise = 0;
  sim.whole_ticks = false;
  return sim;
}

Vec3<double> up_in_body(const DriveSimulation& sim) {
  return sim.T_body_base.rotation() * Vec3<double>::UnitZ();
}

/// Feeds the drive in the order of its stamps; `visit` sees the filter after each sample of the IMU and each
/// check of the wheels.
template <class AfterImu, class AfterWheels>
void feed(NavigationFilter& filter, const DriveSimulation& sim, AfterImu after_imu,
          AfterWheels after_wheels) {
  std::size_t w = 0;
  for (std::size_t i = 0; i < sim.imu.size(); ++i) {
    if (filter.sensors().imu) filter.add(sim.imu[i]);
    for (; w < sim.ticks.size() && sim.ticks[w].t <= sim.imu[i].t; ++w)
      if (filter.sensors().wheels) after_wheels(sim.ticks[w].t, filter.add(sim.ticks[w]));
    // Two samples of the wheels make a step.
    if (filter.sensors().imu || w > 1) filter.advance(sim.imu[i].t);
    after_imu(i);
  }
}

/// A pose measured on its own, made into what vision hands over: the posterior with the filter as prior.
void see(NavigationFilter& filter, const SE3d& T_measured, const Mat6<double>& R) {
  const SE3d T = filter.state().T_world_body;
  const Mat6<double> P = filter.state().pose_covariance();
  const Mat6<double> K = P * (P + R).inverse();
  const Mat6<double> left = Mat6<double>::Identity() - K;
  filter.correct(T * SE3d::exp(K * difference(T, T_measured)),
                 left * P * left.transpose() + K * R * K.transpose());
}

}  // namespace

TEST_CASE("NavigationFilter follows constant rate and force from rest", "[navigation]") {
  const double a = 0.1, w = std::numbers::pi / 100;
  MotionSensors sensors;
  sensors.imu = MountedImu{};
  NavigationFilter filter(sensors);
  filter.start(0, SE3d(), Vec3<double>(0, 0, 9.81));
  const Vec3<double> turn(0, 0, w);
  for (int k = 0; k <= 1000; ++k) {
    filter.add({from_seconds(k * 0.005), turn, {a, 0, 9.81}});
    const double t = k * 0.005, angle = w * t;
    // R(t) a integrated once and twice.
    const Vec3<double> v = a / w * Vec3<double>(std::sin(angle), 1 - std::cos(angle), 0);
    const Vec3<double> p = a / (w * w) * Vec3<double>(1 - std::cos(angle), angle - std::sin(angle), 0);
    REQUIRE((filter.state().velocity - v).norm() < 1e-10);
    REQUIRE((filter.state().T_world_body.translation() - p).norm() < 1e-9);
    REQUIRE(difference(filter.state().T_world_body, SE3d(SO3d::exp(turn * t), p)).tail<3>().norm() < 1e-10);
    REQUIRE((filter.body_twist().tail<3>() - turn).norm() < 1e-12);
  }
  check_sound(filter.state());
}

TEST_CASE("NavigationFilter with wheels alone follows a constant twist", "[navigation]") {
  DriveSimulation sim = perfect_drive();
  sim.motion = [](double) { return Eigen::Vector2d(0.3, 0.7); };
  sim.run(4);
  NavigationFilter filter(sensors_of(sim, false, true));
  filter.start(0, sim.poses[0], std::nullopt);
  feed(
      filter, sim,
      [&](std::size_t i) {
        if (i < 4) return;  // until two samples of the wheels tell the twist
        // Between samples of the wheels the twist goes on.
        REQUIRE(difference(sim.poses[i], filter.state().T_world_body).norm() < 1e-8);
      },
      [&](TimeNs t, const WheelCheck& check) {
        if (t > 0) REQUIRE((check.usable && check.used));
        if (t > 0) REQUIRE(check.forward_speed == Approx(0.3));
      });
  Vec6<double> twist = Vec6<double>::Zero();
  twist[0] = 0.3;
  twist[5] = 0.7;
  CHECK((filter.body_twist() - sim.T_body_base.adjoint() * twist).norm() < 1e-8);
  CHECK((filter.state().velocity - filter.state().T_world_body.rotation() * filter.body_twist().head<3>())
            .norm() < 1e-8);
  check_sound(filter.state());
}

TEST_CASE("NavigationFilter follows a drive without noise, by each set of sensors", "[navigation]") {
  DriveSimulation sim = perfect_drive();
  sim.motion = test::cleaning_motion;
  sim.run(27);
  for (const auto& [imu, wheels, metres] :
       {std::tuple{true, false, 2e-3}, std::tuple{false, true, 1e-4}, std::tuple{true, true, 2e-4}}) {
    CAPTURE(imu, wheels);
    NavigationFilter filter(sensors_of(sim, imu, wheels));
    filter.start(0, sim.poses[0], Vec3<double>(9.81 * up_in_body(sim)));
    double worst = 0, angle = 0;
    bool all_used = true;
    feed(
        filter, sim,
        [&](std::size_t i) {
          if (sim.imu[i].t % from_seconds(0.02) != 0) return;
          const Vec6<double> error = difference(sim.poses[i], filter.state().T_world_body);
          worst = std::max(worst, error.head<3>().norm());
          angle = std::max(angle, error.tail<3>().norm());
        },
        [&](TimeNs t, const WheelCheck& check) { all_used = all_used && (t == 0 || check.used); });
    CHECK(worst < metres);
    CHECK(angle < 1e-4);
    CHECK(all_used);
    check_sound(filter.state());
  }
}

TEST_CASE("NavigationFilter's claims hold over many drives: IMU and a pose now and then", "[navigation]") {
  constexpr int kRuns = 100;
  NavigationOptions options;
  options.imu_noise_factor = 1;
  options.gyro_bias_sigma = 0.5;
  options.accel_bias_sigma = 0.05;
  options.start_speed_sigma = 0.01;
  options.start_accel_sigma = 0.03;
  options.up_walk = 0;
  double pose = 0, velocity = 0, gyro = 0, accel = 0;
  for (int run = 0; run < kRuns; ++run) {
    Random random(1000 + run);
    DriveSimulation sim;
    for (int i = 0; i < 3; ++i) sim.gyro_bias[i] = random.normal(0, options.gyro_bias_sigma * kDegree);
    for (int i = 0; i < 3; ++i) sim.accel_bias[i] = random.normal(0, options.accel_bias_sigma);
    sim.motion = [](double t) { return test::cleaning_motion(t + 1.5); };
    sim.run(6, 5000 + run);
    NavigationFilter filter(sensors_of(sim, true, false), options);
    Vec3<double> force = 9.81 * up_in_body(sim) + sim.accel_bias;
    for (int i = 0; i < 3; ++i) force[i] += random.normal(0, options.start_accel_sigma);
    filter.start(0, sim.poses[0], force);
    Vec6<double> sigma;
    sigma << Vec3<double>::Constant(0.004), Vec3<double>::Constant(0.002);
    for (std::size_t i = 0; i < sim.imu.size(); ++i) {
      filter.add(sim.imu[i]);
      if (i % 100 != 99) continue;
      Vec6<double> noise;
      for (int k = 0; k < 6; ++k) noise[k] = random.normal(0, sigma[k]);
      see(filter, sim.poses[i] * SE3d::exp(noise), Mat6<double>(sigma.cwiseAbs2().asDiagonal()));
    }
    const NavigationState& state = filter.state();
    check_sound(state);
    const std::size_t last = sim.imu.size() - 2;
    // At the last sample: the robot moves, and half a second has passed since it looked.
    Vec3<double> true_velocity = (sim.poses[last + 1].translation() - sim.poses[last].translation()) / 0.005;
    const Vec3<double> before = (sim.poses[last].translation() - sim.poses[last - 1].translation()) / 0.005;
    true_velocity += 0.5 * (true_velocity - before);
    const Vec6<double> e_pose = difference(state.T_world_body, sim.poses.back());
    const Vec3<double> e_velocity =
        state.T_world_body.rotation().inverse() * (true_velocity - state.velocity);
    const Vec3<double> e_gyro = sim.gyro_bias - state.gyro_bias, e_accel = sim.accel_bias - state.accel_bias;
    const auto nees = [&](const auto& e, int place) {
      constexpr int n = std::decay_t<decltype(e)>::RowsAtCompileTime;
      const Eigen::Matrix<double, n, n> P = state.covariance.template block<n, n>(place, place);
      return e.dot(P.ldlt().solve(e)) / kRuns;
    };
    pose += nees(e_pose, Place::kRho);
    velocity += nees(e_velocity, Place::kNu);
    gyro += nees(e_gyro, Place::kGyroBias);
    accel += nees(e_accel, Place::kAccelBias);
  }
  // Sums of chi-squares: standard deviation sqrt(2 n / runs), four of them.
  const auto within = [&](double mean, int n) {
    CAPTURE(mean, n);
    CHECK(std::abs(mean - n) < 4 * std::sqrt(2.0 * n / kRuns));
  };
  within(pose, 6);
  within(velocity, 3);
  within(gyro, 3);
  within(accel, 3);
}

TEST_CASE("NavigationFilter's claims hold over many drives: wheels too, and what they measure",
          "[navigation]") {
  constexpr int kRuns = 60;
  NavigationOptions options;
  options.imu_noise_factor = 1;
  options.gyro_bias_sigma = 0.5;
  options.accel_bias_sigma = 0.05;
  options.start_speed_sigma = 0.01;
  options.start_accel_sigma = 0.03;
  options.up_walk = 0;
  options.radius_walk = 0;
  options.wheel_noise_share = 0;
  options.lateral_noise = options.vertical_noise = 3e-4;  // the truth does neither
  double pose = 0, scales = 0, worst = 0;
  for (int run = 0; run < kRuns; ++run) {
    Random random(2000 + run);
    DriveSimulation sim;
    for (int i = 0; i < 3; ++i) sim.gyro_bias[i] = random.normal(0, options.gyro_bias_sigma * kDegree);
    for (int i = 0; i < 3; ++i) sim.accel_bias[i] = random.normal(0, options.accel_bias_sigma);
    Vec3<double> truth;
    for (int i = 0; i < 3; ++i)
      truth[i] = random.normal(0, i < 2 ? options.radius_sigma : options.track_sigma);
    sim.wheels = {std::exp(truth[0]), std::exp(truth[1]), sim.geometry.track_width * std::exp(truth[2])};
    sim.whole_ticks = false;
    sim.motion = [](double t) { return test::cleaning_motion(t + 1.5); };
    sim.run(10, 7000 + run);
    NavigationFilter filter(sensors_of(sim, true, true), options);
    Vec3<double> force = 9.81 * up_in_body(sim) + sim.accel_bias;
    for (int i = 0; i < 3; ++i) force[i] += random.normal(0, options.start_accel_sigma);
    filter.start(0, sim.poses[0], force);
    Vec6<double> sigma;
    sigma << Vec3<double>::Constant(0.004), Vec3<double>::Constant(0.002);
    const double per_metre = 1 / sim.geometry.metres_per_tick();
    std::size_t w = 0;
    for (std::size_t i = 0; i < sim.imu.size(); ++i) {
      filter.add(sim.imu[i]);
      if (w < sim.ticks.size() && sim.ticks[w].t == sim.imu[i].t) {
        // Speeds with white noise, as the filter has it.
        if (w > 0) {
          const double dt = to_seconds(sim.ticks[w].t - sim.ticks[w - 1].t);
          WheelSample s{sim.ticks[w].t, WheelReading::speeds};
          s.left = (sim.ticks[w].left - sim.ticks[w - 1].left) / per_metre / dt +
                   random.normal(0, options.wheel_noise);
          s.right = (sim.ticks[w].right - sim.ticks[w - 1].right) / per_metre / dt +
                    random.normal(0, options.wheel_noise);
          filter.add(s);
        }
        ++w;
      }
      if (i % 100 != 99) continue;
      Vec6<double> noise;
      for (int k = 0; k < 6; ++k) noise[k] = random.normal(0, sigma[k]);
      see(filter, sim.poses[i] * SE3d::exp(noise), Mat6<double>(sigma.cwiseAbs2().asDiagonal()));
    }
    const NavigationState& state = filter.state();
    check_sound(state);
    const Vec6<double> e_pose = difference(state.T_world_body, sim.poses.back());
    const Mat6<double> P = state.pose_covariance();
    pose += e_pose.dot(P.ldlt().solve(e_pose)) / kRuns;
    const Vec3<double> e = truth - state.wheel_scales;
    const Mat3<double> Q = state.covariance.block<3, 3>(Place::kWheels, Place::kWheels);
    scales += e.dot(Q.ldlt().solve(e)) / kRuns;
    for (int k = 0; k < 3; ++k) worst = std::max(worst, std::abs(e[k]) / std::sqrt(Q(k, k)));
    CHECK(Q.diagonal().cwiseSqrt().maxCoeff() < 0.01);
    CHECK((filter.wheel_measures() - Vec3<double>(0.035 * sim.wheels.scale_left,
                                                  0.035 * sim.wheels.scale_right, sim.wheels.track_width))
              .norm() < 0.01);
  }
  CAPTURE(pose, scales, worst);
  CHECK(pose > 0.5 * 6);
  CHECK(pose < 2 * 6);
  CHECK(std::abs(scales - 3) < 4 * std::sqrt(6.0 / kRuns));
  CHECK(worst < 4.5);
}

TEST_CASE("NavigationFilter::correct is a Kalman update with a measured pose", "[navigation]") {
  DriveSimulation sim;
  sim.motion = test::cleaning_motion;
  sim.run(4);
  NavigationFilter filter(sensors_of(sim, true, true));
  filter.start(0, sim.poses[0], Vec3<double>(9.81 * up_in_body(sim)));
  feed(
      filter, sim, [](std::size_t) {}, [](TimeNs, const WheelCheck&) {});
  const NavigationState before = filter.state();
  Vec6<double> innovation;
  innovation << 0.002, -0.003, 0.001, 0.001, 0.0005, -0.002;
  Mat6<double> A;
  for (int i = 0; i < 36; ++i) A(i) = std::sin(1.0 + i);
  const Mat6<double> R = 1e-5 * (A * A.transpose() + Mat6<double>::Identity());

  Eigen::Matrix<double, 6, kSize> H = Eigen::Matrix<double, 6, kSize>::Zero();
  H.leftCols<6>().setIdentity();
  const Covariance& P = before.covariance;
  const Eigen::Matrix<double, kSize, 6> K = P * H.transpose() * (H * P * H.transpose() + R).inverse();
  const Covariance left = Covariance::Identity() - K * H;
  const Covariance expected = left * P * left.transpose() + K * R * K.transpose();
  const Eigen::Matrix<double, kSize, 1> error = K * innovation;

  see(filter, before.T_world_body * SE3d::exp(innovation), R);
  const NavigationState& after = filter.state();
  CHECK(difference(before.T_world_body * SE3d::exp(error.head<6>()), after.T_world_body).norm() < 1e-10);
  CHECK((after.velocity - before.velocity -
         before.T_world_body.rotation() * error.segment<3>(Place::kNu).eval())
            .norm() < 1e-9);
  CHECK((after.gyro_bias - before.gyro_bias - error.segment<3>(Place::kGyroBias)).norm() < 1e-10);
  CHECK((after.accel_bias - before.accel_bias - error.segment<3>(Place::kAccelBias)).norm() < 1e-9);
  CHECK((after.wheel_scales - before.wheel_scales - error.segment<3>(Place::kWheels)).norm() < 1e-10);
  CHECK((after.up - before.up).norm() ==
        Approx(error.segment<2>(Place::kUp).norm()).epsilon(1e-3).margin(1e-12));
  const Eigen::Matrix<double, kSize, 1> s = expected.diagonal().cwiseSqrt().cwiseInverse();
  CHECK((s.asDiagonal() * (after.covariance - expected) * s.asDiagonal()).cwiseAbs().maxCoeff() < 1e-6);
  // It did learn of what was not measured.
  CHECK(after.covariance(Place::kNu, Place::kNu) < before.covariance(Place::kNu, Place::kNu));
}

TEST_CASE("NavigationFilter lives in any world", "[navigation]") {
  DriveSimulation sim;
  sim.motion = [](double t) { return test::cleaning_motion(t + 1.5); };
  sim.run(6);
  const SE3d T_new_old(SO3d::exp({0.4, -1.9, 0.8}), {3, -2, 1});
  NavigationFilter moved(sensors_of(sim, true, true)), stayed = moved;
  for (NavigationFilter* filter : {&moved, &stayed})
    filter->start(0, sim.poses[0], Vec3<double>(9.81 * up_in_body(sim)));
  std::size_t w = 0;
  const auto same = [&] {
    const NavigationState &a = moved.state(), &b = stayed.state();
    CHECK(difference(a.T_world_body, T_new_old * b.T_world_body).norm() < 1e-9);
    CHECK((a.velocity - T_new_old.rotation() * b.velocity).norm() < 1e-9);
    CHECK((a.up - T_new_old.rotation() * b.up).norm() < 1e-9);
    CHECK((a.gyro_bias - b.gyro_bias).norm() < 1e-9);
    CHECK((a.accel_bias - b.accel_bias).norm() < 1e-9);
    CHECK((a.wheel_scales - b.wheel_scales).norm() < 1e-9);
    CHECK((moved.body_twist() - stayed.body_twist()).norm() < 1e-9);
    // All but the axes that the vertical's error is told in.
    Covariance A = a.covariance, B = b.covariance;
    CHECK(A.block<2, 2>(Place::kUp, Place::kUp).trace() ==
          Approx(B.block<2, 2>(Place::kUp, Place::kUp).trace()));
    CHECK(A.block<2, 2>(Place::kUp, Place::kUp).determinant() ==
          Approx(B.block<2, 2>(Place::kUp, Place::kUp).determinant()));
    const Eigen::Matrix<double, kSize, 2> a_up = A.middleCols<2>(Place::kUp),
                                          b_up = B.middleCols<2>(Place::kUp);
    for (int k = 0; k < Place::kUp; ++k)
      CHECK(a_up.row(k).norm() == Approx(b_up.row(k).norm()).epsilon(1e-5).margin(1e-10));
    for (Covariance* P : {&A, &B}) {
      P->middleCols<2>(Place::kUp).setZero();
      P->middleRows<2>(Place::kUp).setZero();
    }
    const Eigen::Matrix<double, kSize, 1> s = b.covariance.diagonal().cwiseSqrt().cwiseInverse();
    CHECK((s.asDiagonal() * (A - B) * s.asDiagonal()).cwiseAbs().maxCoeff() < 1e-6);
  };
  for (std::size_t i = 0; i < sim.imu.size(); ++i) {
    for (NavigationFilter* filter : {&moved, &stayed}) {
      filter->add(sim.imu[i]);
      if (sim.ticks[w].t == sim.imu[i].t) filter->add(sim.ticks[w]);
    }
    if (sim.ticks[w].t == sim.imu[i].t && w + 1 < sim.ticks.size()) ++w;
    if (i == sim.imu.size() / 2) {
      moved.move_world(T_new_old);
      same();
    }
  }
  see(stayed, sim.poses.back(), 1e-5 * Mat6<double>::Identity());
  see(moved, T_new_old * sim.poses.back(), 1e-5 * Mat6<double>::Identity());
  same();
}

TEST_CASE("NavigationFilter finds the gyro's bias and stops at a standstill", "[navigation]") {
  for (std::uint64_t seed = 1; seed <= 20; ++seed) {
    DriveSimulation sim;
    sim.motion = [](double) { return Eigen::Vector2d(0, 0); };
    sim.run(2, seed);
    NavigationOptions options;
    NavigationFilter filter(sensors_of(sim, true, false), options);
    filter.start(0, sim.poses[0], Vec3<double>(9.81 * up_in_body(sim) + sim.accel_bias));
    Vec3<double> sum = Vec3<double>::Zero();
    for (const ImuSample& s : sim.imu) {
      filter.add(s);
      sum += s.gyro;
    }
    const SE3d T_before = filter.state().T_world_body;
    filter.stand_still(sum / static_cast<double>(sim.imu.size()), 2);
    const NavigationState& state = filter.state();
    check_sound(state);
    const double bound = options.imu_noise_factor * sim.gyro_noise / std::sqrt(2.0);
    for (int k = 0; k < 3; ++k) {
      const double sigma = std::sqrt(state.covariance(Place::kGyroBias + k, Place::kGyroBias + k));
      CHECK(sigma <= 1.001 * bound);
      CHECK(sigma > 0.5 * bound);
      CHECK(std::abs(state.gyro_bias[k] - sim.gyro_bias[k]) < 4 * sigma);
      CHECK(std::abs(state.velocity[k]) < 3 * options.stop_noise);
    }
    // What it turned by the bias meanwhile is taken back, most of it.
    CHECK(difference(state.T_world_body, sim.poses.back()).tail<3>().norm() <
          0.2 * difference(T_before, sim.poses.back()).tail<3>().norm());
  }
}

TEST_CASE("NavigationFilter measures the wheels while it drives and looks", "[navigation]") {
  const double kNominal = 0.035;
  for (std::uint64_t seed = 1; seed <= 4; ++seed) {
    DriveSimulation sim;
    sim.wheels = {1.02, 0.98, 0.235 * 1.02};
    sim.wheel_noise = 0.001;
    sim.motion = [](double t) { return test::cleaning_motion(std::fmod(t, 27.0)); };
    sim.run(54, seed);
    NavigationFilter filter(sensors_of(sim, true, true));
    filter.start(0, sim.poses[0], Vec3<double>(9.81 * up_in_body(sim) + sim.accel_bias));
    Random random(seed);
    std::vector<double> refused;
    feed(
        filter, sim,
        [&](std::size_t i) {
          if (i % 20 != 19) return;
          Vec6<double> noise;
          for (int k = 0; k < 6; ++k) noise[k] = random.normal(0, 0.001);
          see(filter, sim.poses[i] * SE3d::exp(noise), 1e-6 * Mat6<double>::Identity());
        },
        [&](TimeNs t, const WheelCheck& check) {
          if (!check.used) refused.push_back(to_seconds(t));
        });
    const NavigationState& state = filter.state();
    check_sound(state);
    const Vec3<double> truth(std::log(1.02), std::log(0.98), std::log(1.02));
    for (int k = 0; k < 3; ++k) {
      const double sigma = std::sqrt(state.covariance(Place::kWheels + k, Place::kWheels + k));
      CAPTURE(k, sigma, state.wheel_scales[k], truth[k]);
      CHECK(sigma < 0.005);
      CHECK(std::abs(state.wheel_scales[k] - truth[k]) < 3 * sigma);
    }
    const Vec3<double> measures = filter.wheel_measures();
    CHECK(std::abs(measures[0] / (1.02 * kNominal) - 1) < 0.003);
    CHECK(std::abs(measures[1] / (0.98 * kNominal) - 1) < 0.003);
    CHECK(std::abs(measures[2] / (1.02 * 0.235) - 1) < 0.01);
    CHECK(refused.size() < 5);  // the first sample has none before it
  }
}

TEST_CASE("NavigationFilter does not believe wheels that slip", "[navigation]") {
  for (const Eigen::Vector2d& slide : {Eigen::Vector2d(0.2, 0.2), Eigen::Vector2d(0.25, -0.25),
                                       Eigen::Vector2d(0, 0.15), Eigen::Vector2d(-0.3, -0.3)}) {
    CAPTURE(slide.transpose());
    DriveSimulation sim;
    sim.motion = test::cleaning_motion;
    sim.slip = [&](double t) { return t > 4 && t < 6 ? slide : Eigen::Vector2d(0, 0); };
    sim.run(7);
    NavigationFilter filter(sensors_of(sim, true, true));
    filter.start(0, sim.poses[0], Vec3<double>(9.81 * up_in_body(sim) + sim.accel_bias));
    int refused = 0, slipping = 0, wrong = 0;
    feed(
        filter, sim,
        [&](std::size_t i) {
          if (i % 100 == 99 && i <= 800) see(filter, sim.poses[i], 1e-6 * Mat6<double>::Identity());
        },
        [&](TimeNs t, const WheelCheck& check) {
          const double s = to_seconds(t);
          if (s > 4.03 && s < 5.99) {
            ++slipping;
            refused += !check.used;
          } else if (s > 0 && !check.used) {
            ++wrong;
          }
        });
    CHECK(refused > 0.95 * slipping);
    CHECK(wrong <= 3);
    const Vec6<double> error = difference(filter.state().T_world_body, sim.poses.back());
    CAPTURE(error.transpose());
    // By the wheels it would be 30 cm and more, or 2 rad.
    CHECK(error.head<3>().norm() < 0.04);
    CHECK(error.tail<3>().norm() < 0.01);
    check_sound(filter.state());
  }
}

TEST_CASE("NavigationFilter knows the vertical as well as the accelerometer allows", "[navigation]") {
  Random random(3);
  NavigationOptions options;
  double sum = 0;
  constexpr int kDraws = 400;
  MotionSensors sensors;
  sensors.imu = MountedImu{};
  for (int draw = 0; draw < kDraws; ++draw) {
    const SO3d R_world_body =
        SO3d::exp({random.normal(0, 1.0), random.normal(0, 1.0), random.normal(0, 1.0)});
    Vec3<double> force = R_world_body.inverse() * Vec3<double>(0, 0, options.gravity);
    for (int k = 0; k < 3; ++k)
      force[k] += random.normal(0, options.accel_bias_sigma) + random.normal(0, options.start_accel_sigma);
    NavigationFilter filter(sensors, options);
    filter.start(0, SE3d(R_world_body, {1, 2, 3}), force);
    const NavigationState& state = filter.state();
    check_sound(state);
    const Eigen::Matrix2d P = state.covariance.block<2, 2>(Place::kUp, Place::kUp);
    // Alike in all directions, so that its axes do not matter.
    REQUIRE(std::abs(P(0, 0) - P(1, 1)) < 1e-6 * P(0, 0));
    REQUIRE(std::abs(P(0, 1)) < 1e-6 * P(0, 0));
    const double angle = std::acos(std::min(1.0, state.up.z()));
    sum += angle * angle / P(0, 0) / kDraws;
  }
  CHECK(std::abs(sum - 2) < 4 * std::sqrt(4.0 / kDraws));

  // At rest the accelerometer's bias and the vertical cannot be told apart; upside down and back they can.
  const Vec3<double> bias(0.1, -0.08, 0.05);
  NavigationFilter filter(sensors, options);
  filter.start(0, SE3d(), Vec3<double>(Vec3<double>(0, 0, 9.81) + bias));
  const auto sigma = [&] {
    return std::sqrt(filter.state().covariance.block<2, 2>(Place::kUp, Place::kUp).trace() / 2);
  };
  const double at_start = sigma();
  double t = 0;
  SO3d R_before;
  const auto turn_over = [&](const Vec3<double>& rate, double seconds) {
    const double begin = t;
    for (; t < begin + seconds - 1e-9; t += 0.005) {
      const SE3d T(R_before * SO3d::exp(rate * (t - begin)), Vec3<double>::Zero());
      filter.add({from_seconds(t), rate, T.rotation().inverse() * Vec3<double>(0, 0, 9.81) + bias});
      if (std::lround(t * 200) % 20 == 19) see(filter, T, 1e-7 * Mat6<double>::Identity());
    }
    R_before = R_before * SO3d::exp(rate * seconds);
  };
  turn_over({0, 0, 0}, 3);
  CHECK(sigma() > 0.5 * at_start);
  turn_over({0.5, 0, 0}, 6);
  turn_over({0, 0.5, 0}, 6);
  CHECK(sigma() < 0.3 * at_start);
  CHECK((filter.state().accel_bias - bias).norm() < 0.03);
  CHECK(std::acos(std::min(1.0, filter.state().up.z())) < 3.5 * sigma());
}

TEST_CASE("NavigationFilter tells what it does not know after a silence", "[navigation]") {
  DriveSimulation sim = perfect_drive();
  // Turns and stops while nobody speaks.
  sim.motion = [](double t) {
    const double x = std::clamp(t - 3, 0.0, 1.0), s = x * x * (3 - 2 * x);
    return Eigen::Vector2d(0.25 - 0.15 * s, 0.6 * s);
  };
  sim.run(6);
  for (const auto& [imu, wheels] : {std::pair{true, false}, std::pair{false, true}, std::pair{true, true}}) {
    CAPTURE(imu, wheels);
    NavigationFilter filter(sensors_of(sim, imu, wheels));
    filter.start(0, sim.poses[0], Vec3<double>(9.81 * up_in_body(sim)));
    bool told = false;
    std::size_t w = 0;
    for (std::size_t i = 0; i < sim.imu.size(); ++i) {
      const double t = to_seconds(sim.imu[i].t);
      const bool silent = t > 3 && t < 4.5;
      if (imu && !silent) told = !filter.add(sim.imu[i]) || told;
      if (wheels && w < sim.ticks.size() && sim.ticks[w].t == sim.imu[i].t) {
        if (!silent) filter.add(sim.ticks[w]);
        ++w;
      }
      // Images go on.
      if (i % 20 == 0) filter.advance(sim.imu[i].t);
      if (i % 20 == 0 && t < 3) see(filter, sim.poses[i], 1e-6 * Mat6<double>::Identity());
      if (i % 20 == 0 && t >= 3.4 && t < 5) {
        check_sound(filter.state());
        const Vec6<double> e = difference(filter.state().T_world_body, sim.poses[i]);
        const Mat6<double> P = filter.state().pose_covariance();
        // Once wheels speak again, sideways motion is judged by a heading that is not known to within what
        // can be taken as straight: only the place keeps its claim until the robot looks.
        const double nees = silent ? e.dot(P.ldlt().solve(e))
                                   : e.head<3>().dot(P.topLeftCorner<3, 3>().ldlt().solve(e.head<3>()));
        CAPTURE(t, e.transpose(), P.diagonal().cwiseSqrt().transpose(), nees);
        CHECK(nees < 20);
      }
    }
    CHECK(told == imu);
  }
}

TEST_CASE("NavigationFilter never breaks", "[navigation]") {
  DriveSimulation sim;
  sim.motion = test::cleaning_motion;
  sim.run(6);
  const double inf = std::numeric_limits<double>::max();
  for (const auto& [imu, wheels] : {std::pair{true, false}, std::pair{false, true}, std::pair{true, true}})
    for (std::uint64_t seed = 1; seed <= 5; ++seed) {
      CAPTURE(imu, wheels, seed);
      Random random(seed);
      NavigationFilter filter(sensors_of(sim, imu, wheels));
      filter.start(0, sim.poses[0], Vec3<double>(9.81 * up_in_body(sim)));
      TimeNs shift = 0;
      double offset = 0;
      std::size_t w = 0;
      for (std::size_t i = 0; i < sim.imu.size(); ++i) {
        ImuSample s = sim.imu[i];
        s.t += shift;
        const double luck = random.uniform();
        if (luck < 0.002) shift += from_seconds(2.0), s.t += from_seconds(2.0);  // silence
        if (luck > 0.002 && luck < 0.004) s.t -= from_seconds(0.5);              // backwards
        if (luck > 0.004 && luck < 0.006) s.gyro *= 1e4;
        if (luck > 0.006 && luck < 0.008) s.accel = Vec3<double>(1e4, -1e4, 1e4);
        if (luck > 0.008 && luck < 0.010) s.gyro.setConstant(35);
        filter.add(s);
        if (w < sim.ticks.size() && sim.ticks[w].t <= sim.imu[i].t) {
          WheelSample tick = sim.ticks[w++];
          tick.t += shift;
          const double ill = random.uniform();
          if (ill < 0.01) offset = -tick.left;             // counters begin anew
          if (ill > 0.01 && ill < 0.02) offset -= 0x1p16;  // or wrap
          if (ill > 0.02 && ill < 0.03) tick.t -= from_seconds(0.3);
          if (ill > 0.03 && ill < 0.04) tick.left = 1e15;
          if (ill > 0.04 && ill < 0.05) tick.right = -inf;
          if (ill > 0.05 && ill < 0.06) tick = {tick.t, WheelReading::speeds, 1e6, -1e6};
          tick.left += offset;
          tick.right += offset;
          filter.add(tick);
        }
        filter.advance(s.t);
        if (i % 10 == 0) check_sound(filter.state());
        if (i % 40 == 0) see(filter, sim.poses[i], 1e-6 * Mat6<double>::Identity());
        if (i % 200 == 0) filter.stand_still(sim.gyro_bias, 0.3);
      }
      check_sound(filter.state());
      filter.correct(sim.poses.back(), 1e-6 * Mat6<double>::Identity());
      CHECK(difference(filter.state().T_world_body, sim.poses.back()).norm() < 1e-9);
      check_sound(filter.state());
    }
}

TEST_CASE("NavigationFilter refuses wheels that cannot be", "[navigation]") {
  MotionSensors sensors;
  sensors.wheels = MountedWheels{};
  sensors.wheels->geometry.track_width = 0;
  CHECK_THROWS_AS(NavigationFilter(sensors), Error);
  sensors.wheels->geometry = {0, 0.1, 0.2};
  CHECK_THROWS_AS(NavigationFilter(sensors), Error);
  NavigationOptions options;
  options.wheel_gate = -1;
  CHECK_THROWS_AS(NavigationFilter(MotionSensors{}, options), Error);
}
