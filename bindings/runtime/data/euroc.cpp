// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/data/euroc.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <cmath>
#include <cstdlib>

#include "merged_recording.hpp"
#include "sensor_file.hpp"
#include "text_file.hpp"

namespace sweepkit {
namespace {

namespace fs = std::filesystem;

MountedCamera read_camera(const fs::path& folder) {
  const SensorFile sensor(folder / "sensor.yaml");
  if (sensor.has("camera_model") && sensor.text("camera_model") != "pinhole")
    throw sensor.error("camera_model", "must be pinhole", sensor.text("camera_model"));
  const std::vector<double> resolution = sensor.numbers("resolution");
  if (resolution.size() != 2) throw sensor.error("resolution", "must have two numbers, width and height");
  for (const double side : resolution)
    if (side < 1 || side > 65535 || side != std::floor(side))
      throw sensor.error("resolution", "width and height must be whole numbers of pixels in [1, 65535]",
                         number_text(side));

  Distortion distortion = Distortion::none;
  std::vector<double> coefficients;
  if (sensor.has("distortion_coefficients")) coefficients = sensor.numbers("distortion_coefficients");
  if (sensor.has("distortion_model")) {
    const std::string model = sensor.text("distortion_model");
    if (model == "radial-tangential" || model == "radtan" || model == "plumb_bob")
      distortion = Distortion::radial_tangential;
    else if (model == "equidistant")
      distortion = Distortion::equidistant;
    else if (model != "none")
      throw sensor.error("distortion_model", "must be radial-tangential, equidistant or none", model);
  } else if (!coefficients.empty()) {
    distortion = Distortion::radial_tangential;
  }
  if (distortion == Distortion::none) coefficients.clear();

  const std::vector<double> intrinsics = sensor.numbers("intrinsics");
  const SE3d T_body_camera = sensor.pose("T_BS");
  try {
    return {Camera(intrinsics, distortion, coefficients, static_cast<int>(resolution[0]),
                   static_cast<int>(resolution[1])),
            T_body_camera, sensor.number_or("rate_hz", 0.0)};
  } catch (const Error& error) {
    throw Error(error.kind(), (folder / "sensor.yaml").string(), error.what());
  }
}

MountedImu read_imu_description(const fs::path& folder) {
  const SensorFile sensor(folder / "sensor.yaml");
  const ImuNoise usual;
  return {sensor.pose("T_BS"),
          {sensor.number_or("gyroscope_noise_density", usual.gyro_noise_density),
           sensor.number_or("gyroscope_random_walk", usual.gyro_random_walk),
           sensor.number_or("accelerometer_noise_density", usual.accel_noise_density),
           sensor.number_or("accelerometer_random_walk", usual.accel_random_walk)},
          sensor.number_or("rate_hz", 0.0)};
}

MountedWheels read_wheel_description(const fs::path& folder) {
  const SensorFile sensor(folder / "sensor.yaml");
  return {sensor.pose("T_BS"),
          {sensor.number_or("ticks_per_revolution", 1.0), sensor.number_or("wheel_radius", 1.0),
           sensor.number("track_width")},
          sensor.number_or("rate_hz", 0.0)};
}

/// An image named in data.csv.
struct Row {
  TimeNs t;
  std::string name;
  int line;
};

std::vector<Row> read_image_list(const fs::path& folder) {
  TextFile file(folder / "data.csv");
  std::vector<Row> rows;
  while (file.next_data()) {
    const auto& fields = file.fields(2);
    const TimeNs t = file.stamp_ns_of(fields[0]);
    file.check_order(t);
    rows.push_back({t, std::string(fields[1]), file.number()});
  }
  if (rows.empty()) throw Error(ErrorKind::data, file.file().string(), "lists no images");
  return rows;
}

ListedImage listed(const fs::path& folder, const Row& row) {
  // operator/ keeps an absolute name as it is.
  return {folder / "data" / row.name, fmt::format("{}:{}", (folder / "data.csv").string(), row.line)};
}

TimeNs median_step(const std::vector<Row>& rows) {
  if (rows.size() < 2) return 0;
  std::vector<TimeNs> steps;
  for (std::size_t i = 1; i < rows.size(); ++i) steps.push_back(rows[i].t - rows[i - 1].t);
  const auto middle = steps.begin() + static_cast<std::ptrdiff_t>(steps.size() / 2);
  std::nth_element(steps.begin(), middle, steps.end());
  return *middle;
}

std::vector<ListedFrame> pair_images(const fs::path& left_folder, const std::vector<Row>& left,
                                     const fs::path& right_folder, const std::vector<Row>& right,
                                     Pairing pairing) {
  const TimeNs tolerance =
      pairing == Pairing::exact ? 0 : std::min(median_step(left), median_step(right)) / 2;
  std::vector<ListedFrame> frames;
  std::size_t pairs = 0;
  for (std::size_t l = 0, r = 0; l < left.size() || r < right.size();) {
    if (l < left.size() && r < right.size() && std::abs(left[l].t - right[r].t) <= tolerance) {
      // Of two candidates within reach the nearer one; the other stays alone.
      const TimeNs gap = std::abs(left[l].t - right[r].t);
      if (l + 1 < left.size() && std::abs(left[l + 1].t - right[r].t) < gap) {
        frames.push_back({left[l].t, listed(left_folder, left[l]), {}});
        ++l;
      } else if (r + 1 < right.size() && std::abs(left[l].t - right[r + 1].t) < gap) {
        frames.push_back({right[r].t, {}, listed(right_folder, right[r])});
        ++r;
      } else {
        frames.push_back({left[l].t, listed(left_folder, left[l]), listed(right_folder, right[r])});
        ++l, ++r, ++pairs;
      }
    } else if (r == right.size() || (l < left.size() && left[l].t < right[r].t)) {
      frames.push_back({left[l].t, listed(left_folder, left[l]), {}});
      ++l;
    } else {
      frames.push_back({right[r].t, {}, listed(right_folder, right[r])});
      ++r;
    }
  }
  if (pairs == 0 && !left.empty() && !right.empty())
    throw Error(
        ErrorKind::data, (right_folder / "data.csv").string(),
        pairing == Pairing::exact
            ? "no stamp equals one of the left camera; pairing: nearest takes the nearest within half a frame"
            : "no stamp lies within half a frame of one of the left camera");
  return frames;
}

class ImuReader {
 public:
  explicit ImuReader(const fs::path& folder) : file_(std::make_shared<TextFile>(folder / "data.csv")) {}

  std::optional<ImuSample> operator()() {
    if (!file_->next_data()) {
      if (empty_) throw Error(ErrorKind::data, file_->file().string(), "holds no samples");
      return std::nullopt;
    }
    empty_ = false;
    const auto& fields = file_->fields(7);
    ImuSample sample;
    sample.t = file_->stamp_ns_of(fields[0]);
    file_->check_order(sample.t);
    for (int i = 0; i < 3; ++i) {
      sample.gyro[i] = file_->number_of(fields[1 + i]);
      sample.accel[i] = file_->number_of(fields[4 + i]);
    }
    return sample;
  }

 private:
  std::shared_ptr<TextFile> file_;
  bool empty_ = true;
};

/// Either cumulative ticks or a log of speeds, as the header line tells.
class WheelReader {
 public:
  WheelReader(const fs::path& csv, double track_width, bool must_be_speeds)
      : file_(std::make_shared<TextFile>(csv)), track_width_(track_width) {
    // The header is a comment or the first line with letters.
    bool more = file_->next_line();
    while (more && file_->line().find_first_not_of(" \t\r#") == std::string::npos) more = file_->next_line();
    if (!more) throw Error(ErrorKind::data, csv.string(), "holds no samples");
    std::string header = file_->line();
    header.erase(0, header.find_first_not_of(" \t#"));
    if (header.rfind("t_s", 0) == 0) {
      columns_of_speeds(header);
    } else if (must_be_speeds) {
      throw file_->error("a log of wheel speeds needs a header line that begins with t_s",
                         header.substr(0, 80));
    } else if (std::isdigit(static_cast<unsigned char>(header[0]))) {
      pending_ = true;
    }
  }

  std::optional<WheelSample> operator()() {
    if (!pending_ && !file_->next_data()) {
      if (empty_) throw Error(ErrorKind::data, file_->file().string(), "holds no samples");
      return std::nullopt;
    }
    pending_ = empty_ = false;
    const auto& fields = file_->fields(std::max(first_, second_) + 1);
    WheelSample sample;
    sample.t = speeds_ ? file_->stamp_s_of(fields[0]) : file_->stamp_ns_of(fields[0]);
    file_->check_order(sample.t);
    sample.reading = speeds_ ? WheelReading::speeds : WheelReading::ticks;
    sample.left = file_->number_of(fields[first_]);
    sample.right = file_->number_of(fields[second_]);
    if (turn_rate_) {
      const double v = sample.left, half = 0.5 * sample.right * track_width_;
      sample.left = v - half;
      sample.right = v + half;
    }
    return sample;
  }

 private:
  void columns_of_speeds(const std::string& header) {
    speeds_ = true;
    first_ = second_ = 0;
    std::size_t turn = 0, forward = 0, column = 0;
    for (std::size_t at = 0; at <= header.size(); ++column) {
      const std::size_t end = std::min(header.find(',', at), header.size());
      std::string name = header.substr(at, end - at);
      name.erase(0, name.find_first_not_of(" \t"));
      name.erase(name.find_last_not_of(" \t\r") + 1);
      if (name.find("left") != std::string::npos) first_ = column;
      if (name.find("right") != std::string::npos) second_ = column;
      if (name == "v" || name == "v_mps" || name == "v_forward_mps") forward = column;
      if (name.find("omega") != std::string::npos || name.find("yaw_rate") != std::string::npos)
        turn = column;
      at = end + 1;
    }
    if (first_ && second_) return;
    if (!forward || !turn)
      throw file_->error("needs columns of the left and the right speed, or v and omega",
                         header.substr(0, 80));
    first_ = forward;
    second_ = turn;
    turn_rate_ = true;
  }

  std::shared_ptr<TextFile> file_;
  double track_width_;
  bool speeds_ = false;
  bool turn_rate_ = false;
  bool pending_ = false;
  bool empty_ = true;
  std::size_t first_ = 1;
  std::size_t second_ = 2;
};

void check_baseline(const Rig& rig, const fs::path& folder) {
  if (!rig.left || !rig.right) return;
  const SE3d T_left_right = rig.left->T_body_camera.inverse() * rig.right->T_body_camera;
  const double baseline = T_left_right.translation().norm();
  if (baseline < 1e-6)
    throw Error(ErrorKind::calibration, (folder / "cam1" / "sensor.yaml").string() + ": T_BS",
                "the baseline, the distance to cam0, must be above zero", number_text(baseline) + " m");
}

}  // namespace

std::unique_ptr<Recording> open_euroc(const fs::path& given, const RecordingOptions& options) {
  check_options(options);
  const fs::path folder = fs::is_directory(given / "mav0") ? given / "mav0" : given;
  RecordingInfo info;
  info.format = "EuRoC ASL";
  info.path = folder;
  const auto present = [&](const char* name, bool wanted) {
    const bool there = fs::is_directory(folder / name);
    if (!there) info.missing_sensors.emplace_back(name);
    return there && wanted;
  };

  Rig rig;
  MergedRecording::Streams streams;
  std::vector<Row> left, right;
  if (present("cam0", true)) {
    rig.left = read_camera(folder / "cam0");
    left = read_image_list(folder / "cam0");
  }
  if (present("cam1", true)) {
    rig.right = read_camera(folder / "cam1");
    right = read_image_list(folder / "cam1");
  }
  if (present("imu0", options.use_imu)) {
    rig.imu = read_imu_description(folder / "imu0");
    streams.imu = ImuReader(folder / "imu0");
  }
  if (present("odom0", options.use_wheels)) {
    rig.wheels = read_wheel_description(folder / "odom0");
    streams.wheels = WheelReader(folder / "odom0" / "data.csv", rig.wheels->geometry.track_width, false);
  }
  if (info.missing_sensors.size() == 4)
    throw Error(ErrorKind::io, given.string(), "is no recording: none of cam0, cam1, imu0, odom0 lies in it");
  check_baseline(rig, folder);
  if (rig.imu) {
    const SE3d T_imu_given = rig.imu->T_body_imu.inverse();
    rig.imu->T_body_imu = SE3d();
    if (T_imu_given.log().norm() > 0) {
      if (rig.left) rig.left->T_body_camera = T_imu_given * rig.left->T_body_camera;
      if (rig.right) rig.right->T_body_camera = T_imu_given * rig.right->T_body_camera;
      if (rig.wheels) rig.wheels->T_body_base = T_imu_given * rig.wheels->T_body_base;
    }
  }
  streams.frames = pair_images(folder / "cam0", left, folder / "cam1", right, options.pairing);
  const fs::path truth = folder / "state_groundtruth_estimate0" / "data.csv";
  if (fs::exists(truth)) info.truth = truth;
  return std::make_unique<MergedRecording>(std::move(info), std::move(rig), std::move(streams), options);
}

std::vector<WheelSample> read_wheel_log(const fs::path& file, double track_width) {
  require(std::isfinite(track_width) && track_width > 0, "read_wheel_log track_width", "must be above zero",
          track_width);
  WheelReader reader(file, track_width, true);
  std::vector<WheelSample> samples;
  while (const auto sample = reader()) samples.push_back(*sample);
  return samples;
}

}  // namespace sweepkit
