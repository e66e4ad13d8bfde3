// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/floor/ground_plane_estimator.hpp"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <cmath>
#include <numbers>
#include <optional>
#include <vector>

#include "ground_plane_fit.hpp"

namespace sweepkit {

namespace {

constexpr int kMounting = 0, kTilt = 3, kView = 6, kBias = 9, kStates = 10;
using StateVector = Eigen::Matrix<double, kStates, 1>;
using StateMatrix = Eigen::Matrix<double, kStates, kStates>;

constexpr double kDegree = std::numbers::pi / 180.0;
constexpr double kGate = 4.0;         // standard deviations within which a pixel may be floor
constexpr double kSurface = 0.012;    // other surfaces are looked for so far above and below the floor [m]
constexpr double kMaxSupport = 60.0;  // of which a floor that was learned can boast [s]
constexpr double kMountingDrift = 0.002 * kDegree;  // of pitch and roll [rad / sqrt(s)]
constexpr double kDriftTime = 10.0;                 // in which a tilt told by motion is forgotten [s]
constexpr double kWheelbase = 0.1;                  // from the drive wheels to the castor, about [m]
constexpr double kHeightDrift = 1e-5;               // [m / sqrt(s)]

double square(double x) { return x * x; }

// What an image shows of the state.
Eigen::Matrix<double, 3, kStates> seen_by_image() {
  Eigen::Matrix<double, 3, kStates> H;
  H << Mat3<double>::Identity(), Mat3<double>::Identity(), Mat3<double>::Identity(), Vec3<double>::UnitZ();
  return H;
}

// d slope / d (pitch, roll, height), with slope = scale * down / height.
Mat3<double> slope_by_angles(const Vec3<double>& slope, double scale) {
  const double norm = slope.norm();
  const Vec3<double> n = slope / norm;
  const double sp = n.z(), cp = std::hypot(n.x(), n.y());
  const double sr = n.x() / cp, cr = n.y() / cp;
  Mat3<double> J;
  J.col(0) = norm * Vec3<double>(-sp * sr, -sp * cr, cp);
  J.col(1) = norm * Vec3<double>(cp * cr, -cp * sr, 0.0);
  J.col(2) = -slope * (norm / scale);
  return J;
}

Mat3<double> from_angles(const Vec3<double>& slope, double scale, double angle, double height) {
  const Mat3<double> J = slope_by_angles(slope, scale);
  const Vec3<double> variance(square(angle), square(angle), square(height));
  return J * variance.asDiagonal() * J.transpose();
}

// One pixel of either kind of image, in px; not positive if it is invalid.
inline float disparity_of(std::int16_t value) { return static_cast<float>(value) * (1.0f / 16.0f); }
inline float disparity_of(float value) { return value < 1e6f ? value : 0.0f; }

}  // namespace

GroundPlaneSeed GroundPlaneSeed::from_base(const SE3d& T_base_camera) {
  GroundPlaneSeed seed;
  seed.plane.down_camera = T_base_camera.rotation().inverse() * Vec3<double>(0.0, 0.0, -1.0);
  seed.plane.height = T_base_camera.translation().z();
  seed.wheels_camera = T_base_camera.inverse().translation();
  require(seed.plane.height > 0, "GroundPlaneSeed::from_base T_base_camera", "must be above the floor",
          seed.plane.height);
  return seed;
}

GroundPlaneSeed GroundPlaneSeed::from_height(const Vec3<double>& down_camera, double height) {
  const double norm = down_camera.norm();
  require(std::isfinite(norm) && norm > 0, "GroundPlaneSeed::from_height down_camera", "must be a direction",
          norm);
  require(std::isfinite(height) && height > 0, "GroundPlaneSeed::from_height height", "must be positive",
          height);
  return {{down_camera / norm, height}, down_camera * (height / norm)};
}

struct GroundPlaneEstimator::State {
  RectifiedCamera camera;
  GroundPlaneSeed seed;
  GroundPlaneOptions options;
  double scale;  // focal * baseline

  // Mounting, tilt, difference of the floor in view from that under the wheels, and the common error of
  // disparities: the image shows mounting + tilt + view + (0, 0, bias).
  StateVector x;
  StateMatrix P;
  double climb = 0.0, climb_variance = 0.0;   // of the wheels since the floor was seen [m]
  double unseen = 0.0;                        // how long ago the floor was measured [s]
  double support = 0.0;                       // how long the floor was seen where it is believed to be [s]
  Vec3<double> rival = Vec3<double>::Zero();  // another floor that the seed permits
  double rival_support = 0.0;
  impl::FloorSamples samples;
  impl::SurfaceFinder finder;
  std::optional<impl::Surface> contradiction;  // that the image shows instead of the floor

  void reset();
  Vec3<double> slope() const { return x.head<3>() + x.segment<3>(kTilt); }
  Mat3<double> slope_covariance() const {
    return P.topLeftCorner<3, 3>() + P.block<3, 3>(0, kTilt) + P.block<3, 3>(kTilt, 0) +
           P.block<3, 3>(kTilt, kTilt);
  }
  GroundPlane plane(const Vec3<double>& s) const {
    const double norm = s.norm();
    return {s / norm, scale / norm};
  }
  Mat3<double> ride() const {
    return from_angles(x.head<3>(), scale, options.ride_angle * kDegree, options.ride_height);
  }
  Mat3<double> seed_covariance() const {
    return from_angles(scale / seed.plane.height * seed.plane.down_camera, scale,
                       options.mounting_angle * kDegree, options.mounting_height);
  }
  Mat3<double> view() const {
    return from_angles(x.head<3>(), scale, options.view_angle * kDegree, options.view_height);
  }
  // What the image shows besides the floor under the wheels.
  Mat3<double> view_covariance() const {
    Mat3<double> covariance = P.block<3, 3>(kView, kView);
    covariance(2, 2) += P(kBias, kBias);
    return covariance;
  }
  bool predict(const GroundPlaneStep& step);
  void forget_tilt();
  template <int N>
  void update(const Eigen::Matrix<double, N, kStates>& H, const Eigen::Matrix<double, N, 1>& innovation,
              const Eigen::Matrix<double, N, N>& R) {
    const Eigen::Matrix<double, N, N> S = H * P * H.transpose() + R;
    const Eigen::Matrix<double, kStates, N> K = S.ldlt().solve(H * P).transpose();
    x += K * innovation;
    const StateMatrix A = StateMatrix::Identity() - K * H;
    P = (A * P * A.transpose() + K * R * K.transpose()).eval();
  }
  void look_down(const GroundPlaneStep::Vertical& vertical);
  template <class T>
  int collect(View2d<const T> disparity);
  template <class T>
  GroundPlaneResult estimate(View2d<const T> disparity, const GroundPlaneStep& step);
  bool fixes(const impl::Surface& surface) const;
  Mat3<double> noise_of(const impl::Surface& surface) const;
  double distance(const impl::Surface& surface, const Vec3<double>& s, const Mat3<double>& covariance) const;
  template <class T>
  GroundPlaneResult look(View2d<const T> disparity, double seconds);
  void measure(GroundPlaneResult& result, double seconds);
  void learn_rival(const impl::Surface& surface, double seconds);
};

void GroundPlaneEstimator::State::reset() {
  const Vec3<double> s = scale / seed.plane.height * seed.plane.down_camera;
  x.setZero();
  x.head<3>() = s;
  P.setZero();
  P.topLeftCorner<3, 3>() = seed_covariance();
  P.block<3, 3>(kTilt, kTilt) = ride();
  P.block<3, 3>(kView, kView) = view();
  P(kBias, kBias) = square(options.disparity_bias);
  climb = climb_variance = unseen = support = rival_support = 0.0;
}

void GroundPlaneEstimator::State::forget_tilt() {
  x.segment<3>(kTilt).setZero();
  P.middleRows<3>(kTilt).setZero();
  P.middleCols<3>(kTilt).setZero();
  P.block<3, 3>(kTilt, kTilt) = ride();
}

// Returns whether the robot may stand on a floor.
bool GroundPlaneEstimator::State::predict(const GroundPlaneStep& step) {
  // Where motion tells the tilt, it fades only as far as motion drifts.
  const double fade = std::exp(-step.seconds / (step.motion ? kDriftTime : options.settle_time));
  const double view_fade = std::exp(-step.seconds / options.view_time);
  StateMatrix F = StateMatrix::Identity(), Q = StateMatrix::Zero();
  Q.topLeftCorner<3, 3>() = from_angles(x.head<3>(), scale, kMountingDrift * std::sqrt(step.seconds),
                                        kHeightDrift * std::sqrt(step.seconds));
  StateVector next = x;
  Mat3<double> turn = Mat3<double>::Identity();
  if (step.motion) {
    const SE3d& T = step.motion->T_now_before;
    const Vec3<double> s = slope();
    const GroundPlane before = plane(s);
    // The plane turns about the wheels: they stay as far from it as they were.
    const Vec3<double> down = T.rotation() * before.down_camera;
    const double sunk = (down - before.down_camera).dot(seed.wheels_camera);
    const double height = before.height + sunk;
    if (!(height > 0.1 * before.height)) {
      forget_tilt();
      return false;
    }
    turn = (before.height / height) * T.rotation().matrix();
    next.segment<3>(kTilt) = scale / height * down - x.head<3>();
    const Mat3<double> J = turn * SO3d::hat(s);  // slope by a rotation on the right, up to its sign
    Q.block<3, 3>(kTilt, kTilt) = J * step.motion->covariance.bottomRightCorner<3, 3>() * J.transpose();
    climb += down.dot(T.translation()) - sunk;
    climb_variance +=
        before.down_camera.dot(step.motion->covariance.topLeftCorner<3, 3>() * before.down_camera);
  }
  // What fades is not known to.
  const Vec3<double> faded = (1.0 - fade) * next.segment<3>(kTilt);
  next.segment<3>(kTilt) *= fade;
  next.segment<3>(kView) *= view_fade;
  F.block<3, 3>(kTilt, kMounting) = fade * (turn - Mat3<double>::Identity());
  F.block<3, 3>(kTilt, kTilt) = fade * turn;
  F.block<3, 3>(kView, kView) *= view_fade;
  Q.block<3, 3>(kTilt, kTilt) += (1.0 - fade * fade) * ride() + faded * faded.transpose();
  Q.block<3, 3>(kView, kView) = (1.0 - view_fade * view_fade) * view();
  unseen += step.seconds;
  x = next;
  P = (F * P * F.transpose() + Q).eval();
  if (step.vertical) look_down(*step.vertical);
  const double cos_tilt = x.head<3>().normalized().dot(slope().normalized());
  const bool standing = cos_tilt > std::cos(options.max_tilt * kDegree) &&
                        std::abs(climb) - 3.0 * std::sqrt(climb_variance) < options.max_climb;
  if (!standing) forget_tilt();
  return standing;
}

void GroundPlaneEstimator::State::look_down(const GroundPlaneStep::Vertical& vertical) {
  const Vec3<double> down = vertical.down_camera.normalized();
  const Vec3<double> s = slope();
  const double norm = s.norm();
  const Vec3<double> n = s / norm;
  Eigen::Matrix<double, 2, 3> across;
  across.row(0) = n.unitOrthogonal();
  across.row(1) = n.cross(Vec3<double>(across.row(0)));
  Eigen::Matrix<double, 2, kStates> H = Eigen::Matrix<double, 2, kStates>::Zero();
  H.leftCols<3>() = across / norm;
  H.middleCols<3>(kTilt) = H.leftCols<3>();
  const double variance = square(vertical.sigma) + square(options.floor_slope * kDegree);
  update<2>(H, across * down, variance * Eigen::Matrix2d::Identity());
}

// Fills `samples` with what may be a floor or a surface a little above or below it. Returns how many pixels
// had a disparity where a floor can be.
template <class T>
int GroundPlaneEstimator::State::collect(View2d<const T> disparity) {
  samples.clear();
  int valid = 0;
  const Vec3<double> s = slope();
  const Mat3<double> search = slope_covariance() + view_covariance() +
                              from_angles(s, scale, options.mounting_angle * kDegree, 0.5 * kSurface);
  const double noise = square(options.disparity_noise);
  const double inverse = 1.0 / camera.focal;
  for (int v = options.step_v / 2; v < disparity.height; v += options.step_v) {
    const T* row = disparity.row(v);
    const double y = (v - camera.cy) * inverse;
    for (int u = options.step_u / 2; u < disparity.width; u += options.step_u) {
      const double x = (u - camera.cx) * inverse;
      const Vec3<double> ray(x, y, 1.0);
      const double floor = s.dot(ray);
      if (floor < options.min_disparity) continue;
      const float d = disparity_of(row[u]);
      if (!(d > 0.0f)) continue;
      ++valid;
      if (square(d - floor) < square(kGate) * (ray.dot(search * ray) + noise))
        samples.add(static_cast<float>(x), static_cast<float>(y), d,
                    static_cast<std::uint8_t>(v * 8 / disparity.height * 4 + u * 4 / disparity.width));
    }
  }
  return valid;
}

// Whether the samples of a surface fix pitch, roll and height.
bool GroundPlaneEstimator::State::fixes(const impl::Surface& surface) const {
  if (!surface.determined) return false;
  const Mat3<double> by_slope = slope_by_angles(surface.seen, scale).inverse();
  const Mat3<double> variance = by_slope * surface.covariance * by_slope.transpose();
  return variance.diagonal().head<2>().maxCoeff() < square(options.max_angle_error * kDegree) &&
         variance(2, 2) < square(options.max_height_error);
}

// The error with which a surface tells the floor under the wheels. A robot that tilts stands on two heights,
// and the image may show either.
Mat3<double> GroundPlaneEstimator::State::noise_of(const impl::Surface& surface) const {
  const double tilt = std::sqrt((x.segment<3>(kTilt) -
                                 x.head<3>().normalized() * x.head<3>().normalized().dot(x.segment<3>(kTilt)))
                                    .squaredNorm()) /
                      x.head<3>().norm();
  return surface.covariance + from_angles(surface.seen, scale, 0.0, tilt * kWheelbase);
}

// Squared Mahalanobis distance of a surface from a plane that is known.
double GroundPlaneEstimator::State::distance(const impl::Surface& surface, const Vec3<double>& s,
                                             const Mat3<double>& covariance) const {
  const Vec3<double> difference = surface.seen - s;
  const Mat3<double> S = covariance + noise_of(surface);
  return difference.dot(S.ldlt().solve(difference));
}

void GroundPlaneEstimator::State::measure(GroundPlaneResult& result, double seconds) {
  const auto stop = [&](GroundPlaneState state, GroundPlaneReason reason) {
    result.state = state;
    result.reason = reason;
  };
  Mat3<double> search = slope_covariance() + view_covariance();
  search += from_angles(slope(), scale, options.mounting_angle * kDegree, kSurface);
  const impl::SlopePrior prior{slope(), search.inverse()};
  const std::vector<impl::Surface>& surfaces =
      finder.find(samples, prior, {options.disparity_noise, options.hypotheses, options.min_pixels, 3});

  // Of the surfaces that are large enough and agree with what is known the one nearest to the robot.
  const Eigen::Matrix<double, 3, kStates> H = seen_by_image();
  const impl::Surface *floor = nullptr, *largest = nullptr;
  const Vec3<double> expected = H * x;
  const Mat3<double> covariance = H * P * H.transpose();
  for (const impl::Surface& surface : surfaces) {
    if (!fixes(surface)) continue;
    if (!largest || surface.inliers > largest->inliers) largest = &surface;
    if (surface.inliers >= options.min_share * static_cast<double>(samples.size()) &&
        distance(surface, expected, covariance) < options.consistency &&
        (!floor || surface.disparity > floor->disparity))
      floor = &surface;
  }
  if (!largest)
    return stop(GroundPlaneState::predicted,
                surfaces.empty() ? GroundPlaneReason::no_floor : GroundPlaneReason::too_narrow);
  const impl::Surface& shown = floor ? *floor : *largest;
  result.inliers = shown.inliers;
  result.noise = shown.noise;
  if (!floor) {
    contradiction = *largest;
    return stop(GroundPlaneState::refused, GroundPlaneReason::contradiction);
  }
  update<3>(H, floor->seen - H * x, noise_of(*floor));
  climb = climb_variance = unseen = 0.0;
  support = std::min(support + seconds, kMaxSupport);
  rival_support = std::max(rival_support - seconds, 0.0);
  stop(GroundPlaneState::measured, GroundPlaneReason::none);
}

// A floor that calibration permits, seen for longer than the one that is believed, takes its place: the first
// frames may have shown a carpet ahead, or the floor beside the carpet that the robot stood on.
void GroundPlaneEstimator::State::learn_rival(const impl::Surface& surface, double seconds) {
  const Vec3<double> s = scale / seed.plane.height * seed.plane.down_camera;
  if (!(distance(surface, s, seed_covariance() + ride() + view_covariance()) < options.consistency)) return;
  if (rival_support > 0.0 && distance(surface, rival, 2.0 * (ride() + view())) < options.consistency) {
    rival += (surface.seen - rival) * (seconds / (rival_support + seconds));
    rival_support += seconds;
  } else {
    rival_support -= seconds;
    if (rival_support <= 0.0) {
      rival = surface.seen;
      rival_support = seconds;
    }
  }
  // How much better the rival agrees with calibration counts as much as views of it, each of which lasts.
  const Mat3<double> covariance = seed_covariance() + ride() + view();
  const auto off = [&](const Vec3<double>& slope) {
    return (slope - s).dot(covariance.ldlt().solve(slope - s));
  };
  const double prior = 0.5 * (off(x.head<3>()) - off(rival)) * options.view_time;
  if (rival_support + prior <= support) return;
  reset();
  x.head<3>() = rival;
  P.topLeftCorner<3, 3>() = ride() + view_covariance() + noise_of(surface);
  support = rival_support;
  rival_support = 0.0;
}

template <class T>
GroundPlaneResult GroundPlaneEstimator::State::look(View2d<const T> disparity, double seconds) {
  GroundPlaneResult result;
  result.pixels = collect(disparity);
  if (result.pixels < options.min_pixels) {
    result.reason = GroundPlaneReason::no_disparity;
  } else {
    measure(result, seconds);
  }
  return result;
}

template <class T>
GroundPlaneResult GroundPlaneEstimator::State::estimate(View2d<const T> disparity,
                                                        const GroundPlaneStep& step) {
  require(std::isfinite(step.seconds) && step.seconds > 0, "GroundPlaneEstimator::estimate step.seconds",
          "must be positive", step.seconds);
  if (step.motion) {
    const double sum = step.motion->T_now_before.matrix().sum() + step.motion->covariance.sum();
    require(std::isfinite(sum), "GroundPlaneEstimator::estimate step.motion", "must be finite", sum);
  }
  if (step.vertical) {
    const double norm = step.vertical->down_camera.norm() * (1.0 + square(step.vertical->sigma));
    require(std::isfinite(norm) && norm > 0, "GroundPlaneEstimator::estimate step.vertical",
            "must be a direction", norm);
  }
  const bool standing = predict(step);
  contradiction.reset();
  GroundPlaneResult result = look(disparity, step.seconds);
  const double tilt = x.head<3>().normalized().cross(slope().normalized()).norm();
  if (standing && !result.measured() && unseen > options.settle_time && tilt > options.ride_angle * kDegree) {
    // Motion may have told the tilt wrongly: the robot was lifted and put down elsewhere.
    const StateVector x_tilted = x;
    const StateMatrix P_tilted = P;
    forget_tilt();
    const GroundPlaneResult level = look(disparity, step.seconds);
    if (level.measured()) {
      result = level;
    } else {
      x = x_tilted;
      P = P_tilted;
    }
  }
  if (result.state == GroundPlaneState::refused) learn_rival(*contradiction, step.seconds);
  if (!standing && !result.measured()) {
    result.state = GroundPlaneState::predicted;
    result.reason = GroundPlaneReason::lifted;
  }
  const Vec3<double> s = slope();
  result.plane = plane(s);
  const Mat3<double> by_slope = slope_by_angles(s, scale).inverse();
  result.covariance = by_slope * slope_covariance() * by_slope.transpose();
  return result;
}

GroundPlaneEstimator::GroundPlaneEstimator(const RectifiedCamera& camera, const GroundPlaneSeed& seed,
                                           const GroundPlaneOptions& options)
    : state_(std::make_unique<State>()) {
  check_options(options);
  const double scale = camera.focal * camera.baseline;
  require(std::isfinite(scale) && camera.focal > 0 && camera.baseline > 0, "GroundPlaneEstimator camera",
          "must have a focal length and a baseline", scale);
  require(std::isfinite(seed.plane.height) && seed.plane.height > 0, "GroundPlaneEstimator seed",
          "must have a height", seed.plane.height);
  const double direction = seed.plane.down_camera.norm() + 0.0 * seed.wheels_camera.sum();
  require(std::isfinite(direction) && std::abs(direction - 1.0) < 1e-6, "GroundPlaneEstimator seed",
          "must have a unit normal", direction);
  state_->camera = camera;
  state_->seed = seed;
  state_->options = options;
  state_->scale = scale;
  state_->reset();
}

GroundPlaneEstimator::~GroundPlaneEstimator() = default;
GroundPlaneEstimator::GroundPlaneEstimator(GroundPlaneEstimator&&) noexcept = default;
GroundPlaneEstimator& GroundPlaneEstimator::operator=(GroundPlaneEstimator&&) noexcept = default;

GroundPlaneResult GroundPlaneEstimator::estimate(View2d<const std::int16_t> disparity,
                                                 const GroundPlaneStep& step) {
  return state_->estimate(disparity, step);
}
GroundPlaneResult GroundPlaneEstimator::estimate(View2d<const float> disparity, const GroundPlaneStep& step) {
  return state_->estimate(disparity, step);
}

GroundPlane GroundPlaneEstimator::mounting() const { return state_->plane(state_->x.head<3>()); }
void GroundPlaneEstimator::reset() { state_->reset(); }

}  // namespace sweepkit
