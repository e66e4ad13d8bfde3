// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <concepts>
#include <cstddef>
#include <span>
#include <string_view>

#include "sweepkit/core/error.hpp"
#include "sweepkit/geometry/se3.hpp"

namespace sweepkit {

/// What moves a pose by a twist. `I` is a policy without state that offers
///
///     static constexpr std::string_view kName;
///     template <class S> static SE3<S> motion(const Vec6<S>& xi);      // the motion of the twist over a
///     step template <class S> static Mat6<S> jacobian(const Vec6<S>& xi);   // of motion(), perturbed on the
///     right
///
/// xi = (v dt, w dt): mean velocity and mean angular rate in the moving frame times the step [m, rad].
/// motion(xi + d) = motion(xi) Exp(jacobian(xi) d) to first order. S is float, double or ceres::Jet.
template <class I>
concept TwistIntegrator = requires(const Vec6<double>& xi, const Vec6<float>& xi_float) {
  { I::kName } -> std::convertible_to<std::string_view>;
  { I::motion(xi) } -> std::same_as<SE3<double>>;
  { I::motion(xi_float) } -> std::same_as<SE3<float>>;
  { I::jacobian(xi) } -> std::same_as<Mat6<double>>;
};

/// Translates with the heading at the start of the step, then turns. First order.
struct EulerIntegrator {
  static constexpr std::string_view kName = "euler";

  template <class S>
  static SE3<S> motion(const Vec6<S>& xi) {
    return {SO3<S>::exp(xi.template tail<3>()), xi.template head<3>()};
  }
  template <class S>
  static Mat6<S> jacobian(const Vec6<S>& xi) {
    const Vec3<S> phi = xi.template tail<3>();
    Mat6<S> J = Mat6<S>::Zero();
    J.template topLeftCorner<3, 3>() = SO3<S>::exp(-phi).matrix();
    J.template bottomRightCorner<3, 3>() = SO3<S>::right_jacobian(phi);
    return J;
  }
};

/// Translates with the mean heading: half of the turn, the translation, the other half. Second-order
/// Runge-Kutta.
struct MidpointIntegrator {
  static constexpr std::string_view kName = "midpoint";

  template <class S>
  static SE3<S> motion(const Vec6<S>& xi) {
    const Vec3<S> phi = xi.template tail<3>();
    return {SO3<S>::exp(phi), SO3<S>::exp(S(0.5) * phi) * Vec3<S>(xi.template head<3>())};
  }
  template <class S>
  static Mat6<S> jacobian(const Vec6<S>& xi) {
    const Vec3<S> rho = xi.template head<3>(), phi = xi.template tail<3>();
    const Mat3<S> half_back = SO3<S>::exp(S(-0.5) * phi).matrix();
    Mat6<S> J = Mat6<S>::Zero();
    J.template topLeftCorner<3, 3>() = half_back;
    J.template topRightCorner<3, 3>() =
        S(-0.5) * (half_back * SO3<S>::hat(rho) * SO3<S>::right_jacobian(S(0.5) * phi));
    J.template bottomRightCorner<3, 3>() = SO3<S>::right_jacobian(phi);
    return J;
  }
};

/// Exp on SE(3): [R, J v dt; 0, 1] with R = Exp(w dt) and J the left Jacobian of SO(3). Exact for a constant
/// twist, whatever the step; in space, so that sills and uneven floor are in.
struct ClosedFormIntegrator {
  static constexpr std::string_view kName = "closed_form";

  template <class S>
  static SE3<S> motion(const Vec6<S>& xi) {
    const Vec3<S> rho = xi.template head<3>(), phi = xi.template tail<3>();
    const impl::Stumpff<S> c(phi.squaredNorm());
    const Vec3<S> turned = phi.cross(rho);
    return {SO3<S>::exp(phi), Vec3<S>(rho + c.c2 * turned + c.c3 * phi.cross(turned))};
  }
  template <class S>
  static Mat6<S> jacobian(const Vec6<S>& xi) {
    return SE3<S>::right_jacobian(xi);
  }
};

static_assert(TwistIntegrator<EulerIntegrator> && TwistIntegrator<MidpointIntegrator> &&
              TwistIntegrator<ClosedFormIntegrator>);

/// A motion and how uncertain it is: the true one is T Exp(d), d of mean zero and that covariance, (rho, phi)
/// in the frame that T ends in [m, rad].
template <class S>
struct UncertainMotion {
  SE3<S> T;
  Mat6<S> covariance = Mat6<S>::Zero();
};

/// The covariance of T_a_b given in the perturbation on the right, carried to the perturbation of T_a_b T_b_c
/// when T_b_c is exact.
template <class S>
Mat6<S> carry_covariance(const Mat6<S>& covariance, const SE3<S>& T_b_c) {
  const Mat6<S> Ad = T_b_c.inverse().adjoint();
  return Ad * covariance * Ad.transpose();
}

/// Both motions one after the other, their errors independent. First order in the covariances.
template <class S>
UncertainMotion<S> operator*(const UncertainMotion<S>& a, const UncertainMotion<S>& b) {
  return {a.T * b.T, carry_covariance(a.covariance, b.T) + b.covariance};
}

/// The motion of one step. `noise` is the covariance of xi = (v dt, w dt).
template <TwistIntegrator I = ClosedFormIntegrator, class S>
UncertainMotion<S> integrate_step(const Vec6<S>& xi, const Mat6<S>& noise) {
  const Mat6<S> J = I::template jacobian<S>(xi);
  return {I::template motion<S>(xi), J * noise * J.transpose()};
}

/// The poses along a path. times[k] is the start of step k [s] and rates[k] = (v, w) its mean twist [m/s,
/// rad/s]: times has one more than rates, and so has the result, which begins with `start`.
/// @throws Error(argument) where the numbers differ or a time lies before its predecessor
template <TwistIntegrator I = ClosedFormIntegrator, class S>
void integrate_path(std::span<const S> times, std::span<const Vec6<S>> rates, const SE3<S>& start,
                    std::span<SE3<S>> poses) {
  require(times.size() == rates.size() + 1, "integrate_path times", "must be one more than rates",
          times.size());
  require(poses.size() == times.size(), "integrate_path poses", "must be as many as times", poses.size());
  SE3<S> pose = start;
  poses[0] = pose;
  for (std::size_t k = 0; k < rates.size(); ++k) {
    const S dt = times[k + 1] - times[k];
    require(dt >= S(0), "integrate_path times", "must not decrease; they do by [s]", dt);
    pose = pose * I::template motion<S>(Vec6<S>(rates[k] * dt));
    poses[k + 1] = pose;
  }
}

}  // namespace sweepkit
