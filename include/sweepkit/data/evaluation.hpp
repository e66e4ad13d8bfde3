// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "sweepkit/core/options.hpp"
#include "sweepkit/data/trajectory.hpp"

namespace sweepkit {

/// How the estimate is laid over the truth before positions are compared.
enum class AlignMode {
  none,   ///< as it is
  first,  ///< the first pair of poses made equal
  se3,    ///< the rigid motion with the least squares of position errors (Umeyama 1991)
  sim3,   ///< the same with a scale
};

/// What the distance between the two poses of a relative error is measured in.
enum class RpeUnit { frames, seconds, metres };

struct EvaluationOptions {
  AlignMode align = AlignMode::se3;
  double max_dt = 0.01;
  RpeUnit rpe_unit = RpeUnit::metres;
  double rpe_delta = 1.0;
  bool rpe_all_pairs = true;
  double min_path = 1.0;
  double min_turn = 30.0;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v.choice(align, "align",
             {{AlignMode::none, "none"},
              {AlignMode::first, "first"},
              {AlignMode::se3, "se3"},
              {AlignMode::sim3, "sim3"}},
             "lay the estimate over the truth: not, by the first pose, by a rigid motion, by one with scale");
    v(max_dt, "max_dt", "s", range(0, 10), "largest difference of the stamps of a pair of poses");
    v.choice(rpe_unit, "rpe_unit",
             {{RpeUnit::frames, "frames"}, {RpeUnit::seconds, "seconds"}, {RpeUnit::metres, "metres"}},
             "unit of rpe_delta");
    v(rpe_delta, "rpe_delta", "", range(1e-3, 1e6), "distance between the two poses of a relative error");
    v(rpe_all_pairs, "rpe_all_pairs", "", any_value(),
      "relative errors from every pose on; else one after the other, without overlap");
    v(min_path, "min_path", "m", range(0, 1e6),
      "travelled before the translation error is taken in per cent");
    v(min_turn, "min_turn", "deg", range(0, 1e6), "turned before the rotation error is taken in per cent");
  }
};

/// A figure for a set of errors. The median of an even number is the mean of the two in the middle.
struct ErrorStatistics {
  double rmse = 0.0;
  double mean = 0.0;
  double median = 0.0;
  double max = 0.0;
};

/// Statistics of at least one number.
ErrorStatistics error_statistics(std::vector<double> errors);

/// A true pose and the aligned estimate of it.
struct PosePair {
  TimeNs t = 0;  ///< of the estimate
  SE3d truth;
  SE3d estimate;                ///< aligned
  double position_error = 0.0;  ///< [m]
  double rotation_error = 0.0;  ///< angle of the relative rotation [rad]
  double path = 0.0;            ///< travelled up to here, by the truth [m]
  double turned = 0.0;          ///< turned up to here, by the truth [rad]
};

/// How far an estimated trajectory is from the true one.
struct Evaluation {
  EvaluationOptions options;
  /// The alignment that was used; with se3 and sim3 on a path that does not determine the rotation (straight,
  /// or at rest) "..., rotation of the first pose".
  std::string alignment;
  SE3d T_truth_estimate;
  double scale = 1.0;

  std::vector<PosePair> pairs;
  double coverage = 0.0;    ///< share of the truth's span within the estimate's, gaps of over 1 s taken out
  double path_m = 0.0;      ///< length of the true path through the pairs [m]
  double turned_deg = 0.0;  ///< sum of its turns [deg]

  ErrorStatistics ape_m;         ///< absolute position errors [m]
  ErrorStatistics rotation_deg;  ///< absolute rotation errors [deg]
  /// What is left of them after the one rotation of the world that fits all orientations best (chordal mean;
  /// Hartley and others, Rotation Averaging, 2013): does not hang on the first pose, nor on a path that may
  /// be a point [deg].
  ErrorStatistics rotation_fitted_deg;
  std::size_t rpe_pairs = 0;
  std::optional<ErrorStatistics>
      rpe_m;  ///< relative errors, translation [m]; nothing if no pair is so far apart
  std::optional<ErrorStatistics> rpe_deg;  ///< relative errors, rotation [deg]

  // Position error over distance travelled, and norm of the Euler angles (yaw, pitch, roll) of the relative
  // rotation over angle turned, in per cent; over instants after min_path and min_turn. Nothing if there is
  // none.
  std::optional<double> translation_error_percent_median, translation_error_percent_end;
  std::optional<double> rotation_error_percent_median, rotation_error_percent_end;
};

/// Compares two trajectories.
///
/// Pairs: for each pose of the trajectory with fewer poses, the nearest in time of the other, if within
/// max_dt; each pose is in one pair at most. APE: |t_truth - t_estimate| after the alignment. RPE: the
/// translation and the angle of (T_truth_i^-1 T_truth_j)^-1 (T_estimate_i^-1 T_estimate_j), j being the first
/// pose that is at least rpe_delta after i (metres: along the true path), as in Sturm et al., A benchmark for
/// the evaluation of RGB-D SLAM systems (IROS 2012).
/// @throws Error(data) if there is no pair
Evaluation evaluate_trajectory(const Trajectory& truth, const Trajectory& estimate,
                               const EvaluationOptions& options = {});

/// The content of evaluation.json; angles in degrees, figures that there are not as null.
std::string to_json(const Evaluation& evaluation);

/// The figures as lines for people.
std::string to_table(const Evaluation& evaluation);

/// A drawing of both paths from above (the two axes along which the truth extends farthest if it does not lie
/// flat) and of the errors over time.
std::string to_svg(const Evaluation& evaluation);

/// Writes evaluation.json and evaluation.svg into a folder, which is made if needed. @throws Error(io)
void write_evaluation(const std::filesystem::path& folder, const Evaluation& evaluation);

}  // namespace sweepkit
