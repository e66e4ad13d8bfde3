// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/image/rectify.hpp"

#include <fmt/format.h>

#include <limits>
#include <opencv2/imgproc.hpp>

#include "sweepkit/core/error.hpp"

namespace sweepkit {

namespace {

GrayView view_of(const cv::Mat& m) { return {m.data, m.cols, m.rows, static_cast<std::ptrdiff_t>(m.step)}; }

}  // namespace

struct StereoRectifier::Maps {
  struct Eye {
    cv::Mat position, fraction;  // OpenCV's fixed-point maps; empty if nothing changes
    cv::Mat image, seen;
  };

  StereoRig rig;
  RectifiedCamera camera;
  cv::Size size;
  Eye eyes[2];

  explicit Maps(const StereoRig& rig)
      : rig(rig),
        camera(rectified_camera(rig)),
        size(rig.camera(Side::left).width(), rig.camera(Side::left).height()) {
    for (const Side side : {Side::left, Side::right}) {
      Eye& eye = eyes[static_cast<int>(side)];
      const int width = rig.camera(side).width(), height = rig.camera(side).height();
      if (rig.is_rectified() && cv::Size(width, height) == size) {
        eye.seen = cv::Mat(size, CV_8U, cv::Scalar(255));
        continue;
      }
      cv::Mat map(size, CV_32FC2);
      eye.seen.create(size, CV_8U);
      for (int v = 0; v < size.height; ++v)
        for (int u = 0; u < size.width; ++u) {
          const auto p = rig.unrectify(side, Vec2<double>(u, v));
          const bool inside = p && p->x() >= 0 && p->y() >= 0 && p->x() <= width - 1 && p->y() <= height - 1;
          // Outside, a place that no neighbour reaches into.
          map.at<cv::Vec2f>(v, u) =
              inside ? cv::Vec2f(static_cast<float>(p->x()), static_cast<float>(p->y())) : cv::Vec2f(-9, -9);
          eye.seen.at<std::uint8_t>(v, u) = inside ? 255 : 0;
        }
      cv::convertMaps(map, cv::noArray(), eye.position, eye.fraction, CV_16SC2);
    }
  }

  void rectify(Side side, GrayView raw) {
    const Camera& camera = rig.camera(side);
    if (raw.width != camera.width() || raw.height != camera.height() || !raw.data)
      throw Error(ErrorKind::argument,
                  fmt::format("StereoRectifier::rectify {}", side == Side::left ? "left" : "right"),
                  fmt::format("the camera's images have {}x{} px", camera.width(), camera.height()),
                  fmt::format("{}x{} px", raw.width, raw.height));
    Eye& eye = eyes[static_cast<int>(side)];
    const cv::Mat source(raw.height, raw.width, CV_8U, const_cast<std::uint8_t*>(raw.data),
                         static_cast<std::size_t>(raw.stride));
    if (eye.position.empty())
      source.copyTo(eye.image);
    else
      cv::remap(source, eye.image, eye.position, eye.fraction, cv::INTER_LINEAR, cv::BORDER_CONSTANT);
  }
};

StereoRectifier::StereoRectifier(const StereoRig& rig) : maps_(std::make_unique<Maps>(rig)) {}
StereoRectifier::~StereoRectifier() = default;
StereoRectifier::StereoRectifier(StereoRectifier&&) noexcept = default;
StereoRectifier& StereoRectifier::operator=(StereoRectifier&&) noexcept = default;

const StereoRig& StereoRectifier::rig() const { return maps_->rig; }
const RectifiedCamera& StereoRectifier::camera() const { return maps_->camera; }
int StereoRectifier::width() const { return maps_->size.width; }
int StereoRectifier::height() const { return maps_->size.height; }

void StereoRectifier::rectify(GrayView left, GrayView right) {
  maps_->rectify(Side::left, left);
  maps_->rectify(Side::right, right);
}

GrayView StereoRectifier::image(Side side) const {
  return view_of(maps_->eyes[static_cast<int>(side)].image);
}
GrayView StereoRectifier::seen(Side side) const { return view_of(maps_->eyes[static_cast<int>(side)].seen); }

}  // namespace sweepkit
