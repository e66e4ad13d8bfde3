// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/map/rig_identity.hpp"

#include <fmt/format.h>

#include <cmath>
#include <cstddef>
#include <numbers>

namespace sweepkit {
namespace {

using Difference = std::optional<std::string>;

Difference apart(std::string_view side, std::string_view field, double there, double here, double tolerance,
                 std::string_view unit) {
  if (std::abs(there - here) <= tolerance) return std::nullopt;
  return fmt::format("{} {}: {:.9g} there, {:.9g} here (tolerance {:g}{}{})", side, field, there, here,
                     tolerance, unit.empty() ? "" : " ", unit);
}

Difference camera_difference(std::string_view side, const CameraIdentity& there, const CameraIdentity& here,
                             const RigTolerance& tolerance) {
  if (there.width != here.width || there.height != here.height)
    return fmt::format("{} image size: {}x{} px there, {}x{} px here", side, there.width, there.height,
                       here.width, here.height);
  if (there.distortion != here.distortion)
    return fmt::format("{} distortion model: {} there, {} here", side, to_string(there.distortion),
                       to_string(here.distortion));
  constexpr const char* kIntrinsics[] = {"fx", "fy", "cx", "cy"};
  for (std::size_t i = 0; i < std::size(kIntrinsics); ++i)
    if (auto d = apart(side, kIntrinsics[i], there.intrinsics.at(i), here.intrinsics.at(i), tolerance.pixels,
                       "px"))
      return d;
  // A fifth coefficient that is zero is one that is not there.
  for (std::size_t i = 0; i < std::max(there.coefficients.size(), here.coefficients.size()); ++i) {
    const auto value = [i](const CameraIdentity& c) {
      return i < c.coefficients.size() ? c.coefficients[i] : 0.0;
    };
    if (auto d = apart(side, fmt::format("distortion coefficient {}", i + 1), value(there), value(here),
                       tolerance.coefficients, ""))
      return d;
  }
  const auto axis = [](int i) { return "xyz"[i]; };
  const Vec3<double>&a = there.T_body_camera.translation(), &b = here.T_body_camera.translation();
  for (int i = 0; i < 3; ++i)
    if (auto d =
            apart(side, fmt::format("camera in the body, {}", axis(i)), a[i], b[i], tolerance.position, "m"))
      return d;
  const double angle = (there.T_body_camera.rotation().inverse() * here.T_body_camera.rotation()).angle();
  if (angle > tolerance.angle) {
    constexpr double kDegrees = 180 / std::numbers::pi;
    const Vec3<double> r = there.T_body_camera.rotation().log() * kDegrees;
    const Vec3<double> s = here.T_body_camera.rotation().log() * kDegrees;
    return fmt::format(
        "{} camera in the body, rotation vector: ({:.6g}, {:.6g}, {:.6g}) deg there, ({:.6g}, {:.6g}, "
        "{:.6g}) deg here, "
        "{:.3g} deg apart (tolerance {:.2g} deg)",
        side, r.x(), r.y(), r.z(), s.x(), s.y(), s.z(), angle * kDegrees, tolerance.angle * kDegrees);
  }
  return std::nullopt;
}

}  // namespace

RigIdentity identity_of(const StereoRig& rig) {
  const auto camera = [&](Side side) {
    const Camera& c = rig.camera(side);
    return CameraIdentity{c.width(),      c.height(),       c.intrinsics(),
                          c.distortion(), c.coefficients(), rig.T_body_raw(side)};
  };
  return {camera(Side::left), camera(Side::right)};
}

std::optional<std::string> difference(const RigIdentity& there, const RigIdentity& here,
                                      const RigTolerance& tolerance) {
  if (auto d = camera_difference("left", there.left, here.left, tolerance)) return d;
  return camera_difference("right", there.right, here.right, tolerance);
}

}  // namespace sweepkit
