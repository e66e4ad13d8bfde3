// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
// Bundles beside Ceres with automatic derivatives, its own manifolds, loss and tolerances.
#include <ceres/ceres.h>

#include <Eigen/Cholesky>
#include <array>
#include <catch2/catch.hpp>
#include <cmath>
#include <deque>

#include "sweepkit/core/random.hpp"
#include "sweepkit/solve/bundle.hpp"

using namespace sweepkit;

namespace {

const RectifiedCamera kCamera{450.0, 320.5, 199.5, 0.11};
constexpr double kGateMono = 5.991464547107979, kGateStereo = 7.814727903251179, kGateRelative = 12.59;

using Pose = std::array<double, 7>;  // quaternion x y z w, translation
using PoseManifold = ceres::ProductManifold<ceres::EigenQuaternionManifold, ceres::EuclideanManifold<3>>;

template <class T>
Eigen::Matrix<T, 3, 1> to_camera(const T* x, const Eigen::Matrix<T, 3, 1>& p) {
  return Eigen::Map<const Eigen::Quaternion<T>>(x) * p + Eigen::Map<const Eigen::Matrix<T, 3, 1>>(x + 4);
}

struct Reprojection {
  BundleObservation o;
  template <class T>
  bool operator()(const T* pose, const T* point, const T* bias, T* r) const {
    const Eigen::Matrix<T, 3, 1> p = to_camera<T>(pose, Eigen::Map<const Eigen::Matrix<T, 3, 1>>(point));
    const T u = kCamera.focal * p.x() / p.z() + kCamera.cx;
    r[0] = (u - T(o.u)) / T(o.sigma);
    r[1] = (kCamera.focal * p.y() / p.z() + kCamera.cy - T(o.v)) / T(o.sigma);
    r[2] = T(0);
    if (!(o.u_right < 0.0F))
      r[2] = (kCamera.baseline * kCamera.focal / p.z() - (T(o.u) - T(o.u_right) - bias[0])) /
             T(o.sigma_disparity);
    return true;
  }
};

// The error's logarithm (rho, phi) to second order, which is enough where it is small.
struct Motion {
  SE3d T_b_a;
  Mat6<double> root;
  template <class T>
  bool operator()(const T* a, const T* b, T* r) const {
    const Eigen::Map<const Eigen::Quaternion<T>> q_a(a), q_b(b);
    const Eigen::Quaternion<T> q_ab = q_a * q_b.conjugate();
    const Eigen::Matrix<T, 3, 1> t_ab = Eigen::Map<const Eigen::Matrix<T, 3, 1>>(a + 4) -
                                        q_ab * Eigen::Map<const Eigen::Matrix<T, 3, 1>>(b + 4);
    const Eigen::Quaternion<T> q_m = T_b_a.rotation().quaternion().cast<T>();
    const Eigen::Quaternion<T> q = q_m * q_ab;
    const Eigen::Matrix<T, 3, 1> t = q_m * t_ab + T_b_a.translation().cast<T>();
    Eigen::Matrix<T, 3, 1> phi = T(2) * q.vec() / q.w();
    phi *= T(1) - phi.squaredNorm() / T(12);
    Eigen::Matrix<T, 6, 1> e;
    e.template head<3>() = t - phi.cross(t) / T(2) + phi.cross(phi.cross(t)) / T(12);
    e.template tail<3>() = phi;
    Eigen::Map<Eigen::Matrix<T, 6, 1>> out(r);
    out = root.cast<T>() * e;
    return true;
  }
};

struct Prior {
  double mean, sigma;
  template <class T>
  bool operator()(const T* bias, T* r) const {
    r[0] = (bias[0] - T(mean)) / T(sigma);
    return true;
  }
};

struct Reference {
  std::vector<Pose> poses;
  std::vector<Vec3<double>> points;
  double bias, cost;
};

Reference solve_reference(const BundleProblem& bundle) {
  Reference x{{}, bundle.points, bundle.disparity_bias, 0.0};
  for (const SE3d& T : bundle.T_camera_world) {
    const auto& q = T.rotation().quaternion();
    const auto& t = T.translation();
    x.poses.push_back({q.x(), q.y(), q.z(), q.w(), t.x(), t.y(), t.z()});
  }
  ceres::Problem problem;
  for (std::size_t k = 0; k < x.poses.size(); ++k) {
    problem.AddParameterBlock(x.poses[k].data(), 7, new PoseManifold);
    if (bundle.fixed[k]) problem.SetParameterBlockConstant(x.poses[k].data());
  }
  problem.AddParameterBlock(&x.bias, 1);
  if (bundle.disparity_bias_sigma > 0)
    problem.AddResidualBlock(new ceres::AutoDiffCostFunction<Prior, 1, 1>(
                                 new Prior{bundle.disparity_bias, bundle.disparity_bias_sigma}),
                             nullptr, &x.bias);
  else
    problem.SetParameterBlockConstant(&x.bias);
  for (const BundleObservation& o : bundle.observations)
    problem.AddResidualBlock(new ceres::AutoDiffCostFunction<Reprojection, 3, 7, 3, 1>(new Reprojection{o}),
                             new ceres::HuberLoss(std::sqrt(o.u_right < 0.0F ? kGateMono : kGateStereo)),
                             x.poses[static_cast<std::size_t>(o.pose)].data(),
                             x.points[static_cast<std::size_t>(o.point)].data(), &x.bias);
  for (const RelativePose& r : bundle.relative_poses)
    problem.AddResidualBlock(new ceres::AutoDiffCostFunction<Motion, 6, 7, 7>(
                                 new Motion{r.T_a_b.inverse(), r.information.llt().matrixU()}),
                             new ceres::HuberLoss(std::sqrt(kGateRelative)),
                             x.poses[static_cast<std::size_t>(r.a)].data(),
                             x.poses[static_cast<std::size_t>(r.b)].data());
  ceres::Solver::Options options;
  options.logging_type = ceres::SILENT;
  options.linear_solver_type = ceres::DENSE_SCHUR;
  options.max_num_iterations = 200;
  options.function_tolerance = options.gradient_tolerance = options.parameter_tolerance = 1e-15;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  x.cost = summary.final_cost;
  return x;
}

// A drive past points, some of them measured wrongly, some seen twice by the same pose, a few by one camera;
// odometry between neighbours, one of it wrong.
BundleProblem make_bundle(std::uint64_t seed, double bias_sigma) {
  Random random(seed);
  const auto small = [&](double rho, double phi) {
    Vec6<double> xi;
    for (int i = 0; i < 6; ++i) xi[i] = random.normal(0.0, i < 3 ? rho : phi);
    return SE3d::exp(xi);
  };
  BundleProblem bundle;
  bundle.disparity_bias_sigma = bias_sigma;
  for (int k = 0; k < 7; ++k) {
    bundle.T_camera_world.push_back(
        (SE3d(SO3d(), Vec3<double>(0.0, 0.0, 0.15 * k)) * small(0.03, 0.03)).inverse());
    bundle.fixed.push_back(k == 2);
  }
  for (int i = 0; i < 120; ++i) {
    const double z = random.uniform(2.0, 8.0);
    const Vec3<double> p(random.uniform(-0.5, 0.5) * z, random.uniform(-0.3, 0.3) * z, z);
    bundle.points.push_back(p);
    for (int k = 0; k < 7; ++k) {
      const auto m = kCamera.project_stereo(bundle.T_camera_world[static_cast<std::size_t>(k)] * p);
      if (!m || (k % 6 != 0 && random.uniform() < 0.5)) continue;
      for (int twice = 0; twice < (i % 17 == 0 ? 2 : 1); ++twice) {
        BundleObservation o{k, i};
        o.sigma = static_cast<float>(random.uniform(0.7, 2.0));
        o.sigma_disparity = 0.4F;
        o.u = static_cast<float>(random.normal((*m)[0], o.sigma));
        o.v = static_cast<float>(random.normal((*m)[1], o.sigma));
        if (random.uniform() < 0.7)
          o.u_right = static_cast<float>(o.u - random.normal((*m)[0] - (*m)[2] + 0.2, o.sigma_disparity));
        if (random.uniform() < 0.05) o.v += 25.0F;
        bundle.observations.push_back(o);
      }
    }
  }
  for (int k = 1; k < 7; ++k) {
    RelativePose r;
    r.a = k - 1;
    r.b = k;
    r.T_a_b = bundle.T_camera_world[static_cast<std::size_t>(k) - 1] *
              bundle.T_camera_world[static_cast<std::size_t>(k)].inverse() * small(0.005, 0.002);
    if (k == 4) r.T_a_b = r.T_a_b * small(0.05, 0.02);
    r.information.diagonal() << 4e4, 4e4, 4e4, 2.5e5, 2.5e5, 2.5e5;
    r.information(0, 4) = r.information(4, 0) = 3e4;
    bundle.relative_poses.push_back(r);
  }
  for (std::size_t k = 0; k < bundle.fixed.size(); ++k)
    if (!bundle.fixed[k]) bundle.T_camera_world[k] = small(0.02, 0.01) * bundle.T_camera_world[k];
  for (auto& p : bundle.points) p *= random.uniform(0.95, 1.05);
  return bundle;
}

}  // namespace

TEST_CASE("a bundle ends where Ceres ends", "[solve]") {
  for (const double bias_sigma : {0.0, 0.3})
    for (std::uint64_t seed = 1; seed <= 4; ++seed) {
      CAPTURE(bias_sigma, seed);
      BundleProblem bundle = make_bundle(seed, bias_sigma);
      const Reference reference = solve_reference(bundle);
      BundleOptions options;
      options.robust_iterations = 200;
      options.iterations = 0;
      options.function_tolerance = 0.0;
      const BundleResult result = solve_bundle(kCamera, bundle, options);
      CHECK(result.outliers > 0);
      CHECK(result.relative_outliers == 1);
      CHECK(std::abs(result.final_cost / reference.cost - 1.0) < 1e-6);
      CHECK(std::abs(bundle.disparity_bias - reference.bias) < 1e-4);
      for (std::size_t k = 0; k < bundle.fixed.size(); ++k) {
        const Pose& x = reference.poses[k];
        const SE3d T(SO3d(Eigen::Quaterniond(x[3], x[0], x[1], x[2])), Vec3<double>(x[4], x[5], x[6]));
        CHECK((T * bundle.T_camera_world[k].inverse()).log().norm() < 1e-4);
      }
      for (std::size_t i = 0; i < bundle.points.size(); ++i)
        CHECK((bundle.points[i] - reference.points[i]).norm() < 2e-3 * bundle.points[i].norm());
    }
}
