// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/data/evaluation.hpp"

#include <fmt/format.h>

#include <filesystem>
#include <fstream>
#include <numbers>

#include "command_line.hpp"
#include "sweepkit/data/grid_evaluation.hpp"
#include "sweepkit/data/main_directions.hpp"
#include "sweepkit/floor/grid_file.hpp"

namespace {

/// Writes evaluation.json into a folder, if one is named.
void write_json(const std::string& out, const std::string& content) {
  if (out.empty()) return;
  std::filesystem::create_directories(out);
  const std::filesystem::path file = std::filesystem::path(out) / "evaluation.json";
  std::ofstream stream(file, std::ios::binary);
  stream << content;
  stream.close();
  if (!stream) throw sweepkit::Error(sweepkit::ErrorKind::io, file.string(), "cannot be written");
}

int evaluate_directions(const std::string& truth, const std::string& result, const std::string& out) {
  using namespace sweepkit;
  const std::vector<MainDirection> answers = read_main_directions(result);
  if (answers.empty()) {
    fmt::print(stderr, "evaluate: {} holds no answer\n", result);
    return 1;
  }
  const DirectionEvaluation evaluation = evaluate_main_directions(read_true_directions(truth), answers);
  fmt::print("{}", to_table(evaluation));
  write_json(out, to_json(evaluation));
  return 0;
}

/// Where the frame of a grid is in the truth's: by the trajectory that belongs to the grid, if there is one.
sweepkit::PlanarPose pose_of_grid(const sweepkit::Trajectory& truth, const std::string& estimate,
                                  const sweepkit::EvaluationOptions& options) {
  using namespace sweepkit;
  if (estimate.empty()) return {};
  const Evaluation evaluation = evaluate_trajectory(truth, read_trajectory(estimate), options);
  constexpr double kMostTilt = 0.1;  // [rad]
  const auto pose = PlanarPose::of(evaluation.T_truth_estimate, kMostTilt);
  if (!pose) throw Error(ErrorKind::data, estimate, "its z axis is not the truth's");
  fmt::print("{:<20}{}: {:.3f} m, {:.3f} m, {:.2f} deg\n", "alignment", evaluation.alignment, pose->x,
             pose->y, pose->yaw * 180 / std::numbers::pi);
  return *pose;
}

int evaluate_occupancy(const std::string& grid, const std::string& truth, const std::string& recording_path,
                       const std::string& estimate_path, const std::string& out,
                       const sweepkit::EvaluationOptions& options,
                       const sweepkit::GridEvaluationOptions& grid_options) {
  using namespace sweepkit;
  namespace fs = std::filesystem;
  const OccupancyImage map = read_grid(grid), true_map = read_grid(truth);
  fs::path folder = recording_path;
  if (folder.empty() && fs::exists(fs::path(truth).parent_path() / "mav0")) {
    folder = fs::path(truth).parent_path();
    if (folder.empty()) folder = ".";
  }
  std::string estimate = estimate_path;
  if (estimate.empty() && fs::exists(fs::path(grid).parent_path() / "trajectory_optimized.tum"))
    estimate = (fs::path(grid).parent_path() / "trajectory_optimized.tum").string();
  std::vector<FloorView> views;
  PlanarPose pose;
  if (!folder.empty()) {
    const Trajectory true_path = read_trajectory(folder);
    views = floor_views(*open_recording(folder), true_path);
    pose = pose_of_grid(true_path, estimate, options);
  } else if (!estimate_path.empty()) {
    throw Error(ErrorKind::option, "--recording", "is needed to lay the grid over the truth by --estimate");
  }
  const GridEvaluation evaluation = evaluate_grid(map, true_map, pose, views, grid_options);
  fmt::print("{}", to_table(evaluation));
  write_json(out, to_json(evaluation));
  return 0;
}

/// Everything that evaluate may be told; the options of trajectories have no prefix.
struct ProgramOptions : sweepkit::EvaluationOptions {
  sweepkit::GridEvaluationOptions grid;

  template <class Visitor>
  void visit_options(Visitor& v) {
    sweepkit::EvaluationOptions::visit_options(v);
    v.group(grid, "grid", "occupancy grids");
  }
};

}  // namespace

int main(int argc, char** argv) {
  using namespace sweepkit;
  ProgramOptions options;
  std::string truth, estimate, directions, times, grid, recording, out;
  const ProgramInfo info{
      "evaluate",
      "Compares an estimated trajectory, main directions or an occupancy grid with the truth.",
      {"evaluate --truth RECORDING --estimate out/trajectory_live.tum",
       "evaluate --truth mav0/state_groundtruth_estimate0/data.csv --estimate live.tum --align first --out "
       "out",
       "evaluate --truth poses.txt --times times.txt --estimate live.tum --set rpe_unit=seconds",
       "evaluate --truth RECORDING --directions out/main_direction_result.txt",
       "evaluate --truth RECORDING/floor_occupancy.yaml --grid out/grid.yaml"},
      {{"--align", "align"}, {"--max-dt", "max_dt"}},
      {{"--truth", "PATH",
        "true poses: TUM, EuRoC csv, KITTI poses, or a recording that has them; for directions "
        "main_direction_gt.txt, truth.yaml, or a recording with one of them; for a grid its true occupancy "
        "(map_server YAML)",
        &truth, true},
       {"--estimate", "FILE", "estimated poses: TUM, EuRoC csv or KITTI poses", &estimate},
       {"--directions", "FILE", "estimated main directions: main_direction_result.txt", &directions},
       {"--grid", "FILE",
        "occupancy grid (map_server YAML); --estimate then is the trajectory in its frame, without it "
        "trajectory_optimized.tum beside the grid",
        &grid},
       {"--recording", "DIR",
        "whose truth and cameras tell what was visible of the floor; without it the folder of the true "
        "occupancy",
        &recording},
       {"--times", "FILE", "stamps of KITTI poses; without it times.txt beside them", &times},
       {"--out", "DIR", "folder for evaluation.json and evaluation.svg", &out}}};
  return run_program(argc, argv, info, list_options(options), [&] {
    if (grid.empty() ? estimate.empty() == directions.empty() : !directions.empty())
      throw Error(ErrorKind::option, "--estimate",
                  "one of --estimate, --directions and --grid must be given; --estimate may go with --grid");
    if (!grid.empty())
      return evaluate_occupancy(grid, truth, recording, estimate, out, options, options.grid);
    if (!directions.empty()) return evaluate_directions(truth, directions, out);
    const Evaluation evaluation =
        evaluate_trajectory(read_trajectory(truth, times), read_trajectory(estimate, times), options);
    fmt::print("{}", to_table(evaluation));
    if (!out.empty()) write_evaluation(out, evaluation);
    return 0;
  });
}
