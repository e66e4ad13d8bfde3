// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/data/kitti.hpp"

#include <fmt/format.h>

#include <array>
#include <charconv>
#include <cmath>
#include <map>

#include "merged_recording.hpp"
#include "text_file.hpp"

namespace sweepkit {
namespace {

namespace fs = std::filesystem;

/// The intrinsics of a projection matrix K [I | t] and where its camera sits, -t, in the rectified frame.
struct Projection {
  std::vector<double> intrinsics;  ///< fx, fy, cx, cy
  Vec3<double> center;
  std::string place;
};

Projection read_projection(const fs::path& file, const std::string& name) {
  TextFile text(file);
  while (text.next_data()) {
    const auto& fields = text.fields(1);
    if (fields[0] != name + ":") continue;
    if (fields.size() != 13)
      throw Error(ErrorKind::calibration, text.place() + ": " + name,
                  "must have 12 numbers, a 3x4 matrix by rows", std::to_string(fields.size() - 1));
    std::array<double, 12> P;
    for (int i = 0; i < 12; ++i) P[i] = text.number_of(fields[i + 1]);
    const double fx = P[0], fy = P[5], cx = P[2], cy = P[6];
    if (!(fx > 0) || !(fy > 0))
      throw Error(ErrorKind::calibration, text.place() + ": " + name,
                  "the matrix is singular: fx and fy must be above zero",
                  fmt::format("fx {}, fy {}", fx, fy));
    if (P[1] != 0 || P[4] != 0 || P[8] != 0 || P[9] != 0 || P[10] != 1)
      throw Error(ErrorKind::calibration, text.place() + ": " + name,
                  "must have the form fx 0 cx tx  0 fy cy ty  0 0 1 tz");
    const double tz = P[11];
    return {
        {fx, fy, cx, cy}, {-(P[3] - cx * tz) / fx, -(P[7] - cy * tz) / fy, -tz}, text.place() + ": " + name};
  }
  throw Error(ErrorKind::calibration, file.string(), "has no line " + name + ":");
}

/// Files of a folder by frame number.
std::map<long, fs::path> list_images(const fs::path& folder) {
  std::map<long, fs::path> files;
  for (const auto& entry : fs::directory_iterator(folder)) {
    const std::string stem = entry.path().stem().string();
    long number = -1;
    const auto result = std::from_chars(stem.data(), stem.data() + stem.size(), number);
    if (result.ec == std::errc() && result.ptr == stem.data() + stem.size() && number >= 0)
      files.emplace(number, entry.path());
  }
  if (files.empty()) throw Error(ErrorKind::data, folder.string(), "holds no image named by its number");
  return files;
}

}  // namespace

std::unique_ptr<Recording> open_kitti(const fs::path& folder, const RecordingOptions& options) {
  check_options(options);
  RecordingInfo info;
  info.format = "KITTI odometry";
  info.path = folder;
  info.missing_sensors = {"imu0", "odom0"};

  std::map<long, fs::path> images[2];
  for (int side = 0; side < 2; ++side) {
    const fs::path images_folder = folder / fmt::format("image_{}", side);
    if (fs::is_directory(images_folder))
      images[side] = list_images(images_folder);
    else
      info.missing_sensors.push_back(fmt::format("cam{}", side));
  }
  if (images[0].empty() && images[1].empty())
    throw Error(ErrorKind::io, folder.string(),
                "is no KITTI sequence: neither image_0 nor image_1 lies in it");

  Rig rig;
  const Projection first = read_projection(folder / "calib.txt", "P0");
  const auto mount = [&](const Projection& projection, const std::map<long, fs::path>& files) {
    const SharedGray image = read_gray(files.begin()->second);
    return MountedCamera{
        Camera(projection.intrinsics, Distortion::none, {}, image.view.width, image.view.height),
        SE3d(SO3d(), projection.center - first.center)};
  };
  if (!images[0].empty()) rig.left = mount(first, images[0]);
  if (!images[1].empty()) {
    const Projection second = read_projection(folder / "calib.txt", "P1");
    const double baseline = (second.center - first.center).norm();
    if (baseline < 1e-6)
      throw Error(ErrorKind::calibration, second.place,
                  "the baseline, the distance to P0, must be above zero", number_text(baseline) + " m");
    rig.right = mount(second, images[1]);
  }

  MergedRecording::Streams streams;
  TextFile times(folder / "times.txt");
  for (long number = 0; times.next_data(); ++number) {
    ListedFrame frame;
    frame.t = times.stamp_s_of(times.fields(1)[0]);
    times.check_order(frame.t);
    for (int side = 0; side < 2; ++side) {
      const auto at = images[side].find(number);
      ListedImage& image = side == 0 ? frame.left : frame.right;
      if (at != images[side].end()) image = {at->second, times.place()};
    }
    if (frame.left.file.empty() && frame.right.file.empty())
      throw times.error("there is no image of this frame", fmt::format("{:06d}", number));
    streams.frames.push_back(std::move(frame));
  }
  if (streams.frames.empty()) throw Error(ErrorKind::data, times.file().string(), "holds no stamps");
  if (fs::exists(folder / "poses.txt")) info.truth = folder / "poses.txt";
  return std::make_unique<MergedRecording>(std::move(info), std::move(rig), std::move(streams), options);
}

}  // namespace sweepkit
