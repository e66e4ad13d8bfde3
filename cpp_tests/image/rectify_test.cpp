// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/image/rectify.hpp"

#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>

#include "image/random_image.hpp"
#include "sweepkit/core/error.hpp"
#include "sweepkit/image/image.hpp"

using namespace sweepkit;

namespace {

StereoRig distorted_rig() {
  const Camera left({150, 149, 95, 61}, Distortion::radial_tangential, {-0.28, 0.07, 0.0002, 0.00002}, 192,
                    120);
  const Camera right({149, 150, 97, 58}, Distortion::radial_tangential, {-0.285, 0.075, -0.0001, 0.0001}, 192,
                     120);
  return StereoRig(left, right, SE3d(),
                   SE3d(SO3d::exp(Vec3<double>(0.006, -0.012, 0.014)), {0.06, 0.001, -0.002}));
}

double smooth(double x, double y) {
  return 128 + 60 * std::sin(0.11 * x + 0.3) + 50 * std::cos(0.09 * y + 0.04 * x);
}

GrayImage smooth_image(int width, int height) {
  GrayImage image(width, height);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) image(x, y) = static_cast<std::uint8_t>(std::lround(smooth(x, y)));
  return image;
}

}  // namespace

TEST_CASE("A rectified image shows at each pixel what the raw one shows at its unrectified place") {
  const StereoRig rig = distorted_rig();
  const GrayImage raw = smooth_image(192, 120);
  StereoRectifier rectifier(rig);
  rectifier.rectify(raw, raw);
  CHECK(rectifier.width() == 192);
  CHECK(rectifier.height() == 120);
  for (const Side side : {Side::left, Side::right}) {
    const GrayView image = rectifier.image(side), seen = rectifier.seen(side);
    int count = 0;
    for (int v = 0; v < 120; ++v)
      for (int u = 0; u < 192; ++u) {
        const auto p = rig.unrectify(side, Vec2<double>(u, v));
        const bool inside = p && p->x() >= 0 && p->y() >= 0 && p->x() <= 191 && p->y() <= 119;
        CHECK_FALSE(seen(u, v) != (inside ? 255 : 0));
        // Half a grey level of the raw image, one of the result, and weights of five bits.
        if (inside) CHECK_FALSE(std::abs(image(u, v) - smooth(p->x(), p->y())) > 1.8);
        if (!inside) CHECK_FALSE(image(u, v) != 0);
        count += inside;
      }
    CHECK(count > 192 * 120 * 8 / 10);
  }
}

TEST_CASE("The rectified camera is that of the rig") {
  const StereoRig rig = distorted_rig();
  const RectifiedCamera camera = StereoRectifier(rig).camera();
  const auto projected = rig.project_stereo(Vec3<double>(0.1, 0.05, 0.7));
  const auto p = camera.project_stereo(Vec3<double>(0.1, 0.05, 0.7));
  REQUIRE(projected);
  REQUIRE(p);
  CHECK((*p - Vec3<double>(projected->x(), projected->y(), projected->x() - projected->z())).norm() < 1e-9);
}

TEST_CASE("A rig that is rectified gives the images as they are") {
  const Camera camera({150, 150, 95, 61}, Distortion::none, {}, 192, 120);
  const StereoRig rig(camera, camera, SE3d(), SE3d(SO3d(), {0.06, 0, 0}));
  REQUIRE(rig.is_rectified());
  const GrayImage left = random_image(192, 120, 1), right = random_image(192, 120, 2);
  StereoRectifier rectifier(rig);
  CHECK(rectifier.image(Side::left).empty());
  rectifier.rectify(left, right);
  for (int v = 0; v < 120; ++v) {
    CHECK(std::equal(left.row(v), left.row(v) + 192, rectifier.image(Side::left).row(v)));
    CHECK(std::equal(right.row(v), right.row(v) + 192, rectifier.image(Side::right).row(v)));
    CHECK(std::count(rectifier.seen(Side::left).row(v), rectifier.seen(Side::left).row(v) + 192, 255) == 192);
  }
}

TEST_CASE("Images of another size than their camera's are refused with both sizes") {
  StereoRectifier rectifier(distorted_rig());
  const GrayImage right_size(192, 120), wrong(191, 120);
  CHECK_THROWS_WITH(rectifier.rectify(wrong, right_size),
                    Catch::Contains("192x120") && Catch::Contains("191x120"));
  CHECK_THROWS_WITH(rectifier.rectify(right_size, wrong),
                    Catch::Contains("right") && Catch::Contains("191x120"));
  CHECK_THROWS_AS(rectifier.rectify({}, {}), Error);
}
