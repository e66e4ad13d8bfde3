// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/geometry/ransac.hpp"

#include <Eigen/Core>
#include <Eigen/Eigenvalues>
#include <catch2/catch.hpp>
#include <cmath>
#include <vector>

namespace {

using sweepkit::Random;

/// Lines n . p = d in the plane, the plainest estimator there is.
struct LineEstimator {
  struct Model {
    Eigen::Vector2d n = Eigen::Vector2d::UnitX();
    double d = 0.0;
  };
  static constexpr int kSampleSize = 2;
  static constexpr int kMaxModels = 1;

  const std::vector<Eigen::Vector2d>& points;
  double threshold = 0.05;

  int size() const { return static_cast<int>(points.size()); }
  int solve(std::span<const int, 2> sample, std::span<Model, 1> models) const {
    const Eigen::Vector2d a = points[static_cast<std::size_t>(sample[0])];
    const Eigen::Vector2d along = points[static_cast<std::size_t>(sample[1])] - a;
    if (along.norm() < 1e-12) return 0;
    models[0].n = Eigen::Vector2d(-along.y(), along.x()).normalized();
    models[0].d = models[0].n.dot(a);
    return 1;
  }
  double cost(const Model& model, int i) const {
    const double e = (model.n.dot(points[static_cast<std::size_t>(i)]) - model.d) / threshold;
    return e * e;
  }
  bool refine(Model& model, std::span<const int> chosen) const {
    Eigen::Vector2d mean = Eigen::Vector2d::Zero();
    for (const int i : chosen)
      mean += points[static_cast<std::size_t>(i)] / static_cast<double>(chosen.size());
    Eigen::Matrix2d spread = Eigen::Matrix2d::Zero();
    for (const int i : chosen) {
      const Eigen::Vector2d v = points[static_cast<std::size_t>(i)] - mean;
      spread += v * v.transpose();
    }
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> eigen(spread);
    model.n = eigen.eigenvectors().col(0);
    model.d = model.n.dot(mean);
    return true;
  }
};

/// The same with a score of its own, which must change nothing.
struct ScoringLineEstimator : LineEstimator {
  double score(const Model& model, double bound) const {
    double sum = 0.0;
    for (int i = 0; i < size() && sum < bound; ++i) sum += std::min(cost(model, i), 1.0);
    return sum;
  }
};

std::vector<Eigen::Vector2d> line_points(Random& random, int inliers, int outliers, double sigma) {
  std::vector<Eigen::Vector2d> points;
  for (int i = 0; i < inliers; ++i) {
    const double x = random.uniform(-5, 5);
    points.emplace_back(x, 0.5 * x + 1.0 + sigma * random.normal());
  }
  for (int i = 0; i < outliers; ++i) points.emplace_back(random.uniform(-5, 5), random.uniform(-5, 5));
  return points;
}

bool same(const sweepkit::RansacResult<LineEstimator::Model>& a,
          const sweepkit::RansacResult<LineEstimator::Model>& b) {
  return a.model.n == b.model.n && a.model.d == b.model.d && a.inliers == b.inliers && a.score == b.score &&
         a.iterations == b.iterations && a.models == b.models;
}

}  // namespace

TEST_CASE("a line is found among outliers", "[ransac]") {
  Random random(1);
  for (const int outliers : {0, 100, 300}) {
    const auto points = line_points(random, 100, outliers, 0.01);
    const auto found = sweepkit::ransac(LineEstimator{points});
    REQUIRE(found);
    CHECK(std::abs(found->model.n.x() / found->model.n.y() + 0.5) < 5e-3);
    CHECK(found->inliers.size() >= 99);
    CHECK(std::is_sorted(found->inliers.begin(), found->inliers.end()));
    // Score and inliers are those of the model, by the definition.
    double score = 0.0;
    std::vector<int> inliers;
    const LineEstimator estimator{points};
    for (int i = 0; i < estimator.size(); ++i) {
      score += std::min(estimator.cost(found->model, i), 1.0);
      if (estimator.cost(found->model, i) < 1.0) inliers.push_back(i);
    }
    CHECK(found->score == Approx(score).epsilon(1e-12));
    CHECK(found->inliers == inliers);
  }
}

TEST_CASE("the search ends when it may", "[ransac]") {
  CHECK(sweepkit::ransac_iterations(50, 100, 3, 0.99) ==
        Approx(std::log(0.01) / std::log(1.0 - 50.0 * 49 * 48 / (100.0 * 99 * 98))));
  CHECK(sweepkit::ransac_iterations(100, 100, 3, 0.99) == 1.0);
  CHECK(std::isinf(sweepkit::ransac_iterations(2, 100, 3, 0.99)));

  Random random(2);
  sweepkit::RansacOptions options;
  options.min_iterations = 0;
  const auto clean = line_points(random, 100, 0, 0.0);
  CHECK(sweepkit::ransac(LineEstimator{clean}, options)->iterations == 1);
  options.min_iterations = 7;
  CHECK(sweepkit::ransac(LineEstimator{clean}, options)->iterations == 7);
  const auto noise = line_points(random, 3, 300, 0.0);
  options.max_iterations = 40;
  const auto found = sweepkit::ransac(LineEstimator{noise}, options);
  if (found) CHECK(found->iterations == 40);
}

TEST_CASE("same seed, same result; a score of the estimator's own changes nothing", "[ransac]") {
  Random random(3);
  const auto points = line_points(random, 60, 140, 0.02);
  sweepkit::RansacOptions options;
  int different = 0;
  const auto first = sweepkit::ransac(LineEstimator{points}, options);
  for (int seed = 1; seed < 6; ++seed) {
    options.seed = seed;
    const auto a = sweepkit::ransac(LineEstimator{points}, options);
    const auto b = sweepkit::ransac(LineEstimator{points}, options);
    const auto c = sweepkit::ransac(ScoringLineEstimator{{points}}, options);
    REQUIRE((a && b && c));
    CHECK(same(*a, *b));
    CHECK(same(*a, *c));
    different += !same(*a, *first);
  }
  CHECK(different > 0);
}

TEST_CASE("local optimisation needs fewer samples and scores better", "[ransac]") {
  Random random(4);
  double with = 0.0, without = 0.0;
  for (int i = 0; i < 30; ++i) {
    const auto points = line_points(random, 60, 60, 0.03);
    sweepkit::RansacOptions options;
    with += sweepkit::ransac(LineEstimator{points}, options)->score;
    options.local_rounds = 0;
    without += sweepkit::ransac(LineEstimator{points}, options)->score;
  }
  CHECK(with < without);
}

TEST_CASE("a good guess saves the search, a bad one does no harm", "[ransac]") {
  Random random(5);
  const auto points = line_points(random, 30, 170, 0.01);
  sweepkit::RansacOptions options;
  options.min_iterations = 0;
  options.max_iterations = 0;
  LineEstimator::Model good{Eigen::Vector2d(-0.5, 1.0).normalized(), 1.0 / std::sqrt(1.25)}, bad;
  const std::vector<LineEstimator::Model> guesses{bad, good};
  const auto found = sweepkit::ransac(LineEstimator{points}, options, guesses);
  REQUIRE(found);
  CHECK(found->iterations == 0);
  CHECK(found->inliers.size() >= 29);
}

TEST_CASE("data without consensus give nothing", "[ransac]") {
  const std::vector<Eigen::Vector2d> none, two{{0, 0}, {1, 1}}, same_point(20, Eigen::Vector2d(1, 2));
  CHECK_FALSE(sweepkit::ransac(LineEstimator{none}));
  CHECK_FALSE(sweepkit::ransac(LineEstimator{two}));
  CHECK_FALSE(sweepkit::ransac(LineEstimator{same_point}));
  const std::vector<Eigen::Vector2d> corners{{0, 0}, {1, 0}, {0, 1}};
  CHECK_FALSE(sweepkit::ransac(LineEstimator{corners}));
  sweepkit::check_options(sweepkit::RansacOptions{});
}
