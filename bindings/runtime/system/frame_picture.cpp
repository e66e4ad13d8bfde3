// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/system/frame_picture.hpp"

#include "canvas.hpp"

namespace sweepkit {
namespace {

constexpr Color kTracked{40, 230, 60}, kStereo{255, 150, 30}, kAlone{150, 150, 150};

}  // namespace

void write_frame_picture(const std::filesystem::path& file, const StereoRig& rig, GrayView left,
                         const StereoFrame& frame) {
  Canvas canvas(left);
  // Tracked points last, so that nothing hides them.
  for (const bool tracked : {false, true})
    for (std::size_t i = 0; i < frame.measurements.size(); ++i) {
      const Measurement& m = frame.measurements[i];
      if ((i < frame.points.size() && frame.points[i].valid()) != tracked) continue;
      const auto pixel = rig.unrectify_fast(Side::left, {m.u, m.v});
      if (!pixel) continue;
      if (tracked)
        canvas.circle(pixel->x(), pixel->y(), 2.5 + m.octave, kTracked);
      else
        canvas.dot(pixel->x(), pixel->y(), m.stereo() ? kStereo : kAlone);
    }
  canvas.write(file);
}

}  // namespace sweepkit
