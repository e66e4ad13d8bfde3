// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "sweepkit/core/options.hpp"
#include "sweepkit/data/camera_simulation.hpp"
#include "sweepkit/data/drive.hpp"
#include "sweepkit/data/imu_simulation.hpp"
#include "sweepkit/data/renderer.hpp"
#include "sweepkit/data/scene.hpp"
#include "sweepkit/data/source.hpp"
#include "sweepkit/data/wheel_simulation.hpp"

namespace sweepkit {

/// One camera of the simulated pair. Angles turn it from looking along the robot's x axis: first the yaw,
/// then the pitch, then the roll.
struct SimulatedCamera {
  std::vector<double> intrinsics = {347.0, 347.1, 318.2, 198.4};
  std::vector<double> coefficients = {-0.1012, 0.0204, -0.0003, 0.0004};
  std::vector<double> position = {0.125, 0.03, 0.081};
  double yaw_left_deg = 0.2;
  double pitch_down_deg = 3.0;
  double roll_deg = 0.3;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(intrinsics, "intrinsics", "px", range(-1e5, 1e5),
      "fx, fy, cx, cy; the centre of the first pixel is (0, 0)");
    v(coefficients, "coefficients", "", range(-100.0, 100.0), "of the distortion, as many as its model has");
    v(position, "position", "m", range(-1.0, 1.0),
      "x, y, z of the lens in the robot's base, within its outline");
    v(yaw_left_deg, "yaw_left_deg", "deg", range(-180.0, 180.0), "turned to the left");
    v(pitch_down_deg, "pitch_down_deg", "deg", range(-90.0, 90.0), "turned down");
    v(roll_deg, "roll_deg", "deg", range(-180.0, 180.0),
      "turned about its axis; positive: the right side down");
  }

  /// Where it sits: camera axes (x right, y down, z forward) in the base. @throws Error(option)
  SE3d T_base_camera() const;
};

/// The pair of cameras.
struct SimulatedCameras {
  static SimulatedCamera usual_right() {
    return {{346.2, 346.0, 321.6, 200.9},
            {-0.0994, 0.0208, -0.0002, -0.0003},
            {0.1248, -0.03, 0.0807},
            -0.15,
            3.3,
            -0.2};
  }

  int width = 640;
  int height = 400;
  double rate_hz = 10.0;
  double shutter_ms = 5.0;
  bool motion_blur = true;
  Distortion model = Distortion::radial_tangential;
  SimulatedCamera left;
  SimulatedCamera right = usual_right();
  ExposureOptions exposure;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(width, "width", "px", range(16, 8192), "of an image");
    v(height, "height", "px", range(16, 8192), "of an image");
    v(rate_hz, "rate_hz", "Hz", range(0.1, 1000.0), "pairs of images a second");
    v(shutter_ms, "shutter_ms", "ms", range(0.0, 100.0),
      "how long the shutter is open; the stamp is its middle");
    v(motion_blur, "motion_blur", "", any_value(), "draws what moves while the shutter is open");
    v.choice(model, "model",
             {{Distortion::none, "none"},
              {Distortion::radial_tangential, "radial-tangential"},
              {Distortion::equidistant, "equidistant"}},
             "distortion of both cameras");
    v.group(left, "left", "The left camera.");
    v.group(right, "right", "The right camera.");
    v.group(exposure, "exposure", "From light to grey levels.");
  }

  /// @throws Error(calibration)
  Camera camera(Side side) const;
};

/// All sensors.
struct SimulatedSensors {
  SimulatedCameras cameras;
  ImuSimulationOptions imu;
  WheelSimulationOptions wheels;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v.group(cameras, "cameras", "The pair of cameras.");
    v.group(imu, "imu", "The inertial unit, whose frame is the body frame.");
    v.group(wheels, "wheels", "Encoders of the drive wheels.");
  }

  /// The rig in the body frame, as the files of the recording tell it.
  Rig rig() const;
};

enum class ImageFormat { png, jpeg };

/// How a recording is made.
struct SimulationOptions {
  std::string save_path;
  int seed = 1;
  double duration = 0.0;
  ImageFormat format = ImageFormat::png;
  int jpeg_quality = 90;
  int depth_every = 20;
  double truth_rate_hz = 200.0;
  RobotOptions robot;
  SimulatedSensors sensors;
  RendererOptions renderer;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(save_path, "save_path", "", any_value(), "folder for the recording; appears when it is complete");
    v(seed, "seed", "", range(0, 2147483647), "of noise, biases and what a drive leaves to chance");
    v(duration, "duration", "s", range(0.0, 36000.0), "of the recording; 0: as long as the drive takes");
    v.choice(format, "format", {{ImageFormat::png, "png"}, {ImageFormat::jpeg, "jpeg"}}, "of images");
    v(jpeg_quality, "jpeg_quality", "", range(1, 100), "of JPEG images");
    v(depth_every, "depth_every", "", range(0, 1000000),
      "depth and labels of each so manieth left image; 0: of none");
    v(truth_rate_hz, "truth_rate_hz", "Hz", range(1.0, 10000.0),
      "true poses, velocities and biases a second");
    v.group(robot, "robot", "The robot's body and drive.");
    v.group(sensors, "sensors", "What it carries.");
    v.group(renderer, "renderer", "How images are drawn.");
  }
};

/// Something that happens at a given time, beside what disturbs the drive.
struct SceneEvent {
  enum class Kind {
    dark,           ///< lamps and daylight go down to `level`
    exposure_step,  ///< the automatic exposure jumps by `factor` at `begin`
    person,         ///< somebody walks along `path` at even pace
    missing,        ///< samples of `sensor` are lost, a `share` of them
    late,           ///< samples of `sensor` are stamped `delay` after their time
  };
  enum class Sensor { cameras, left, right, imu, wheels };
  Kind kind = Kind::dark;
  double begin = 0.0;  ///< [s] from the beginning of the recording
  double end = 0.0;    ///< [s]
  double level = 0.004;
  double factor = 1.35;
  std::vector<Vec2<double>> path;  ///< in the world
  Sensor sensor = Sensor::cameras;
  double share = 1.0;
  double delay = 0.03;  ///< [s]
  std::string place;    ///< where it is written, for errors
};

/// A flat and what happens in it.
struct SimulatedScene {
  Scene scene;
  DriveScript script;
  std::vector<DriveDisturbance> disturbances;
  std::vector<SceneEvent> events;
};

/// Reads a scene file: the world as read_scene does, and the keys `robot` and `sensors` (options of
/// SimulationOptions, which are set), `drive` and `events`.
/// @throws Error(io, data, option) with file and line: unknown keys, wrong values
SimulatedScene read_simulated_scene(const std::filesystem::path& file, SimulationOptions& options);

/// The same from text. @param name stands in errors where the file would
SimulatedScene parse_simulated_scene(const std::string& text, const std::string& name,
                                     SimulationOptions& options);

/// What the program that simulates sees of it.
struct SimulationHooks {
  std::function<bool()> interrupted;                  ///< true: stop and leave nothing behind
  std::function<void(int done, int total)> progress;  ///< stereo images
};

struct SimulationResult {
  bool stopped = false;
  int frames = 0;         ///< stereo images
  double duration = 0.0;  ///< [s]
  double path_m = 0.0;    ///< of the base, without what it was carried
  double seconds = 0.0;   ///< that it took
  double drawing = 0.0;   ///< of these for images, from the first to the last [s]
};

/// Makes a recording in EuRoC's layout with `odom0`, `depth0`, truth of poses, velocities and biases,
/// `truth.yaml`, `floor_occupancy`, `plan.svg` and `contact_sheet.png`. All chance comes from options.seed;
/// files are the same for every number of threads. The folder gets its name when it is complete; a simulated
/// recording of that name is replaced.
/// @throws Error(data, calibration, option) for a drive, event or rig that cannot be; Error(io) if it cannot
/// be
///   written: nothing is left then
SimulationResult simulate(const SimulatedScene& scene, const SimulationOptions& options,
                          const SimulationHooks& hooks = {});

}  // namespace sweepkit
