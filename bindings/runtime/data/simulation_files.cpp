// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "simulation_files.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numbers>

namespace sweepkit {
namespace {

constexpr double kDeg = 180.0 / std::numbers::pi;

std::string matrix_text(const SE3d& T) {
  std::string text = "T_BS:\n  cols: 4\n  rows: 4\n  data: [";
  const Eigen::Matrix4d m = T.matrix();
  for (int i = 0; i < 16; ++i)
    text += fmt::format("{:.12g}{}", m(i / 4, i % 4), i == 15 ? "]\n" : i % 4 == 3 ? ",\n         " : ", ");
  return text;
}

std::string list_text(const std::vector<double>& values) {
  std::string text;
  for (const double value : values) text += fmt::format("{}{:.9g}", text.empty() ? "" : ", ", value);
  return "[" + text + "]";
}

// A scalar that any YAML reader takes for this text.
std::string quoted(const std::string& text) {
  std::string out = "'";
  for (const char c : text) out += c == '\'' ? std::string("''") : std::string(1, c);
  return out + "'";
}

double modulo_90(double degrees) {
  const double m = std::fmod(degrees, 90.0);
  return m < 0.0 ? m + 90.0 : m;
}

// A camera against the floor that the robot stands on.
struct Mounting {
  double height, pitch_down, roll, yaw_left;
  Vec3<double> normal;  // of the floor, in the camera

  explicit Mounting(const SE3d& T_base_camera) {
    normal = T_base_camera.rotation().inverse() * Vec3<double>(0, 0, 1);
    const Vec3<double> ahead = T_base_camera.rotation() * Vec3<double>(0, 0, 1);
    height = T_base_camera.translation().z();
    pitch_down = -std::asin(std::clamp(ahead.z(), -1.0, 1.0)) * kDeg;
    yaw_left = std::atan2(ahead.y(), ahead.x()) * kDeg;
    roll = std::atan2(-normal.x(), -normal.y()) * kDeg;
  }
  std::string text() const {
    return fmt::format("{{height_m: {:.5f}, pitch_down_deg: {:.4f}, roll_deg: {:.4f}, yaw_left_deg: {:.4f}}}",
                       height, pitch_down, roll, yaw_left);
  }
};

std::string room_text(const Scene& scene, const Room& room) {
  std::vector<Vec2<double>> corners;
  // No -0.000 from rounding.
  for (const auto& corner : room.corners)
    corners.push_back((1e6 * scene.from_world(corner)).array().round() / 1e6 + 0.0);
  Vec2<double> low = corners[0], high = corners[0];
  for (const auto& c : corners) low = low.cwiseMin(c), high = high.cwiseMax(c);
  const bool is_rectangle =
      corners.size() == 4 && std::all_of(corners.begin(), corners.end(), [&](const auto& c) {
        return std::min(std::abs(c.x() - low.x()), std::abs(c.x() - high.x())) < 1e-6 &&
               std::min(std::abs(c.y() - low.y()), std::abs(c.y() - high.y())) < 1e-6;
      });
  std::string text = fmt::format("    - {{name: {}, rect: [{:.3f}, {:.3f}, {:.3f}, {:.3f}]", room.name,
                                 low.x(), low.y(), high.x(), high.y());
  if (!is_rectangle) {
    text += ", corners: [";
    for (std::size_t i = 0; i < corners.size(); ++i)
      text += fmt::format("{}[{:.3f}, {:.3f}]", i ? ", " : "", corners[i].x(), corners[i].y());
    text += "]";
  }
  return text + "}\n";
}

}  // namespace

std::string camera_yaml(const SimulatedScene& scene, const SimulatedSensors& sensors, Side side) {
  const Camera camera = sensors.cameras.camera(side);
  const Rig rig = sensors.rig();
  const bool left = side == Side::left;
  std::string text =
      fmt::format("# {}, camera {}\nsensor_type: camera\ncomment: simulated grey global-shutter camera\n\n",
                  scene.scene.name, left ? "0 (left)" : "1 (right)");
  text += matrix_text((left ? rig.left : rig.right)->T_body_camera);
  text += fmt::format("\nrate_hz: {:g}\nresolution: [{}, {}]\ncamera_model: pinhole\n",
                      sensors.cameras.rate_hz, camera.width(), camera.height());
  text += fmt::format("intrinsics: {} #fu, fv, cu, cv\n", list_text(camera.intrinsics()));
  // Without distortion: as the model that everybody knows.
  const bool none = camera.distortion() == Distortion::none;
  text += fmt::format("distortion_model: {}\n", none ? "radial-tangential" : to_string(camera.distortion()));
  text += "distortion_coefficients: " +
          list_text(none ? std::vector<double>{0, 0, 0, 0} : camera.coefficients()) + "\n";
  return text;
}

std::string imu_yaml(const SimulatedScene& scene, const ImuSimulationOptions& imu) {
  return fmt::format(
      "# {}\nsensor_type: imu\ncomment: simulated MEMS IMU, the body frame\n\n{}\nrate_hz: {:g}\n# densities "
      "(continuous time)\ngyroscope_noise_density: {:g}     # [ rad / s / sqrt(Hz) ]\ngyroscope_random_walk: "
      "{:g}       "
      "# [ rad / s^2 / sqrt(Hz) ]\naccelerometer_noise_density: {:g}  # [ m / s^2 / sqrt(Hz) "
      "]\naccelerometer_random_walk: {:g}    # [ m / s^3 / sqrt(Hz) ]\n",
      scene.scene.name, matrix_text(SE3d()), imu.rate_hz, imu.gyro_noise_density, imu.gyro_random_walk,
      imu.accel_noise_density, imu.accel_random_walk);
}

std::string wheels_yaml(const SimulatedScene& scene, const SimulatedSensors& sensors) {
  const WheelSimulationOptions& wheels = sensors.wheels;
  return fmt::format(
      "# {}\nsensor_type: wheel_odometry\ncomment: cumulative encoder ticks of the two drive wheels; the "
      "sensor frame S is "
      "the robot base (x forward, y left, z up, on the floor between the drive wheels)\n\n{}\nrate_hz: "
      "{:g}\nticks_per_revolution: {:g}\nwheel_radius: {:g}   # [m] nominal\ntrack_width: {:g}   # [m] "
      "nominal\n",
      scene.scene.name, matrix_text(sensors.rig().wheels->T_body_base), wheels.rate_hz,
      wheels.ticks_per_revolution, wheels.wheel_radius, wheels.track_width);
}

std::string depth_yaml(int every) {
  return fmt::format(
      "sensor_type: depth_truth\ncomment: true z-depth of every pixel of the unrectified left camera (cam0), "
      "16 bit, 0 = "
      "none or farther than 6.5535 m; labels are 8 bit class images of the same frames\ndepth_unit: 0.0001  "
      "# "
      "[m]\nevery_nth_frame: {}\nlabels: {{0: background, 1: floor, 2: carpet, 3: furniture, 10: "
      "shuttlecock, 11: cable, 12: "
      "mahjong, 13: pet_waste, 14: small_obstacle, 20: moving}}\n",
      every);
}

double driven_length(const Drive& drive) {
  constexpr double kStep = 0.01;
  double length = 0.0;
  for (double t = 0.5 * kStep; t < drive.base.duration(); t += kStep) {
    const bool carried = std::any_of(drive.events.begin(), drive.events.end(), [&](const TimedEvent& e) {
      return e.kind == "lifted" && t >= e.begin && t <= e.end;
    });
    if (!carried) length += kStep * drive.base.at(t).velocity.norm();
  }
  return length;
}

std::string truth_yaml(const SimulatedScene& scene, const SimulationOptions& options, const Drive& drive,
                       const std::vector<TimedEvent>& events, int frames, double first_frame) {
  const Scene& flat = scene.scene;
  const SimulatedSensors& sensors = options.sensors;
  const SE3d T_base_left = sensors.cameras.left.T_base_camera();
  const Mounting left(T_base_left), right(sensors.cameras.right.T_base_camera());
  const SE3d T_world_left = drive.base.pose(first_frame) * T_base_left;
  const Mounting first(T_world_left);
  const ImuSimulationOptions& imu = sensors.imu;
  const WheelSimulationOptions& wheels = sensors.wheels;
  const ExposureOptions& exposure = sensors.cameras.exposure;

  std::string out = fmt::format(
      "# Truth of {}. World frame R: z up, floor z = 0. Body frame = IMU. Angles in degrees, lengths in m, "
      "times in s from "
      "start_time.\nname: {}\n",
      flat.name, quoted(flat.name));
  out += fmt::format(
      "start_time_ns: {}\nduration_s: {:.3f}\nframes: {}\nfirst_frame_s: {:g}\ngravity: [0, 0, {:.4f}]\n",
      kSimulationBegin, drive.base.duration(), frames, first_frame, -imu.gravity);
  out += fmt::format("path_length_m: {:.3f}   # base, without the parts carried through the air\n",
                     driven_length(drive));
  std::optional<double> direction;
  for (const Room& room : flat.rooms)
    if (!direction) direction = flat.main_direction(room);
  if (direction) {
    const double main = *direction * kDeg;
    out += fmt::format(
        "main_direction:\n  yaw_world_deg: {:.4f}          # direction of the rooms' walls in the world "
        "frame, modulo 90\n  "
        "yaw_from_left_camera_frame0_deg: {:.4f}   # the same, counter-clockwise from the left camera's "
        "forward axis "
        "(projected on the floor) at frame 0, modulo 90\n  left_camera_yaw_frame0_world_deg: {:.4f}\n",
        modulo_90(main), modulo_90(main - first.yaw_left), first.yaw_left);
  }
  const auto plane = [](const Mounting& m) {
    return fmt::format("[{:.8f}, {:.8f}, {:.8f}, {:.6f}]", m.normal.x(), m.normal.y(), m.normal.z(),
                       m.height);
  };
  out += fmt::format(
      "floor_plane:\n  world: [0, 0, 1, 0]           # n.p + d = 0\n  left_camera_nominal: {}   # standing "
      "level on the bare "
      "floor, camera axes (x right, y down, z forward)\n  left_camera_frame0: {}\ncamera0_mounting: "
      "{}\ncamera1_mounting: "
      "{}\n",
      plane(left), plane(first), left.text(), right.text());
  out +=
      "base_frame: {comment: 'robot base, x forward, y left, z up, on the floor between the drive wheels'}\n";
  out += matrix_text(sensors.rig().wheels->T_body_base);
  out += fmt::format(
      "wheels: {{true_radius_left_m: {:.7f}, true_radius_right_m: {:.7f}, true_track_width_m: {:.6f}, "
      "nominal_radius_m: "
      "{:.6f}, nominal_track_width_m: {:.6f}, ticks_per_revolution: {:g}}}\n",
      wheels.true_radius_left(), wheels.true_radius_right(), wheels.true_track(), wheels.wheel_radius,
      wheels.track_width, wheels.ticks_per_revolution);
  out += fmt::format(
      "noise:\n  gyro_density: {:g}\n  gyro_random_walk: {:g}\n  accel_density: {:g}\n  accel_random_walk: "
      "{:g}\n  "
      "image_read_sigma_grey: {:g}\n  image_shot_variance_per_grey: {:g}\n  image_sigma_at_100_grey: "
      "{:.3f}\n  "
      "exposure_ms: {:g}\n  vignetting: {:g}\n",
      imu.gyro_noise_density, imu.gyro_random_walk, imu.accel_noise_density, imu.accel_random_walk,
      exposure.read_noise, exposure.shot_noise,
      std::sqrt(exposure.read_noise * exposure.read_noise + 100.0 * exposure.shot_noise),
      sensors.cameras.shutter_ms, exposure.vignetting);
  if (options.format == ImageFormat::jpeg) out += fmt::format("  jpeg_quality: {}\n", options.jpeg_quality);

  out += fmt::format(
      "rooms:   # rectangles in the flat's own axes; world = Rz(flat_yaw) * flat + flat_origin\n  "
      "flat_yaw_deg: {:.4f}\n  "
      "flat_origin: [{:.4f}, {:.4f}]\n  list:\n",
      flat.yaw * kDeg, flat.origin.x(), flat.origin.y());
  for (const Room& room : flat.rooms) out += room_text(flat, room);
  out += flat.doors.empty() ? "  doors: []\n" : "  doors:\n";
  for (const Door& door : flat.doors)
    out += fmt::format(
        "    - {{between: [{}, {}], centre_world: [{:.3f}, {:.3f}], width: {:.3f}, sill_m: {:.4f}}}\n",
        door.from, door.to, door.centre.x(), door.centre.y(), door.width, door.sill);
  const std::vector<ObjectTruth> objects = object_truth(flat);
  out +=
      objects.empty()
          ? "objects: []\n"
          : "objects:   # bounding box: centre in the world frame, size along the object's own axes, yaw of "
            "these axes\n";
  for (const ObjectTruth& o : objects)
    out += fmt::format(
        "  - {{class: {}, name: {}, label: {}, centre: [{:.4f}, {:.4f}, {:.4f}], size: [{:.4f}, {:.4f}, "
        "{:.4f}], yaw_deg: "
        "{:.2f}}}\n",
        o.object_class, o.name, static_cast<int>(o.label), o.centre.x(), o.centre.y(), o.centre.z(),
        o.size.x(), o.size.y(), o.size.z(), o.yaw * kDeg);
  out += events.empty() ? "events: []\n" : "events:\n";
  for (const TimedEvent& e : events)
    out +=
        fmt::format("  - {{kind: {}, t_start: {:.2f}, t_end: {:.2f}, start_ns: {}, end_ns: {}, note: {}}}\n",
                    e.kind, e.begin, e.end, kSimulationBegin + from_seconds(e.begin),
                    kSimulationBegin + from_seconds(e.end), quoted(e.note));
  return out;
}

}  // namespace sweepkit
