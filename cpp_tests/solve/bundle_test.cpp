// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/solve/bundle.hpp"

#include <Eigen/LU>
#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <limits>

#include "sweepkit/core/random.hpp"
#include "sweepkit/solve/motion_error.hpp"
#include "sweepkit/solve/reprojection.hpp"

using namespace sweepkit;

namespace {

const RectifiedCamera kCamera{450.0, 320.5, 199.5, 0.11};

Vec6<double> draw(Random& random, double rho, double phi) {
  Vec6<double> xi;
  for (int i = 0; i < 6; ++i) xi[i] = random.normal(0.0, i < 3 ? rho : phi);
  return xi;
}

double distance(const SE3d& a, const SE3d& b) { return (a * b.inverse()).log().norm(); }

// Cameras that go forward among points; the first pose is fixed.
BundleProblem make_truth(Random& random, int poses, int points, double noise, double outliers = 0.0) {
  BundleProblem problem;
  for (int k = 0; k < poses; ++k) {
    Vec6<double> xi = draw(random, 0.05, 0.02);
    xi[2] += 0.1 * k;
    problem.T_camera_world.push_back(SE3d::exp(xi).inverse());
    problem.fixed.push_back(k == 0);
  }
  for (int i = 0; i < points; ++i) {
    const double z = 0.1 * poses + random.uniform(1.0, 8.0);
    problem.points.emplace_back(random.uniform(-0.5, 0.5) * z, random.uniform(-0.4, 0.4) * z, z);
    for (int k = 0; k < poses; ++k) {
      // The first and the last pose see all, so that every point is determined.
      if (k != 0 && k != poses - 1 && random.uniform() < 0.4) continue;
      const auto m =
          kCamera.project_stereo(problem.T_camera_world[static_cast<std::size_t>(k)] * problem.points.back());
      if (!m) continue;
      BundleObservation o{k, i};
      o.sigma_disparity = 0.3F;
      o.u = static_cast<float>((*m)[0] + noise * random.normal());
      o.v = static_cast<float>((*m)[1] + noise * random.normal());
      const double disparity = (*m)[0] - (*m)[2] + noise * o.sigma_disparity * random.normal();
      if (random.uniform() < 0.6) o.u_right = static_cast<float>(o.u - disparity);
      if (random.uniform() < outliers) o.v += static_cast<float>(random.uniform(15.0, 60.0));
      if (o.u_right < 0.0F) o.u_right = -1.0F;
      problem.observations.push_back(o);
    }
  }
  return problem;
}

BundleProblem disturb(const BundleProblem& truth, Random& random, double poses, double points) {
  BundleProblem problem = truth;
  for (std::size_t k = 0; k < problem.fixed.size(); ++k)
    if (!problem.fixed[k])
      problem.T_camera_world[k] = SE3d::exp(draw(random, poses, 0.5 * poses)) * problem.T_camera_world[k];
  for (auto& p : problem.points) p += points * draw(random, 1.0, 1.0).head<3>();
  return problem;
}

double worst_pose(const BundleProblem& a, const BundleProblem& b) {
  double worst = 0.0;
  for (std::size_t k = 0; k < a.T_camera_world.size(); ++k)
    worst = std::max(worst, distance(a.T_camera_world[k], b.T_camera_world[k]));
  return worst;
}

bool same_bits(const SE3d& a, const SE3d& b) {
  return a.translation() == b.translation() &&
         a.rotation().quaternion().coeffs() == b.rotation().quaternion().coeffs();
}

double mean(const std::vector<double>& values) {
  double sum = 0.0;
  for (const double v : values) sum += v;
  return sum / static_cast<double>(values.size());
}

}  // namespace

TEST_CASE("a bundle without noise comes back to the truth", "[solve]") {
  Random random(1);
  const BundleProblem truth = make_truth(random, 6, 200, 0.0);
  BundleProblem problem = disturb(truth, random, 0.03, 0.1);
  BundleOptions options;
  options.robust_iterations = 30;
  options.function_tolerance = 0.0;
  const BundleResult result = solve_bundle(kCamera, problem, options);
  REQUIRE(result.usable);
  REQUIRE(result.outliers == 0);
  REQUIRE(result.final_cost < 1e-4 * result.initial_cost);
  // Pixels are floats: 1e-5 px.
  REQUIRE(worst_pose(problem, truth) < 1e-5);
  for (std::size_t i = 0; i < truth.points.size(); ++i)
    REQUIRE((problem.points[i] - truth.points[i]).norm() < 1e-3);
  // The fixed pose: to the last bit.
  REQUIRE(same_bits(problem.T_camera_world[0], truth.T_camera_world[0]));
}

TEST_CASE("a bundle with noise and outliers comes near the truth and names the outliers", "[solve]") {
  Random random(2);
  BundleProblem truth = make_truth(random, 8, 400, 1.0, 0.05);
  BundleProblem problem = disturb(truth, random, 0.03, 0.1);
  const BundleResult result = solve_bundle(kCamera, problem, BundleOptions{});
  REQUIRE(result.usable);
  CHECK(worst_pose(problem, truth) < 0.02);
  const auto count = static_cast<int>(truth.observations.size());
  // 5 % put there, and some of the good ones beyond the 95 % gate.
  CHECK(result.outliers > count / 25);
  CHECK(result.outliers < count / 8);
  int gross = 0, found = 0;
  for (std::size_t i = 0; i < truth.observations.size(); ++i) {
    const BundleObservation& o = truth.observations[i];
    const auto m = kCamera.project(truth.T_camera_world[static_cast<std::size_t>(o.pose)] *
                                   truth.points[static_cast<std::size_t>(o.point)]);
    if (std::abs((*m)[1] - o.v) < 10.0) continue;
    ++gross;
    found += result.outlier[i];
  }
  CHECK(gross > 50);
  // A point with two views and one of them wrong cannot tell which.
  CHECK(found > 0.95 * gross);
}

TEST_CASE("what is left at the minimum is what the noise puts there", "[solve]") {
  Random random(3);
  const BundleProblem truth = make_truth(random, 6, 300, 1.0);
  BundleProblem problem = truth;
  BundleOptions options;
  options.gate = 100.0;  // plain least squares
  options.robust_iterations = 50;
  options.function_tolerance = 1e-10;
  const BundleResult result = solve_bundle(kCamera, problem, options);
  int residuals = 0;
  for (const BundleObservation& o : truth.observations) residuals += o.u_right < 0.0F ? 2 : 3;
  const double freedom = residuals - 3.0 * 300 - 6.0 * 5;
  // Chi-square: within four standard deviations.
  CHECK(std::abs(2.0 * result.final_cost - freedom) < 4.0 * std::sqrt(2.0 * freedom));
  REQUIRE(result.converged);
}

TEST_CASE("the gradient vanishes at the minimum of a bundle", "[solve]") {
  Random random(4);
  BundleProblem problem = make_truth(random, 4, 60, 1.0);
  BundleOptions options;
  options.gate = 100.0;
  options.robust_iterations = 100;
  options.function_tolerance = 1e-14;
  solve_bundle(kCamera, problem, options);
  std::vector<Vec6<double>> pose_gradient(4, Vec6<double>::Zero());
  std::vector<Vec3<double>> point_gradient(60, Vec3<double>::Zero());
  double scale = 0.0;
  for (const BundleObservation& o : problem.observations) {
    const SE3d& T = problem.T_camera_world[static_cast<std::size_t>(o.pose)];
    Vec3<double> r;
    Eigen::Matrix<double, 3, 6> J_pose;
    Mat3<double> J_point;
    REQUIRE(reprojection_error(kCamera, T.rotation().matrix(), T.translation(),
                               problem.points[static_cast<std::size_t>(o.point)], o.u, o.v,
                               static_cast<double>(o.u) - o.u_right, r, &J_pose, &J_point));
    const double d =
        o.u_right < 0.0F ? 0.0 : 1.0 / (static_cast<double>(o.sigma_disparity) * o.sigma_disparity);
    r = r.cwiseProduct(Vec3<double>(1, 1, d));
    pose_gradient[static_cast<std::size_t>(o.pose)] += J_pose.transpose() * r;
    point_gradient[static_cast<std::size_t>(o.point)] += J_point.transpose() * r;
    scale += (J_pose.transpose() * r).norm();
  }
  for (std::size_t k = 1; k < 4; ++k) CHECK(pose_gradient[k].norm() < 1e-4 * scale);
  for (const auto& g : point_gradient) CHECK(g.norm() < 1e-4 * scale);
}

TEST_CASE("the same bundle gives the same bits", "[solve]") {
  Random random(5);
  const BundleProblem truth = make_truth(random, 6, 200, 1.0, 0.05);
  const BundleProblem start = disturb(truth, random, 0.03, 0.1);
  BundleProblem a = start, b = start;
  const BundleResult result_a = solve_bundle(kCamera, a, BundleOptions{});
  const BundleResult result_b = solve_bundle(kCamera, b, BundleOptions{});
  REQUIRE(result_a.final_cost == result_b.final_cost);
  REQUIRE(result_a.outlier == result_b.outlier);
  REQUIRE(a.points == b.points);
  for (std::size_t k = 0; k < a.fixed.size(); ++k)
    REQUIRE(same_bits(a.T_camera_world[k], b.T_camera_world[k]));
}

TEST_CASE("relative poses tie poses together", "[solve]") {
  Random random(7);
  SECTION("alone they give the chain of motions") {
    BundleProblem problem;
    std::vector<SE3d> truth{SE3d::exp(draw(random, 1.0, 0.5))};
    for (int k = 0; k < 4; ++k) {
      const SE3d T_a_b = SE3d::exp(draw(random, 0.5, 0.3));
      truth.push_back(T_a_b.inverse() * truth.back());
      problem.relative_poses.push_back({k, k + 1, T_a_b, Mat6<double>::Identity() * 100.0});
    }
    problem.T_camera_world = truth;
    problem.fixed = {1, 0, 0, 0, 0};
    for (std::size_t k = 1; k < truth.size(); ++k)
      problem.T_camera_world[k] = SE3d::exp(draw(random, 0.2, 0.2)) * truth[k];
    BundleOptions options;
    options.robust_iterations = 50;
    options.function_tolerance = 1e-14;
    const BundleResult result = solve_bundle(kCamera, problem, options);
    REQUIRE(result.usable);
    for (std::size_t k = 0; k < truth.size(); ++k)
      REQUIRE(distance(problem.T_camera_world[k], truth[k]) < 1e-6);
  }
  SECTION("two that contradict meet by their information") {
    BundleProblem problem;
    problem.T_camera_world.resize(2);
    problem.fixed = {1, 0};
    const Vec6<double> x = Vec6<double>::Unit(0);
    problem.relative_poses.push_back({0, 1, SE3d::exp(0.0 * x), Mat6<double>::Identity() * 1.0});
    problem.relative_poses.push_back({0, 1, SE3d::exp(0.4 * x), Mat6<double>::Identity() * 3.0});
    BundleOptions options;
    options.robust_iterations = 50;
    options.function_tolerance = 1e-14;
    solve_bundle(kCamera, problem, options);
    REQUIRE(distance(problem.T_camera_world[1], SE3d::exp(-0.3 * x)) < 1e-6);
  }
  SECTION("beside observations they take part of the error away") {
    std::vector<double> without, with;
    for (int run = 0; run < 10; ++run) {
      BundleProblem truth = make_truth(random, 4, 25, 1.0);
      BundleProblem a = disturb(truth, random, 0.01, 0.02), b = a;
      for (int k = 0; k < 3; ++k) {
        const auto i = static_cast<std::size_t>(k);
        const SE3d T_a_b = truth.T_camera_world[i] * truth.T_camera_world[i + 1].inverse();
        b.relative_poses.push_back(
            {k, k + 1, T_a_b * SE3d::exp(draw(random, 1e-3, 1e-3)), Mat6<double>::Identity() * 1e6});
      }
      solve_bundle(kCamera, a, BundleOptions{});
      solve_bundle(kCamera, b, BundleOptions{});
      without.push_back(worst_pose(a, truth));
      with.push_back(worst_pose(b, truth));
    }
    CHECK(mean(with) < 0.5 * mean(without));
  }
  SECTION("directions without information stay open") {
    BundleProblem problem;
    problem.T_camera_world.resize(2);
    problem.fixed = {1, 0};
    Mat6<double> without_y = Mat6<double>::Identity() * 1e4;
    without_y(1, 1) = 0.0;
    problem.relative_poses.push_back(
        {0, 1, SE3d::exp((Vec6<double>() << 0.1, 0.7, 0.2, 0, 0, 0).finished()), without_y});
    const BundleResult result = solve_bundle(kCamera, problem, BundleOptions{});
    REQUIRE(result.usable);
    REQUIRE(result.final_cost < 1e-9);
    // All but y, which may be anything.
    const SE3d T_a_b = problem.T_camera_world[1].inverse();
    CHECK(T_a_b.translation().x() == Approx(0.1).margin(1e-5));
    CHECK(T_a_b.translation().z() == Approx(0.2).margin(1e-5));
    CHECK(T_a_b.rotation().angle() < 1e-5);
    CHECK(std::isfinite(T_a_b.translation().y()));
  }
}

TEST_CASE("what little a bundle may hold is taken as it is", "[solve]") {
  Random random(8);
  SECTION("nothing at all") {
    BundleProblem problem;
    const BundleResult result = solve_bundle(kCamera, problem, BundleOptions{});
    REQUIRE(result.usable);
    REQUIRE(result.iterations == 0);
  }
  SECTION("no observations") {
    BundleProblem problem = make_truth(random, 3, 10, 0.0);
    problem.observations.clear();
    const BundleProblem before = problem;
    REQUIRE(solve_bundle(kCamera, problem, BundleOptions{}).usable);
    REQUIRE(problem.points == before.points);
    for (std::size_t k = 0; k < 3; ++k)
      REQUIRE(same_bits(problem.T_camera_world[k], before.T_camera_world[k]));
  }
  SECTION("a point that one left camera alone sees") {
    BundleProblem problem = make_truth(random, 4, 50, 0.5);
    problem.points.emplace_back(0.3, 0.2, 4.0);
    problem.observations.push_back({1, 50, 300.0F, 200.0F});
    const BundleResult result = solve_bundle(kCamera, problem, BundleOptions{});
    REQUIRE(result.usable);
    REQUIRE(result.unused == 1);
    REQUIRE(problem.points[50] == Vec3<double>(0.3, 0.2, 4.0));
  }
  SECTION("a point behind a camera") {
    BundleProblem problem = make_truth(random, 4, 50, 0.5);
    problem.points.emplace_back(0.0, 0.0, -4.0);
    for (int k = 0; k < 3; ++k) problem.observations.push_back({k, 50, 300.0F, 200.0F, 280.0F});
    const BundleProblem before = problem;
    const BundleResult result = solve_bundle(kCamera, problem, BundleOptions{});
    REQUIRE(result.usable);
    for (std::size_t k = result.outlier.size() - 3; k < result.outlier.size(); ++k)
      REQUIRE(result.outlier[k]);
    REQUIRE(worst_pose(problem, before) < 0.05);
  }
  SECTION("points only, all poses fixed") {
    const BundleProblem truth = make_truth(random, 4, 50, 0.0);
    BundleProblem problem = truth;
    problem.fixed.assign(4, 1);
    for (auto& p : problem.points) p.z() += 0.1;
    BundleOptions options;
    options.robust_iterations = 30;
    options.function_tolerance = 1e-12;
    REQUIRE(solve_bundle(kCamera, problem, options).usable);
    for (std::size_t i = 0; i < truth.points.size(); ++i)
      CHECK((problem.points[i] - truth.points[i]).norm() < 1e-3);
    for (std::size_t k = 0; k < 4; ++k)
      REQUIRE(same_bits(problem.T_camera_world[k], truth.T_camera_world[k]));
  }
}

TEST_CASE("a bundle asked to stop stops", "[solve]") {
  Random random(9);
  BundleProblem problem = disturb(make_truth(random, 5, 100, 1.0), random, 0.03, 0.1);
  const BundleProblem before = problem;
  const std::atomic<bool> stop = true;
  const BundleResult result = solve_bundle(kCamera, problem, BundleOptions{}, &stop);
  REQUIRE(result.stopped);
  REQUIRE(result.usable);
  REQUIRE(result.iterations == 0);
  REQUIRE(worst_pose(problem, before) < 1e-12);
}

TEST_CASE("wrong bundles are refused", "[solve]") {
  Random random(10);
  const BundleProblem good = make_truth(random, 3, 20, 1.0);
  const auto refused = [&](const auto& change) {
    BundleProblem problem = good;
    change(problem);
    try {
      solve_bundle(kCamera, problem, BundleOptions{});
    } catch (const Error& error) {
      return error.kind() == ErrorKind::argument;
    }
    return false;
  };
  const double nan = std::numeric_limits<double>::quiet_NaN();
  CHECK_FALSE(refused([](BundleProblem&) {}));
  CHECK(refused([&](BundleProblem& p) { p.points[7].x() = nan; }));
  CHECK(refused([&](BundleProblem& p) { p.T_camera_world[2] = SE3d(SO3d(), Vec3<double>(0, nan, 0)); }));
  CHECK(refused([&](BundleProblem& p) { p.observations[3].u = static_cast<float>(nan); }));
  CHECK(refused([&](BundleProblem& p) { p.observations[3].u_right = static_cast<float>(nan); }));
  CHECK(refused([&](BundleProblem& p) { p.observations[3].sigma = 0.0F; }));
  CHECK(refused([&](BundleProblem& p) { p.observations[3].pose = 3; }));
  CHECK(refused([&](BundleProblem& p) { p.observations[3].point = -1; }));
  CHECK(refused([&](BundleProblem& p) { p.fixed.pop_back(); }));
  CHECK(refused([&](BundleProblem& p) { p.fixed.assign(3, 0); }));
  CHECK(refused([&](BundleProblem& p) { p.relative_poses.push_back({0, 0, {}, Mat6<double>::Identity()}); }));
  CHECK(refused([&](BundleProblem& p) { p.relative_poses.push_back({0, 5, {}, Mat6<double>::Identity()}); }));
  CHECK(refused([&](BundleProblem& p) {
    p.relative_poses.push_back({0, 1, {}, Mat6<double>::Constant(nan)});
  }));
}

TEST_CASE("bundle options are declared", "[solve]") {
  BundleOptions options;
  REQUIRE(list_options(options).find("function_tolerance"));
  REQUIRE_NOTHROW(check_options(options));
}

TEST_CASE("a common error of all disparities is told apart from depth by motion", "[solve]") {
  Random random(71);
  for (const double bias : {-0.3, 0.2}) {
    const BundleProblem truth = make_truth(random, 8, 400, 0.1);
    BundleProblem problem = disturb(truth, random, 0.01, 0.02);
    for (BundleObservation& o : problem.observations)
      if (o.u_right > 0.0F) o.u_right -= static_cast<float>(bias);
    BundleProblem trusting = problem;
    problem.disparity_bias_sigma = 1.0;
    BundleOptions options;
    options.robust_iterations = options.iterations = 30;
    options.function_tolerance = 1e-12;
    REQUIRE(solve_bundle(kCamera, problem, options).usable);
    REQUIRE(solve_bundle(kCamera, trusting, options).usable);
    CHECK(problem.disparity_bias == Approx(bias).margin(0.03));
    CHECK(trusting.disparity_bias == 0.0);
    CHECK(worst_pose(problem, truth) < 0.3 * worst_pose(trusting, truth));

    // A bias that is known already counts as if it had been taken off.
    BundleProblem known = trusting;
    known.disparity_bias = bias;
    REQUIRE(solve_bundle(kCamera, known, options).usable);
    CHECK(known.disparity_bias == bias);
    CHECK(worst_pose(known, truth) < 0.3 * worst_pose(trusting, truth));
  }
}

TEST_CASE("without motion a bias of disparities stays what it was thought to be", "[solve]") {
  Random random(72);
  BundleProblem truth = make_truth(random, 2, 200, 0.1);
  truth.T_camera_world[1] = truth.T_camera_world[0];
  std::erase_if(truth.observations, [](const BundleObservation& o) { return o.pose == 1; });
  BundleProblem problem = truth;
  for (BundleObservation& o : problem.observations)
    if (o.u_right > 0.0F) o.u_right -= 0.2F;
  problem.disparity_bias = 0.05;
  problem.disparity_bias_sigma = 0.1;
  REQUIRE(solve_bundle(kCamera, problem, {}).usable);
  CHECK(problem.disparity_bias == Approx(0.05).margin(1e-3));
}

TEST_CASE("a relative pose that contradicts what is seen is left out", "[solve]") {
  Random random(81);
  const BundleProblem truth = make_truth(random, 6, 150, 0.5);
  BundleProblem plain = disturb(truth, random, 0.01, 0.02), slipped = plain;
  BundleOptions options;
  options.robust_iterations = options.iterations = 20;
  for (int k = 0; k < 5; ++k) {
    const auto i = static_cast<std::size_t>(k);
    const SE3d T_a_b = truth.T_camera_world[i] * truth.T_camera_world[i + 1].inverse();
    RelativePose relative{k, k + 1, T_a_b * SE3d::exp(draw(random, 2e-3, 1e-3)), Mat6<double>::Zero()};
    relative.information.diagonal() << 2.5e5, 2.5e5, 2.5e5, 1e6, 1e6, 1e6;
    plain.relative_poses.push_back(relative);
    // Wheels slipped by 15 cm between the third and the fourth.
    if (k == 2) relative.T_a_b = relative.T_a_b * SE3d::exp(0.15 * Vec6<double>::Unit(2));
    slipped.relative_poses.push_back(relative);
  }
  const BundleResult of_plain = solve_bundle(kCamera, plain, options);
  const BundleResult of_slipped = solve_bundle(kCamera, slipped, options);
  REQUIRE((of_plain.usable && of_slipped.usable));
  CHECK(of_plain.relative_outliers == 0);
  CHECK(of_slipped.relative_outliers == 1);
  // As if it had not been there.
  BundleProblem without = slipped;
  without.relative_poses.erase(without.relative_poses.begin() + 2);
  solve_bundle(kCamera, without, options);
  CHECK(worst_pose(slipped, without) < 1e-3);
  CHECK(worst_pose(slipped, truth) < worst_pose(plain, truth) + 5e-3);
}

TEST_CASE("what is known of a common error of disparities is what a dense solution says", "[solve]") {
  Random random(91);
  for (const bool tied : {false, true}) {
    CAPTURE(tied);
    const BundleProblem truth = make_truth(random, 4, 25, 0.05);
    BundleProblem problem = truth;
    if (tied)
      for (int k = 0; k < 3; ++k) {
        const auto i = static_cast<std::size_t>(k);
        RelativePose relative{k, k + 1, truth.T_camera_world[i] * truth.T_camera_world[i + 1].inverse(), {}};
        relative.information = 1e5 * Mat6<double>::Identity();
        problem.relative_poses.push_back(relative);
      }
    problem.disparity_bias_sigma = 0.5;
    BundleOptions options;
    options.robust_iterations = options.iterations = 30;
    options.gate = 100;
    options.function_tolerance = 1e-12;
    const BundleResult result = solve_bundle(kCamera, problem, options);
    REQUIRE(result.usable);
    REQUIRE(result.outliers == 0);
    REQUIRE(result.unused == 0);

    // All unknowns in one: poses 1..3, points, bias. Jacobian of the weighted residuals by central
    // differences of the projection.
    const int poses = 3, points = static_cast<int>(problem.points.size());
    const int n = 6 * poses + 3 * points + 1;
    const auto residuals = [&](const Eigen::VectorXd& x) {
      std::vector<double> e;
      std::vector<SE3d> T = problem.T_camera_world;
      for (int k = 0; k < poses; ++k) {
        const auto i = static_cast<std::size_t>(k + 1);
        T[i] = SE3d::exp(Vec6<double>(x.segment<6>(6 * k))) * T[i];
      }
      for (const BundleObservation& o : problem.observations) {
        const Vec3<double> p =
            problem.points[static_cast<std::size_t>(o.point)] + x.segment<3>(6 * poses + 3 * o.point);
        const auto uvr = *kCamera.project_stereo(T[static_cast<std::size_t>(o.pose)] * p);
        e.push_back((uvr[0] - o.u) / o.sigma);
        e.push_back((uvr[1] - o.v) / o.sigma);
        if (o.u_right >= 0)
          e.push_back((uvr[0] - uvr[2] + problem.disparity_bias + x[n - 1] - (o.u - o.u_right)) /
                      o.sigma_disparity);
      }
      for (const RelativePose& r : problem.relative_poses) {
        const Vec6<double> d =
            relative_pose_error(T[static_cast<std::size_t>(r.a)], T[static_cast<std::size_t>(r.b)], r.T_a_b);
        for (int k = 0; k < 6; ++k) e.push_back(std::sqrt(r.information(k, k)) * d[k]);
      }
      return Eigen::VectorXd(Eigen::Map<Eigen::VectorXd>(e.data(), static_cast<Eigen::Index>(e.size())));
    };
    const Eigen::Index m = residuals(Eigen::VectorXd::Zero(n)).size();
    Eigen::MatrixXd J(m, n);
    constexpr double h = 1e-5;
    for (int k = 0; k < n; ++k) {
      Eigen::VectorXd x = Eigen::VectorXd::Zero(n);
      x[k] = h;
      const Eigen::VectorXd ahead = residuals(x);
      x[k] = -h;
      J.col(k) = (ahead - residuals(x)) / (2 * h);
    }
    const Eigen::MatrixXd H = J.transpose() * J;
    // What is left of the bias's information when all others are unknown: one over its variance.
    const double expected = 1.0 / H.inverse()(n - 1, n - 1);
    CHECK(expected > 0);
    CHECK(result.disparity_bias_information == Approx(expected).epsilon(1e-3));
  }
}
