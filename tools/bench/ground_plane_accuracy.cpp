// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
//
// Errors of the ground plane against truth:
//
//     ground_plane_accuracy [--every N] [--method sgbm|sgbm_3way|bm] [--ramp] RECORDING...
//
// A recording needs wheels (for the mounting), true poses and `depth0`. Truth is the level plane through the
// middle of the drive wheels, seen from the camera. A frame stands while the robot's base is level to 0.05
// degrees and the robot is not lifted; else it tilts (at a sill or the edge of a carpet) or is lifted.
//
// `enough`: standing frames with true depth in which at least 5 % of the rectified image show floor or carpet
// that lies within 3 mm of the true plane, has true disparities from 2 to 128 px and a partner in the right
// image, the disparity at its tenth decile at least twice that at its first. `standing`: all standing frames.
// Errors are medians and 95th percentiles over all frames of a kind, whatever the estimator says of them.
//
// Each recording runs with the mounting as calibrated and with two wrong ones (pitch, roll and height off by
// 0.5 degrees, 0.5 degrees and 1.5 mm with different signs), each without and with the gyro telling how the
// camera turned. Images are matched by sgbm_3way without the floor's ramp, as ObstacleDetector does; --ramp
// matches them along the ramp of the plane of the frame before, each mounting's own. The first two seconds of
// each run, while a wrong mounting is learned, are left out.
#include <fmt/format.h>
#include <yaml-cpp/yaml.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <map>
#include <numbers>
#include <opencv2/imgcodecs.hpp>
#include <string>
#include <vector>

#include "sweepkit/data/recording.hpp"
#include "sweepkit/data/trajectory.hpp"
#include "sweepkit/floor/ground_plane_estimator.hpp"
#include "sweepkit/image/dense_disparity.hpp"
#include "sweepkit/motion/gyro_integration.hpp"

namespace {

using namespace sweepkit;
namespace fs = std::filesystem;

constexpr double kDegree = std::numbers::pi / 180;
constexpr double kDepthUnit = 1e-4;  // m
constexpr double kLevel = 0.05 * kDegree;
constexpr double kSettling = 2.0;  // s

struct Settings {
  int every = 1;
  bool ramp = false;
  DisparityOptions disparity;
};

struct TimeSpan {
  TimeNs begin, end;
};

struct Pose {
  GroundPlane plane;
  bool level = false;
};

struct Look {
  TimeNs t = 0;
  Pose truth;
  bool lifted = false;
  bool labelled = false, enough = false;
  std::optional<GyroDelta> turn;  // since the last look
};

struct Errors {
  std::vector<double> pitch, roll, height;  // deg, deg, mm
  int frames = 0;
  std::array<int, 3> states{};

  void add(const GroundPlaneResult& result, const GroundPlane& truth) {
    ++frames;
    ++states[static_cast<std::size_t>(result.state)];
    pitch.push_back(std::abs(pitch_down(result.plane) - pitch_down(truth)) / kDegree);
    roll.push_back(std::abs(sweepkit::roll(result.plane) - sweepkit::roll(truth)) / kDegree);
    height.push_back(std::abs(result.plane.height - truth.height) * 1e3);
  }
};

double quantile(std::vector<double> values, double share) {
  if (values.empty()) return 0.0;
  const auto at = values.begin() + std::lround(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

std::vector<TimeSpan> lifted_spans(const fs::path& folder) {
  std::vector<TimeSpan> spans;
  const fs::path file = folder / "truth.yaml";
  if (!fs::exists(file)) return spans;
  for (const YAML::Node& event : YAML::LoadFile(file.string())["events"])
    if (event["kind"].as<std::string>() == "lifted")
      spans.push_back({event["start_ns"].as<TimeNs>(), event["end_ns"].as<TimeNs>()});
  return spans;
}

Pose true_pose(const SE3d& T_world_camera, const SE3d& T_world_base) {
  Pose pose;
  pose.plane.down_camera = T_world_camera.rotation().inverse() * Vec3<double>(0, 0, -1);
  pose.plane.height = T_world_camera.translation().z() - T_world_base.translation().z();
  const Vec3<double> up = T_world_base.rotation() * Vec3<double>::UnitZ();
  pose.level = std::hypot(up.x(), up.y()) < std::sin(kLevel);
  return pose;
}

// Whether the image shows enough of the true plane, by true depth and labels of the raw left image.
bool shows_enough(const StereoRig& rig, const GroundPlane& truth, const cv::Mat& depth,
                  const cv::Mat& labels) {
  const RectifiedCamera camera = rectified_camera(rig);
  const Camera& raw = rig.camera(Side::left);
  std::vector<double> disparities;
  int looked = 0;
  for (int v = 0; v < depth.rows; v += 2)
    for (int u = 0; u < depth.cols; u += 2) {
      ++looked;
      const auto pixel = rig.unrectify(Side::left, {static_cast<double>(u), static_cast<double>(v)});
      if (!pixel) continue;
      const int x = static_cast<int>(std::lround(pixel->x())), y = static_cast<int>(std::lround(pixel->y()));
      if (x < 0 || y < 0 || x >= depth.cols || y >= depth.rows) continue;
      const int label = labels.at<std::uint8_t>(y, x);
      const double z_raw = depth.at<std::uint16_t>(y, x) * kDepthUnit;
      const auto ray = raw.unproject({static_cast<double>(x), static_cast<double>(y)});
      if ((label != 1 && label != 2) || !(z_raw > 0) || !ray) continue;
      const Vec3<double> p_camera = rig.R_camera_raw(Side::left) * (z_raw * *ray);
      const double d = camera.disparity(p_camera.z());
      if (std::abs(truth.height_of(p_camera)) < 0.003 && d >= 2 && d < 128 && d <= u)
        disparities.push_back(d);
    }
  return static_cast<double>(disparities.size()) >= 0.05 * looked &&
         quantile(disparities, 0.9) >= 2 * quantile(disparities, 0.1);
}

// A mounting that is off.
GroundPlaneSeed disturbed(const GroundPlaneSeed& seed, double pitch, double roll, double height) {
  GroundPlaneSeed wrong = seed;
  const SO3d turn = SO3d::exp({pitch * kDegree, 0, roll * kDegree});
  wrong.plane.down_camera = turn * seed.plane.down_camera;
  wrong.plane.height += height;
  wrong.wheels_camera = turn * seed.wheels_camera + height * wrong.plane.down_camera;
  return wrong;
}

void print(const char* kind, const Errors& e) {
  fmt::print("  {:<10}{:>7}{:>9}{:>8}{:>8}", kind, e.frames, e.states[0], e.states[1], e.states[2]);
  for (const auto* values : {&e.pitch, &e.roll, &e.height})
    fmt::print("{:>9.3f}{:>8.3f}", quantile(*values, 0.5), quantile(*values, 0.95));
  fmt::print("\n");
}

void run(const fs::path& folder, const Settings& settings) {
  const auto recording = open_recording(folder);
  const Rig rig = recording->rig();
  const Trajectory truth = read_trajectory(folder);
  if (!rig.wheels) throw Error(ErrorKind::data, folder.string(), "has no wheels");
  const StereoRig stereo = rig.stereo();
  StereoDisparity matcher(stereo, settings.disparity);
  const SE3d T_base_camera = rig.wheels->T_body_base.inverse() * stereo.T_body_camera();
  const GroundPlaneSeed seed = GroundPlaneSeed::from_base(T_base_camera);
  const std::vector<TimeSpan> lifted = lifted_spans(folder);

  struct Run {
    std::string name;
    GroundPlaneEstimator estimator;
    std::map<std::string, Errors> errors;
  };
  struct Mounting {
    GroundPlane last;
    Run alone, with_gyro;
  };
  std::vector<Mounting> mountings;
  const auto add = [&](const std::string& name, const GroundPlaneSeed& s) {
    mountings.push_back({s.plane,
                         {name + ", images alone", {matcher.camera(), s}, {}},
                         {name + ", gyro", {matcher.camera(), s}, {}}});
  };
  add("mounting as calibrated", seed);
  for (const int sign : {1, -1})
    add(fmt::format("mounting off by {:+.1f} deg, {:+.1f} deg, {:+.1f} mm", 0.5 * sign, -0.5 * sign,
                    1.5 * sign),
        disturbed(seed, 0.5 * sign, -0.5 * sign, 0.0015 * sign));

  std::vector<ImuSample> imu;
  Vec3<double> bias = Vec3<double>::Zero();
  TimeNs before = 0, first = 0;
  int index = 0;
  while (const auto sample = recording->next()) {
    if (const auto* s = std::get_if<ImuSample>(&*sample)) imu.push_back(*s);
    const auto* image = std::get_if<StereoImage>(&*sample);
    if (!image || image->left.empty() || image->right.empty() || index++ % settings.every != 0) continue;
    const auto T_world_body = interpolate(truth, image->t);
    if (!T_world_body) continue;
    const Pose pose =
        true_pose(*T_world_body * stereo.T_body_camera(), *T_world_body * rig.wheels->T_body_base);
    const bool carried = std::any_of(lifted.begin(), lifted.end(), [&](const TimeSpan& span) {
      return image->t >= span.begin && image->t <= span.end;
    });
    bool labelled = false, enough = false;
    const fs::path depths = recording->info().path / "depth0";
    const std::string name = std::to_string(image->t) + ".png";
    if (pose.level && !carried && fs::exists(depths / "data" / name)) {
      const cv::Mat depth = cv::imread((depths / "data" / name).string(), cv::IMREAD_UNCHANGED);
      const cv::Mat labels = cv::imread((depths / "labels" / name).string(), cv::IMREAD_UNCHANGED);
      if (depth.type() != CV_16U || labels.type() != CV_8U || depth.size() != labels.size())
        throw Error(ErrorKind::data, (depths / "data" / name).string(), "is no depth with labels");
      labelled = true;
      enough = shows_enough(stereo, pose.plane, depth, labels);
    }

    GroundPlaneStep step, step_with_gyro;
    if (before != 0) step.seconds = to_seconds(image->t - before);
    step_with_gyro = step;
    if (rig.imu && before != 0) {
      // Standing at the start tells the bias.
      if (to_seconds(before - first) < 1.5) {
        bias.setZero();
        for (const ImuSample& s : imu) bias += s.gyro / static_cast<double>(imu.size());
      }
      if (const auto turn = integrate_gyro(imu, before, image->t, bias, rig.imu->noise)) {
        const SO3d R_camera_body = stereo.T_body_camera().rotation().inverse();
        GroundPlaneStep::Motion motion;
        motion.T_now_before =
            SE3d(R_camera_body * turn->R.inverse() * R_camera_body.inverse(), Vec3<double>::Zero());
        motion.covariance.topLeftCorner<3, 3>() = Mat3<double>::Identity();  // not known
        const double drift = 0.05 * kDegree * step.seconds;
        motion.covariance.bottomRightCorner<3, 3>() =
            (turn->variance + drift * drift) * Mat3<double>::Identity();
        step_with_gyro.motion = motion;
        if (to_seconds(before - first) >= 1.5)
          imu.erase(imu.begin(), std::lower_bound(imu.begin(), imu.end(), before,
                                                  [](const ImuSample& s, TimeNs t) { return s.t < t; }));
      }
    }
    if (before == 0) first = image->t;
    before = image->t;

    for (Mounting& mounting : mountings) {
      DisparityRamp ramp;
      if (settings.ramp) ramp = mounting.last.disparity(matcher.camera()).ramp(matcher.camera().cx);
      const DisparityView disparity = matcher.match(image->left.view, image->right.view, ramp);
      for (Run* r : {&mounting.alone, &mounting.with_gyro}) {
        const bool gyro = r == &mounting.with_gyro;
        const GroundPlaneResult result = r->estimator.estimate(disparity, gyro ? step_with_gyro : step);
        if (!gyro) mounting.last = result.plane;
        if (to_seconds(image->t - first) < kSettling) continue;
        if (carried) {
          r->errors["lifted"].add(result, pose.plane);
        } else if (!pose.level) {
          r->errors["tilting"].add(result, pose.plane);
        } else {
          r->errors["standing"].add(result, pose.plane);
          if (labelled) r->errors[enough ? "enough" : "too little"].add(result, pose.plane);
        }
      }
    }
  }
  fmt::print("{}\n", folder.string());
  for (const Mounting& mounting : mountings)
    for (const Run* r : {&mounting.alone, &mounting.with_gyro}) {
      fmt::print(" {}\n  {:<10}{:>7}{:>9}{:>8}{:>8}{:>9}{:>8}{:>9}{:>8}{:>9}{:>8}\n", r->name, "", "frames",
                 "measured", "predict", "refused", "pitch 50", "95 deg", "roll 50", "95 deg", "height50",
                 "95 mm");
      for (const char* kind : {"enough", "too little", "standing", "tilting", "lifted"})
        if (const auto found = r->errors.find(kind); found != r->errors.end()) print(kind, found->second);
    }
}

}  // namespace

int main(int argc, char** argv) {
  Settings settings;
  settings.disparity.method = DisparityMethod::sgbm_3way;
  std::vector<fs::path> folders;
  for (int i = 1; i < argc; ++i) {
    const std::string argument = argv[i];
    if (argument == "--every" && i + 1 < argc) {
      settings.every = std::max(1, std::atoi(argv[++i]));
    } else if (argument == "--ramp") {
      settings.ramp = true;
    } else if (argument == "--method" && i + 1 < argc) {
      const std::string method = argv[++i];
      settings.disparity.method = method == "bm"          ? DisparityMethod::bm
                                  : method == "sgbm_3way" ? DisparityMethod::sgbm_3way
                                                          : DisparityMethod::sgbm;
    } else {
      folders.push_back(argument);
    }
  }
  if (folders.empty()) {
    fmt::print(
        stderr,
        "usage: ground_plane_accuracy [--every N] [--method sgbm|sgbm_3way|bm] [--ramp] RECORDING...\n");
    return 2;
  }
  try {
    for (const fs::path& folder : folders) run(folder, settings);
  } catch (const Error& error) {
    fmt::print(stderr, "ground_plane_accuracy: {}\n", error.what());
    return 3;
  } catch (const YAML::Exception& error) {
    fmt::print(stderr, "ground_plane_accuracy: {}\n", error.what());
    return 3;
  }
}
