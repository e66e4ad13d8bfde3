// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <memory>

#include "sweepkit/core/view.hpp"
#include "sweepkit/geometry/rectified_camera.hpp"
#include "sweepkit/geometry/stereo_rig.hpp"

namespace sweepkit {

/// The rectified left camera that a rig stands for.
inline RectifiedCamera rectified_camera(const StereoRig& rig) {
  return {rig.focal(), rig.center().x(), rig.center().y(), rig.baseline()};
}

/// Rectifies whole images of a stereo pair, for dense matching; everything else rectifies points only.
///
/// A rectified image has the size of the raw left one, and its pixel (u, v) is the rectified position (u, v)
/// of StereoRig: dense and sparse measurements share one camera. What the rectified image cuts off at its
/// borders is left out, what no raw pixel fills is 0. Bilinear, in fixed point (weights of 5 bits).
/// The result depends on the images alone. Allocates nothing after the first pair. Not thread-safe.
class StereoRectifier {
 public:
  explicit StereoRectifier(const StereoRig& rig);
  ~StereoRectifier();
  StereoRectifier(StereoRectifier&&) noexcept;
  StereoRectifier& operator=(StereoRectifier&&) noexcept;

  const StereoRig& rig() const;
  /// The camera of the rectified left image.
  const RectifiedCamera& camera() const;
  int width() const;   ///< of the rectified images [px]
  int height() const;  ///< of the rectified images [px]

  /// Rectifies a raw pair; a rig that is rectified already copies. Throws Error(argument), naming both sizes,
  /// unless the images have the sizes of their cameras.
  void rectify(GrayView left, GrayView right);
  /// The rectified image of a side of the last pair; empty before the first.
  GrayView image(Side side) const;
  /// 255 where the raw image of a side fills the rectified one, else 0.
  GrayView seen(Side side) const;

 private:
  struct Maps;
  std::unique_ptr<Maps> maps_;
};

}  // namespace sweepkit
