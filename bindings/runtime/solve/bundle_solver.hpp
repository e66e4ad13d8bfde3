// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstdint>
#include <vector>

#include "block_cholesky.hpp"
#include "sweepkit/solve/bundle.hpp"

namespace sweepkit {

/// Chi-square, 95 %, for 2, 3 and 6 degrees of freedom.
inline constexpr double kGateMono = 5.991464547107979;
inline constexpr double kGateStereo = 7.814727903251179;
inline constexpr double kGateRelative = 12.59;

/// What a bundle's solution moves.
struct BundleState {
  std::vector<SE3d> T_camera_world;
  std::vector<Mat3<double>> R;  ///< of these
  std::vector<Vec3<double>> points;
  double bias = 0.0;  ///< of disparities [px]
};

/// Levenberg and Marquardt on a bundle, after Triggs, McLauchlan, Hartley and Fitzgibbon, Bundle adjustment -
/// a modern synthesis (1999): points are eliminated one by one, what remains of the poses is solved by
/// blocks, the bias of the disparities as a border of one more column. Robust weights are those of
/// iteratively reweighted least squares.
///
/// With A the derivative of the weighted errors by the point in the camera's frame, and M = A' A, a 3 x 3
/// matrix, all that an observation adds to the normal equations follows from M, R and the point alone; no
/// Jacobian is ever written down.
class BundleSolver {
 public:
  /// @param problem must outlive this; of it only what is known stays in use, not poses and points
  /// @param determined for each point: whether its observations count
  BundleSolver(const RectifiedCamera& camera, const BundleProblem& problem, const BundleOptions& options,
               const std::vector<std::uint8_t>& determined);

  bool empty() const { return seen_.empty() && relative_.empty(); }
  bool estimates_bias() const { return estimates_bias_; }

  /// @param i of a point that is determined
  void switch_observation(std::size_t i, bool on) { seen_[place_[i]].on = on; }
  void switch_off_relative(std::size_t i) { relative_[i].on = false; }

  struct Outcome {
    bool usable = false, converged = false;
    int iterations = 0;
    double initial_cost = 0.0, final_cost = 0.0;
  };
  /// Moves the state; ends early once it is asked to.
  Outcome minimise(BundleState& state, int iterations, const std::atomic<bool>* stop);

  /// What all observations that are on and all relative poses say of the bias when poses and points are
  /// unknown [1/px^2]; without its prior and without robust weights.
  double bias_information(const BundleState& state);

 private:
  struct Seen {  // an observation; those of a point lie side by side
    int pose, column;
    bool on = true;
    double u, v, disparity;
    double weight, weight_disparity;  // 1 / sigma; the latter 0 if only the left camera sees it
    double scale2;                    // beyond this squared error Huber's loss is linear
  };
  struct OfPoint {
    std::uint32_t point, begin, end;  // of seen_
    std::uint32_t pairs;              // of pair_slots_: where its own begin
  };
  struct Eliminated {
    Mat3<double> inverse;
    Vec3<double> gradient, border, damping;
  };
  struct Relative {
    int a, b, column_a, column_b;
    BlockCholesky<6>::Slot slot;
    SE3d T_a_b;
    Mat6<double> information;
    bool on = true;
  };
  struct Step {
    Eigen::VectorXd poses;
    std::vector<Vec3<double>> points;
    double bias = 0.0;
    double promised = 0.0;  // by how much the cost falls, if all were linear
  };

  double cost(const BundleState& state) const;
  // Normal equations at a state, points eliminated. False if they are singular.
  bool build(const BundleState& state, double damping, bool robust);
  void add_point(const BundleState& state, std::size_t k, double damping, bool robust);
  void eliminate(std::size_t k);
  void add_relative(const BundleState& state, bool robust);
  bool solve(Step& step);
  BundleState moved(const BundleState& state, const Step& step) const;

  const RectifiedCamera camera_;
  const BundleProblem& problem_;
  const double relative_scale2_, tolerance_;
  bool estimates_bias_ = false;
  std::vector<int> column_;           // of each pose, -1: stays
  std::vector<int> pose_of_;          // of each column
  std::vector<Seen> seen_;            // by point
  std::vector<std::uint32_t> place_;  // of each observation in seen_
  std::vector<OfPoint> of_points_;
  std::vector<std::int32_t> pair_slots_;  // 2 * index + transposed, of pairs of free poses, by point
  std::vector<Relative> relative_;

  BlockCholesky<6> S_;
  std::vector<Mat6<double>> U_;  // of poses, before points are eliminated
  Eigen::VectorXd gradient_, border_, pose_damping_;
  double bias_gradient_ = 0.0, bias_curvature_ = 0.0, bias_damping_ = 0.0;
  double full_bias_gradient_ = 0.0;
  Eigen::VectorXd full_gradient_;
  std::vector<Eigen::Matrix<double, 6, 3>> W_;  // of each of seen_
  std::vector<Eliminated> eliminated_;          // of each point
};

}  // namespace sweepkit
