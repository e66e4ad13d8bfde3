// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "sweepkit/floor/obstacle_mask.hpp"
#include "sweepkit/geometry/rectified_camera.hpp"
#include "sweepkit/image/image.hpp"

namespace sweepkit {

/// The labels whose pixels become points.
struct CloudLabels {
  bool obstacle = true;
  bool hole = false;
  bool floor = false;
};

/// Mask and organised cloud: the point of pixel (u, v) stands at (u, v) of three images of coordinates in the
/// rectified left camera's frame [m], NaN where the pixel is not chosen. Keeps its memory. Not thread-safe.
class OrganisedCloud {
 public:
  /// @param labels which pixels become points
  template <DisparityPixel D>
  void build(View2d<const D> disparity, const RectifiedCamera& camera, const FloorDisparity& floor,
             const FloorTolerance& tolerance, CloudLabels labels = {});

  GrayView mask() const { return mask_.view(); }  ///< a FloorLabel a pixel
  View2d<const float> x() const { return planes_[0].view(); }
  View2d<const float> y() const { return planes_[1].view(); }
  View2d<const float> z() const { return planes_[2].view(); }

 private:
  GrayImage mask_;
  Image<float> planes_[3];
};

/// Mask and the points of the chosen pixels as a list, row by row. Keeps its memory. Not thread-safe.
class PointList {
 public:
  /// @param labels which pixels become points
  template <DisparityPixel D>
  void build(View2d<const D> disparity, const RectifiedCamera& camera, const FloorDisparity& floor,
             const FloorTolerance& tolerance, CloudLabels labels = {});

  GrayView mask() const { return mask_.view(); }  ///< a FloorLabel a pixel
  std::size_t size() const { return size_; }
  /// In the rectified left camera's frame [m].
  std::span<const Vec3<float>> points() const { return {points_.data(), size_}; }
  /// v * width + u of each point.
  std::span<const std::int32_t> pixels() const { return {pixels_.data(), size_}; }

 private:
  GrayImage mask_;
  std::size_t size_ = 0;
  std::vector<Vec3<float>> points_;
  std::vector<std::int32_t> pixels_;
};

namespace impl {

inline bool is_chosen(FloorLabel label, CloudLabels chosen) {
  return (label == FloorLabel::obstacle && chosen.obstacle) || (label == FloorLabel::hole && chosen.hole) ||
         (label == FloorLabel::floor && chosen.floor);
}

}  // namespace impl

template <DisparityPixel D>
void OrganisedCloud::build(View2d<const D> disparity, const RectifiedCamera& camera,
                           const FloorDisparity& floor, const FloorTolerance& tolerance, CloudLabels labels) {
  mask_.resize(disparity.width, disparity.height);
  for (auto& plane : planes_) plane.resize(disparity.width, disparity.height);
  obstacle_mask(disparity, floor, tolerance, mask_.view());
  const float baseline = static_cast<float>(camera.baseline), focal = static_cast<float>(camera.focal);
  for (int v = 0; v < disparity.height; ++v)
    for (int u = 0; u < disparity.width; ++u) {
      const bool chosen = impl::is_chosen(static_cast<FloorLabel>(mask_(u, v)), labels);
      const float scale =
          chosen ? baseline / impl::disparity_px(disparity(u, v)) : std::numeric_limits<float>::quiet_NaN();
      planes_[0](u, v) = scale * (static_cast<float>(u) - static_cast<float>(camera.cx));
      planes_[1](u, v) = scale * (static_cast<float>(v) - static_cast<float>(camera.cy));
      planes_[2](u, v) = scale * focal;
    }
}

template <DisparityPixel D>
void PointList::build(View2d<const D> disparity, const RectifiedCamera& camera, const FloorDisparity& floor,
                      const FloorTolerance& tolerance, CloudLabels labels) {
  mask_.resize(disparity.width, disparity.height);
  obstacle_mask(disparity, floor, tolerance, mask_.view());
  const float baseline = static_cast<float>(camera.baseline), focal = static_cast<float>(camera.focal);
  points_.clear();
  pixels_.clear();
  for (int v = 0; v < disparity.height; ++v)
    for (int u = 0; u < disparity.width; ++u) {
      if (!impl::is_chosen(static_cast<FloorLabel>(mask_(u, v)), labels)) continue;
      const float scale = baseline / impl::disparity_px(disparity(u, v));
      points_.emplace_back(scale * (static_cast<float>(u) - static_cast<float>(camera.cx)),
                           scale * (static_cast<float>(v) - static_cast<float>(camera.cy)), scale * focal);
      pixels_.push_back(v * disparity.width + u);
    }
  size_ = points_.size();
}

}  // namespace sweepkit
