// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/data/evaluation.hpp"

#include <fmt/format.h>

#include <filesystem>
#include <fstream>

#include "command_line.hpp"
#include "sweepkit/data/main_directions.hpp"

namespace {

int evaluate_directions(const std::string& truth, const std::string& result, const std::string& out) {
  using namespace sweepkit;
  const std::vector<MainDirection> answers = read_main_directions(result);
  if (answers.empty()) {
    fmt::print(stderr, "evaluate: {} holds no answer\n", result);
    return 1;
  }
  const DirectionEvaluation evaluation = evaluate_main_directions(read_true_directions(truth), answers);
  fmt::print("{}", to_table(evaluation));
  if (out.empty()) return 0;
  std::filesystem::create_directories(out);
  const std::filesystem::path file = std::filesystem::path(out) / "evaluation.json";
  std::ofstream stream(file, std::ios::binary);
  stream << to_json(evaluation);
  stream.close();
  if (!stream) throw Error(ErrorKind::io, file.string(), "cannot be written");
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  using namespace sweepkit;
  EvaluationOptions options;
  std::string truth, estimate, directions, times, out;
  const ProgramInfo info{
      "evaluate",
      "Compares an estimated trajectory, or main directions, with the truth.",
      {"evaluate --truth RECORDING --estimate out/trajectory_live.tum",
       "evaluate --truth mav0/state_groundtruth_estimate0/data.csv --estimate live.tum --align first --out "
       "out",
       "evaluate --truth poses.txt --times times.txt --estimate live.tum --set rpe_unit=seconds",
       "evaluate --truth RECORDING --directions out/main_direction_result.txt"},
      {{"--align", "align"}, {"--max-dt", "max_dt"}},
      {{"--truth", "PATH",
        "true poses: TUM, EuRoC csv, KITTI poses, or a recording that has them; for directions "
        "main_direction_gt.txt, truth.yaml, or a recording with one of them",
        &truth, true},
       {"--estimate", "FILE", "estimated poses: TUM, EuRoC csv or KITTI poses", &estimate},
       {"--directions", "FILE", "estimated main directions: main_direction_result.txt", &directions},
       {"--times", "FILE", "stamps of KITTI poses; without it times.txt beside them", &times},
       {"--out", "DIR", "folder for evaluation.json and evaluation.svg", &out}}};
  return run_program(argc, argv, info, list_options(options), [&] {
    if (estimate.empty() == directions.empty())
      throw Error(ErrorKind::option, "--estimate", "one of --estimate and --directions must be given");
    if (!directions.empty()) return evaluate_directions(truth, directions, out);
    const Evaluation evaluation =
        evaluate_trajectory(read_trajectory(truth, times), read_trajectory(estimate, times), options);
    fmt::print("{}", to_table(evaluation));
    if (!out.empty()) write_evaluation(out, evaluation);
    return 0;
  });
}
