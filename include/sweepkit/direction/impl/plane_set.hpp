// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cstddef>
#include <span>
#include <vector>

#include "sweepkit/direction/interpretation_plane.hpp"

namespace sweepkit::impl {

/// Interpretation planes as columns of numbers, padded with planes of no weight to whole groups, so that the
/// loops over all planes run in vector registers. Sums are taken in a fixed order.
class PlaneSet {
 public:
  static constexpr std::size_t kGroup = 8;

  void assign(std::span<const InterpretationPlane> planes, double model_sigma, double full_length) {
    size_ = planes.size();
    const std::size_t padded = (size_ + kGroup - 1) / kGroup * kGroup;
    for (auto* column : {&nx_, &ny_, &nz_, &mx_, &my_, &mz_, &turn_, &shift_, &weight_})
      column->assign(padded, 0);
    total_ = 0;
    for (std::size_t i = 0; i < size_; ++i) {
      const InterpretationPlane& p = planes[i];
      nx_[i] = static_cast<float>(p.normal.x());
      ny_[i] = static_cast<float>(p.normal.y());
      nz_[i] = static_cast<float>(p.normal.z());
      mx_[i] = static_cast<float>(p.middle.x());
      my_[i] = static_cast<float>(p.middle.y());
      mz_[i] = static_cast<float>(p.middle.z());
      const double turn = p.turn_sigma * p.turn_sigma, shift = p.shift_sigma * p.shift_sigma;
      turn_[i] = static_cast<float>(turn + model_sigma * model_sigma);
      shift_[i] = static_cast<float>(shift - turn);
      weight_[i] = static_cast<float>(std::min(1.0, p.length / full_length));
      total_ += weight_[i];
    }
    // Padding must not divide by zero.
    for (std::size_t i = size_; i < padded; ++i) turn_[i] = 1;
  }

  std::size_t size() const { return size_; }
  std::size_t padded() const { return nx_.size(); }
  float weight(std::size_t i) const { return weight_[i]; }
  double total_weight() const { return total_; }
  Vec3<float> normal(std::size_t i) const { return {nx_[i], ny_[i], nz_[i]}; }

  /// Squared residual over its variance (along = 1 - middle - normal parts; the normal's is small where it
  /// counts).
  float squared_sigmas(std::size_t i, const Vec3<float>& d) const {
    const float r = nx_[i] * d.x() + ny_[i] * d.y() + nz_[i] * d.z();
    return r * r / variance(i, d);
  }
  float residual(std::size_t i, const Vec3<float>& d) const {
    return nx_[i] * d.x() + ny_[i] * d.y() + nz_[i] * d.z();
  }
  float variance(std::size_t i, const Vec3<float>& d) const {
    const float m = mx_[i] * d.x() + my_[i] * d.y() + mz_[i] * d.z();
    return turn_[i] + shift_[i] * m * m;
  }

  /// Sum of weight * max(0, 1 - z^2 / limit^2).
  float consensus(const Vec3<float>& d, float limit) const {
    const float scale = 1 / (limit * limit);
    float sums[kGroup] = {};
    for (std::size_t i = 0; i < padded(); i += kGroup)
      for (std::size_t k = 0; k < kGroup; ++k) sums[k] += gain(i + k, d, scale);
    return sum(sums);
  }

  /// The same with the best of three directions for each plane.
  float consensus(const Mat3<float>& directions, float limit) const {
    const float scale = 1 / (limit * limit);
    const Vec3<float> x = directions.col(0), y = directions.col(1), z = directions.col(2);
    float sums[kGroup] = {};
    for (std::size_t i = 0; i < padded(); i += kGroup)
      for (std::size_t k = 0; k < kGroup; ++k)
        sums[k] += std::max(gain(i + k, x, scale), std::max(gain(i + k, y, scale), gain(i + k, z, scale)));
    return sum(sums);
  }

 private:
  float gain(std::size_t i, const Vec3<float>& d, float scale) const {
    const float r = nx_[i] * d.x() + ny_[i] * d.y() + nz_[i] * d.z();
    const float m = mx_[i] * d.x() + my_[i] * d.y() + mz_[i] * d.z();
    const float rest = 1 - r * r * scale / (turn_[i] + shift_[i] * m * m);
    return weight_[i] * (rest > 0 ? rest : 0);
  }
  static float sum(const float (&s)[kGroup]) {
    return ((s[0] + s[1]) + (s[2] + s[3])) + ((s[4] + s[5]) + (s[6] + s[7]));
  }

  std::size_t size_ = 0;
  double total_ = 0;
  std::vector<float> nx_, ny_, nz_, mx_, my_, mz_, turn_, shift_, weight_;
};

}  // namespace sweepkit::impl
