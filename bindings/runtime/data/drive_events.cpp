// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "drive_events.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <numbers>

#include "smooth_step.hpp"

namespace sweepkit {
namespace {

constexpr double kDeg = 180.0 / std::numbers::pi;
constexpr double kRamp = 0.1;  // [s]

// How fast the script goes on against the clock.
double pace(std::span<const DriveDisturbance> disturbances, double t) {
  double rate = 1.0;
  for (const DriveDisturbance& d : disturbances) {
    const double since = t - d.begin;
    switch (d.kind) {
      case DriveDisturbance::Kind::slip:
        if (d.left && d.right)
          rate *= 1.0 + smooth_step(since / kRamp) * smooth_step((d.end - t) / kRamp) * (d.grip - 1.0);
        break;
      case DriveDisturbance::Kind::free_spin:
        rate *= 1.0 - smooth_step((since + 0.3) / 0.3) * smooth_step((d.end + 0.3 - t) / 0.3);
        break;
      case DriveDisturbance::Kind::bump:
        rate *= 1.0 - 1.4 * smooth_step(since / 0.05) + 0.4 * smooth_step((since - 0.1) / 0.2) +
                smooth_step((since - 0.4) / 0.5);
        break;
    }
  }
  return rate;
}

// Spans in which a condition holds.
std::vector<std::pair<double, double>> spans(double duration, double step, double shortest,
                                             const std::function<bool(double)>& holds) {
  std::vector<std::pair<double, double>> found;
  double begin = -1.0;
  for (double t = 0.0; t <= duration + step; t += step) {
    const bool now = t <= duration && holds(t);
    if (now && begin < 0.0) begin = t;
    if (!now && begin >= 0.0) {
      const double end = std::min(t, duration);
      if (end - begin >= shortest) found.emplace_back(begin, end);
      begin = -1.0;
    }
  }
  return found;
}

double yaw_of(const SE3d& T) {
  const Vec3<double> x = T.rotation() * Vec3<double>(1, 0, 0);
  return std::atan2(x.y(), x.x());
}

}  // namespace

DriveClock::DriveClock(std::span<const DriveDisturbance> disturbances, double script, double duration) {
  double longest = script + 1.0;
  for (const DriveDisturbance& d : disturbances) {
    const bool timed = d.kind == DriveDisturbance::Kind::bump || d.end > d.begin;
    if (!(d.begin >= 0.0) || !timed)
      throw Error(ErrorKind::data, d.place, "must end after it begins, not before 0");
    if (d.kind == DriveDisturbance::Kind::slip && !(d.grip > 0.0 && d.grip <= 1.0))
      throw Error(ErrorKind::data, d.place, "grip must be above 0 and at most 1", number_text(d.grip));
    longest += std::max(kBumpDuration, d.end - d.begin) + 1.0;
  }
  const double limit = duration > 0.0 ? duration : longest;
  driven_ = {0.0};
  // The trapezoidal rule; after the script's end the robot stands whatever the clock says.
  double before = pace(disturbances, 0.0);
  std::size_t done = 0;
  for (std::size_t i = 1; kStep * static_cast<double>(i) <= limit + 0.5 * kStep; ++i) {
    const double now = pace(disturbances, kStep * static_cast<double>(i));
    driven_.push_back(driven_.back() + 0.5 * kStep * (before + now));
    before = now;
    if (done == 0 && driven_.back() >= script) done = i;
    if (duration <= 0.0 && done > 0 && kStep * static_cast<double>(i - done) >= 1.0) break;
  }
  // A whole number of the spline's steps.
  duration_ = std::floor(100.0 * kStep * static_cast<double>(driven_.size() - 1) + 1e-6) / 100.0;
}

double DriveClock::driven(double t) const {
  const double at = std::clamp(t / kStep, 0.0, static_cast<double>(driven_.size() - 1));
  const auto i = std::min(static_cast<std::size_t>(at), driven_.size() - 2);
  return driven_[i] + (at - static_cast<double>(i)) * (driven_[i + 1] - driven_[i]);
}

double DriveClock::when(double script) const {
  const auto i = std::find_if(driven_.begin(), driven_.end(), [&](double s) { return s >= script - 1e-9; });
  return kStep * static_cast<double>(i - driven_.begin());
}

SE3d shaken(std::span<const DriveDisturbance> disturbances, double t) {
  SE3d shake;
  for (const DriveDisturbance& d : disturbances) {
    const double since = t - d.begin;
    if (d.kind != DriveDisturbance::Kind::bump || since <= 0.0 || since >= kBumpDuration) continue;
    // A rigid body on soft wheels: the nose dips and swings back, damped.
    const double size = d.strength * smooth_step(since / 0.03) * std::exp(-since / 0.09) *
                        smooth_step((kBumpDuration - since) / 0.3);
    const double wave = 2.0 * std::numbers::pi * 9.0 * since;
    constexpr double kPitch = 0.0105, kYaw = 0.004, kUp = 0.0008;
    shake = shake * SE3d(SO3d::exp({0, size * kPitch * std::sin(wave), size * kYaw * std::sin(0.7 * wave)}),
                         {0, 0, size * kUp * (1.0 - std::cos(wave))});
  }
  return shake;
}

void observe(const Scene& scene, const FloorPlan& plan, Drive& drive) {
  const PoseSpline& base = drive.base;
  const double duration = base.duration();
  constexpr double kStep = 0.02;
  const auto speed = [&](double t) { return base.at(t).velocity.norm(); };
  const auto turn = [&](double t) { return base.at(t).angular_rate.norm(); };
  const auto in_air = [&](double t) {
    return std::any_of(drive.events.begin(), drive.events.end(),
                       [&](const TimedEvent& e) { return e.kind == "lifted" && t >= e.begin && t <= e.end; });
  };
  std::vector<TimedEvent> seen;
  for (const auto& [begin, end] :
       spans(duration, kStep, 0.3, [&](double t) { return speed(t) < 1e-3 && turn(t) < 2e-3; }))
    seen.push_back({"standstill", begin, end, ""});
  for (const auto& [begin, end] : spans(duration, kStep, 0.3, [&](double t) {
         return speed(t) < 4e-3 && std::abs(base.at(t).angular_rate.z()) > 0.02 && !in_air(t);
       })) {
    double angle = 0.0;
    for (double t = begin; t < end; t += kStep) angle += kStep * base.at(t).angular_rate.z();
    seen.push_back({"turn_in_place", begin, end, fmt::format("{:.0f} deg", angle * kDeg)});
  }
  const auto carpet = [&](double t) {
    const Vec3<double> p = base.pose(t).translation();
    return in_air(t) ? -1 : plan.carpet_at(p.x(), p.y());
  };
  for (std::size_t i = 0; i < scene.objects.size(); ++i) {
    if (scene.objects[i].kind != ObjectKind::carpet) continue;
    const SceneObject& object = scene.objects[i];
    const double thick = object.size.z() > 0.0 ? object.size.z() : usual_size(ObjectKind::carpet).z();
    for (const auto& [begin, end] :
         spans(duration, kStep, 0.1, [&](double t) { return carpet(t) == static_cast<int>(i); }))
      seen.push_back({"on_carpet", begin, end, fmt::format("{:.1f} mm thick", 1000.0 * thick)});
  }
  for (const Door& door : scene.doors) {
    const DoorPassage passage = door_passage(scene, door);
    const Vec2<double> u(std::cos(passage.yaw), std::sin(passage.yaw));
    // From the nose's arrival to the tail's departure.
    for (const auto& [begin, end] : spans(duration, kStep, 0.1, [&](double t) {
           const Vec2<double> d = base.pose(t).translation().head<2>() - passage.centre;
           return std::abs(u.dot(d)) < 0.5 * passage.depth + 0.15 &&
                  std::abs(u.x() * d.y() - u.y() * d.x()) < 0.5 * passage.width;
         }))
      seen.push_back({"door_passage", begin, end,
                      fmt::format("{} / {}, {}", door.from, door.to, door.sill > 0.0 ? "sill" : "no sill")});
  }
  std::vector<SE3d> poses;
  constexpr double kPoseStep = 0.1;
  for (double t = 0.0; t <= duration; t += kPoseStep) poses.push_back(base.pose(t));
  for (const auto& [begin, end] : spans(duration, kPoseStep, 0.3, [&](double t) {
         const SE3d now = base.pose(t);
         for (std::size_t i = 0; kPoseStep * static_cast<double>(i) < t - 10.0; ++i)
           if ((poses[i].translation() - now.translation()).norm() < 0.5 &&
               std::abs(std::remainder(yaw_of(poses[i]) - yaw_of(now), 2.0 * std::numbers::pi)) < 30.0 / kDeg)
             return true;
         return false;
       }))
    seen.push_back({"revisit", begin, end, "within 0.5 m and 30 deg of a pose at least 10 s earlier"});
  drive.events.insert(drive.events.end(), seen.begin(), seen.end());
}

}  // namespace sweepkit
