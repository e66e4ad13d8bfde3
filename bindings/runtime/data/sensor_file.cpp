// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sensor_file.hpp"

#include <fmt/format.h>
#include <yaml-cpp/yaml.h>

#include <Eigen/LU>
#include <cmath>

#include "text_file.hpp"

namespace sweepkit {

struct SensorFile::Document {
  YAML::Node root;
};

SensorFile::SensorFile(const std::filesystem::path& file)
    : file_(file), document_(std::make_unique<Document>()) {
  std::string content;
  TextFile lines(file);
  while (lines.next_line()) {
    // OpenCV's header is no YAML directive; a blank keeps the numbers of the lines.
    if (lines.line().rfind("%YAML:", 0) != 0) content += lines.line();
    content += '\n';
    if (content.size() > (1u << 20))
      throw Error(ErrorKind::calibration, lines.place(), "the file is too long");
  }
  try {
    document_->root = YAML::Load(content);
  } catch (const YAML::Exception& exception) {
    throw Error(ErrorKind::calibration, fmt::format("{}:{}", file.string(), exception.mark.line + 1),
                "is no YAML: " + exception.msg);
  }
  if (!document_->root.IsMap())
    throw Error(ErrorKind::calibration, file.string(), "holds no keys: a sensor description is expected");
}

SensorFile::~SensorFile() = default;

bool SensorFile::has(const std::string& key) const { return document_->root[key].IsDefined(); }

Error SensorFile::error(const std::string& key, const std::string& message, const std::string& value) const {
  std::string place = file_.string();
  // The key's line, not the value's: a matrix begins on the line after.
  for (const auto& entry : document_->root)
    if (entry.first.IsScalar() && entry.first.Scalar() == key)
      place += fmt::format(":{}", entry.first.Mark().line + 1);
  return Error(ErrorKind::calibration, place + ": " + key, message, value);
}

double SensorFile::number(const std::string& key, bool positive) const {
  if (!has(key)) throw error(key, "is missing");
  double value = std::nan("");
  const YAML::Node node = document_->root[key];
  if (!node.IsScalar() || !YAML::convert<double>::decode(node, value) || !std::isfinite(value))
    throw error(key, "must be a finite number", node.IsScalar() ? node.Scalar() : "");
  if (positive && value <= 0) throw error(key, "must be above zero", node.Scalar());
  return value;
}

double SensorFile::number_or(const std::string& key, double otherwise) const {
  return has(key) ? number(key) : otherwise;
}

std::string SensorFile::text(const std::string& key) const {
  if (!has(key)) throw error(key, "is missing");
  const YAML::Node node = document_->root[key];
  if (!node.IsScalar()) throw error(key, "must be a word");
  return node.Scalar();
}

std::vector<double> SensorFile::numbers(const std::string& key) const {
  if (!has(key)) throw error(key, "is missing");
  YAML::Node node = document_->root[key];
  if (node.IsMap() && node["data"].IsDefined()) {
    for (const char* side : {"rows", "cols"})
      if (node[side].IsDefined() && (!node[side].IsScalar() || node[side].Scalar() != "4"))
        throw error(key, std::string("must have 4 ") + side,
                    node[side].IsScalar() ? node[side].Scalar() : "");
    node.reset(node["data"]);
  }
  if (!node.IsSequence()) throw error(key, "must be a list of numbers");
  std::vector<double> values;
  const auto add = [&](const YAML::Node& item) {
    double value = std::nan("");
    if (!item.IsScalar() || !YAML::convert<double>::decode(item, value) || !std::isfinite(value))
      throw error(key, fmt::format("number {} is not a finite number", values.size() + 1),
                  item.IsScalar() ? item.Scalar() : "");
    values.push_back(value);
  };
  for (const YAML::Node& item : node) {
    if (item.IsSequence())
      for (const YAML::Node& inner : item) add(inner);
    else
      add(item);
  }
  return values;
}

SE3d SensorFile::pose(const std::string& key) const {
  const std::vector<double> values = numbers(key);
  if (values.size() != 16)
    throw error(key, "must have 16 numbers, a 4x4 matrix by rows", std::to_string(values.size()));
  const Eigen::Matrix4d T = Eigen::Map<const Eigen::Matrix<double, 4, 4, Eigen::RowMajor>>(values.data());
  const Eigen::Matrix3d R = T.topLeftCorner<3, 3>();
  const double determinant = R.determinant();
  if (std::abs(determinant) < 1e-3)
    throw error(key, "the rotation is singular", fmt::format("determinant {:.3g}", determinant));
  const double deviation = (R * R.transpose() - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff();
  if (determinant < 0 || deviation > 1e-3)
    throw error(key, "the upper left 3x3 part is no rotation",
                fmt::format("determinant {:.6g}, R R^T differs from I by {:.3g}", determinant, deviation));
  if ((T.row(3) - Eigen::RowVector4d(0, 0, 0, 1)).cwiseAbs().maxCoeff() > 1e-9)
    throw error(key, "the last row must be 0 0 0 1");
  return SE3d(T);
}

}  // namespace sweepkit
