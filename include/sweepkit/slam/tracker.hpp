// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "sweepkit/core/options.hpp"
#include "sweepkit/geometry/pnp.hpp"
#include "sweepkit/geometry/rectified_camera.hpp"
#include "sweepkit/geometry/stereo_rig.hpp"
#include "sweepkit/match/brute_force.hpp"
#include "sweepkit/match/projection.hpp"
#include "sweepkit/slam/keyframe_rule.hpp"
#include "sweepkit/slam/local_map.hpp"
#include "sweepkit/slam/local_mapper.hpp"
#include "sweepkit/slam/scale_levels.hpp"
#include "sweepkit/slam/stereo_frame.hpp"
#include "sweepkit/solve/pose.hpp"

namespace sweepkit {

/// What tracking may be told.
struct TrackerOptions {
  double search_radius = 15;
  double map_search_radius = 4;
  int min_points = 15;
  int min_points_with_motion = 8;
  double vision_noise = 2;
  int min_start_points = 50;
  int restart_after = 3;
  double max_depth_uncertainty = 0.2;
  double view_angle = 60;
  ProjectionOptions projection;
  BruteForceOptions brute_force;
  PnpOptions pnp;
  PoseOptions pose;
  KeyframeRule keyframe;
  BlindKeyframeRule blind_keyframe;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(search_radius, "search_radius", "px", range(1, 200),
      "how far from its predicted place a point of the last frame is looked for, at octave 0");
    v(map_search_radius, "map_search_radius", "px", range(1, 100),
      "the same for points of the local map, once the pose is known better");
    v(min_points, "min_points", "", range(4, 1000), "with fewer points tracked the robot is lost");
    v(min_points_with_motion, "min_points_with_motion", "", range(0, 1000),
      "the same where wheels or IMU say how the robot moved");
    v(vision_noise, "vision_noise", "", range(0.1, 100),
      "multiplies the standard deviations of what is seen, against those of odometry: errors of neighbouring "
      "points and frames go together");
    v(min_start_points, "min_start_points", "", range(4, 10000), "stereo points needed to start a map");
    v(restart_after, "restart_after", "frames", range(1, 1000),
      "lost for so many frames, vision starts again at the last pose; with odometry it does so at once, at "
      "the pose that odometry tells");
    v(max_depth_uncertainty, "max_depth_uncertainty", "", range(0.001, 1),
      "largest share of its depth by which a stereo point of the last frame may be uncertain to be tracked");
    v(view_angle, "view_angle", "deg", range(1, 180),
      "points are looked for where the view differs less from the views they were seen in");
    v.group(projection, "projection", "matching near predicted places");
    v.group(brute_force, "brute_force", "matching without prediction, when the prediction fails");
    v.group(pnp, "pnp", "pose from matches without prediction");
    v.group(pose, "pose", "pose from matches, refined");
    v.group(keyframe, "keyframe", "when a frame becomes a keyframe");
    v.group(blind_keyframe, "blind_keyframe",
            "when one that shows nothing does, so that odometry goes into the map");
  }
};

enum class TrackingState {
  starting,  ///< no map yet: too few stereo points so far
  tracking,
  lost,
};

/// What became of a frame.
struct TrackResult {
  TrackingState state = TrackingState::starting;
  int points = 0;  ///< map points found
  bool wants_keyframe = false;
  bool starts_map = false;  ///< the keyframe to make is where vision starts (again)
  bool blind = false;       ///< the keyframe to make is to hold odometry alone
};

/// Where wheels or IMU say that the camera is.
struct MotionPrior {
  SE3d T_camera_world;
  Mat6<double> covariance = Mat6<double>::Identity();  ///< as PoseResult has it [m^2, rad^2]
};

/// Finds each frame's pose against a copy of the map: last frame's points by projection from where motion or
/// odometry predict it, without any prediction where that fails, then the local map. Odometry counts as a
/// measurement of the pose. Keeps its buffers; one thread at a time;
/// deterministic.
class Tracker {
 public:
  /// @param T_camera_world_start pose of the first frame
  Tracker(const RectifiedCamera& camera, const StereoRig::Bounds& view, const ScaleLevels& levels,
          const TrackerOptions& options, const SE3d& T_camera_world_start);

  /// Takes the mapper's newest copy; the last pose follows its reference keyframe.
  void set_local_map(std::shared_ptr<const LocalMap> map);

  /// Fills in points, pose, covariance and reference of a frame whose measurements, descriptors and grid are
  /// set.
  /// @param prior where odometry says that it is; null without odometry
  TrackResult track(StereoFrame& frame, const MotionPrior* prior = nullptr);

  /// Leaves the map: a new one begins at the frame just tracked or lost, with the pose that it has. False,
  /// and nothing changes, if the frame shows too few stereo points for that.
  bool begin_map(StereoFrame& frame);

  /// Where the camera is expected, moving on as between the last two frames; nothing before there is a map.
  std::optional<SE3d> predict(TimeNs t) const;
  /// Pose of the last frame tracked, in the map as it stands.
  const SE3d& last_T_camera_world() const { return last_.T_camera_world; }
  /// The keyframe that poses refer to now (none before the first copy of the map), and a pose against it.
  std::pair<KeyframeId, SE3d> refer(const SE3d& T_camera_world) const;

  /// Takes over the counts of predicted and found points since the last call.
  std::vector<PointCount> take_counts();

 private:
  struct Target {
    Vec3<double> p_world;
    Vec3<float> spread;
    PointId point;
  };

  TrackResult start(StereoFrame& frame);
  TrackResult lose(StereoFrame& frame);
  int needed_points() const { return prior_ ? options_.min_points_with_motion : options_.min_points; }
  void keep_as_last(const StereoFrame& frame);
  bool certain(const Measurement& m) const;
  int count_certain(const StereoFrame& frame) const;
  void collect_last_points();
  PoseResult find_pose(const StereoFrame& frame, const SE3d& T_predicted);
  int match_last_frame(const StereoFrame& frame, const SE3d& T_camera_world, double radius);
  std::optional<SE3d> find_without_prior(const StereoFrame& frame);
  PoseResult refine_by_local_map(StereoFrame& frame, const PoseResult& coarse);
  void begin_queries();
  void run_queries(const StereoFrame& frame);
  void take(std::int32_t measurement, const Target& target);
  PoseResult solve(const StereoFrame& frame, const SE3d& T_start);
  KeyframeSituation situation(const StereoFrame& frame, int tracked_points) const;

  RectifiedCamera camera_;
  StereoRig::Bounds view_;
  ScaleLevels levels_;
  TrackerOptions options_;
  SE3d T_start_;
  std::shared_ptr<const LocalMap> map_;
  std::vector<PointCount> counts_;

  StereoFrame last_;                              // the last one tracked
  Vec6<double> velocity_ = Vec6<double>::Zero();  // camera twist between the last two frames [1/s]
  int lost_frames_ = 0;
  const MotionPrior* prior_ = nullptr;  // of the frame being tracked, while it is believed

  ProjectionMatcher projection_;
  BruteForceMatcher brute_force_;
  PoseWorkspace workspace_;
  // Of the last frame: what can be tracked.
  std::vector<Target> last_targets_;
  std::vector<std::uint32_t> last_index_;
  // Queries and what became of them.
  std::vector<Target> targets_;
  std::vector<ProjectionQuery> queries_;
  std::vector<OrbDescriptor> query_descriptors_;
  std::vector<Match> matches_;
  // Matches so far, by measurement of the frame.
  std::vector<Target> matched_;
  std::vector<std::uint8_t> taken_;
  std::vector<PoseObservation> observations_;
  std::vector<std::uint32_t> observed_;
  std::vector<std::uint8_t> inlier_;
  std::vector<PointId> found_points_, predicted_points_;
};

}  // namespace sweepkit
