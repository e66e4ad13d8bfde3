// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/data/evaluation.hpp"

#include <fmt/format.h>

#include "command_line.hpp"

int main(int argc, char** argv) {
  using namespace sweepkit;
  EvaluationOptions options;
  std::string truth, estimate, times, out;
  const ProgramInfo info{
      "evaluate",
      "Compares an estimated trajectory with the true one.",
      {"evaluate --truth RECORDING --estimate out/trajectory_live.tum",
       "evaluate --truth mav0/state_groundtruth_estimate0/data.csv --estimate live.tum --align first --out "
       "out",
       "evaluate --truth poses.txt --times times.txt --estimate live.tum --set rpe_unit=seconds"},
      {{"--align", "align"}, {"--max-dt", "max_dt"}},
      {{"--truth", "PATH", "true poses: TUM, EuRoC csv, KITTI poses, or a recording that has them", &truth,
        true},
       {"--estimate", "FILE", "estimated poses: any of these", &estimate, true},
       {"--times", "FILE", "stamps of KITTI poses; without it times.txt beside them", &times},
       {"--out", "DIR", "folder for evaluation.json and evaluation.svg", &out}}};
  return run_program(argc, argv, info, list_options(options), [&] {
    const Evaluation evaluation =
        evaluate_trajectory(read_trajectory(truth, times), read_trajectory(estimate, times), options);
    fmt::print("{}", to_table(evaluation));
    if (!out.empty()) write_evaluation(out, evaluation);
    return 0;
  });
}
