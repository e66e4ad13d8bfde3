// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/solve/pose.hpp"

#include <Eigen/LU>
#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <cstring>
#include <limits>

#include "sweepkit/core/random.hpp"
#include "sweepkit/solve/impl/pose.hpp"
#include "sweepkit/solve/reprojection.hpp"

using namespace sweepkit;

namespace {

const RectifiedCamera kCamera{450.0, 320.5, 199.5, 0.11};
constexpr PoseLoss kLosses[] = {PoseLoss::quadratic, PoseLoss::huber, PoseLoss::cauchy,
                                PoseLoss::geman_mcclure, PoseLoss::tukey};

struct Scene {
  SE3d T_camera_world;
  std::vector<PoseObservation> observations;
};

Vec6<double> draw(Random& random, double rho, double phi) {
  Vec6<double> xi;
  for (int i = 0; i < 6; ++i) xi[i] = random.normal(0.0, i < 3 ? rho : phi);
  return xi;
}

Scene make_scene(Random& random, int count, double noise, double outliers = 0.0) {
  Scene scene;
  scene.T_camera_world = SE3d::exp(draw(random, 20.0, 1.0));
  const SE3d T_world_camera = scene.T_camera_world.inverse();
  for (int i = 0; i < count; ++i) {
    const double z = random.uniform(1, 10), u = random.uniform(0, 640), v = random.uniform(0, 400);
    PoseObservation o;
    o.p_world = T_world_camera *
                Vec3<double>((u - kCamera.cx) / kCamera.focal * z, (v - kCamera.cy) / kCamera.focal * z, z);
    o.sigma = static_cast<float>(random.uniform(0.7, 2.0));
    o.sigma_disparity = 0.3F;
    o.u = static_cast<float>(u + noise * o.sigma * random.normal());
    o.v = static_cast<float>(v + noise * o.sigma * random.normal());
    const double disparity = kCamera.disparity(z) + noise * o.sigma_disparity * random.normal();
    if (random.uniform() < 0.7) o.u_right = static_cast<float>(o.u - disparity);
    if (random.uniform() < outliers) {
      o.u = static_cast<float>(random.uniform(0, 640));
      o.v = static_cast<float>(random.uniform(0, 400));
      if (o.u_right >= 0.0F) o.u_right = static_cast<float>(o.u - random.uniform(0, 50));
    }
    // One that left the right image at its edge.
    if (o.u_right < 0.0F) o.u_right = -1.0F;
    scene.observations.push_back(o);
  }
  return scene;
}

// Squared error of an estimate in units of its covariance: chi-square with 6 degrees of freedom.
double nees(const SE3d& T_true, const PoseResult& result) {
  const Vec6<double> e = (T_true * result.T_camera_world.inverse()).log();
  return e.dot(result.covariance.inverse() * e);
}

double distance(const SE3d& a, const SE3d& b) { return (a * b.inverse()).log().norm(); }

}  // namespace

TEST_CASE("the sums of the pose solver are those of one observation after the other", "[solve]") {
  Random random(1);
  for (const int count : {1, 4, 7, 50}) {
    const Scene scene = make_scene(random, count, 1.0);
    const SE3d T = SE3d::exp(draw(random, 0.02, 0.01)) * scene.T_camera_world;
    PoseOptions options;
    std::vector<PoseBlock> blocks;
    pose_detail::prepare(kCamera, T, scene.observations, options, blocks);
    pose_detail::Linearization sums;
    PosePrior prior{SE3d::exp(draw(random, 0.1, 0.1)) * T, Mat6<double>::Identity() * 3.0};
    pose_detail::linearize<QuadraticLoss>(kCamera, T, blocks, 1.0, &prior, sums);

    Mat6<double> J_prior;
    const Vec6<double> e = pose_error(T, prior.T_camera_world, &J_prior);
    Mat6<double> H = J_prior.transpose() * prior.information * J_prior;
    Vec6<double> g = J_prior.transpose() * prior.information * e;
    double cost = e.dot(prior.information * e);
    for (const PoseObservation& o : scene.observations) {
      Vec3<double> r;
      Eigen::Matrix<double, 3, 6> J;
      REQUIRE(reprojection_error(kCamera, T.rotation().matrix(), T.translation(), o.p_world, o.u, o.v,
                                 static_cast<double>(o.u) - o.u_right, r, &J));
      const double w = 1.0 / (static_cast<double>(o.sigma) * o.sigma);
      const double wd =
          o.u_right < 0 ? 0.0 : 1.0 / (static_cast<double>(o.sigma_disparity) * o.sigma_disparity);
      const Mat3<double> W = Vec3<double>(w, w, wd).asDiagonal();
      H += J.transpose() * W * J;
      g += J.transpose() * W * r;
      cost += r.dot(W * r);
    }
    REQUIRE((sums.H - H).norm() < 1e-11 * H.norm());
    REQUIRE((sums.g - g).norm() < 1e-9 * g.norm());
    REQUIRE(sums.cost == Approx(cost).epsilon(1e-11));
  }
}

TEST_CASE("each loss is t at zero, and its weight is its derivative", "[solve]") {
  const auto check = [](auto loss) {
    using Loss = decltype(loss);
    const auto at = [](double t) {
      Eigen::Array4d rho, weight;
      Loss::evaluate(Eigen::Array4d(Eigen::Array4d::Constant(t)), rho, weight);
      return std::pair(rho[2], weight[2]);
    };
    REQUIRE(at(0.0).first == 0.0);
    REQUIRE(at(0.0).second == 1.0);
    for (const double t : {0.01, 0.3, 0.9, 1.1, 3.0, 50.0}) {
      REQUIRE(at(t).second == Approx((at(t + 1e-6).first - at(t - 1e-6).first) / 2e-6).margin(1e-8));
      REQUIRE(at(t).first <= t);
    }
  };
  check(QuadraticLoss{});
  check(HuberLoss{});
  check(CauchyLoss{});
  check(GemanMcClureLoss{});
  check(TukeyLoss{});
  check(TruncatedLoss{});
}

TEST_CASE("a pose is recovered exactly from data without noise", "[solve]") {
  Random random(2);
  std::vector<std::uint8_t> inlier;
  for (const PoseLoss loss : kLosses)
    for (int k = 0; k < 20; ++k) {
      const Scene scene = make_scene(random, 100, 0.0);
      PoseOptions options;
      options.loss = loss;
      options.tolerance = 1e-6;
      const SE3d start = SE3d::exp(draw(random, 0.2, 0.05)) * scene.T_camera_world;
      const PoseResult result = solve_pose(kCamera, start, scene.observations, options, inlier);
      REQUIRE(result.converged());
      REQUIRE(result.inliers == 100);
      // Pixels are floats: 1e-5 px.
      REQUIRE(distance(result.T_camera_world, scene.T_camera_world) < 2e-6);
    }
}

TEST_CASE("the covariance of a pose tells its true error", "[solve]") {
  std::vector<std::uint8_t> inlier;
  PoseWorkspace workspace;
  for (const PoseLoss loss : {PoseLoss::huber, PoseLoss::geman_mcclure}) {
    PoseOptions options;
    options.loss = loss;
    double sum = 0.0;
    constexpr int kRuns = 500;
    for (int k = 0; k < kRuns; ++k) {
      Random random(1000 + static_cast<std::uint64_t>(k));
      const Scene scene = make_scene(random, 300, 1.0);
      const SE3d start = SE3d::exp(draw(random, 0.05, 0.02)) * scene.T_camera_world;
      const PoseResult result =
          solve_pose(kCamera, start, scene.observations, options, inlier, nullptr, &workspace);
      REQUIRE(result.converged());
      sum += nees(scene.T_camera_world, result);
    }
    // The mean of 500 has a standard deviation of sqrt(12 / 500) = 0.15.
    CHECK(sum / kRuns == Approx(6.0).margin(0.5));
  }
}

TEST_CASE("the gate's share of the information is that of the integrals", "[solve]") {
  for (const double c : {1.0, 5.99, 7.81, 20.0})
    for (const int k : {2, 3}) {
      // Share of E[r_i^2] against that of E[1] within the gate, by the radial density r^(k-1) exp(-r^2 / 2).
      double squares = 0.0, ones = 0.0;
      constexpr int kSteps = 20000;
      for (int i = 0; i < kSteps; ++i) {
        const double r = (i + 0.5) / kSteps * std::sqrt(c);
        const double density = std::pow(r, k - 1) * std::exp(-0.5 * r * r);
        ones += density;
        squares += density * r * r / k;
      }
      CHECK(pose_detail::gated_information(k == 3, c) == Approx(squares / ones).epsilon(1e-6));
    }
}

TEST_CASE("two outliers among five observations do not spoil a pose", "[solve]") {
  std::vector<std::uint8_t> inlier;
  for (const PoseLoss loss : {PoseLoss::cauchy, PoseLoss::geman_mcclure, PoseLoss::tukey}) {
    PoseOptions options;
    options.loss = loss;
    double sum = 0.0;
    for (int k = 0; k < 100; ++k) {
      Random random(static_cast<std::uint64_t>(k));
      const Scene scene = make_scene(random, 300, 1.0, 0.4);
      const SE3d start = SE3d::exp(draw(random, 0.15, 0.08)) * scene.T_camera_world;
      const PoseResult result = solve_pose(kCamera, start, scene.observations, options, inlier);
      REQUIRE(result.usable());
      REQUIRE(nees(scene.T_camera_world, result) < 40.0);
      sum += nees(scene.T_camera_world, result);
      REQUIRE(result.inliers > 120);
      REQUIRE(result.inliers < 220);
      REQUIRE(result.inliers == std::count(inlier.begin(), inlier.end(), 1));
    }
    CHECK(sum / 100 == Approx(6.0).margin(1.3));
  }
}

TEST_CASE("points known badly along their rays weigh less", "[solve]") {
  // Truth: each point is off along a ray from a camera a metre aside, by what its spread says.
  std::vector<std::uint8_t> inlier;
  double with = 0.0, without = 0.0, error_with = 0.0, error_without = 0.0;
  constexpr int kRuns = 100;
  for (int k = 0; k < kRuns; ++k) {
    Random random(static_cast<std::uint64_t>(k));
    Scene scene = make_scene(random, 200, 1.0);
    const Vec3<double> other = scene.T_camera_world.inverse() * Vec3<double>(1.0, 0.0, 0.0);
    for (PoseObservation& o : scene.observations) {
      const Vec3<double> ray = o.p_world - other;
      const Vec3<double> spread = ray.normalized() * (0.01 * ray.squaredNorm());
      o.p_world += random.normal() * spread;
      o.p_world_spread = spread.cast<float>();
    }
    PoseOptions options;
    const PoseResult counted = solve_pose(kCamera, scene.T_camera_world, scene.observations, options, inlier);
    options.point_uncertainty = false;
    const PoseResult ignored = solve_pose(kCamera, scene.T_camera_world, scene.observations, options, inlier);
    with += nees(scene.T_camera_world, counted) / kRuns;
    without += nees(scene.T_camera_world, ignored) / kRuns;
    error_with += distance(scene.T_camera_world, counted.T_camera_world);
    error_without += distance(scene.T_camera_world, ignored.T_camera_world);
  }
  CHECK(with < 9.0);
  CHECK(without > 2.0 * with);
  CHECK(error_with < error_without);
}

TEST_CASE("a prior is honoured", "[solve]") {
  Random random(4);
  std::vector<std::uint8_t> inlier(3, 1);
  const SE3d T = SE3d::exp(draw(random, 3.0, 1.0));
  Mat6<double> root;
  for (int i = 0; i < 36; ++i) root.data()[i] = random.normal();
  PosePrior prior{T, root * root.transpose() + 10.0 * Mat6<double>::Identity()};

  SECTION("without observations it is returned with its covariance") {
    const PoseResult result =
        solve_pose(kCamera, SE3d::exp(draw(random, 0.5, 0.3)) * T, {}, PoseOptions{}, inlier, &prior);
    REQUIRE(result.converged());
    REQUIRE(inlier.empty());
    REQUIRE(distance(result.T_camera_world, T) < 1e-6);
    REQUIRE((result.covariance * prior.information - Mat6<double>::Identity()).norm() < 1e-6);
  }
  SECTION("with observations it shares in the error and the covariance") {
    double sum = 0.0;
    constexpr int kRuns = 200;
    for (int k = 0; k < kRuns; ++k) {
      const Scene scene = make_scene(random, 30, 1.0);
      // About as strong as 30 observations.
      prior.information = Mat6<double>::Identity();
      prior.information.topLeftCorner<3, 3>() *= 1.0 / (0.01 * 0.01);
      prior.information.bottomRightCorner<3, 3>() *= 1.0 / (0.001 * 0.001);
      prior.T_camera_world = SE3d::exp(draw(random, 0.01, 0.001)) * scene.T_camera_world;
      const PoseResult result =
          solve_pose(kCamera, prior.T_camera_world, scene.observations, PoseOptions{}, inlier, &prior);
      REQUIRE(result.converged());
      sum += nees(scene.T_camera_world, result);
    }
    CHECK(sum / kRuns == Approx(6.0).margin(0.9));
  }
  SECTION("one that leaves directions open is not enough alone") {
    prior.information.setZero();
    prior.information(0, 0) = 1.0;
    const PoseResult result = solve_pose(kCamera, T, {}, PoseOptions{}, inlier, &prior);
    REQUIRE(result.status == PoseStatus::degenerate);
    REQUIRE(result.T_camera_world.matrix() == T.matrix());
  }
}

TEST_CASE("what does not determine a pose is said, and the start is kept", "[solve]") {
  Random random(5);
  std::vector<std::uint8_t> inlier;
  PoseOptions options;
  const auto require_start = [&](const PoseResult& result, const SE3d& start, PoseStatus status) {
    REQUIRE(result.status == status);
    REQUIRE_FALSE(result.usable());
    REQUIRE(result.T_camera_world.matrix() == start.matrix());
    REQUIRE(result.covariance.allFinite());
    REQUIRE(result.inliers == 0);
    REQUIRE(std::count(inlier.begin(), inlier.end(), 1) == 0);
  };
  SECTION("nothing") { require_start(solve_pose(kCamera, {}, {}, options, inlier), {}, PoseStatus::too_few); }
  SECTION("too few") {
    const Scene scene = make_scene(random, 4, 0.0);
    require_start(solve_pose(kCamera, scene.T_camera_world, scene.observations, options, inlier),
                  scene.T_camera_world, PoseStatus::too_few);
  }
  SECTION("all behind") {
    const Scene scene = make_scene(random, 50, 0.0);
    const SE3d start = SE3d::exp((Vec6<double>() << 0, 0, -50, 0, 0, 0).finished()) * scene.T_camera_world;
    require_start(solve_pose(kCamera, start, scene.observations, options, inlier), start,
                  PoseStatus::too_few);
  }
  SECTION("one point, seen twenty times") {
    const Scene scene = make_scene(random, 1, 0.0);
    const std::vector<PoseObservation> same(20, scene.observations[0]);
    require_start(solve_pose(kCamera, scene.T_camera_world, same, options, inlier), scene.T_camera_world,
                  PoseStatus::degenerate);
  }
  SECTION("points on a line through the camera's sight leave a turn about it open") {
    std::vector<PoseObservation> line;
    for (int i = 1; i <= 20; ++i) {
      PoseObservation o;
      o.p_world = Vec3<double>(0.1, 0.05, 0.0) * i + Vec3<double>(0, 0, 3);
      const auto m = kCamera.project_stereo(o.p_world);
      o.u = static_cast<float>((*m)[0]);
      o.v = static_cast<float>((*m)[1]);
      o.u_right = static_cast<float>((*m)[2]);
      line.push_back(o);
    }
    require_start(solve_pose(kCamera, {}, line, options, inlier), {}, PoseStatus::degenerate);
  }
  SECTION("nothing but outliers") {
    Scene scene = make_scene(random, 100, 1.0, 1.0);
    options.min_inliers = 30;
    require_start(solve_pose(kCamera, scene.T_camera_world, scene.observations, options, inlier),
                  scene.T_camera_world, PoseStatus::too_few);
  }
}

TEST_CASE("numbers that are none are refused", "[solve]") {
  Random random(6);
  const Scene good = make_scene(random, 10, 1.0);
  std::vector<std::uint8_t> inlier;
  const auto refused = [&](const auto& change) {
    Scene scene = good;
    change(scene);
    try {
      solve_pose(kCamera, scene.T_camera_world, scene.observations, PoseOptions{}, inlier);
    } catch (const Error& error) {
      return error.kind() == ErrorKind::argument;
    }
    return false;
  };
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const float inf = std::numeric_limits<float>::infinity();
  CHECK(refused([&](Scene& s) { s.observations[3].p_world.y() = nan; }));
  CHECK(refused([&](Scene& s) { s.observations[3].u = inf; }));
  CHECK(refused([&](Scene& s) { s.observations[9].v = static_cast<float>(nan); }));
  CHECK(refused([&](Scene& s) { s.observations[9].u_right = static_cast<float>(nan); }));
  CHECK(refused([&](Scene& s) { s.observations[0].sigma = 0.0F; }));
  CHECK(refused([&](Scene& s) { s.observations[0].sigma = static_cast<float>(nan); }));
  CHECK(refused([&](Scene& s) {
    s.observations[0].u_right = 1.0F;
    s.observations[0].sigma_disparity = -1.0F;
  }));
  CHECK(refused([&](Scene& s) { s.T_camera_world = SE3d(SO3d(), Vec3<double>(nan, 0, 0)); }));
  CHECK_THROWS_AS(solve_pose({}, {}, good.observations, PoseOptions{}, inlier), Error);
}

TEST_CASE("the same input gives the same bits, with or without a workspace", "[solve]") {
  Random random(7);
  std::vector<std::uint8_t> inlier, inlier_again;
  PoseWorkspace workspace;
  for (const int count : {300, 41, 500}) {
    const Scene scene = make_scene(random, count, 1.0, 0.2);
    const SE3d start = SE3d::exp(draw(random, 0.1, 0.05)) * scene.T_camera_world;
    const PoseResult a =
        solve_pose(kCamera, start, scene.observations, PoseOptions{}, inlier, nullptr, &workspace);
    const PoseResult b = solve_pose(kCamera, start, scene.observations, PoseOptions{}, inlier_again);
    REQUIRE(a.T_camera_world.matrix() == b.T_camera_world.matrix());
    REQUIRE(a.covariance == b.covariance);
    REQUIRE(inlier == inlier_again);
  }
}

TEST_CASE("pose options are declared", "[solve]") {
  PoseOptions options;
  const OptionList list = list_options(options);
  REQUIRE(list.find("loss"));
  REQUIRE(list.find("gate"));
  REQUIRE_NOTHROW(check_options(options));
  options.tolerance = std::numeric_limits<double>::quiet_NaN();
  REQUIRE_THROWS_AS(check_options(options), Error);
}
