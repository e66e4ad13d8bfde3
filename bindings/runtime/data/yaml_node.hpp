// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <yaml-cpp/yaml.h>

#include <initializer_list>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "sweepkit/core/error.hpp"
#include "sweepkit/core/options.hpp"
#include "sweepkit/geometry/so3.hpp"

namespace sweepkit {

/// A node of a YAML document that is read strictly: every error is Error(data) whose place is "FILE:LINE:
/// path.to.key".
class YamlNode {
 public:
  /// The document of a file or of text. @throws Error(io) if it cannot be read or is longer than 4 MB
  static YamlNode load(const std::string& file);
  static YamlNode parse(const std::string& text, const std::string& name);

  bool is_map() const { return node_.IsMap(); }
  bool is_list() const { return node_.IsSequence(); }
  bool is_null() const { return !node_.IsDefined() || node_.IsNull(); }

  /// Refuses keys that are not among these, naming the nearest, and keys that stand twice. Also refuses what
  /// is no map.
  void allow(std::initializer_list<std::string_view> keys) const;
  void allow(const std::vector<std::string>& keys) const;

  bool has(const std::string& key) const;
  /// The value of a key that must be there.
  YamlNode at(const std::string& key) const;
  std::vector<std::string> keys() const;
  /// The elements of a list; refuses what is none. Empty for a missing node.
  std::vector<YamlNode> items() const;

  /// This node as a value; refused unless of that type and in the range.
  double number(Range range = any_value()) const;
  int integer(Range range = any_value()) const;
  bool flag() const;
  std::string text() const;
  Vec2<double> point() const;           ///< [x, y]
  Vec3<double> point3() const;          ///< [x, y, z]
  std::vector<double> numbers() const;  ///< any number of numbers
  /// The position of a word among those allowed.
  std::size_t choice(const std::vector<std::string>& words) const;

  /// The value of a key, if it is there.
  void read(const std::string& key, double& value, Range range = any_value()) const;
  void read(const std::string& key, int& value, Range range = any_value()) const;
  void read(const std::string& key, bool& value) const;
  void read(const std::string& key, std::string& value) const;
  /// As read, of an angle in degrees, stored in radians.
  void read_degrees(const std::string& key, double& value, Range range = any_value()) const;
  /// Reads a map of options (see visit_options) that stands in this node.
  void read_options(const OptionList& options) const;

  /// An error about this node.
  Error error(const std::string& message, const std::string& value = {}) const;
  std::string place() const;
  int line() const;

 private:
  YamlNode(YAML::Node node, std::string file, std::string path, int line)
      : node_(std::move(node)), file_(std::move(file)), path_(std::move(path)), line_(line) {}

  YAML::Node node_;
  std::string file_, path_;
  int line_ = 0;  ///< of the nearest node that has one
};

}  // namespace sweepkit
