// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/match/align.hpp"

#include <Eigen/LU>
#include <catch2/catch.hpp>

#include "match/analytic_texture.hpp"
#include "sweepkit/core/simd.hpp"

using namespace sweepkit;

namespace {

struct Errors {
  int kept = 0;
  Eigen::Vector2d mean = Eigen::Vector2d::Zero();
  double rms = 0, sigma = 0;
};

/// The reference shows texture(p), the current image gain * texture(A (p - shift)) + offset.
Errors align_many(const Eigen::Matrix2d& A, const Eigen::Vector2d& shift, double noise, int count,
                  std::vector<Alignment>* out = nullptr) {
  const AnalyticTexture texture(21, 1.0, 40);
  const GrayImage reference = render(200, 160, texture, noise, 3);
  const GrayImage current = render(
      200, 160,
      [&](double x, double y) {
        const Eigen::Vector2d p = A * (Eigen::Vector2d(x, y) - shift);
        return 0.8 * texture(p.x(), p.y()) + 20;
      },
      noise, 4);
  const PatchAligner aligner;
  Random random(5);
  Errors e;
  for (int i = 0; i < count; ++i) {
    const Eigen::Vector2d point(random.uniform(40, 150), random.uniform(40, 120));
    const Eigen::Vector2d truth = A.inverse() * point + shift;
    const Eigen::Vector2d predicted = truth + Eigen::Vector2d(random.uniform(-1, 1), random.uniform(-1, 1));
    const auto found =
        aligner.align(reference, point.cast<float>(), A.cast<float>(), current, predicted.cast<float>());
    if (!found) continue;
    ++e.kept;
    const Eigen::Vector2d error = found->position.cast<double>() - truth;
    e.mean += error;
    e.rms += error.squaredNorm();
    e.sigma += found->covariance.trace();
    if (out) out->push_back(*found);
  }
  e.mean /= std::max(e.kept, 1);
  e.rms = std::sqrt(e.rms / std::max(e.kept, 1));
  e.sigma = std::sqrt(e.sigma / std::max(e.kept, 1));
  return e;
}

}  // namespace

TEST_CASE("aligned positions have no bias at any part of a pixel, whatever gain and offset") {
  for (int k = 0; k < 5; ++k) {
    const Errors e = align_many(Eigen::Matrix2d::Identity(), {3 + 0.2 * k, -2 - 0.15 * k}, 1, 400);
    INFO("step " << k << ", mean " << e.mean.transpose() << ", rms " << e.rms << ", sigma " << e.sigma);
    CHECK(e.kept > 340);
    CHECK(e.mean.lpNorm<Eigen::Infinity>() < 0.01);
    CHECK(e.rms < 0.12);
  }
}

TEST_CASE("alignment follows turned and scaled patches") {
  Eigen::Matrix2d A;
  A << 0.95, -0.2, 0.22, 1.04;
  const Errors e = align_many(A, {30.3, -10.6}, 0.5, 300);
  INFO("mean " << e.mean.transpose() << ", rms " << e.rms);
  CHECK(e.kept > 200);
  CHECK(e.mean.lpNorm<Eigen::Infinity>() < 0.01);
  CHECK(e.rms < 0.1);
}

TEST_CASE("SIMD and portable alignment agree to the bit") {
  Eigen::Matrix2d A;
  A << 0.95, -0.2, 0.22, 1.04;
  std::vector<Alignment> fast, portable;
  align_many(A, {30.3, -10.6}, 2, 100, &fast);
  const ScopedSimdLevel level(SimdLevel::portable);
  align_many(A, {30.3, -10.6}, 2, 100, &portable);
  REQUIRE(fast.size() == portable.size());
  for (std::size_t i = 0; i < fast.size(); ++i) {
    CHECK(fast[i].position == portable[i].position);
    CHECK(fast[i].covariance == portable[i].covariance);
    CHECK(fast[i].residual == portable[i].residual);
  }
}

TEST_CASE("alignment finds nothing at edges, without texture, along one edge only, or with a singular map") {
  const GrayImage image = render(100, 80, AnalyticTexture(1, 1));
  const PatchAligner aligner;
  const Eigen::Matrix2f I = Eigen::Matrix2f::Identity();
  CHECK(aligner.align(image, {50, 40}, I, image, {50.5f, 39.5f}));
  for (const Eigen::Vector2f& p :
       {Eigen::Vector2f(1, 40), {98, 40}, {50, 2}, {50, 79}, {-1e9f, 0}, {1e9f, 1e9f}}) {
    CHECK_FALSE(aligner.align(image, p, I, image, {50, 40}));
    CHECK_FALSE(aligner.align(image, {50, 40}, I, image, p));
  }
  CHECK_FALSE(aligner.align(image, {50, 40}, Eigen::Matrix2f::Zero(), image, {50, 40}));
  const GrayImage flat = render(100, 80, [](double, double) { return 90.0; });
  CHECK_FALSE(aligner.align(flat, {50, 40}, I, flat, {50, 40}));
  const GrayImage edge =
      render(100, 80, [](double x, double) { return 128 + 100 * std::tanh((x - 50) / 2); });
  CHECK_FALSE(aligner.align(edge, {50, 40}, I, edge, {50, 40}));
}
