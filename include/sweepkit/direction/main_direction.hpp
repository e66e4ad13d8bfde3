// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "sweepkit/core/options.hpp"
#include "sweepkit/core/time.hpp"
#include "sweepkit/direction/manhattan_frame.hpp"
#include "sweepkit/geometry/stereo_rig.hpp"

namespace sweepkit {

/// The angle modulo 90 degrees in (-45, 45] degrees [rad].
double wrap_quarter_turn(double angle);

struct MainDirectionOptions {
  int window = 50;
  double threshold = 0.5;
  double inlier_tolerance = 1.5;
  double stereo_tolerance = 2.0;
  double min_frame_confidence = 0.8;
  double min_collected_share = 0.3;
  double max_drift = 6.0;
  double max_sigma = 0.5;
  ManhattanOptions manhattan = in_rooms();

  /// Edges of rooms are long, those of what stands about in them, and of its patterns, many and short: here
  /// length counts without a limit.
  static ManhattanOptions in_rooms() {
    ManhattanOptions options;
    options.segments.full_length = 300;
    return options;
  }

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(window, "window", "frames", range(1, 100000), "stereo frames of a window, N");
    v(threshold, "threshold", "", range(0.0, 1.0),
      "a window with a confidence below this is thrown away and the next begins; exactly this is accepted");
    v(inlier_tolerance, "inlier_tolerance", "deg", range(0.01, 20.0),
      "directions of a window that lie within this of the answer are its inliers");
    v(stereo_tolerance, "stereo_tolerance", "deg", range(0.01, 20.0),
      "by how much the directions of the two cameras may differ");
    v(min_frame_confidence, "min_frame_confidence", "", range(0.0, 1.0),
      "a camera whose own confidence is lower says nothing");
    v(min_collected_share, "min_collected_share", "", range(0.0, 1.0),
      "share of a window's frames that must have a direction for an answer");
    v(max_drift, "max_drift", "deg/s", range(0.0, 90.0), "largest drift of the yaw that is looked for");
    v(max_sigma, "max_sigma", "deg", range(0.0, 45.0),
      "largest standard error of an answer, directions being 0.6 deg off each: more where few of them fix a "
      "drift");
    v.group(manhattan, "manhattan", "the main direction in one image");
  }
};

/// What one camera sees of the main direction.
struct CameraDirection {
  bool found = false;
  double angle = 0;       ///< see FrameDirection [rad]
  double sigma = 0;       ///< standard deviation from the segments alone [rad]
  double confidence = 0;  ///< of the Manhattan frame
  double support = 0;     ///< weight of the horizontal segments along it
};

/// What is known of the rate at which a yaw drifts: a gyro's bias that is left in.
struct YawDrift {
  double rate = 0;   ///< of the yaw that is given, over that of the true one [rad/s]
  double sigma = 0;  ///< its standard deviation; 0: exact [rad/s]
};

/// What one stereo frame says of the main direction. Angles are counter-clockwise, seen from above, from the
/// left camera's forward axis to the nearest axis of the room, in (-45, 45] degrees; also those of the right
/// camera, so that both can be compared.
struct FrameDirection {
  TimeNs t = 0;
  double yaw = 0;  ///< of the left camera's forward axis in odometry, counter-clockwise from above [rad]
  YawDrift drift;  ///< of `yaw`, as known at t
  CameraDirection left;
  CameraDirection right;
};

/// An accepted window.
struct MainDirection {
  TimeNs window_begin = 0;  ///< stamp of the window's first frame
  double angle = 0;         ///< at that frame [rad], in (-45, 45] degrees
  double confidence = 0;    ///< inliers over directions collected
  TimeNs run_begin = 0;     ///< stamp of the run's first frame
  double run_angle = 0;     ///< at that frame [rad]
  TimeNs window_end = 0;    ///< stamp of the window's last frame: when the answer was known
  int frames = 0;           ///< of the window
  int collected = 0;        ///< frames that had a direction in both cameras that agree
  int inliers = 0;
  double drift = 0;  ///< of the yaw, as the directions tell [rad/s]
  double sigma = 0;  ///< standard error of `angle`, the inliers being independent [rad]
};

/// Turns segments into a FrameDirection. Not thread-safe.
class FrameDirectionFinder {
 public:
  FrameDirectionFinder(const StereoRig& rig, const MainDirectionOptions& options = {});

  const MainDirectionOptions& options() const { return options_; }

  /// @param R_world_body orientation of the body in a frame whose z axis is up and whose yaw is smooth
  /// (odometry). A camera that looks up or down within 10 degrees of the vertical has no direction.
  FrameDirection find(TimeNs t, std::span<const LineSegment> left, std::span<const LineSegment> right,
                      const SO3d& R_world_body, const YawDrift& drift = {});

  /// Of the last find, for each segment of a side: 0 or 2 along the one or the other horizontal axis of the
  /// room, 1 vertical, -1 none.
  std::span<const std::int8_t> labels(Side side) const { return labels_[static_cast<int>(side)]; }

 private:
  StereoRig rig_;
  MainDirectionOptions options_;
  ManhattanEstimator estimator_;
  std::vector<InterpretationPlane> planes_;
  std::array<std::vector<std::int8_t>, 2> labels_;
};

/// The direction that both cameras of a frame agree on, modulo 90 degrees [rad], the mean weighted by their
/// variances; nothing if one found none, is too little confident, or they differ by more than the tolerance.
std::optional<double> agreed_direction(const FrameDirection& frame, const MainDirectionOptions& options);

/// Collects windows of frames and says the main direction when one is good: RANSAC over the window's
/// directions, each carried to its first frame by the yaw of odometry. Where the drift of that yaw is not
/// known well, it is estimated with the direction: two directions are a hypothesis then, else one. The
/// inliers' least squares are the answer.
class MainDirectionWindow {
 public:
  explicit MainDirectionWindow(const MainDirectionOptions& options = {});

  const MainDirectionOptions& options() const { return options_; }

  /// Takes the next frame. Gives the answer with the last frame of a window that is accepted; the next frame
  /// begins a new window in any case.
  std::optional<MainDirection> add(const FrameDirection& frame);

  /// Windows thrown away so far.
  int restarts() const { return restarts_; }
  /// Confidence of the last complete window, accepted or not; 0 before.
  double last_confidence() const { return last_confidence_; }

 private:
  struct Collected {
    double seconds;  // since the window's first frame
    double angle;    // carried to it by the yaw as given
  };
  struct Line {
    double angle = 0;  // at the window's first frame
    double drift = 0;
  };

  double residual(const Collected& c, const Line& line) const;
  Line consensus(const YawDrift& drift) const;
  void fit(Line& line, const YawDrift& drift, MainDirection& result) const;
  std::optional<MainDirection> close();

  MainDirectionOptions options_;
  std::optional<FrameDirection> run_first_;
  FrameDirection first_, last_;
  int frames_ = 0;
  int restarts_ = 0;
  double last_confidence_ = 0;
  std::vector<Collected> collected_;
};

/// Both stages: what a program or a robot feeds.
class MainDirectionEstimator {
 public:
  MainDirectionEstimator(const StereoRig& rig, const MainDirectionOptions& options = {})
      : finder_(rig, options), window_(options) {}

  /// As FrameDirectionFinder::find and MainDirectionWindow::add.
  std::optional<MainDirection> add(TimeNs t, std::span<const LineSegment> left,
                                   std::span<const LineSegment> right, const SO3d& R_world_body,
                                   const YawDrift& drift = {}) {
    last_ = finder_.find(t, left, right, R_world_body, drift);
    return window_.add(last_);
  }

  const FrameDirectionFinder& finder() const { return finder_; }
  const MainDirectionWindow& window() const { return window_; }
  const FrameDirection& last() const { return last_; }  ///< of the last frame

 private:
  FrameDirectionFinder finder_;
  MainDirectionWindow window_;
  FrameDirection last_;
};

/// The first answer of a run that begins with frames[start], or nothing: what a study of the options replays.
std::optional<MainDirection> first_main_direction(std::span<const FrameDirection> frames,
                                                  const MainDirectionOptions& options);

}  // namespace sweepkit
