// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "sweepkit/core/event.hpp"
#include "sweepkit/core/options.hpp"
#include "sweepkit/core/sample.hpp"
#include "sweepkit/core/stage_clock.hpp"
#include "sweepkit/data/source.hpp"
#include "sweepkit/direction/main_direction.hpp"
#include "sweepkit/feature/segments.hpp"
#include "sweepkit/geometry/stereo_rig.hpp"
#include "sweepkit/map/atlas.hpp"
#include "sweepkit/map/map.hpp"
#include "sweepkit/slam/frontend.hpp"
#include "sweepkit/slam/local_mapper.hpp"
#include "sweepkit/slam/odometry_bridge.hpp"
#include "sweepkit/slam/place_recognition.hpp"
#include "sweepkit/slam/tracker.hpp"
#include "sweepkit/system/grid_stage.hpp"
#include "sweepkit/system/obstacle_stage.hpp"

namespace sweepkit {

/// Which frame a pose is asked in.
enum class Frame {
  odom,  ///< smooth: never corrected
  map,   ///< corrected; steps when the map is
};

/// What a pose rests on.
enum class PoseBasis {
  vision,
  odometry,
  guess,  ///< carried on from the poses before
};

/// Where the body is at an instant. At t = 0 of a run both frames stand at the body's first pose.
struct BodyPose {
  TimeNs t = 0;
  SE3d T_frame_body;  ///< frame: odom or map, as asked
  /// Of xi in T_frame_body * Exp(xi), (rho, phi) in the body's axes, since the start of the map [m^2, rad^2].
  Mat6<double> covariance = Mat6<double>::Zero();
  PoseBasis basis = PoseBasis::guess;
};

/// The search for the room's main direction at the start of a run. It needs an IMU, which knows what is up.
struct MainDirectionSearchOptions {
  bool enabled = true;
  double give_up_after = 60;
  MainDirectionOptions direction;
  SegmentOptions segments;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(enabled, "enabled", "", any_value(), "look for the main direction from the first image on");
    v(give_up_after, "give_up_after", "s", range(0, 1e6), "no longer than this: some rooms have none");
    v.group(direction, "direction", "the main direction");
    v.group(segments, "segments", "line segments in the images");
  }
};

/// Places known again: loops, maps that meet, the way back into a map.
struct PlaceOptions {
  bool enabled = true;
  std::string vocabulary;
  double seek_time = 10;
  double seek_angle = 3;
  double seek_distance = 0.05;
  PlaceRecognizerOptions recognizer;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(enabled, "enabled", "", any_value(), "look in all maps for the place of each new keyframe");
    v(seek_time, "seek_time", "s", range(0, 1e6),
      "where twins are not feared, so long a new map that knows no way to the others looks closely for them: "
      "it gets a keyframe ...");
    v(seek_angle, "seek_angle", "deg", range(0.1, 180), "... at each such turn ...");
    v(seek_distance, "seek_distance", "m", range(0.001, 1000), "... or way");
    v(vocabulary, "vocabulary", "", any_value(),
      "file of the vocabulary, sweepkit's own format; none: the one that comes with the library");
    v.group(recognizer, "recognizer", "what is taken for the same place");
  }
};

/// What lies on the floor, and where there is none to drive on.
struct FloorStageOptions {
  bool enabled = false;
  double every = 0.2;
  FloorMountingOptions mounting;
  ObstacleDetectorOptions detector;
  GridStageOptions grid;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(enabled, "enabled", "", any_value(), "look for obstacles and map the floor, beside the frame path");
    v(every, "every", "s", range(0, 1e6), "an image so often");
    v.group(mounting, "mounting", "where the floor is, for a rig without wheels");
    v.group(detector, "detector", "obstacles");
    v.group(grid, "grid", "the floor's map");
  }
};

/// What the whole system may be told.
struct SweeperOptions {
  bool realtime = false;
  int image_queue = 2;
  int keyframe_queue = 2;
  double sample_wait = 0.02;
  double dark_level = 15;
  double map_scale_sigma = 0.003;
  int history = 36000;
  FrontendOptions frontend;
  TrackerOptions tracker;
  LocalMapperOptions mapper;
  OdometryBridgeOptions odometry;
  MainDirectionSearchOptions main_direction;
  PlaceOptions places;
  FloorStageOptions floor;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(realtime, "realtime", "", any_value(),
      "keep up with the clock: mapping in a thread of its own, images dropped when late; else every image in "
      "its turn");
    v(image_queue, "image_queue", "images", range(1, 1000),
      "images that may wait in real time before the oldest goes");
    v(keyframe_queue, "keyframe_queue", "keyframes", range(1, 100),
      "keyframes that may wait for mapping in real time before no more are made");
    v(sample_wait, "sample_wait", "s", range(0, 1),
      "how long an image waits in real time for wheel and IMU samples of its time");
    v(dark_level, "dark_level", "grey", range(0, 255), "a mean of the left image below is darkness");
    v(map_scale_sigma, "map_scale_sigma", "", range(0, 1),
      "how far the size of the whole map may be off, as a share; for the covariance of poses");
    v(history, "history", "images", range(0, 1e9),
      "whose poses are kept, the newest, with half a kB each; 0: all, as trajectories of a whole run need");
    v.group(frontend, "frontend", "from images to measurements");
    v.group(tracker, "tracker", "the pose of each frame");
    v.group(mapper, "mapper", "the map");
    v.group(odometry, "odometry", "wheels and IMU");
    v.group(main_direction, "main_direction", "the room's main direction, at the start");
    v.group(places, "places", "places known again");
    v.group(floor, "floor", "obstacles and the floor's map");
  }
};

/// An image and what became of it.
struct TrackedImage {
  TimeNs t = 0;
  SE3d T_map_body;                                 ///< as known at that moment
  SE3d T_odom_body;                                ///< the same in odom
  Mat6<double> covariance = Mat6<double>::Zero();  ///< as in BodyPose
  PoseBasis basis = PoseBasis::guess;
  int points = 0;           ///< map points tracked
  KeyframeId reference;     ///< keyframe that its pose follows when the map is corrected
  SE3d T_camera_reference;  ///< against that keyframe
};

/// Who wants to see each frame once it is tracked. Called in the frame path, in the thread that tracks: what
/// takes long here makes images late. Must not throw.
class FrameSink {
 public:
  virtual ~FrameSink() = default;
  /// @param image may lack one side; the frame then is that of an image before
  virtual void on_frame(const StereoImage& image, const StereoFrame& frame, const TrackedImage& tracked) = 0;
};

/// Counted over a run.
struct SweeperCounts {
  std::int64_t images = 0;           ///< processed, each with a pose
  std::int64_t images_lost = 0;      ///< of these, without a pose from vision once a map had begun
  std::int64_t images_dropped = 0;   ///< not processed: late in real time
  std::int64_t images_missing = 0;   ///< of one camera only
  std::int64_t samples_dropped = 0;  ///< refused: out of order, not finite, of a wrong size
  std::int64_t imu_samples = 0;
  std::int64_t wheel_samples = 0;
  std::int64_t keyframes_made = 0;
  std::int64_t loops_closed = 0;
  std::int64_t maps_joined = 0;
  std::int64_t loops_rejected = 0;  ///< recognized, but the rest of the map contradicted them
};

/// The whole system. Feeds may be called from any threads, one for each kind of sample; they never throw:
/// what cannot be used is counted, told as an event and dropped.
///
/// With `realtime` off an image is processed in the thread that feeds it, mapping included, before feed
/// returns: runs of the same binary on the same samples are identical to the bit. With `realtime` on, feed
/// returns at once; tracking and mapping have a thread each, a frame never waits for mapping, and images that
/// come faster than they can be tracked are dropped, the oldest first.
class Sweeper {
 public:
  /// @param events told of everything that happens, from any thread; must not throw; must outlive this; may
  /// be
  ///   null
  /// @param frames shown every frame; must outlive this; may be null
  /// Throws Error(option) if an option is out of range, Error(calibration) if the floor is asked for and
  /// nothing tells where it is. With cameras alone: samples of IMU and wheels are checked and counted, but
  /// nobody knows where they sit.
  explicit Sweeper(const StereoRig& rig, const SweeperOptions& options = {}, EventSink* events = nullptr,
                   FrameSink* frames = nullptr);
  /// With all sensors that there are. Throws Error(calibration) without two cameras.
  explicit Sweeper(const Rig& rig, const SweeperOptions& options = {}, EventSink* events = nullptr,
                   FrameSink* frames = nullptr);
  /// Ends without waiting for what is still queued.
  ~Sweeper();
  Sweeper(const Sweeper&) = delete;
  Sweeper& operator=(const Sweeper&) = delete;

  /// Goes on with the maps of another run, before the first sample. The run begins a map of its own, whose
  /// frame is that of its first pose; once a place is known again it is joined and the pose is in the frame
  /// of the atlas (events maps_joined and relocalized). Throws Error(data) that names the difference if the
  /// atlas was made with another rig, Error(argument) once samples were fed.
  void resume(Atlas&& atlas, const std::string& place = "atlas");
  /// Writes all maps for another run, in any state; mapping waits meanwhile, tracking does not. Throws
  /// Error(io). Thread-safe.
  void save_atlas(const std::string& path) const;

  void feed(const ImuSample& sample) noexcept;
  void feed(const WheelSample& sample) noexcept;
  void feed(StereoImage image) noexcept;

  /// The pose at any time from the first image kept (SweeperOptions::history) to the newest sample, also
  /// while others feed; waits for no tracking and no mapping. Between images along the constant twist from
  /// one to the next; after the last one as IMU or wheels tell, at their rate, and without them as it moved
  /// before. Nothing outside that time, and before the first image was tracked.
  std::optional<BodyPose> pose_at(TimeNs t, Frame frame = Frame::odom) const;

  /// Processes what is queued and stops all threads. What is fed later is dropped. Called by nobody else.
  void finish();

  const StereoRig& rig() const;
  const SweeperOptions& options() const;
  SweeperCounts counts() const;
  /// Every image so far, from number `first` on, also those dropped: their poses are guesses. Of older ones
  /// than SweeperOptions::history nothing is known any more.
  std::vector<TrackedImage> images(std::size_t first = 0) const;
  /// T_map_body of the image now, after all corrections of the map.
  SE3d optimized_pose(const TrackedImage& image) const;
  /// Times of the stages so far; thread-safe.
  const StageClock& stage_clock() const;
  /// The map; in real time only after finish.
  const Map& map() const;
  /// What is known of motion as of the last image: velocity, biases, the vertical, the wheels; nothing
  /// without IMU and wheels or before the first image. Thread-safe.
  std::optional<NavigationState> navigation() const;
  /// What became of the search for places known again; in real time only after finish.
  const PlaceCounts& place_counts() const;
  /// What lies on the floor, as of the newest image looked at; null before, and without floor.enabled.
  /// Thread-safe.
  std::shared_ptr<const ObstacleReport> obstacles() const;
  /// The floor as all images so far show it, in the map's frame as it is now; nothing without floor.enabled.
  /// Thread-safe; mapping waits meanwhile.
  std::optional<OccupancyImage> grid() const;
  /// The room's main direction, once it is found. Thread-safe.
  std::optional<MainDirection> main_direction() const;

 private:
  class Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace sweepkit
