// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>
#include <cstdint>
#include <memory>
#include <span>
#include <unordered_map>
#include <utility>
#include <vector>

#include "sweepkit/bow/vocabulary_training.hpp"
#include "sweepkit/core/random.hpp"
#include "sweepkit/geometry/rectified_camera.hpp"
#include "sweepkit/geometry/stereo_rig.hpp"
#include "sweepkit/map/map.hpp"
#include "sweepkit/slam/place_database.hpp"
#include "sweepkit/slam/scale_levels.hpp"
#include "sweepkit/slam/stereo_frame.hpp"

namespace sweepkit {

/// Rooms of points with descriptors, seen by a stereo camera that stays level or not: maps and frames for
/// tests of place recognition, without images. World z is up.
class PlaceWorld {
 public:
  static constexpr double kWidth = 640, kHeight = 400;
  static constexpr double kFarthest = 5;  ///< from where a point shows in octave 0 [m]

  static RectifiedCamera camera() { return {.focal = 350, .cx = 319.5, .cy = 199.5, .baseline = 0.1}; }
  static StereoRig::Bounds view() { return {0, kWidth - 1, 0, kHeight - 1}; }
  static ScaleLevels levels() { return {1.2, 8}; }
  static Vec3<double> gravity() { return {0, 0, -1}; }

  /// Adds points on the four walls of a room of 4 x 4 m about (x, y); rooms of one seed look the same.
  /// @param fresh share of the points that look different from those of other rooms of the seed
  void add_room(double x, double y, int count, std::uint64_t seed, double fresh = 0) {
    Random random(seed), other(seed + 1000 + points_.size());
    for (int i = 0; i < count; ++i) {
      const double along = random.uniform(-2, 2), height = random.uniform(0, 2);
      Vec3<double> p;
      switch (i % 4) {
        case 0:
          p = {2, along, height};
          break;
        case 1:
          p = {along, 2, height};
          break;
        case 2:
          p = {-2, along, height};
          break;
        default:
          p = {along, -2, height};
      }
      OrbDescriptor descriptor, different;
      for (auto& word : descriptor.words) word = random();
      for (auto& word : different.words) word = other();
      points_.push_back(p + Vec3<double>(x, y, 0));
      descriptors_.push_back(other.uniform() < fresh ? different : descriptor);
    }
  }

  /// World to camera of one that stands at (x, y), 0.3 m high, and looks level along `yaw` [rad].
  static SE3d level_view(double x, double y, double yaw, double pitch = 0) {
    Mat3<double> R_world_camera;
    const Vec3<double> forward(std::cos(yaw), std::sin(yaw), 0), down(0, 0, -1);
    R_world_camera.col(2) = forward;
    R_world_camera.col(1) = down;
    R_world_camera.col(0) = down.cross(forward);
    const SO3<double> R(R_world_camera);
    return (SE3d(R, {x, y, 0.6}) * SE3d(SO3<double>::exp({pitch, 0, 0}), Vec3<double>::Zero())).inverse();
  }

  /// The frame from a pose, with noise of `sigma` [px] and some flipped bits; `shows[i]` is the point at
  /// measurement i.
  StereoFrame see(const SE3d& T_camera_world, std::uint64_t seed, double sigma = 0.4, TimeNs t = 0) {
    Random random(seed);
    StereoFrame frame;
    frame.t = t;
    frame.T_camera_world = T_camera_world;
    shows.clear();
    for (std::size_t i = 0; i < points_.size(); ++i) {
      const Vec3<double> p = T_camera_world * points_[i];
      const double du = sigma * random.normal(), dv = sigma * random.normal(),
                   dd = 0.3 * sigma * random.normal();
      const auto flips = random();
      const auto uvr = camera().project_stereo(p);
      if (!uvr || p.norm() > kFarthest || uvr->x() < 0 || uvr->x() >= kWidth || uvr->y() < 0 ||
          uvr->y() >= kHeight)
        continue;
      Measurement m;
      m.u = static_cast<float>(uvr->x() + du);
      m.v = static_cast<float>(uvr->y() + dv);
      m.u_right = static_cast<float>(uvr->z() + du - dd);
      m.octave = levels().octave(kFarthest, p.norm());
      m.sigma = static_cast<float>(sigma);
      m.sigma_right = static_cast<float>(0.3 * sigma);
      if (m.u_right < 0) m.u_right = -1;
      frame.measurements.push_back(m);
      OrbDescriptor descriptor = descriptors_[i];
      for (int k = 0; k < 8; ++k) descriptor.words[k % 4] ^= std::uint64_t{1} << ((flips >> (6 * k)) & 63U);
      frame.descriptors.push_back(descriptor);
      shows.push_back(i);
    }
    frame.grid.build(frame.measurements);
    frame.points.assign(frame.measurements.size(), PointId{});
    return frame;
  }

  /// A frame of which only so large a share of the key points still looks like what it shows: the others have
  /// exchanged their descriptors.
  static StereoFrame confuse(StereoFrame frame, double share, std::uint64_t seed) {
    Random random(seed);
    std::vector<std::size_t> others;
    for (std::size_t i = 0; i < frame.descriptors.size(); ++i)
      if (random.uniform() >= share) others.push_back(i);
    for (std::size_t k = 0; k + 1 < others.size(); ++k)
      std::swap(frame.descriptors[others[k]], frame.descriptors[others[k + 1]]);
    return frame;
  }

  /// Adds a keyframe that sees the world from T_camera_true but stands in the map at T_camera_map, with the
  /// points it shows: known ones of this sub-map observed again, others made from its own stereo.
  /// @param alike the share of its key points that look like what they show, see confuse()
  KeyframeId add_keyframe(Map& map, MapId map_id, const SE3d& T_camera_true, const SE3d& T_camera_map,
                          std::uint64_t seed, TimeNs t, bool new_points = false, double alike = 1) {
    const StereoFrame frame = confuse(see(T_camera_true, seed), alike, 7);
    Keyframe keyframe;
    keyframe.map = map_id;
    keyframe.t = t;
    keyframe.T_camera_world = T_camera_map;
    keyframe.measurements = frame.measurements;
    keyframe.descriptors = frame.descriptors;
    keyframe.covariance = Mat6<double>::Identity() * 1e-4;
    keyframe.parent = newest_[map_id.value];
    const KeyframeId id = map.add_keyframe(std::move(keyframe));
    newest_[map_id.value] = id;
    auto& known = known_[map_id.value];
    if (new_points) known.clear();
    const RectifiedCamera c = camera();
    for (std::uint32_t i = 0; i < frame.measurements.size(); ++i) {
      const Measurement& m = frame.measurements[i];
      const auto it = known.find(shows[i]);
      if (it != known.end()) map.add_observation(it->second, id, i);
      if (!m.stereo()) continue;
      const Vec3<double> p_camera =
          c.depth(m.disparity()) * Vec3<double>((m.u - c.cx) / c.focal, (m.v - c.cy) / c.focal, 1);
      const Vec3<double> p_world = T_camera_map.inverse() * p_camera;
      if (it != known.end()) {
        const auto n = static_cast<double>(map.point(it->second).observations.size());
        map.set_position(it->second, ((n - 1) * map.point(it->second).p_world + p_world) / n);
        continue;
      }
      const PointId point = map.add_point(p_world, id, i);
      const Vec3<double> to_camera = T_camera_map.inverse().translation() - p_world;
      map.set_appearance(point, frame.descriptors[i], to_camera.normalized().cast<float>(),
                         static_cast<float>(kFarthest / levels().coarsest()), static_cast<float>(kFarthest));
      known.emplace(shows[i], point);
    }
    return id;
  }

  /// A tree trained on this world's descriptors, so fine that most have a word of their own.
  std::shared_ptr<const OrbVocabulary> vocabulary() const {
    VocabularyTrainingOptions options;
    options.depth = 2;
    options.weighting = BagWeighting::tf;
    options.iterations = 5;
    options.threads = 1;
    const std::vector<std::vector<OrbDescriptor>> images{descriptors_};
    return std::make_shared<const OrbVocabulary>(
        train_vocabulary<256>(std::span<const std::vector<OrbDescriptor>>(images), options));
  }

  std::vector<std::size_t> shows;

 private:
  std::vector<Vec3<double>> points_;
  std::vector<OrbDescriptor> descriptors_;
  std::unordered_map<std::uint32_t, std::unordered_map<std::size_t, PointId>> known_;
  std::unordered_map<std::uint32_t, KeyframeId> newest_;
};

}  // namespace sweepkit
