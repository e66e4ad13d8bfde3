// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
// real_floor [--set path=value ...] [--pictures DIR] [--poses] FOLDER: rectification, dense disparity, ground
// plane, mask and obstacles on real images: what ObstacleDetector makes of them. FOLDER holds
// kitti/06_first51 (frames 0 to 50 of KITTI odometry 06), euroc_still and euroc_loop_pairs (of EuRoC V1_01,
// with true poses) and middlebury (six pairs with true disparities); what is missing is left out.
//
// The detector's lengths are those of a robot whose cameras stand 8 cm high. Elsewhere the unit of length is
// chosen so that they do: all else is then as shipped, unless said otherwise. Where the baseline is a small
// part of the height all floor is far in disparity: `far floor too` lets the plane use it down to 8 px. What
// is printed is in true metres again, except on Middlebury, where no true metre is known.
//
// Seeds: KITTI: 1.65 m above the road and level, as its authors built the car. EuRoC: the vertical of the
// true poses, and the height at which the first image shows most (disparities alone, see commonest_height);
// the floor so found is the seed of all other images. Middlebury: `level`: a level floor which has, in the
// lowest row, the median true disparity of that row: what a robot would expect there that took the thing
// before it for floor; `fitted`: the plane that may be a floor and carries most of the true
// disparities of the lower third.
//
// `found`: pixels with a disparity (Middlebury: of those with a true one and a partner), `bad1`: of these off
// by more than 1 px. Labels: shares of all pixels. Middlebury's `carried`: of the pixels of the lower third
// with a true disparity, those within 1 px of the estimated plane; `agree`: pixels of floor, obstacle and
// hole whose label is the one that the true disparity has beside the seed's plane; `invented`: floor where
// that one is none; `n`: obstacles and holes. With --poses the true motion is told to the plane.

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <map>
#include <numbers>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <string>
#include <vector>

#include "real_floor.hpp"
#include "sweepkit/core/error.hpp"
#include "sweepkit/core/option_text.hpp"
#include "sweepkit/data/recording.hpp"
#include "sweepkit/data/trajectory.hpp"
#include "sweepkit/floor/obstacle_detector.hpp"

namespace real_floor {

/// The mask over the image: floor green, obstacle red, hole blue; yellow boxes: obstacles; white: holes.
void draw(const Settings& settings, const std::string& name, const ObstacleFrame& frame) {
  if (settings.pictures.empty()) return;
  std::filesystem::create_directories(settings.pictures);
  const cv::Vec3b tints[] = {{0, 0, 0}, {60, 200, 60}, {50, 50, 230}, {255, 110, 40}};  // blue, green, red
  cv::Mat picture(frame.mask.height, frame.mask.width, CV_8UC3);
  for (int v = 0; v < picture.rows; ++v)
    for (int u = 0; u < picture.cols; ++u) {
      const int label = frame.mask(u, v);
      for (int k = 0; k < 3; ++k)
        picture.at<cv::Vec3b>(v, u)[k] = static_cast<std::uint8_t>(
            label ? 0.6 * frame.left(u, v) + 0.4 * tints[label][k] : frame.left(u, v));
    }
  for (const Obstacle& thing : frame.obstacles)
    cv::rectangle(picture, {thing.image.u_min, thing.image.v_min}, {thing.image.u_max, thing.image.v_max},
                  thing.kind == ObstacleKind::hole ? cv::Scalar(255, 255, 255) : cv::Scalar(0, 230, 255));
  cv::imwrite((settings.pictures / (name + ".png")).string(), picture);
}

}  // namespace real_floor

namespace {

using namespace real_floor;
namespace fs = std::filesystem;

constexpr double kMinFloor = 2.0;  // disparity of floor that counts [px]

SE3d scaled(const SE3d& T, double unit) { return {T.rotation(), T.translation() / unit}; }

/// The same rig with lengths counted in `unit` metres.
StereoRig scaled(const StereoRig& rig, double unit) {
  return {rig.camera(Side::left), rig.camera(Side::right), scaled(rig.T_body_raw(Side::left), unit),
          scaled(rig.T_body_raw(Side::right), unit)};
}

double mean(const std::vector<double>& values) {
  double sum = 0;
  for (const double x : values) sum += x;
  return values.empty() ? 0 : sum / static_cast<double>(values.size());
}
double deviation(const std::vector<double>& values) {
  const double m = mean(values);
  double sum = 0;
  for (const double x : values) sum += (x - m) * (x - m);
  return values.empty() ? 0 : std::sqrt(sum / static_cast<double>(values.size()));
}
/// What the images of a recording gave.
class Tally {
 public:
  void add(const ObstacleFrame& frame, double unit) {
    ++images_;
    std::string what{to_string(frame.plane.state)};
    if (!frame.plane.measured()) what += fmt::format(" ({})", to_string(frame.plane.reason));
    ++states_[what];
    pitch_.push_back(pitch_down(frame.plane.plane) / kDegree);
    roll_.push_back(roll(frame.plane.plane) / kDegree);
    height_.push_back(frame.plane.plane.height * unit);
    for (int v = 0; v < frame.mask.height; ++v)
      for (int u = 0; u < frame.mask.width; ++u) {
        ++labels_[frame.mask(u, v)];
        found_ += frame.disparity(u, v) > 0;
      }
    for (const Obstacle& thing : frame.obstacles) ++things_[static_cast<int>(thing.kind)];
  }
  void print(const std::string& name) const {
    std::string states;
    for (const auto& [what, count] : states_) states += fmt::format(" {} {}", count, what);
    const double all = static_cast<double>(labels_[0] + labels_[1] + labels_[2] + labels_[3]);
    fmt::print("{}: {} images; plane{}\n", name, images_, states);
    fmt::print("  pitch {:.2f} +- {:.2f} deg, roll {:.2f} +- {:.2f} deg, height {:.3f} +- {:.3f} m\n",
               mean(pitch_), deviation(pitch_), mean(roll_), deviation(roll_), mean(height_),
               deviation(height_));
    const auto share = [&](std::size_t count) { return 100 * static_cast<double>(count) / all; };
    fmt::print(
        "  found {:.1f} %; floor {:.1f}, obstacle {:.1f}, hole {:.2f}, unknown {:.1f} %; an image has {:.1f} "
        "obstacles, {:.2f} holes\n",
        share(found_), share(labels_[1]), share(labels_[2]), share(labels_[3]), share(labels_[0]),
        static_cast<double>(things_[0]) / images_, static_cast<double>(things_[1]) / images_);
  }

 private:
  int images_ = 0;
  std::map<std::string, int> states_;
  std::vector<double> pitch_, roll_, height_;
  std::size_t labels_[4] = {}, found_ = 0;
  int things_[2] = {};
};

/// A recording's images with the true poses of the rectified left camera.
struct Shot {
  TimeNs t = 0;
  SharedGray left, right;
  std::optional<SE3d> T_world_camera;
};
struct Images {
  StereoRig rig;
  std::vector<Shot> images;
};

Images read(const fs::path& folder) {
  RecordingOptions reading;
  reading.use_imu = false;
  const auto recording = open_recording(folder, reading);
  Images read{recording->rig().stereo(), {}};
  const Trajectory truth = read_trajectory(recording->info().truth);
  while (const auto sample = recording->next())
    if (const auto* pair = std::get_if<StereoImage>(&*sample); pair && !pair->left.empty()) {
      std::optional<SE3d> T = interpolate(truth, pair->t);
      if (T) *T = *T * read.rig.T_body_camera();
      read.images.push_back({pair->t, pair->left, pair->right, T});
    }
  return read;
}

ObstaclePose pose_of(const Shot& image, const Settings& settings, double unit) {
  ObstaclePose pose;
  if (settings.poses && image.T_world_camera) pose.T_odom_camera = scaled(*image.T_world_camera, unit);
  return pose;
}

/// How far the road that an image shows ahead lies from where it is once the car is there.
struct RoadCheck {
  static constexpr double kAhead = 8.0;  // m
  std::vector<SE3d> poses;
  std::vector<GroundPlane> planes;  // in true metres

  void print() const {
    std::vector<double> differences;
    for (std::size_t i = 0; i < poses.size(); ++i)
      for (std::size_t k = i + 1; k < poses.size(); ++k) {
        const Vec3<double> way = (poses[i].inverse() * poses[k]).translation();
        if (way.norm() < kAhead) continue;
        // From the later camera down to the earlier one's road, beside its own height.
        const Vec3<double> down = poses[k].rotation().inverse() * poses[i].rotation() * planes[i].down_camera;
        const double height = planes[i].height_of(way) / down.dot(planes[k].down_camera);
        differences.push_back(height - planes[k].height);
        break;
      }
    if (differences.empty()) return;
    std::vector<double> sizes;
    for (const double x : differences) sizes.push_back(std::abs(x));
    fmt::print("  height over the road as seen {:g} m before: mean {:+.3f}, deviation {:.3f} m\n", kAhead,
               mean(differences), deviation(differences));
  }
};

void kitti(const fs::path& folder, const Settings& settings, double height) {
  const Images recording = read(folder);
  const double unit = height / kRobotHeight;
  // A car pitches and heaves on its springs, and a road is no floor.
  const std::vector<std::string> own{"plane.min_disparity=8",       "plane.mounting_angle=1",
                                     "plane.mounting_height=0.004", "plane.ride_angle=0.3",
                                     "plane.ride_height=0.001",     "plane.view_angle=0.3",
                                     "plane.view_height=0.001",     "plane.max_height_error=0.005"};
  for (const bool as_shipped : {true, false}) {
    ObstacleDetector detector(scaled(recording.rig, unit),
                              GroundPlaneSeed::from_height(Vec3<double>::UnitY(), kRobotHeight),
                              settings.detector(as_shipped ? std::vector<std::string>{} : own));
    Tally tally;
    RoadCheck road;
    for (std::size_t k = 0; k < recording.images.size(); ++k) {
      const Shot& image = recording.images[k];
      const ObstacleFrame& frame =
          detector.detect(image.t, image.left.view, image.right.view, pose_of(image, settings, unit));
      tally.add(frame, unit);
      if (image.T_world_camera) {
        road.poses.push_back(*image.T_world_camera);
        road.planes.push_back({frame.plane.plane.down_camera, frame.plane.plane.height * unit});
      }
      if (k % 5 == 0) draw(settings, fmt::format("kitti_{}_{:02}", as_shipped ? "shipped" : "car", k), frame);
    }
    tally.print(as_shipped ? "KITTI 06, as shipped" : "KITTI 06, a car's options");
    road.print();
  }
}

/// The height of the camera above the level surface that most pixels show: the fullest of 2 cm from 0.2 to 4
/// m, each with its neighbours.
double commonest_height(DisparityView disparity, const RectifiedCamera& camera, const Vec3<double>& down) {
  constexpr double kFrom = 0.2, kStep = 0.02;
  std::vector<int> counts(190);
  for (int v = 0; v < disparity.height; ++v)
    for (int u = 0; u < disparity.width; ++u) {
      const double slope =
          down.dot(Vec3<double>((u - camera.cx) / camera.focal, (v - camera.cy) / camera.focal, 1));
      const double d = disparity(u, v) / 16.0;
      if (d < kMinFloor || slope < 0.1) continue;
      const double at = (camera.focal * camera.baseline * slope / d - kFrom) / kStep;
      if (at >= 0 && at < static_cast<double>(counts.size())) ++counts[static_cast<std::size_t>(at)];
    }
  std::size_t best = 1;
  const auto around = [&](std::size_t k) { return counts[k - 1] + counts[k] + counts[k + 1]; };
  for (std::size_t k = 1; k + 1 < counts.size(); ++k)
    if (around(k) > around(best)) best = k;
  return kFrom + kStep * (static_cast<double>(best) + 0.5);
}

/// Returns how high the floor is in the world.
double euroc(const std::string& name, const fs::path& folder, const Settings& settings,
             std::optional<double> floor_z, bool one_by_one, const std::vector<std::string>& own) {
  const Images recording = read(folder);
  const auto down_of = [](const Shot& image) -> Vec3<double> {
    return image.T_world_camera->rotation().inverse() * Vec3<double>(0, 0, -1);
  };
  const Shot& first = recording.images.front();
  if (!floor_z) {
    StereoDisparity stereo(recording.rig);
    const double height =
        commonest_height(stereo.match(first.left.view, first.right.view), stereo.camera(), down_of(first));
    floor_z = first.T_world_camera->translation().z() - height;
    fmt::print("{}: seed {:.2f} m below the camera, at {:+.3f} m in the world\n", name, height, *floor_z);
  }
  const double unit = (first.T_world_camera->translation().z() - *floor_z) / kRobotHeight;
  std::optional<ObstacleDetector> detector;
  Tally tally;
  std::vector<double> floors, tilts;
  for (std::size_t k = 0; k < recording.images.size(); ++k) {
    const Shot& image = recording.images[k];
    const double height = (image.T_world_camera->translation().z() - *floor_z) / unit;
    if (!detector || one_by_one)
      detector.emplace(scaled(recording.rig, unit), GroundPlaneSeed::from_height(down_of(image), height),
                       settings.detector(own));
    const ObstacleFrame& frame =
        detector->detect(image.t, image.left.view, image.right.view, pose_of(image, settings, unit));
    tally.add(frame, unit);
    const GroundPlane& plane = frame.plane.plane;
    floors.push_back((*image.T_world_camera * (plane.down_camera * plane.height * unit)).z());
    tilts.push_back(std::acos(std::min(1.0, plane.down_camera.dot(down_of(image)))) / kDegree);
    if (one_by_one)
      fmt::print("  image {}: {} {}, floor at {:+.3f} m in the world, {:.2f} deg off the true horizontal\n",
                 k, to_string(frame.plane.state), to_string(frame.plane.reason), floors.back(), tilts.back());
    if (k % 10 == 0 || one_by_one)
      draw(settings, fmt::format("{}_{:02}", folder.filename().string(), k), frame);
  }
  tally.print(name);
  fmt::print("  floor in the world {:+.3f} +- {:.3f} m, {:.2f} deg off the true horizontal\n", mean(floors),
             deviation(floors), median(tilts));
  return mean(floors);
}

}  // namespace

int main(int argc, char** argv) {
  try {
    Settings settings;
    fs::path folder;
    for (int i = 1; i < argc; ++i) {
      const std::string argument = argv[i];
      if (argument == "--set" && i + 1 < argc)
        settings.options.emplace_back(argv[++i]);
      else if (argument == "--pictures" && i + 1 < argc)
        settings.pictures = argv[++i];
      else if (argument == "--poses")
        settings.poses = true;
      else
        folder = argument;
    }
    if (folder.empty()) {
      fmt::print(stderr, "usage: real_floor [--set path=value ...] [--pictures DIR] [--poses] FOLDER\n");
      return 2;
    }
    if (fs::exists(folder / "kitti/06_first51")) kitti(folder / "kitti/06_first51", settings, 1.65);
    // From where it stands the floor has 50 px at most, from 1.5 m hardly the 40 px that the plane asks for.
    const std::vector<std::string> far{"plane.min_disparity=8"};
    std::optional<double> floor_z;
    if (fs::exists(folder / "euroc_still")) {
      euroc("EuRoC V1_01 standing, as shipped", folder / "euroc_still", settings, floor_z, false, {});
      floor_z =
          euroc("EuRoC V1_01 standing, far floor too", folder / "euroc_still", settings, floor_z, false, far);
    }
    if (fs::exists(folder / "euroc_loop_pairs")) {
      euroc("EuRoC V1_01 flying, as shipped", folder / "euroc_loop_pairs", settings, floor_z, true, {});
      euroc("EuRoC V1_01 flying, far floor too", folder / "euroc_loop_pairs", settings, floor_z, true, far);
    }
    if (fs::exists(folder / "middlebury")) middlebury(folder / "middlebury", settings);
  } catch (const Error& error) {
    fmt::print(stderr, "real_floor: {}\n", error.what());
    return error.kind() == ErrorKind::option ? 2 : 3;
  }
}
