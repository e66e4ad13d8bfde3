// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "sweepkit/core/error.hpp"
#include "sweepkit/geometry/se3.hpp"

namespace sweepkit {

/// A sensor.yaml of the ASL layout, with or without the `%YAML:1.0` of OpenCV. All errors name file, line and
/// key and are of the kind `calibration`.
class SensorFile {
 public:
  explicit SensorFile(const std::filesystem::path& file);
  ~SensorFile();
  SensorFile(const SensorFile&) = delete;
  SensorFile& operator=(const SensorFile&) = delete;

  bool has(const std::string& key) const;
  /// A finite number, above zero where asked.
  double number(const std::string& key, bool positive = true) const;
  double number_or(const std::string& key, double otherwise) const;
  std::string text(const std::string& key) const;
  std::vector<double> numbers(const std::string& key) const;
  /// T_BS: a flat list of 16, `data` of a 4x4 matrix, or four rows of four. Must be a rigid motion.
  SE3d pose(const std::string& key) const;

  Error error(const std::string& key, const std::string& message, const std::string& value = {}) const;

 private:
  struct Document;
  std::filesystem::path file_;
  std::unique_ptr<Document> document_;
};

}  // namespace sweepkit
