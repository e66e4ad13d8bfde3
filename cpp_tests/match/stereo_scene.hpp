// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>
#include <vector>

#include "match/analytic_texture.hpp"
#include "match/random_features.hpp"
#include "sweepkit/geometry/stereo_rig.hpp"

namespace sweepkit {

/// Two distorted cameras turned against each other and against the baseline: about 10 px of vertical
/// parallax.
inline StereoRig unrectified_rig() {
  const Camera left({420, 418, 318, 203}, Distortion::radial_tangential, {-0.28, 0.07, 0.0002, 0.00002}, 640,
                    400);
  const Camera right({417, 421, 323, 198}, Distortion::radial_tangential, {-0.285, 0.075, -0.0001, 0.0001},
                     640, 400);
  const SE3d T_body_left(SO3d::exp(Vec3<double>(0.3, -0.2, 0.1)), {0.1, 0.2, 0.3});
  const SE3d T_left_right(SO3d::exp(Vec3<double>(0.006, -0.012, 0.014)), {0.11, 0.001, -0.002});
  return StereoRig(left, right, T_body_left, T_body_left * T_left_right);
}

/// Cameras that are a rectified pair already.
inline StereoRig rectified_rig() {
  const Camera camera({420, 420, 319.5, 199.5}, Distortion::none, {}, 640, 400);
  return StereoRig(camera, camera, SE3d(), SE3d(SO3d(), {0.11, 0, 0}));
}

/// The point of a plane n . p = 1 (rectified left camera frame) seen at a rectified position of a side.
inline Vec3<double> point_on_plane(const StereoRig& rig, Side side, const Vec2<double>& rectified,
                                   const Vec3<double>& normal) {
  const Vec3<double> ray((rectified.x() - rig.center().x()) / rig.focal(),
                         (rectified.y() - rig.center().y()) / rig.focal(), 1);
  const Vec3<double> origin(side == Side::left ? 0 : rig.baseline(), 0, 0);
  return origin + ray * ((1 - normal.dot(origin)) / normal.dot(ray));
}

/// What a camera of the rig sees of a textured plane.
inline GrayImage render_plane(const StereoRig& rig, Side side, const Vec3<double>& normal,
                              const AnalyticTexture& texture, double noise, std::uint64_t seed) {
  return render(
      640, 400,
      [&](double x, double y) {
        const auto rectified = rig.rectify(side, Vec2<double>(x, y));
        if (!rectified) return 128.0;
        const Vec3<double> p = point_on_plane(rig, side, *rectified, normal);
        return texture(p.x(), p.y());
      },
      noise, seed);
}

/// Random points before both cameras as key points: what each side's pixel and truth are.
struct PointScene {
  Features<256> left, right;
  std::vector<int> right_of_left;      ///< -1: the right camera does not have it
  std::vector<Vec3<double>> uvd_left;  ///< rectified position and disparity
};

/// @param bits descriptors of a pair differ by up to so many
/// @param noise standard deviation of key points [px]
inline PointScene point_scene(Random& random, const StereoRig& rig, int count, int bits, double noise,
                              double missing = 0.2) {
  PointScene scene;
  const SE3d T_left_camera = rig.T_body_raw(Side::left).inverse() * rig.T_body_camera();
  const SE3d T_right_camera = rig.T_body_raw(Side::right).inverse() * rig.T_body_camera();
  while (static_cast<int>(scene.left.size()) < count) {
    const Vec2<double> pixel(random.uniform(10, 629), random.uniform(10, 389));
    const auto uv = rig.rectify(Side::left, pixel);
    if (!uv) continue;
    const double z = 1 / random.uniform(1 / 8.0, 1 / 0.6);
    const Vec3<double> p((uv->x() - rig.center().x()) / rig.focal() * z,
                         (uv->y() - rig.center().y()) / rig.focal() * z, z);
    const auto left = rig.camera(Side::left).project(T_left_camera * p);
    const auto right = rig.camera(Side::right).project(T_right_camera * p);
    if (!left || !right) continue;
    const auto octave = static_cast<std::int32_t>(random.index(4));
    const auto add = [&](Features<256>& f, const Vec2<double>& at, const OrbDescriptor& d) {
      f.keypoints.push_back({.x = static_cast<float>(at.x() + random.normal(0, noise)),
                             .y = static_cast<float>(at.y() + random.normal(0, noise)),
                             .octave = octave});
      f.descriptors.push_back(d);
    };
    const OrbDescriptor d = random_descriptor(random);
    add(scene.left, *left, d);
    scene.uvd_left.emplace_back(uv->x(), uv->y(), rig.focal() * rig.baseline() / z);
    if (random.uniform() < missing || !rig.camera(Side::right).contains(*right, 5)) {
      scene.right_of_left.push_back(-1);
      // Somebody else, anywhere.
      add(scene.right, {random.uniform(10, 629), random.uniform(10, 389)}, random_descriptor(random));
    } else {
      scene.right_of_left.push_back(static_cast<int>(scene.right.size()));
      add(scene.right, *right, disturbed(random, d, bits));
    }
  }
  return scene;
}

}  // namespace sweepkit
