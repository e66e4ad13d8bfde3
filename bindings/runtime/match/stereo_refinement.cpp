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

/// Where a grid of samples lies in an image: column i and row j at origin + i * step_u + j * step_v.
struct Lattice {
  Vec2<float> origin, step_u, step_v;
  bool aligned = false;  // with the pixels, one to one
};

struct Strip {
  alignas(32) float value[kMaxRows][kStripColumns];
};

/// Reads columns -8 .. 7 and rows -radius .. radius; false if one lies outside the image.
template <class Sampler>
SWEEPKIT_ALWAYS_INLINE bool read_strip(const GrayView& image, const Lattice& lattice, int radius,
                                       Strip& strip) {
  constexpr int kFirst = -kStripColumns / 2, kLast = kStripColumns / 2 - 1;
  if (lattice.aligned) {
    const int x = static_cast<int>(lattice.origin.x()), y = static_cast<int>(lattice.origin.y());
    if (x + kFirst < 0 || x + kLast >= image.width || y < radius || y + radius >= image.height) return false;
    for (int j = -radius; j <= radius; ++j)
      widen<kStripColumns>(image.row(y + j) + x + kFirst, strip.value[j + radius]);
    return true;
  }
  for (const int i : {kFirst, kLast})
    for (const int j : {-radius, radius}) {
      const float x = lattice.origin.x() + i * lattice.step_u.x() + j * lattice.step_v.x();
      const float y = lattice.origin.y() + i * lattice.step_u.y() + j * lattice.step_v.y();
      if (!(x >= 1 && y >= 1 && x < image.width - 2 && y < image.height - 2)) return false;
    }
  for (int j = -radius; j <= radius; ++j)
    Sampler::bilinear(image, lattice.origin.x() + j * lattice.step_v.x() + kFirst * lattice.step_u.x(),
                      lattice.origin.y() + j * lattice.step_v.y() + kFirst * lattice.step_u.y(),
                      lattice.step_u.x(), lattice.step_u.y(), strip.value[j + radius]);
  return true;
}

/// The left patch made ready: zero-mean values, and the gradient's part that neither gain nor offset can
/// explain.
struct Template {
  Lanes value[kMaxRows], gradient[kMaxRows];
  float count, variance, gradient_energy;
};

SWEEPKIT_ALWAYS_INLINE void prepare(const Strip& left, int rows, Template& t) {
  t.count = static_cast<float>(8 * rows);
  Lanes sum = {}, gradient_sum = {};
  for (int j = 0; j < rows; ++j) {
    const float* p = left.value[j] + kPatch;
    Lanes m2, m1, p1, p2;
    load(p - 2, m2);
    load(p - 1, m1);
    load(p, t.value[j]);
    load(p + 1, p1);
    load(p + 2, p2);
    t.gradient[j] = (p1 - m1) * (8.0f / 12) - (p2 - m2) * (1.0f / 12);
    sum += t.value[j];
    gradient_sum += t.gradient[j];
  }
  const float mean = add_lanes(sum) / t.count, gradient_mean = add_lanes(gradient_sum) / t.count;
  Lanes vv = {}, vg = {};
  for (int j = 0; j < rows; ++j) {
    t.value[j] -= mean;
    vv += t.value[j] * t.value[j];
    vg += t.value[j] * t.gradient[j];
  }
  t.variance = add_lanes(vv);
  const float slope = t.variance > 0 ? add_lanes(vg) / t.variance : 0.0f;
  Lanes gg = {};
  for (int j = 0; j < rows; ++j) {
    t.gradient[j] = t.gradient[j] - gradient_mean - slope * t.value[j];
    gg += t.gradient[j] * t.gradient[j];
  }
  t.gradient_energy = add_lanes(gg);
}

/// Sums over the right patch at a shift.
struct Sums {
  float value_right;     // template times right
  float gradient_right;  // gradient times right
  float right, right2;   // right and its square

  float variance(float count) const { return right2 - right * right / count; }
};

/// Right patch moved by a whole number of columns and a fraction of one.
SWEEPKIT_ALWAYS_INLINE Sums compare(const Template& t, const Strip& right, int rows, int whole,
                                    float fraction) {
  const float f = fraction;
  // Lagrange's cubic through columns -1, 0, 1, 2.
  const float w0 = -f * (f - 1) * (f - 2) * (1.0f / 6), w1 = (f + 1) * (f - 1) * (f - 2) * 0.5f,
              w2 = -(f + 1) * f * (f - 2) * 0.5f, w3 = (f + 1) * f * (f - 1) * (1.0f / 6);
  Lanes value_right = {}, gradient_right = {}, sum = {}, sum2 = {};
  for (int j = 0; j < rows; ++j) {
    const float* p = right.value[j] + kPatch + whole;
    Lanes a, r, c, d;
    load(p - 1, a);
    load(p, r);
    load(p + 1, c);
    load(p + 2, d);
    r = a * w0 + r * w1 + c * w2 + d * w3;
    value_right += t.value[j] * r;
    gradient_right += t.gradient[j] * r;
    sum += r;
    sum2 += r * r;
  }
  return {add_lanes(value_right), add_lanes(gradient_right), add_lanes(sum), add_lanes(sum2)};
}

/// The same at a whole number of columns, for the correlation alone.
SWEEPKIT_ALWAYS_INLINE Sums compare_whole(const Template& t, const Strip& right, int rows, int whole) {
  Lanes value_right = {}, sum = {}, sum2 = {};
  for (int j = 0; j < rows; ++j) {
    Lanes r;
    load(right.value[j] + kPatch + whole, r);
    value_right += t.value[j] * r;
    sum += r;
    sum2 += r * r;
  }
  return {add_lanes(value_right), 0, add_lanes(sum), add_lanes(sum2)};
}

struct Shift {
  float columns;      // to add to the place in the right image [samples]
  float sigma;        // [samples]
  float correlation;  // of the patches there
};

/// Finds the shift; false without texture or when it runs off the strip.
SWEEPKIT_ALWAYS_INLINE bool find_shift(const Strip& left, const Strip& right, int rows, int reach,
                                       int iterations, float noise, Shift& shift) {
  Template t;
  prepare(left, rows, t);
  if (!(t.variance > 0) || !(t.gradient_energy > 0)) return false;
  int start = 0;
  if (reach > 0) {
    float best = -2;
    for (int s = -reach; s <= std::min(reach, kReach - 1); ++s) {
      const Sums sums = compare_whole(t, right, rows, s);
      const float variance = sums.variance(t.count);
      const float correlation = variance > 0 ? sums.value_right / std::sqrt(variance) : -2.0f;
      if (correlation > best) {
        best = correlation;
        start = s;
      }
    }
  }
  float x = static_cast<float>(start);
  float gain = 1;
  for (int k = 0; k < iterations; ++k) {
    const float whole = std::floor(x);
    const Sums sums = compare(t, right, rows, static_cast<int>(whole), x - whole);
    gain = sums.value_right / t.variance;
    if (!(gain > 0.1f)) return false;
    const float step = std::clamp(-sums.gradient_right / (gain * t.gradient_energy), -0.75f, 0.75f);
    x += step;
    if (!(x >= -kReach && x < kReach)) return false;
    if (std::abs(step) < 0.005f) break;
  }
  const float whole = std::floor(x);
  const Sums sums = compare(t, right, rows, static_cast<int>(whole), x - whole);
  const float variance = sums.variance(t.count);
  gain = sums.value_right / t.variance;
  if (!(variance > 0) || !(gain > 0.1f)) return false;
  const float residual = std::max(variance - gain * sums.value_right, 0.0f) / (t.count - 3);
  shift.columns = x;
  shift.correlation = sums.value_right / std::sqrt(variance * t.variance);
  shift.sigma = std::sqrt((residual + noise * noise) / t.gradient_energy) / gain;
  return true;
}

/// A pair as the loop over levels sees it.
struct Pair {
  Vec2<float> left_pixel, right_pixel;          // full image, raw
  Vec2<float> left_rectified, right_rectified;  // of those
  Eigen::Matrix2f J_left, J_left_inverse, J_right_inverse;
  bool aligned;  // rectified pair: no map at all
};

struct Result {
  float disparity = 0, sigma = 0, correlation = 0;
};

/// Refines on one level from a disparity; false if that fails.
template <class Sampler>
SWEEPKIT_ALWAYS_INLINE bool refine_on_level(const Pair& pair, const ImagePyramid& left_pyramid,
                                            const ImagePyramid& right_pyramid, int level, float disparity,
                                            int reach, const PatchRefinement::Options& options,
                                            Result& result) {
  const GrayView left = left_pyramid.level(level), right = right_pyramid.level(level);
  const Vec2<float> scale(left_pyramid.scale_x(level), left_pyramid.scale_y(level));
  // The left patch sits on whole pixels of the level, its middle (column -0.5) as near to the key point as
  // can be; what is measured is the disparity there.
  Lattice at_left{.origin = {std::round(left_pyramid.to_level_x(level, pair.left_pixel.x()) + 0.5f),
                             std::round(left_pyramid.to_level_y(level, pair.left_pixel.y()))},
                  .step_u = {1, 0},
                  .step_v = {0, 1},
                  .aligned = pair.aligned};
  const Vec2<float> center(left_pyramid.to_full_x(level, at_left.origin.x()),
                           left_pyramid.to_full_y(level, at_left.origin.y()));
  const Vec2<float> rectified = pair.left_rectified + pair.J_left * (center - pair.left_pixel);
  const Vec2<float> target(rectified.x() - disparity, rectified.y());
  const Vec2<float> pixel = pair.right_pixel + pair.J_right_inverse * (target - pair.right_rectified);
  Lattice at_right{
      .origin = {right_pyramid.to_level_x(level, pixel.x()), right_pyramid.to_level_y(level, pixel.y())},
      .step_u = {1, 0},
      .step_v = {0, 1},
      .aligned = pair.aligned};
  // Columns of both grids are scale.x() rectified pixels wide, rows scale.y() high.
  if (!pair.aligned) {
    at_left.step_u = pair.J_left_inverse.col(0);
    at_left.step_v = pair.J_left_inverse.col(1);
    at_right.step_u = pair.J_right_inverse.col(0);
    at_right.step_v = pair.J_right_inverse.col(1);
    const float skew = scale.y() / scale.x();
    for (Lattice* l : {&at_left, &at_right}) {
      l->step_u.y() /= skew;
      l->step_v.x() *= skew;
    }
  }
  // Along the epipolar line to a whole column, so that the same pixels are read at the same fractions.
  const float column = std::round(at_right.origin.x());
  const float offset = (column - at_right.origin.x()) / at_right.step_u.x();
  at_right.origin += offset * at_right.step_u;
  if (pair.aligned) at_right.origin = {column, std::round(at_right.origin.y())};

  Strip left_strip, right_strip;
  if (!read_strip<Sampler>(left, at_left, options.radius, left_strip) ||
      !read_strip<Sampler>(right, at_right, options.radius, right_strip))
    return false;
  Shift shift;
  if (!find_shift(left_strip, right_strip, 2 * options.radius + 1, reach, options.iterations,
                  static_cast<float>(options.image_noise), shift))
    return false;
  result.disparity = disparity - (offset + shift.columns) * scale.x();
  result.sigma = shift.sigma * scale.x();
  result.correlation = shift.correlation;
  return true;
}

template <class Sampler>
SWEEPKIT_ALWAYS_INLINE void refine_all(const StereoRig& rig, const PatchRefinement::Options& options,
                                       const Features<256>& left, const ImagePyramid& left_pyramid,
                                       const Features<256>& right, const ImagePyramid& right_pyramid,
                                       std::span<StereoMatch> matches) {
  const bool aligned = rig.is_rectified();
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
    Result result;
    if (!refine_on_level<Sampler>(pair, left_pyramid, right_pyramid, level, match.disparity, reach, options,
                                  result)) {
      clear_match(match);
      continue;
    }
    if (level > 0 && options.finish_on_full_image) {
      Result full;
      if (refine_on_level<Sampler>(pair, left_pyramid, right_pyramid, 0, result.disparity, 1, options,
                                   full) &&
          full.sigma < result.sigma && full.correlation >= options.min_correlation)
        result = full;
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
