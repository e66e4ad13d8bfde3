// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cstdint>
#include <cstdio>

#include "sweepkit/sweepkit.hpp"

int main() {
  using namespace sweepkit;
  const Camera camera({300.0, 300.0, 319.5, 199.5}, Distortion::none, {}, 640, 400);
  const StereoRig rig(camera, camera, SE3d(), SE3d(SO3d(), {0.06, 0.0, 0.0}));
  Sweeper robot(rig);
  const NewGray blank = make_gray(640, 400);
  std::fill_n(blank.pixels.data, 640 * 400, std::uint8_t{128});
  robot.feed(StereoImage{0, blank.image, blank.image});
  robot.finish();
  std::printf("runtime: sweepkit %s took %d image\n", version().c_str(),
              static_cast<int>(robot.counts().images));
  return robot.counts().images == 1 ? 0 : 1;
}
