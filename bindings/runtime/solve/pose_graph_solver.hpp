// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <numeric>
#include <type_traits>
#include <vector>

#include "block_cholesky.hpp"
#include "pose_graph_freedom.hpp"
#include "small_matrix.hpp"
#include "sweepkit/solve/pose_graph.hpp"
#include "sweepkit/solve/pose_graph_error.hpp"
#include "sweepkit/solve/robust_loss.hpp"

namespace sweepkit {

inline constexpr double kGate6 = 22.457744484825;      // chi-square, 99.9 %, 6 degrees of freedom
inline constexpr double kGate7 = 24.321886347857;      // and 7
inline constexpr double kNormalGate = 3.090232306168;  // of a normal number; for many degrees of freedom

template <class Pose>
bool is_finite(const Pose& T) {
  return T.matrix().allFinite() && T.rotation().quaternion().coeffs().allFinite();
}

// The parts that edges make of the nodes: for each node the first one of its part.
template <class Pose>
std::vector<int> parts_of(const BasicPoseGraph<Pose>& graph) {
  std::vector<int> first(graph.nodes.size());
  std::iota(first.begin(), first.end(), 0);
  const auto root = [&](int k) {
    while (first[static_cast<std::size_t>(k)] != k) {
      int& up = first[static_cast<std::size_t>(k)];
      up = first[static_cast<std::size_t>(up)];
      k = up;
    }
    return k;
  };
  for (const auto& edge : graph.edges) {
    const int a = root(edge.i), b = root(edge.j);
    first[static_cast<std::size_t>(std::max(a, b))] = std::min(a, b);
  }
  for (std::size_t k = 0; k < first.size(); ++k) first[k] = root(static_cast<int>(k));
  return first;
}

template <class Freedom>
class PoseGraphSolver {
 public:
  using Pose = typename Freedom::Pose;
  using Graph = BasicPoseGraph<Pose>;
  using Result = PoseGraphResult<Pose>;

  PoseGraphSolver(const Graph& graph, const PoseGraphOptions& options, const Freedom& freedom,
                  const std::atomic<bool>* stop)
      : graph_(graph),
        options_(options),
        freedom_(freedom),
        stop_(stop),
        gate_(options.gate * (kRows == 7 ? kGate7 : kGate6)) {
    set_up();
  }

  Result solve() {
    Result& r = result_;
    weight_.assign(graph_.edges.size(), 1.0);
    r.initial_cost = cost_of(x_);
    r.contradiction.assign(graph_.edges.size(), 0.0);
    r.converged = minimise();
    const bool any_robust =
        std::any_of(graph_.edges.begin(), graph_.edges.end(), [](const auto& e) { return e.robust; });
    if (options_.loss == PoseGraphLoss::truncated && any_robust && free_ > 0) find_wrong_edges();
    finish();
    return std::move(r);
  }

 private:
  static constexpr int kRows = Pose::Tangent::RowsAtCompileTime;
  static constexpr int kSize = Freedom::kSize;
  using Residual = typename Pose::Tangent;
  using Jacobian = Eigen::Matrix<double, kRows, kRows>;
  using EdgeJacobian = Eigen::Matrix<double, kRows, kSize>;
  using Transposed = Eigen::Matrix<double, kSize, kRows>;
  using Step = typename Freedom::Step;
  using Square = typename BlockCholesky<kSize>::Block;
  using Slot = typename BlockCholesky<kSize>::Slot;

  void set_up() {
    Result& r = result_;
    const std::size_t n = graph_.nodes.size();
    const std::vector<int> part = parts_of(graph_);
    std::vector<bool> anchored(n, false), held(n, false);
    for (std::size_t k = 0; k < n; ++k)
      if (graph_.nodes[k].fixed) anchored[static_cast<std::size_t>(part[k])] = true;
    for (std::size_t k = 0; k < n; ++k) {
      if (part[k] != static_cast<int>(k)) continue;
      ++r.components;
      if (anchored[k]) continue;
      held[k] = true;
      r.held.push_back(static_cast<int>(k));
    }
    variable_.assign(n, -1);
    for (std::size_t k = 0; k < n; ++k)
      if (!graph_.nodes[k].fixed && !held[k]) variable_[k] = free_++;
    for (const auto& node : graph_.nodes) x_.push_back(node.T_world_node);

    std::vector<std::pair<int, int>> pairs;
    for (const auto& edge : graph_.edges)
      if (variable(edge.i) >= 0 && variable(edge.j) >= 0)
        pairs.emplace_back(variable(edge.i), variable(edge.j));
    H_ = BlockCholesky<kSize>(free_, pairs);
    r.products = H_.factor_products();
    for (const auto& edge : graph_.edges)
      slots_.push_back(variable(edge.i) >= 0 && variable(edge.j) >= 0
                           ? H_.slot(variable(edge.i), variable(edge.j))
                           : Slot{});
    gradient_.resize(free_ * kSize);
    for (const auto& edge : graph_.edges) {
      information_.push_back(edge.information);
      freedom_.blur(at(x_, edge.i), at(x_, edge.j), edge.T_i_j, information_.back());
    }
  }

  static double squared(const Jacobian& information, const Residual& e) {
    return e.dot(small::product<kRows, kRows, 1>(information, e));
  }
  int variable(int node) const { return variable_[static_cast<std::size_t>(node)]; }
  const Pose& at(const std::vector<Pose>& x, int node) const { return x[static_cast<std::size_t>(node)]; }
  bool asked_to_stop() {
    if (stop_ && stop_->load(std::memory_order_relaxed)) result_.stopped = true;
    return result_.stopped;
  }

  // Cost and weight of a robust edge by its loss.
  void loss(double chi2, double& cost, double& weight) const {
    const auto evaluate = [&]<class Loss>(Loss) {
      using One = Eigen::Array<double, 1, 1>;
      One rho, w;
      Loss::evaluate(One(chi2 / gate_), rho, w);
      cost = gate_ * rho[0];
      weight = w[0];
    };
    switch (options_.loss) {
      case PoseGraphLoss::huber:
        return evaluate(HuberLoss{});
      case PoseGraphLoss::cauchy:
        return evaluate(CauchyLoss{});
      case PoseGraphLoss::geman_mcclure:
        return evaluate(GemanMcClureLoss{});
      case PoseGraphLoss::quadratic:
      case PoseGraphLoss::truncated:
        break;
    }
    cost = chi2;
    weight = 1.0;
  }

  // Half the sum of chi2, by the loss; edges that are out cost the gate.
  double cost_of(const std::vector<Pose>& x) const {
    double sum = 0.0;
    for (std::size_t l = 0; l < graph_.edges.size(); ++l) {
      const auto& edge = graph_.edges[l];
      if (weight_[l] == 0.0 && options_.loss == PoseGraphLoss::truncated) {
        sum += gate_;
        continue;
      }
      const Residual e = pose_graph_error(at(x, edge.i), at(x, edge.j), edge.T_i_j);
      double cost = squared(information_[l], e);
      if (edge.robust) {
        double weight;
        loss(cost, cost, weight);
      }
      sum += cost;
    }
    return 0.5 * sum;
  }

  void linearise() {
    H_.set_zero();
    gradient_.setZero();
    for (std::size_t l = 0; l < graph_.edges.size(); ++l) {
      const auto& edge = graph_.edges[l];
      const int i = variable(edge.i), j = variable(edge.j);
      const bool out = options_.loss == PoseGraphLoss::truncated && weight_[l] == 0.0;
      if ((i < 0 && j < 0) || out) continue;
      Residual e;
      EdgeJacobian J_i, J_j;
      error_of(edge, e, J_i, J_j);
      Residual pull = small::product<kRows, kRows, 1>(information_[l], e);
      double weight = 1.0;
      if (edge.robust) {
        double cost;
        loss(e.dot(pull), cost, weight);
        pull *= weight;
      }
      const Jacobian information = weight * information_[l];
      const EdgeJacobian W_i = small::product<kRows, kRows, kSize>(information, J_i);
      const EdgeJacobian W_j = small::product<kRows, kRows, kSize>(information, J_j);
      const Transposed J_i_t = small::transposed<kRows, kSize>(J_i);
      const Transposed J_j_t = small::transposed<kRows, kSize>(J_j);
      if (i >= 0) {
        H_.diagonal(i) += small::product<kSize, kRows, kSize>(J_i_t, W_i);
        gradient_.template segment<kSize>(i * kSize) += small::product<kSize, kRows, 1>(J_i_t, pull);
      }
      if (j >= 0) {
        H_.diagonal(j) += small::product<kSize, kRows, kSize>(J_j_t, W_j);
        gradient_.template segment<kSize>(j * kSize) += small::product<kSize, kRows, 1>(J_j_t, pull);
      }
      if (i >= 0 && j >= 0)
        H_.off_diagonal(slots_[l]) += slots_[l].transposed ? small::product<kSize, kRows, kSize>(J_j_t, W_i)
                                                           : small::product<kSize, kRows, kSize>(J_i_t, W_j);
    }
  }

  void error_of(const PoseGraphEdge<Pose>& edge, Residual& e, EdgeJacobian& J_i, EdgeJacobian& J_j) const {
    const Pose &T_w_i = at(x_, edge.i), &T_w_j = at(x_, edge.j);
    Jacobian A_i, A_j;
    e = pose_graph_error(T_w_i, T_w_j, edge.T_i_j, &A_i, &A_j);
    J_i = freedom_.along(T_w_i, A_i);
    J_j = freedom_.along(T_w_j, A_j);
  }

  // Levenberg and Marquardt from x_; true if a tolerance was met.
  bool minimise() {
    if (free_ == 0) return true;
    double cost = cost_of(x_);
    double damping = 1e-6, growth = 2.0;
    std::vector<Pose> trial = x_;
    for (int k = 0; k < options_.iterations; ++k) {
      if (asked_to_stop()) return false;
      linearise();
      ++result_.iterations;
      for (int attempt = 0;; ++attempt) {
        if (attempt == 40) return false;
        if (H_.factorize(damping)) {
          Eigen::VectorXd step = -gradient_;
          H_.solve(step);
          double promised = -0.5 * gradient_.dot(step);
          for (int v = 0; v < free_; ++v) {
            const auto s = step.segment<kSize>(v * kSize);
            promised += 0.5 * damping * s.cwiseAbs2().dot(H_.diagonal(v).diagonal());
          }
          for (std::size_t n = 0; n < trial.size(); ++n)
            if (const int v = variable_[n]; v >= 0)
              trial[n] = freedom_.moved(x_[n], Step(step.segment<kSize>(v * kSize)));
          const double new_cost = cost_of(trial);
          const double gain = cost - new_cost;
          const bool small_step = step.cwiseAbs().maxCoeff() <= options_.step_tolerance;
          if (gain >= 0.0) {
            x_.swap(trial);
            cost = new_cost;
            const double ratio = promised > 0.0 ? gain / promised : 1.0;
            damping *= std::max(1.0 / 9.0, 1.0 - std::pow(2.0 * ratio - 1.0, 3));
            damping = std::max(damping, 1e-12);
            growth = 2.0;
            if (small_step || gain <= options_.function_tolerance * cost) return true;
            break;
          }
          // No way down that numbers can tell.
          if (small_step || promised <= 1e-13 * cost) return true;
        }
        damping *= growth;
        growth *= 2.0;
      }
    }
    return false;
  }

  // Factorises and inverts at x_. What is barely determined gets a little damping: its covariance is huge
  // then.
  void invert() {
    linearise();
    double damping = 0.0;
    while (!H_.factorize(damping)) damping = damping == 0.0 ? 1e-13 : 10.0 * damping;
    H_.invert();
  }

  // How far each robust edge is from what all others say, after invert(). With whitened residual r and
  // Jacobian J of the edge, C = J H^-1 J' and weight w in H, the prediction by the others differs by
  // (I - w C)^-1 r, and the square of that in units of its covariance is r' (I + (1 - w) C)^-1 (I - w C)^-1
  // r.
  void measure_contradictions() {
    for (std::size_t l = 0; l < graph_.edges.size(); ++l) {
      const auto& edge = graph_.edges[l];
      if (!edge.robust) continue;
      const int i = variable(edge.i), j = variable(edge.j);
      Residual e;
      EdgeJacobian J_i, J_j;
      error_of(edge, e, J_i, J_j);
      Jacobian root = information_[l];
      small::factorize<kRows>(root);
      const Jacobian U = small::transposed<kRows, kRows>(root);
      e = small::product<kRows, kRows, 1>(U, e);
      J_i = small::product<kRows, kRows, kSize>(U, J_i);
      J_j = small::product<kRows, kRows, kSize>(U, J_j);
      const auto between = [&](const EdgeJacobian& A, const Square& S, const EdgeJacobian& B) {
        return small::product<kRows, kSize, kRows>(small::product<kRows, kSize, kSize>(A, S),
                                                   small::transposed<kRows, kSize>(B));
      };
      Jacobian C = Jacobian::Zero();
      if (i >= 0) C += between(J_i, H_.inverse(i), J_i);
      if (j >= 0) C += between(J_j, H_.inverse(j), J_j);
      if (i >= 0 && j >= 0) {
        const Jacobian cross = between(J_i, H_.inverse(slots_[l]), J_j);
        C += cross + small::transposed<kRows, kRows>(cross);
      }
      // The weight is 1 or 0.
      Jacobian M =
          weight_[l] == 1.0 ? Jacobian(Jacobian::Identity() - C) : Jacobian(Jacobian::Identity() + C);
      // What nothing else determines is met exactly, and so not contradicted: e and M are zero along it but
      // for rounding and the solver's tolerance, to which this is large.
      for (double ridge = 1e-8; ridge < 1.0; ridge *= 10.0) {
        Jacobian L = M;
        L.diagonal().array() += ridge;
        if (!small::factorize<kRows>(L)) continue;
        result_.contradiction[l] = small::solve_lower<kRows, 1>(L, e).squaredNorm();
        break;
      }
    }
  }

  void find_wrong_edges();
  void finish();

  const Graph& graph_;
  const PoseGraphOptions& options_;
  Freedom freedom_;
  const std::atomic<bool>* stop_;
  double gate_;
  std::vector<int> variable_;  // of each node, -1: stays
  int free_ = 0;
  std::vector<Pose> x_;
  std::vector<double> weight_;
  std::vector<Slot> slots_;
  std::vector<Jacobian> information_;  // of each edge, as used
  BlockCholesky<kSize> H_;
  Eigen::VectorXd gradient_;
  Result result_;
};

// If some edge is contradicted in the solution with all of them, or the whole does not fit, begins anew
// without any robust edge and takes in those that what is known does not contradict, all at once and again
// with what is known then: so wrong edges that agree with each other do not speak for one another before
// right ones have spoken. From there it descends on half the sum of min(contradiction, gate), an edge at a
// time: leaving an edge out, or taking it back, changes the cost by its contradiction, exactly so where the
// problem is linear. A change that does not bring the cost down is undone and ends the search.
template <class Freedom>
void PoseGraphSolver<Freedom>::find_wrong_edges() {
  invert();
  measure_contradictions();
  const double freedom = static_cast<double>(kRows) * static_cast<double>(graph_.edges.size()) -
                         static_cast<double>(kSize) * free_;
  const double cost_of_all = cost_of(x_);
  const bool fits = 2.0 * cost_of_all <= freedom + kNormalGate * std::sqrt(2.0 * freedom);
  if (fits && std::all_of(result_.contradiction.begin(), result_.contradiction.end(),
                          [&](double c) { return c <= gate_; }))
    return;
  const std::vector<Pose> x_of_all = x_;
  const std::vector<double> contradiction_of_all = result_.contradiction;
  const bool converged_of_all = result_.converged;
  std::vector<Pose> before;
  for (std::size_t l = 0; l < graph_.edges.size(); ++l)
    if (graph_.edges[l].robust) weight_[l] = 0.0;
  for (std::size_t k = 0; k < x_.size(); ++k) x_[k] = graph_.nodes[k].T_world_node;
  result_.converged = minimise();
  for (bool taken = true; taken && !asked_to_stop();) {
    invert();
    measure_contradictions();
    taken = false;
    for (std::size_t l = 0; l < graph_.edges.size(); ++l)
      if (weight_[l] == 0.0 && result_.contradiction[l] <= gate_) {
        weight_[l] = 1.0;
        taken = true;
      }
    if (taken) result_.converged = minimise();
  }
  double cost = cost_of(x_);
  while (!asked_to_stop()) {
    invert();
    measure_contradictions();
    std::size_t change = graph_.edges.size();
    double best_gain = 0.0;
    for (std::size_t l = 0; l < graph_.edges.size(); ++l) {
      if (!graph_.edges[l].robust) continue;
      const double gain = (result_.contradiction[l] - gate_) * (weight_[l] == 0.0 ? -1.0 : 1.0);
      if (gain > best_gain) {
        best_gain = gain;
        change = l;
      }
    }
    if (change == graph_.edges.size()) break;
    before = x_;
    weight_[change] = 1.0 - weight_[change];
    const bool converged = minimise();
    const double new_cost = cost_of(x_);
    if (!(new_cost < cost)) {
      weight_[change] = 1.0 - weight_[change];
      x_.swap(before);
      break;
    }
    cost = new_cost;
    result_.converged = converged;
  }
  if (asked_to_stop()) return;
  if (!(cost < cost_of_all)) {
    x_ = x_of_all;
    weight_.assign(weight_.size(), 1.0);
    result_.contradiction = contradiction_of_all;
    result_.converged = converged_of_all;
    return;
  }
  // What wrong edges bent may not have come back all the way: again from the poses given.
  before = x_;
  for (std::size_t k = 0; k < x_.size(); ++k) x_[k] = graph_.nodes[k].T_world_node;
  const bool converged = minimise();
  if (cost_of(x_) < cost * (1.0 - 1e-6)) {
    result_.converged = converged;
    invert();
    measure_contradictions();
  } else {
    x_.swap(before);
  }
}

template <class Freedom>
void PoseGraphSolver<Freedom>::finish() {
  Result& r = result_;
  r.final_cost = cost_of(x_);
  r.usable = std::isfinite(r.final_cost) &&
             std::all_of(x_.begin(), x_.end(), [](const Pose& T) { return is_finite(T); });
  if (!r.usable)
    for (std::size_t k = 0; k < x_.size(); ++k) x_[k] = graph_.nodes[k].T_world_node;
  for (std::size_t l = 0; l < graph_.edges.size(); ++l) {
    const auto& edge = graph_.edges[l];
    const Residual e = pose_graph_error(at(x_, edge.i), at(x_, edge.j), edge.T_i_j);
    r.chi2.push_back(squared(information_[l], e));
    double weight = weight_[l], cost;
    if (edge.robust && options_.loss != PoseGraphLoss::truncated) loss(r.chi2.back(), cost, weight);
    r.weight.push_back(weight);
    if (weight < 0.5) r.rejected.push_back(static_cast<int>(l));
  }
  if (options_.covariances) {
    if (free_ > 0) invert();
    for (std::size_t k = 0; k < x_.size(); ++k) {
      typename Result::Covariance covariance = Result::Covariance::Zero();
      if (const int v = variable_[k]; v >= 0) {
        const EdgeJacobian B = freedom_.along(x_[k], Jacobian(Jacobian::Identity()));
        covariance = small::product<kRows, kSize, kRows>(
            small::product<kRows, kSize, kSize>(B, H_.inverse(v)), small::transposed<kRows, kSize>(B));
      }
      r.covariance.push_back(covariance);
    }
  }
  r.T_world_node = std::move(x_);
}

}  // namespace sweepkit
