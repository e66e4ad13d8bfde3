// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/match/align.hpp"

#include <algorithm>
#include <cmath>

#include "patch_lanes.hpp"

namespace sweepkit {

namespace {

constexpr int kSize = 8;  // rows and columns -4 .. 3
constexpr int kHalf = kSize / 2;
constexpr float kCount = kSize * kSize;

struct Template {
  Lanes value[kSize], by_x[kSize], by_y[kSize];
  float variance, xx, xy, yy;
};

/// Reads the patch about a whole pixel of the reference; false outside or without texture.
template <class Sampler>
SWEEPKIT_ALWAYS_INLINE bool prepare(const GrayView& image, const Eigen::Vector2f& center,
                                    const Eigen::Matrix2f& A, Template& t) {
  // Two more on each side for derivatives.
  constexpr int kFirst = -kHalf - 2, kRows = kSize + 4, kColumns = 16;
  alignas(32) float value[kRows][kColumns];
  for (const int i : {kFirst, kFirst + kColumns - 1})
    for (const int j : {kFirst, kFirst + kRows - 1}) {
      const Eigen::Vector2f p = center + A * Eigen::Vector2f(i, j);
      if (!(p.x() >= 0 && p.y() >= 0 && p.x() < image.width - 1 && p.y() < image.height - 1)) return false;
    }
  for (int j = 0; j < kRows; ++j) {
    const Eigen::Vector2f p = center + A * Eigen::Vector2f(kFirst, kFirst + j);
    Sampler::bilinear(image, p.x(), p.y(), A(0, 0), A(1, 0), value[j]);
  }
  Lanes sum = {}, sum_x = {}, sum_y = {};
  for (int j = 0; j < kSize; ++j) {
    const auto read = [&](int dx, int dy, Lanes& lanes) { load(value[j + 2 + dy] + 2 + dx, lanes); };
    Lanes a, b, c, d;
    read(0, 0, t.value[j]);
    read(-2, 0, a), read(-1, 0, b), read(1, 0, c), read(2, 0, d);
    t.by_x[j] = (c - b) * (8.0f / 12) - (d - a) * (1.0f / 12);
    read(0, -2, a), read(0, -1, b), read(0, 1, c), read(0, 2, d);
    t.by_y[j] = (c - b) * (8.0f / 12) - (d - a) * (1.0f / 12);
    sum += t.value[j];
    sum_x += t.by_x[j];
    sum_y += t.by_y[j];
  }
  const float mean = add_lanes(sum) / kCount, mean_x = add_lanes(sum_x) / kCount,
              mean_y = add_lanes(sum_y) / kCount;
  Lanes value2 = {}, value_x = {}, value_y = {};
  for (int j = 0; j < kSize; ++j) {
    t.value[j] -= mean;
    value2 += t.value[j] * t.value[j];
    value_x += t.value[j] * t.by_x[j];
    value_y += t.value[j] * t.by_y[j];
  }
  t.variance = add_lanes(value2);
  if (!(t.variance > 0)) return false;
  // What gain and offset can explain says nothing about the position.
  const float gain_x = add_lanes(value_x) / t.variance, gain_y = add_lanes(value_y) / t.variance;
  Lanes xx = {}, xy = {}, yy = {};
  for (int j = 0; j < kSize; ++j) {
    t.by_x[j] = t.by_x[j] - mean_x - gain_x * t.value[j];
    t.by_y[j] = t.by_y[j] - mean_y - gain_y * t.value[j];
    xx += t.by_x[j] * t.by_x[j];
    xy += t.by_x[j] * t.by_y[j];
    yy += t.by_y[j] * t.by_y[j];
  }
  t.xx = add_lanes(xx);
  t.xy = add_lanes(xy);
  t.yy = add_lanes(yy);
  return true;
}

struct Sums {
  float value, x, y, sum, sum2;
};

/// Lagrange's cubic through -1, 0, 1, 2 at f.
struct Weights {
  float a, b, c, d;
  explicit Weights(float f)
      : a(-f * (f - 1) * (f - 2) * (1.0f / 6)),
        b((f + 1) * (f - 1) * (f - 2) * 0.5f),
        c(-(f + 1) * f * (f - 2) * 0.5f),
        d((f + 1) * f * (f - 1) * (1.0f / 6)) {}
};

/// Compares with the current image at a position; false if the patch does not lie inside.
SWEEPKIT_ALWAYS_INLINE bool compare(const Template& t, const GrayView& image, float x, float y, Sums& sums) {
  if (!(x >= kHalf + 1 && y >= kHalf + 1 && x < image.width - kHalf - 2 && y < image.height - kHalf - 2))
    return false;
  const int xi = static_cast<int>(x), yi = static_cast<int>(y);
  const Weights across(x - static_cast<float>(xi)), down(y - static_cast<float>(yi));
  Lanes row[kSize + 3];
  for (int j = 0; j < kSize + 3; ++j) {
    const std::uint8_t* p = image.row(yi - kHalf - 1 + j) + xi - kHalf - 1;
    alignas(32) float v[4][8];
    for (int k = 0; k < 4; ++k) widen<8>(p + k, v[k]);
    Lanes a, b, c, d;
    load(v[0], a), load(v[1], b), load(v[2], c), load(v[3], d);
    row[j] = a * across.a + b * across.b + c * across.c + d * across.d;
  }
  Lanes value = {}, by_x = {}, by_y = {}, sum = {}, sum2 = {};
  for (int j = 0; j < kSize; ++j) {
    const Lanes r = row[j] * down.a + row[j + 1] * down.b + row[j + 2] * down.c + row[j + 3] * down.d;
    value += t.value[j] * r;
    by_x += t.by_x[j] * r;
    by_y += t.by_y[j] * r;
    sum += r;
    sum2 += r * r;
  }
  sums = {add_lanes(value), add_lanes(by_x), add_lanes(by_y), add_lanes(sum), add_lanes(sum2)};
  return true;
}

template <class Sampler>
SWEEPKIT_ALWAYS_INLINE bool run(const AlignOptions& options, const GrayView& reference,
                                const Eigen::Vector2f& point, const Eigen::Matrix2f& A,
                                const GrayView& current, const Eigen::Vector2f& predicted,
                                Alignment& result) {
  const float determinant = A(0, 0) * A(1, 1) - A(0, 1) * A(1, 0);
  if (!(std::abs(determinant) > 0.05f) || !predicted.allFinite() || !point.allFinite()) return false;
  // A whole pixel of the reference needs no interpolation; the rest of the way is made in the current image.
  const Eigen::Vector2f whole(std::round(point.x()), std::round(point.y())), rest = whole - point;
  const Eigen::Vector2f offset((A(1, 1) * rest.x() - A(0, 1) * rest.y()) / determinant,
                               (A(0, 0) * rest.y() - A(1, 0) * rest.x()) / determinant);
  Template t;
  if (!prepare<Sampler>(reference, whole, A, t)) return false;
  const auto noise = static_cast<float>(options.image_noise);
  const float H = t.xx * t.yy - t.xy * t.xy;
  if (!(H > 1e-4f * t.xx * t.yy)) return false;
  float x = predicted.x() + offset.x(), y = predicted.y() + offset.y();
  Sums sums;
  float gain = 1;
  bool converged = false;
  for (result.iterations = 0; result.iterations < options.iterations && !converged; ++result.iterations) {
    if (!compare(t, current, x, y, sums)) return false;
    gain = sums.value / t.variance;
    if (!(gain > 0.1f)) return false;
    const float a = -sums.x / gain, b = -sums.y / gain;
    const float dx = std::clamp((a * t.yy - b * t.xy) / H, -1.0f, 1.0f);
    const float dy = std::clamp((b * t.xx - a * t.xy) / H, -1.0f, 1.0f);
    x += dx;
    y += dy;
    converged = dx * dx + dy * dy < 1e-4f;
  }
  result.position = Eigen::Vector2f(x, y) - offset;
  if (!converged || !((result.position - predicted).norm() <= options.max_shift)) return false;
  if (!compare(t, current, x, y, sums)) return false;
  const float variance = sums.sum2 - sums.sum * sums.sum / kCount;
  gain = sums.value / t.variance;
  if (!(variance > 0) || !(gain > 0.1f)) return false;
  const float residual2 = std::max(variance - gain * sums.value, 0.0f) / (kCount - 4);
  result.residual = std::sqrt(residual2);
  result.correlation = sums.value / std::sqrt(variance * t.variance);
  const float scale = (residual2 + noise * noise) / (gain * gain * H);
  result.covariance << t.yy * scale, -t.xy * scale, -t.xy * scale, t.xx * scale;
  return result.correlation >= options.min_correlation;
}

bool run_portable(const AlignOptions& options, const GrayView& reference, const Eigen::Vector2f& point,
                  const Eigen::Matrix2f& A, const GrayView& current, const Eigen::Vector2f& predicted,
                  Alignment& result) {
  return run<PortableSampler>(options, reference, point, A, current, predicted, result);
}

#ifdef SWEEPKIT_HAVE_AVX2
SWEEPKIT_TARGET_AVX2 bool run_avx2(const AlignOptions& options, const GrayView& reference,
                                   const Eigen::Vector2f& point, const Eigen::Matrix2f& A,
                                   const GrayView& current, const Eigen::Vector2f& predicted,
                                   Alignment& result) {
  return run<Avx2Sampler>(options, reference, point, A, current, predicted, result);
}
#endif

}  // namespace

std::optional<Alignment> PatchAligner::align(const GrayView& reference, const Eigen::Vector2f& point,
                                             const Eigen::Matrix2f& A_reference_current,
                                             const GrayView& current,
                                             const Eigen::Vector2f& predicted) const {
  Alignment result;
#ifdef SWEEPKIT_HAVE_AVX2
  const auto kernel = simd_level() == SimdLevel::avx2 ? run_avx2 : run_portable;
#else
  const auto kernel = run_portable;
#endif
  if (!kernel(options_, reference, point, A_reference_current, current, predicted, result))
    return std::nullopt;
  return result;
}

}  // namespace sweepkit
