// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>
#include <cstdint>
#include <utility>
#include <vector>

#include "sweepkit/core/random.hpp"
#include "sweepkit/map/atlas.hpp"

namespace sweepkit {

inline StereoRig small_rig() {
  const Camera left({400.5, 401.25, 320.1, 200.2}, Distortion::radial_tangential, {-0.3, 0.1, 1e-4, -2e-4},
                    640, 400);
  const Camera right({399.5, 400.75, 318.9, 201.2}, Distortion::radial_tangential, {-0.29, 0.09, 2e-4, -1e-4},
                     640, 400);
  const SO3d R = SO3d::exp({-1.2, 1.3, -1.1});
  return {left, right, SE3d(R, {0.1, 0.02, 0.3}),
          SE3d(R, Vec3<double>(0.1, 0.02, 0.3) + R * Vec3<double>(0.12, 0, 0))};
}

/// A map with all that a map can have: two trees, points seen by several keyframes, merged and removed ones,
/// removed keyframes, odometry, a keyframe that saw nothing. Odd numbers everywhere.
inline Map random_map(std::uint64_t seed, int keyframes = 8, std::uint32_t measurements = 10) {
  Random random(seed);
  const auto vector = [&](auto v) {
    for (auto& x : v.reshaped()) x = static_cast<std::decay_t<decltype(x)>>(random.normal());
    return v;
  };
  Map map;
  const MapId maps[] = {map.add_map(), map.add_map()};
  map.add_map();  // nothing came of it
  std::vector<KeyframeId> ids;
  std::vector<PointId> points;
  for (int k = 0; k < keyframes; ++k) {
    Keyframe keyframe;
    keyframe.map = maps[2 * k >= keyframes];
    keyframe.t = 1403636579763555584 + 100000000 * k;
    keyframe.T_camera_world = SE3d::exp(vector(Vec6<double>()));
    keyframe.covariance = vector(Mat6<double>());
    keyframe.covariance = (keyframe.covariance * keyframe.covariance.transpose()).eval();
    const bool first = k == 0 || map.keyframe(ids.back()).map != keyframe.map;
    if (!first) {
      keyframe.parent = ids.back();
      if (k % 3 != 1) {
        const Mat6<double> A = vector(Mat6<double>());
        keyframe.odometry = OdometryEdge{ids.back(), {SE3d::exp(vector(Vec6<double>())), A * A.transpose()}};
      }
    }
    if (k != keyframes - 2) {
      keyframe.measurements.resize(measurements);
      keyframe.descriptors.resize(measurements);
      for (Measurement& m : keyframe.measurements) {
        m.u = static_cast<float>(random.uniform(0, 640));
        m.v = static_cast<float>(random.uniform(0, 400));
        m.u_right = random.uniform(0, 1) < 0.7 ? m.u - static_cast<float>(random.uniform(0, m.u)) : -1;
        m.sigma = static_cast<float>(random.uniform(0.5, 3));
        m.sigma_right = static_cast<float>(random.uniform(0.1, 1));
        m.angle = static_cast<float>(random.uniform(-3, 3));
        m.octave = static_cast<std::int32_t>(random.index(8));
      }
      for (OrbDescriptor& d : keyframe.descriptors)
        for (std::uint64_t& word : d.words) word = random();
    }
    const bool blind = keyframe.blind();
    const KeyframeId id = map.add_keyframe(std::move(keyframe));
    ids.push_back(id);
    if (blind) continue;
    for (std::uint32_t i = 0; i < measurements; ++i) {
      const double dice = random.uniform(0, 1);
      if (dice < 0.4) {
        points.push_back(map.add_point(vector(Vec3<double>()), id, i));
        OrbDescriptor descriptor;
        for (std::uint64_t& word : descriptor.words) word = random();
        map.set_appearance(points.back(), descriptor, vector(Vec3<float>()), 0.3f, 7.7f);
        map.count_prediction(points.back(), 3, 2);
      } else if (dice < 0.8 && !points.empty()) {
        const PointId point = map.resolve(points[random.index(points.size())]);
        if (point.valid()) map.add_observation(point, id, i);
      }
    }
    if (points.size() > 4 && k % 2) {
      const PointId drop = points[points.size() - 3], keep = points[points.size() - 4];
      if (map.find(drop) && map.find(keep)) map.merge_points(drop, keep);
      if (map.find(points.back())) map.remove_point(points.back());
    }
    if (k % 4 == 3 && map.keyframe(ids[ids.size() - 2]).parent.valid()) {
      map.remove_keyframe(ids[ids.size() - 2]);
      ids.erase(ids.end() - 2);
    }
  }
  return map;
}

inline AtlasInfo random_info(std::uint64_t seed, const Map& map) {
  Random random(seed);
  AtlasInfo info;
  info.rig = identity_of(small_rig());
  info.vocabulary = "default";
  info.vocabulary_checksum = random();
  info.disparity_bias = random.normal();
  info.disparity_bias_sigma = 0.01;
  info.gravity_known = {true, false, true};
  for (std::uint32_t i = 0; i < map.keyframe_id_end(); ++i) {
    if (!map.find(KeyframeId{i})) continue;
    info.attachments["floor_scans"].push_back({KeyframeId{i}, std::vector<std::byte>(3 * i, std::byte{7})});
    if (i % 2) info.attachments["bags"].push_back({KeyframeId{i}, std::vector<std::byte>(5, std::byte{9})});
  }
  return info;
}

}  // namespace sweepkit
