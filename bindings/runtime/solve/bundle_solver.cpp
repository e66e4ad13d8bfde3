// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "bundle_solver.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "small_matrix.hpp"
#include "sweepkit/solve/motion_error.hpp"
#include "sweepkit/solve/reprojection.hpp"

namespace sweepkit {
namespace {

// Behind the camera each error counts as so many standard deviations, and pulls no more.
constexpr double kBehind = 30.0;
constexpr double kInitialDamping = 1e-4;
constexpr double kMinDiagonal = 1e-6;  // what damping takes a smaller one for
constexpr double kMaxDamping = 1e12;
constexpr double kLeastGain = 1e-3;  // share of what was promised

// Half of Huber's loss of a squared error, and its weight.
double loss(double squared, double scale2, double& weight) {
  if (squared <= scale2) {
    weight = 1.0;
    return 0.5 * squared;
  }
  const double ratio = std::sqrt(scale2 / squared);
  weight = ratio;
  return ratio * squared - 0.5 * scale2;
}

double damped(double diagonal) { return std::max(diagonal, kMinDiagonal); }

}  // namespace

BundleSolver::BundleSolver(const RectifiedCamera& camera, const BundleProblem& problem,
                           const BundleOptions& options, const std::vector<std::uint8_t>& determined)
    : camera_(camera),
      problem_(problem),
      relative_scale2_(options.gate * kGateRelative),
      tolerance_(options.function_tolerance),
      column_(problem.T_camera_world.size(), -1),
      place_(problem.observations.size(), 0) {
  std::vector<std::uint8_t> used(problem.T_camera_world.size(), 0);
  std::vector<std::uint32_t> count(problem.points.size(), 0);
  for (const BundleObservation& o : problem.observations)
    if (determined[static_cast<std::size_t>(o.point)]) {
      used[static_cast<std::size_t>(o.pose)] = 1;
      ++count[static_cast<std::size_t>(o.point)];
    }
  for (const RelativePose& r : problem.relative_poses)
    used[static_cast<std::size_t>(r.a)] = used[static_cast<std::size_t>(r.b)] = 1;
  for (std::size_t i = 0; i < column_.size(); ++i)
    if (used[i] && !problem.fixed[i]) {
      column_[i] = static_cast<int>(pose_of_.size());
      pose_of_.push_back(static_cast<int>(i));
    }

  std::vector<std::uint32_t> next(problem.points.size(), 0);
  std::uint32_t seen = 0;
  for (std::size_t p = 0; p < count.size(); ++p) {
    next[p] = seen;
    if (count[p] > 0) of_points_.push_back({static_cast<std::uint32_t>(p), seen, seen + count[p], 0});
    seen += count[p];
  }
  seen_.resize(seen);
  for (std::size_t i = 0; i < problem.observations.size(); ++i) {
    const BundleObservation& o = problem.observations[i];
    const auto point = static_cast<std::size_t>(o.point);
    if (!determined[point]) continue;
    const bool stereo = !(o.u_right < 0.0F);
    estimates_bias_ |= stereo && problem.disparity_bias_sigma > 0.0;
    place_[i] = next[point]++;
    seen_[place_[i]] = {.pose = o.pose,
                        .column = column_[static_cast<std::size_t>(o.pose)],
                        .u = o.u,
                        .v = o.v,
                        .disparity = stereo ? static_cast<double>(o.u) - o.u_right : 0.0,
                        .weight = 1.0 / o.sigma,
                        .weight_disparity = stereo ? 1.0 / o.sigma_disparity : 0.0,
                        .scale2 = options.gate * (stereo ? kGateStereo : kGateMono)};
  }

  // Which poses have something in common, once each.
  const std::size_t n = pose_of_.size();
  std::vector<bool> tied(n * n, false);
  std::vector<std::pair<int, int>> pairs;
  const auto tie = [&](int a, int b) {
    if (a < 0 || b < 0 || a == b) return;
    const auto i = static_cast<std::size_t>(std::max(a, b)), j = static_cast<std::size_t>(std::min(a, b));
    if (tied[i * n + j]) return;
    tied[i * n + j] = true;
    pairs.emplace_back(static_cast<int>(i), static_cast<int>(j));
  };
  for (const OfPoint& of : of_points_)
    for (std::uint32_t i = of.begin; i < of.end; ++i)
      for (std::uint32_t j = of.begin; j < i; ++j) tie(seen_[i].column, seen_[j].column);
  for (const RelativePose& r : problem.relative_poses)
    tie(column_[static_cast<std::size_t>(r.a)], column_[static_cast<std::size_t>(r.b)]);
  S_ = BlockCholesky<6>(static_cast<int>(n), pairs);
  for (OfPoint& of : of_points_) {
    of.pairs = static_cast<std::uint32_t>(pair_slots_.size());
    for (std::uint32_t i = of.begin; i < of.end; ++i)
      for (std::uint32_t j = of.begin; j < i; ++j) {
        const int a = seen_[i].column, b = seen_[j].column;
        if (a < 0 || b < 0 || a == b) continue;
        const auto slot = S_.slot(a, b);
        pair_slots_.push_back(2 * slot.index + slot.transposed);
      }
  }
  for (const RelativePose& r : problem.relative_poses) {
    const int a = column_[static_cast<std::size_t>(r.a)], b = column_[static_cast<std::size_t>(r.b)];
    relative_.push_back({.a = r.a,
                         .b = r.b,
                         .column_a = a,
                         .column_b = b,
                         .slot = a >= 0 && b >= 0 ? S_.slot(a, b) : BlockCholesky<6>::Slot{},
                         .T_a_b = r.T_a_b,
                         .information = r.information});
  }
  U_.resize(n);
  W_.resize(seen_.size());
  eliminated_.resize(of_points_.size());
}

double BundleSolver::cost(const BundleState& state) const {
  double sum = 0.0, weight;
  for (const OfPoint& of : of_points_) {
    const Vec3<double>& p_world = state.points[of.point];
    for (std::uint32_t i = of.begin; i < of.end; ++i) {
      const Seen& o = seen_[i];
      if (!o.on) continue;
      const auto pose = static_cast<std::size_t>(o.pose);
      Vec3<double> e;
      if (reprojection_error(camera_, state.R[pose], state.T_camera_world[pose].translation(), p_world, o.u,
                             o.v, o.disparity - state.bias, e))
        e = e.cwiseProduct(Vec3<double>(o.weight, o.weight, o.weight_disparity));
      else
        e << kBehind, kBehind, o.weight_disparity > 0.0 ? kBehind : 0.0;
      sum += loss(e.squaredNorm(), o.scale2, weight);
    }
  }
  for (const Relative& r : relative_) {
    if (!r.on) continue;
    const Vec6<double> e = relative_pose_error(state.T_camera_world[static_cast<std::size_t>(r.a)],
                                               state.T_camera_world[static_cast<std::size_t>(r.b)], r.T_a_b);
    sum += loss(e.dot(r.information * e), relative_scale2_, weight);
  }
  if (estimates_bias_) {
    const double e = (state.bias - problem_.disparity_bias) / problem_.disparity_bias_sigma;
    sum += 0.5 * e * e;
  }
  return sum;
}

// What the observations of a point add to its own equations, to those of its poses, and to W between them.
void BundleSolver::add_point(const BundleState& state, std::size_t k, double damping, bool robust) {
  const OfPoint& of = of_points_[k];
  const Vec3<double>& p_world = state.points[of.point];
  Mat3<double> V = Mat3<double>::Zero();
  Vec3<double> gradient = Vec3<double>::Zero(), border = Vec3<double>::Zero();
  const double f = camera_.focal;
  for (std::uint32_t i = of.begin; i < of.end; ++i) {
    const Seen& o = seen_[i];
    const auto pose = static_cast<std::size_t>(o.pose);
    const Mat3<double>& R = state.R[pose];
    const Vec3<double> p = R * p_world + state.T_camera_world[pose].translation();
    if (!o.on || !(p.z() > RectifiedCamera::kMinDepth)) {
      W_[i].setZero();
      continue;
    }
    const double iz = 1.0 / p.z(), x = p.x() * iz, y = p.y() * iz, d = camera_.baseline * f * iz;
    const double e0 = o.weight * (camera_.cx + f * x - o.u), e1 = o.weight * (camera_.cy + f * y - o.v);
    const double e2 = o.weight_disparity * (d - o.disparity + state.bias);
    double rho = 1.0;
    if (robust) loss(e0 * e0 + e1 * e1 + e2 * e2, o.scale2, rho);
    // A = (a 0 -a x; 0 a -a y; 0 0 c), and M = A' A.
    const double a = o.weight * f * iz, c = -o.weight_disparity * d * iz;
    const double aa = rho * a * a, m02 = -aa * x, m12 = -aa * y, m22 = aa * (x * x + y * y) + rho * c * c;
    const Vec3<double> g(rho * a * e0, rho * a * e1, rho * (-a * (x * e0 + y * e1) + c * e2));
    Mat3<double> P;  // M R
    for (int n = 0; n < 3; ++n) {
      P(0, n) = aa * R(0, n) + m02 * R(2, n);
      P(1, n) = aa * R(1, n) + m12 * R(2, n);
      P(2, n) = m02 * R(0, n) + m12 * R(1, n) + m22 * R(2, n);
    }
    for (int n = 0; n < 3; ++n)
      for (int m = 0; m <= n; ++m) V(m, n) += R(0, m) * P(0, n) + R(1, m) * P(1, n) + R(2, m) * P(2, n);
    for (int n = 0; n < 3; ++n) gradient[n] += R(0, n) * g[0] + R(1, n) * g[1] + R(2, n) * g[2];
    const double q = rho * c * o.weight_disparity;
    if (estimates_bias_) {
      for (int n = 0; n < 3; ++n) border[n] += R(2, n) * q;
      bias_curvature_ += rho * o.weight_disparity * o.weight_disparity;
      full_bias_gradient_ += rho * o.weight_disparity * e2;
    }
    if (o.column < 0) continue;
    // The derivative by (rho, phi) is A (1, -[p]x).
    Eigen::Matrix<double, 6, 3>& W = W_[i];
    for (int n = 0; n < 3; ++n) {
      W(0, n) = P(0, n);
      W(1, n) = P(1, n);
      W(2, n) = P(2, n);
      W(3, n) = p.y() * P(2, n) - p.z() * P(1, n);
      W(4, n) = p.z() * P(0, n) - p.x() * P(2, n);
      W(5, n) = p.x() * P(1, n) - p.y() * P(0, n);
    }
    // [p]x M, whose transpose is -M [p]x, and -[p]x M [p]x. Lower triangle only.
    const double k00 = p.y() * m02, k01 = p.y() * m12 - p.z() * aa, k02 = p.y() * m22 - p.z() * m12;
    const double k10 = p.z() * aa - p.x() * m02, k11 = -p.x() * m12, k12 = p.z() * m02 - p.x() * m22;
    const double k20 = -p.y() * aa, k21 = p.x() * aa, k22 = p.x() * m12 - p.y() * m02;
    Mat6<double>& U = U_[static_cast<std::size_t>(o.column)];
    U(0, 0) += aa;
    U(1, 1) += aa;
    U(2, 0) += m02;
    U(2, 1) += m12;
    U(2, 2) += m22;
    U(3, 0) += k00;
    U(3, 1) += k01;
    U(3, 2) += k02;
    U(4, 0) += k10;
    U(4, 1) += k11;
    U(4, 2) += k12;
    U(5, 0) += k20;
    U(5, 1) += k21;
    U(5, 2) += k22;
    // -K [p]x for K = [p]x M: row by row the cross product p x row.
    U(3, 3) += p.y() * k02 - p.z() * k01;
    U(4, 3) += p.y() * k12 - p.z() * k11;
    U(4, 4) += p.z() * k10 - p.x() * k12;
    U(5, 3) += p.y() * k22 - p.z() * k21;
    U(5, 4) += p.z() * k20 - p.x() * k22;
    U(5, 5) += p.x() * k21 - p.y() * k20;
    const Eigen::Index at = 6 * o.column;
    full_gradient_.segment<3>(at) += g;
    full_gradient_.segment<3>(at + 3) += p.cross(g);
    if (estimates_bias_) {
      border_[at + 2] += q;
      border_[at + 3] += p.y() * q;
      border_[at + 4] -= p.x() * q;
    }
  }
  Eliminated& out = eliminated_[k];
  for (int n = 0; n < 3; ++n) {
    out.damping[n] = damping * damped(V(n, n));
    for (int m = 0; m < n; ++m) V(n, m) = V(m, n);
  }
  const bool seen = V(0, 0) + V(1, 1) + V(2, 2) > 0.0;
  V.diagonal() += out.damping;
  out.gradient = gradient;
  out.border = border;
  out.inverse = small::inverse<3>(V);
  if (!seen || !out.inverse.allFinite()) out.inverse.setZero();
}

// Takes a point out of the equations of its poses.
void BundleSolver::eliminate(std::size_t k) {
  const OfPoint& of = of_points_[k];
  const Eliminated& e = eliminated_[k];
  const Vec3<double> step = e.inverse * e.gradient, of_bias = e.inverse * e.border;
  if (estimates_bias_) {
    bias_curvature_ -= e.border.dot(of_bias);
    bias_gradient_ -= e.border.dot(step);
  }
  const std::int32_t* slot = pair_slots_.data() + of.pairs;
  for (std::uint32_t i = of.begin; i < of.end; ++i) {
    const int a = seen_[i].column;
    if (a < 0) continue;
    const Eigen::Matrix<double, 6, 3>& W = W_[i];
    const Eigen::Matrix<double, 6, 3> Y = small::product<6, 3, 3>(W, e.inverse);
    gradient_.segment<6>(6 * a) -= W * step;
    if (estimates_bias_) border_.segment<6>(6 * a) -= W * of_bias;
    double* diagonal = S_.diagonal(a).data();
    for (int n = 0; n < 6; ++n)
      for (int m = 0; m < 6; ++m)
        diagonal[6 * n + m] -= Y.data()[m] * W.data()[n] + Y.data()[6 + m] * W.data()[6 + n] +
                               Y.data()[12 + m] * W.data()[12 + n];
    for (std::uint32_t j = of.begin; j < i; ++j) {
      const int b = seen_[j].column;
      if (b < 0) continue;
      const Eigen::Matrix<double, 6, 3>& Wb = W_[j];
      if (a == b) {  // seen twice by one pose
        const Mat6<double> both = small::product<6, 3, 6>(Y, small::transposed<6, 3>(Wb));
        S_.diagonal(a) -= both + both.transpose();
        continue;
      }
      const bool transposed = *slot & 1;
      double* block = S_.off_diagonal({*slot >> 1, transposed}).data();
      ++slot;
      const double* rows = transposed ? Wb.data() : Y.data();
      const double* columns = transposed ? Y.data() : Wb.data();
      for (int n = 0; n < 6; ++n)
        for (int m = 0; m < 6; ++m)
          block[6 * n + m] -=
              rows[m] * columns[n] + rows[6 + m] * columns[6 + n] + rows[12 + m] * columns[12 + n];
    }
  }
}

void BundleSolver::add_relative(const BundleState& state, bool robust) {
  for (const Relative& r : relative_) {
    if (robust && !r.on) continue;
    Mat6<double> J_a, J_b;
    const Vec6<double> e =
        relative_pose_error(state.T_camera_world[static_cast<std::size_t>(r.a)],
                            state.T_camera_world[static_cast<std::size_t>(r.b)], r.T_a_b, &J_a, &J_b);
    double rho = 1.0;
    if (robust) loss(e.dot(r.information * e), relative_scale2_, rho);
    const Mat6<double> information = rho * r.information;
    const Mat6<double> A = small::product<6, 6, 6>(information, J_a);
    const Mat6<double> B = small::product<6, 6, 6>(information, J_b);
    if (r.column_a >= 0) {
      U_[static_cast<std::size_t>(r.column_a)] += small::product<6, 6, 6>(small::transposed<6, 6>(J_a), A);
      full_gradient_.segment<6>(6 * r.column_a) += A.transpose() * e;
    }
    if (r.column_b >= 0) {
      U_[static_cast<std::size_t>(r.column_b)] += small::product<6, 6, 6>(small::transposed<6, 6>(J_b), B);
      full_gradient_.segment<6>(6 * r.column_b) += B.transpose() * e;
    }
    if (r.column_a >= 0 && r.column_b >= 0) {
      const Mat6<double> ab = small::product<6, 6, 6>(small::transposed<6, 6>(J_a), B);
      S_.off_diagonal(r.slot) += r.slot.transposed ? small::transposed<6, 6>(ab) : ab;
    }
  }
}

bool BundleSolver::build(const BundleState& state, double damping, bool robust) {
  const auto n = static_cast<Eigen::Index>(6 * pose_of_.size());
  S_.set_zero();
  for (Mat6<double>& U : U_) U.setZero();
  full_gradient_ = border_ = Eigen::VectorXd::Zero(n);
  pose_damping_.resize(n);
  bias_curvature_ = full_bias_gradient_ = 0.0;
  for (std::size_t k = 0; k < of_points_.size(); ++k) add_point(state, k, damping, robust);
  for (Mat6<double>& U : U_)
    for (int c = 1; c < 6; ++c)
      for (int r = 0; r < c; ++r) U(r, c) = U(c, r);
  add_relative(state, robust);
  if (estimates_bias_ && robust) {
    const double w = 1.0 / problem_.disparity_bias_sigma;
    bias_curvature_ += w * w;
    full_bias_gradient_ += w * w * (state.bias - problem_.disparity_bias);
  }
  bias_damping_ = damping * damped(bias_curvature_);
  bias_curvature_ += bias_damping_;
  gradient_ = full_gradient_;
  bias_gradient_ = full_bias_gradient_;
  for (std::size_t c = 0; c < U_.size(); ++c) {
    Mat6<double>& diagonal = S_.diagonal(static_cast<int>(c));
    diagonal += U_[c];
    for (int k = 0; k < 6; ++k) {
      double& add = pose_damping_[static_cast<Eigen::Index>(6 * c) + k];
      add = damping * damped(U_[c](k, k));
      diagonal(k, k) += add;
    }
  }
  for (std::size_t k = 0; k < of_points_.size(); ++k) eliminate(k);
  return S_.factorize();
}

bool BundleSolver::solve(Step& step) {
  step.poses = -gradient_;
  S_.solve(step.poses);
  step.bias = 0.0;
  if (estimates_bias_) {
    Eigen::VectorXd of_bias = border_;
    S_.solve(of_bias);
    const double curvature = bias_curvature_ - border_.dot(of_bias);
    if (!(curvature > 0.0)) return false;
    step.bias = (-bias_gradient_ - border_.dot(step.poses)) / curvature;
    step.poses -= step.bias * of_bias;
  }
  // By how much the quadratic model falls: half of delta' (damping delta - gradient).
  double promised = step.poses.dot(pose_damping_.cwiseProduct(step.poses) - full_gradient_) +
                    step.bias * (bias_damping_ * step.bias - full_bias_gradient_);
  step.points.resize(of_points_.size());
  for (std::size_t k = 0; k < of_points_.size(); ++k) {
    const OfPoint& of = of_points_[k];
    const Eliminated& e = eliminated_[k];
    Vec3<double> g = e.gradient + step.bias * e.border;
    for (std::uint32_t i = of.begin; i < of.end; ++i) {
      if (seen_[i].column < 0) continue;
      const double* w = W_[i].data();
      const double* d = step.poses.data() + 6 * seen_[i].column;
      for (int n = 0; n < 3; ++n)
        for (int m = 0; m < 6; ++m) g[n] += w[6 * n + m] * d[m];
    }
    step.points[k] = -(e.inverse * g);
    promised += step.points[k].dot(e.damping.cwiseProduct(step.points[k]) - e.gradient);
  }
  step.promised = 0.5 * promised;
  return std::isfinite(step.promised);
}

BundleState BundleSolver::moved(const BundleState& state, const Step& step) const {
  BundleState to = state;
  for (std::size_t c = 0; c < pose_of_.size(); ++c) {
    const auto pose = static_cast<std::size_t>(pose_of_[c]);
    SE3d& T = to.T_camera_world[pose];
    T = SE3d::exp(step.poses.segment<6>(static_cast<Eigen::Index>(6 * c))) * T;
    to.R[pose] = T.rotation().matrix();
  }
  for (std::size_t k = 0; k < of_points_.size(); ++k) to.points[of_points_[k].point] += step.points[k];
  to.bias += step.bias;
  return to;
}

BundleSolver::Outcome BundleSolver::minimise(BundleState& state, int iterations,
                                             const std::atomic<bool>* stop) {
  Outcome out;
  double now = cost(state);
  out.initial_cost = out.final_cost = now;
  if (!std::isfinite(now)) return out;
  out.usable = true;
  double damping = kInitialDamping, worse = 2.0;
  Step step;
  while (out.iterations < iterations && damping < kMaxDamping) {
    if (stop && stop->load(std::memory_order_relaxed)) break;
    ++out.iterations;
    if (!build(state, damping, true) || !solve(step)) {
      damping *= worse;
      worse *= 2.0;
      continue;
    }
    if (!(step.promised > 1e-12 * now)) {
      out.converged = true;
      break;
    }
    BundleState to = moved(state, step);
    const double then = cost(to);
    const double gain = (now - then) / step.promised;
    if (!(gain > kLeastGain)) {
      damping *= worse;
      worse *= 2.0;
      continue;
    }
    state = std::move(to);
    out.converged = now - then <= tolerance_ * now;
    now = out.final_cost = then;
    if (out.converged) break;
    const double trust = 2.0 * gain - 1.0;
    damping *= std::max(1.0 / 3.0, 1.0 - trust * trust * trust);
    worse = 2.0;
  }
  return out;
}

double BundleSolver::bias_information(const BundleState& state) {
  if (!build(state, 1e-9, false)) return 0.0;
  Eigen::VectorXd of_bias = border_;
  S_.solve(of_bias);
  const double information = bias_curvature_ - border_.dot(of_bias);
  return std::isfinite(information) ? std::max(information, 0.0) : 0.0;
}

}  // namespace sweepkit
