// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/floor/obstacle_cloud.hpp"

#include <bit>
#include <catch2/catch.hpp>
#include <cmath>
#include <cstring>

#include "floor/random_disparities.hpp"
#include "sweepkit/core/simd.hpp"

using namespace sweepkit;

namespace {

const FloorTolerance kTolerance{1.2, 0.03, 0.1, 0.08};

bool chosen(std::uint8_t label, CloudLabels labels) {
  switch (static_cast<FloorLabel>(label)) {
    case FloorLabel::floor:
      return labels.floor;
    case FloorLabel::obstacle:
      return labels.obstacle;
    case FloorLabel::hole:
      return labels.hole;
    case FloorLabel::unknown:
      return false;
  }
  return false;
}

const CloudLabels kChoices[] = {
    {}, {true, true, true}, {false, true, false}, {false, false, true}, {false, false, false}};

}  // namespace

TEMPLATE_TEST_CASE("An organised cloud has the points of the chosen pixels and no others", "", float,
                   std::int16_t) {
  const FloorDisparity floor = tilted_floor().disparity(kFloorCamera);
  const int width = GENERATE(640, 1, 7, 8, 33, 45), height = 237;
  const CloudLabels labels = GENERATE(from_range(std::begin(kChoices), std::end(kChoices)));
  const Image<TestType> d = random_disparities<TestType>(width, height, floor, 5);
  OrganisedCloud fast, portable;
  fast.build<TestType>(d, kFloorCamera, floor, kTolerance, labels);
  {
    const ScopedSimdLevel level(SimdLevel::portable);
    portable.build<TestType>(d, kFloorCamera, floor, kTolerance, labels);
  }
  GrayImage mask(width, height);
  obstacle_mask<TestType>(d, floor, kTolerance, mask.view());
  const View2d<const float> planes[2][3] = {{fast.x(), fast.y(), fast.z()},
                                            {portable.x(), portable.y(), portable.z()}};
  int differ = 0, wrong = 0;
  for (int v = 0; v < height; ++v)
    for (int u = 0; u < width; ++u) {
      differ += fast.mask()(u, v) != mask(u, v) || portable.mask()(u, v) != mask(u, v);
      for (int i = 0; i < 3; ++i)
        differ += std::bit_cast<std::uint32_t>(planes[0][i](u, v)) !=
                  std::bit_cast<std::uint32_t>(planes[1][i](u, v));
      const Vec3<double> p(planes[0][0](u, v), planes[0][1](u, v), planes[0][2](u, v));
      if (!chosen(mask(u, v), labels)) {
        wrong += !(std::isnan(p.x()) && std::isnan(p.y()) && std::isnan(p.z()));
        continue;
      }
      const double px = d(u, v) * double(kDisparityUnit<TestType>);
      const auto expected = kFloorCamera.back_project(u, v, px, 0, 0);
      wrong += !expected || !((p - expected->p_camera).norm() <= 2e-6 * expected->p_camera.norm() + 1e-30);
    }
  CHECK(differ == 0);
  CHECK(wrong == 0);
}

TEMPLATE_TEST_CASE("A list has the points of the organised cloud, row by row", "", float, std::int16_t) {
  const FloorDisparity floor = tilted_floor().disparity(kFloorCamera);
  const int width = GENERATE(640, 1, 7, 8, 33, 45), height = 237;
  const CloudLabels labels = GENERATE(from_range(std::begin(kChoices), std::end(kChoices)));
  const Image<TestType> d = random_disparities<TestType>(width, height, floor, 6);
  OrganisedCloud organised;
  organised.build<TestType>(d, kFloorCamera, floor, kTolerance, labels);
  PointList fast, portable;
  fast.build<TestType>(d, kFloorCamera, floor, kTolerance, labels);
  {
    const ScopedSimdLevel level(SimdLevel::portable);
    portable.build<TestType>(d, kFloorCamera, floor, kTolerance, labels);
  }
  for (const PointList* list : {&fast, &portable}) {
    std::size_t count = 0;
    int wrong = 0;
    for (int v = 0; v < height; ++v)
      for (int u = 0; u < width; ++u) {
        wrong += list->mask()(u, v) != organised.mask()(u, v);
        if (std::isnan(organised.z()(u, v))) continue;
        REQUIRE(count < list->size());
        const float expected[] = {organised.x()(u, v), organised.y()(u, v), organised.z()(u, v)};
        wrong += std::memcmp(list->points()[count].data(), expected, sizeof expected) != 0;
        wrong += list->pixels()[count] != v * width + u;
        ++count;
      }
    CHECK(wrong == 0);
    CHECK(count == list->size());
  }
}

TEST_CASE("Clouds keep no points of the image before, and take images of any size") {
  const FloorDisparity floor = tilted_floor().disparity(kFloorCamera);
  OrganisedCloud cloud;
  PointList list;
  for (const auto& [width, height] : {std::pair{300, 200}, {64, 300}, {0, 0}, {301, 222}}) {
    const Image<float> d = random_disparities<float>(width, height, floor, 7);
    OrganisedCloud fresh;
    PointList fresh_list;
    cloud.build<float>(d, kFloorCamera, floor, kTolerance);
    fresh.build<float>(d, kFloorCamera, floor, kTolerance);
    list.build<float>(d, kFloorCamera, floor, kTolerance);
    fresh_list.build<float>(d, kFloorCamera, floor, kTolerance);
    REQUIRE(cloud.z().width == width);
    REQUIRE(cloud.z().height == height);
    int differ = 0;
    for (int v = 0; v < height; ++v)
      differ += std::memcmp(cloud.z().row(v), fresh.z().row(v), sizeof(float) * width) != 0;
    CHECK(differ == 0);
    REQUIRE(list.size() == fresh_list.size());
    CHECK(std::equal(list.points().begin(), list.points().end(), fresh_list.points().begin()));
  }
}
