// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

#include "sweepkit/data/simulate.hpp"

namespace sweepkit {

/// When a recording begins [ns]: no clock is asked, so that files do not depend on the hour.
inline constexpr TimeNs kSimulationBegin = 1'700'000'000 * kNsPerSecond;

/// Texts of the small files of a simulated recording.
std::string camera_yaml(const SimulatedScene& scene, const SimulatedSensors& sensors, Side side);
std::string imu_yaml(const SimulatedScene& scene, const ImuSimulationOptions& imu);
std::string wheels_yaml(const SimulatedScene& scene, const SimulatedSensors& sensors);
std::string depth_yaml(int every);
std::string truth_yaml(const SimulatedScene& scene, const SimulationOptions& options, const Drive& drive,
                       const std::vector<TimedEvent>& events, int frames, double first_frame);

/// Length of the base's way [m], without what it was carried.
double driven_length(const Drive& drive);

}  // namespace sweepkit
