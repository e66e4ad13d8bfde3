// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

// The umbrella: what a user of the runtime and of the blocks needs. It pulls in Eigen and the standard
// library, nothing heavier.
#include "sweepkit/core/error.hpp"
#include "sweepkit/core/ids.hpp"
#include "sweepkit/core/options.hpp"
#include "sweepkit/core/random.hpp"
#include "sweepkit/core/sample.hpp"
#include "sweepkit/core/time.hpp"
#include "sweepkit/core/view.hpp"
#include "sweepkit/geometry/camera.hpp"
#include "sweepkit/geometry/se3.hpp"
#include "sweepkit/geometry/so3.hpp"
#include "sweepkit/geometry/stereo_rig.hpp"
#include "sweepkit/map/map.hpp"
