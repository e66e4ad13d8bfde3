// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
// Integrators, IMU preintegration and the gyro bias, beside what one would write from the textbook. Times of
// preintegration are for one second at 200 Hz; the counter sample is what one sample costs, flops what it
// needs, counted by hand, and bound_ns that over 4 flops a cycle (two units of two doubles, SSE2) at 3 GHz.
#include <benchmark/benchmark.h>

#include <cmath>
#include <vector>

#include "sweepkit/core/random.hpp"
#include "sweepkit/motion/gyro_bias.hpp"
#include "sweepkit/motion/imu_preintegration.hpp"
#include "sweepkit/motion/integrators.hpp"
#include "sweepkit/motion/standstill.hpp"
#include "sweepkit/motion/wheel_odometry.hpp"

namespace sweepkit {
namespace {

constexpr ImuNoise kNoise{2e-4, 2e-5, 2e-3, 3e-3};

std::vector<ImuSample> make_samples(double seconds) {
  Random random(1);
  std::vector<ImuSample> samples;
  for (int k = 0; k <= static_cast<int>(seconds * 200); ++k) {
    const double t = 0.005 * k;
    samples.push_back({from_seconds(t),
                       {0.8 * std::sin(3 * t), 0.6 * std::cos(5 * t + 1), 1.1 * std::sin(2 * t + 0.3)},
                       {1.5 * std::cos(4 * t), -2 * std::sin(3 * t + 0.2), 9.81 + std::sin(6 * t)}});
  }
  return samples;
}

void count(benchmark::State& state, double samples, double flops) {
  const double total = static_cast<double>(state.iterations()) * samples;
  state.counters["sample"] =
      benchmark::Counter(total, benchmark::Counter::kIsRate | benchmark::Counter::kInvert);
  if (flops > 0) {
    state.counters["flops"] = flops;
    state.counters["bound_ns"] = flops / (4 * 3.0);
  }
}

// Rotation from the quaternion 30, its product and norm 50, R J1, R J2 and their parts 130, the derivatives
// 190, crossed columns and sums 130, covariance 150, the step itself 60.
template <class Rule>
void preintegrate_sweepkit(benchmark::State& state) {
  const auto samples = make_samples(1.0);
  for (auto _ : state) {
    auto delta = preintegrate<Rule>(samples, 0, kNsPerSecond, {}, kNoise);
    benchmark::DoNotOptimize(delta);
  }
  count(state, 200, 740);
}
BENCHMARK_TEMPLATE(preintegrate_sweepkit, MidpointRule)->Name("motion/preintegrate/sweepkit_midpoint");
BENCHMARK_TEMPLATE(preintegrate_sweepkit, ClosedFormRule)->Name("motion/preintegrate/sweepkit");
BENCHMARK_TEMPLATE(preintegrate_sweepkit, CubicRule)->Name("motion/preintegrate/sweepkit_cubic");

// As Forster et al. write it: Euler steps, 9 x 9 matrices for the covariance, derivatives block by block.
void preintegrate_euler(benchmark::State& state) {
  using Mat9 = Eigen::Matrix<double, 9, 9>;
  const auto samples = make_samples(1.0);
  for (auto _ : state) {
    Mat3<double> R = Mat3<double>::Identity(), R_g = Mat3<double>::Zero(), v_g = R_g, v_a = R_g, p_g = R_g,
                 p_a = R_g;
    Vec3<double> v = Vec3<double>::Zero(), p = v;
    Mat9 P = Mat9::Zero();
    for (std::size_t k = 0; k + 1 < samples.size(); ++k) {
      const double dt = to_seconds(samples[k + 1].t - samples[k].t);
      const Vec3<double>&a = samples[k].accel, phi = samples[k].gyro * dt;
      const Mat3<double> dR = SO3d::exp(phi).matrix(), J = SO3d::right_jacobian(phi), A = SO3d::hat(a);
      Mat9 F = Mat9::Identity();
      F.block<3, 3>(0, 0) = dR.transpose();
      F.block<3, 3>(3, 0) = -R * A * dt;
      F.block<3, 3>(6, 0) = -0.5 * R * A * dt * dt;
      F.block<3, 3>(6, 3) = dt * Mat3<double>::Identity();
      Eigen::Matrix<double, 9, 6> B = Eigen::Matrix<double, 9, 6>::Zero();
      B.block<3, 3>(0, 0) = J * dt;
      B.block<3, 3>(3, 3) = R * dt;
      B.block<3, 3>(6, 3) = 0.5 * R * dt * dt;
      Eigen::Matrix<double, 6, 1> noise;
      noise << Vec3<double>::Constant(kNoise.gyro_noise_density * kNoise.gyro_noise_density / dt),
          Vec3<double>::Constant(kNoise.accel_noise_density * kNoise.accel_noise_density / dt);
      P = F * P * F.transpose() + B * noise.asDiagonal() * B.transpose();
      p += v * dt + 0.5 * R * a * dt * dt;
      v += R * a * dt;
      p_a += v_a * dt - 0.5 * R * dt * dt;
      p_g += v_g * dt - 0.5 * R * A * R_g * dt * dt;
      v_a -= R * dt;
      v_g -= R * A * R_g * dt;
      R_g = dR.transpose() * R_g - J * dt;
      R = R * dR;
    }
    benchmark::DoNotOptimize(P);
    benchmark::DoNotOptimize(p);
    benchmark::DoNotOptimize(p_g);
  }
  count(state, 200, 0);
}
BENCHMARK(preintegrate_euler)->Name("motion/preintegrate/euler_9x9");

// Midpoint steps with dense 15 x 15 matrices for covariance and derivatives, as VINS-Mono's paper has it.
void preintegrate_dense(benchmark::State& state) {
  using Mat15 = Eigen::Matrix<double, 15, 15>;
  const auto samples = make_samples(1.0);
  for (auto _ : state) {
    SO3d R;
    Vec3<double> v = Vec3<double>::Zero(), p = v;
    Mat15 P = Mat15::Zero(), J = Mat15::Identity();
    for (std::size_t k = 0; k + 1 < samples.size(); ++k) {
      const double dt = to_seconds(samples[k + 1].t - samples[k].t);
      const Vec3<double> w = 0.5 * (samples[k].gyro + samples[k + 1].gyro);
      const SO3d next = R * SO3d::exp(w * dt);
      const Mat3<double> R0 = R.matrix(), R1 = next.matrix(), I = Mat3<double>::Identity();
      const Mat3<double> A0 = SO3d::hat(samples[k].accel), A1 = SO3d::hat(samples[k + 1].accel);
      const Mat3<double> turned = R1 * A1 * (I - SO3d::hat(w) * dt);
      Mat15 F = Mat15::Identity();  // p, theta, v, accelerometer bias, gyro bias
      F.block<3, 3>(0, 3) = -0.25 * (R0 * A0 + turned) * dt * dt;
      F.block<3, 3>(0, 6) = I * dt;
      F.block<3, 3>(0, 9) = -0.25 * (R0 + R1) * dt * dt;
      F.block<3, 3>(0, 12) = 0.25 * R1 * A1 * dt * dt * dt;
      F.block<3, 3>(3, 3) = I - SO3d::hat(w) * dt;
      F.block<3, 3>(3, 12) = -I * dt;
      F.block<3, 3>(6, 3) = -0.5 * (R0 * A0 + turned) * dt;
      F.block<3, 3>(6, 9) = -0.5 * (R0 + R1) * dt;
      F.block<3, 3>(6, 12) = 0.5 * R1 * A1 * dt * dt;
      Eigen::Matrix<double, 15, 12> V = Eigen::Matrix<double, 15, 12>::Zero();
      V.block<3, 3>(0, 0) = 0.5 * R0 * dt * dt;
      V.block<3, 3>(3, 3) = I * dt;
      V.block<3, 3>(6, 0) = R0 * dt;
      V.block<3, 3>(9, 6) = I * dt;
      V.block<3, 3>(12, 9) = I * dt;
      Eigen::Matrix<double, 12, 1> noise;
      noise << Vec3<double>::Constant(kNoise.accel_noise_density),
          Vec3<double>::Constant(kNoise.gyro_noise_density), Vec3<double>::Constant(kNoise.accel_random_walk),
          Vec3<double>::Constant(kNoise.gyro_random_walk);
      J = F * J;
      P = F * P * F.transpose() + V * (noise.cwiseAbs2() / dt).asDiagonal() * V.transpose();
      const Vec3<double> a = 0.5 * (R * samples[k].accel + next * samples[k + 1].accel);
      p += v * dt + 0.5 * a * dt * dt;
      v += a * dt;
      R = next;
    }
    benchmark::DoNotOptimize(P);
    benchmark::DoNotOptimize(J);
    benchmark::DoNotOptimize(p);
  }
  count(state, 200, 0);
}
BENCHMARK(preintegrate_dense)->Name("motion/preintegrate/dense_15x15");

// Sine and cosine 40 each, quaternions 30, the translation 45 at most.
template <class I>
void integrate(benchmark::State& state) {
  Random random(2);
  std::vector<double> times{0};
  std::vector<Vec6<double>> rates;
  for (int k = 0; k < 1000; ++k) {
    times.push_back(times.back() + 0.02);
    Vec6<double> rate = Vec6<double>::Zero();
    rate[0] = random.uniform(0, 0.3);
    rate[4] = random.normal(0, 0.02);
    rate[5] = random.normal(0, 0.5);
    rates.push_back(rate);
  }
  std::vector<SE3d> poses(times.size());
  for (auto _ : state) {
    integrate_path<I, double>(times, rates, SE3d(), poses);
    benchmark::DoNotOptimize(poses.data());
  }
  count(state, 1000, 185);
}
BENCHMARK_TEMPLATE(integrate, EulerIntegrator)->Name("motion/integrate/euler");
BENCHMARK_TEMPLATE(integrate, MidpointIntegrator)->Name("motion/integrate/midpoint");
BENCHMARK_TEMPLATE(integrate, ClosedFormIntegrator)->Name("motion/integrate/closed_form");

// Ten keyframes half a second apart: 900 samples. The bound counts 190 flops a sample, and nothing for the
// solve.
void solve_bias(benchmark::State& state) {
  const auto samples = make_samples(4.6);
  std::vector<SO3d> attitudes(10);
  for (int k = 0; k < 9; ++k)
    attitudes[k + 1] = attitudes[k] * integrate_gyro(samples, k * kNsPerSecond / 2,
                                                     (k + 1) * kNsPerSecond / 2, {0.004, -0.02, 0.07}, kNoise)
                                          ->R;
  Vec3<double> bias = Vec3<double>::Zero();
  std::vector<TurnPair> pairs;
  for (auto _ : state) {
    pairs.clear();
    for (int k = 0; k < 9; ++k) {
      const std::span<const ImuSample> part(samples.data() + 100 * k, 101);
      pairs.push_back({attitudes[k].inverse() * attitudes[k + 1],
                       *integrate_gyro(part, k * kNsPerSecond / 2, (k + 1) * kNsPerSecond / 2,
                                       Vec3<double>::Zero(), kNoise)});
    }
    bias = solve_gyro_bias(pairs)->bias;
    benchmark::DoNotOptimize(bias);
  }
  state.counters["error_deg_s"] = (bias - Vec3<double>(0.004, -0.02, 0.07)).norm() * 57.29578;
  state.counters["bound_us"] = 900 * 190 / (4 * 3.0) * 1e-3;
}
BENCHMARK(solve_bias)->Name("motion/gyro_bias/sweepkit/10_keyframes")->Unit(benchmark::kMicrosecond);

// The same from preintegration of the whole IMU.
void solve_bias_full(benchmark::State& state) {
  const auto samples = make_samples(4.6);
  for (auto _ : state) {
    std::vector<TurnPair> pairs;
    for (int k = 0; k < 9; ++k) {
      const std::span<const ImuSample> part(samples.data() + 100 * k, 101);
      const auto d = preintegrate(part, k * kNsPerSecond / 2, (k + 1) * kNsPerSecond / 2, {}, kNoise).value();
      pairs.push_back({d.R, {d.begin, d.end, d.R, d.bias.gyro, d.R_gyro, d.covariance(0, 0), 0.0}});
    }
    auto bias = solve_gyro_bias(pairs);
    benchmark::DoNotOptimize(bias);
  }
}
BENCHMARK(solve_bias_full)->Name("motion/gyro_bias/whole_imu/10_keyframes")->Unit(benchmark::kMicrosecond);

// The motion over 0.1 s, as the system asks for it at each image: 20 gyro samples, 5 steps of the wheels.
void odometry_between(benchmark::State& state) {
  OdometryIntegrator odometry({1560, 0.035, 0.235}, SE3d(), kNoise);
  for (const auto& s : make_samples(2.0)) odometry.add(s);
  for (int k = 0; k <= 100; ++k)
    odometry.add(WheelSample{k * 20'000'000, WheelReading::ticks, 40.0 * k, 43.0 * k});
  for (auto _ : state) {
    auto motion = odometry.between(900'000'000, kNsPerSecond);
    benchmark::DoNotOptimize(motion);
  }
}
BENCHMARK(odometry_between)->Name("motion/odometry/sweepkit/0.1s")->Unit(benchmark::kMicrosecond);

void standstill(benchmark::State& state) {
  const auto samples = make_samples(5.0);
  for (auto _ : state) {
    StandstillDetector detector(kNoise, 200);
    for (const auto& s : samples) detector.add(s);
    benchmark::DoNotOptimize(detector);
  }
  count(state, 1000, 0);
}
BENCHMARK(standstill)->Name("motion/standstill/sweepkit");

}  // namespace
}  // namespace sweepkit
