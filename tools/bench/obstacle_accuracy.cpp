// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
// obstacle_accuracy [options] RECORDING...: obstacles that the detector finds, against true depth and labels
// of recordings in the layout of sweephome or of `simulate --set depth_every=1`.
//   --set path=value   an option of the detector, as obstacle_detector has it
//   --pictures DIR     pictures of frames with missed obstacles or false alarms
//   --stride N         look at every so manieth image with truth only
// The left camera is raw in the truth: depth and labels are warped to the rectified image (nearest pixel).
// Heights are above the floor's plane that the wheels stand on. Pixels: `truth` is what belongs to neither
// floor nor carpet and rises 5 mm to 30 cm, within the range; `found` are the pixels of obstacles within it;
// pixels whose truth is unknown or higher are left out. An object counts if at least 60 of its pixels are
// visible to both cameras; it is found if at least 10 of them belong to
// obstacles whose depth there is right to 10 %, and found apart if one obstacle has most of its pixels on it.
// A false alarm is an obstacle of which more than half the pixels show floor or carpet, or any hole: there
// are none. What a user is told of are things that are confirmed: `reported` counts each of them once (by its
// id) that was a false alarm in at least one image while it was confirmed. `clear` are those whose image
// shows them beyond doubt (Obstacle::clear). `told of` are objects 2 cm or higher that count within 1 m in at
// least kTold images, of which one or more of the found pixels belonged to a confirmed thing in one of them.

#include <fmt/format.h>
#include <yaml-cpp/yaml.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <map>
#include <numbers>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <optional>
#include <set>
#include <sstream>
#include <string>
#include <vector>

#include "sweepkit/core/error.hpp"
#include "sweepkit/core/option_text.hpp"
#include "sweepkit/data/recording.hpp"
#include "sweepkit/data/scene.hpp"
#include "sweepkit/data/trajectory.hpp"
#include "sweepkit/floor/obstacle_detector.hpp"

namespace {

using namespace sweepkit;
namespace fs = std::filesystem;

constexpr double kDepthUnit = 1e-4;  // m
constexpr double kLow = 0.005;       // least height of a true obstacle's pixel [m]
constexpr double kFlat = 0.013;      // floor: lower than sills [m]
constexpr int kMargin = 3;           // by which matching smears edges [px]
constexpr int kVisible = 60;         // [px]
constexpr int kFound = 10;           // [px]
constexpr int kTold = 5;             // images
constexpr double kDepthShare = 0.1;
constexpr std::array<double, 2> kRanges{1.0, 2.0};
constexpr std::array<double, 7> kDistances{0.0, 0.3, 0.5, 0.75, 1.0, 1.5, 2.0};
constexpr std::array<double, 6> kHeights{0.0, 0.0195, 0.03, 0.05, 0.10, 0.5};

struct TrueObject {
  std::string name;
  int label;
  Vec3<double> centre, size;
  double yaw;
};

struct Tally {
  int count = 0, found = 0, apart = 0, clear = 0;
};

struct PixelTally {
  double truth = 0, found = 0, both = 0;
};

struct Counts {
  int frames = 0, frames_with_alarm[2] = {0, 0}, frames_with_confirmed = 0;
  int alarms[2] = {0, 0}, holes[2] = {0, 0}, confirmed = 0;
  int clear_alarms = 0, frames_with_clear = 0;
  int images = 0;  // seen by the detector, with truth or without
  std::set<std::pair<std::string, std::int64_t>> reported, reported_near;
  struct Nearby {
    int images = 0;
    bool told = false;
  };
  std::map<std::pair<std::string, std::size_t>, Nearby> nearby;  // objects within 1 m
  std::array<std::array<Tally, kDistances.size()>, kHeights.size()> table{};
  std::map<std::string, std::array<Tally, 2>> classes;
  std::array<PixelTally, 2> pixels{};
  std::vector<double> pitch_deg, height_mm, ms;
};

struct Settings {
  ObstacleDetectorOptions options;
  fs::path pictures;
  int stride = 1;
};

// Truth of one image, warped to the rectified left one.
struct Truth {
  Image<float> height;  // above the wheels' floor [m]
  Image<float> depth;   // in the rectified camera [m]; 0: unknown
  Image<std::uint8_t> label;
  Image<std::int16_t> object;  // index, or -1
};

std::vector<TrueObject> read_objects(const fs::path& folder) {
  std::vector<TrueObject> objects;
  constexpr double kRad = std::numbers::pi / 180;
  for (const auto& node : YAML::LoadFile((folder / "truth.yaml").string())["objects"]) {
    const auto vec = [&](const char* key) {
      return Vec3<double>(node[key][0].as<double>(), node[key][1].as<double>(), node[key][2].as<double>());
    };
    objects.push_back({node["name"].as<std::string>(), node["label"].as<int>(), vec("centre"), vec("size"),
                       node["yaw_deg"].as<double>() * kRad});
  }
  return objects;
}

std::map<TimeNs, std::pair<std::string, std::string>> read_depth_list(const fs::path& folder) {
  std::map<TimeNs, std::pair<std::string, std::string>> list;
  std::ifstream file(folder / "mav0/depth0/data.csv");
  std::string line;
  while (std::getline(file, line)) {
    if (line.empty() || line[0] == '#') continue;
    std::stringstream parts(line);
    std::string t, depth, label;
    std::getline(parts, t, ',');
    std::getline(parts, depth, ',');
    std::getline(parts, label, ',');
    while (!label.empty() && (label.back() == '\r' || label.back() == '\n')) label.pop_back();
    list[std::stoll(t)] = {depth, label};
  }
  return list;
}

// The raw pixel shown at each rectified one.
class Warp {
 public:
  explicit Warp(const StereoRig& rig) : rig_(rig) {
    const Camera& raw = rig.camera(Side::left);
    for (int v = 0; v < raw.height(); ++v)
      for (int u = 0; u < raw.width(); ++u) {
        int index = -1;
        if (const auto p = rig.unrectify(Side::left, {double(u), double(v)})) {
          const int x = static_cast<int>(std::lround(p->x())), y = static_cast<int>(std::lround(p->y()));
          if (x >= 0 && y >= 0 && x < raw.width() && y < raw.height()) index = y * raw.width() + x;
        }
        raw_pixel_.push_back(index);
        const auto ray = raw.unproject(Vec2<double>(u, v));
        rays_.push_back(ray ? Vec3<double>(rig.R_camera_raw(Side::left) * *ray) : Vec3<double>::Zero());
      }
  }

  Truth operator()(const cv::Mat& depth, const cv::Mat& label, const std::vector<TrueObject>& objects,
                   const SE3d& T_world_camera, const SE3d& T_base_camera) const {
    const int width = depth.cols, height = depth.rows;
    Truth truth{{width, height}, {width, height}, {width, height}, {width, height}};
    for (int v = 0; v < height; ++v)
      for (int u = 0; u < width; ++u) {
        truth.depth(u, v) = truth.height(u, v) = 0;
        truth.label(u, v) = 0;
        truth.object(u, v) = -1;
        const int raw = raw_pixel_[static_cast<std::size_t>(v) * width + u];
        if (raw < 0) continue;
        const double z = depth.at<std::uint16_t>(raw / width, raw % width) * kDepthUnit;
        truth.label(u, v) = label.at<std::uint8_t>(raw / width, raw % width);
        if (!(z > 0)) continue;
        const Vec3<double> p_camera = z * rays_[static_cast<std::size_t>(raw)];
        truth.depth(u, v) = static_cast<float>(p_camera.z());
        truth.height(u, v) = static_cast<float>((T_base_camera * p_camera).z());
        if (truth.label(u, v) < 10) continue;
        const Vec3<double> p_world = T_world_camera * p_camera;
        for (std::size_t i = 0; i < objects.size(); ++i) {
          const TrueObject& o = objects[i];
          if (o.label != truth.label(u, v)) continue;
          const Vec3<double> d = p_world - o.centre;
          const double c = std::cos(o.yaw), s = std::sin(o.yaw);
          const Vec3<double> q(c * d.x() + s * d.y(), -s * d.x() + c * d.y(), d.z());
          if (((q.cwiseAbs() - 0.5 * o.size).array() < 0.012).all()) {
            truth.object(u, v) = static_cast<std::int16_t>(i);
            break;
          }
        }
      }
    return truth;
  }

 private:
  const StereoRig& rig_;
  std::vector<int> raw_pixel_;
  std::vector<Vec3<double>> rays_;  // of raw pixels, in the rectified camera's axes, z of the raw camera 1
};

void draw(const fs::path& file, const ObstacleFrame& frame, const Truth& truth,
          const std::vector<std::size_t>& wrong, const std::string& text) {
  cv::Mat picture(frame.left.height, frame.left.width, CV_8UC3), shown;
  for (int v = 0; v < picture.rows; ++v)
    for (int u = 0; u < picture.cols; ++u) {
      const auto g = static_cast<std::uint8_t>(frame.left(u, v) * 0.7);
      cv::Vec3b c(g, g, g);
      if (const int region = frame.regions(u, v)) {
        const bool bad = std::count(wrong.begin(), wrong.end(), static_cast<std::size_t>(region - 1)) > 0;
        c = bad ? cv::Vec3b(60, 60, 255) : cv::Vec3b(60, 220, static_cast<std::uint8_t>(37 * region));
      } else if (truth.object(u, v) >= 0) {
        c = cv::Vec3b(255, 160, g);
      }
      picture.at<cv::Vec3b>(v, u) = c;
    }
  cv::Mat disparity(picture.rows, picture.cols, CV_8UC1);
  for (int v = 0; v < picture.rows; ++v)
    for (int u = 0; u < picture.cols; ++u)
      disparity.at<std::uint8_t>(v, u) =
          static_cast<std::uint8_t>(std::clamp(frame.disparity(u, v) / 16 * 2, 0, 255));
  cv::applyColorMap(disparity, shown, cv::COLORMAP_JET);
  cv::putText(picture, text, {5, 12}, cv::FONT_HERSHEY_PLAIN, 0.8, {255, 255, 255});
  cv::vconcat(picture, shown, picture);
  cv::imwrite(file.string(), picture);
}

// Whether floor or carpet is all that there is around a pixel.
bool is_flat(const Truth& truth, int u, int v) {
  for (int y = std::max(v - kMargin, 0); y <= std::min(v + kMargin, truth.label.height() - 1); ++y)
    for (int x = std::max(u - kMargin, 0); x <= std::min(u + kMargin, truth.label.width() - 1); ++x)
      if (truth.label(x, y) != 2 && !(truth.label(x, y) == 1 && truth.height(x, y) < kFlat)) return false;
  return true;
}

bool is_confirmed(const ObstacleFrame& frame, std::size_t k) {
  return std::any_of(frame.tracked.begin(), frame.tracked.end(),
                     [&](const TrackedObstacle& t) { return t.confirmed && t.last == static_cast<int>(k); });
}

void compare(const ObstacleFrame& frame, const Truth& truth, const std::vector<TrueObject>& objects,
             const SE3d& T_base_world, const RectifiedCamera& camera, const Settings& settings,
             const std::string& folder, const std::string& name, Counts& counts) {
  const SE3d T_floor_camera = floor_frame(frame.plane.plane);
  const int width = frame.left.width, height = frame.left.height;
  const std::size_t n = frame.obstacles.size();
  std::vector<int> flat(n, 0), all(n, 0);
  struct Seen {
    int visible = 0, hit = 0, clear = 0;
    double distance = 1e9;
    std::map<int, int> by_region;
  };
  std::vector<Seen> seen(objects.size());
  for (int v = 0; v < height; ++v)
    for (int u = 0; u < width; ++u) {
      const int region = frame.regions(u, v);
      const double z = truth.depth(u, v), h = truth.height(u, v);
      const int label = truth.label(u, v);
      const double measured = frame.disparity(u, v) > 0 ? camera.depth(frame.disparity(u, v) / 16.0) : 0;
      if (region > 0 && z > 0) {
        ++all[static_cast<std::size_t>(region - 1)];
        flat[static_cast<std::size_t>(region - 1)] += is_flat(truth, u, v);
      }
      const bool obstacle =
          region > 0 && frame.obstacles[static_cast<std::size_t>(region - 1)].kind == ObstacleKind::obstacle;
      if (z > 0 && h <= settings.options.obstacles.max_height)
        for (std::size_t r = 0; r < kRanges.size(); ++r) {
          const bool is = label != 1 && label != 2 && h >= kLow && z <= kRanges[r];
          // Beyond the range nothing is asked; at its end depth errors decide.
          const bool found = obstacle && (z <= kRanges[r] || measured <= 0.9 * kRanges[r]);
          counts.pixels[r].truth += is;
          counts.pixels[r].found += found;
          counts.pixels[r].both += is && found;
        }
      if (const int o = truth.object(u, v); o >= 0) {
        Seen& s = seen[static_cast<std::size_t>(o)];
        const double d = camera.disparity(z);
        s.visible += u - d >= 0;
        const Vec3<double> p(z * (u - camera.cx) / camera.focal, z * (v - camera.cy) / camera.focal, z);
        s.distance = std::min(s.distance, (T_floor_camera * p).head<2>().norm());
        if (obstacle && std::abs(measured - z) < kDepthShare * z) {
          ++s.hit;
          s.clear += frame.obstacles[static_cast<std::size_t>(region - 1)].clear;
          ++s.by_region[region];
        }
      }
    }
  std::vector<std::size_t> wrong;
  bool alarm[2] = {false, false}, confirmed = false, clear = false;
  for (std::size_t k = 0; k < n; ++k) {
    const Obstacle& o = frame.obstacles[k];
    if (o.kind == ObstacleKind::obstacle && 2 * flat[k] <= all[k]) continue;
    wrong.push_back(k);
    if (o.clear) ++counts.clear_alarms, clear = true;
    for (int r = 0; r < 2; ++r)
      if (o.distance <= (r == 0 ? 1.0 : 10.0)) {
        ++(o.kind == ObstacleKind::hole ? counts.holes[r] : counts.alarms[r]);
        alarm[r] = true;
      }
    for (const TrackedObstacle& t : frame.tracked)
      if (t.last == static_cast<int>(k) && t.confirmed) {
        ++counts.confirmed, confirmed = true;
        counts.reported.emplace(folder, t.id);
        if (o.distance <= 1.0) counts.reported_near.emplace(folder, t.id);
      }
  }
  ++counts.frames;
  for (int r = 0; r < 2; ++r) counts.frames_with_alarm[r] += alarm[r];
  counts.frames_with_confirmed += confirmed;
  counts.frames_with_clear += clear;
  std::string missed;
  for (std::size_t i = 0; i < objects.size(); ++i) {
    const Seen& s = seen[i];
    if (s.visible < kVisible || s.distance > kDistances.back()) continue;
    const double top =
        (T_base_world * (objects[i].centre + Vec3<double>(0, 0, 0.5 * objects[i].size.z()))).z();
    const auto row = static_cast<std::size_t>(
        std::upper_bound(kHeights.begin(), kHeights.end(), std::max(top, 0.0)) - kHeights.begin() - 1);
    const auto column = static_cast<std::size_t>(
        std::upper_bound(kDistances.begin(), kDistances.end(), s.distance) - kDistances.begin() - 1);
    const bool found = s.hit >= kFound;
    bool apart = false;
    for (const auto& [region, count] : s.by_region)
      apart = apart || (2 * count > frame.obstacles[static_cast<std::size_t>(region - 1)].pixels && found);
    std::vector<Tally*> tallies{&counts.table[row][column]};
    if (s.distance <= 1.0)
      tallies.push_back(&counts.classes[std::string(objects[i].name)][top >= kHeights[1] ? 0 : 1]);
    for (Tally* t : tallies) {
      ++t->count;
      t->found += found;
      t->apart += apart;
      t->clear += s.clear >= kFound;
    }
    if (s.distance <= 1.0 && top >= kHeights[1]) {
      Counts::Nearby& nearby = counts.nearby[{folder, i}];
      ++nearby.images;
      for (const auto& [region, count] : s.by_region)
        nearby.told = nearby.told || is_confirmed(frame, static_cast<std::size_t>(region - 1));
    }
    if (!found && s.distance <= 1.0 && top >= kHeights[1])
      missed += fmt::format("{} {:.0f} mm at {:.2f} m, {} of {} px; ", objects[i].name, 1000 * top,
                            s.distance, s.hit, s.visible);
  }
  if (!settings.pictures.empty() && (!missed.empty() || !wrong.empty())) {
    std::string text = missed;
    for (const std::size_t k : wrong)
      text += fmt::format("false {}{} at {:.2f} m, {} px, top {:.0f} mm, {:.0f} x {:.0f} mm; ",
                          is_confirmed(frame, k) ? "reported " : "", to_string(frame.obstacles[k].kind),
                          frame.obstacles[k].distance, frame.obstacles[k].pixels,
                          1000 * frame.obstacles[k].box.top, 1000 * frame.obstacles[k].box.length,
                          1000 * frame.obstacles[k].box.width);
    fmt::print("# {} plane {}: {}\n", name, to_string(frame.plane.state), text);
    draw(settings.pictures / (name + ".png"), frame, truth, wrong, text);
  }
}

void look_at(const fs::path& folder, const Settings& settings, Counts& counts) {
  RecordingOptions read;
  read.use_imu = false;
  const auto recording = open_recording(folder, read);
  const StereoRig rig = recording->rig().stereo();
  if (!recording->rig().wheels)
    throw Error(ErrorKind::calibration, folder.string(), "has no wheels, which tell where the floor is");
  const SE3d T_body_base = recording->rig().wheels->T_body_base;
  const SE3d T_base_camera = T_body_base.inverse() * rig.T_body_camera();
  ObstacleDetector detector(rig, GroundPlaneSeed::from_base(T_base_camera), settings.options);
  const Warp warp(rig);
  const Trajectory poses = read_trajectory(folder);
  const std::vector<TrueObject> objects = read_objects(folder);
  const auto list = read_depth_list(folder);
  int number = 0;
  const GroundPlane level = GroundPlaneSeed::from_base(T_base_camera).plane;
  while (const auto sample = recording->next()) {
    const auto* image = std::get_if<StereoImage>(&*sample);
    if (!image || image->left.empty() || image->right.empty()) continue;
    const auto T_world_body = interpolate(poses, image->t);
    ObstaclePose pose;
    if (T_world_body) pose.T_odom_camera = *T_world_body * rig.T_body_camera();
    const ObstacleFrame& frame = detector.detect(image->t, image->left.view, image->right.view, pose);
    counts.ms.push_back(frame.times.total());
    ++counts.images;
    const auto entry = list.find(image->t);
    if (entry == list.end() || !T_world_body || number++ % settings.stride != 0) continue;
    const cv::Mat depth =
        cv::imread((folder / "mav0/depth0" / entry->second.first).string(), cv::IMREAD_UNCHANGED);
    const cv::Mat label =
        cv::imread((folder / "mav0/depth0" / entry->second.second).string(), cv::IMREAD_UNCHANGED);
    if (depth.empty() || depth.type() != CV_16UC1 || label.empty() || label.type() != CV_8UC1)
      throw Error(ErrorKind::data, (folder / "mav0/depth0" / entry->second.first).string(), "cannot be read");
    const SE3d T_world_base = *T_world_body * T_body_base;
    const Truth truth = warp(depth, label, objects, *pose.T_odom_camera, T_base_camera);
    constexpr double kDegrees = 180 / std::numbers::pi;
    counts.pitch_deg.push_back(std::abs(pitch_down(frame.plane.plane) - pitch_down(level)) * kDegrees);
    counts.height_mm.push_back(std::abs(frame.plane.plane.height - level.height) * 1000);
    compare(frame, truth, objects, T_world_base.inverse(), detector.camera(), settings, folder.string(),
            fmt::format("{}_{}", folder.filename().string(), image->t), counts);
  }
}

double quantile(std::vector<double> values, double share) {
  if (values.empty()) return 0;
  std::sort(values.begin(), values.end());
  return values[static_cast<std::size_t>(share * static_cast<double>(values.size() - 1))];
}

void print(const Counts& c) {
  fmt::print(
      "\nframes {} of {}; time a pair {:.1f} ms (median); plane off by {:.3f} deg pitch, {:.2f} mm (p95)\n",
      c.frames, c.images, quantile(c.ms, 0.5), quantile(c.pitch_deg, 0.95), quantile(c.height_mm, 0.95));
  fmt::print(
      "false alarms: within 1 m {} obstacles, {} holes in {} frames; all {} obstacles, {} holes in {} "
      "frames; clear {} in {} frames; confirmed {} in {} "
      "frames\nreported false alarms (things confirmed): {}, of them {} within 1 "
      "m\n",
      c.alarms[0], c.holes[0], c.frames_with_alarm[0], c.alarms[1], c.holes[1], c.frames_with_alarm[1],
      c.clear_alarms, c.frames_with_clear, c.confirmed, c.frames_with_confirmed, c.reported.size(),
      c.reported_near.size());
  for (std::size_t r = 0; r < kRanges.size(); ++r) {
    const PixelTally& p = c.pixels[r];
    if (p.truth > 0)
      fmt::print("pixels within {:g} m: precision {:.3f}, recall {:.3f}, IoU {:.3f}\n", kRanges[r],
                 p.both / std::max(p.found, 1.0), p.both / p.truth, p.both / (p.truth + p.found - p.both));
  }
  fmt::print("\nfound / objects (apart)\n{:>14}", "height \\ at");
  for (std::size_t k = 0; k + 1 < kDistances.size(); ++k)
    fmt::print("{:>22}", fmt::format("{:g}-{:g} m", kDistances[k], kDistances[k + 1]));
  for (std::size_t h = 0; h + 1 < kHeights.size(); ++h) {
    fmt::print("\n{:>14}", fmt::format("{:.0f}-{:.0f} mm", 1000 * kHeights[h], 1000 * kHeights[h + 1]));
    for (std::size_t k = 0; k + 1 < kDistances.size(); ++k) {
      const Tally& t = c.table[h][k];
      fmt::print("{:>22}", t.count ? fmt::format("{} / {} ({})", t.found, t.count, t.apart) : "-");
    }
  }
  Tally sum;
  for (std::size_t h = 1; h + 1 < kHeights.size(); ++h)
    for (std::size_t k = 0; k < 4; ++k)
      sum.count += c.table[h][k].count, sum.found += c.table[h][k].found, sum.apart += c.table[h][k].apart,
          sum.clear += c.table[h][k].clear;
  fmt::print("\n2 cm or higher, within 1 m: {} of {} found ({:.2f} %), {} apart, {} clear\n", sum.found,
             sum.count, 100.0 * sum.found / std::max(sum.count, 1), sum.apart, sum.clear);
  int objects = 0, told = 0;
  for (const auto& [key, nearby] : c.nearby)
    if (nearby.images >= kTold) ++objects, told += nearby.told;
  fmt::print("told of: {} of {} such objects seen in at least {} images\n", told, objects, kTold);
  for (const int low : {0, 1}) {
    fmt::print("classes {} 2 cm, within 1 m:", low ? "below" : "from");
    for (const auto& [name, tallies] : c.classes)
      if (const Tally& t = tallies[static_cast<std::size_t>(low)]; t.count > 0)
        fmt::print(" {} {}/{}", name, t.found, t.count);
    fmt::print("\n");
  }
}

}  // namespace

int main(int argc, char** argv) {
  try {
    Settings settings;
    Counts counts;
    std::vector<fs::path> folders;
    const OptionList options = list_options(settings.options);
    for (int i = 1; i < argc; ++i) {
      const std::string arg = argv[i];
      if (arg == "--set" && i + 1 < argc) {
        set_option(options, argv[++i]);
      } else if (arg == "--pictures" && i + 1 < argc) {
        fs::create_directories(settings.pictures = argv[++i]);
      } else if (arg == "--stride" && i + 1 < argc) {
        settings.stride = std::max(1, std::atoi(argv[++i]));
      } else {
        folders.emplace_back(arg);
      }
    }
    if (folders.empty()) {
      fmt::print(stderr,
                 "usage: obstacle_accuracy [--set path=value] [--pictures DIR] [--stride N] RECORDING...\n");
      return 2;
    }
    for (const fs::path& folder : folders) look_at(folder, settings, counts);
    print(counts);
    return 0;
  } catch (const std::exception& error) {
    fmt::print(stderr, "obstacle_accuracy: {}\n", error.what());
    return 3;
  }
}
