// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/match/stereo_refinement.hpp"

#include <catch2/catch.hpp>

#include "match/stereo_scene.hpp"
#include "sweepkit/core/simd.hpp"

using namespace sweepkit;

namespace {

struct Errors {
  int total = 0, kept = 0;
  double mean = 0, rms = 0, sigma = 0;
};

/// A textured plane as both cameras see it.
struct PlaneView {
  Vec3<double> normal;
  ImagePyramid left, right;

  PlaneView(const StereoRig& rig, const Vec3<double>& normal, const AnalyticTexture& texture, double noise)
      : normal(normal) {
    left.build(render_plane(rig, Side::left, normal, texture, noise, 1), 8, 1.2);
    right.build(render_plane(rig, Side::right, normal, texture, noise, 2), 8, 1.2);
  }
};

/// Key points anywhere in a rendered plane, their right partners off by up to 0.7 px of their level: the
/// error of refined disparities against those of the plane.
Errors refine_plane(const StereoRig& rig, const PlaneView& view, int octave, int count,
                    const PatchRefinement::Options& options, std::vector<StereoMatch>* out = nullptr) {
  Random random(11);
  Features<256> left, right;
  std::vector<StereoMatch> matches;
  std::vector<double> truth;
  while (static_cast<int>(left.size()) < count) {
    const Vec2<double> pixel(random.uniform(30, 609), random.uniform(30, 369));
    const auto uv = rig.rectify(Side::left, pixel);
    const Vec3<double> p = point_on_plane(rig, Side::left, *uv, view.normal);
    const double d = rig.focal() * rig.baseline() / p.z();
    const double shift = random.uniform(-0.7, 0.7) * view.left.scale(octave);
    const auto at =
        rig.unrectify(Side::right, Vec2<double>(uv->x() - d + shift, uv->y() + random.uniform(-1, 1)));
    if (!at || !rig.camera(Side::right).contains(*at, 30)) continue;
    const KeyPoint l{
        .x = static_cast<float>(pixel.x()), .y = static_cast<float>(pixel.y()), .octave = octave};
    const KeyPoint r{.x = static_cast<float>(at->x()), .y = static_cast<float>(at->y()), .octave = octave};
    const auto u = static_cast<float>(uv->x());
    matches.push_back({.right = static_cast<std::int32_t>(left.size()),
                       .u_left = u,
                       .v_left = static_cast<float>(uv->y()),
                       .u_right = static_cast<float>(uv->x() - d + shift),
                       .disparity = static_cast<float>(d - shift),
                       .rectified = 1});
    left.keypoints.push_back(l);
    right.keypoints.push_back(r);
    truth.push_back(d);
  }
  left.descriptors.resize(left.size());
  right.descriptors.resize(right.size());
  const std::vector<StereoMatch> before = matches;
  PatchRefinement(rig, options).refine(left, view.left, right, view.right, matches);

  Errors errors;
  errors.total = count;
  for (std::size_t i = 0; i < matches.size(); ++i) {
    CHECK(matches[i].u_left == before[i].u_left);
    CHECK(matches[i].v_left == before[i].v_left);
    if (!matches[i].found()) continue;
    CHECK(matches[i].u_right == Approx(matches[i].u_left - matches[i].disparity).margin(1e-3));
    const double e = matches[i].disparity - truth[i];
    ++errors.kept;
    errors.mean += e;
    errors.rms += e * e;
    errors.sigma += matches[i].sigma;
  }
  errors.mean /= std::max(errors.kept, 1);
  errors.rms = std::sqrt(errors.rms / std::max(errors.kept, 1));
  errors.sigma /= std::max(errors.kept, 1);
  if (out) *out = matches;
  return errors;
}

/// A plane with that disparity in the image's middle, inclined as said (change of disparity a pixel).
Vec3<double> plane(const StereoRig& rig, double disparity, double by_u, double by_v) {
  // d = f b (n . ray), linear in the pixel.
  const double fb = rig.focal() * rig.baseline();
  return {by_u * rig.focal() / fb, by_v * rig.focal() / fb, disparity / fb};
}

}  // namespace

TEST_CASE("refined disparity has no bias at any part of a pixel") {
  const StereoRig rig = rectified_rig();
  PatchRefinement::Options options;
  options.sigma_floor = 0;
  for (int k = 0; k < 5; ++k) {
    const double disparity = 20 + k * 0.2;
    // One unit of the plane is seen as disparity / baseline px: waves up to 1 rad/px.
    const AnalyticTexture texture(5, disparity / rig.baseline());
    const PlaneView view(rig, plane(rig, disparity, 0, 0), texture, 2);
    for (const int octave : {0, 3}) {
      const Errors e = refine_plane(rig, view, octave, 600, options);
      INFO("octave " << octave << ", disparity " << disparity << ", rms " << e.rms);
      CHECK(e.kept > 0.9 * e.total);
      CHECK(std::abs(e.mean) < 0.01);
      CHECK(e.rms < 0.15);
      // The standard deviation that it reports is about right.
      CHECK(e.sigma > 0.6 * e.rms);
      CHECK(e.sigma < 2.5 * e.rms);
    }
  }
}

TEST_CASE("disparities of a plane come out of two distorted unrectified cameras") {
  const StereoRig rig = unrectified_rig();
  {
    const AnalyticTexture texture(9, 24.3 / rig.baseline());
    const PlaneView view(rig, plane(rig, 28.3, 0, 0), texture, 0.5);
    for (const int octave : {0, 2, 5}) {
      const Errors e = refine_plane(rig, view, octave, 400, {});
      INFO("octave " << octave << ", mean " << e.mean);
      CHECK(e.kept > 0.85 * e.total);
      CHECK(std::abs(e.mean) < 0.01);
      CHECK(e.rms < 0.05);
    }
  }
  // A wall, and a floor as a low robot sees it. Within a patch the disparity differs by far more than the
  // error.
  for (const auto& [by_u, by_v] : {std::pair{-0.04, 0.02}, {0.01, 0.07}}) {
    const AnalyticTexture texture(9, 13 / rig.baseline());  // no aliasing where the plane is far
    const PlaneView view(rig, plane(rig, 28.3, by_u, by_v), texture, 0.5);
    for (const int octave : {0, 2, 5}) {
      const Errors e = refine_plane(rig, view, octave, 400, {});
      INFO("octave " << octave << ", slant " << by_u << " " << by_v << ", mean " << e.mean);
      CHECK(e.kept > 0.85 * e.total);
      CHECK(std::abs(e.mean) < 0.02);
      CHECK(e.rms < 0.15);
    }
  }
}

TEST_CASE("SIMD and portable refinement agree to the bit") {
  for (const StereoRig& rig : {rectified_rig(), unrectified_rig()}) {
    const AnalyticTexture texture(2, 24.3 / rig.baseline());
    const PlaneView view(rig, plane(rig, 24.3, 0.02, 0.05), texture, 3);
    std::vector<StereoMatch> fast, portable;
    refine_plane(rig, view, 2, 200, {}, &fast);
    const ScopedSimdLevel level(SimdLevel::portable);
    refine_plane(rig, view, 2, 200, {}, &portable);
    CHECK(fast == portable);
  }
}

TEST_CASE("SIMD and portable refinement agree to the bit along the image's edges") {
  const StereoRig rig = unrectified_rig();
  const AnalyticTexture texture(2, 10.3 / rig.baseline());
  const PlaneView view(rig, plane(rig, 10.3, 0.01, 0.02), texture, 3);
  Features<256> left, right;
  std::vector<StereoMatch> start;
  for (int y = 0; y < 400; y += 3)
    for (int x = 0; x < 640; x += y < 24 || y > 375 ? 3 : x == 30 ? 570 : 3) {
      const auto uv = rig.rectify(Side::left, Vec2<double>(x, y));
      if (!uv) continue;
      const Vec3<double> p = point_on_plane(rig, Side::left, *uv, view.normal);
      const double d = rig.focal() * rig.baseline() / p.z();
      const auto at = rig.unrectify(Side::right, Vec2<double>(uv->x() - d, uv->y()));
      if (!at || !rig.camera(Side::right).contains(*at)) continue;
      start.push_back({.right = static_cast<std::int32_t>(left.size()),
                       .u_left = static_cast<float>(uv->x()),
                       .v_left = static_cast<float>(uv->y()),
                       .u_right = static_cast<float>(uv->x() - d),
                       .disparity = static_cast<float>(d),
                       .rectified = 1});
      const std::int32_t octave = static_cast<std::int32_t>(left.size() % 3);
      left.keypoints.push_back({.x = static_cast<float>(x), .y = static_cast<float>(y), .octave = octave});
      right.keypoints.push_back(
          {.x = static_cast<float>(at->x()), .y = static_cast<float>(at->y()), .octave = octave});
    }
  left.descriptors.resize(left.size());
  right.descriptors.resize(right.size());
  const PatchRefinement refinement(rig, {});
  std::vector<StereoMatch> fast = start, portable = start;
  refinement.refine(left, view.left, right, view.right, fast);
  {
    const ScopedSimdLevel level(SimdLevel::portable);
    refinement.refine(left, view.left, right, view.right, portable);
  }
  CHECK(fast == portable);
  CHECK(std::ranges::count_if(fast, &StereoMatch::found) > 1000);
}

TEST_CASE("refinement removes what has no texture or does not look alike") {
  const StereoRig rig = rectified_rig();
  const AnalyticTexture flat(1, 1, 0);
  CHECK(refine_plane(rig, PlaneView(rig, plane(rig, 20, 0, 0), flat, 1), 0, 100, {}).kept == 0);
  CHECK(refine_plane(rig, PlaneView(rig, plane(rig, 20, 0, 0), flat, 20), 0, 100, {}).kept <= 2);
}

TEST_CASE("refinement near the image's edge is refused, not read beyond it") {
  const StereoRig rig = rectified_rig();
  ImagePyramid pyramid;
  pyramid.build(render(640, 400, AnalyticTexture(1, 1)), 8, 1.2);
  Features<256> f;
  std::vector<StereoMatch> matches;
  for (const float x : {0.0f, 3.0f, 636.0f, 639.0f, 1000.0f, -50.0f})
    for (const float y : {0.0f, 4.0f, 396.0f, 399.0f, 9000.0f})
      for (const int octave : {0, 7, 20}) {
        f.keypoints.push_back({.x = x, .y = y, .octave = octave});
        matches.push_back({.right = static_cast<std::int32_t>(matches.size()),
                           .u_left = x,
                           .v_left = y,
                           .u_right = x - 1,
                           .disparity = 1,
                           .rectified = 1});
      }
  f.descriptors.resize(f.size());
  PatchRefinement(rig, {}).refine(f, pyramid, f, pyramid, matches);
  for (const StereoMatch& m : matches) CHECK(std::isfinite(m.disparity));
  std::vector<StereoMatch> wrong(3);
  CHECK_THROWS_AS(PatchRefinement(rig, {}).refine(f, pyramid, f, pyramid, wrong), Error);
  CHECK_THROWS_AS(PatchRefinement(rig, {}).refine(f, ImagePyramid(), f, pyramid, matches), Error);
}
