// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/data/simulate.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <numbers>
#include <opencv2/imgproc.hpp>

#include "recording_writer.hpp"
#include "simulation_files.hpp"
#include "smooth_step.hpp"
#include "sweepkit/core/parallel.hpp"
#include "sweepkit/core/random.hpp"
#include "sweepkit/data/scene_plot.hpp"

namespace sweepkit {
namespace {

using Seconds = std::chrono::duration<double>;

constexpr double kRad = std::numbers::pi / 180.0;
constexpr double kFirstFrame = 0.05;  // [s]

double seconds_since(std::chrono::steady_clock::time_point t) {
  return Seconds(std::chrono::steady_clock::now() - t).count();
}

// Independent streams of chance from one seed.
enum class Chance : std::uint64_t { drive, imu, wheels, image_left, image_right, missing };
std::uint64_t seed_of(int seed, Chance what, std::uint64_t index = 0) {
  return (static_cast<std::uint64_t>(seed) << 40) ^ (static_cast<std::uint64_t>(what) << 36) ^ index;
}

// What samples of a sensor go through on their way into a file: some are lost, some stamped late.
class Delivery {
 public:
  Delivery(const std::vector<SceneEvent>& events, std::initializer_list<SceneEvent::Sensor> sensors,
           std::uint64_t seed)
      : random_(seed) {
    for (const SceneEvent& event : events)
      if (std::find(sensors.begin(), sensors.end(), event.sensor) != sensors.end() &&
          (event.kind == SceneEvent::Kind::missing || event.kind == SceneEvent::Kind::late))
        events_.push_back(&event);
  }

  // The stamp in the file, or nothing; to be asked in the order of time.
  std::optional<TimeNs> stamp(TimeNs t) {
    const double s = to_seconds(t - kSimulationBegin);
    TimeNs late = 0;
    bool lost = false;
    for (const SceneEvent* e : events_) {
      if (s < e->begin || s >= e->end) continue;
      if (e->kind == SceneEvent::Kind::late) late += from_seconds(e->delay);
      if (e->kind == SceneEvent::Kind::missing && random_.uniform() < e->share) lost = true;
    }
    if (lost) return std::nullopt;
    // What was late is not overtaken.
    last_ = std::max(t + late, last_ + 1);
    return last_;
  }

 private:
  std::vector<const SceneEvent*> events_;
  Random random_;
  TimeNs last_ = 0;
};

// How bright lamps and daylight are.
double brightness(const std::vector<SceneEvent>& events, double t) {
  double level = 1.0;
  constexpr double kSwitch = 0.06;  // [s]
  for (const SceneEvent& e : events)
    if (e.kind == SceneEvent::Kind::dark)
      level *=
          1.0 + smooth_step((t - e.begin) / kSwitch) * smooth_step((e.end - t) / kSwitch) * (e.level - 1.0);
  return level;
}

// Somebody who walks along a chain of points.
class Walker {
 public:
  explicit Walker(const SceneEvent& event) : event_(event), length_(0.0) {
    for (std::size_t i = 1; i < event.path.size(); ++i) length_ += (event.path[i] - event.path[i - 1]).norm();
  }

  std::optional<SE3d> pose(double t) const {
    if (t < event_.begin || t > event_.end) return std::nullopt;
    double s = length_ * (t - event_.begin) / (event_.end - event_.begin);
    std::size_t i = 1;
    while (i + 1 < event_.path.size() && s > (event_.path[i] - event_.path[i - 1]).norm())
      s -= (event_.path[i] - event_.path[i - 1]).norm(), ++i;
    const Vec2<double> d = (event_.path[i] - event_.path[i - 1]).normalized();
    const Vec2<double> p = event_.path[i - 1] + s * d;
    return SE3d(SO3d::exp({0, 0, std::atan2(d.y(), d.x())}), {p.x(), p.y(), 0.0});
  }
  // Of the stride, at a time.
  double phase(double t) const {
    constexpr double kStride = 1.5;  // [m]
    return length_ * (t - event_.begin) / (event_.end - event_.begin) / kStride;
  }
  const SceneEvent& event() const { return event_; }

 private:
  SceneEvent event_;
  double length_;
};

std::vector<Walker> walkers_of(const SimulatedScene& scene, const Drive& drive, const RobotOptions& robot) {
  std::vector<Walker> walkers;
  for (const SceneEvent& event : scene.events)
    if (event.kind == SceneEvent::Kind::person) walkers.emplace_back(event);
  for (const Walker& walker : walkers)
    for (double t = 0.0; t <= drive.base.duration(); t += 0.02) {
      const auto person = walker.pose(t);
      if (!person) continue;
      const SE3d base = drive.base.pose(t);
      const double gap = (person->translation() - base.translation()).head<2>().norm();
      if (gap < robot.radius + 0.3) {
        const Vec2<double> p = scene.scene.from_world(base.translation().head<2>());
        throw Error(
            ErrorKind::data, walker.event().place,
            fmt::format("the person walks into the robot, which is at [{:.2f}, {:.2f}] of the file's frame "
                        "after {:.1f} s",
                        p.x(), p.y(), t));
      }
    }
  return walkers;
}

void check_rig(const SimulationOptions& options) {
  const SimulatedCameras& cameras = options.sensors.cameras;
  for (const auto& [name, camera] : {std::pair("left", &cameras.left), {"right", &cameras.right}}) {
    const std::string place = fmt::format("sensors.cameras.{}.position", name);
    const SE3d T = camera->T_base_camera();
    if (T.translation().head<2>().norm() > options.robot.radius)
      throw Error(ErrorKind::calibration, place,
                  "lies outside the robot's outline: the camera would look through things",
                  number_text(T.translation().head<2>().norm()));
    if (T.translation().z() < 0.005)
      throw Error(ErrorKind::calibration, place, "lies in the floor", number_text(T.translation().z()));
  }
  options.sensors.rig().stereo();
}

std::vector<TimedEvent> all_events(const SimulatedScene& scene, const Drive& drive) {
  std::vector<TimedEvent> events = drive.events;
  static const std::array<const char*, 5> kSensors = {"both cameras", "the left camera", "the right camera",
                                                      "the IMU", "the wheels"};
  for (const SceneEvent& e : scene.events) {
    if (e.begin >= drive.base.duration()) continue;
    const double end = std::min(e.end, drive.base.duration());
    const char* sensor = kSensors[static_cast<std::size_t>(e.sensor)];
    switch (e.kind) {
      case SceneEvent::Kind::dark:
        events.push_back({"dark", e.begin, end, fmt::format("light goes down to {:g}", e.level)});
        break;
      case SceneEvent::Kind::exposure_step:
        events.push_back(
            {"exposure_step", e.begin, end, fmt::format("auto exposure jumps by a factor {:g}", e.factor)});
        break;
      case SceneEvent::Kind::person:
        events.push_back({"moving_person", e.begin, end, "walks through"});
        break;
      case SceneEvent::Kind::missing:
        events.push_back(
            {"missing", e.begin, end, fmt::format("{:g} % of the samples of {}", 100.0 * e.share, sensor)});
        break;
      case SceneEvent::Kind::late:
        events.push_back(
            {"late", e.begin, end, fmt::format("samples of {} are stamped {:g} s late", sensor, e.delay)});
        break;
    }
  }
  std::stable_sort(events.begin(), events.end(),
                   [](const TimedEvent& a, const TimedEvent& b) { return a.begin < b.begin; });
  return events;
}

// Images of a pair of cameras, drawn in small batches: radiance by the renderer, then exposure from image to
// image, then noise, coding and writing of all at once.
class ImageMaker {
 public:
  ImageMaker(const SimulatedScene& scene, const SimulationOptions& options, const Drive& drive,
             FolderWriter& folder)
      : scene_(scene),
        options_(options),
        drive_(drive),
        folder_(folder),
        cameras_{options.sensors.cameras.camera(Side::left), options.sensors.cameras.camera(Side::right)},
        T_base_camera_{options.sensors.cameras.left.T_base_camera(),
                       options.sensors.cameras.right.T_base_camera()},
        rays_{RayTable(cameras_[0], options.renderer.samples),
              RayTable(cameras_[1], options.renderer.samples)},
        exposures_{Exposure(cameras_[0], options.sensors.cameras.exposure),
                   Exposure(cameras_[1], options.sensors.cameras.exposure)},
        automatic_(options.sensors.cameras.exposure),
        walkers_(walkers_of(scene, drive, options.robot)),
        renderer_(scene.scene, options.renderer) {
    const double interval = 1.0 / options.sensors.cameras.rate_hz;
    const double last = drive.base.duration() - 0.5e-3 * options.sensors.cameras.shutter_ms;
    while (kFirstFrame + interval * static_cast<double>(times_.size()) <= last + 1e-9)
      times_.push_back(kFirstFrame + interval * static_cast<double>(times_.size()));
    for (const char* name : {"mav0/cam0/data", "mav0/cam1/data"}) folder_.make_folder(name);
    if (options.depth_every > 0)
      for (const char* name : {"mav0/depth0/data", "mav0/depth0/labels"}) folder_.make_folder(name);
  }

  int count() const { return static_cast<int>(times_.size()); }

  // False if it was interrupted.
  bool make(const SimulationHooks& hooks) {
    using enum SceneEvent::Sensor;
    // Losses that hit both cameras are the same ones.
    std::array<Delivery, 2> both = {
        Delivery(scene_.events, {cameras}, seed_of(options_.seed, Chance::missing, 0)),
        Delivery(scene_.events, {cameras}, seed_of(options_.seed, Chance::missing, 0))};
    std::array<Delivery, 2> alone = {
        Delivery(scene_.events, {left}, seed_of(options_.seed, Chance::missing, 1)),
        Delivery(scene_.events, {right}, seed_of(options_.seed, Chance::missing, 2))};
    std::array<std::string, 2> lists = {"#timestamp [ns],filename\n", "#timestamp [ns],filename\n"};
    std::string depth_list = "#timestamp [ns],depth filename,label filename\n";
    const std::size_t pixels =
        static_cast<std::size_t>(cameras_[0].width()) * static_cast<std::size_t>(cameras_[0].height());
    const std::size_t batch = std::clamp<std::size_t>((std::size_t{96} << 20) / (pixels * 20), 1, 8);
    std::vector<std::array<Frame, 2>> frames(std::min(batch, std::max<std::size_t>(times_.size(), 1)));
    const char* suffix = options_.format == ImageFormat::png ? "png" : "jpg";

    for (std::size_t first = 0; first < times_.size(); first += frames.size()) {
      const std::size_t size = std::min(frames.size(), times_.size() - first);
      for (std::size_t k = 0; k < size; ++k) {
        if (hooks.interrupted && hooks.interrupted()) return false;
        const std::size_t index = first + k;
        const TimeNs t = kSimulationBegin + from_seconds(times_[index]);
        for (std::size_t side = 0; side < 2; ++side) {
          Frame& frame = frames[k][side];
          const auto through = both[side].stamp(t);
          const auto stamp = through ? alone[side].stamp(*through) : std::nullopt;
          frame.name = stamp ? fmt::format("{}", *stamp) : "";
          frame.with_depth = side == 0 && stamp && options_.depth_every > 0 &&
                             index % static_cast<std::size_t>(options_.depth_every) == 0;
          // The left camera rules the exposure: it is drawn even if the image gets lost.
          if (stamp || side == 0) draw(frame, side, times_[index]);
          if (!stamp) continue;
          lists[side] += fmt::format("{},{}.{}\n", frame.name, frame.name, suffix);
          if (frame.with_depth) depth_list += fmt::format("{0},data/{0}.png,labels/{0}.png\n", frame.name);
        }
        expose(frames[k], index);
      }
      parallel_for(2 * size, options_.renderer.threads,
                   [&](std::size_t i) { write(frames[i / 2][i % 2], first + i / 2, i % 2); });
      for (std::size_t k = 0; k < size; ++k) keep_for_sheet(frames[k][0], first + k);
      if (hooks.progress) hooks.progress(static_cast<int>(first + size), count());
    }
    folder_.write("mav0/cam0/data.csv", lists[0]);
    folder_.write("mav0/cam1/data.csv", lists[1]);
    if (options_.depth_every > 0) folder_.write("mav0/depth0/data.csv", depth_list);
    return true;
  }

  // Some of the left images, small, in rows.
  GrayImage contact_sheet() const {
    constexpr int kColumns = 5, kGap = 4;
    if (sheet_.empty()) return {};
    const int w = sheet_[0].width(), h = sheet_[0].height();
    const int rows = (static_cast<int>(sheet_.size()) + kColumns - 1) / kColumns;
    GrayImage sheet(kColumns * (w + kGap) + kGap, rows * (h + kGap) + kGap);
    sheet.fill(255);
    for (std::size_t i = 0; i < sheet_.size(); ++i) {
      const int x0 = kGap + static_cast<int>(i % kColumns) * (w + kGap),
                y0 = kGap + static_cast<int>(i / kColumns) * (h + kGap);
      for (int y = 0; y < h; ++y) std::copy_n(sheet_[i].row(y), w, sheet.row(y0 + y) + x0);
    }
    return sheet;
  }

 private:
  struct Frame {
    RenderedView view;
    GrayImage image;
    std::string name;  // of the files; empty: lost
    double gain = 1.0;
    bool with_depth = false;
  };

  void draw(Frame& frame, std::size_t side, double t) const {
    ViewRequest request;
    const SE3d& T_base_camera = T_base_camera_[side];
    request.T_world_camera = drive_.base.pose(t) * T_base_camera;
    const double half = 0.5e-3 * options_.sensors.cameras.shutter_ms;
    const SE3d open = drive_.base.pose(t - half) * T_base_camera,
               close = drive_.base.pose(t + half) * T_base_camera;
    const SE3d moved = open.inverse() * close;
    // Below a tenth of a pixel at half a metre there is nothing to smear.
    const double smear = cameras_[side].fx() * (moved.rotation().angle() + moved.translation().norm() / 0.5);
    request.blur = options_.sensors.cameras.motion_blur && smear > 0.1;
    request.T_world_camera_open = open;
    request.T_world_camera_close = close;
    request.lamps = request.daylight = brightness(scene_.events, t);
    for (const Walker& walker : walkers_)
      if (const auto person = walker.pose(t))
        request.moving.push_back(walking_person(*person, walker.phase(t)));
    request.depth = frame.with_depth;
    renderer_.render(rays_[side], request, frame.view);
  }

  void expose(std::array<Frame, 2>& pair, std::size_t index) {
    const double t = times_[index], before = index > 0 ? times_[index - 1] : -1.0;
    for (const SceneEvent& e : scene_.events)
      if (e.kind == SceneEvent::Kind::exposure_step && e.begin <= t && e.begin > before)
        automatic_.jump(e.factor);
    const double interval = 1.0 / options_.sensors.cameras.rate_hz;
    const auto mean = [&](double gain) {
      return exposures_[0].mean_grey(pair[0].view.radiance.view(), gain);
    };
    if (index == 0) automatic_.observe(interval, mean);
    pair[0].gain = pair[1].gain = automatic_.gain();
    if (index > 0) automatic_.observe(interval, mean);
  }

  void write(Frame& frame, std::size_t index, std::size_t side) const {
    if (frame.name.empty()) return;
    exposures_[side].develop(
        frame.view.radiance.view(), frame.gain,
        seed_of(options_.seed, side == 0 ? Chance::image_left : Chance::image_right, index), frame.image);
    const std::string stem = fmt::format("mav0/cam{}/data/{}", side, frame.name);
    if (options_.format == ImageFormat::png)
      folder_.write(stem + ".png", encode_png(frame.image.view()));
    else
      folder_.write(stem + ".jpg", encode_jpeg(frame.image.view(), options_.jpeg_quality));
    if (!frame.with_depth) return;
    const Image<float>& depth = frame.view.depth;
    Image<std::uint16_t> stored(depth.width(), depth.height());
    for (int y = 0; y < depth.height(); ++y)
      for (int x = 0; x < depth.width(); ++x) {
        const float tenths = std::round(10000.0f * depth(x, y));
        stored(x, y) =
            tenths > 0.0f && tenths <= 65535.0f ? static_cast<std::uint16_t>(tenths) : std::uint16_t{0};
      }
    folder_.write(fmt::format("mav0/depth0/data/{}.png", frame.name),
                  encode_png(std::as_const(stored).view()));
    folder_.write(fmt::format("mav0/depth0/labels/{}.png", frame.name),
                  encode_png(std::as_const(frame.view.label).view()));
  }

  void keep_for_sheet(const Frame& frame, std::size_t index) {
    constexpr std::size_t kPictures = 20;
    const std::size_t every = std::max<std::size_t>(1, times_.size() / kPictures);
    if (frame.name.empty() || index % every != 0 || sheet_.size() >= kPictures) return;
    const double scale = std::min(1.0, 256.0 / frame.image.width());
    GrayImage small(std::max(1, static_cast<int>(frame.image.width() * scale)),
                    std::max(1, static_cast<int>(frame.image.height() * scale)));
    const cv::Mat from(frame.image.height(), frame.image.width(), CV_8UC1,
                       const_cast<std::uint8_t*>(frame.image.row(0)),
                       static_cast<std::size_t>(frame.image.stride()));
    cv::Mat to(small.height(), small.width(), CV_8UC1, small.row(0),
               static_cast<std::size_t>(small.stride()));
    cv::resize(from, to, to.size(), 0, 0, cv::INTER_AREA);
    sheet_.push_back(std::move(small));
  }

  const SimulatedScene& scene_;
  const SimulationOptions& options_;
  const Drive& drive_;
  FolderWriter& folder_;
  std::array<Camera, 2> cameras_;
  std::array<SE3d, 2> T_base_camera_;
  std::array<RayTable, 2> rays_;
  std::array<Exposure, 2> exposures_;
  AutoExposure automatic_;
  std::vector<Walker> walkers_;
  Renderer renderer_;
  std::vector<double> times_;
  std::vector<GrayImage> sheet_;
};

void write_motion(const SimulatedScene& scene, const SimulationOptions& options, const Drive& drive,
                  const FolderWriter& folder) {
  using enum SceneEvent::Sensor;
  const SimulatedSensors& sensors = options.sensors;
  const ImuStream imu_stream =
      simulate_imu(drive.base, kSimulationBegin, sensors.imu, seed_of(options.seed, Chance::imu));
  std::string text =
      "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],a_RS_S_x [m "
      "s^-2],a_RS_S_y [m s^-2],a_RS_S_z "
      "[m s^-2]\n";
  Delivery imu_delivery(scene.events, {imu}, seed_of(options.seed, Chance::missing, 3));
  for (const ImuSample& s : imu_stream.samples)
    if (const auto t = imu_delivery.stamp(s.t))
      text += fmt::format("{},{:.9f},{:.9f},{:.9f},{:.8f},{:.8f},{:.8f}\n", *t, s.gyro.x(), s.gyro.y(),
                          s.gyro.z(), s.accel.x(), s.accel.y(), s.accel.z());
  folder.make_folder("mav0/imu0");
  folder.write("mav0/imu0/data.csv", text);
  folder.write("mav0/imu0/sensor.yaml", imu_yaml(scene, sensors.imu));

  text = "#timestamp [ns],left [ticks],right [ticks]\n";
  Delivery wheel_delivery(scene.events, {wheels}, seed_of(options.seed, Chance::missing, 4));
  for (const WheelSample& s : simulate_wheels(drive.base, kSimulationBegin, sensors.wheels, drive.episodes,
                                              seed_of(options.seed, Chance::wheels)))
    if (const auto t = wheel_delivery.stamp(s.t))
      text += sensors.wheels.quantised ? fmt::format("{},{:.0f},{:.0f}\n", *t, s.left, s.right)
                                       : fmt::format("{},{:.9f},{:.9f}\n", *t, s.left, s.right);
  folder.make_folder("mav0/odom0");
  folder.write("mav0/odom0/data.csv", text);
  folder.write("mav0/odom0/sensor.yaml", wheels_yaml(scene, sensors));

  text =
      "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [], "
      "v_RS_R_x [m s^-1], "
      "v_RS_R_y [m s^-1], v_RS_R_z [m s^-1], b_w_RS_S_x [rad s^-1], b_w_RS_S_y [rad s^-1], b_w_RS_S_z [rad "
      "s^-1], b_a_RS_S_x [m "
      "s^-2], b_a_RS_S_y [m s^-2], b_a_RS_S_z [m s^-2]\n";
  const SE3d T_base_imu = sensors.imu.T_base_imu();
  const auto count = static_cast<std::size_t>(drive.base.duration() * options.truth_rate_hz + 1e-6) + 1;
  for (std::size_t i = 0; i < count; ++i) {
    const double t = static_cast<double>(i) / options.truth_rate_hz;
    const MotionState s = drive.base.at(t).of(T_base_imu);
    const Vec3<double>&p = s.T_world_body.translation(), &v = s.velocity;
    Eigen::Quaterniond q = s.T_world_body.rotation().quaternion();
    if (q.w() < 0.0) q.coeffs() = -q.coeffs();
    const auto nearest = static_cast<std::size_t>(std::llround(t * sensors.imu.rate_hz));
    const std::size_t k = std::min(nearest, imu_stream.samples.size() - 1);
    const Vec3<double>&bg = imu_stream.gyro_bias[k], &ba = imu_stream.accel_bias[k];
    text += fmt::format(
        "{},{:.7f},{:.7f},{:.7f},{:.9f},{:.9f},{:.9f},{:.9f},{:.7f},{:.7f},{:.7f},{:.7f},{:.7f},{:.7f},{:.6f}"
        ",{:.6f},{:.6f}\n",
        kSimulationBegin + from_seconds(t), p.x(), p.y(), p.z(), q.w(), q.x(), q.y(), q.z(), v.x(), v.y(),
        v.z(), bg.x(), bg.y(), bg.z(), ba.x(), ba.y(), ba.z());
  }
  folder.make_folder("mav0/state_groundtruth_estimate0");
  folder.write("mav0/state_groundtruth_estimate0/data.csv", text);
}

std::string plan_of(const SimulatedScene& scene, const Drive& drive, const std::vector<TimedEvent>& events) {
  PlanPath path{{}, "#d62728", "path"};
  for (double t = 0.0; t <= drive.base.duration(); t += 0.05)
    path.points.push_back(drive.base.pose(t).translation().head<2>());
  std::vector<PlanMark> marks = {{path.points.front(), "start"}};
  for (const TimedEvent& e : events)
    if (e.kind == "dark" || e.kind == "wheel_slip" || e.kind == "free_spin" || e.kind == "lifted" ||
        e.kind == "bump" || e.kind == "bare_wall" || e.kind == "missing")
      marks.push_back({drive.base.pose(e.begin).translation().head<2>(), e.kind});
  return scene_to_svg(scene.scene, {path}, marks);
}

}  // namespace

SE3d SimulatedCamera::T_base_camera() const {
  if (position.size() != 3) throw Error(ErrorKind::option, "sensors.cameras: position", "needs x, y, z");
  Mat3<double> R_base_ahead;  // x right, y down, z forward
  R_base_ahead << 0, 0, 1, -1, 0, 0, 0, -1, 0;
  const SO3d yaw = SO3d::exp({0, 0, yaw_left_deg * kRad}), pitch = SO3d::exp({0, pitch_down_deg * kRad, 0});
  const SO3d roll = SO3d::exp({0, 0, roll_deg * kRad});
  return {yaw * pitch * SO3d(R_base_ahead) * roll, {position[0], position[1], position[2]}};
}

Camera SimulatedCameras::camera(Side side) const {
  const SimulatedCamera& c = side == Side::left ? left : right;
  return Camera(c.intrinsics, model, model == Distortion::none ? std::vector<double>{} : c.coefficients,
                width, height);
}

Rig SimulatedSensors::rig() const {
  const SE3d T_imu_base = imu.T_base_imu().inverse();
  Rig rig;
  rig.left =
      MountedCamera{cameras.camera(Side::left), T_imu_base * cameras.left.T_base_camera(), cameras.rate_hz};
  rig.right =
      MountedCamera{cameras.camera(Side::right), T_imu_base * cameras.right.T_base_camera(), cameras.rate_hz};
  rig.imu = MountedImu{SE3d(), imu.noise(), imu.rate_hz};
  rig.wheels = MountedWheels{T_imu_base, wheels.nominal(), wheels.rate_hz};
  return rig;
}

SimulationResult simulate(const SimulatedScene& scene, const SimulationOptions& options,
                          const SimulationHooks& hooks) {
  const auto begin = std::chrono::steady_clock::now();
  check_options(options);
  check_rig(options);
  const FloorPlan plan(scene.scene);
  const Drive drive = make_drive(scene.scene, plan, options.robot, scene.script, scene.disturbances,
                                 options.duration, seed_of(options.seed, Chance::drive));
  const std::vector<TimedEvent> events = all_events(scene, drive);

  FolderWriter folder(options.save_path, "truth.yaml");
  ImageMaker images(scene, options, drive, folder);
  if (images.count() == 0)
    throw Error(ErrorKind::data, scene.script.place, "the recording is too short for an image",
                number_text(drive.base.duration()));
  write_motion(scene, options, drive, folder);
  folder.write("mav0/cam0/sensor.yaml", camera_yaml(scene, options.sensors, Side::left));
  folder.write("mav0/cam1/sensor.yaml", camera_yaml(scene, options.sensors, Side::right));
  if (options.depth_every > 0) folder.write("mav0/depth0/sensor.yaml", depth_yaml(options.depth_every));
  folder.write("truth.yaml", truth_yaml(scene, options, drive, events, images.count(), kFirstFrame));
  folder.write("plan.svg", plan_of(scene, drive, events));
  write_occupancy(true_occupancy(scene.scene, drive.base.pose(0.0).translation().head<2>()), folder.path());

  const auto drawing = std::chrono::steady_clock::now();
  SimulationResult result;
  result.stopped = !images.make(hooks);
  result.drawing = seconds_since(drawing);
  result.duration = drive.base.duration();
  if (!result.stopped) {
    result.frames = images.count();
    result.path_m = driven_length(drive);
    const GrayImage sheet = images.contact_sheet();
    folder.write("contact_sheet.png", encode_png(sheet.view()));
    folder.finish();
  }
  result.seconds = seconds_since(begin);
  return result;
}

}  // namespace sweepkit
