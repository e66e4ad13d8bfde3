// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <bitset>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string_view>
#include <vector>

#include "sweepkit/core/options.hpp"
#include "sweepkit/geometry/pnp.hpp"
#include "sweepkit/geometry/rectified_camera.hpp"
#include "sweepkit/geometry/stereo_rig.hpp"
#include "sweepkit/map/map.hpp"
#include "sweepkit/match/orientation.hpp"
#include "sweepkit/match/projection.hpp"
#include "sweepkit/slam/place_database.hpp"
#include "sweepkit/slam/scale_levels.hpp"
#include "sweepkit/solve/pose.hpp"

namespace sweepkit {

struct PlaceVerifierOptions {
  int max_distance = 64;
  double ratio = 0.9;
  bool check_orientation = true;
  double max_size_difference = 1.5;
  int match_keyframes = 5;
  int group_keyframes = 15;
  int min_matches = 15;
  double first_radius = 10;
  double radius = 4;
  double view_angle = 60;
  double max_depth_uncertainty = 0.1;
  int min_inliers = 30;
  double min_inlier_share = 0.5;
  int min_cells = 9;
  int min_off_plane = 8;
  double min_seen_share = 0.13;
  double min_inverse_share = 0.33;
  double depth_tolerance = 0.1;
  double max_contradictions = 0.06;
  double max_position_sigma = 0.03;
  double max_rotation_sigma = 1;
  double max_tilt = 2;
  double max_prior_distance = 6;
  double prior_position_floor = 0.1;
  double prior_rotation_floor = 2;
  PnpOptions pnp = {.threshold = 4, .min_inliers = 12, .ransac = {}};
  PnpOptions pooled = {.threshold = 4, .min_inliers = 8, .ransac = {.max_iterations = 5000}};
  ProjectionOptions projection = {.max_distance = 80, .ratio = 0.9};
  PoseOptions pose;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(max_distance, "max_distance", "bits", range(0, 256), "largest Hamming distance of a match");
    v(ratio, "ratio", "", range(0.1, 1), "the best must lie below this part of the second best");
    v(check_orientation, "check_orientation", "", any_value(),
      "keep only matches that agree on how much the image turned");
    v(max_size_difference, "max_size_difference", "levels", range(0, 100),
      "largest difference in size between what two key points show, by depth and octave: stereo knows both");
    v(match_keyframes, "match_keyframes", "keyframes", range(1, 100),
      "the candidate and its best neighbours, whose descriptors are compared with the image's");
    v(group_keyframes, "group_keyframes", "keyframes", range(1, 200),
      "the same with more neighbours: their points are looked for once there is a pose");
    v(min_matches, "min_matches", "", range(4, 10000), "fewer matches of descriptors are no place");
    v(first_radius, "first_radius", "px", range(0.5, 100),
      "how far from its predicted place a point is looked for first, at octave 0");
    v(radius, "radius", "px", range(0.5, 100), "the same once the pose is refined");
    v(view_angle, "view_angle", "deg", range(1, 180),
      "points are looked for where the view differs less from the views they were seen in");
    v(max_depth_uncertainty, "max_depth_uncertainty", "", range(0.001, 1),
      "largest share of its depth by which a stereo point of the image may be uncertain to be looked for in "
      "the candidate");
    v(min_inliers, "min_inliers", "", range(4, 10000), "fewer points that agree on the pose are no place");
    v(min_inlier_share, "min_inlier_share", "", range(0, 1),
      "least share of them among the points found near where they were predicted");
    v(min_cells, "min_cells", "", range(1, 40),
      "so many of the 8 x 5 cells of the image must have one of them");
    v(min_off_plane, "min_off_plane", "", range(0, 10000),
      "so many must lie off the plane on which most lie: wallpaper, tiles and boards repeat along a plane");
    v(min_seen_share, "min_seen_share", "", range(0, 1),
      "least share of the candidate's points found again where the image has a key point");
    v(min_inverse_share, "min_inverse_share", "", range(0, 1),
      "the same for the image's points in the candidate");
    v(depth_tolerance, "depth_tolerance", "", range(0.001, 1),
      "depths that differ by a larger share contradict each other, if their noise does not explain it");
    v(max_contradictions, "max_contradictions", "", range(0, 1),
      "largest share of points through which the other image looks, among those whose place it sees");
    v(max_position_sigma, "max_position_sigma", "m", range(1e-4, 100),
      "largest standard deviation of the position in any direction");
    v(max_rotation_sigma, "max_rotation_sigma", "deg", range(1e-3, 180), "and of the rotation");
    v(max_tilt, "max_tilt", "deg", range(0.01, 180),
      "largest angle between gravity as the image knows it and as the map does");
    v(max_prior_distance, "max_prior_distance", "", range(0.1, 1e6),
      "how many standard deviations the pose may lie from where odometry expects it");
    v(prior_position_floor, "prior_position_floor", "m", range(0, 100),
      "standard deviation added to that expectation");
    v(prior_rotation_floor, "prior_rotation_floor", "deg", range(0, 180), "and to its rotation");
    v.group(pnp, "pnp", "pose from matches of descriptors");
    v.group(pooled, "pooled", "the same from those of several images");
    v.group(projection, "projection", "matches near predicted places");
    v.group(pose, "pose", "pose from these");
  }
};

/// Why a candidate was not taken for the place.
enum class PlaceRejection {
  none,            ///< it was
  few_matches,     ///< too few descriptors match
  no_pose,         ///< no pose on which enough of them agree
  few_inliers,     ///< too few points found near where the pose predicts them
  inlier_share,    ///< too many points found there that do not agree
  concentrated,    ///< what agrees lies in a corner of the image
  flat,            ///< what agrees lies on one plane, along which patterns repeat
  not_seen,        ///< too many points that should be seen are not
  not_seen_there,  ///< the same for points of the image in the candidate
  contradicted,    ///< one image looks through what the other saw
  uncertain,       ///< the pose is not known well enough
  tilted,          ///< it contradicts gravity
  far_from_prior,  ///< it contradicts odometry
  ambiguous,       ///< another place fits as well
  inconsistent,    ///< other keyframes contradict it
  unconfirmed,     ///< other keyframes do not say so yet
};
inline constexpr std::size_t kPlaceRejections = 16;

/// The name of a rejection, as events, files and Python use it: "few_matches".
std::string_view to_string(PlaceRejection rejection);

/// How often what happened.
struct PlaceCounts {
  std::size_t queries = 0;                               ///< images asked about
  std::size_t candidates = 0;                            ///< groups that the database offered for them
  std::size_t accepted = 0;                              ///< places recognized
  std::array<std::size_t, kPlaceRejections> rejected{};  ///< by PlaceRejection; 0 for `none`

  std::size_t of(PlaceRejection rejection) const { return rejected[static_cast<std::size_t>(rejection)]; }
};

/// A measurement of the image and the point of the map that it shows.
struct PlacePair {
  std::uint32_t measurement = 0;
  PointId point;

  friend bool operator==(const PlacePair&, const PlacePair&) = default;
};

/// A place known again.
struct PlaceMatch {
  KeyframeId query;      ///< the keyframe that knows it, none if it was a frame
  KeyframeId candidate;  ///< the keyframe that it was compared with first
  MapId map;             ///< of the candidate
  SE3d T_camera_world;   ///< the image's rectified left camera in the candidate's map
  Mat6<double> covariance = Mat6<double>::Zero();  ///< of it as PoseResult has it, against the candidate's
                                                   ///< surroundings [m^2, rad^2]
  SE3d T_query_candidate;                          ///< the candidate's camera to the image's
  std::vector<PlacePair> pairs;                    ///< that agree on the pose, by measurement
  int matches = 0;                                 ///< of descriptors
  int predicted = 0;          ///< points of the candidate's surroundings that the image could have found:
                              ///< it has a key point near them
  int found = 0;              ///< of these, found near where they were predicted
  double seen_share = 0;      ///< inliers among those predicted
  double inverse_share = 0;   ///< the same the other way, for the image's points in the candidate
  double contradictions = 0;  ///< share of points through which the other image looks
  int off_plane = 0;          ///< inliers off the plane on which most of them lie
  std::bitset<40> cells;      ///< of the image's 8 x 5, row by row, that have an inlier
  int confirmations = 1;      ///< images that say so, this one among them
};

/// What verify() found: a match to be believed only if ok().
struct PlaceCheck {
  PlaceRejection rejection = PlaceRejection::few_matches;
  PlaceMatch match;

  bool ok() const { return rejection == PlaceRejection::none; }
};

/// Where odometry or the map says that an image was taken.
struct PlacePrior {
  SE3d T_camera_world;
  Mat6<double> covariance = Mat6<double>::Identity();  ///< as PoseResult has it [m^2, rad^2]
};

/// What is known of an image besides what it shows.
struct PlaceHints {
  /// Which way gravity pulls, unit, in the image's rectified left camera and in the candidate's map. With
  /// both only the turn about it and the translation are searched for, and the result must agree with it.
  std::optional<Vec3<double>> gravity_camera, gravity_world;
  /// Where the image should be in the candidate's map.
  std::optional<PlacePrior> prior;
};

/// One of several images whose way from one to the other is known.
struct PlaceView {
  const PlaceImage* image = nullptr;
  SE3d T_view_first;  ///< the first one's rectified left camera to this one's
};

/// Where several images together say that the first was taken; to be verified.
struct PlaceProposal {
  SE3d T_first_world;
  int matches = 0;  ///< of descriptors, in all images
  int inliers = 0;  ///< of these, that agree on the pose
};

struct PooledMatch;

/// Decides whether an image shows the place of a keyframe: matches of descriptors below the same nodes of the
/// vocabulary, a pose by RANSAC (P3P, or two points where gravity is known; stereo fixes the scale), points
/// of the keyframe and its neighbours looked for where that pose predicts them, a robust refinement, and then
/// everything that can speak against it: too few points, in a corner, points that should be seen both ways
/// and are not, rays through what should be solid, gravity, odometry. Keeps its buffers; one thread at a
/// time; deterministic.
class PlaceVerifier {
 public:
  PlaceVerifier(const RectifiedCamera& camera, const StereoRig::Bounds& view, const ScaleLevels& levels,
                const PlaceVerifierOptions& options = {});

  const PlaceVerifierOptions& options() const { return options_; }

  /// @param candidate a keyframe of the map that the database has
  PlaceCheck verify(const PlaceImage& image, const Map& map, const PlaceDatabase& database,
                    KeyframeId candidate, const PlaceHints& hints = {});

  /// The same from a pose on: no descriptors are matched without prediction.
  PlaceCheck verify_at(const PlaceImage& image, const Map& map, KeyframeId candidate,
                       const SE3d& T_camera_world, const PlaceHints& hints = {});

  /// Whether a covariance is within max_position_sigma and max_rotation_sigma.
  bool certain(const Mat6<double>& covariance) const;

  /// Where images were taken of which none alone has enough matches: those of all, over the known way from
  /// one to the other, on one pose.
  /// @param gravity_first, gravity_world which way gravity pulls in the first image's rectified left camera
  ///   and in the candidate's map, unit
  std::optional<PlaceProposal> propose(std::span<const PlaceView> views, const Map& map,
                                       const PlaceDatabase& database, KeyframeId candidate,
                                       const Vec3<double>& gravity_first, const Vec3<double>& gravity_world);

  /// One pose for several images from what each found on its own near it.
  /// @param pairs for each image, as PlaceMatch::pairs
  SE3d refine_together(std::span<const PlaceView> views, std::span<const std::vector<PlacePair>> pairs,
                       const Map& map, const SE3d& T_first_world) const;

 private:
  struct PoolPoint {
    PointId id;
    Vec3<double> p_world;
    Vec3<float> spread;
    Vec3<float> normal;
    float min_distance, max_distance;
    OrbDescriptor descriptor;
    float noise;  // of a measurement against the point, in its sigmas: the point was measured too
  };
  struct DescriptorMatch {
    std::uint32_t measurement;
    PointId point;
    int distance;
  };

  void collect_group(const Map& map, KeyframeId candidate, const PlaceImage& image);
  void match_descriptors(const PlaceImage& image, const Map& map, const PlaceDatabase& database);
  PooledMatch pooled_match(std::size_t view, const Measurement& m, const Vec3<double>& p_world) const;
  void match_keyframe(const PlaceImage& image, const Map& map, const Keyframe& keyframe,
                      const DirectIndex& index);
  float size_level(int octave, double distance) const;
  std::optional<SE3d> coarse_pose(const PlaceImage& image, const Map& map, const PlaceHints& hints);
  PoseResult match_projected(const PlaceImage& image, const SE3d& T_camera_world, double radius);
  void examine(const PlaceImage& image, const Map& map, const SE3d& T_start, const PlaceHints& hints,
               PlaceCheck& check);
  KeyframeId most_seen(const Map& map) const;
  double inverse_share(const PlaceImage& image, const Keyframe& candidate, const SE3d& T_candidate_camera);
  int count_off_plane() const;
  int count_comparable(std::span<const Measurement> measurements, const KeypointGrid& grid);
  double contradictions(const PlaceImage& image, const Keyframe& candidate, const SE3d& T_candidate_camera);
  PlaceRejection judge(const PlaceHints& hints, const PlaceMatch& match) const;
  Vec3<double> back_project(const Measurement& m) const;

  RectifiedCamera camera_;
  StereoRig::Bounds view_;
  ScaleLevels levels_;
  PlaceVerifierOptions options_;

  ProjectionMatcher projection_;
  OrientationCheck orientation_;
  PoseWorkspace workspace_;
  std::vector<KeyframeId> group_;
  std::vector<PoolPoint> pool_;  // by id
  std::vector<DescriptorMatch> descriptor_matches_, keyframe_matches_;
  std::vector<std::uint64_t> best_of_keyframe_;
  std::vector<float> image_sizes_, keyframe_sizes_;  // NaN where not known
  std::vector<ProjectionQuery> queries_;
  std::vector<OrbDescriptor> query_descriptors_;
  std::vector<std::uint32_t> asked_;
  std::vector<Match> matches_;
  std::vector<PoseObservation> observations_;
  std::vector<PlacePair> observed_;
  std::vector<std::uint8_t> inlier_;
  KeypointGrid grid_;
  std::vector<std::int32_t> near_;
};

}  // namespace sweepkit
