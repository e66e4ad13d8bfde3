// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/data/main_directions.hpp"

#include <fmt/format.h>
#include <yaml-cpp/yaml.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <nlohmann/json.hpp>
#include <numbers>
#include <optional>

#include "sweepkit/data/recording.hpp"
#include "text_file.hpp"

namespace sweepkit {
namespace {

constexpr double kDegree = std::numbers::pi / 180;

std::string stamp_text(TimeNs t) {
  const bool negative = t < 0;
  const auto ns = static_cast<std::uint64_t>(negative ? -t : t);
  return fmt::format("{}{}.{:09}", negative ? "-" : "", ns / kNsPerSecond, ns % kNsPerSecond);
}

// An angle just above -45 degrees must not be printed as -45.
double degrees_for_file(double angle) {
  const double rounded = std::round(wrap_quarter_turn(angle) / kDegree * 1e6) / 1e6;
  return rounded <= -45.0 ? rounded + 90.0 : rounded;
}

double yaml_number(const std::filesystem::path& file, const YAML::Node& node, const std::string& name) {
  if (!node || !node.IsScalar()) throw Error(ErrorKind::data, file.string(), name + " is missing");
  const std::optional<double> value = [&]() -> std::optional<double> {
    try {
      return node.as<double>();
    } catch (const YAML::Exception&) {
      return std::nullopt;
    }
  }();
  if (!value || !std::isfinite(*value))
    throw Error(ErrorKind::data, file.string() + ":" + std::to_string(node.Mark().line + 1),
                name + " must be a number", node.Scalar());
  return *value;
}

std::vector<TrueDirection> read_truth_yaml(const std::filesystem::path& file) {
  YAML::Node root;
  try {
    root = YAML::LoadFile(file.string());
  } catch (const YAML::BadFile&) {
    throw Error(ErrorKind::io, file.string(), "cannot be read");
  } catch (const YAML::Exception& error) {
    throw Error(ErrorKind::data, file.string() + ":" + std::to_string(error.mark.line + 1), error.msg);
  }
  if (!root.IsMap() || !root["main_direction"] || !root["main_direction"].IsMap())
    throw Error(ErrorKind::data, file.string(), "main_direction is missing");
  const YAML::Node main = root["main_direction"];
  const std::filesystem::path folder = file.parent_path();
  const std::filesystem::path poses = folder / "mav0/state_groundtruth_estimate0/data.csv";
  std::vector<TrueDirection> truth;
  if (std::filesystem::exists(poses) && main["yaw_world_deg"]) {
    const double room = yaml_number(file, main["yaw_world_deg"], "main_direction.yaw_world_deg") * kDegree;
    const auto recording = open_recording(folder.empty() ? "." : folder, {.prefetch = 0});
    if (!recording->rig().left) throw Error(ErrorKind::data, folder.string(), "cam0 is missing");
    const SO3d R_body_left = recording->rig().left->T_body_camera.rotation();
    for (const StampedPose& pose : read_trajectory(poses)) {
      const Vec3<double> forward = pose.T_world_body.rotation() * (R_body_left * Vec3<double>::UnitZ());
      truth.push_back({pose.t, wrap_quarter_turn(room - std::atan2(forward.y(), forward.x()))});
    }
    return truth;
  }
  const double angle = yaml_number(file, main["yaw_from_left_camera_frame0_deg"],
                                   "main_direction.yaw_from_left_camera_frame0_deg");
  const double first =
      root["first_frame_s"] ? yaml_number(file, root["first_frame_s"], "first_frame_s") : 0.0;
  if (!root["start_time_ns"]) throw Error(ErrorKind::data, file.string(), "start_time_ns is missing");
  TimeNs start = 0;
  try {
    start = root["start_time_ns"].as<TimeNs>();
  } catch (const YAML::Exception&) {
    throw Error(ErrorKind::data, file.string(), "start_time_ns must be whole nanoseconds",
                root["start_time_ns"].Scalar());
  }
  return {{start + from_seconds(first), wrap_quarter_turn(angle * kDegree)}};
}

nlohmann::json statistics_json(const ErrorStatistics& s) {
  return {{"mean", s.mean}, {"median", s.median}, {"rmse", s.rmse}, {"max", s.max}};
}

}  // namespace

std::string main_direction_line(const MainDirection& d) {
  return fmt::format("{} {:.6f} {:.6f} {} {:.6f}", stamp_text(d.window_begin), degrees_for_file(d.angle),
                     d.confidence, stamp_text(d.run_begin), degrees_for_file(d.run_angle));
}

void write_main_directions(const std::filesystem::path& file, const std::vector<MainDirection>& directions) {
  std::ofstream out(file, std::ios::binary);
  for (const MainDirection& d : directions) out << main_direction_line(d) << '\n';
  out.close();
  if (!out) throw Error(ErrorKind::io, file.string(), "cannot be written");
}

std::vector<MainDirection> read_main_directions(const std::filesystem::path& file) {
  TextFile text(file);
  std::vector<MainDirection> directions;
  while (text.next_data()) {
    const auto& fields = text.fields(5);
    MainDirection d;
    d.window_begin = text.stamp_s_of(fields[0]);
    d.angle = wrap_quarter_turn(text.number_of(fields[1]) * kDegree);
    d.confidence = text.number_of(fields[2]);
    if (d.confidence < 0 || d.confidence > 1) throw text.error("a confidence must be in [0, 1]", fields[2]);
    d.run_begin = text.stamp_s_of(fields[3]);
    d.run_angle = wrap_quarter_turn(text.number_of(fields[4]) * kDegree);
    directions.push_back(d);
  }
  return directions;
}

std::vector<TrueDirection> read_true_directions(const std::filesystem::path& file) {
  if (std::filesystem::is_directory(file)) {
    for (const char* name : {"truth.yaml", "main_direction_gt.txt"})
      if (std::filesystem::exists(file / name)) return read_true_directions(file / name);
    throw Error(ErrorKind::io, file.string(), "has neither truth.yaml nor main_direction_gt.txt");
  }
  if (file.extension() == ".yaml") return read_truth_yaml(file);
  TextFile text(file);
  std::vector<TrueDirection> truth;
  while (text.next_data()) {
    const auto& fields = text.fields(2);
    truth.push_back({text.stamp_s_of(fields[0]), wrap_quarter_turn(text.number_of(fields[1]) * kDegree)});
  }
  if (truth.empty()) throw Error(ErrorKind::data, file.string(), "has no direction");
  std::stable_sort(truth.begin(), truth.end(), [](const auto& a, const auto& b) { return a.t < b.t; });
  return truth;
}

DirectionEvaluation evaluate_main_directions(const std::vector<TrueDirection>& truth,
                                             const std::vector<MainDirection>& answers,
                                             const DirectionEvaluationOptions& options) {
  check_options(options);
  DirectionEvaluation result;
  result.options = options;
  result.answers = answers.size();
  const auto add = [&](TimeNs t, double angle, double confidence, bool at_run) {
    const TrueDirection* nearest = nullptr;
    for (const TrueDirection& candidate : truth)
      if (!nearest || std::abs(candidate.t - t) < std::abs(nearest->t - t)) nearest = &candidate;
    if (!nearest || to_seconds(std::abs(nearest->t - t)) > options.max_dt) return;
    result.pairs.push_back(
        {t, angle, nearest->angle, wrap_quarter_turn(angle - nearest->angle), confidence, at_run});
  };
  for (const MainDirection& a : answers) {
    add(a.window_begin, a.angle, a.confidence, false);
    add(a.run_begin, a.run_angle, a.confidence, true);
  }
  if (result.pairs.empty())
    throw Error(ErrorKind::data, "evaluate_main_directions", "no answer has a truth within max_dt",
                std::to_string(answers.size()) + " answers");
  std::vector<double> window, run;
  std::size_t right = 0;
  for (const DirectionPair& p : result.pairs) {
    const double error = std::abs(p.error) / kDegree;
    (p.at_run ? run : window).push_back(error);
    right += error <= options.right;
  }
  if (!window.empty()) result.window_deg = error_statistics(window);
  if (!run.empty()) result.run_deg = error_statistics(run);
  result.right_share = static_cast<double>(right) / static_cast<double>(result.pairs.size());
  return result;
}

std::string to_json(const DirectionEvaluation& e) {
  nlohmann::json pairs = nlohmann::json::array();
  for (const DirectionPair& p : e.pairs)
    pairs.push_back({{"t", to_seconds(p.t)},
                     {"at", p.at_run ? "run" : "window"},
                     {"estimate_deg", p.estimate / kDegree},
                     {"truth_deg", p.truth / kDegree},
                     {"error_deg", p.error / kDegree},
                     {"confidence", p.confidence}});
  const nlohmann::json json = {{"answers", e.answers},
                               {"pairs", pairs},
                               {"window_error_deg", statistics_json(e.window_deg)},
                               {"run_error_deg", statistics_json(e.run_deg)},
                               {"right_within_deg", e.options.right},
                               {"right_share", e.right_share}};
  return json.dump(2) + "\n";
}

std::string to_table(const DirectionEvaluation& e) {
  std::string text = fmt::format("{:<8}{:>22}{:>12}{:>12}{:>12}{:>12}\n", "angle at", "stamp", "given deg",
                                 "true deg", "error deg", "confidence");
  for (const DirectionPair& p : e.pairs)
    text += fmt::format("{:<8}{:>22}{:>12.4f}{:>12.4f}{:>12.4f}{:>12.4f}\n", p.at_run ? "run" : "window",
                        stamp_text(p.t), p.estimate / kDegree, p.truth / kDegree, p.error / kDegree,
                        p.confidence);
  text += fmt::format(
      "answers {}, error at window mean {:.3f} max {:.3f}, at run mean {:.3f} max {:.3f} deg; {:.1f} % "
      "within {:g} deg\n",
      e.answers, e.window_deg.mean, e.window_deg.max, e.run_deg.mean, e.run_deg.max, 100 * e.right_share,
      e.options.right);
  return text;
}

}  // namespace sweepkit
