// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
// What comes of pairs that cannot be used: as the table "What cannot be used" of the floor's page says.
#include <catch2/catch.hpp>
#include <cstdlib>
#include <filesystem>
#include <functional>
#include <limits>
#include <string>
#include <vector>

#include "floor/synthetic_floor.hpp"
#include "sweepkit/core/error.hpp"
#include "sweepkit/core/random.hpp"
#include "sweepkit/data/recording.hpp"
#include "sweepkit/data/trajectory.hpp"
#include "sweepkit/floor/obstacle_detector.hpp"
#include "sweepkit/floor/obstacle_mask.hpp"
#include "sweepkit/image/image.hpp"

namespace {

using namespace sweepkit;
using namespace sweepkit::test;

constexpr int kWidth = 320, kHeight = 200;
const GroundPlane kFloor = plane_of(3.0, 0.0, 0.08);

StereoRig small_rig() {
  const Camera camera({173, 173, 159.5, 99.5}, Distortion::none, {}, kWidth, kHeight);
  return {camera, camera, SE3d(), SE3d(SO3d(), Vec3<double>(0.06, 0, 0))};
}
ObstacleDetector small_detector() {
  return ObstacleDetector(small_rig(), GroundPlaneSeed::from_height(kFloor.down_camera, kFloor.height));
}

GrayImage image_of(const std::function<int(int, int)>& value) {
  GrayImage image(kWidth, kHeight);
  for (int v = 0; v < kHeight; ++v)
    for (int u = 0; u < kWidth; ++u) image(u, v) = static_cast<std::uint8_t>(value(u, v));
  return image;
}
GrayView view(const GrayImage& image) { return image.view(); }

/// The floor with a fine texture that both images see, or anything else that is as far away at each row.
struct TexturedPair {
  GrayImage left{kWidth, kHeight}, right{kWidth, kHeight};

  /// @param disparity whole pixels, of row v
  TexturedPair(const std::function<double(int)>& disparity, int low, int high, std::uint64_t seed) {
    Random random(seed);
    std::vector<double> texture(static_cast<std::size_t>(kWidth) * 2);
    for (int v = 0; v < kHeight; ++v) {
      for (double& x : texture) x = random.uniform(low, high);
      const double d = disparity(v);
      for (int u = 0; u < kWidth; ++u) {
        left(u, v) = sample(texture, u);
        right(u, v) = sample(texture, u + d);
      }
    }
  }
  static std::uint8_t sample(const std::vector<double>& texture, double at) {
    const auto k = static_cast<std::size_t>(at / 2);
    const double part = at / 2 - static_cast<double>(k);
    return static_cast<std::uint8_t>((1 - part) * texture[k] + part * texture[k + 1]);
  }
};
TexturedPair floor_pair(std::uint64_t seed, int low = 20, int high = 235) {
  const FloorDisparity floor = kFloor.disparity({173, 159.5, 99.5, 0.06});
  return TexturedPair([floor](int v) { return std::max(0.0, floor(0, v)); }, low, high, seed);
}

int count(const ObstacleFrame& frame, FloorLabel label) {
  int n = 0;
  for (int v = 0; v < frame.mask.height; ++v)
    for (int u = 0; u < frame.mask.width; ++u) n += frame.mask(u, v) == static_cast<std::uint8_t>(label);
  return n;
}
int pixels(const ObstacleFrame& frame) { return frame.mask.width * frame.mask.height; }

/// Nothing is seen: neither floor nor obstacle, and the plane is the one that was known.
void check_blind(const ObstacleFrame& frame, const GroundPlane& known) {
  CHECK(frame.plane.state == GroundPlaneState::predicted);
  CHECK(frame.plane.reason == GroundPlaneReason::no_disparity);
  CHECK(count(frame, FloorLabel::unknown) == pixels(frame));
  CHECK(frame.obstacles.empty());
  CHECK((frame.plane.plane.down_camera - known.down_camera).norm() < 1e-3);
  CHECK(std::abs(frame.plane.plane.height - known.height) < 5e-4);
}

TEST_CASE("a textured floor is measured, so that what follows tests something") {
  ObstacleDetector detector = small_detector();
  for (int k = 1; k <= 3; ++k) {
    const TexturedPair pair = floor_pair(static_cast<std::uint64_t>(k));
    const ObstacleFrame& frame = detector.detect(k * 100'000'000LL, view(pair.left), view(pair.right));
    CHECK(frame.plane.measured());
    CHECK(count(frame, FloorLabel::floor) > pixels(frame) / 4);
    CHECK(frame.obstacles.empty());
  }
}

TEST_CASE("pairs without contrast show nothing, at the start and after a floor") {
  Random random(3);
  const std::vector<std::pair<std::string, GrayImage>> images = [&] {
    std::vector<std::pair<std::string, GrayImage>> made;
    made.emplace_back("black", image_of([](int, int) { return 0; }));
    made.emplace_back("constant", image_of([](int, int) { return 128; }));
    made.emplace_back("overexposed", image_of([](int, int) { return 255; }));
    made.emplace_back("dark with noise",
                      image_of([&](int, int) { return static_cast<int>(random.index(3)); }));
    made.emplace_back("shaded", image_of([](int, int v) { return v; }));
    return made;
  }();
  for (const bool after_floor : {false, true})
    for (const auto& [name, image] : images) {
      INFO(name << (after_floor ? " after a floor" : ""));
      ObstacleDetector detector = small_detector();
      GroundPlane known = kFloor;
      if (after_floor) {
        const TexturedPair pair = floor_pair(1);
        known = detector.detect(1, view(pair.left), view(pair.right)).plane.plane;
      }
      check_blind(detector.detect(100'000'000, view(image), view(image)), known);
    }
}

TEST_CASE("images that have nothing to do with each other give no floor") {
  Random random(4);
  const auto noise = [&](int, int) { return static_cast<int>(random.index(256)); };
  const GrayImage left = image_of(noise), right = image_of(noise);
  ObstacleDetector detector = small_detector();
  const ObstacleFrame& frame = detector.detect(1, view(left), view(right));
  CHECK_FALSE(frame.plane.measured());
  CHECK(count(frame, FloorLabel::floor) < pixels(frame) / 100);
  // Nor does an image whose partner is covered.
  const TexturedPair pair = floor_pair(5);
  const GrayImage covered = image_of([](int, int) { return 0; });
  const ObstacleFrame& alone = detector.detect(100'000'000, view(pair.left), view(covered));
  CHECK_FALSE(alone.plane.measured());
  CHECK(count(alone, FloorLabel::unknown) > 98 * pixels(alone) / 100);
  CHECK(alone.obstacles.empty());
}

TEST_CASE("a wall before the camera moves no plane and is no floor") {
  const TexturedPair wall([](int) { return 52.0; }, 20, 235, 6);  // 20 cm away
  ObstacleDetector detector = small_detector();
  const TexturedPair floor = floor_pair(1);
  const GroundPlane known = detector.detect(1, view(floor.left), view(floor.right)).plane.plane;
  for (int k = 1; k <= 10; ++k) {
    const ObstacleFrame& frame = detector.detect(k * 100'000'000LL, view(wall.left), view(wall.right));
    CHECK_FALSE(frame.plane.measured());
    CHECK((frame.plane.plane.down_camera - known.down_camera).norm() < 2e-3);
    CHECK(std::abs(frame.plane.plane.height - known.height) < 1e-3);
    CHECK(count(frame, FloorLabel::obstacle) > 10 * count(frame, FloorLabel::floor));
    CHECK_FALSE(frame.obstacles.empty());
  }
}

TEST_CASE("images of a wrong size, and none, are refused by name; the detector goes on") {
  ObstacleDetector detector = small_detector();
  const TexturedPair pair = floor_pair(1);
  const GrayImage small(kWidth - 1, kHeight);
  const auto message = [&](GrayView left, GrayView right) -> std::string {
    try {
      detector.detect(1, left, right);
    } catch (const Error& error) {
      CHECK(error.kind() == ErrorKind::argument);
      return error.what();
    }
    return "";
  };
  CHECK_THAT(message({}, {}), Catch::Contains("320x200"));
  CHECK_THAT(message(view(pair.left), {}), Catch::Contains("320x200"));
  CHECK_THAT(message(view(small), view(pair.right)), Catch::Contains("319x200"));
  CHECK_THAT(message(view(pair.left), view(small)), Catch::Contains("319x200"));
  CHECK(detector.detect(1, view(pair.left), view(pair.right)).plane.measured());
  CHECK_THROWS_AS(detector.detect(1, view(pair.left), view(pair.right)), Error);  // time stands still
}

TEST_CASE("holes and not-a-numbers in disparities are unknown, and a floor between them is found") {
  for (const double share : {0.5, 0.9, 0.999, 1.0}) {
    INFO(share);
    Random random(7);
    FloorImage image;
    image.add_plane(plane_of(3, 0, 0.08));
    const float nothing[] = {0, -1, std::numeric_limits<float>::quiet_NaN(),
                             std::numeric_limits<float>::infinity(), -std::numeric_limits<float>::infinity()};
    for (float& d : image.disparity)
      if (random.uniform() < share) d = nothing[random.index(std::size(nothing))];
    GroundPlaneEstimator estimator(kFloorCamera,
                                   GroundPlaneSeed::from_height(kFloor.down_camera, kFloor.height));
    const GroundPlaneResult result = estimator.estimate(image.view());
    CHECK(result.measured() == (share < 0.99));
    CHECK((result.plane.down_camera - kFloor.down_camera).norm() < 2e-3);
    CHECK(std::abs(result.plane.height - kFloor.height) < 5e-4);

    sweepkit::Image<std::uint8_t> mask(FloorImage::kWidth, FloorImage::kHeight);
    const FloorTolerance tolerance = FloorTolerance::of({}, result.plane, kFloorCamera);
    obstacle_mask(image.view(), result.plane.disparity(kFloorCamera), tolerance, mask.view());
    int wrong = 0;
    for (int v = 0; v < FloorImage::kHeight; ++v)
      for (int u = 0; u < FloorImage::kWidth; ++u) {
        const float d = image.view()(u, v);
        const bool known = d > 0 && std::isfinite(d);
        const auto label = static_cast<FloorLabel>(mask(u, v));
        wrong +=
            known ? label == FloorLabel::obstacle || label == FloorLabel::hole : label != FloorLabel::unknown;
      }
    CHECK(wrong == 0);
    ObstacleFinder finder;
    CHECK(finder.find(image.view(), std::as_const(mask).view(), kFloorCamera, result.plane).empty());
  }
}

TEST_CASE("before a bare wall the plane stays at the floor (sweephome)") {
  const char* data = std::getenv("SWEEPKIT_DATA");
  if (!data || !std::filesystem::exists(std::filesystem::path(data) / "sweephome/dev03")) {
    WARN("skipped: SWEEPKIT_DATA has no sweephome/dev03");
    return;
  }
  RecordingOptions reading;
  reading.start = 11.7;
  reading.duration = 3.0;
  const auto recording = open_recording(std::filesystem::path(data) / "sweephome/dev03", reading);
  const Rig& rig = recording->rig();
  const StereoRig stereo = rig.stereo();
  const SE3d T_base_camera = rig.wheels->T_body_base.inverse() * stereo.T_body_camera();
  const GroundPlaneSeed seed = GroundPlaneSeed::from_base(T_base_camera);
  ObstacleDetector detector(stereo, seed);
  const Trajectory truth = read_trajectory(recording->info().truth);
  int at_wall = 0, skipped = 0;
  while (const auto sample = recording->next()) {
    const auto* image = std::get_if<StereoImage>(&*sample);
    if (!image || image->left.empty() || image->right.empty() || skipped++ % 2) continue;
    const auto T_world_body = interpolate(truth, image->t);
    REQUIRE(T_world_body);
    const SE3d T_world_camera = *T_world_body * stereo.T_body_camera();
    const Vec3<double> down = T_world_camera.rotation().inverse() * Vec3<double>(0, 0, -1);
    const ObstacleFrame& frame = detector.detect(image->t, image->left.view, image->right.view);
    const double angle = std::acos(std::min(1.0, down.dot(frame.plane.plane.down_camera))) / kDegree;
    CHECK(angle < 0.5);
    CHECK(std::abs(frame.plane.plane.height - T_world_camera.translation().z()) < 0.003);
    at_wall += !frame.plane.measured();
  }
  CHECK(at_wall > 5);
}

}  // namespace
