// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <concepts>
#include <optional>
#include <span>
#include <utility>
#include <vector>

#include "sweepkit/core/options.hpp"
#include "sweepkit/core/random.hpp"

namespace sweepkit {

/// How long ransac() searches.
struct RansacOptions {
  int max_iterations = 500;
  int min_iterations = 10;
  double confidence = 0.999;
  int local_rounds = 2;
  int seed = 1;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(max_iterations, "max_iterations", "", range(1, 1000000), "samples to draw at most");
    v(min_iterations, "min_iterations", "", range(0, 1000000),
      "samples to draw at least, however good the first");
    v(confidence, "confidence", "", range(0.0, 0.999999999),
      "stop when a sample free of outliers has been drawn with this probability");
    v(local_rounds, "local_rounds", "", range(0, 100), "refinements of each model that is the best so far");
    v(seed, "seed", "", range(0, 2147483647), "seed of the samples: same seed, same result");
  }
};

/// What ransac() asks of the problem. An estimator holds the data, numbered 0 .. size() - 1, and offers:
///   Model                    a default-constructible value
///   kSampleSize, kMaxModels  numbers of data that fix a model, and of models that they can give
///   size()                   number of data
///   solve(sample, models)    writes the models through a sample, returns how many; 0 for a degenerate one
///   cost(model, i)           squared residual of datum i over its squared threshold: an inlier is below 1
///   refine(model, chosen)    improves the model on the chosen data (never empty); false if it cannot
/// It may also offer score(model, bound): the sum over all data of min(cost, 1), or anything not below
/// `bound` as soon as the sum has reached it. That is the loop that takes the time, and can be written for
/// SIMD.
template <class E>
concept RansacEstimator =
    requires(const E& estimator, typename E::Model& model, int i,
             std::span<const int, static_cast<std::size_t>(E::kSampleSize)> sample,
             std::span<typename E::Model, static_cast<std::size_t>(E::kMaxModels)> models,
             std::span<const int> chosen) {
  requires std::default_initializable<typename E::Model>;
  { estimator.size() } -> std::convertible_to<int>;
  { estimator.solve(sample, models) } -> std::convertible_to<int>;
  { estimator.cost(std::as_const(model), i) } -> std::convertible_to<double>;
  { estimator.refine(model, chosen) } -> std::same_as<bool>;
};

/// The model with the best score, and how it was found.
template <class Model>
struct RansacResult {
  Model model;
  std::vector<int> inliers;  ///< data with cost below 1, ascending
  double score = 0.0;        ///< sum over all data of min(cost, 1)
  int iterations = 0;        ///< samples drawn
  int models = 0;            ///< models scored: those of samples, guesses and refinements
};

/// Number of samples after which one without outliers has been drawn with probability `confidence`.
inline double ransac_iterations(int inliers, int size, int sample_size, double confidence) {
  double good = 1.0;
  for (int k = 0; k < sample_size; ++k)
    good *= std::max(0.0, static_cast<double>(inliers - k)) / static_cast<double>(size - k);
  if (good >= 1.0) return 1.0;
  return std::log1p(-confidence) / std::log1p(-good);  // infinite if good is zero
}

/// Robust estimation from random samples: RANSAC (Fischler and Bolles 1981) with the truncated squares of
/// MSAC as score (Torr and Zisserman 2000), local optimisation of each new best model (Chum, Matas and
/// Kittler 2003) and adaptive termination. The same data, options and seed give the same result. Thread-safe
/// as far as the estimator's const members are.
/// @param guesses models to try before any sample, such as a prediction
/// @return nothing if no model has more inliers than a sample has data
template <RansacEstimator Estimator>
std::optional<RansacResult<typename Estimator::Model>> ransac(
    const Estimator& estimator, const RansacOptions& options = {},
    std::type_identity_t<std::span<const typename Estimator::Model>> guesses = {}) {
  using Model = typename Estimator::Model;
  constexpr int kSampleSize = Estimator::kSampleSize;
  const int size = static_cast<int>(estimator.size());
  if (size <= kSampleSize) return std::nullopt;

  const auto score_of = [&](const Model& model, double bound) {
    if constexpr (requires {
                    { estimator.score(model, bound) } -> std::convertible_to<double>;
                  }) {
      return static_cast<double>(estimator.score(model, bound));
    } else {
      double sum = 0.0;
      for (int i = 0; i < size && sum < bound; ++i) {
        const double cost = estimator.cost(model, i);
        sum += cost < 1.0 ? cost : 1.0;
      }
      return sum;
    }
  };

  RansacResult<Model> best;
  best.score = static_cast<double>(size);
  best.inliers.reserve(static_cast<std::size_t>(size));
  bool found = false;
  double needed = static_cast<double>(options.max_iterations);

  const auto try_model = [&](const Model& model) {
    ++best.models;
    const double score = score_of(model, best.score);
    if (!(score < best.score)) return false;
    best.model = model;
    best.score = score;
    found = true;
    best.inliers.clear();
    for (int i = 0; i < size; ++i)
      if (estimator.cost(best.model, i) < 1.0) best.inliers.push_back(i);
    return true;
  };
  const auto improve = [&](const Model& model) {
    if (!try_model(model)) return;
    for (int round = 0; round < options.local_rounds && !best.inliers.empty(); ++round) {
      Model refined = best.model;
      if (!estimator.refine(refined, std::span<const int>(best.inliers)) || !try_model(refined)) break;
    }
    needed = ransac_iterations(static_cast<int>(best.inliers.size()), size, kSampleSize, options.confidence);
  };

  for (const Model& guess : guesses) improve(guess);
  Random random(static_cast<std::uint64_t>(options.seed));
  std::array<int, static_cast<std::size_t>(kSampleSize)> sample;
  std::array<Model, static_cast<std::size_t>(Estimator::kMaxModels)> models;
  while (best.iterations < options.max_iterations &&
         (best.iterations < options.min_iterations || static_cast<double>(best.iterations) < needed)) {
    ++best.iterations;
    random.sample(static_cast<std::size_t>(size), std::span<int>(sample));
    const int count = estimator.solve(sample, models);
    for (int k = 0; k < count; ++k) improve(models[static_cast<std::size_t>(k)]);
  }
  if (!found || best.inliers.size() <= static_cast<std::size_t>(kSampleSize)) return std::nullopt;
  return best;
}

}  // namespace sweepkit
