// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "sweepkit/core/options.hpp"
#include "sweepkit/data/floor_plan.hpp"
#include "sweepkit/data/pose_spline.hpp"
#include "sweepkit/data/scene.hpp"
#include "sweepkit/data/wheel_simulation.hpp"

namespace sweepkit {

// How a robot goes through a flat. Its base frame: x forward, y left, z up, on the floor in the middle
// between the drive wheels. Lengths in m, angles in rad unless said otherwise, times in s.

/// The body of the robot and what its drive can do.
struct RobotOptions {
  double radius = 0.17;
  double margin = 0.02;
  double contact_track = 0.235;
  double caster = 0.11;
  double speed = 0.3;
  double turn_rate_deg = 75.0;
  double acceleration = 0.5;
  double turn_acceleration_deg = 240.0;
  double corner = 0.35;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(radius, "radius", "m", range(0.02, 1.0), "of the robot's outline about its base");
    v(margin, "margin", "m", range(0.0, 0.5), "kept free beside it where it plans its own way");
    v(contact_track, "contact_track", "m", range(0.01, 2.0), "distance of the points where its wheels stand");
    v(caster, "caster", "m", range(0.01, 1.0), "distance from the drive axle forward to the castor wheel");
    v(speed, "speed", "m/s", range(0.01, 3.0), "at most, along its way");
    v(turn_rate_deg, "turn_rate_deg", "deg/s", range(1.0, 720.0), "at most");
    v(acceleration, "acceleration", "m/s^2", range(0.01, 20.0), "at most, along its way");
    v(turn_acceleration_deg, "turn_acceleration_deg", "deg/s^2", range(1.0, 5000.0), "at most, on the spot");
    v(corner, "corner", "m", range(0.0, 2.0),
      "a corner of its way is rounded from so far before it to so far behind it; 0: it stops and turns");
  }
};

/// One thing to do.
struct DriveStep {
  enum class Kind {
    stand,        ///< for `seconds`
    drive,        ///< through `points`, corners rounded; refused where something stands in the way
    go,           ///< to the last of `points`, on a way it finds itself; then to `yaw`, if given
    back,         ///< `length` backwards
    turn,         ///< by `angle` on the spot, positive to the left
    turn_to,      ///< to `yaw` of the world
    lanes,        ///< over the room called `room`, `spacing` apart, for at most `seconds`
    follow_wall,  ///< with the wall to the right, `distance` from it, along `length`
    face_wall,    ///< up to `wall` of `room`, `along` from its first corner, `distance` before it; dwell
                  ///< `seconds`
    carry,        ///< lifted by `height` and put down at the last of `points` with `yaw` after `seconds`;
                  ///< without points anywhere it could have driven to, with any heading
    cover,        ///< lanes over all rooms, for at most `seconds`
    home,         ///< back to the start and to its heading
  };
  Kind kind = Kind::stand;
  std::string place;     ///< where it is written, for errors: "file:line: path"
  double seconds = 0.0;  ///< 0 for lanes and cover: until done
  double length = 0.0;
  double angle = 0.0;
  std::optional<double> yaw;  ///< in the world
  double spacing = 0.25;
  double distance = 0.25;
  double height = 0.5;
  std::vector<Vec2<double>> points;  ///< in the world
  std::string room;
  int wall = 0;
  double along = 0.0;
};

/// What a robot does. Without steps it stands for 2 s, covers all rooms and comes home.
struct DriveScript {
  std::optional<Vec2<double>> start;  ///< in the world; a free spot of the first room if not given
  double yaw = 0.0;                   ///< at the start, in the world
  std::vector<DriveStep> steps;
  std::string place;  ///< where it is written, for errors
};

/// What happens to the robot at a given time.
struct DriveDisturbance {
  enum class Kind {
    slip,       ///< wheels roll farther than the robot moves: it moves `grip` times as far
    free_spin,  ///< the robot hangs; its wheels turn at `speed_left` and `speed_right`
    bump,       ///< it runs into something that gives way: thrown back, shaken, then on
  };
  Kind kind = Kind::slip;
  double begin = 0.0;  ///< [s] from the beginning of the recording
  double end = 0.0;    ///< [s]
  double grip = 0.12;  ///< slip
  bool left = true;    ///< slip: which wheels; of one alone the robot keeps its way and pace
  bool right = true;
  double speed_left = 0.3;   ///< free_spin [m/s]
  double speed_right = 0.3;  ///< free_spin [m/s]
  double strength = 1.0;     ///< bump: 1 shakes by 0.6 degrees
  std::string place;         ///< where it is written, for errors
};

/// A span of time worth knowing, as truth.yaml lists them.
struct TimedEvent {
  std::string kind;
  double begin = 0.0;  ///< [s] from the beginning of the recording
  double end = 0.0;    ///< [s]
  std::string note;
};

/// A drive as it happened.
struct Drive {
  PoseSpline base;                     ///< T_world_base over time, from the beginning of the recording
  std::vector<WheelEpisode> episodes;  ///< when wheels do not roll as the base moves
  /// standstill, turn_in_place, on_carpet, door_passage, revisit, bare_wall, lifted, wheel_slip, free_spin,
  /// bump
  std::vector<TimedEvent> events;
};

/// Works a script out. On the floor the robot never moves sideways: it goes along smooth curves and turns;
/// height, pitch and roll are those of a plane through its wheels and castor on the floor's height. The
/// spline has a knot each 10 ms.
/// @param duration of the recording [s]; 0: until the script is done and one second more. A script that is
///   longer is cut off, after a shorter one the robot stands
/// @param seed of what is left to chance: start, order and direction of lanes, where it is put down
/// @throws Error(data) that names place and position: a start or way through furniture, a goal that cannot be
///   reached, unknown rooms; Error(option) for options out of range
Drive make_drive(const Scene& scene, const FloorPlan& plan, const RobotOptions& robot,
                 const DriveScript& script, std::span<const DriveDisturbance> disturbances = {},
                 double duration = 0.0, std::uint64_t seed = 1);

}  // namespace sweepkit
