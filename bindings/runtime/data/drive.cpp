// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/data/drive.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <numbers>

#include "drive_events.hpp"
#include "drive_planner.hpp"
#include "smooth_step.hpp"
#include "sweepkit/core/random.hpp"

namespace sweepkit {
namespace {

constexpr double kRad = std::numbers::pi / 180.0;
constexpr double kStep = 0.01;  // of the spline [s]

double wrapped(double angle) { return std::remainder(angle, 2.0 * std::numbers::pi); }

Vec2<double> heading(double yaw) { return {std::cos(yaw), std::sin(yaw)}; }

double angle_of(const Vec2<double>& d) { return std::atan2(d.y(), d.x()); }

// A robot that stands on the floor: a plane through the contacts of its wheels and the castor.
class Stance {
 public:
  Stance(const FloorPlan& plan, const RobotOptions& robot) : plan_(plan), robot_(robot) {}

  SE3d operator()(const Vec2<double>& p, double yaw) const {
    const Vec2<double> ahead = heading(yaw), left(-ahead.y(), ahead.x());
    const double half = 0.5 * robot_.contact_track;
    const auto height = [&](const Vec2<double>& q) { return plan_.height(q.x(), q.y()); };
    const double at_left = height(p + half * left), at_right = height(p - half * left);
    const double middle = 0.5 * (at_left + at_right);
    const double roll = std::atan2(at_left - at_right, 2.0 * half);
    const double pitch = -std::atan2(height(p + robot_.caster * ahead) - middle, robot_.caster);
    return {SO3d::exp({0, 0, yaw}) * SO3d::exp({0, pitch, 0}) * SO3d::exp({roll, 0, 0}),
            {p.x(), p.y(), middle}};
  }

 private:
  const FloorPlan& plan_;
  const RobotOptions& robot_;
};

// Writes down what a robot does, one piece after the other, each a function of the time since its beginning.
class DriveBuilder {
 public:
  using Pose = std::function<SE3d(double)>;
  struct Piece {
    double begin, duration;
    Pose pose;
    bool lifted = false;
  };

  DriveBuilder(const Scene& scene, const FloorPlan& plan, const RobotOptions& robot,
               const DriveScript& script, std::uint64_t seed)
      : scene_(scene),
        plan_(plan),
        robot_(robot),
        planner_(plan, robot.radius + robot.margin),
        stance_(plan, robot),
        random_(seed),
        place_(script.place) {
    p_ = script.start ? *script.start : free_spot();
    yaw_ = script.yaw;
    if (Vec2<double> at; !planner_.is_free(p_, p_, robot_.radius, &at))
      refuse("the robot does not fit at its start", at);
    home_ = p_;
    home_yaw_ = yaw_;
  }

  void run(const DriveStep& step) {
    place_ = step.place;
    const double limit = step.seconds > 0.0 ? time_ + step.seconds : std::numeric_limits<double>::infinity();
    switch (step.kind) {
      case DriveStep::Kind::stand:
        return stand(step.seconds);
      case DriveStep::Kind::drive:
        return drive(step.points, step.yaw);
      case DriveStep::Kind::go:
        return go(step.points.back(), step.yaw);
      case DriveStep::Kind::back:
        return straight(-step.length);
      case DriveStep::Kind::turn:
        return turn(step.angle);
      case DriveStep::Kind::turn_to:
        return turn(wrapped(*step.yaw - yaw_));
      case DriveStep::Kind::lanes: {
        const Room* room = scene_.find_room(step.room);
        if (!room) throw Error(ErrorKind::data, place_, "there is no room of that name", step.room);
        return lanes(*room, step.spacing, limit);
      }
      case DriveStep::Kind::follow_wall:
        return follow_wall(step.distance, step.length);
      case DriveStep::Kind::face_wall:
        return face_wall(step);
      case DriveStep::Kind::carry:
        return carry(step);
      case DriveStep::Kind::cover:
        return cover(step.spacing, limit);
      case DriveStep::Kind::home:
        return go(home_, home_yaw_);
    }
  }

  double time() const { return time_; }
  const std::vector<Piece>& pieces() const { return pieces_; }
  const std::vector<TimedEvent>& events() const { return events_; }

  // T_world_base after that time of driving.
  SE3d pose(double t) const {
    if (pieces_.empty() || t <= 0.0) return stance_(home_, home_yaw_);
    auto next = std::upper_bound(pieces_.begin(), pieces_.end(), t,
                                 [](double value, const Piece& piece) { return value < piece.begin; });
    const Piece& piece = *(next == pieces_.begin() ? next : next - 1);
    return piece.pose(std::min(t - piece.begin, piece.duration));
  }

 private:
  [[noreturn]] void refuse(const std::string& what, const Vec2<double>& at) const {
    const ObjectTruth* nearest = nullptr;
    double least = 0.5;
    const std::vector<ObjectTruth> objects = object_truth(scene_);
    for (const ObjectTruth& object : objects) {
      if (object.label == SceneLabel::carpet || object.label == SceneLabel::cable) continue;
      const Vec2<double> d = at - object.centre.head<2>(), u = heading(object.yaw), v(-u.y(), u.x());
      const double gap = std::hypot(std::max(0.0, std::abs(u.dot(d)) - 0.5 * object.size.x()),
                                    std::max(0.0, std::abs(v.dot(d)) - 0.5 * object.size.y()));
      if (gap < least) least = gap, nearest = &object;
    }
    const Vec2<double> in_file = scene_.from_world(at);
    std::string message =
        fmt::format("{} at [{:.2f}, {:.2f}] of the file's frame", what, in_file.x(), in_file.y());
    if (nearest) message += fmt::format(", near the {}", nearest->name);
    throw Error(ErrorKind::data, place_, message);
  }

  Vec2<double> free_spot() {
    if (scene_.rooms.empty()) throw Error(ErrorKind::data, place_, "the scene has no room to drive in");
    Vec2<double> low = scene_.rooms[0].corners[0], high = low;
    for (const auto& corner : scene_.rooms[0].corners)
      low = low.cwiseMin(corner), high = high.cwiseMax(corner);
    // The roomiest of some spots.
    Vec2<double> best = 0.5 * (low + high);
    double most = -1.0;
    for (int i = 0; i < 200; ++i) {
      const Vec2<double> p(random_.uniform(low.x(), high.x()), random_.uniform(low.y(), high.y()));
      const double room = std::min(0.6, plan_.clearance(p.x(), p.y()));
      if (plan_.room_at(p.x(), p.y()) == 0 && room > most) most = room, best = p;
    }
    return best;
  }

  // Anywhere that the robot could drive to from its start and a hand can put it down.
  Vec2<double> any_spot() {
    Vec2<double> low = Vec2<double>::Constant(1e9), high = -low;
    for (const Room& room : scene_.rooms)
      for (const auto& corner : room.corners) low = low.cwiseMin(corner), high = high.cwiseMax(corner);
    for (int i = 0; i < 1000; ++i) {
      const Vec2<double> p(random_.uniform(low.x(), high.x()), random_.uniform(low.y(), high.y()));
      if (plan_.room_at(p.x(), p.y()) >= 0 && planner_.is_free(p, p) &&
          plan_.open_above(p.x(), p.y(), robot_.radius) && planner_.route(home_, p))
        return p;
    }
    throw Error(ErrorKind::data, place_, "found nowhere in the flat where the robot fits");
  }

  void add(double duration, Pose pose, bool lifted = false) {
    if (duration <= 0.0) return;
    if (time_ + duration > 1e5) throw Error(ErrorKind::data, place_, "the drive takes more than a day");
    pieces_.push_back({time_, duration, std::move(pose), lifted});
    time_ += duration;
  }

  void stand(double seconds) {
    add(seconds, [pose = stance_(p_, yaw_)](double) { return pose; });
  }

  void turn(double angle) {
    if (std::abs(angle) < 1e-6) return;
    const SmoothRun run(angle, robot_.turn_rate_deg * kRad, robot_.turn_acceleration_deg * kRad);
    add(run.duration, [run, this, p = p_, yaw = yaw_](double t) { return stance_(p, yaw + run.at(t)); });
    yaw_ = wrapped(yaw_ + angle);
  }

  // Forward or, if negative, backwards.
  void straight(double length) {
    if (std::abs(length) < 1e-6) return;
    const Vec2<double> goal = p_ + length * heading(yaw_);
    if (Vec2<double> at; !planner_.is_free(p_, goal, robot_.radius, &at))
      refuse("something stands in the way", at);
    const SmoothRun run(length, robot_.speed, robot_.acceleration);
    add(run.duration,
        [run, this, p = p_, yaw = yaw_](double t) { return stance_(p + run.at(t) * heading(yaw), yaw); });
    p_ = goal;
  }

  // Along one chain whose corners can be rounded.
  bool rounded(const Points& points) {
    for (double corner = robot_.corner; corner > 0.04; corner *= 0.5) {
      const auto path = std::make_shared<const RoundedPath>(points, corner);
      bool free = true;
      for (double s = 0.0; free && s < path->length(); s += 0.02) {
        const Vec2<double> p = path->at(s).p;
        free = plan_.clearance(p.x(), p.y()) >= robot_.radius;
      }
      if (!free) continue;
      turn(wrapped(angle_of(path->at(0.0).d) - yaw_));
      const auto timing = std::make_shared<const PathTiming>(*path, robot_.speed, robot_.turn_rate_deg * kRad,
                                                             robot_.acceleration);
      add(timing->duration(), [path, timing, this](double t) {
        const RoundedPath::Place place = path->at(timing->at(t));
        return stance_(place.p, angle_of(place.d));
      });
      p_ = path->at(path->length()).p;
      yaw_ = angle_of(path->at(path->length()).d);
      return true;
    }
    return false;
  }

  // Through points that have been found free; stops where the turn is sharper than `sharpest`.
  void follow(const Points& points, double sharpest) {
    Points chain;
    for (const auto& p : points)
      if (chain.empty() || (p - chain.back()).norm() > 0.02) chain.push_back(p);
    if (chain.size() < 2) return;
    Points part = {chain[0]};
    const auto flush = [&] {
      if (part.size() < 2) return;
      if (part.size() > 2 && robot_.corner > 0.0 && rounded(part)) return;
      for (std::size_t i = 1; i < part.size(); ++i) {
        turn(wrapped(angle_of(part[i] - p_) - yaw_));
        straight((part[i] - p_).norm());
      }
    };
    for (std::size_t i = 1; i < chain.size(); ++i) {
      part.push_back(chain[i]);
      if (i + 1 == chain.size()) break;
      const double bend = wrapped(angle_of(chain[i + 1] - chain[i]) - angle_of(chain[i] - chain[i - 1]));
      if (std::abs(bend) > sharpest) {
        flush();
        part = {chain[i]};
      }
    }
    flush();
  }

  void drive(const Points& points, const std::optional<double>& yaw) {
    Points chain = {p_};
    chain.insert(chain.end(), points.begin(), points.end());
    for (std::size_t i = 1; i < chain.size(); ++i)
      if (Vec2<double> at; !planner_.is_free(chain[i - 1], chain[i], robot_.radius, &at))
        refuse("something stands in the way", at);
    follow(chain, 100.0 * kRad);
    if (yaw) turn(wrapped(*yaw - yaw_));
  }

  void go(const Vec2<double>& goal, const std::optional<double>& yaw) {
    const auto route = planner_.route(p_, goal);
    if (!route) refuse("no way leads to the goal", goal);
    // The ends may be nearer to things than the planner likes to be.
    for (std::size_t i = 1; i < route->size(); ++i)
      if (Vec2<double> at; !planner_.is_free((*route)[i - 1], (*route)[i], robot_.radius, &at))
        refuse("something stands in the way", at);
    follow(*route, 100.0 * kRad);
    if (yaw) turn(wrapped(*yaw - yaw_));
  }

  void lanes(const Room& room, double spacing, double limit) {
    const bool along = random_.uniform() < 0.7, from_far = random_.uniform() < 0.5;
    const double direction = scene_.main_direction(room).value_or(0.0);
    for (const Points& lane : planner_.lanes(room, direction, spacing, along, from_far)) {
      if (time_ >= limit) return;
      const auto route = planner_.route(p_, lane[0]);
      if (!route) continue;  // a corner that cannot be reached
      Points chain = *route;
      chain.push_back(lane[1]);
      follow(chain, 50.0 * kRad);
    }
  }

  void cover(double spacing, double limit) {
    const int here = plan_.room_at(p_.x(), p_.y());
    std::vector<std::size_t> order;
    if (here >= 0) order.push_back(static_cast<std::size_t>(here));
    for (std::size_t i = 0; i < scene_.rooms.size(); ++i)
      if (static_cast<int>(i) != here) order.push_back(i);
    random_.shuffle(std::span(order).subspan(here >= 0 ? 1 : 0));
    const double begin = time_;
    for (std::size_t i = 0; i < order.size(); ++i) {
      // Each room gets its share of the time.
      const double share = static_cast<double>(i + 1) / static_cast<double>(order.size());
      lanes(scene_.rooms[order[i]], spacing, begin + share * (limit - begin));
    }
  }

  void follow_wall(double distance, double length) {
    if (distance < robot_.radius + 0.015)
      throw Error(ErrorKind::data, place_, "the distance from the wall leaves no room for the robot",
                  number_text(distance));
    const auto way = planner_.along_wall(p_, distance, length);
    if (!way) refuse("no wall can be followed from here", p_);
    go(way->front(), std::nullopt);
    for (std::size_t i = 1; i < way->size(); ++i)
      if (Vec2<double> at; !planner_.is_free((*way)[i - 1], (*way)[i], robot_.radius, &at))
        refuse("something stands in the way along the wall", at);
    follow(*way, 70.0 * kRad);
  }

  void face_wall(const DriveStep& step) {
    const Room* room = scene_.find_room(step.room);
    if (!room) throw Error(ErrorKind::data, place_, "there is no room of that name", step.room);
    if (step.wall < 0 || step.wall >= static_cast<int>(room->corners.size()))
      throw Error(ErrorKind::data, place_, "the room has no such wall", std::to_string(step.wall));
    const auto first = static_cast<std::size_t>(step.wall), second = (first + 1) % room->corners.size();
    const Vec2<double> wall = (room->corners[second] - room->corners[first]).normalized();
    const Vec2<double> inward(-wall.y(), wall.x());
    const Vec2<double> foot = room->corners[first] + step.along * wall;
    constexpr double kApproach = 0.45;
    const double near = robot_.radius + step.distance;
    const double yaw = angle_of(-inward);
    go(foot + (near + kApproach) * inward, yaw);
    straight(kApproach);
    const double begin = time_;
    stand(0.5 * step.seconds);
    if (step.angle != 0.0) {
      turn(step.angle);
      turn(-2.0 * step.angle);
      turn(step.angle);
    }
    stand(0.5 * step.seconds);
    events_.push_back({"bare_wall", begin, time_,
                       fmt::format("robot {:.2f} m before a wall of {}", step.distance, step.room)});
    straight(-kApproach);
  }

  void carry(const DriveStep& step) {
    const SE3d from = stance_(p_, yaw_);
    const bool anywhere = step.points.empty();
    const Vec2<double> goal = anywhere ? any_spot() : step.points.back();
    const double yaw =
        step.yaw.value_or(anywhere ? random_.uniform(-std::numbers::pi, std::numbers::pi) : yaw_);
    if (Vec2<double> at; !planner_.is_free(goal, goal, robot_.radius, &at))
      refuse("the robot does not fit where it is put down", at);
    const SE3d to = stance_(goal, yaw);
    const double angle = wrapped(yaw - yaw_), duration = step.seconds, height = step.height;
    const Vec3<double> way = to.translation() - from.translation();
    const SO3d rest = SO3d::exp({0, 0, -angle}) * (from.rotation().inverse() * to.rotation());
    const double sway = random_.uniform(3.0, 7.0) * kRad, dip = random_.uniform(-8.0, -3.0) * kRad;
    const double begin = time_;
    add(
        duration,
        [=](double t) {
          // Up, over, down; held at an angle while in the air.
          const double x = t / duration;
          const double up = smooth_step(x / 0.35) * smooth_step((1.0 - x) / 0.35);
          const double over = smooth_step((x - 0.12) / 0.76);
          const double wave = std::sin(2.0 * std::numbers::pi * 0.9 * t);
          const SO3d tilt = SO3d::exp({up * sway * wave, up * dip, 0});
          const SO3d turned =
              from.rotation() * SO3d::exp({0, 0, over * angle}) * SO3d::exp(over * rest.log());
          return SE3d(turned * tilt, from.translation() + over * way + Vec3<double>(0, 0, up * height));
        },
        true);
    events_.push_back({"lifted", begin, time_, "picked up, carried and put down elsewhere"});
    p_ = goal;
    yaw_ = wrapped(yaw);
  }

  const Scene& scene_;
  const FloorPlan& plan_;
  const RobotOptions& robot_;
  DrivePlanner planner_;
  Stance stance_;
  Random random_;
  std::string place_;
  Vec2<double> p_, home_;
  double yaw_ = 0.0, home_yaw_ = 0.0, time_ = 0.0;
  std::vector<Piece> pieces_;
  std::vector<TimedEvent> events_;
};

std::vector<DriveStep> usual_steps() {
  std::vector<DriveStep> steps(3);
  steps[0].kind = DriveStep::Kind::stand;
  steps[0].seconds = 2.0;
  steps[1].kind = DriveStep::Kind::cover;
  steps[1].spacing = 0.4;
  steps[2].kind = DriveStep::Kind::home;
  return steps;
}

}  // namespace

Drive make_drive(const Scene& scene, const FloorPlan& plan, const RobotOptions& robot,
                 const DriveScript& script, std::span<const DriveDisturbance> disturbances, double duration,
                 std::uint64_t seed) {
  check_options(robot);
  DriveBuilder builder(scene, plan, robot, script, seed);
  for (const DriveStep& step : script.steps.empty() ? usual_steps() : script.steps) {
    builder.run(step);
    // Nobody sees what comes later.
    if (duration > 0.0 && builder.time() > duration) break;
  }

  const DriveClock clock(disturbances, builder.time(), duration);
  std::vector<SE3d> poses;
  const auto count = static_cast<std::size_t>(std::llround(clock.duration() / kStep)) + 1;
  poses.reserve(count);
  for (std::size_t i = 0; i < count; ++i) {
    const double t = kStep * static_cast<double>(i);
    poses.push_back(builder.pose(clock.driven(t)) * shaken(disturbances, t));
  }

  Drive drive{PoseSpline(std::move(poses), kStep), {}, {}};
  const double end = clock.duration();
  for (const DriveDisturbance& d : disturbances) {
    WheelEpisode episode;
    episode.begin = d.begin, episode.end = d.end;
    if (d.begin >= end) continue;
    switch (d.kind) {
      case DriveDisturbance::Kind::slip:
        episode.grip_left = d.left ? d.grip : 1.0, episode.grip_right = d.right ? d.grip : 1.0;
        drive.episodes.push_back(episode);
        drive.events.push_back({"wheel_slip", d.begin, std::min(d.end, end),
                                fmt::format("{} slipping, moved over rolled {:.2f}",
                                            d.left && d.right ? "both wheels"
                                            : d.left          ? "left wheel"
                                                              : "right wheel",
                                            d.grip)});
        break;
      case DriveDisturbance::Kind::free_spin:
        episode.kind = WheelEpisode::Kind::free;
        episode.speed_left = d.speed_left, episode.speed_right = d.speed_right;
        drive.episodes.push_back(episode);
        drive.events.push_back({"free_spin", d.begin, std::min(d.end, end),
                                fmt::format("wheels turn at {:.2f} and {:.2f} m/s, the robot stands",
                                            d.speed_left, d.speed_right)});
        break;
      case DriveDisturbance::Kind::bump:
        drive.events.push_back(
            {"bump", d.begin, std::min(d.begin + kBumpDuration, end), "thrown back and shaken"});
        break;
    }
  }
  for (const TimedEvent& event : builder.events()) {
    const double begin = clock.when(event.begin);
    if (begin >= end) continue;
    const double until = std::min(clock.when(event.end), end);
    drive.events.push_back({event.kind, begin, until, event.note});
    if (event.kind != "lifted") continue;
    // In the air the wheels run on for a while, then rest.
    WheelEpisode still;
    still.kind = WheelEpisode::Kind::free;
    still.begin = begin, still.end = until, still.ramp = 0.02;
    drive.episodes.push_back(still);
    WheelEpisode spin = still;
    spin.begin = begin + 0.1, spin.end = std::min(begin + 1.7, until), spin.ramp = 0.2;
    spin.speed_left = spin.speed_right = robot.speed;
    if (spin.end > spin.begin + 0.1) drive.episodes.push_back(spin);
  }
  observe(scene, plan, drive);
  std::stable_sort(drive.events.begin(), drive.events.end(),
                   [](const TimedEvent& a, const TimedEvent& b) { return a.begin < b.begin; });
  return drive;
}

}  // namespace sweepkit
