// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/match/stereo_refinement.hpp"

#include <algorithm>
#include <cmath>
#include <optional>

#include "patch_lanes.hpp"
#include "sweepkit/core/error.hpp"
#include "sweepkit/match/stereo_filter.hpp"

namespace sweepkit {

namespace {

constexpr int kMaxRadius = 7;
constexpr int kMaxRows = 2 * kMaxRadius + 1;
// The patch has columns -4 .. 3 of a strip with columns -8 .. 7: room to move by -3 .. 2 whole columns and a
// fraction of one.
constexpr int kPatch = 4;
constexpr int kStripColumns = 16;
constexpr int kReach = 3;
constexpr float kGoodCorrelation = 0.9f;
// Where level 0 finishes, fewer rows and a step or two tell where to start there.
constexpr int kCoarseRadius = 4;
constexpr float kMaxShear = 4;  // columns a row
constexpr int kOffsetBase = 32;
static_assert(kOffsetBase > kMaxRadius * kMaxShear + 1);

/// Where a grid of samples lies in an image: column i and row j at origin + i * step_u + j * step_v.
struct Lattice {
  Vec2<float> origin, step_u, step_v;
  bool aligned = false;  // with the pixels, one to one
};

// Rows are counted in two registers.
constexpr int kRowLanes = 16;
static_assert(kMaxRows <= kRowLanes);

struct Strip {
  alignas(32) float value[kMaxRows][kStripColumns];
  int offset[kRowLanes];  // whole columns that a row is read farther to the right
};

/// Numbers of eight rows, the middle one 0.
SWEEPKIT_ALWAYS_INLINE void row_numbers(int first, int rows, Lanes& numbers) {
  numbers = Lanes{0, 1, 2, 3, 4, 5, 6, 7} + static_cast<float>(first - rows / 2);
}

/// Reads columns -8 .. 7 and rows -radius .. radius, each shifted by shear times its number to the nearest
/// whole column; false if one lies outside the image.
template <class Sampler>
SWEEPKIT_ALWAYS_INLINE bool read_strip(const GrayView& image, const Lattice& lattice, int radius, float shear,
                                       Strip& strip) {
  constexpr int kFirst = -kStripColumns / 2, kLast = kStripColumns / 2 - 1;
  const int rows = 2 * radius + 1;
  for (int j = 0; j < kRowLanes; j += 8) {
    // Positive before it is cut to a whole number; find_shift keeps the shear below kMaxShear.
    Lanes numbers;
    row_numbers(j, rows, numbers);
    const Lanes moved = numbers * shear + (kOffsetBase + 0.5f);
    const IntLanes whole = __builtin_convertvector(moved, IntLanes) - kOffsetBase;
    std::memcpy(strip.offset + j, &whole, sizeof(whole));
  }
  const int left = std::min(strip.offset[0], strip.offset[rows - 1]) + kFirst,
            right = std::max(strip.offset[0], strip.offset[rows - 1]) + kLast;
  if (lattice.aligned) {
    const int x = static_cast<int>(lattice.origin.x()), y = static_cast<int>(lattice.origin.y());
    if (x + left < 0 || x + right >= image.width || y < radius || y + radius >= image.height) return false;
    Sampler::copy_rows(image.row(y - radius) + x + kFirst, image.stride, strip.offset, rows, strip.value);
    return true;
  }
  for (const int i : {left, right})
    for (const int j : {-radius, radius}) {
      const float x = lattice.origin.x() + i * lattice.step_u.x() + j * lattice.step_v.x();
      const float y = lattice.origin.y() + i * lattice.step_u.y() + j * lattice.step_v.y();
      if (!(x >= 1 && y >= 1 && x < image.width - 2 && y < image.height - 2)) return false;
    }
  const Vec2<float> first = lattice.origin - static_cast<float>(radius) * lattice.step_v +
                            static_cast<float>(kFirst) * lattice.step_u;
  Sampler::bilinear_rows(image, first, lattice.step_u, lattice.step_v, strip.offset, rows, strip.value);
  return true;
}

/// The left patch made ready. Its values and derivatives stay as they are; sums of products with them are
/// freed of what mean, gain and offset explain.
struct Template {
  Lanes value[kMaxRows];     // less that of the middle, for exact sums
  Lanes by_shift[kMaxRows];  // derivative; that by shear is the row's number times it
  float count, mean, variance;
  float shift_mean, shift_gain, shear_mean, shear_gain;  // how offset and gain explain the derivatives
  float shift2, shear2, both;                            // products of what they leave
};

SWEEPKIT_ALWAYS_INLINE void prepare(const Strip& left, int rows, Template& t) {
  t.count = static_cast<float>(8 * rows);
  const float pivot = left.value[rows / 2][kPatch + 4];
  Lanes sum = {}, value2 = {}, shift_sum = {}, shear_sum = {}, value_shift = {}, value_shear = {},
        shift2 = {}, both = {}, shear2 = {};
  for (int j = 0; j < rows; ++j) {
    const float* p = left.value[j] + kPatch;
    const auto row = static_cast<float>(j - rows / 2);
    Lanes m2, m1, v, p1, p2;
    load(p - 2, m2);
    load(p - 1, m1);
    load(p, v);
    load(p + 1, p1);
    load(p + 2, p2);
    v -= pivot;
    const Lanes d = (p1 - m1) * (8.0f / 12) - (p2 - m2) * (1.0f / 12);
    const Lanes vd = v * d, dd = d * d, dd_row = dd * row;
    t.value[j] = v;
    t.by_shift[j] = d;
    sum += v;
    value2 += v * v;
    shift_sum += d;
    shear_sum += d * row;
    value_shift += vd;
    value_shear += vd * row;
    shift2 += dd;
    both += dd_row;
    shear2 += dd_row * row;
  }
  const HalfLanes first = add_lanes(sum, value2, shift_sum, shear_sum),
                  second = add_lanes(value_shift, value_shear, shift2, both);
  const float inverse_count = 1 / t.count;
  t.mean = first[0] * inverse_count;
  t.shift_mean = first[2] * inverse_count;
  t.shear_mean = first[3] * inverse_count;
  t.variance = first[1] - t.mean * first[0];
  const float inverse = t.variance > 0 ? 1 / t.variance : 0.0f;
  const float shift_value = second[0] - t.mean * first[2], shear_value = second[1] - t.mean * first[3];
  t.shift_gain = shift_value * inverse;
  t.shear_gain = shear_value * inverse;
  t.shift2 = second[2] - t.shift_mean * first[2] - t.shift_gain * shift_value;
  t.both = second[3] - t.shift_mean * first[3] - t.shift_gain * shear_value;
  t.shear2 = add_lanes(shear2) - t.shear_mean * first[3] - t.shear_gain * shear_value;
}

/// Sums over the right patch at a shift and shear.
struct Sums {
  float value_right = 0, shift_right = 0, shear_right = 0;  // the template's times right
  float variance = 0;                                       // of right, times the number of samples
};

/// Right patch with row j moved by shift + shear * j columns; false if it runs off the strip.
SWEEPKIT_ALWAYS_INLINE bool compare(const Template& t, const Strip& right, int rows, float shift, float shear,
                                    Sums& sums) {
  // Lagrange's cubic through columns -1, 0, 1, 2: weights of all rows at once.
  alignas(32) float weight[4][kRowLanes];
  alignas(32) int whole[kRowLanes];
  for (int j = 0; j < kRowLanes; j += 8) {
    IntLanes offset;
    Lanes numbers;
    row_numbers(j, rows, numbers);
    std::memcpy(&offset, right.offset + j, sizeof(offset));
    Lanes x = numbers * shear + shift - __builtin_convertvector(offset, Lanes);
    const Lanes low = Lanes{} - (kReach + 1), high = Lanes{} + (kReach + 1);
    x = x > low ? x : low;  // also what is not a number
    x = x < high ? x : high;
    const IntLanes floor = __builtin_convertvector(x + (kReach + 1), IntLanes) - (kReach + 1);
    const Lanes f = x - __builtin_convertvector(floor, Lanes);
    const Lanes a = f * (f - 1), b = (f + 1) * (f - 2);
    const Lanes w[4] = {a * (2 - f) * (1.0f / 6), b * (f - 1) * 0.5f, b * f * -0.5f,
                        a * (f + 1) * (1.0f / 6)};
    for (int k = 0; k < 4; ++k) std::memcpy(weight[k] + j, &w[k], sizeof(Lanes));
    std::memcpy(whole + j, &floor, sizeof(floor));
  }
  Lanes value_right = {}, shift_right = {}, shear_right = {}, sum = {}, sum2 = {};
  for (int j = 0; j < rows; ++j) {
    if (whole[j] < -kReach || whole[j] >= kReach) return false;
    const float* p = right.value[j] + kPatch + whole[j];
    Lanes a, r, c, d;
    load(p - 1, a);
    load(p, r);
    load(p + 1, c);
    load(p + 2, d);
    r = (a * weight[0][j] + r * weight[1][j]) + (c * weight[2][j] + d * weight[3][j]);
    const Lanes dr = t.by_shift[j] * r;
    value_right += t.value[j] * r;
    shift_right += dr;
    shear_right += dr * static_cast<float>(j - rows / 2);
    sum += r;
    sum2 += r * r;
  }
  const HalfLanes s = add_lanes(value_right, shift_right, shear_right, sum);
  sums.value_right = s[0] - t.mean * s[3];
  sums.shift_right = s[1] - t.shift_mean * s[3] - t.shift_gain * sums.value_right;
  sums.shear_right = s[2] - t.shear_mean * s[3] - t.shear_gain * sums.value_right;
  sums.variance = add_lanes(sum2) - s[3] * s[3] / t.count;
  return true;
}

/// Correlation at a whole number of columns.
SWEEPKIT_ALWAYS_INLINE float correlation(const Template& t, const Strip& right, int rows, int whole) {
  Lanes value_right = {}, sum = {}, sum2 = {};
  for (int j = 0; j < rows; ++j) {
    Lanes r;
    load(right.value[j] + kPatch + whole, r);
    value_right += t.value[j] * r;
    sum += r;
    sum2 += r * r;
  }
  const HalfLanes s = add_lanes(value_right, sum, sum2, sum2);
  const float variance = s[2] - s[1] * s[1] / t.count;
  return variance > 0 ? (s[0] - t.mean * s[1]) / std::sqrt(variance * t.variance) : -2.0f;
}

/// Whole columns at which the patches correlate best, climbing from the middle unless that is good already.
SWEEPKIT_ALWAYS_INLINE int search(const Template& t, const Strip& right, int rows, int reach) {
  float best = correlation(t, right, rows, 0);
  if (best >= kGoodCorrelation) return 0;
  const float up = correlation(t, right, rows, 1), down = correlation(t, right, rows, -1);
  if (!(std::max(up, down) > best)) return 0;
  best = std::max(up, down);
  const int step = up > down ? 1 : -1;
  int at = step;
  while (std::abs(at + step) <= reach && at + step < kReach) {
    const float c = correlation(t, right, rows, at + step);
    if (!(c > best)) break;
    best = c;
    at += step;
  }
  return at;
}

struct Shift {
  float columns;      // to add to the place in the right image [samples]
  float shear;        // columns a row
  float sigma;        // [samples]
  float correlation;  // of the patches there
};

/// Finds shift and shear; false without texture or when they run off the strip.
/// @param reach whole columns to climb to first; 0 starts at the middle
/// @param precision smaller steps are the last [samples]
SWEEPKIT_ALWAYS_INLINE bool find_shift(const Strip& left, const Strip& right, int rows, int reach,
                                       float precision, const PatchRefinement::Options& options,
                                       Shift& shift) {
  Template t;
  prepare(left, rows, t);
  if (!(t.variance > 0) || !(t.shift2 > 0)) return false;
  if (reach > 0) shift.columns = static_cast<float>(search(t, right, rows, reach));
  const auto noise = static_cast<float>(options.image_noise),
             shear_sigma = static_cast<float>(options.shear_sigma);
  // A prior of shear 0 holds it where texture does not tell.
  const float prior = (noise * noise + 0.01f) / (shear_sigma * shear_sigma);
  const float shear2 = t.shear2 + prior;
  const float inverse = 1 / (t.shift2 * shear2 - t.both * t.both), inverse_variance = 1 / t.variance;
  if (!(inverse > 0)) return false;
  Sums sums;
  float gain = 0;
  for (int k = 0; k < options.iterations; ++k) {
    if (!compare(t, right, rows, shift.columns, shift.shear, sums)) return false;
    gain = sums.value_right * inverse_variance;
    if (!(gain > 0.1f) || !(sums.variance > 0)) return false;
    const float a = -sums.shift_right / gain, b = -sums.shear_right / gain - prior * shift.shear;
    const float step = std::clamp((a * shear2 - b * t.both) * inverse, -0.75f, 0.75f);
    shift.columns += step;
    shift.shear += std::clamp((b * t.shift2 - a * t.both) * inverse, -0.2f, 0.2f);
    if (!(std::abs(shift.shear) < kMaxShear)) return false;
    if (std::abs(step) < precision) break;
  }
  // The last step was too small to change what is said about the patches, or there were too many.
  const float residual = std::max(sums.variance - gain * sums.value_right, 0.0f) / (t.count - 4);
  shift.correlation = sums.value_right / std::sqrt(sums.variance * t.variance);
  shift.sigma = std::sqrt((residual + noise * noise) * shear2 * inverse) / gain;
  return true;
}

/// A pair as the loop over levels sees it.
struct Pair {
  Vec2<float> left_pixel, right_pixel;          // full image, raw
  Vec2<float> left_rectified, right_rectified;  // of those
  Eigen::Matrix2f J_left, J_left_inverse, J_right_inverse;
  bool aligned;  // rectified pair: no map at all
};

struct Strips {
  Strip left, right;
};

struct Result {
  float disparity = 0, shear = 0, sigma = 0, correlation = 0;
};

/// @param skew height of a row on the level against the width of a column
SWEEPKIT_ALWAYS_INLINE void set_steps(const Eigen::Matrix2f& map, float skew, Lattice& lattice) {
  lattice.step_u = {map(0, 0), map(1, 0) / skew};
  lattice.step_v = {map(0, 1) * skew, map(1, 1)};
}

/// Refines on one level from the disparity and shear of `start`; false if that fails.
/// @param coarse only as well as level 0 needs for a start
template <class Sampler>
SWEEPKIT_ALWAYS_INLINE bool refine_on_level(const Pair& pair, const ImagePyramid& left_pyramid,
                                            const ImagePyramid& right_pyramid, int level, const Result& start,
                                            int reach, bool coarse, const PatchRefinement::Options& options,
                                            Strips& strips, Result& result) {
  const int radius = coarse ? std::min(kCoarseRadius, options.radius) : options.radius;
  const GrayView left = left_pyramid.level(level), right = right_pyramid.level(level);
  const Vec2<float> scale(left_pyramid.scale_x(level), left_pyramid.scale_y(level));
  // The left patch sits on whole pixels of the level, its middle (column -0.5) as near to the key point as
  // can be; what is measured is the disparity there.
  Lattice at_left{.origin = {std::round(left_pyramid.to_level_x(level, pair.left_pixel.x()) + 0.5f),
                             std::round(left_pyramid.to_level_y(level, pair.left_pixel.y()))},
                  .step_u = {1, 0},
                  .step_v = {0, 1},
                  .aligned = coarse || pair.aligned};
  const Vec2<float> center(left_pyramid.to_full_x(level, at_left.origin.x()),
                           left_pyramid.to_full_y(level, at_left.origin.y()));
  const Vec2<float> rectified = pair.left_rectified + pair.J_left * (center - pair.left_pixel);
  // Shear carries disparities between the patch's row and the key point's.
  const float rows_below = rectified.y() - pair.left_rectified.y();
  const float disparity = start.disparity - start.shear * rows_below;
  const Vec2<float> target(rectified.x() - disparity, rectified.y());
  const Vec2<float> pixel = pair.right_pixel + pair.J_right_inverse * (target - pair.right_rectified);
  Lattice at_right{
      .origin = {right_pyramid.to_level_x(level, pixel.x()), right_pyramid.to_level_y(level, pixel.y())},
      .step_u = {1, 0},
      .step_v = {0, 1},
      .aligned = pair.aligned};
  // Both grids have columns scale.x() rectified pixels wide and rows scale.y() high. A coarse comparison
  // leaves the left pixels where they are and lets the right grid follow.
  if (!pair.aligned) {
    const float skew = scale.y() / scale.x();
    if (!coarse) set_steps(pair.J_left_inverse, skew, at_left);
    set_steps(coarse ? Eigen::Matrix2f(pair.J_right_inverse * pair.J_left) : pair.J_right_inverse, skew,
              at_right);
  }
  const float column_width = coarse ? pair.J_left(0, 0) : 1.0f;
  // Along the epipolar line to a whole column, so that the same pixels are read at the same fractions.
  const float column = std::round(at_right.origin.x());
  const float offset = (column - at_right.origin.x()) / pair.J_right_inverse(0, 0);
  at_right.origin +=
      offset * Vec2<float>(pair.J_right_inverse(0, 0), pair.J_right_inverse(1, 0) * scale.x() / scale.y());
  if (pair.aligned) at_right.origin = {column, std::round(at_right.origin.y())};

  if (!read_strip<Sampler>(left, at_left, radius, 0, strips.left) ||
      !read_strip<Sampler>(right, at_right, radius, start.shear, strips.right))
    return false;
  Shift shift{.columns = 0, .shear = start.shear, .sigma = 0, .correlation = 0};
  if (!find_shift(strips.left, strips.right, 2 * radius + 1, reach, coarse ? 0.3f : 0.05f, options, shift))
    return false;
  result.disparity =
      disparity - (offset + shift.columns * column_width) * scale.x() + shift.shear * rows_below;
  result.shear = shift.shear;
  result.sigma = shift.sigma * column_width * scale.x();
  result.correlation = shift.correlation;
  return true;
}

template <class Sampler>
SWEEPKIT_ALWAYS_INLINE void refine_all(const StereoRig& rig, const PatchRefinement::Options& options,
                                       const Features<256>& left, const ImagePyramid& left_pyramid,
                                       const Features<256>& right, const ImagePyramid& right_pyramid,
                                       std::span<StereoMatch> matches) {
  const bool aligned = rig.is_rectified();
  Strips strips{};
  const auto floor = static_cast<float>(options.sigma_floor);
  const int reach = std::min(kReach, static_cast<int>(std::ceil(options.max_shift)));
  for (std::size_t i = 0; i < matches.size(); ++i) {
    StereoMatch& match = matches[i];
    if (!match.found()) continue;
    const KeyPoint& l = left.keypoints[i];
    const KeyPoint& r = right.keypoints[match.right];
    Pair pair;
    pair.left_pixel = {l.x, l.y};
    pair.right_pixel = {r.x, r.y};
    pair.left_rectified = {match.u_left, match.v_left};
    pair.aligned = aligned;
    if (aligned) {
      pair.J_left = pair.J_left_inverse = pair.J_right_inverse = Eigen::Matrix2f::Identity();
      pair.right_rectified = pair.right_pixel;
    } else {
      Eigen::Matrix2f J_right;
      const auto at_left = rig.rectify_fast(Side::left, pair.left_pixel, pair.J_left);
      const auto at_right = rig.rectify_fast(Side::right, pair.right_pixel, J_right);
      if (!at_left || !at_right) continue;
      pair.right_rectified = *at_right;
      pair.J_left_inverse = pair.J_left.inverse();
      pair.J_right_inverse = J_right.inverse();
    }
    const int level = std::min(l.octave, left_pyramid.levels() - 1);
    const float scale = left_pyramid.scale_x(level);
    const bool finish = level > 0 && options.finish_on_full_image;
    Result result;
    if (!refine_on_level<Sampler>(pair, left_pyramid, right_pyramid, level, {.disparity = match.disparity},
                                  reach, finish, options, strips, result)) {
      clear_match(match);
      continue;
    }
    if (finish) {
      Result full;
      if (!refine_on_level<Sampler>(pair, left_pyramid, right_pyramid, 0, result, 0, false, options, strips,
                                    full) ||
          !(full.correlation >= options.min_correlation) ||
          !(std::abs(full.disparity - result.disparity) <= options.max_difference * scale)) {
        clear_match(match);
        continue;
      }
      if (full.sigma < result.sigma) result = full;
    }
    if (!(std::abs(result.disparity - match.disparity) <= options.max_shift * scale) ||
        !(result.disparity > 0) || !(result.correlation >= options.min_correlation) ||
        !(result.sigma <= options.max_sigma * scale)) {
      clear_match(match);
      continue;
    }
    match.disparity = result.disparity;
    match.u_right = match.u_left - result.disparity;
    match.sigma = std::sqrt(result.sigma * result.sigma + floor * floor);
  }
}

void refine_portable(const StereoRig& rig, const PatchRefinement::Options& options, const Features<256>& left,
                     const ImagePyramid& left_pyramid, const Features<256>& right,
                     const ImagePyramid& right_pyramid, std::span<StereoMatch> matches) {
  refine_all<PortableSampler>(rig, options, left, left_pyramid, right, right_pyramid, matches);
}

#ifdef SWEEPKIT_HAVE_AVX2
SWEEPKIT_TARGET_AVX2 void refine_avx2(const StereoRig& rig, const PatchRefinement::Options& options,
                                      const Features<256>& left, const ImagePyramid& left_pyramid,
                                      const Features<256>& right, const ImagePyramid& right_pyramid,
                                      std::span<StereoMatch> matches) {
  refine_all<Avx2Sampler>(rig, options, left, left_pyramid, right, right_pyramid, matches);
}
#endif

}  // namespace

void PatchRefinement::refine(const Features<256>& left, const ImagePyramid& left_pyramid,
                             const Features<256>& right, const ImagePyramid& right_pyramid,
                             std::span<StereoMatch> matches) const {
  if (!options_.enabled) return;
  require(matches.size() == left.size(), "PatchRefinement::refine matches",
          "must be as long as the left key points", matches.size());
  require(!left_pyramid.empty() && !right_pyramid.empty(), "PatchRefinement::refine",
          "the pyramids must be built", left_pyramid.levels());
  require(left_pyramid.levels() == right_pyramid.levels(), "PatchRefinement::refine right_pyramid",
          "must have as many levels as the left one", right_pyramid.levels());
#ifdef SWEEPKIT_HAVE_AVX2
  if (simd_level() == SimdLevel::avx2) {
    refine_avx2(rig_, options_, left, left_pyramid, right, right_pyramid, matches);
    return;
  }
#endif
  refine_portable(rig_, options_, left, left_pyramid, right, right_pyramid, matches);
}

}  // namespace sweepkit
