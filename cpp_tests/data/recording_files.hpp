// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

#include "scratch_folder.hpp"
#include "sweepkit/data/image_file.hpp"
#include "sweepkit/data/recording.hpp"

namespace sweepkit {

inline constexpr int kWidth = 32, kHeight = 24;

inline void write_gray_png(const std::filesystem::path& file, int value, int width = kWidth,
                           int height = kHeight) {
  std::filesystem::create_directories(file.parent_path());
  const NewGray image = make_gray(width, height);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) image.pixels(x, y) = static_cast<std::uint8_t>(value);
  write_png(file, image.image.view);
}

inline std::string camera_yaml(double x) {
  return "%YAML:1.0\nsensor_type: camera\nT_BS:\n  cols: 4\n  rows: 4\n  data: [1, 0, 0, " +
         std::to_string(x) +
         ",\n    0, 1, 0, 0,\n    0, 0, 1, 0,\n    0, 0, 0, 1]\nrate_hz: 10\nresolution: [32, 24]\n"
         "camera_model: pinhole\nintrinsics: [20, 20, 16, 12]\ndistortion_model: radial-tangential\n"
         "distortion_coefficients: [-0.1, 0.01, 0, 0]\n";
}

inline const char* const kIdentity = "T_BS: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]\n";

/// A recording in the ASL layout of 5 images at 10 Hz from t = 1 s, IMU at 100 Hz from 0.95 s, wheels at 50
/// Hz from 1 s. Images of the left camera have the grey 10 + i, those of the right one 100 + i.
inline void write_euroc(const ScratchFolder& folder) {
  std::string csv = "#timestamp [ns],filename\n";
  for (int i = 0; i < 5; ++i) {
    const std::string stamp = std::to_string(1'000'000'000LL + i * 100'000'000LL);
    csv += stamp + "," + stamp + ".png\n";
    write_gray_png(folder / ("mav0/cam0/data/" + stamp + ".png"), 10 + i);
    write_gray_png(folder / ("mav0/cam1/data/" + stamp + ".png"), 100 + i);
  }
  for (int side = 0; side < 2; ++side) {
    const std::string camera = "mav0/cam" + std::to_string(side);
    folder.write(camera + "/data.csv", csv);
    folder.write(camera + "/sensor.yaml", camera_yaml(0.1 * side));
  }
  std::string imu = "#t,wx,wy,wz,ax,ay,az\n";
  for (int i = 0; i < 50; ++i)
    imu += std::to_string(950'000'000LL + i * 10'000'000LL) + ",0.1,0.2,0.3,0,0,9.81\n";
  folder.write("mav0/imu0/data.csv", imu);
  folder.write("mav0/imu0/sensor.yaml",
               std::string(kIdentity) + "rate_hz: 100\ngyroscope_noise_density: 1.5e-4\n");
  std::string wheels = "#timestamp [ns],left [ticks],right [ticks]\n";
  for (int i = 0; i < 21; ++i)
    wheels += std::to_string(1'000'000'000LL + i * 20'000'000LL) + "," + std::to_string(7 * i) + "," +
              std::to_string(100 + 8 * i) + "\n";
  folder.write("mav0/odom0/data.csv", wheels);
  folder.write("mav0/odom0/sensor.yaml", std::string(kIdentity) +
                                             "rate_hz: 50\nticks_per_revolution: 100\nwheel_radius: 0.05\n"
                                             "track_width: 0.3\n");
}

/// Reads to the end and gives the samples.
inline std::vector<Sample> read_all(Source& source) {
  std::vector<Sample> samples;
  while (auto sample = source.next()) samples.push_back(std::move(*sample));
  return samples;
}

template <class T>
std::vector<T> only(const std::vector<Sample>& samples) {
  std::vector<T> chosen;
  for (const Sample& sample : samples)
    if (const T* s = std::get_if<T>(&sample)) chosen.push_back(*s);
  return chosen;
}

}  // namespace sweepkit
