// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <deque>
#include <optional>
#include <vector>

#include "sweepkit/core/options.hpp"
#include "sweepkit/motion/wheel_odometry.hpp"
#include "sweepkit/motion/wheel_track.hpp"

namespace sweepkit {

struct SlipOptions {
  double interval = 0.2;
  double enter = 25.0;
  double leave = 6.6;
  double calm = 0.4;
  double turn_share = 0.05;
  double turn_noise = 0.4;
  double forward_share = 0.04;
  double forward_noise = 0.003;
  double spin_share = 0.3;
  WheelDecoderOptions decoder;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(interval, "interval", "s", range(0.02, 5.0), "length of the turns compared with the gyro's");
    v(enter, "enter", "", range(1.0, 1e6), "squared error over its variance at which slip begins");
    v(leave, "leave", "", range(0.1, 1e6), "below which it is calm");
    v(calm, "calm", "s", range(0.0, 10.0), "how long it must be calm for slip to end");
    v(turn_share, "turn_share", "", range(0.0, 1.0), "error of a turn by the wheels, as a share");
    v(turn_noise, "turn_noise", "deg", range(1e-3, 90.0), "and whatever its size");
    v(forward_share, "forward_share", "", range(0.0, 1.0), "error of a distance by the wheels, as a share");
    v(forward_noise, "forward_noise", "m", range(1e-5, 1.0), "and whatever its size");
    v(spin_share, "spin_share", "", range(0.0, 1.0),
      "slip in which the robot moves less than that share of what the wheels roll is free spin");
    v.group(decoder, "decoder", "from wheel samples to distances");
  }
};

/// A time in which the wheels did not do what the robot did.
struct SlipEpisode {
  enum class Kind {
    slip,       ///< wheels and floor disagree
    free_spin,  ///< the wheels turn and the robot hardly moves, or hangs in the air
  };
  TimeNs begin = 0;
  TimeNs end = 0;
  Kind kind = Kind::slip;
  double rolled = 0.0;  ///< distance of the base by the wheels [m]
  double moved = 0.0;   ///< by vision, as far as it saw [m]
  double worst = 0.0;   ///< largest squared error over its variance
};

/// Notices slip from the wheels' turn against the gyro's, and their distance and turn against vision, each by
/// a chi-square test of one interval, with hysteresis: it begins with one error above `enter` and ends when
/// the test that began it has been below `leave` for `calm`, or the wheels rest that long. The wheels' own
/// error is taken as a share, which radii and track that are not calibrated explain. Not thread-safe.
class SlipDetector {
 public:
  SlipDetector(const WheelGeometry& geometry, const SE3d& T_body_base, const ImuNoise& noise = {},
               const SlipOptions& options = {});

  /// False if the sample is refused.
  bool add(const ImuSample& sample);
  bool add(const WheelSample& sample);
  /// The motion of the body by vision, between images some 0.1 to 1 s apart.
  void add_motion(TimeNs begin, TimeNs end, const UncertainMotion<double>& T_begin_end);
  void set_gyro_bias(const Vec3<double>& bias) { gyro_bias_ = bias; }
  void set_wheels(const WheelParameters& wheels) { wheels_ = wheels; }

  bool slipping() const { return open_.has_value(); }
  /// The one that lasts; nothing while there is none.
  const std::optional<SlipEpisode>& current() const { return open_; }
  /// Those that are over, in order of time.
  const std::vector<SlipEpisode>& episodes() const { return episodes_; }

 private:
  struct Motion {
    TimeNs begin, end;
    UncertainMotion<double> T;
  };
  enum class Test { gyro, vision };

  void compare();
  void compare_with_gyro(TimeNs begin, TimeNs end);
  void compare_with_vision(const Motion& motion);
  void judge(Test test, TimeNs begin, TimeNs end, double error, bool rolls);
  void close(TimeNs end);

  WheelGeometry geometry_;
  SE3d T_body_base_;
  SlipOptions options_;
  WheelTrack track_;
  WheelParameters wheels_;
  Vec3<double> gyro_bias_ = Vec3<double>::Zero();
  std::deque<Motion> waiting_;
  std::optional<TimeNs> compared_;
  std::optional<SlipEpisode> open_;
  std::vector<SlipEpisode> episodes_;
  Test opened_by_ = Test::gyro;
  bool seen_ = false;            // vision has looked during the open episode
  TimeNs loud_ = 0, rolls_ = 0;  // when the test that opened it last failed, when wheels last rolled
};

}  // namespace sweepkit
