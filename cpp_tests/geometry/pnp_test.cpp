// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/geometry/pnp.hpp"
#include "sweepkit/geometry/impl/pnp.hpp"

#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <limits>
#include <vector>

#include "geometry/jacobian_check.hpp"
#include "sweepkit/core/random.hpp"

namespace {

using sweepkit::PnpMatches;
using sweepkit::PnpOptions;
using sweepkit::Random;
using sweepkit::SE3d;
using sweepkit::SO3d;
using sweepkit::Vec6;
using Vec2d = sweepkit::Vec2<double>;
using Vec3d = sweepkit::Vec3<double>;

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kFocal = 400.0, kBaseline = 0.1;

/// A view of a room, with the truth about it.
struct View {
  SE3d T_world_camera;
  std::vector<Vec3d> points;
  std::vector<Vec2d> rays;
  std::vector<double> right_x;
  std::vector<int> good;

  PnpMatches matches(bool stereo) const {
    PnpMatches m;
    m.points = points;
    m.rays = rays;
    if (stereo) m.right_x = right_x;
    m.focal = kFocal;
    m.baseline = kBaseline;
    return m;
  }
};

View make_view(Random& random, int count, double outlier_share, double noise_px, double offset = 3.0) {
  View view;
  const Vec3d phi(random.uniform(-2, 2), random.uniform(-2, 2), random.uniform(-2, 2));
  const Vec3d t(random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1));
  view.T_world_camera = SE3d(SO3d::exp(phi), offset * t);
  const double sigma = noise_px / kFocal;
  for (int i = 0; i < count; ++i) {
    const double z = random.uniform(1.0, 8.0);
    const Vec2d ray(random.uniform(-0.8, 0.8), random.uniform(-0.5, 0.5));
    view.points.push_back(view.T_world_camera * (z * ray.homogeneous()));
    const bool good = i >= static_cast<int>(outlier_share * count);
    if (good) view.good.push_back(i);
    const Vec2d seen = good ? ray : Vec2d(random.uniform(-0.8, 0.8), random.uniform(-0.5, 0.5));
    view.rays.push_back(seen + sigma * Vec2d(random.normal(), random.normal()));
    const double disparity = kBaseline / (good ? z : random.uniform(1.0, 8.0));
    view.right_x.push_back(i % 3 == 0 ? kNan : seen.x() - disparity + sigma * random.normal());
  }
  return view;
}

Vec6<double> error_of(const View& view, const SE3d& T_world_camera) {
  return (view.T_world_camera.inverse() * T_world_camera).log();
}

}  // namespace

TEST_CASE("errors of a match have the derivatives they say", "[pnp]") {
  Random random(1);
  for (int run = 0; run < 50; ++run) {
    const View view = make_view(random, 1, 0.0, 5.0);
    const auto pose = sweepkit::impl::PnpPose::from(view.T_world_camera);
    const double right = view.rays[0].x() - 0.03;
    for (const double* r : {&right, static_cast<const double*>(nullptr)}) {
      const auto error_at = [&](const Vec6<double>& xi) {
        const auto moved = pose.moved(xi);
        Vec3d e;
        sweepkit::impl::pnp_error(moved.R * view.points[0] + moved.t, view.rays[0], r, kBaseline, e, nullptr);
        return e;
      };
      Eigen::Matrix<double, 3, 6> J;
      Vec3d e;
      const Vec3d p_camera = pose.R * view.points[0] + pose.t;
      REQUIRE(sweepkit::impl::pnp_error(p_camera, view.rays[0], r, kBaseline, e, &J));
      sweepkit::test::check_jacobian(error_at, Vec6<double>(Vec6<double>::Zero()), J);
    }
    // moved() is T_world_camera * Exp(xi).
    Vec6<double> xi;
    xi << 0.1, -0.2, 0.3, 0.2, -0.1, 0.4;
    CHECK(((view.T_world_camera * SE3d::exp(xi)).inverse() * pose.moved(xi).T_world_camera()).log().norm() <
          1e-12);
  }
}

TEST_CASE("exact matches give the exact pose", "[pnp]") {
  Random random(2);
  PnpOptions options;
  options.min_inliers = 4;
  for (const int count : {6, 30, 300})
    for (const bool stereo : {false, true})
      for (int run = 0; run < 20; ++run) {
        const View view = make_view(random, count, 0.0, 0.0, run % 2 ? 3.0 : 1000.0);
        const auto found = sweepkit::solve_pnp(view.matches(stereo), options);
        REQUIRE(found);
        CHECK(error_of(view, found->T_world_camera).norm() < (run % 2 ? 1e-9 : 1e-7));
        CHECK(found->inliers == view.good);
        CHECK(found->rmse < 1e-6);
      }
}

TEST_CASE("outliers up to 70 % are told from inliers", "[pnp]") {
  Random random(3);
  for (const double share : {0.3, 0.5, 0.7})
    for (const bool stereo : {false, true}) {
      int found_all = 0;
      for (int run = 0; run < 50; ++run) {
        const View view = make_view(random, 300, share, 0.5);
        const auto found = sweepkit::solve_pnp(view.matches(stereo));
        if (!found) continue;
        const Vec6<double> e = error_of(view, found->T_world_camera);
        std::vector<int> right_ones;
        std::set_intersection(found->inliers.begin(), found->inliers.end(), view.good.begin(),
                              view.good.end(), std::back_inserter(right_ones));
        const std::size_t wrong_ones = found->inliers.size() - right_ones.size();
        found_all += e.head<3>().norm() < 0.02 && e.tail<3>().norm() < 0.005 &&
                     right_ones.size() >= view.good.size() * 98 / 100 && wrong_ones <= 8;
      }
      INFO("outliers " << share << ", stereo " << stereo);
      CHECK(found_all == 50);
    }
}

TEST_CASE("the covariance of the pose is that of its errors", "[pnp]") {
  const int runs = 500;
  for (const bool stereo : {false, true}) {
    Random random(4);
    double nees = 0.0, rmse = 0.0;
    for (int run = 0; run < runs; ++run) {
      const View view = make_view(random, 60, 0.0, 1.0);
      PnpOptions options;
      options.threshold = 4.0;  // keeps all inliers, so that the noise stays normal
      options.huber_width = 4.0;
      const auto found = sweepkit::solve_pnp(view.matches(stereo), options);
      REQUIRE(found);
      const Vec6<double> e = error_of(view, found->T_world_camera);
      nees += e.dot(found->covariance.ldlt().solve(e)) / runs;
      rmse += found->rmse / runs;
    }
    // The mean of 500 chi squares with six degrees of freedom: 6 +- 0.155.
    INFO("stereo " << stereo);
    CHECK(nees == Approx(6.0).margin(0.6));
    CHECK(rmse == Approx(1.0).margin(0.05));
  }
}

TEST_CASE("sigmas weigh the matches and scale the covariance", "[pnp]") {
  Random random(5);
  View view = make_view(random, 200, 0.0, 0.0);
  std::vector<double> sigmas;
  for (std::size_t i = 0; i < view.rays.size(); ++i) {
    sigmas.push_back(i % 2 ? 0.2 : 4.0);
    view.rays[i] += sigmas[i] / kFocal * Vec2d(random.normal(), random.normal());
  }
  auto matches = view.matches(false);
  matches.sigmas = sigmas;
  const auto weighted = sweepkit::solve_pnp(matches);
  REQUIRE(weighted);
  CHECK(weighted->inliers.size() > 180);
  CHECK(weighted->rmse == Approx(1.0).margin(0.15));
  const Vec6<double> e = error_of(view, weighted->T_world_camera);
  CHECK(e.dot(weighted->covariance.ldlt().solve(e)) < 25.0);
  for (double& sigma : sigmas) sigma *= 2.0;
  const auto wider = sweepkit::refine_pnp(matches, weighted->inliers, weighted->T_world_camera);
  REQUIRE(wider);
  CHECK(wider->covariance.trace() == Approx(4.0 * weighted->covariance.trace()).epsilon(0.2));
}

TEST_CASE("refinement alone comes back from a wrong start", "[pnp]") {
  Random random(6);
  for (int run = 0; run < 50; ++run) {
    const View view = make_view(random, 50, 0.0, 0.0);
    Vec6<double> xi;
    for (int k = 0; k < 6; ++k) xi(k) = random.uniform(-0.15, 0.15);
    PnpOptions options;
    options.refine_iterations = 30;
    const auto found =
        sweepkit::refine_pnp(view.matches(run % 2), view.good, view.T_world_camera * SE3d::exp(xi), options);
    REQUIRE(found);
    CHECK(error_of(view, found->T_world_camera).norm() < 1e-8);
  }
}

TEST_CASE("same seed, same pose to the last bit; a guess spares the samples", "[pnp]") {
  Random random(7);
  const View view = make_view(random, 200, 0.5, 0.7);
  const auto a = sweepkit::solve_pnp(view.matches(true));
  const auto b = sweepkit::solve_pnp(view.matches(true));
  REQUIRE((a && b));
  CHECK(a->T_world_camera.matrix() == b->T_world_camera.matrix());
  CHECK(a->covariance == b->covariance);
  CHECK(a->inliers == b->inliers);
  PnpOptions options;
  options.ransac.max_iterations = 0;
  options.ransac.min_iterations = 0;
  CHECK_FALSE(sweepkit::solve_pnp(view.matches(true), options));
  const auto c = sweepkit::solve_pnp(view.matches(true), options, view.T_world_camera);
  REQUIRE(c);
  CHECK(c->iterations == 0);
  CHECK((a->T_world_camera.inverse() * c->T_world_camera).log().norm() < 2e-3);
}

TEST_CASE("matches that fix no pose give nothing", "[pnp]") {
  Random random(8);
  const View good = make_view(random, 50, 0.0, 0.0);
  const auto nothing = [&](const View& view) {
    return !sweepkit::solve_pnp(view.matches(false)) && !sweepkit::solve_pnp(view.matches(true)) &&
           !sweepkit::solve_pnp(view.matches(true), {}, view.T_world_camera);
  };
  CHECK_FALSE(nothing(good));
  View view;
  CHECK(nothing(view));  // none
  view = make_view(random, 5, 0.0, 0.0);
  CHECK(nothing(view));  // too few
  view = good;
  for (std::size_t i = 0; i < view.points.size(); ++i) {  // one point seen by all
    view.points[i] = good.points[0];
    view.rays[i] = good.rays[0];
    view.right_x[i] = kNan;
  }
  CHECK(nothing(view));
  view = good;
  for (std::size_t i = 0; i < view.points.size(); ++i) {  // collinear, and truly seen
    const Vec3d p_camera = Vec3d(0, 0.2, 4) + random.uniform(-1.0, 1.0) * Vec3d(1, 0.5, 0.7);
    view.points[i] = view.T_world_camera * p_camera;
    view.rays[i] = p_camera.hnormalized();
    view.right_x[i] = kNan;
  }
  CHECK(nothing(view));
  view = good;
  for (auto& p : view.points) p = view.T_world_camera * -(view.T_world_camera.inverse() * p);
  for (auto& x : view.right_x) x = kNan;
  {  // behind: another pose may see points mirrored through a centre only if they are flat
    const auto found = sweepkit::solve_pnp(view.matches(false));
    CHECK_FALSE(found);
  }
  view = good;
  for (auto& p : view.points) p.y() = kNan;
  CHECK(nothing(view));
  view = make_view(random, 300, 1.0, 0.0);
  CHECK_FALSE(sweepkit::solve_pnp(view.matches(true)));  // nothing but outliers
}

TEST_CASE("a few broken values are outliers, wrong sizes an error", "[pnp]") {
  Random random(9);
  View view = make_view(random, 60, 0.0, 0.2);
  view.points[3].x() = kNan;
  view.rays[7].y() = std::numeric_limits<double>::infinity();
  view.right_x[8] = std::numeric_limits<double>::infinity();
  std::vector<double> sigmas(60, 1.0);
  sigmas[11] = 0.0;
  sigmas[12] = -1.0;
  sigmas[13] = kNan;
  auto matches = view.matches(true);
  matches.sigmas = sigmas;
  const auto found = sweepkit::solve_pnp(matches);
  REQUIRE(found);
  CHECK(error_of(view, found->T_world_camera).norm() < 5e-3);
  for (const int i : {3, 7, 8, 11, 12, 13})
    CHECK_FALSE(std::binary_search(found->inliers.begin(), found->inliers.end(), i));
  matches.rays = matches.rays.first(59);
  CHECK_THROWS_AS(sweepkit::solve_pnp(matches), sweepkit::Error);
  matches = view.matches(true);
  matches.focal = 0.0;
  CHECK_THROWS_AS(sweepkit::solve_pnp(matches), sweepkit::Error);
  sweepkit::check_options(PnpOptions{});
}
