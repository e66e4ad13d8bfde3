// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/data/evaluation.hpp"

#include <fmt/format.h>

#include <Eigen/LU>
#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <fstream>
#include <nlohmann/json.hpp>
#include <numbers>
#include <numeric>

#include "sweepkit/geometry/alignment.hpp"

namespace sweepkit {
namespace {

constexpr double kDegrees = 180.0 / std::numbers::pi;
constexpr TimeNs kLongestGap = kNsPerSecond;
/// What rounding may take from a sum of distances [m] or angles [deg] before it counts.
constexpr double kRounding = 1e-9;

/// Indices into truth and estimate.
using IndexPairs = std::vector<std::pair<std::size_t, std::size_t>>;

/// For each pose of `few` the nearest of `many`, both in order of time; in each pair the index of `few`
/// first.
IndexPairs associate(const Trajectory& few, const Trajectory& many, TimeNs max_dt) {
  IndexPairs pairs;
  std::size_t near = 0;
  for (std::size_t i = 0; i < few.size(); ++i) {
    const auto gap = [&](std::size_t j) { return std::abs(many[j].t - few[i].t); };
    while (near + 1 < many.size() && gap(near + 1) <= gap(near)) ++near;
    if (gap(near) > max_dt) continue;
    if (!pairs.empty() && pairs.back().second == near) {
      // Two poses want the same partner: the nearer one keeps it.
      if (std::abs(few[pairs.back().first].t - many[near].t) <= gap(near)) continue;
      pairs.pop_back();
    }
    pairs.emplace_back(i, near);
  }
  return pairs;
}

double median_of(std::vector<double>& values) {
  const std::size_t middle = values.size() / 2;
  std::nth_element(values.begin(), values.begin() + static_cast<std::ptrdiff_t>(middle), values.end());
  const double upper = values[middle];
  if (values.size() % 2 == 1) return upper;
  return 0.5 *
         (upper + *std::max_element(values.begin(), values.begin() + static_cast<std::ptrdiff_t>(middle)));
}

/// Norm of yaw, pitch and roll (rotations about z, y, x in this order) [rad].
double euler_norm(const SO3d& rotation) {
  const Mat3<double> R = rotation.matrix();
  const double yaw = std::atan2(R(1, 0), R(0, 0));
  const double pitch = std::atan2(-R(2, 0), std::hypot(R(0, 0), R(1, 0)));
  const double roll = std::atan2(R(2, 1), R(2, 2));
  return std::sqrt(yaw * yaw + pitch * pitch + roll * roll);
}

/// Finds the alignment from the pairs (poses of the estimate as they are) and names it.
void align(Evaluation& evaluation) {
  const auto& pairs = evaluation.pairs;
  const AlignMode mode = evaluation.options.align;
  evaluation.alignment = std::get<std::string>(list_options(evaluation.options).find("align")->value());
  const SE3d T_first = pairs.front().truth * pairs.front().estimate.inverse();
  if (mode == AlignMode::first) evaluation.T_truth_estimate = T_first;
  if (mode != AlignMode::se3 && mode != AlignMode::sim3) return;

  std::vector<Vec3<double>> from, to;
  for (const PosePair& pair : pairs) {
    from.push_back(pair.estimate.translation());
    to.push_back(pair.truth.translation());
  }
  const std::span<const Vec3<double>> src(from), dst(to);
  const auto found = mode == AlignMode::se3 ? align_se3(src, dst) : align_sim3(src, dst);
  if (found) {
    evaluation.T_truth_estimate = found->T_dst_src;
    evaluation.scale = found->scale;
    return;
  }
  // A straight path, or none at all: the best translation for the rotation that the first poses give.
  evaluation.alignment += ", rotation of the first pose";
  const SO3d& R = T_first.rotation();
  const Vec3<double> zero = Vec3<double>::Zero();
  const double count = static_cast<double>(pairs.size());
  const Vec3<double> mean_from = std::accumulate(from.begin(), from.end(), zero) / count;
  const Vec3<double> mean_to = std::accumulate(to.begin(), to.end(), zero) / count;
  if (mode == AlignMode::sim3) {
    double along = 0.0, square = 0.0;
    for (std::size_t i = 0; i < from.size(); ++i) {
      const Vec3<double> turned = R * Vec3<double>(from[i] - mean_from);
      along += turned.dot(to[i] - mean_to);
      square += turned.squaredNorm();
    }
    if (square > 0 && along > 0) evaluation.scale = along / square;
  }
  evaluation.T_truth_estimate = SE3d(R, mean_to - evaluation.scale * (R * mean_from));
}

/// Rotation errors [deg] after the rotation of the world that fits all orientations best.
std::vector<double> fitted_rotation_errors(const std::vector<PosePair>& pairs) {
  Mat3<double> sum = Mat3<double>::Zero();
  for (const PosePair& pair : pairs)
    sum += (pair.truth.rotation() * pair.estimate.rotation().inverse()).matrix();
  const Eigen::JacobiSVD<Mat3<double>> svd(sum, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Vec3<double> signs = Vec3<double>::Ones();
  signs.z() = (svd.matrixU() * svd.matrixV().transpose()).determinant();
  const SO3d R(Mat3<double>(svd.matrixU() * signs.asDiagonal() * svd.matrixV().transpose()));
  std::vector<double> degrees;
  degrees.reserve(pairs.size());
  for (const PosePair& pair : pairs)
    degrees.push_back((pair.truth.rotation().inverse() * R * pair.estimate.rotation()).angle() * kDegrees);
  return degrees;
}

void relative_errors(Evaluation& evaluation) {
  const auto& pairs = evaluation.pairs;
  const EvaluationOptions& options = evaluation.options;
  // Stamps are rounded more coarsely than sums: a microsecond must not cost a pose its partner.
  const auto far_enough = [&](std::size_t i, std::size_t j) {
    switch (options.rpe_unit) {
      case RpeUnit::frames:
        return static_cast<double>(j - i) >= options.rpe_delta;
      case RpeUnit::seconds:
        return to_seconds(pairs[j].t - pairs[i].t) >= options.rpe_delta - 1e-6;
      case RpeUnit::metres:
        break;
    }
    return pairs[j].path - pairs[i].path >= options.rpe_delta - kRounding;
  };
  std::vector<double> metres, degrees;
  for (std::size_t i = 0, j = 0; i < pairs.size(); i = options.rpe_all_pairs ? i + 1 : j) {
    j = std::max(j, i);
    while (j < pairs.size() && !far_enough(i, j)) ++j;
    if (j == pairs.size()) break;
    const SE3d truth = pairs[i].truth.inverse() * pairs[j].truth;
    const SE3d estimate = pairs[i].estimate.inverse() * pairs[j].estimate;
    const SE3d error = truth.inverse() * estimate;
    metres.push_back(error.translation().norm());
    degrees.push_back(error.rotation().angle() * kDegrees);
  }
  evaluation.rpe_pairs = metres.size();
  if (metres.empty()) return;
  evaluation.rpe_m = error_statistics(std::move(metres));
  evaluation.rpe_deg = error_statistics(std::move(degrees));
}

void percentages(Evaluation& evaluation) {
  std::vector<double> translation, rotation;
  for (const PosePair& pair : evaluation.pairs) {
    if (pair.path >= evaluation.options.min_path - kRounding && pair.path > 0)
      translation.push_back(100.0 * pair.position_error / pair.path);
    if (pair.turned * kDegrees >= evaluation.options.min_turn - kRounding && pair.turned > 0)
      rotation.push_back(100.0 * euler_norm(pair.truth.rotation().inverse() * pair.estimate.rotation()) /
                         pair.turned);
  }
  // Distance and angle only grow, so that the last instant counts if any does.
  if (!translation.empty()) {
    evaluation.translation_error_percent_end = translation.back();
    evaluation.translation_error_percent_median = median_of(translation);
  }
  if (!rotation.empty()) {
    evaluation.rotation_error_percent_end = rotation.back();
    evaluation.rotation_error_percent_median = median_of(rotation);
  }
}

double coverage_of(const Trajectory& truth, const std::vector<PosePair>& pairs) {
  const double span = static_cast<double>(truth.back().t - truth.front().t);
  if (!(span > 0)) return 1.0;
  double covered = 0.0;
  for (std::size_t i = 1; i < pairs.size(); ++i) {
    const TimeNs gap = pairs[i].t - pairs[i - 1].t;
    if (gap <= kLongestGap) covered += static_cast<double>(gap);
  }
  return std::min(1.0, covered / span);
}

}  // namespace

ErrorStatistics error_statistics(std::vector<double> errors) {
  require(!errors.empty(), "error_statistics errors", "must not be empty", errors.size());
  ErrorStatistics statistics;
  double sum = 0.0, squares = 0.0;
  for (const double error : errors) {
    sum += error;
    squares += error * error;
    statistics.max = std::max(statistics.max, error);
  }
  const double count = static_cast<double>(errors.size());
  statistics.mean = sum / count;
  statistics.rmse = std::sqrt(squares / count);
  statistics.median = median_of(errors);
  return statistics;
}

Evaluation evaluate_trajectory(const Trajectory& truth, const Trajectory& estimate,
                               const EvaluationOptions& options) {
  check_options(options);
  Evaluation evaluation;
  evaluation.options = options;
  const TimeNs max_dt = from_seconds(options.max_dt);
  const bool estimate_is_longer = estimate.size() > truth.size();
  const IndexPairs indices =
      estimate_is_longer ? associate(truth, estimate, max_dt) : associate(estimate, truth, max_dt);
  if (indices.empty())
    throw Error(ErrorKind::data, "evaluate", "no pose of the estimate is within max_dt of a true one",
                number_text(options.max_dt) + " s");
  for (const auto& [few, many] : indices) {
    const StampedPose& true_pose = truth[estimate_is_longer ? few : many];
    const StampedPose& pose = estimate[estimate_is_longer ? many : few];
    PosePair pair{pose.t, true_pose.T_world_body, pose.T_world_body};
    if (!evaluation.pairs.empty()) {
      const PosePair& before = evaluation.pairs.back();
      const SE3d step = before.truth.inverse() * pair.truth;
      pair.path = before.path + step.translation().norm();
      pair.turned = before.turned + step.rotation().angle();
    }
    evaluation.pairs.push_back(pair);
  }

  align(evaluation);
  std::vector<double> metres, degrees;
  for (PosePair& pair : evaluation.pairs) {
    const SO3d& R = evaluation.T_truth_estimate.rotation();
    pair.estimate = SE3d(R * pair.estimate.rotation(), evaluation.scale * (R * pair.estimate.translation()) +
                                                           evaluation.T_truth_estimate.translation());
    pair.position_error = (pair.truth.translation() - pair.estimate.translation()).norm();
    pair.rotation_error = (pair.truth.rotation().inverse() * pair.estimate.rotation()).angle();
    metres.push_back(pair.position_error);
    degrees.push_back(pair.rotation_error * kDegrees);
  }
  evaluation.ape_m = error_statistics(std::move(metres));
  evaluation.rotation_deg = error_statistics(std::move(degrees));
  evaluation.rotation_fitted_deg = error_statistics(fitted_rotation_errors(evaluation.pairs));
  evaluation.path_m = evaluation.pairs.back().path;
  evaluation.turned_deg = evaluation.pairs.back().turned * kDegrees;
  evaluation.coverage = coverage_of(truth, evaluation.pairs);
  relative_errors(evaluation);
  percentages(evaluation);
  return evaluation;
}

std::string to_json(const Evaluation& e) {
  nlohmann::ordered_json json;
  const auto put = [&](const std::string& name, const std::optional<double>& value) {
    json[name] = value ? nlohmann::ordered_json(*value) : nlohmann::ordered_json();
  };
  const auto put_statistics = [&](const std::string& name, const std::string& unit,
                                  const std::optional<ErrorStatistics>& s) {
    put(name + "_rmse_" + unit, s ? std::optional(s->rmse) : std::nullopt);
    put(name + "_mean_" + unit, s ? std::optional(s->mean) : std::nullopt);
    put(name + "_median_" + unit, s ? std::optional(s->median) : std::nullopt);
    put(name + "_max_" + unit, s ? std::optional(s->max) : std::nullopt);
  };
  json["align"] = e.alignment;
  json["pairs"] = e.pairs.size();
  put("coverage", e.coverage);
  put("path_m", e.path_m);
  put("turned_deg", e.turned_deg);
  put_statistics("ape", "m", e.ape_m);
  put_statistics("rotation", "deg", e.rotation_deg);
  put_statistics("rotation_fitted", "deg", e.rotation_fitted_deg);
  put_statistics("rpe", "m", e.rpe_m);
  put_statistics("rpe", "deg", e.rpe_deg);
  json["rpe_pairs"] = e.rpe_pairs;
  put("translation_error_percent_median", e.translation_error_percent_median);
  put("translation_error_percent_end", e.translation_error_percent_end);
  put("rotation_error_percent_median", e.rotation_error_percent_median);
  put("rotation_error_percent_end", e.rotation_error_percent_end);
  put("scale", e.scale);
  for (const OptionRef& option : list_options(const_cast<EvaluationOptions&>(e.options)))
    std::visit([&](const auto& value) { json["options"][option.path] = value; }, option.value());
  return json.dump(2) + "\n";
}

std::string to_table(const Evaluation& e) {
  const auto percent = [](const std::optional<double>& value) {
    return value ? fmt::format("{:10.4f}", *value) : fmt::format("{:>10}", "-");
  };
  std::string text;
  text += fmt::format("alignment           {}\n", e.alignment);
  if (e.options.align == AlignMode::sim3) text += fmt::format("scale               {:.6f}\n", e.scale);
  text += fmt::format("pairs               {} (coverage {:.1f} %)\n", e.pairs.size(), 100.0 * e.coverage);
  text += fmt::format("path                {:.3f} m, turned {:.1f} deg\n\n", e.path_m, e.turned_deg);
  text += fmt::format("{:<20}{:>10}{:>10}{:>10}{:>10}\n", "", "rmse", "mean", "median", "max");
  const auto row = [&](const std::string& name, const std::optional<ErrorStatistics>& s) {
    text +=
        s ? fmt::format("{:<20}{:10.5f}{:10.5f}{:10.5f}{:10.5f}\n", name, s->rmse, s->mean, s->median, s->max)
          : fmt::format("{:<20}{:>10}{:>10}{:>10}{:>10}\n", name, "-", "-", "-", "-");
  };
  row("APE [m]", e.ape_m);
  row("rotation [deg]", e.rotation_deg);
  row("... fitted [deg]", e.rotation_fitted_deg);
  const char* unit = e.options.rpe_unit == RpeUnit::frames    ? "frames"
                     : e.options.rpe_unit == RpeUnit::seconds ? "s"
                                                              : "m";
  row(fmt::format("RPE [m / {:g} {}]", e.options.rpe_delta, unit), e.rpe_m);
  row(fmt::format("RPE [deg / {:g} {}]", e.options.rpe_delta, unit), e.rpe_deg);
  text += fmt::format("\n{:<20}{:>10}{:>10}\n", "", "median", "end");
  text += fmt::format("{:<20}{}{}\n", "translation [%]", percent(e.translation_error_percent_median),
                      percent(e.translation_error_percent_end));
  text += fmt::format("{:<20}{}{}\n", "rotation [%]", percent(e.rotation_error_percent_median),
                      percent(e.rotation_error_percent_end));
  return text;
}

void write_evaluation(const std::filesystem::path& folder, const Evaluation& evaluation) {
  std::error_code failure;
  std::filesystem::create_directories(folder, failure);
  if (failure) throw Error(ErrorKind::io, folder.string(), "cannot be made: " + failure.message());
  const auto write = [&](const char* name, const std::string& content) {
    std::ofstream file(folder / name, std::ios::binary);
    file << content;
    if (!file.flush()) throw Error(ErrorKind::io, (folder / name).string(), "cannot be written");
  };
  write("evaluation.json", to_json(evaluation));
  write("evaluation.svg", to_svg(evaluation));
}

}  // namespace sweepkit
