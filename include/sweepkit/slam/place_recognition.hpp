// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <bitset>
#include <deque>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "sweepkit/core/options.hpp"
#include "sweepkit/slam/place_database.hpp"
#include "sweepkit/slam/place_verification.hpp"

namespace sweepkit {

struct PlaceRecognizerOptions {
  PlaceDatabaseOptions database;
  PlaceVerifierOptions verifier;
  int confirmations = 3;
  int history = 10;
  double history_time = 20;
  int sure_inliers = 80;
  int sure_cells = 14;
  int sure_off_plane = 20;
  double min_travel = 0.1;
  double min_turn = 10;
  double drift = 0.05;
  double consistent_distance = 0.1;
  double consistent_angle = 3;
  double max_speed = 1;
  double max_turn_rate = 180;
  double rival_share = 0.4;
  bool pool = true;
  double pooled_inverse_share = 0.25;
  double pooled_seen_share = 0.08;
  double pooled_off_plane = 0.2;
  bool twins = true;
  int stranger_history = 40;
  int stranger_views = 4;
  double stranger_travel = 1;
  double stranger_turn = 90;
  double stranger_contradictions = 0.015;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v.group(database, "database", "which keyframes look alike");
    v.group(verifier, "verifier", "whether they show the same place");
    v(confirmations, "confirmations", "images", range(1, 100),
      "images that must say so, with motion between them that agrees");
    v(history, "history", "images", range(1, 1000), "images before that are asked");
    v(history_time, "history_time", "s", range(0.1, 1e6), "that are no older than this");
    v(sure_inliers, "sure_inliers", "", range(4, 100000),
      "with so many points that agree one image is enough ...");
    v(sure_cells, "sure_cells", "", range(1, 40),
      "... if they are spread over so many of its 8 x 5 cells ...");
    v(sure_off_plane, "sure_off_plane", "", range(0, 100000), "... and so many lie off their main plane");
    v(min_travel, "min_travel", "m", range(0, 100), "by how much these images must lie apart");
    v(min_turn, "min_turn", "deg", range(0, 360), "or be turned, between the two farthest of them");
    v(drift, "drift", "", range(0, 1),
      "by what share of the distance between images odometry between them may be wrong");
    v(consistent_distance, "consistent_distance", "m", range(0, 100),
      "by how much two places may differ that are the same, beside drift");
    v(consistent_angle, "consistent_angle", "deg", range(0, 180), "and in rotation");
    v(max_speed, "max_speed", "m/s", range(0, 100),
      "how fast the camera may move between frames where no odometry says how");
    v(max_turn_rate, "max_turn_rate", "deg/s", range(0, 10000), "and turn");
    v(rival_share, "rival_share", "", range(0, 1),
      "another place with so large a share of the best one's points makes it ambiguous");
    v(pool, "pool", "", any_value(),
      "frames that none alone tells the place of are asked together, if odometry and gravity are known");
    v(pooled_inverse_share, "pooled_inverse_share", "", range(0, 1), "verifier.min_inverse_share for them");
    v(pooled_seen_share, "pooled_seen_share", "", range(0, 1),
      "verifier.min_seen_share for them, from far ahead few points look as they did ...");
    v(pooled_off_plane, "pooled_off_plane", "", range(0, 1),
      "... where so large a share of what agrees lies off the main plane: a thing that stands elsewhere too "
      "has few planes");
    v(twins, "twins", "", any_value(),
      "a room that is not mapped may look like one that is: another map that odometry knows no way to is "
      "believed only after what the options below ask for; false: after confirmations, as in its own");
    v(stranger_history, "stranger_history", "images", range(1, 1000), "views that are asked then");
    v(stranger_views, "stranger_views", "images", range(1, 100), "different views that must say so");
    v(stranger_travel, "stranger_travel", "m", range(0, 100),
      "by how much the farthest of them must lie apart");
    v(stranger_turn, "stranger_turn", "deg", range(0, 180), "or be turned");
    v(stranger_contradictions, "stranger_contradictions", "", range(0, 1),
      "largest share of points that one side looks through, over all of them");
  }
};

/// Says of keyframes and frames where in the maps they were taken, once several agree: for loops (a keyframe
/// in its own map), for joining (in another map) and for relocalization (a frame of no map). One thread at a
/// time; deterministic.
class PlaceRecognizer {
 public:
  /// Throws as PlaceDatabase does.
  PlaceRecognizer(const RectifiedCamera& camera, const StereoRig::Bounds& view, const ScaleLevels& levels,
                  std::shared_ptr<const OrbVocabulary> vocabulary,
                  const PlaceRecognizerOptions& options = {});

  /// Keyframes enter and leave here; feed() adds the one that it is fed.
  PlaceDatabase& database() { return database_; }
  const PlaceDatabase& database() const { return database_; }
  const PlaceCounts& counts() const { return counts_; }
  /// Why the last feed() or locate() gave nothing: of the candidate that came farthest.
  PlaceRejection last_rejection() const { return last_; }

  /// A new keyframe of the map: where it has been before, if it has. Adds it to the database. A place in its
  /// own map is checked against the map's poses, whose covariance is that of both keyframes.
  /// Where twins are not feared, keyframes of which none alone tells the place in another map are asked
  /// together, as by locate(); `query` is then the one of them that tells most.
  /// @param gravity which way gravity pulls in the keyframe's map and in all others (world axes), unit; null
  ///   if not known
  /// @param one_frame other maps that stand in the frame of the keyframe's own as far as odometry tells,
  /// within
  ///   its covariance (the robot was lifted, but measured how): places in them are checked in the same way
  std::optional<PlaceMatch> feed(const Map& map, KeyframeId keyframe, const Vec3<double>* gravity = nullptr,
                                 std::span<const MapId> one_frame = {});

  /// A frame that belongs to no map. Frames come in the order of time; each that moved on confirms or
  /// contradicts what those before said. Where none alone has enough to tell, but odometry and gravity are
  /// known, the matches of all are pooled: one pose for all, and what speaks for and against it is summed.
  /// The frame itself may then have no pairs: its place is that of those before, by odometry.
  /// @param gravity_camera which way gravity pulls in the rectified left camera, unit; null if not known
  /// @param gravity_world the same in the maps
  /// @param T_camera_odom where odometry says that the camera is, in any frame that stays; null without
  std::optional<PlaceMatch> locate(const Map& map, const StereoFrame& frame,
                                   const Vec3<double>* gravity_camera = nullptr,
                                   const Vec3<double>* gravity_world = nullptr,
                                   const SE3d* T_camera_odom = nullptr);
  /// Forgets the frames that locate() has seen: call it when the robot was moved, or is found.
  void forget();

 private:
  struct Seen {
    PlaceImage image;
    std::optional<SE3d> T_camera_odom;
    std::optional<Vec3<double>> gravity_camera;
    std::optional<PlaceMatch> match;  // verified on its own
    std::vector<PlaceGroup> groups;   // that look like it
  };

  // What several images say of one place for all of them.
  struct Pooled {
    PlaceMatch match;              // of the newest image
    PlaceMatch anchor;             // of the image that tells most, as it was found
    std::vector<SE3d> confirming;  // T_camera_world of the images that agree
    int denials = 0;
    int inliers = 0, off_plane = 0;  // sums
    std::bitset<40> cells;           // of all their views
    std::size_t most_cells = 0;      // of one
    double seen_share = 0, inverse_share = 0, contradictions = 0;
  };

  // Doubts: most of what should be seen is missing, what is there agrees.
  enum class Witness { confirms, doubts, denies, silent };

  // What the images of a drive say of a place.
  struct Testimony {
    std::vector<SE3d> confirming, doubting, denying;  // T_camera_world
    std::vector<double> contradictions;               // of those that could tell
  };

  // A place that a keyframe was verified at.
  struct Claim {
    KeyframeId keyframe;
    MapId map;
    SE3d T_camera_world;
  };

  std::optional<PlaceMatch> best_candidate(const Map& map, const PlaceImage& image,
                                           std::span<const PlaceGroup> groups, PlaceHints hints,
                                           MapId own_map, std::span<const MapId> one_frame = {});
  std::optional<PlaceMatch> confirmed(const Map& map, const Keyframe& keyframe, PlaceMatch match,
                                      const Vec3<double>* gravity, std::span<const MapId> one_frame);
  std::optional<PlaceMatch> feed_together(const Map& map, const Keyframe& keyframe,
                                          std::span<const MapId> known, const Vec3<double>& gravity_world);
  std::optional<PlaceMatch> locate_together(const Map& map, const Seen& now,
                                            const Vec3<double>& gravity_world);
  std::optional<Pooled> locate_together(const Map& map, std::span<const Seen* const> seen,
                                        std::span<const MapId> known, const Vec3<double>& gravity_world);
  std::vector<PlaceGroup> groups_of(std::span<const Seen* const> seen, const Map& map,
                                    std::span<const MapId> known) const;
  Pooled examine_together(const Map& map, std::span<const Seen* const> seen, MapId target,
                          const SE3d& T_first_world, const Vec3<double>& gravity_world);
  PlaceRejection judge(const Pooled& pooled) const;
  std::optional<PlaceCheck> check_at(const Map& map, const PlaceImage& image, const SE3d& T_camera_world,
                                     MapId target, const PlaceHints& hints);
  static bool other_place(const SE3d& T_a_world, const SE3d& T_b_world);
  bool same_place(const SE3d& T_a_world, const SE3d& T_b_world, double travelled) const;
  Witness ask(const Map& map, const PlaceImage& image, const SE3d& T_camera_world, MapId target,
              double travelled, const PlaceHints& hints, double* contradictions = nullptr);
  bool far_apart(std::span<const SE3d> poses) const;
  bool convinced(const std::vector<SE3d>& confirming, int denials, PlaceMatch& match);
  bool convinced_of_stranger(const Testimony& testimony, PlaceMatch& match);
  void remember(Seen&& now);
  void reject(PlaceRejection rejection);

  PlaceRecognizerOptions options_;
  PlaceDatabase database_;
  PlaceVerifier verifier_;
  PlaceCounts counts_;
  PlaceRejection last_ = PlaceRejection::none;
  std::deque<Seen> seen_;     // by locate()
  std::deque<Seen> fed_;      // keyframes, by feed() where twins are not feared
  std::deque<Claim> claims_;  // of feed() since it last knew a place
};

}  // namespace sweepkit
