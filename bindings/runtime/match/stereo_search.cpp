// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/match/stereo_search.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>

#include "sweepkit/core/error.hpp"
#include "sweepkit/core/simd.hpp"

namespace sweepkit {

namespace {

constexpr float kInfinity = std::numeric_limits<float>::infinity();
constexpr std::uint64_t kNobody = std::numeric_limits<std::uint64_t>::max();

/// What a left key point accepts.
struct Window {
  float u_low, u_high;  // u_low <= u < u_high: disparity 0 is no disparity
  float v, reach;
  std::int32_t min_octave, max_octave;
};

/// Slots of a range that lie in a window are written to `inside`; returns how many. Room for all is needed.
int slots_inside_portable(const float* u, const float* v, const std::int32_t* octave, std::int32_t first,
                          std::int32_t last, const Window& w, std::int32_t* inside) {
  int count = 0;
  for (std::int32_t k = first; k < last; ++k) {
    inside[count] = k;
    count += (u[k] >= w.u_low) & (u[k] < w.u_high) & (std::abs(v[k] - w.v) <= w.reach) &
             (octave[k] >= w.min_octave) & (octave[k] <= w.max_octave);
  }
  return count;
}

void distances_portable(const OrbDescriptor& a, const OrbDescriptor* b, const std::int32_t* slots, int count,
                        std::uint32_t* distances) {
  for (int i = 0; i < count; ++i) distances[i] = static_cast<std::uint32_t>(hamming_distance(a, b[slots[i]]));
}

#ifdef SWEEPKIT_HAVE_AVX2
SWEEPKIT_TARGET_AVX2 int slots_inside_avx2(const float* u, const float* v, const std::int32_t* octave,
                                           std::int32_t first, std::int32_t last, const Window& w,
                                           std::int32_t* inside) {
  const __m256 u_low = _mm256_set1_ps(w.u_low), u_high = _mm256_set1_ps(w.u_high);
  const __m256 v0 = _mm256_set1_ps(w.v), reach = _mm256_set1_ps(w.reach), sign = _mm256_set1_ps(-0.0f);
  const __m256i below = _mm256_set1_epi32(w.min_octave - 1), above = _mm256_set1_epi32(w.max_octave + 1);
  int count = 0;
  for (std::int32_t k = first; k < last; k += 8) {
    const __m256 uk = _mm256_loadu_ps(u + k);
    const __m256 dv = _mm256_andnot_ps(sign, _mm256_sub_ps(_mm256_loadu_ps(v + k), v0));
    const __m256i ok = _mm256_loadu_si256(reinterpret_cast<const __m256i*>(octave + k));
    const __m256 in = _mm256_and_ps(
        _mm256_and_ps(_mm256_cmp_ps(uk, u_low, _CMP_GE_OQ), _mm256_cmp_ps(uk, u_high, _CMP_LT_OQ)),
        _mm256_cmp_ps(dv, reach, _CMP_LE_OQ));
    const __m256i oct = _mm256_and_si256(_mm256_cmpgt_epi32(ok, below), _mm256_cmpgt_epi32(above, ok));
    auto bits = static_cast<unsigned>(_mm256_movemask_ps(_mm256_and_ps(in, _mm256_castsi256_ps(oct))));
    if (last - k < 8) bits &= (1u << (last - k)) - 1;
    for (; bits; bits &= bits - 1) inside[count++] = k + std::countr_zero(bits);
  }
  return count;
}

SWEEPKIT_TARGET_AVX2 void distances_avx2(const OrbDescriptor& a, const OrbDescriptor* b,
                                         const std::int32_t* slots, int count, std::uint32_t* distances) {
  const std::uint64_t a0 = a.words[0], a1 = a.words[1], a2 = a.words[2], a3 = a.words[3];
  for (int i = 0; i < count; ++i) {
    const auto& w = b[slots[i]].words;
    distances[i] = static_cast<std::uint32_t>(_mm_popcnt_u64(a0 ^ w[0]) + _mm_popcnt_u64(a1 ^ w[1]) +
                                              _mm_popcnt_u64(a2 ^ w[2]) + _mm_popcnt_u64(a3 ^ w[3]));
  }
}
#endif

void check(const Features<256>& features, const char* place) {
  require(features.keypoints.size() == features.descriptors.size(), place,
          "must have as many descriptors as key points", features.descriptors.size());
  for (const KeyPoint& k : features.keypoints)
    require(k.octave >= 0 && k.octave < 32, place, "octaves must lie in [0, 32)", k.octave);
}

}  // namespace

StereoSearch::StereoSearch(const StereoRig& rig, const StereoSearchOptions& options)
    : rig_(rig), options_(options), grid_({.width = 32, .height = 4}) {
  check_options(options_);
  for (int o = 0; o < 32; ++o) scale_[o] = static_cast<float>(std::pow(options_.scale_factor, o));
}

int StereoSearch::match(const Features<256>& left, const Features<256>& right, std::span<const float> prior,
                        std::vector<StereoMatch>& matches) {
  check(left, "StereoSearch::match left");
  check(right, "StereoSearch::match right");
  require(prior.empty() || prior.size() == left.size(), "StereoSearch::match prior",
          "must be empty or as long as the left key points", prior.size());

  rectified_.resize(right.size());
  valid_.resize(right.size());
  rig_.rectify(Side::right, right.keypoints, rectified_, valid_);
  skip_.resize(right.size());
  right_.resize(right.size());
  for (std::size_t i = 0; i < right.size(); ++i) {
    skip_[i] = !valid_[i];
    right_[i] = {rectified_[i].x(), rectified_[i].y(), right.keypoints[i].octave};
  }
  grid_.build(right_, skip_);
  right_descriptors_.resize(grid_.size());
  for (std::size_t k = 0; k < grid_.size(); ++k) right_descriptors_[k] = right.descriptors[grid_.index()[k]];

  rectified_.resize(left.size());
  valid_.resize(left.size());
  rig_.rectify(Side::left, left.keypoints, rectified_, valid_);
  const int found = search(left, prior, matches);
  return options_.left_right_check ? keep_mutual(matches) : found;
}

int StereoSearch::search(const Features<256>& left, std::span<const float> prior,
                         std::vector<StereoMatch>& matches) {
#ifdef SWEEPKIT_HAVE_AVX2
  const bool fast = simd_level() == SimdLevel::avx2;
  const auto slots_inside = fast ? slots_inside_avx2 : slots_inside_portable;
  const auto distances_to = fast ? distances_avx2 : distances_portable;
#else
  const auto slots_inside = slots_inside_portable;
  const auto distances_to = distances_portable;
#endif
  const float* u = grid_.u().data();
  const float* v = grid_.v().data();
  const std::int32_t* octave = grid_.octave().data();
  const std::int32_t* index = grid_.index().data();
  const auto max_distance = static_cast<std::uint32_t>(options_.max_distance);
  const auto max_disparity = static_cast<float>(rig_.focal());
  const auto threshold = static_cast<float>(options_.threshold);
  const auto ratio = static_cast<float>(options_.ratio);

  best_left_.assign(grid_.size(), kNobody);
  slots_.resize(grid_.size());
  distances_.resize(grid_.size());
  slot_.resize(left.size());
  matches.assign(left.size(), {});
  int found = 0;
  for (std::size_t i = 0; i < left.size(); ++i) {
    if (!valid_[i]) continue;
    StereoMatch& match = matches[i];
    match.rectified = 1;
    match.u_left = rectified_[i].x();
    match.v_left = rectified_[i].y();

    const std::int32_t o = left.keypoints[i].octave;
    float low = 0, high = max_disparity;
    if (!prior.empty() && prior[i] > 0) {
      low = std::max(prior[i] - threshold, 0.0f);
      high = std::min(prior[i] + threshold, max_disparity);
    }
    const Window window{.u_low = match.u_left - high,
                        .u_high = low > 0 ? std::nextafter(match.u_left - low, kInfinity) : match.u_left,
                        .v = match.v_left,
                        .reach = static_cast<float>(options_.row_tolerance) * scale_[o],
                        .min_octave = o - options_.max_octave_difference,
                        .max_octave = o + options_.max_octave_difference};
    int count = 0;
    grid_.for_each_range(window.u_low, window.u_high, window.v - window.reach, window.v + window.reach,
                         [&](std::int32_t first, std::int32_t last) {
                           count += slots_inside(u, v, octave, first, last, window, slots_.data() + count);
                         });
    if (count == 0) continue;
    distances_to(left.descriptors[i], right_descriptors_.data(), slots_.data(), count, distances_.data());

    int best = 0;
    std::uint64_t best_key = kNobody;
    for (int c = 0; c < count; ++c) {
      const std::int32_t slot = slots_[c];
      const auto distance = static_cast<std::uint64_t>(distances_[c]) << 32;
      best_left_[slot] = std::min(best_left_[slot], distance | i);
      const std::uint64_t key = distance | static_cast<std::uint32_t>(index[slot]);
      if (key < best_key) {
        best_key = key;
        best = c;
      }
    }
    const std::uint32_t distance = distances_[best];
    if (distance > max_distance) continue;
    const float u_best = u[slots_[best]];
    if (ratio < 1) {
      // Key points within a few pixels of the best are the same corner, seen on another octave.
      const float near = 2 * scale_[o];
      std::uint32_t second = std::numeric_limits<std::uint32_t>::max();
      for (int c = 0; c < count; ++c)
        if (std::abs(u[slots_[c]] - u_best) > near) second = std::min(second, distances_[c]);
      if (static_cast<float>(distance) > ratio * static_cast<float>(second)) continue;
    }
    slot_[i] = slots_[best];
    match.right = index[slots_[best]];
    match.u_right = u_best;
    match.disparity = match.u_left - u_best;
    match.sigma = static_cast<float>(options_.sigma) * scale_[o];
    match.distance = static_cast<std::int32_t>(distance);
    ++found;
  }
  return found;
}

int StereoSearch::keep_mutual(std::vector<StereoMatch>& matches) const {
  int kept = 0;
  for (std::size_t i = 0; i < matches.size(); ++i) {
    StereoMatch& match = matches[i];
    if (!match.found()) continue;
    if ((best_left_[slot_[i]] & 0xffffffffu) == i) {
      ++kept;
    } else {
      match = {.u_left = match.u_left, .v_left = match.v_left, .rectified = 1};
    }
  }
  return kept;
}

}  // namespace sweepkit
