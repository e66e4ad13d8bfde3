// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/solve/bundle.hpp"

#include <ceres/ceres.h>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <array>
#include <cmath>
#include <deque>
#include <memory>

#include "sweepkit/core/error.hpp"
#include "sweepkit/solve/motion_error.hpp"
#include "sweepkit/solve/reprojection.hpp"

namespace sweepkit {
namespace {

constexpr double kGateMono = 5.991464547107979;  // chi-square, 95 %, 2 degrees of freedom
constexpr double kGateRelative = 12.59;
constexpr double kGateStereo = 7.814727903251179;  // and 3

// A pose as Ceres holds it: x y z of the translation, x y z w of the quaternion.
using PoseBlock = std::array<double, 7>;

PoseBlock to_block(const SE3d& T) {
  const Vec3<double>& t = T.translation();
  const Eigen::Quaterniond& q = T.rotation().quaternion();
  return {t.x(), t.y(), t.z(), q.x(), q.y(), q.z(), q.w()};
}

SE3d to_motion(const double* x) {
  return {SO3d(Eigen::Quaterniond(x[6], x[3], x[4], x[5])), Vec3<double>(x[0], x[1], x[2])};
}

// T <- Exp(xi) T. The cost functions below give derivatives by xi in the first six of the seven columns and
// zeros in the last, so Plus has the identity there: no chain through the quaternion is ever computed.
class MotionManifold final : public ceres::Manifold {
 public:
  int AmbientSize() const override { return 7; }
  int TangentSize() const override { return 6; }
  bool Plus(const double* x, const double* delta, double* x_plus_delta) const override {
    const PoseBlock block = to_block(SE3d::exp(Eigen::Map<const Vec6<double>>(delta)) * to_motion(x));
    std::copy(block.begin(), block.end(), x_plus_delta);
    return true;
  }
  bool PlusJacobian(const double*, double* jacobian) const override {
    Eigen::Map<Eigen::Matrix<double, 7, 6, Eigen::RowMajor>> J(jacobian);
    J.setIdentity();
    return true;
  }
  bool Minus(const double* y, const double* x, double* y_minus_x) const override {
    Eigen::Map<Vec6<double>> delta(y_minus_x);
    delta = (to_motion(y) * to_motion(x).inverse()).log();
    return true;
  }
  bool MinusJacobian(const double*, double* jacobian) const override {
    Eigen::Map<Eigen::Matrix<double, 6, 7, Eigen::RowMajor>> J(jacobian);
    J.setIdentity();
    return true;
  }
};

// Rows 2: u and v; 3: the disparity too. Parameters are the pose, the point and, as Shared, the bias of
// disparities. Switched off it is zero whatever the parameters.
template <int Rows, int... Shared>
class ReprojectionCost final : public ceres::SizedCostFunction<Rows, 7, 3, Shared...> {
  static constexpr bool kBias = sizeof...(Shared) > 0;

 public:
  /// @param disparity_bias where it is no parameter
  ReprojectionCost(const RectifiedCamera& camera, const BundleObservation& o, double disparity_bias = 0.0)
      : camera_(camera),
        u_(o.u),
        v_(o.v),
        disparity_(static_cast<double>(o.u) - o.u_right - disparity_bias),
        weight_(1.0 / o.sigma),
        weight_disparity_(1.0 / o.sigma_disparity) {}

  void switch_off() { on_ = false; }

  bool Evaluate(const double* const* parameters, double* residuals, double** jacobians) const override {
    Eigen::Map<Eigen::Matrix<double, Rows, 1>> r(residuals);
    const bool need_pose = jacobians && jacobians[0], need_point = jacobians && jacobians[1];
    const double* x = parameters[0];
    const Mat3<double> R = Eigen::Quaterniond(x[6], x[3], x[4], x[5]).toRotationMatrix();
    Vec3<double> errors;
    Eigen::Matrix<double, 3, 6> J_pose;
    Mat3<double> J_point;
    double disparity = disparity_;
    if constexpr (kBias) disparity -= parameters[2][0];
    const bool in_front =
        on_ && reprojection_error(camera_, R, Vec3<double>(x[0], x[1], x[2]),
                                  Eigen::Map<const Vec3<double>>(parameters[1]), u_, v_, disparity, errors,
                                  need_pose ? &J_pose : nullptr, need_point ? &J_point : nullptr);
    Eigen::Matrix<double, Rows, 1> weights = Eigen::Matrix<double, Rows, 1>::Constant(weight_);
    if constexpr (Rows == 3) weights[2] = weight_disparity_;
    if (!in_front) {
      // Behind the camera an observation costs ten standard deviations beyond all gates, but pulls no more.
      r.setConstant(on_ ? 30.0 : 0.0);
      errors.setZero();
      J_pose.setZero();
      J_point.setZero();
    } else {
      r = weights.cwiseProduct(errors.template head<Rows>());
    }
    if (need_pose) {
      Eigen::Map<Eigen::Matrix<double, Rows, 7, Eigen::RowMajor>> J(jacobians[0]);
      J.template leftCols<6>() = weights.asDiagonal() * J_pose.template topRows<Rows>();
      J.col(6).setZero();
    }
    if (need_point) {
      Eigen::Map<Eigen::Matrix<double, Rows, 3, Eigen::RowMajor>> J(jacobians[1]);
      J = weights.asDiagonal() * J_point.template topRows<Rows>();
    }
    if constexpr (kBias) {
      if (jacobians && jacobians[2]) {
        Eigen::Map<Eigen::Matrix<double, Rows, 1>> J(jacobians[2]);
        J.setZero();
        if (in_front) J[2] = weight_disparity_;
      }
    }
    return true;
  }

 private:
  RectifiedCamera camera_;
  double u_, v_, disparity_, weight_, weight_disparity_;
  bool on_ = true;
};

// Holds the bias of disparities near what was known of it.
class BiasPriorCost final : public ceres::SizedCostFunction<1, 1> {
 public:
  BiasPriorCost(double mean, double sigma) : mean_(mean), weight_(1.0 / sigma) {}
  bool Evaluate(const double* const* parameters, double* residuals, double** jacobians) const override {
    residuals[0] = weight_ * (parameters[0][0] - mean_);
    if (jacobians && jacobians[0]) jacobians[0][0] = weight_;
    return true;
  }

 private:
  double mean_, weight_;
};

class RelativePoseCost final : public ceres::SizedCostFunction<6, 7, 7> {
 public:
  explicit RelativePoseCost(const RelativePose& factor) : T_a_b_(factor.T_a_b) {
    // A root that also takes directions without information.
    const Eigen::SelfAdjointEigenSolver<Mat6<double>> eigen(factor.information);
    root_ = eigen.eigenvalues().cwiseMax(0.0).cwiseSqrt().asDiagonal() * eigen.eigenvectors().transpose();
  }

  void switch_off() { root_.setZero(); }

  bool Evaluate(const double* const* parameters, double* residuals, double** jacobians) const override {
    Mat6<double> J_a, J_b;
    Eigen::Map<Vec6<double>> r(residuals);
    r = root_ * relative_pose_error(to_motion(parameters[0]), to_motion(parameters[1]), T_a_b_,
                                    jacobians ? &J_a : nullptr, jacobians ? &J_b : nullptr);
    for (int i = 0; jacobians && i < 2; ++i) {
      if (!jacobians[i]) continue;
      Eigen::Map<Eigen::Matrix<double, 6, 7, Eigen::RowMajor>> J(jacobians[i]);
      J.leftCols<6>() = root_ * (i == 0 ? J_a : J_b);
      J.col(6).setZero();
    }
    return true;
  }

 private:
  SE3d T_a_b_;
  Mat6<double> root_;
};

class StopCallback final : public ceres::IterationCallback {
 public:
  explicit StopCallback(const std::atomic<bool>& stop) : stop_(stop) {}
  ceres::CallbackReturnType operator()(const ceres::IterationSummary&) override {
    return stop_.load(std::memory_order_relaxed) ? ceres::SOLVER_TERMINATE_SUCCESSFULLY
                                                 : ceres::SOLVER_CONTINUE;
  }

 private:
  const std::atomic<bool>& stop_;
};

void check(const RectifiedCamera& camera, const BundleProblem& problem) {
  require(camera.focal > 0.0 && std::isfinite(camera.focal + camera.cx + camera.cy + camera.baseline),
          "solve_bundle camera", "must be finite with a positive focal length", camera.focal);
  const std::size_t poses = problem.T_camera_world.size();
  require(problem.fixed.size() == poses, "solve_bundle fixed", "must have an entry for each pose",
          problem.fixed.size());
  for (std::size_t i = 0; i < poses; ++i)
    require(problem.T_camera_world[i].matrix().allFinite(), "solve_bundle T_camera_world", "must be finite",
            i);
  for (std::size_t i = 0; i < problem.points.size(); ++i)
    require(problem.points[i].allFinite(), "solve_bundle points", "must be finite", i);
  const auto is_pose = [&](int i) { return i >= 0 && static_cast<std::size_t>(i) < poses; };
  for (const BundleObservation& o : problem.observations) {
    require(is_pose(o.pose), "solve_bundle observation pose", "must be one of the poses", o.pose);
    require(o.point >= 0 && static_cast<std::size_t>(o.point) < problem.points.size(),
            "solve_bundle observation point", "must be one of the points", o.point);
    require(std::isfinite(o.u + o.v + o.u_right), "solve_bundle observation", "must be finite",
            &o - problem.observations.data());
    require(o.sigma > 0.0F && std::isfinite(o.sigma), "solve_bundle sigma", "must be positive", o.sigma);
    require(o.u_right < 0.0F || (o.sigma_disparity > 0.0F && std::isfinite(o.sigma_disparity)),
            "solve_bundle sigma_disparity", "must be positive", o.sigma_disparity);
  }
  require(std::isfinite(problem.disparity_bias) && std::isfinite(problem.disparity_bias_sigma) &&
              problem.disparity_bias_sigma >= 0.0,
          "solve_bundle disparity_bias", "must be finite with a sigma that is not negative",
          problem.disparity_bias_sigma);
  for (const RelativePose& r : problem.relative_poses) {
    require(is_pose(r.a) && is_pose(r.b) && r.a != r.b, "solve_bundle relative pose",
            "must tie two different poses", r.a);
    require(r.T_a_b.matrix().allFinite() && r.information.allFinite(), "solve_bundle relative pose",
            "must be finite", r.a);
  }
  require(poses == 0 || std::any_of(problem.fixed.begin(), problem.fixed.end(), [](auto f) { return f; }),
          "solve_bundle fixed", "must hold at least one pose: only differences are observed", 0);
}

bool beyond_gate(const RectifiedCamera& camera, const Mat3<double>& R, const Vec3<double>& t,
                 const Vec3<double>& p_world, const BundleObservation& o, double disparity_bias,
                 double gate) {
  const bool stereo = !(o.u_right < 0.0F);
  Vec3<double> e;
  const double disparity = static_cast<double>(o.u) - o.u_right - disparity_bias;
  if (!reprojection_error(camera, R, t, p_world, o.u, o.v, disparity, e)) return true;
  const double inv = 1.0 / o.sigma, inv_d = stereo ? 1.0 / o.sigma_disparity : 0.0;
  e = e.cwiseProduct(Vec3<double>(inv, inv, inv_d));
  return !(e.squaredNorm() <= gate * (stereo ? kGateStereo : kGateMono));
}

// The information of the bias once poses and points are eliminated: Schur complements, points first.
double bias_information(const RectifiedCamera& camera, const BundleProblem& problem,
                        const std::vector<std::uint8_t>& outlier,
                        const std::vector<std::uint8_t>& determined) {
  const std::size_t pose_count = problem.T_camera_world.size();
  std::vector<int> column(pose_count, -1);
  int columns = 0;
  for (std::size_t i = 0; i < pose_count; ++i)
    if (!problem.fixed[i]) column[i] = 6 * std::exchange(columns, columns + 1);
  const Eigen::Index n = 6 * columns;
  // The last row and column are the bias's.
  Eigen::MatrixXd S = Eigen::MatrixXd::Zero(n + 1, n + 1);

  struct Seen {
    int column;
    Eigen::Matrix<double, 6, 3> W;
  };
  struct OfPoint {
    Mat3<double> H = Mat3<double>::Zero();
    Vec3<double> w_bias = Vec3<double>::Zero();
    std::vector<Seen> seen;
  };
  std::vector<Mat3<double>> R(pose_count);
  for (std::size_t i = 0; i < pose_count; ++i) R[i] = problem.T_camera_world[i].rotation().matrix();
  std::vector<OfPoint> points(problem.points.size());
  for (std::size_t k = 0; k < problem.observations.size(); ++k) {
    const BundleObservation& o = problem.observations[k];
    const auto pose = static_cast<std::size_t>(o.pose), point = static_cast<std::size_t>(o.point);
    if (outlier[k] || !determined[point]) continue;
    const bool stereo = !(o.u_right < 0.0F);
    Vec3<double> e;
    Eigen::Matrix<double, 3, 6> J_pose;
    Mat3<double> J_point;
    if (!reprojection_error(camera, R[pose], problem.T_camera_world[pose].translation(),
                            problem.points[point], o.u, o.v, 0.0, e, &J_pose, &J_point))
      continue;
    const double w = 1.0 / (static_cast<double>(o.sigma) * o.sigma);
    const Vec3<double> weight(
        w, w, stereo ? 1.0 / (static_cast<double>(o.sigma_disparity) * o.sigma_disparity) : 0.0);
    const Mat3<double> weighted_point = weight.asDiagonal() * J_point;
    OfPoint& of = points[point];
    of.H += J_point.transpose() * weighted_point;
    of.w_bias += weighted_point.row(2).transpose();
    S(n, n) += weight[2];
    if (const int c = column[pose]; c >= 0) {
      const Eigen::Matrix<double, 3, 6> weighted_pose = weight.asDiagonal() * J_pose;
      S.block<6, 6>(c, c) += J_pose.transpose() * weighted_pose;
      S.block<6, 1>(c, n) += weighted_pose.row(2).transpose();
      of.seen.push_back({c, J_pose.transpose() * weighted_point});
    }
  }
  for (const OfPoint& of : points) {
    if (of.H.isZero(0.0)) continue;
    Mat3<double> H = of.H;
    H.diagonal() *= 1.0 + 1e-9;
    const Mat3<double> inverse = H.inverse();
    if (!inverse.allFinite()) continue;
    S(n, n) -= of.w_bias.dot(inverse * of.w_bias);
    for (const Seen& a : of.seen) {
      const Eigen::Matrix<double, 6, 3> Wa = a.W * inverse;
      S.block<6, 1>(a.column, n) -= Wa * of.w_bias;
      for (const Seen& b : of.seen)
        if (b.column >= a.column) S.block<6, 6>(a.column, b.column) -= Wa * b.W.transpose();
    }
  }
  for (const RelativePose& r : problem.relative_poses) {
    const auto a = static_cast<std::size_t>(r.a), b = static_cast<std::size_t>(r.b);
    Mat6<double> J_a, J_b;
    relative_pose_error(problem.T_camera_world[a], problem.T_camera_world[b], r.T_a_b, &J_a, &J_b);
    const int ca = column[a], cb = column[b];
    if (ca >= 0) S.block<6, 6>(ca, ca) += J_a.transpose() * r.information * J_a;
    if (cb >= 0) S.block<6, 6>(cb, cb) += J_b.transpose() * r.information * J_b;
    if (ca >= 0 && cb >= 0 && ca < cb) S.block<6, 6>(ca, cb) += J_a.transpose() * r.information * J_b;
    if (ca >= 0 && cb >= 0 && cb < ca) S.block<6, 6>(cb, ca) += J_b.transpose() * r.information * J_a;
  }
  const Eigen::VectorXd cross = S.col(n).head(n);
  const Eigen::MatrixXd poses = S.topLeftCorner(n, n).selfadjointView<Eigen::Upper>();
  const double information = S(n, n) - cross.dot(poses.ldlt().solve(cross));
  return std::isfinite(information) ? std::max(information, 0.0) : 0.0;
}

}  // namespace

BundleResult solve_bundle(const RectifiedCamera& camera, BundleProblem& problem, const BundleOptions& options,
                          const std::atomic<bool>* stop) {
  check(camera, problem);
  const std::size_t pose_count = problem.T_camera_world.size(), point_count = problem.points.size();
  std::vector<PoseBlock> poses(pose_count);
  std::transform(problem.T_camera_world.begin(), problem.T_camera_world.end(), poses.begin(), to_block);
  std::vector<Vec3<double>> points = problem.points;

  // A point is determined by a disparity or by two poses.
  std::vector<int> seen_from(point_count, -1);
  std::vector<std::uint8_t> determined(point_count, 0);
  for (const BundleObservation& o : problem.observations) {
    auto& from = seen_from[static_cast<std::size_t>(o.point)];
    if (!(o.u_right < 0.0F) || (from >= 0 && from != o.pose))
      determined[static_cast<std::size_t>(o.point)] = 1;
    from = o.pose;
  }

  BundleResult result;
  ceres::Problem::Options problem_options;
  problem_options.cost_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  problem_options.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  problem_options.manifold_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  problem_options.disable_all_safety_checks = true;
  MotionManifold manifold;
  ceres::HuberLoss mono_loss(std::sqrt(options.gate * kGateMono)),
      stereo_loss(std::sqrt(options.gate * kGateStereo));
  std::deque<ReprojectionCost<2>> mono;
  std::deque<ReprojectionCost<3>> stereo;
  std::deque<ReprojectionCost<3, 1>> stereo_biased;
  double bias = problem.disparity_bias;
  bool estimate_bias = problem.disparity_bias_sigma > 0.0;
  BiasPriorCost bias_prior(problem.disparity_bias, estimate_bias ? problem.disparity_bias_sigma : 1.0);
  std::deque<RelativePoseCost> relative;
  // Odometry that is wrong altogether, by slip, shall not bend the map.
  ceres::HuberLoss relative_loss(std::sqrt(options.gate * kGateRelative));
  std::vector<std::uint8_t> pose_used(pose_count, 0), point_used(point_count, 0);
  ceres::Problem ceres_problem(problem_options);
  std::vector<int> place(problem.observations.size(), -1);  // in mono or stereo
  for (std::size_t i = 0; i < problem.observations.size(); ++i) {
    const BundleObservation& o = problem.observations[i];
    const auto pose = static_cast<std::size_t>(o.pose), point = static_cast<std::size_t>(o.point);
    if (!determined[point]) {
      ++result.unused;
      continue;
    }
    pose_used[pose] = point_used[point] = 1;
    if (o.u_right < 0.0F) {
      place[i] = static_cast<int>(mono.size());
      ceres_problem.AddResidualBlock(&mono.emplace_back(camera, o), &mono_loss, poses[pose].data(),
                                     points[point].data());
    } else if (estimate_bias) {
      place[i] = static_cast<int>(stereo_biased.size());
      ceres_problem.AddResidualBlock(&stereo_biased.emplace_back(camera, o), &stereo_loss, poses[pose].data(),
                                     points[point].data(), &bias);
    } else {
      place[i] = static_cast<int>(stereo.size());
      ceres_problem.AddResidualBlock(&stereo.emplace_back(camera, o, bias), &stereo_loss, poses[pose].data(),
                                     points[point].data());
    }
  }
  estimate_bias = !stereo_biased.empty();
  if (estimate_bias) ceres_problem.AddResidualBlock(&bias_prior, nullptr, &bias);
  for (const RelativePose& r : problem.relative_poses) {
    const auto a = static_cast<std::size_t>(r.a), b = static_cast<std::size_t>(r.b);
    pose_used[a] = pose_used[b] = 1;
    ceres_problem.AddResidualBlock(&relative.emplace_back(r), &relative_loss, poses[a].data(),
                                   poses[b].data());
  }

  std::vector<std::uint8_t> relative_outlier(relative.size(), 0);

  ceres::Solver::Options solver;
  solver.logging_type = ceres::SILENT;
  solver.num_threads = options.num_threads;
  solver.function_tolerance = options.function_tolerance;
  auto ordering = std::make_shared<ceres::ParameterBlockOrdering>();
  for (std::size_t i = 0; i < point_count; ++i)
    if (point_used[i]) ordering->AddElementToGroup(points[i].data(), 0);
  if (estimate_bias) ordering->AddElementToGroup(&bias, 1);
  int free_poses = 0;
  for (std::size_t i = 0; i < pose_count; ++i) {
    if (!pose_used[i]) continue;
    ceres_problem.SetManifold(poses[i].data(), &manifold);
    ordering->AddElementToGroup(poses[i].data(), 1);
    if (problem.fixed[i])
      ceres_problem.SetParameterBlockConstant(poses[i].data());
    else
      ++free_poses;
  }
  solver.linear_solver_ordering = ordering;
  solver.linear_solver_type = free_poses <= options.dense_poses ? ceres::DENSE_SCHUR : ceres::SPARSE_SCHUR;
  std::unique_ptr<StopCallback> callback;
  if (stop) {
    callback = std::make_unique<StopCallback>(*stop);
    solver.callbacks.push_back(callback.get());
  }

  std::vector<Mat3<double>> R(pose_count);
  const auto mark = [&] {
    for (std::size_t i = 0; i < pose_count; ++i) R[i] = to_motion(poses[i].data()).rotation().matrix();
    result.outlier.assign(problem.observations.size(), 0);
    result.outliers = 0;
    for (std::size_t i = 0; i < problem.observations.size(); ++i) {
      const BundleObservation& o = problem.observations[i];
      const auto pose = static_cast<std::size_t>(o.pose);
      result.outlier[i] = beyond_gate(camera, R[pose], Eigen::Map<const Vec3<double>>(poses[pose].data()),
                                      points[static_cast<std::size_t>(o.point)], o, bias, options.gate);
      result.outliers += result.outlier[i];
    }
    result.relative_outliers = 0;
    for (std::size_t i = 0; i < relative.size(); ++i) {
      const RelativePose& r = problem.relative_poses[i];
      const Vec6<double> e =
          relative_pose_error(to_motion(poses[static_cast<std::size_t>(r.a)].data()),
                              to_motion(poses[static_cast<std::size_t>(r.b)].data()), r.T_a_b);
      relative_outlier[i] = !(e.dot(r.information * e) <= options.gate * kGateRelative);
      result.relative_outliers += relative_outlier[i];
    }
  };
  const auto stop_asked = [&] { return stop && stop->load(std::memory_order_relaxed); };

  result.usable = true;
  const bool empty = ceres_problem.NumResidualBlocks() == 0;
  if (empty) result.converged = true;
  for (int round = 0; !empty && round < 2; ++round) {
    if (stop_asked()) break;
    solver.max_num_iterations = round == 0 ? options.robust_iterations : options.iterations;
    ceres::Solver::Summary summary;
    ceres::Solve(solver, &ceres_problem, &summary);
    if (round == 0) result.initial_cost = summary.initial_cost;
    result.final_cost = summary.final_cost;
    result.iterations += static_cast<int>(summary.iterations.size()) - 1;
    result.converged = summary.termination_type == ceres::CONVERGENCE;
    if (!summary.IsSolutionUsable()) {
      result.usable = false;
      return result;
    }
    if (round == 1) break;
    mark();
    if ((result.outliers == 0 && result.relative_outliers == 0) || options.iterations == 0) break;
    for (std::size_t i = 0; i < relative.size(); ++i)
      if (relative_outlier[i]) relative[i].switch_off();
    for (std::size_t i = 0; i < place.size(); ++i) {
      if (place[i] < 0 || !result.outlier[i]) continue;
      const auto k = static_cast<std::size_t>(place[i]);
      if (problem.observations[i].u_right < 0.0F)
        mono[k].switch_off();
      else if (estimate_bias)
        stereo_biased[k].switch_off();
      else
        stereo[k].switch_off();
    }
  }
  result.stopped = stop_asked();
  mark();
  for (std::size_t i = 0; i < pose_count; ++i)
    if (pose_used[i] && !problem.fixed[i]) problem.T_camera_world[i] = to_motion(poses[i].data());
  problem.points = std::move(points);
  problem.disparity_bias = bias;
  if (estimate_bias)
    result.disparity_bias_information = bias_information(camera, problem, result.outlier, determined);
  return result;
}

}  // namespace sweepkit
