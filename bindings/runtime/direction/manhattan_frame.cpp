// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/direction/manhattan_frame.hpp"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <numbers>

namespace sweepkit {

namespace {

constexpr double kDegree = std::numbers::pi / 180;
constexpr int kBins = 90;           // of the vote, one a degree
constexpr double kWidestVote = 20;  // [deg] segments that tell less of the angle have no vote
constexpr std::size_t kPeaks = 3;   // of a vote that are tried
constexpr std::size_t kPeaksWithUp = 8;
constexpr int kClimbRounds = 6, kMixtureRounds = 12;
constexpr double kOutlierShare = 0.2;    // prior of the mixture
constexpr double kDegreesOfFreedom = 4;  // of Student's distribution: edges have heavier tails than noise
// Log odds of a right frame: slope * (margin over the runner-up / sqrt(score + 1) - offset), fitted by
// logistic regression on simulated segments with 0 to 100 % outliers; the offset with a known up direction
// lies halfway to what rendered recordings give.
struct Odds {
  double slope, offset;
};
constexpr Odds kOdds{7.0, 0.36}, kOddsWithUp{3.5, 0.55};

/// A frame whose second column is the axis, turned about it.
SO3d frame_about(const Vec3<double>& axis, double angle) {
  const Vec3<double> seed = std::abs(axis.x()) < 0.7 ? Vec3<double>::UnitX() : Vec3<double>::UnitY();
  const Vec3<double> a = axis.cross(seed).normalized(), b = axis.cross(a);
  Mat3<double> R;
  R.col(0) = std::cos(angle) * a + std::sin(angle) * b;
  R.col(1) = axis;
  R.col(2) = R.col(0).cross(R.col(1));
  return SO3d(R);
}

/// The one of 24 that is meant by ManhattanFrame::R_camera_manhattan.
SO3d canonical(const SO3d& R, const Vec3<double>& down) {
  const Mat3<double> D = R.matrix();
  int y = 0;
  for (int k = 1; k < 3; ++k)
    if (std::abs(down.dot(D.col(k))) > std::abs(down.dot(D.col(y)))) y = k;
  int z = (y + 1) % 3;
  if (std::abs(D(2, (y + 2) % 3)) > std::abs(D(2, z))) z = (y + 2) % 3;
  Mat3<double> C;
  C.col(1) = down.dot(D.col(y)) < 0 ? Vec3<double>(-D.col(y)) : Vec3<double>(D.col(y));
  C.col(2) = D(2, z) < 0 ? Vec3<double>(-D.col(z)) : Vec3<double>(D.col(z));
  C.col(0) = C.col(1).cross(C.col(2));
  return SO3d(C);
}

VanishingPointOptions hypotheses_of(const ManhattanOptions& options) {
  VanishingPointOptions result;
  result.hypotheses = options.hypotheses;
  result.inlier_sigmas = options.inlier_sigmas;
  result.seed = options.seed;
  result.segments = options.segments;
  return result;
}

}  // namespace

double manhattan_distance(const SO3d& a, const SO3d& b) {
  const Mat3<double> M = (a.inverse() * b).matrix();
  int order[3] = {0, 1, 2};
  double best = -1;
  do {
    // Signs of a permutation's matrix: all as in M, or, where that is a reflection, but for the smallest.
    double trace = 0, least = 2,
           sign = (order[1] - order[0]) * (order[2] - order[0]) * (order[2] - order[1]) > 0 ? 1 : -1;
    for (int k = 0; k < 3; ++k) {
      const double m = M(order[k], k);
      trace += std::abs(m);
      least = std::min(least, std::abs(m));
      if (m < 0) sign = -sign;
    }
    best = std::max(best, sign > 0 ? trace : trace - 2 * least);
  } while (std::next_permutation(order, order + 3));
  return std::acos(std::clamp(0.5 * (best - 1), -1.0, 1.0));
}

ManhattanEstimator::ManhattanEstimator(const ManhattanOptions& options)
    : options_(options), finder_(hypotheses_of(options)) {
  check_options(options_);
}

double ManhattanEstimator::score(const SO3d& R) const {
  return planes_.consensus(Mat3<float>(R.matrix().cast<float>()), static_cast<float>(options_.inlier_sigmas));
}

void ManhattanEstimator::vote(const Vec3<double>& axis, std::vector<double>& peaks) const {
  const Mat3<double> R = frame_about(axis, 0).matrix();
  const Vec3<float> v = axis.cast<float>(), a = R.col(0).cast<float>(),
                    b = axis.cross(R.col(0)).cast<float>();
  const auto reach = static_cast<float>(options_.inlier_sigmas);
  constexpr auto kToDegrees = static_cast<float>(1 / kDegree);
  std::array<float, kBins> votes{};
  for (std::size_t i = 0; i < planes_.size(); ++i) {
    if (planes_.squared_sigmas(i, v) < reach * reach) continue;
    // The one direction square to the axis that the segment can have.
    const Vec3<float> h = planes_.normal(i).cross(v);
    const float sine = h.norm();
    if (!(sine > 1e-3f)) continue;
    const float half = reach * std::sqrt(planes_.variance(i, h / sine)) / sine * kToDegrees;
    if (!(half < kWidestVote)) continue;
    const float angle = std::atan2(h.dot(b), h.dot(a)) * kToDegrees;
    const float center = angle - kBins * std::floor(angle / kBins);
    const int low = static_cast<int>(std::ceil(center - half - 0.5f));
    const int high = static_cast<int>(std::floor(center + half - 0.5f));
    const float scale = 1 / (half * half);
    for (int k = low; k <= high; ++k) {
      const float off = static_cast<float>(k) + 0.5f - center;
      votes[(k + kBins) % kBins] += planes_.weight(i) * (1 - off * off * scale);
    }
  }
  peaks.clear();
  const auto at = [&](int k) { return votes[(k + kBins) % kBins]; };
  for (int k = 0; k < kBins; ++k)
    if (at(k) > 0 && at(k) >= at(k + 1) && at(k) > at(k - 1)) peaks.push_back(k);
  std::stable_sort(peaks.begin(), peaks.end(), [&](double p, double q) {
    return votes[static_cast<int>(p)] > votes[static_cast<int>(q)];
  });
  peaks.resize(std::min(peaks.size(), up_ ? kPeaksWithUp : kPeaks));
  for (double& p : peaks) p = (p + 0.5) * kDegree;
}

void ManhattanEstimator::add_frame(const SO3d& R) { frames_.push_back({R, score(R)}); }

ManhattanEstimator::Equations ManhattanEstimator::nearest_direction(const SO3d& R, double reach) const {
  const Mat3<double> D = R.matrix();
  const Mat3<float> d = D.cast<float>();
  Equations e;
  for (std::size_t i = 0; i < planes_.size(); ++i) {
    int best = 0;
    float least = std::numeric_limits<float>::max(), variance = 1;
    for (int k = 0; k < 3; ++k) {
      const Vec3<float> dk = d.col(k);
      const float r = planes_.residual(i, dk), v = planes_.variance(i, dk);
      if (r * r < least * v) {
        least = r * r / v;
        variance = v;
        best = k;
      }
    }
    const double part = 1 - least / (reach * reach);
    if (part <= 0) continue;
    const double w = planes_.weight(i) * part * part / variance;
    const Vec3<double> dk = D.col(best), n = planes_.normal(i).cast<double>(), J = dk.cross(n);
    e.H += w * J * J.transpose();
    e.g += w * n.dot(dk) * J;
  }
  return e;
}

ManhattanEstimator::Equations ManhattanEstimator::mixture(const SO3d& R) const {
  // Gamma(5/2) / (Gamma(2) sqrt(4 pi)): the top of Student's density with four degrees of freedom.
  constexpr double kTop = 0.375;
  constexpr double nu = kDegreesOfFreedom;
  const Mat3<double> D = R.matrix();
  const Mat3<float> d = D.cast<float>();
  Equations e;
  for (std::size_t i = 0; i < planes_.size(); ++i) {
    double r[3], v[3], fall[3], p[3], sum = kOutlierShare / std::numbers::pi;
    for (int k = 0; k < 3; ++k) {
      const Vec3<float> dk = d.col(k);
      r[k] = planes_.residual(i, dk);
      v[k] = planes_.variance(i, dk);
      fall[k] = 1 / (1 + r[k] * r[k] / (nu * v[k]));
      p[k] = (1 - kOutlierShare) / 3 * kTop * fall[k] * fall[k] * std::sqrt(fall[k] / v[k]);
      sum += p[k];
    }
    const Vec3<double> n = planes_.normal(i).cast<double>();
    for (int k = 0; k < 3; ++k) {
      const double w = planes_.weight(i) * p[k] / sum * (nu + 1) / nu * fall[k] / v[k];
      const Vec3<double> J = D.col(k).cross(n);
      e.H += w * J * J.transpose();
      e.g += w * r[k] * J;
    }
  }
  return e;
}

void ManhattanEstimator::turn(SO3d& R, const Equations& e) const {
  const Vec3<double> step =
      up_ ? Vec3<double>(*up_ * (up_->dot(e.g) / up_->dot(e.H * *up_))) : Vec3<double>(e.H.ldlt().solve(e.g));
  R = SO3d::exp(-step) * R;
}

std::optional<ManhattanFrame> ManhattanEstimator::best_frame() {
  std::stable_sort(frames_.begin(), frames_.end(),
                   [](const Candidate& a, const Candidate& b) { return a.score > b.score; });
  // The best few that differ, each climbed with a falling reach.
  const double apart = options_.tolerance * kDegree;
  std::vector<Candidate> modes;
  for (const Candidate& start : frames_) {
    if (modes.size() >= static_cast<std::size_t>(options_.refined)) break;
    const auto near = [&](const Candidate& m) { return manhattan_distance(m.R, start.R) < apart; };
    if (std::any_of(modes.begin(), modes.end(), near)) continue;
    modes.push_back(start);
  }
  for (Candidate& mode : modes) {
    for (int round = 0; round < kClimbRounds; ++round)
      turn(mode.R, nearest_direction(mode.R, options_.inlier_sigmas * (round == 0 ? 1.5 : 1.0)));
    mode.score = score(mode.R);
  }
  std::stable_sort(modes.begin(), modes.end(),
                   [](const Candidate& a, const Candidate& b) { return a.score > b.score; });
  if (modes.empty() || !(modes[0].score > 0)) return std::nullopt;
  // The best that is another frame; and the same turned about an axis of its own, which scores as well where
  // no segment tells of that turn.
  double runner_up = 0;
  for (const Candidate& m : modes)
    if (manhattan_distance(m.R, modes[0].R) > apart) {
      runner_up = m.score;
      break;
    }
  for (int k = 0; k < 3; ++k) {
    const Vec3<double> axis = modes[0].R.matrix().col(k);
    if (up_ && std::abs(axis.dot(*up_)) < 0.5) continue;
    for (const double angle : {-30.0, -15.0, 15.0, 30.0, 45.0})
      runner_up = std::max(runner_up, score(SO3d::exp(angle * kDegree * axis) * modes[0].R));
  }
  ManhattanFrame frame;
  describe(frame, modes[0], runner_up);
  return frame;
}

void ManhattanEstimator::describe(ManhattanFrame& frame, const Candidate& best, double runner_up) {
  SO3d R = best.R;
  for (int round = 0; round < kMixtureRounds; ++round) turn(R, mixture(R));
  const Equations last = mixture(R);
  double worst;
  if (up_) {
    const double variance = 1 / up_->dot(last.H * *up_);
    frame.covariance = variance * *up_ * up_->transpose();
    worst = variance;
  } else {
    frame.covariance = last.H.inverse();
    Eigen::SelfAdjointEigenSolver<Mat3<double>> eigen;
    worst = eigen.computeDirect(frame.covariance, Eigen::EigenvaluesOnly).eigenvalues()(2);
  }
  frame.R_camera_manhattan = canonical(R, up_ ? Vec3<double>(-*up_) : Vec3<double>::UnitY());
  const Odds& odds = up_ ? kOddsWithUp : kOdds;
  const double margin = (best.score - runner_up) / std::sqrt(best.score + 1);
  const double mode = 1 / (1 + std::exp(-odds.slope * (margin - odds.offset)));
  frame.confidence = mode * std::erf(options_.tolerance * kDegree / std::sqrt(2 * worst));

  const Mat3<float> d = frame.R_camera_manhattan.matrix().cast<float>();
  const auto limit = static_cast<float>(options_.inlier_sigmas * options_.inlier_sigmas);
  double inside = 0;
  for (std::size_t i = 0; i < planes_.size(); ++i) {
    int label = 0;
    float least = std::numeric_limits<float>::max();
    for (int k = 0; k < 3; ++k)
      if (const float z2 = planes_.squared_sigmas(i, d.col(k)); z2 < least) {
        least = z2;
        label = k;
      }
    if (least >= limit) continue;
    labels_[index_[i]] = static_cast<std::int8_t>(label);
    frame.support[label] += planes_.weight(i);
    inside += planes_.weight(i);
  }
  frame.share = planes_.total_weight() > 0 ? inside / planes_.total_weight() : 0;
  frame.segments = static_cast<int>(planes_.size());
}

std::optional<ManhattanFrame> ManhattanEstimator::estimate(std::span<const InterpretationPlane> planes) {
  up_.reset();
  labels_.assign(planes.size(), -1);
  if (planes.size() < 3) return std::nullopt;
  index_.resize(planes.size());
  for (std::size_t i = 0; i < planes.size(); ++i) index_[i] = static_cast<std::int32_t>(i);
  planes_.assign(planes, options_.segments.model_sigma * kDegree, options_.segments.full_length);
  finder_.candidates(planes_, options_.candidates, points_);
  frames_.clear();
  for (const VanishingPoint& point : points_) {
    vote(point.direction, peaks_);
    for (const double angle : peaks_) add_frame(frame_about(point.direction, angle));
  }
  return best_frame();
}

std::optional<ManhattanFrame> ManhattanEstimator::estimate(std::span<const InterpretationPlane> planes,
                                                           const Vec3<double>& up) {
  const double norm = up.norm();
  require(std::isfinite(norm) && norm > 0, "ManhattanEstimator::estimate up", "must be finite and not zero",
          norm);
  up_ = up / norm;
  labels_.assign(planes.size(), -1);
  // Segments that may be vertical tell nothing of the angle; an error of the up direction shifts the others
  // by the part of it that lies in their plane's normal.
  const double model = options_.segments.model_sigma * kDegree, up_sigma = options_.up_sigma * kDegree;
  const double reach2 = options_.inlier_sigmas * options_.inlier_sigmas;
  used_.clear();
  index_.clear();
  for (std::size_t i = 0; i < planes.size(); ++i) {
    const InterpretationPlane& p = planes[i];
    const double r = p.normal.dot(*up_);
    if (r * r < reach2 * (p.variance(*up_) + model * model + up_sigma * up_sigma)) {
      labels_[i] = 1;
      continue;
    }
    used_.push_back(p);
    used_.back().turn_sigma = std::hypot(p.turn_sigma, up_sigma * r);
    used_.back().shift_sigma = std::hypot(p.shift_sigma, up_sigma * r);
    index_.push_back(static_cast<std::int32_t>(i));
  }
  planes_.assign(used_, model, options_.segments.full_length);
  frames_.clear();
  vote(-*up_, peaks_);
  for (const double angle : peaks_) add_frame(frame_about(-*up_, angle));
  return best_frame();
}

}  // namespace sweepkit
