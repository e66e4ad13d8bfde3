// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/direction/vanishing_points.hpp"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <numbers>

#include "sweepkit/core/random.hpp"

namespace sweepkit {

namespace {

constexpr double kDegree = std::numbers::pi / 180;
constexpr int kRounds = 4;

/// The direction nearest to all planes near it: the eigenvector of least eigenvalue of the weighted scatter
/// of their normals, with the weights of Geman and McClure.
VanishingPoint refine(const impl::PlaneSet& planes, Vec3<double> d, double limit,
                      std::span<const std::uint8_t> use) {
  VanishingPoint point;
  const double scale = 1 / (limit * limit);
  for (int round = 0; round < kRounds; ++round) {
    Mat3<double> scatter = Mat3<double>::Zero();
    const Vec3<float> df = d.cast<float>();
    point.support = 0;
    point.segments = 0;
    for (std::size_t i = 0; i < planes.size(); ++i) {
      if (!use.empty() && !use[i]) continue;
      const float variance = planes.variance(i, df), r = planes.residual(i, df);
      const double z2 = r * r / variance * scale;
      if (z2 >= 1) continue;
      point.support += planes.weight(i) * (1 - z2);
      ++point.segments;
      const double robust = (1 - z2) * (1 - z2);
      const Vec3<double> n = planes.normal(i).cast<double>();
      scatter += planes.weight(i) * robust / variance * n * n.transpose();
    }
    if (point.segments < 2) break;
    Eigen::SelfAdjointEigenSolver<Mat3<double>> eigen;
    eigen.computeDirect(scatter);
    const Vec3<double> better = eigen.eigenvectors().col(0);
    point.sigma = 1 / std::sqrt(std::max(eigen.eigenvalues()(1), 1e-12));
    d = better.dot(d) < 0 ? Vec3<double>(-better) : better;
  }
  point.direction = d.z() < 0 ? Vec3<double>(-d) : d;
  return point;
}

}  // namespace

VanishingPointFinder::VanishingPointFinder(const VanishingPointOptions& options) : options_(options) {
  check_options(options_);
}

void VanishingPointFinder::candidates(const impl::PlaneSet& planes, int count,
                                      std::vector<VanishingPoint>& points) {
  points.clear();
  const std::size_t size = planes.size();
  if (size < 2) return;
  const auto limit = static_cast<float>(options_.inlier_sigmas);

  cumulative_.resize(size);
  double sum = 0;
  for (std::size_t i = 0; i < size; ++i) cumulative_[i] = sum += planes.weight(i);
  Random random(static_cast<std::uint64_t>(options_.seed));
  const auto draw = [&] {
    const auto at = std::upper_bound(cumulative_.begin(), cumulative_.end(), random.uniform() * sum);
    return std::min(static_cast<std::size_t>(at - cumulative_.begin()), size - 1);
  };
  hypotheses_.clear();
  for (int k = 0; k < options_.hypotheses; ++k) {
    const std::size_t i = draw(), j = draw();
    const Vec3<float> d = planes.normal(i).cross(planes.normal(j));
    const float sine = d.norm();
    // Two segments of one line fix no direction.
    if (!(sine > 0.02f)) continue;
    const Vec3<float> unit = d / sine;
    hypotheses_.push_back({unit, planes.consensus(unit, limit)});
  }
  std::stable_sort(hypotheses_.begin(), hypotheses_.end(),
                   [](const Hypothesis& a, const Hypothesis& b) { return a.support > b.support; });

  const auto near = [&](const Vec3<double>& d) {
    return std::any_of(points.begin(), points.end(), [&](const VanishingPoint& p) {
      return std::abs(p.direction.dot(d)) > std::cos(options_.separation * kDegree);
    });
  };
  for (const Hypothesis& h : hypotheses_) {
    if (points.size() >= static_cast<std::size_t>(count)) break;
    if (near(h.direction.cast<double>())) continue;
    const VanishingPoint point = refine(planes, h.direction.cast<double>(), options_.inlier_sigmas, {});
    if (point.segments >= 2 && !near(point.direction)) points.push_back(point);
  }
}

void VanishingPointFinder::find(std::span<const InterpretationPlane> planes,
                                std::vector<VanishingPoint>& points) {
  planes_.assign(planes, options_.segments.model_sigma * kDegree, options_.segments.full_length);
  labels_.assign(planes.size(), -1);
  std::vector<VanishingPoint> open;
  candidates(planes_, 4 * options_.max_points, open);
  points.clear();
  std::vector<std::uint8_t> free(planes.size(), 1);
  while (!open.empty() && points.size() < static_cast<std::size_t>(options_.max_points)) {
    // What is left to each of them after the stronger ones took theirs.
    std::size_t best = 0;
    for (std::size_t c = 0; c < open.size(); ++c) {
      open[c] = refine(planes_, open[c].direction, options_.inlier_sigmas, free);
      if (open[c].support > open[best].support) best = c;
    }
    const VanishingPoint point = open[best];
    open.erase(open.begin() + static_cast<std::ptrdiff_t>(best));
    // By chance a segment of any direction fits within its tolerance over a quarter turn.
    double chance = 0;
    const Vec3<float> d = point.direction.cast<float>();
    for (std::size_t i = 0; i < planes_.size(); ++i)
      if (free[i])
        chance +=
            planes_.weight(i) * std::min(1.0, 4 / std::numbers::pi / 3 * options_.inlier_sigmas *
                                                  std::sqrt(static_cast<double>(planes_.variance(i, d))));
    if (point.segments < 2 || point.support < chance + options_.min_support) continue;
    const bool twin = std::any_of(points.begin(), points.end(), [&](const VanishingPoint& p) {
      return std::abs(p.direction.dot(point.direction)) > std::cos(options_.separation * kDegree);
    });
    if (twin) continue;
    const auto limit = static_cast<float>(options_.inlier_sigmas * options_.inlier_sigmas);
    for (std::size_t i = 0; i < planes_.size(); ++i)
      if (free[i] && planes_.squared_sigmas(i, d) < limit) {
        free[i] = 0;
        labels_[i] = static_cast<std::int32_t>(points.size());
      }
    points.push_back(point);
  }
  // A point may have gained by what it was refined on.
  std::vector<std::int32_t> order(points.size()), place(points.size());
  for (std::size_t i = 0; i < order.size(); ++i) order[i] = static_cast<std::int32_t>(i);
  std::stable_sort(order.begin(), order.end(),
                   [&](std::int32_t a, std::int32_t b) { return points[a].support > points[b].support; });
  std::vector<VanishingPoint> sorted;
  for (std::size_t i = 0; i < order.size(); ++i) {
    sorted.push_back(points[order[i]]);
    place[order[i]] = static_cast<std::int32_t>(i);
  }
  points.swap(sorted);
  for (std::int32_t& label : labels_)
    if (label >= 0) label = place[label];
}

}  // namespace sweepkit
