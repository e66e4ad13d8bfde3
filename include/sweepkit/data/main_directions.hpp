// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "sweepkit/core/options.hpp"
#include "sweepkit/data/evaluation.hpp"
#include "sweepkit/direction/main_direction.hpp"

namespace sweepkit {

/// One line of `main_direction_result.txt`, without its line end: stamp of the window's first frame [s, 9
/// decimals], angle of the main direction from the left camera there [deg], confidence, stamp of the run's
/// first frame, angle there.
std::string main_direction_line(const MainDirection& direction);

/// Writes a result file, one line a detection; an empty file says that there was none. @throws Error(io)
void write_main_directions(const std::filesystem::path& file, const std::vector<MainDirection>& directions);

/// Reads a result file; only stamps, angles and confidence are known. @throws Error(io, data) naming file and
/// line
std::vector<MainDirection> read_main_directions(const std::filesystem::path& file);

/// The true angle of the main direction from the left camera at an instant.
struct TrueDirection {
  TimeNs t = 0;
  double angle = 0;  ///< [rad], in (-45, 45] degrees
};

/// Reads the truth: `main_direction_gt.txt`, lines of a stamp [s] and an angle [deg]; or the `truth.yaml` of
/// a simulated recording or the recording's folder: the angle at its first frame and, where true poses and
/// mav0 lie beside it, at every true pose.
/// @throws Error(io, data) naming file and line
std::vector<TrueDirection> read_true_directions(const std::filesystem::path& file);

struct DirectionEvaluationOptions {
  double max_dt = 0.06;
  double right = 2.0;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(max_dt, "max_dt", "s", range(0, 10), "largest difference of the stamps of an angle and its truth");
    v(right, "right", "deg", range(0, 45), "error up to which an answer is right");
  }
};

/// An angle that was given and its truth.
struct DirectionPair {
  TimeNs t = 0;
  double estimate = 0;  ///< [rad]
  double truth = 0;     ///< [rad]
  double error = 0;     ///< estimate - truth modulo a quarter turn [rad]
  double confidence = 0;
  bool at_run = false;  ///< the angle carried to the run's first frame
};

struct DirectionEvaluation {
  DirectionEvaluationOptions options;
  std::vector<DirectionPair> pairs;
  std::size_t answers = 0;
  ErrorStatistics window_deg;  ///< of the angles at the windows' first frames
  ErrorStatistics run_deg;     ///< of those carried to the run's first frame
  double right_share = 0;      ///< of all pairs
};

/// Compares the answers with the truth nearest in time. @throws Error(data) if no angle has a truth within
/// max_dt
DirectionEvaluation evaluate_main_directions(const std::vector<TrueDirection>& truth,
                                             const std::vector<MainDirection>& answers,
                                             const DirectionEvaluationOptions& options = {});

/// The content of evaluation.json; angles in degrees.
std::string to_json(const DirectionEvaluation& evaluation);

/// The figures as lines for people.
std::string to_table(const DirectionEvaluation& evaluation);

}  // namespace sweepkit
