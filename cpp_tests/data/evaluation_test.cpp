// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/data/evaluation.hpp"

#include <Eigen/SVD>
#include <algorithm>
#include <catch2/catch.hpp>
#include <fstream>
#include <nlohmann/json.hpp>
#include <numbers>

#include "scratch_folder.hpp"
#include "sweepkit/core/random.hpp"

using namespace sweepkit;

namespace {

constexpr double kDegrees = 180.0 / std::numbers::pi;

SE3d pose(double x, double y, double z, double yaw_degrees = 0.0) {
  return SE3d(SO3d::exp({0, 0, yaw_degrees / kDegrees}), {x, y, z});
}

/// A pose every 0.1 s.
Trajectory at_10_hz(const std::vector<SE3d>& poses) {
  Trajectory trajectory;
  for (std::size_t i = 0; i < poses.size(); ++i)
    trajectory.push_back({1'700'000'000'000'000'000 + static_cast<TimeNs>(i) * 100'000'000, poses[i]});
  return trajectory;
}

EvaluationOptions with(AlignMode align, RpeUnit unit = RpeUnit::metres, double delta = 1.0, bool all = true) {
  EvaluationOptions options;
  options.align = align;
  options.rpe_unit = unit;
  options.rpe_delta = delta;
  options.rpe_all_pairs = all;
  return options;
}

/// A curved drive and a disturbed copy of it in another world frame.
std::pair<Trajectory, Trajectory> random_drive(std::uint64_t seed, int count, double noise) {
  Random random(seed);
  std::vector<SE3d> truth{pose(3, -2, 1, 40)}, estimate;
  for (int i = 1; i < count; ++i) {
    Vec6<double> twist;
    twist << 0.2, 0.02 * random.normal(), 0.05 * random.normal(), 0.02 * random.normal(),
        0.02 * random.normal(), 0.1 + 0.1 * random.normal();
    truth.push_back(truth.back() * SE3d::exp(twist));
  }
  Vec6<double> apart;
  apart << 5, -7, 2, 0.3, -0.9, 1.2;
  const SE3d T_other_world = SE3d::exp(apart);
  for (const SE3d& T : truth) {
    Vec6<double> error;
    for (int k = 0; k < 6; ++k) error[k] = noise * random.normal();
    estimate.push_back(T_other_world * T * SE3d::exp(error));
  }
  return {at_10_hz(truth), at_10_hz(estimate)};
}

/// Matrices and nothing else: the reference is to be slow and plain.
struct Reference {
  std::vector<Eigen::Matrix4d> truth, estimate;

  static double angle(const Eigen::Matrix3d& R) {
    const Eigen::Vector3d axis(R(2, 1) - R(1, 2), R(0, 2) - R(2, 0), R(1, 0) - R(0, 1));
    return std::atan2(axis.norm(), R.trace() - 1.0);
  }

  void align(AlignMode mode) {
    Eigen::Matrix4d T = Eigen::Matrix4d::Identity();
    if (mode == AlignMode::first) T = truth[0] * estimate[0].inverse();
    if (mode == AlignMode::se3 || mode == AlignMode::sim3) {
      Eigen::Matrix3Xd from(3, truth.size()), to(3, truth.size());
      for (std::size_t i = 0; i < truth.size(); ++i) {
        from.col(i) = estimate[i].topRightCorner<3, 1>();
        to.col(i) = truth[i].topRightCorner<3, 1>();
      }
      T = Eigen::umeyama(from, to, mode == AlignMode::sim3);
    }
    const double scale = std::cbrt(T.topLeftCorner<3, 3>().determinant());
    for (auto& E : estimate) {
      E = T * E;
      E.topLeftCorner<3, 3>() /= scale;
    }
  }

  std::vector<double> ape() const {
    std::vector<double> errors;
    for (std::size_t i = 0; i < truth.size(); ++i)
      errors.push_back((truth[i].topRightCorner<3, 1>() - estimate[i].topRightCorner<3, 1>()).norm());
    return errors;
  }

  std::vector<double> rotation() const {
    std::vector<double> errors;
    for (std::size_t i = 0; i < truth.size(); ++i)
      errors.push_back(kDegrees *
                       angle(truth[i].topLeftCorner<3, 3>().transpose() * estimate[i].topLeftCorner<3, 3>()));
    return errors;
  }

  double path(std::size_t i, std::size_t j) const {
    double length = 0;
    for (std::size_t k = i + 1; k <= j; ++k)
      length += (truth[k].topRightCorner<3, 1>() - truth[k - 1].topRightCorner<3, 1>()).norm();
    return length;
  }

  double turned(std::size_t i, std::size_t j) const {
    double sum = 0;
    for (std::size_t k = i + 1; k <= j; ++k)
      sum += angle(truth[k - 1].topLeftCorner<3, 3>().transpose() * truth[k].topLeftCorner<3, 3>());
    return sum;
  }

  /// Translation [m] and rotation [deg] over at least one metre, from every pose.
  std::pair<std::vector<double>, std::vector<double>> rpe_per_metre() const {
    std::pair<std::vector<double>, std::vector<double>> errors;
    for (std::size_t i = 0; i < truth.size(); ++i)
      for (std::size_t j = i; j < truth.size(); ++j)
        if (path(i, j) >= 1.0) {
          const Eigen::Matrix4d E =
              (truth[i].inverse() * truth[j]).inverse() * (estimate[i].inverse() * estimate[j]);
          errors.first.push_back(E.topRightCorner<3, 1>().norm());
          errors.second.push_back(kDegrees * angle(E.topLeftCorner<3, 3>()));
          break;
        }
    return errors;
  }
};

void check_statistics(const ErrorStatistics& statistics, std::vector<double> errors) {
  double sum = 0, squares = 0;
  for (const double error : errors) sum += error, squares += error * error;
  std::sort(errors.begin(), errors.end());
  const std::size_t n = errors.size();
  CHECK(std::abs(statistics.rmse - std::sqrt(squares / n)) < 1e-9);
  CHECK(std::abs(statistics.mean - sum / n) < 1e-9);
  CHECK(std::abs(statistics.median - (errors[(n - 1) / 2] + errors[n / 2]) / 2) < 1e-9);
  CHECK(std::abs(statistics.max - errors.back()) < 1e-9);
}

double median(std::vector<double> values) {
  std::sort(values.begin(), values.end());
  return (values[(values.size() - 1) / 2] + values[values.size() / 2]) / 2;
}

}  // namespace

TEST_CASE("a drive along a line with known errors has known figures") {
  // 3 m along x in steps of 1 m; the estimate is 0, 3, 4 and 12 cm to the left and turned by 0, 1, 0 and 2
  // degrees.
  const Trajectory truth = at_10_hz({pose(0, 0, 0), pose(1, 0, 0), pose(2, 0, 0), pose(3, 0, 0)});
  const Trajectory estimate =
      at_10_hz({pose(0, 0, 0), pose(1, 0.03, 0, 1), pose(2, 0.04, 0), pose(3, 0.12, 0, 2)});
  const Evaluation e = evaluate_trajectory(truth, estimate, with(AlignMode::none));
  CHECK(e.pairs.size() == 4);
  CHECK(e.coverage == 1.0);
  CHECK(e.path_m == Approx(3.0).margin(1e-12));
  CHECK(e.turned_deg == Approx(0.0).margin(1e-12));
  CHECK(std::abs(e.ape_m.rmse - 0.065) < 1e-9);  // 9 + 16 + 144 = 169; 13 cm / sqrt(4)
  CHECK(std::abs(e.ape_m.mean - 0.0475) < 1e-9);
  CHECK(std::abs(e.ape_m.median - 0.035) < 1e-9);
  CHECK(std::abs(e.ape_m.max - 0.12) < 1e-9);
  CHECK(std::abs(e.rotation_deg.rmse - std::sqrt(1.25)) < 1e-9);
  CHECK(std::abs(e.rotation_deg.median - 0.5) < 1e-9);
  CHECK(std::abs(e.rotation_deg.max - 2.0) < 1e-9);
  // Per cent after 1 m: 3 / 100, 4 / 200, 12 / 300.
  CHECK(std::abs(*e.translation_error_percent_median - 3.0) < 1e-9);
  CHECK(std::abs(*e.translation_error_percent_end - 4.0) < 1e-9);
  CHECK_FALSE(e.rotation_error_percent_median);
  CHECK_FALSE(e.rotation_error_percent_end);
  // Relative errors of a metre each; in the estimate's own frame the step of the first pair is (1, 0.03).
  CHECK(e.rpe_pairs == 3);
  const auto step = [](double x, double y, double yaw) {
    const double c = std::cos(yaw / kDegrees), s = std::sin(yaw / kDegrees);
    return std::hypot(c * x + s * y - 1.0, -s * x + c * y);
  };
  check_statistics(*e.rpe_m, {step(1, 0.03, 0), step(1, 0.01, 1), step(1, 0.08, 0)});
  check_statistics(*e.rpe_deg, {1, 1, 2});
}

TEST_CASE("the percentages of rotation count from 30 degrees on and take the norm of the Euler angles") {
  std::vector<SE3d> truth, estimate;
  for (int i = 0; i <= 4; ++i) {
    truth.push_back(pose(0, 0, 0, 15.0 * i));
    // Off by 0.3 degrees about z and 0.4 about x: Euler angles 0.3, 0, 0.4, norm 0.5.
    const double off = i == 0 ? 0.0 : 1.0 / kDegrees;
    estimate.push_back(truth.back() * SE3d(SO3d::exp({0, 0, 0.3 * off}) * SO3d::exp({0.4 * off, 0, 0}),
                                           Vec3<double>::Zero()));
  }
  const Evaluation e = evaluate_trajectory(at_10_hz(truth), at_10_hz(estimate), with(AlignMode::first));
  CHECK(std::abs(e.turned_deg - 60.0) < 1e-9);
  CHECK(std::abs(*e.rotation_error_percent_median - 100.0 * 0.5 / 45.0) < 1e-9);
  CHECK(std::abs(*e.rotation_error_percent_end - 100.0 * 0.5 / 60.0) < 1e-9);
  CHECK_FALSE(e.translation_error_percent_end);
  CHECK_FALSE(e.rpe_m);
}

TEST_CASE("all figures are those of a slow reference to 1e-9, for each alignment") {
  for (const AlignMode mode : {AlignMode::none, AlignMode::first, AlignMode::se3, AlignMode::sim3})
    for (const std::uint64_t seed : {1, 2, 3}) {
      const auto [truth, estimate] = random_drive(seed, 60 + static_cast<int>(seed), 0.03);
      const Evaluation e = evaluate_trajectory(truth, estimate, with(mode));
      Reference reference;
      for (const auto& p : truth) reference.truth.push_back(p.T_world_body.matrix());
      for (const auto& p : estimate) reference.estimate.push_back(p.T_world_body.matrix());
      reference.align(mode);
      check_statistics(e.ape_m, reference.ape());
      check_statistics(e.rotation_deg, reference.rotation());
      const auto [metres, degrees] = reference.rpe_per_metre();
      CHECK(e.rpe_pairs == metres.size());
      check_statistics(*e.rpe_m, metres);
      check_statistics(*e.rpe_deg, degrees);

      const auto ape = reference.ape();
      std::vector<double> translation, rotation;
      for (std::size_t i = 0; i < truth.size(); ++i) {
        if (reference.path(0, i) >= 1.0) translation.push_back(100 * ape[i] / reference.path(0, i));
        if (kDegrees * reference.turned(0, i) < 30.0) continue;
        const Eigen::Matrix3d R = reference.truth[i].topLeftCorner<3, 3>().transpose() *
                                  reference.estimate[i].topLeftCorner<3, 3>();
        // Eigen's angles for Rz Ry Rx; of the two solutions the one with the smaller norm.
        const Eigen::Vector3d zyx = R.eulerAngles(2, 1, 0);
        Eigen::Vector3d other(zyx[0] - std::numbers::pi, std::numbers::pi - zyx[1],
                              zyx[2] + std::numbers::pi);
        for (double& a : other) a = std::remainder(a, 2 * std::numbers::pi);
        rotation.push_back(100 * std::min(zyx.norm(), other.norm()) / reference.turned(0, i));
      }
      CHECK(std::abs(*e.translation_error_percent_median - median(translation)) < 1e-9);
      CHECK(std::abs(*e.translation_error_percent_end - translation.back()) < 1e-9);
      if (mode != AlignMode::none) {
        CHECK(std::abs(*e.rotation_error_percent_median - median(rotation)) < 1e-9);
        CHECK(std::abs(*e.rotation_error_percent_end - rotation.back()) < 1e-9);
      }
      CHECK(std::abs(e.path_m - reference.path(0, truth.size() - 1)) < 1e-9);
      CHECK(std::abs(e.turned_deg - kDegrees * reference.turned(0, truth.size() - 1)) < 1e-9);
    }
}

TEST_CASE("alignments undo what they may and nothing else") {
  auto [truth, estimate] = random_drive(5, 80, 0.0);
  for (const AlignMode mode : {AlignMode::first, AlignMode::se3, AlignMode::sim3}) {
    const Evaluation e = evaluate_trajectory(truth, estimate, with(mode));
    CHECK(e.ape_m.max < 1e-9);
    CHECK(e.rotation_deg.max < 1e-9);
  }
  CHECK(evaluate_trajectory(truth, estimate, with(AlignMode::none)).ape_m.rmse > 1.0);
  for (auto& p : estimate)
    p.T_world_body = SE3d(p.T_world_body.rotation(), 1.25 * p.T_world_body.translation());
  const Evaluation scaled = evaluate_trajectory(truth, estimate, with(AlignMode::sim3));
  CHECK(scaled.scale == Approx(0.8).epsilon(1e-12));
  CHECK(scaled.ape_m.max < 1e-9);
  CHECK(scaled.rpe_m->max < 1e-9);
  CHECK(evaluate_trajectory(truth, estimate, with(AlignMode::se3)).ape_m.rmse > 0.1);
}

TEST_CASE("a path that does not determine the rotation is laid over by the first pose's") {
  std::vector<SE3d> still(5, pose(0, 0, 0)), jitter;
  for (int i = 0; i < 5; ++i) jitter.push_back(pose(1 + (i % 2 ? 0.01 : -0.01), 0, 0, 30));
  const Evaluation e = evaluate_trajectory(at_10_hz(jitter), at_10_hz(still));
  CHECK(e.alignment == "se3, rotation of the first pose");
  CHECK(e.rotation_deg.max < 1e-9);
  CHECK(std::abs(e.ape_m.max - 0.012) < 1e-9);  // mean of x is 0.998
}

TEST_CASE("fitted rotation errors are the least that any rotation of the world leaves") {
  const auto [truth, estimate] = random_drive(5, 40, 0.02);
  const Evaluation e = evaluate_trajectory(truth, estimate, with(AlignMode::none));
  const auto sum_of_squares = [&](const SO3d& R) {
    double sum = 0;
    for (std::size_t i = 0; i < truth.size(); ++i)
      sum += (truth[i].T_world_body.rotation().matrix() - (R * estimate[i].T_world_body.rotation()).matrix())
                 .squaredNorm();
    return sum;
  };
  // Chordal: |A - B|^2 = 8 sin^2(angle / 2).
  double fitted = 0;
  Evaluation first = evaluate_trajectory(truth, estimate, with(AlignMode::first));
  CHECK(e.rotation_fitted_deg.rmse < first.rotation_deg.rmse);
  CHECK(e.rotation_fitted_deg.rmse == Approx(first.rotation_fitted_deg.rmse).margin(1e-9));
  // The minimum, found by descent from the first pose's rotation.
  SO3d R = first.T_truth_estimate.rotation();
  for (double step = 0.1; step > 1e-9; step *= 0.5)
    for (bool better = true; better;) {
      better = false;
      for (int k = 0; k < 6; ++k) {
        Vec3<double> turn = Vec3<double>::Zero();
        turn[k / 2] = k % 2 ? step : -step;
        if (sum_of_squares(SO3d::exp(turn) * R) < sum_of_squares(R)) {
          R = SO3d::exp(turn) * R;
          better = true;
        }
      }
    }
  for (std::size_t i = 0; i < truth.size(); ++i)
    fitted += std::pow(
        (truth[i].T_world_body.rotation().inverse() * R * estimate[i].T_world_body.rotation()).angle(), 2);
  CHECK(e.rotation_fitted_deg.rmse ==
        Approx(kDegrees * std::sqrt(fitted / static_cast<double>(truth.size()))).epsilon(1e-4));
}

TEST_CASE("relative errors by frames, by seconds and without overlap") {
  const auto [truth, estimate] = random_drive(8, 41, 0.02);
  CHECK(evaluate_trajectory(truth, estimate, with(AlignMode::se3, RpeUnit::frames, 1)).rpe_pairs == 40);
  CHECK(evaluate_trajectory(truth, estimate, with(AlignMode::se3, RpeUnit::seconds, 1)).rpe_pairs == 31);
  CHECK(evaluate_trajectory(truth, estimate, with(AlignMode::se3, RpeUnit::seconds, 1, false)).rpe_pairs ==
        4);
  CHECK(evaluate_trajectory(truth, estimate, with(AlignMode::se3, RpeUnit::frames, 7, false)).rpe_pairs == 5);
  // A rigid alignment does not change them.
  const auto a = evaluate_trajectory(truth, estimate, with(AlignMode::none, RpeUnit::frames, 3));
  const auto b = evaluate_trajectory(truth, estimate, with(AlignMode::se3, RpeUnit::frames, 3));
  CHECK(std::abs(a.rpe_m->rmse - b.rpe_m->rmse) < 1e-9);
  CHECK(std::abs(a.rpe_deg->max - b.rpe_deg->max) < 1e-9);
}

TEST_CASE("poses are paired with the nearest in time, each once, and gaps are not covered") {
  // Truth at 200 Hz for 10 s, estimate at 10 Hz, 2 ms late, with a hole of 3 s.
  Trajectory truth, estimate;
  for (int i = 0; i <= 2000; ++i) truth.push_back({i * 5'000'000LL, pose(0.001 * i, 0, 0)});
  for (int i = 0; i <= 100; ++i)
    if (i <= 40 || i >= 70)
      estimate.push_back({i * 100'000'000LL + (i < 100 ? 2'000'000 : 0), pose(0.02 * i, 0, 0)});
  const Evaluation e = evaluate_trajectory(truth, estimate, with(AlignMode::none));
  CHECK(e.pairs.size() == 72);
  CHECK(e.ape_m.max < 1e-9);
  CHECK(e.coverage == Approx(0.7).margin(0.002));
  // The other way round the same pairs are found.
  CHECK(evaluate_trajectory(estimate, truth, with(AlignMode::none)).pairs.size() == 72);

  Trajectory late = estimate;
  for (auto& p : late) p.t += 1'000'000'000'000;
  CHECK_THROWS_AS(evaluate_trajectory(truth, late), Error);
  EvaluationOptions wrong;
  wrong.max_dt = std::nan("");
  CHECK_THROWS_AS(evaluate_trajectory(truth, estimate, wrong), Error);
}

TEST_CASE("results are written as JSON with the names that hold, and as a drawing") {
  const auto [truth, estimate] = random_drive(6, 50, 0.02);
  const Evaluation e = evaluate_trajectory(truth, estimate);
  const ScratchFolder folder;
  write_evaluation(folder / "a/b", e);
  const auto json = nlohmann::json::parse(std::ifstream(folder / "a/b/evaluation.json"));
  for (const char* name : {"ape_rmse_m", "ape_median_m", "ape_max_m", "rpe_rmse_m", "rpe_rmse_deg",
                           "translation_error_percent_median", "translation_error_percent_end",
                           "rotation_error_percent_median", "rotation_error_percent_end", "path_m",
                           "turned_deg", "pairs", "coverage", "rotation_rmse_deg", "rotation_max_deg"})
    CHECK(json.at(name).is_number());
  CHECK(json["ape_rmse_m"] == e.ape_m.rmse);
  CHECK(json["align"] == "se3");
  CHECK(json["options"]["rpe_unit"] == "metres");
  CHECK(to_svg(e).find("<polyline") != std::string::npos);
  CHECK(to_svg(e).find("nan") == std::string::npos);
  CHECK(to_table(e).find("APE [m]") != std::string::npos);
  CHECK_THROWS_AS(write_evaluation("/proc/nowhere", e), Error);
}
