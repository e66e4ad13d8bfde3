// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cmath>
#include <memory>
#include <optional>
#include <vector>

#include "sweepkit/core/options.hpp"
#include "sweepkit/geometry/rectified_camera.hpp"
#include "sweepkit/geometry/stereo_rig.hpp"
#include "sweepkit/map/map.hpp"
#include "sweepkit/match/brute_force.hpp"
#include "sweepkit/motion/integrators.hpp"
#include "sweepkit/slam/global_adjustment.hpp"
#include "sweepkit/slam/local_map.hpp"
#include "sweepkit/slam/loop_correction.hpp"
#include "sweepkit/slam/map_culling.hpp"
#include "sweepkit/slam/scale_levels.hpp"
#include "sweepkit/slam/stereo_frame.hpp"
#include "sweepkit/solve/bundle.hpp"

namespace sweepkit {

/// What local mapping may be told.
struct LocalMapperOptions {
  double max_depth_uncertainty = 0.2;
  int triangulate_keyframes = 5;
  double min_parallax = 1;
  int fuse_keyframes = 12;
  double fuse_radius = 3;
  int fuse_distance = 50;
  int window = 20;
  int fixed_window = 40;
  int local_keyframes = 40;
  double revisit_distance = 1.5;
  double revisit_angle = 50;
  double cull_found_ratio = 0.25;
  double cull_redundancy = 0.9;
  int cull_observations = 3;
  double disparity_bias_sigma = 0.1;
  double drift_factor = 4;
  double odometry_scale_sigma = 0.1;
  int scale_points = 50;
  BruteForceOptions triangulation = {.max_distance = 50, .ratio = 0.85};
  BundleOptions bundle;
  LoopCorrectionOptions loop;
  MapCaps caps;
  int global_points = 80;
  BundleOptions global_bundle{.robust_iterations = 4, .iterations = 4};

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(max_depth_uncertainty, "max_depth_uncertainty", "", range(0.001, 1),
      "largest share of its depth by which a stereo point may be uncertain to enter the map");
    v(triangulate_keyframes, "triangulate_keyframes", "", range(0, 100),
      "neighbours with which points are triangulated that stereo gave no certain depth");
    v(min_parallax, "min_parallax", "deg", range(0.01, 90),
      "least angle between the two rays of such a point");
    v(fuse_keyframes, "fuse_keyframes", "", range(0, 100),
      "neighbours whose points are compared with a new keyframe's");
    v(fuse_radius, "fuse_radius", "px", range(0.5, 50),
      "how far a point may project from its double, at octave 0");
    v(fuse_distance, "fuse_distance", "bits", range(0, 256),
      "largest Hamming distance between a point and its double");
    v(window, "window", "keyframes", range(1, 200), "keyframes that local bundle adjustment moves");
    v(fixed_window, "fixed_window", "keyframes", range(1, 500), "further keyframes that hold it in place");
    v(local_keyframes, "local_keyframes", "keyframes", range(1, 1000),
      "keyframes whose points frames are tracked against");
    v(revisit_distance, "revisit_distance", "m", range(0, 100),
      "keyframes this near, looking the same way, are tracked against even if they share no points");
    v(revisit_angle, "revisit_angle", "deg", range(0, 180),
      "largest angle between the views of such keyframes");
    v(cull_found_ratio, "cull_found_ratio", "", range(0, 1),
      "points matched in a smaller share of the frames that should see them are removed");
    v(cull_redundancy, "cull_redundancy", "", range(0.1, 1),
      "a keyframe goes when others see this share of its points as well");
    v(cull_observations, "cull_observations", "", range(1, 20),
      "by how many others each of these points has to be seen");
    v(disparity_bias_sigma, "disparity_bias_sigma", "px", range(0, 10),
      "how far the rig's common error of all disparities may lie from zero before the map tells; 0: it is "
      "not "
      "estimated");
    v(drift_factor, "drift_factor", "", range(0, 1000),
      "multiplies the covariance that a keyframe adds to its parent's: errors of points that both see go "
      "together");
    v(odometry_scale_sigma, "odometry_scale_sigma", "", range(0, 10),
      "how little the length of odometry counts between keyframes that see, as a share of it");
    v(scale_points, "scale_points", "", range(0, 10000), "a keyframe sees if it has so many points");
    v.group(triangulation, "triangulation", "which measurements of two keyframes are tried");
    v.group(bundle, "bundle", "local bundle adjustment");
    v.group(caps, "caps", "how large the map may become");
    v.group(loop, "loop", "places known again");
    v(global_points, "global_points", "points", range(10, 100000),
      "of each keyframe, about so many hold the whole map together when it is adjusted; others go along");
    v.group(global_bundle, "global_bundle", "bundle adjustment of the whole map after them");
  }
};

/// How often a point should have been seen by frames, and was.
struct PointCount {
  PointId point;
  int predicted = 0;
  int found = 0;
};

/// A tracked frame that shall become a keyframe.
struct KeyframeCandidate {
  StereoFrame frame;
  std::vector<PointCount> counts;  ///< since the last candidate
  bool starts_map = false;         ///< it knows no points: its pose is where a map starts, or starts again
  bool begins_map = false;         ///< and that map is another one than so far
  int begun = 0;                   ///< how many maps tracking has begun, the first not counted
  /// The motion of the camera since the candidate before, if wheels or IMU tell.
  std::optional<UncertainMotion<double>> odometry;
};

/// Owns the map: inserts keyframes, makes, fuses and culls points, adjusts the neighbourhood, and makes the
/// copy that the tracker works with. One thread at a time; deterministic.
class LocalMapper {
 public:
  LocalMapper(const RectifiedCamera& camera, const StereoRig::Bounds& view, const ScaleLevels& levels,
              const LocalMapperOptions& options);

  /// Goes on with maps made before; the first keyframe begins one of its own, until it is joined to one of
  /// them.
  /// @param disparity_bias, sigma of the rig when they were made [px]; a sigma of 0 is not known
  /// Throws Error(argument) after the first keyframe.
  void resume(Map&& map, double disparity_bias, double disparity_bias_sigma);

  /// Everything that a new keyframe brings about. A debug build then checks the invariants of the map and
  /// throws Error(argument) if one is broken.
  /// @param stop bundle adjustment ends early once it is true
  /// @return the tracker's new copy
  std::shared_ptr<const LocalMap> process(KeyframeCandidate&& candidate,
                                          const std::atomic<bool>* stop = nullptr);

  /// Makes the map hold that its newest keyframe shows a place known before: joins the two maps or closes the
  /// loop, fuses the points of both sides and adjusts the seam. Nothing changes if it is not accepted.
  /// Whoever wants the tracker to know calls `copy_newest`.
  LoopCorrection take_place(const PlaceMatch& match);
  /// The tracker's copy as the map stands; null before the first keyframe.
  std::shared_ptr<const LocalMap> copy_newest() const;
  /// Copies the current map for an adjustment of all of it, which takes long and may run beside.
  GlobalAdjustment begin_global_adjustment() const;
  /// Takes its result over; keyframes and points made meanwhile go along with those they hang on.
  /// @return the tracker's new copy; null, and nothing changes, if it was not solved or the map was corrected
  ///   otherwise meanwhile
  std::shared_ptr<const LocalMap> finish_global_adjustment(const GlobalAdjustment& global);

  const Map& map() const { return map_; }
  /// The map that keyframes go into; none before the first.
  MapId current_map() const { return current_; }
  /// By how much the rig measures all disparities too large, estimated with the map; it is taken off them
  /// [px].
  double disparity_bias() const { return disparity_bias_; }
  double disparity_bias_sigma() const { return std::sqrt(disparity_bias_variance_); }

 private:
  KeyframeId insert(KeyframeCandidate&& candidate);
  void add_stereo_points(KeyframeId id);
  void triangulate(KeyframeId id);
  void fuse(KeyframeId id);
  bool agrees(const Measurement& measurement, const Vec3<double>& p_camera) const;
  void fuse_into(KeyframeId target, const std::vector<PointId>& points);
  void cull_points(KeyframeId newest);
  void adjust(KeyframeId id, const std::atomic<bool>* stop);
  void cull_keyframes(KeyframeId newest);
  void keep_caps(KeyframeId newest);
  void refresh_appearance(PointId id);
  std::vector<KeyframeId> neighbourhood(KeyframeId id) const;
  KeyframeId newest_before(KeyframeId id) const;
  KeyframeId last_seeing(KeyframeId id) const;
  std::vector<KeyframeId> adjustment_window(KeyframeId id) const;
  std::vector<KeyframeId> fixed_around(const std::vector<KeyframeId>& window) const;
  std::vector<PointId> points_of(const std::vector<KeyframeId>& keyframes) const;
  MapBundle bundle_of(const std::vector<KeyframeId>& window, const std::vector<KeyframeId>& fixed,
                      std::vector<PointId>&& points) const;
  void drop_outliers(const MapBundle& bundle);
  void fuse_place(const PlaceMatch& match);
  Mat6<double> odometry_covariance(KeyframeId id) const;
  Vec3<float> spread(const MapPoint& point) const;
  std::shared_ptr<const LocalMap> copy(KeyframeId newest) const;

  RectifiedCamera camera_;
  StereoRig::Bounds view_;
  ScaleLevels levels_;
  LocalMapperOptions options_;
  Map map_;
  MapId current_;
  int begun_ = 0;        // that current_ is the how manieth begun
  int corrections_ = 0;  // of current_ as a whole
  SE3d T_now_begun_;     // where these took its frame, since it began
  double disparity_bias_ = 0;
  std::vector<PointId> recent_points_;
  double disparity_bias_variance_;  // of what remains of it
  ProjectionMatcher matcher_;
  BruteForceMatcher triangulation_matcher_;
  KeypointGrid grid_;
  std::vector<Match> matches_;
};

}  // namespace sweepkit
