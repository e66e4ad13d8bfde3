// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <limits>
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
  std::vector<float> disparities_;  // of a row's points
};

namespace impl {

inline ChosenLabels chosen_labels(CloudLabels labels) {
  ChosenLabels chosen;
  const auto set = [&](FloorLabel label, bool wanted) {
    chosen.of_label[static_cast<int>(label)] = wanted ? -1 : 0;
  };
  set(FloorLabel::floor, labels.floor);
  set(FloorLabel::obstacle, labels.obstacle);
  set(FloorLabel::hole, labels.hole);
  return chosen;
}

template <DisparityPixel D>
inline CloudRow cloud_row(const RectifiedCamera& camera, int v) {
  return {static_cast<float>(camera.baseline) / kDisparityUnit<D>, static_cast<float>(camera.focal),
          static_cast<float>(camera.cx), static_cast<float>(v - camera.cy)};
}

}  // namespace impl

template <DisparityPixel D>
void OrganisedCloud::build(View2d<const D> disparity, const RectifiedCamera& camera,
                           const FloorDisparity& floor, const FloorTolerance& tolerance, CloudLabels labels) {
  const int width = std::max(disparity.width, 0), height = std::max(disparity.height, 0);
  mask_.resize(width, height);
  for (auto& plane : planes_) plane.resize(width, height);
  const impl::FloorRows floor_rows(floor, tolerance, kDisparityUnit<D>);
  const impl::ChosenLabels chosen = impl::chosen_labels(labels);
  for (int v = 0; v < height; ++v)
    impl::planes_row(disparity.row(v), width, floor_rows.row(v), impl::cloud_row<D>(camera, v), chosen,
                     mask_.row(v), {planes_[0].row(v), planes_[1].row(v), planes_[2].row(v)});
}

template <DisparityPixel D>
void PointList::build(View2d<const D> disparity, const RectifiedCamera& camera, const FloorDisparity& floor,
                      const FloorTolerance& tolerance, CloudLabels labels) {
  const int width = std::max(disparity.width, 0), height = std::max(disparity.height, 0);
  const std::size_t room =
      static_cast<std::size_t>(width) * static_cast<std::size_t>(height) + impl::kPointSlack;
  require(room <= std::numeric_limits<std::int32_t>::max(), "PointList::build disparity",
          "is too large to number its pixels", room);
  mask_.resize(width, height);
  if (points_.size() < room) {
    points_.resize(room);
    pixels_.resize(room);
  }
  disparities_.resize(static_cast<std::size_t>(width) + impl::kPointSlack);
  const impl::FloorRows floor_rows(floor, tolerance, kDisparityUnit<D>);
  const impl::ChosenLabels chosen = impl::chosen_labels(labels);
  size_ = 0;
  for (int v = 0; v < height; ++v)
    size_ += impl::points_row(disparity.row(v), width, floor_rows.row(v), impl::cloud_row<D>(camera, v),
                              chosen, v * width, mask_.row(v), disparities_.data(), pixels_.data() + size_,
                              points_.data()->data() + 3 * size_);
}

}  // namespace sweepkit
