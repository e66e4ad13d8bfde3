// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include <catch2/catch.hpp>
#include <cstdlib>
#include <filesystem>
#include <numbers>

#include "sweepkit/data/recording.hpp"
#include "sweepkit/data/trajectory.hpp"
#include "sweepkit/slam/frontend.hpp"
#include "sweepkit/slam/place_verification.hpp"

using namespace sweepkit;
namespace fs = std::filesystem;

namespace {

std::string shipped_vocabulary() {
  for (fs::path folder = fs::path(__FILE__).parent_path(); folder.has_relative_path();
       folder = folder.parent_path())
    if (fs::exists(folder / "tools/initial/orb.swv")) return (folder / "tools/initial/orb.swv").string();
  return {};
}

// A map of one keyframe with its stereo points.
KeyframeId add_map_of(Map& map, const RectifiedCamera& camera, const StereoFrame& frame) {
  Keyframe keyframe;
  keyframe.map = map.add_map();
  keyframe.t = frame.t;
  keyframe.measurements = frame.measurements;
  keyframe.descriptors = frame.descriptors;
  const KeyframeId id = map.add_keyframe(std::move(keyframe));
  const ScaleLevels levels;
  for (std::uint32_t i = 0; i < frame.measurements.size(); ++i) {
    const Measurement& m = frame.measurements[i];
    if (!m.stereo() || m.sigma_right > 0.2 * m.disparity()) continue;
    const Vec3<double> p = camera.depth(m.disparity()) * Vec3<double>((m.u - camera.cx) / camera.focal,
                                                                      (m.v - camera.cy) / camera.focal, 1);
    const auto farthest = static_cast<float>(p.norm() * levels.scale(m.octave));
    map.set_appearance(map.add_point(p, id, i), frame.descriptors[i],
                       Vec3<float>((-p.normalized()).cast<float>()),
                       static_cast<float>(farthest / levels.coarsest()), farthest);
  }
  return id;
}

}  // namespace

TEST_CASE("Both pairs of EuRoC V1_01 that see one place are verified, and no other", "[place][recording]") {
  const char* data = std::getenv("SWEEPKIT_DATA");
  if (!data) {
    WARN("skipped: SWEEPKIT_DATA is not set");
    return;
  }
  const auto recording = open_recording(fs::path(data) / "euroc_loop_pairs");
  const Trajectory truth = read_trajectory(recording->info().truth);
  const StereoRig rig = recording->rig().stereo();
  const RectifiedCamera camera{rig.focal(), rig.center().x(), rig.center().y(), rig.baseline()};
  Frontend frontend(rig, {});
  PlaceDatabaseOptions options;
  options.exclude_covisible = false;
  options.exclusion_time = 0;
  options.min_relative_score = 0;
  PlaceDatabase database(open_place_vocabulary(shipped_vocabulary()), options);
  PlaceVerifier verifier(camera, rig.bounds(), {});
  Map map;
  std::vector<KeyframeId> ids;
  std::vector<SE3d> T_world_camera;
  while (const auto sample = recording->next()) {
    const StereoImage* image = std::get_if<StereoImage>(&*sample);
    if (!image) continue;
    StereoFrame frame;
    frame.t = image->t;
    frontend.extract(image->left.view, image->right.view);
    frontend.match(frame);
    ids.push_back(add_map_of(map, camera, frame));
    const auto T_world_body = interpolate(truth, image->t);
    REQUIRE(T_world_body);
    T_world_camera.push_back(*T_world_body * rig.T_body_camera());
  }
  REQUIRE(ids.size() == 4);
  database.follow(map);
  // The first two are 98 s apart, the others half a second.
  for (std::size_t i = 0; i < 4; ++i)
    for (std::size_t j = 0; j < 4; ++j) {
      if (i == j) continue;
      const PlaceImage image = database.image(map.keyframe(ids[i]));
      const PlaceCheck check = verifier.verify(image, map, database, ids[j]);
      const PlaceMatch& m = check.match;
      CAPTURE(i, j, to_string(check.rejection), m.matches, m.pairs.size(), m.found, m.predicted, m.seen_share,
              m.inverse_share, m.contradictions, m.cells.count(), m.off_plane);
      CHECK(check.ok() == (i / 2 == j / 2));
      if (!check.ok()) continue;
      const SE3d T_true = T_world_camera[i].inverse() * T_world_camera[j];
      const SE3d error = m.T_query_candidate * T_true.inverse();
      CHECK(error.translation().norm() < 0.05);
      CHECK(error.rotation().angle() * 180 / std::numbers::pi < 1);
      const auto groups = database.candidates(image, map);
      REQUIRE_FALSE(groups.empty());
      CHECK(groups.front().best == ids[j]);
    }
}
