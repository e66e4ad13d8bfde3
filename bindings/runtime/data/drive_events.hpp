// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>
#include <vector>

#include "sweepkit/data/drive.hpp"

namespace sweepkit {

inline constexpr double kBumpDuration = 0.9;  // [s]

/// How far a robot has come with its script after a time, where slipping wheels slow it, hanging stops it and
/// bumps throw it back.
class DriveClock {
 public:
  /// @param script how long the script takes undisturbed [s]
  /// @param duration of the recording; 0: until the script is done and one second more
  /// @throws Error(data) that names the place of a disturbance with wrong times
  DriveClock(std::span<const DriveDisturbance> disturbances, double script, double duration);

  double duration() const { return duration_; }  ///< of the recording [s]
  double driven(double t) const;                 ///< time of the script at a time of the recording
  double when(double script) const;              ///< the first time of the recording that this happens at

 private:
  static constexpr double kStep = 0.001;
  double duration_;
  std::vector<double> driven_;
};

/// What bumps add to the pose at a time of the recording, in the base's own frame.
SE3d shaken(std::span<const DriveDisturbance> disturbances, double t);

/// Adds what can be seen from the motion alone: standstill, turn_in_place, on_carpet, door_passage, revisit.
void observe(const Scene& scene, const FloorPlan& plan, Drive& drive);

}  // namespace sweepkit
