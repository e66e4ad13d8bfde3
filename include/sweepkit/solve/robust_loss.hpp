// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>
#include <concepts>

namespace sweepkit {

/// A robust loss: for squared errors t, in units of the squared scale, the cost rho(t) and the weight
/// rho'(t) of iteratively reweighted least squares. rho(t) is t to first order at zero. It works element by
/// element on Eigen arrays, so that several errors go through at once.
template <class Loss>
concept RobustLoss = requires(const Eigen::Array4d& t, Eigen::Array4d& out) {
  { Loss::evaluate(t, out, out) } -> std::same_as<void>;
  { Loss::kRedescending } -> std::convertible_to<bool>;
};

/// Plain least squares.
struct QuadraticLoss {
  static constexpr bool kRedescending = false;
  template <class Array>
  static void evaluate(const Array& t, Array& rho, Array& weight) {
    rho = t;
    weight.setOnes();
  }
};

/// Huber (1964): quadratic up to the scale, linear beyond. Convex.
struct HuberLoss {
  static constexpr bool kRedescending = false;
  template <class Array>
  static void evaluate(const Array& t, Array& rho, Array& weight) {
    const Array root = t.max(1.0).sqrt();
    weight = root.inverse();
    rho = t.min(1.0) + 2.0 * (root - 1.0);
  }
};

/// Cauchy: log(1 + t). Large errors lose their pull, but never all of it.
struct CauchyLoss {
  static constexpr bool kRedescending = true;
  template <class Array>
  static void evaluate(const Array& t, Array& rho, Array& weight) {
    weight = (1.0 + t).inverse();
    rho = (1.0 + t).log();
  }
};

/// Geman and McClure (1987): t / (1 + t). Bounded.
struct GemanMcClureLoss {
  static constexpr bool kRedescending = true;
  template <class Array>
  static void evaluate(const Array& t, Array& rho, Array& weight) {
    const Array q = (1.0 + t).inverse();
    weight = q * q;
    rho = t * q;
  }
};

/// Least squares on what lies within the scale, as long as it does; all else costs the same and has no
/// weight.
struct TruncatedLoss {
  static constexpr bool kRedescending = true;
  template <class Array>
  static void evaluate(const Array& t, Array& rho, Array& weight) {
    rho = t.min(1.0);
    weight = (t <= 1.0).select(Array::Ones(), Array::Zero());
  }
};

/// Tukey's biweight: what lies beyond the scale has no weight at all.
struct TukeyLoss {
  static constexpr bool kRedescending = true;
  template <class Array>
  static void evaluate(const Array& t, Array& rho, Array& weight) {
    const Array q = (1.0 - t).max(0.0);
    weight = q * q;
    rho = (1.0 - weight * q) * (1.0 / 3.0);
  }
};

}  // namespace sweepkit
