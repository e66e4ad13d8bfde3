// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/data/trajectory.hpp"

#include <fmt/format.h>

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cerrno>
#include <cmath>
#include <cstring>

#include "text_file.hpp"

namespace sweepkit {
namespace {

namespace fs = std::filesystem;

/// Columns i, i + 1, i + 2 as a vector.
Vec3<double> vector_at(const TextFile& file, const std::vector<std::string_view>& fields, std::size_t i) {
  return {file.number_of(fields[i]), file.number_of(fields[i + 1]), file.number_of(fields[i + 2])};
}

SO3d rotation_of(const TextFile& file, double w, double x, double y, double z) {
  const Eigen::Quaterniond q(w, x, y, z);
  if (std::abs(q.norm() - 1.0) > 1e-2)
    throw file.error("the quaternion must have length 1", fmt::format("{:.6g}", q.norm()));
  return SO3d(q);
}

}  // namespace

std::string tum_line(const StampedPose& pose) {
  const std::uint64_t magnitude =
      pose.t < 0 ? 0 - static_cast<std::uint64_t>(pose.t) : static_cast<std::uint64_t>(pose.t);
  const Vec3<double>& p = pose.T_world_body.translation();
  const Eigen::Quaterniond& q = pose.T_world_body.rotation().quaternion();
  const double sign = q.w() < 0 ? -1.0 : 1.0;
  return fmt::format("{}{}.{:09d} {:.9f} {:.9f} {:.9f} {:.9f} {:.9f} {:.9f} {:.9f}\n", pose.t < 0 ? "-" : "",
                     magnitude / kNsPerSecond, magnitude % kNsPerSecond, p.x(), p.y(), p.z(), sign * q.x(),
                     sign * q.y(), sign * q.z(), sign * q.w());
}

TumWriter::TumWriter(fs::path file) : file_(std::move(file)), stream_(std::fopen(file_.c_str(), "wb")) {
  if (!stream_)
    throw Error(ErrorKind::io, file_.string(), std::string("cannot be written: ") + std::strerror(errno));
}

TumWriter::~TumWriter() { std::fclose(stream_); }

void TumWriter::put(const std::string& text) {
  if (std::fwrite(text.data(), 1, text.size(), stream_) != text.size())
    throw Error(ErrorKind::io, file_.string(), std::string("cannot be written: ") + std::strerror(errno));
}

void TumWriter::write(const StampedPose& pose) { put(tum_line(pose)); }

void TumWriter::comment(std::string_view text) { put(fmt::format("# {}\n", text)); }

void TumWriter::flush() {
  if (std::fflush(stream_) != 0)
    throw Error(ErrorKind::io, file_.string(), std::string("cannot be written: ") + std::strerror(errno));
}

void write_tum(const fs::path& file, std::span<const StampedPose> trajectory) {
  TumWriter writer(file);
  for (const StampedPose& pose : trajectory) writer.write(pose);
  writer.flush();
}

Trajectory read_tum(const fs::path& path) {
  TextFile file(path);
  Trajectory trajectory;
  while (file.next_data()) {
    const auto& fields = file.fields(8);
    const TimeNs t = file.stamp_s_of(fields[0]);
    file.check_order(t);
    const SO3d R = rotation_of(file, file.number_of(fields[7]), file.number_of(fields[4]),
                               file.number_of(fields[5]), file.number_of(fields[6]));
    trajectory.push_back({t, SE3d(R, vector_at(file, fields, 1))});
  }
  if (trajectory.empty()) throw Error(ErrorKind::data, path.string(), "holds no poses");
  return trajectory;
}

Trajectory read_euroc_truth(const fs::path& path) {
  TextFile file(path);
  Trajectory trajectory;
  while (file.next_data()) {
    const auto& fields = file.fields(8);
    const TimeNs t = file.stamp_ns_of(fields[0]);
    file.check_order(t);
    const SO3d R = rotation_of(file, file.number_of(fields[4]), file.number_of(fields[5]),
                               file.number_of(fields[6]), file.number_of(fields[7]));
    trajectory.push_back({t, SE3d(R, vector_at(file, fields, 1))});
  }
  if (trajectory.empty()) throw Error(ErrorKind::data, path.string(), "holds no poses");
  return trajectory;
}

Trajectory read_kitti_poses(const fs::path& path, const fs::path& times_path) {
  TextFile file(path), times(times_path);
  Trajectory trajectory;
  while (file.next_data()) {
    if (!times.next_data())
      throw file.error(fmt::format("there is no stamp for this pose in {}", times_path.string()));
    const TimeNs t = times.stamp_s_of(times.fields(1)[0]);
    times.check_order(t);
    const auto& fields = file.fields(12);
    std::array<double, 12> m;
    for (std::size_t i = 0; i < 12; ++i) m[i] = file.number_of(fields[i]);
    const Eigen::Map<const Eigen::Matrix<double, 3, 4, Eigen::RowMajor>> T(m.data());
    const Mat3<double> R = T.leftCols<3>();
    if ((R * R.transpose() - Mat3<double>::Identity()).cwiseAbs().maxCoeff() > 1e-3 || R.determinant() < 0)
      throw file.error("the left 3x3 part is no rotation");
    trajectory.push_back({t, SE3d(SO3d(R), T.col(3))});
  }
  if (trajectory.empty()) throw Error(ErrorKind::data, path.string(), "holds no poses");
  return trajectory;
}

Trajectory read_trajectory(const fs::path& path, const fs::path& times) {
  if (fs::is_directory(path)) {
    for (const char* truth :
         {"mav0/state_groundtruth_estimate0/data.csv", "state_groundtruth_estimate0/data.csv"})
      if (fs::exists(path / truth)) return read_euroc_truth(path / truth);
    if (fs::exists(path / "poses.txt"))
      return read_kitti_poses(path / "poses.txt", times.empty() ? path / "times.txt" : times);
    throw Error(ErrorKind::io, path.string(),
                "holds no true poses (state_groundtruth_estimate0 or poses.txt)");
  }
  TextFile file(path);
  if (!file.next_data()) throw Error(ErrorKind::data, path.string(), "holds no poses");
  const bool commas = file.line().find(',') != std::string::npos;
  const std::size_t columns = file.fields(1).size();
  if (commas && columns >= 8) return read_euroc_truth(path);
  if (columns == 12) return read_kitti_poses(path, times.empty() ? path.parent_path() / "times.txt" : times);
  if (columns == 8) return read_tum(path);
  throw file.error("is no pose: 8 columns (TUM), 12 (KITTI) or comma-separated ones (EuRoC) are expected",
                   fmt::format("{} columns", columns));
}

std::optional<SE3d> interpolate(std::span<const StampedPose> trajectory, TimeNs t, TimeNs max_gap) {
  const auto after = std::lower_bound(trajectory.begin(), trajectory.end(), t,
                                      [](const StampedPose& pose, TimeNs stamp) { return pose.t < stamp; });
  if (after == trajectory.end()) return std::nullopt;
  if (after->t == t) return after->T_world_body;
  if (after == trajectory.begin()) return std::nullopt;
  const StampedPose& before = *(after - 1);
  if (after->t - before.t > max_gap) return std::nullopt;
  const double share = static_cast<double>(t - before.t) / static_cast<double>(after->t - before.t);
  const SE3d T_before_after = before.T_world_body.inverse() * after->T_world_body;
  return before.T_world_body * SE3d::exp(share * T_before_after.log());
}

double path_length(std::span<const StampedPose> trajectory) {
  double length = 0.0;
  for (std::size_t i = 1; i < trajectory.size(); ++i)
    length +=
        (trajectory[i].T_world_body.translation() - trajectory[i - 1].T_world_body.translation()).norm();
  return length;
}

}  // namespace sweepkit
