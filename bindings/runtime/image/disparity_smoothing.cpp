// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "disparity_smoothing.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <limits>

namespace sweepkit {

namespace {

constexpr int kRounds = 3;
constexpr float kLeastWeight = 1e-3f;  // of matched disparities behind one that is filled in

}  // namespace

void DisparitySmoother::smooth(GrayView guide, const DisparitySmoothing& options, const DisparityRamp& ramp,
                               View2d<std::int16_t> disparity) {
  const std::size_t width = static_cast<std::size_t>(guide.width), count = width * guide.height;
  sum_.resize(count);
  known_.resize(count);
  upward_.resize(count);
  for (int i = 0; i < 256; ++i) weight_[i] = static_cast<float>(std::exp(-i / options.sigma));
  for (int v = 0; v < guide.height; ++v) {
    const std::int16_t* d = disparity.row(v);
    const int shift = ramp.sixteenths(v);
    for (int u = 0; u < guide.width; ++u) {
      const bool known = d[u] > 0;
      known_[v * width + u] = known;
      sum_[v * width + u] = known ? static_cast<float>(d[u] - shift) : 0.0f;
    }
  }
  // Each round a quarter as smooth as the one before: the steps of the paper's equation 16.
  for (int round = 1; round <= kRounds; ++round) {
    const double part = 1.5 * std::pow(4.0, kRounds - round) / (std::pow(4.0, kRounds) - 1);
    rows(guide, static_cast<float>(part * options.smoothness));
    columns(guide, static_cast<float>(part * options.smoothness));
  }
  for (int v = 0; v < guide.height; ++v) {
    std::int16_t* d = disparity.row(v);
    const int shift = ramp.sixteenths(v);
    for (int u = 0; u < guide.width; ++u) {
      const float known = known_[v * width + u];
      if (d[u] <= 0 && !(options.fill && known > kLeastWeight)) continue;
      const float smoothed = sum_[v * width + u] / known + static_cast<float>(shift);
      d[u] = static_cast<std::int16_t>(
          std::clamp(std::lround(smoothed), 0l, long{std::numeric_limits<std::int16_t>::max()}));
    }
  }
}

void DisparitySmoother::rows(GrayView guide, float lambda) {
  const int last = guide.width - 1;
  for (int v = 0; v < guide.height; ++v) {
    const std::uint8_t* grey = guide.row(v);
    const std::size_t start = static_cast<std::size_t>(v) * guide.width;
    float *sum = sum_.data() + start, *known = known_.data() + start, *next = upward_.data() + start;
    float before = 0, next_before = 0, sum_before = 0, known_before = 0;
    for (int u = 0; u <= last; ++u) {
      const float after = u < last ? lambda * weight_[std::abs(grey[u] - grey[u + 1])] : 0.0f;
      const float scale = 1 / (1 + before + after - before * next_before);
      next_before = next[u] = after * scale;
      sum_before = sum[u] = (sum[u] + before * sum_before) * scale;
      known_before = known[u] = (known[u] + before * known_before) * scale;
      before = after;
    }
    for (int u = last - 1; u >= 0; --u) {
      sum[u] += next[u] * sum[u + 1];
      known[u] += next[u] * known[u + 1];
    }
  }
}

void DisparitySmoother::columns(GrayView guide, float lambda) {
  const int width = guide.width, last = guide.height - 1;
  const auto at = [&](std::vector<float>& values, int v) {
    return values.data() + static_cast<std::ptrdiff_t>(v) * width;
  };
  for (int v = 0; v <= last; ++v) {
    const std::uint8_t* grey = guide.row(v);
    const std::uint8_t *above = guide.row(std::max(v - 1, 0)), *below = guide.row(std::min(v + 1, last));
    float *sum = at(sum_, v), *known = at(known_, v), *next = at(upward_, v);
    const float *sum_above = at(sum_, std::max(v - 1, 0)), *known_above = at(known_, std::max(v - 1, 0)),
                *next_above = at(upward_, std::max(v - 1, 0));
    for (int u = 0; u < width; ++u) {
      const float before = v > 0 ? lambda * weight_[std::abs(grey[u] - above[u])] : 0.0f;
      const float after = v < last ? lambda * weight_[std::abs(grey[u] - below[u])] : 0.0f;
      const float scale = 1 / (1 + before + after - (v > 0 ? before * next_above[u] : 0.0f));
      next[u] = after * scale;
      sum[u] = (sum[u] + (v > 0 ? before * sum_above[u] : 0.0f)) * scale;
      known[u] = (known[u] + (v > 0 ? before * known_above[u] : 0.0f)) * scale;
    }
  }
  for (int v = last - 1; v >= 0; --v) {
    float *sum = at(sum_, v), *known = at(known_, v);
    const float *next = at(upward_, v), *sum_below = at(sum_, v + 1), *known_below = at(known_, v + 1);
    for (int u = 0; u < width; ++u) {
      sum[u] += next[u] * sum_below[u];
      known[u] += next[u] * known_below[u];
    }
  }
}

}  // namespace sweepkit
