// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "yaml_node.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <limits>
#include <numbers>
#include <set>

#include "sweepkit/core/edit_distance.hpp"
#include "sweepkit/core/option_text.hpp"

namespace sweepkit {
namespace {

constexpr std::size_t kLongestFile = 1 << 22;

template <class Words>
std::string nearest_of(const Words& words, std::string_view to) {
  std::string nearest;
  std::size_t best = std::numeric_limits<std::size_t>::max();
  for (const auto& word : words)
    if (const std::size_t d = edit_distance(to, word); d < best) best = d, nearest = std::string(word);
  return nearest;
}

std::string shown(const YAML::Node& node) {
  if (!node.IsDefined() || node.IsNull()) return "nothing";
  std::string text;
  if (node.IsScalar())
    text = node.Scalar().empty() ? "\"\"" : node.Scalar();
  else
    text = node.IsMap() ? "a map" : "a list";
  return text.size() > 60 ? text.substr(0, 57) + "..." : text;
}

std::optional<double> parse_double(std::string_view text) {
  if (!text.empty() && text.front() == '+') text.remove_prefix(1);
  double value = 0;
  const auto result = std::from_chars(text.data(), text.data() + text.size(), value);
  if (text.empty() || result.ec != std::errc() || result.ptr != text.data() + text.size() ||
      !std::isfinite(value))
    return std::nullopt;
  return value;
}

}  // namespace

YamlNode YamlNode::load(const std::string& file) {
  std::ifstream stream(file, std::ios::binary);
  if (!stream || std::filesystem::is_directory(file))
    throw Error(ErrorKind::io, file, stream ? "is a folder, not a file" : "cannot be opened");
  std::string text;
  char block[4096];
  while (stream.read(block, sizeof(block)) || stream.gcount() > 0) {
    text.append(block, static_cast<std::size_t>(stream.gcount()));
    if (text.size() > kLongestFile) throw Error(ErrorKind::io, file, "is longer than 4 MB");
  }
  return parse(text, file);
}

YamlNode YamlNode::parse(const std::string& text, const std::string& name) {
  try {
    return YamlNode(YAML::Load(text), name, "", 1);
  } catch (const YAML::Exception& exception) {
    throw Error(ErrorKind::data, fmt::format("{}:{}", name, std::max(exception.mark.line, 0) + 1),
                "is no YAML: " + exception.msg);
  }
}

void YamlNode::allow(const std::vector<std::string>& known) const {
  if (!node_.IsMap()) throw error("must hold keys and values, key: value", shown(node_));
  std::set<std::string> seen;
  for (const auto& entry : node_) {
    const std::string at = fmt::format("{}:{}", file_, entry.first.Mark().line + 1);
    if (!entry.first.IsScalar()) throw Error(ErrorKind::data, at, "a key must be a word", shown(entry.first));
    const std::string& key = entry.first.Scalar();
    const std::string full = at + ": " + (path_.empty() ? key : path_ + "." + key);
    if (std::find(known.begin(), known.end(), key) == known.end())
      throw Error(ErrorKind::data, full, "there is no such key; the nearest is " + nearest_of(known, key));
    if (!seen.insert(key).second) throw Error(ErrorKind::data, full, "stands twice");
  }
}

void YamlNode::allow(std::initializer_list<std::string_view> known) const {
  std::vector<std::string> words;
  for (const std::string_view word : known) words.emplace_back(word);
  allow(words);
}

bool YamlNode::has(const std::string& key) const {
  if (!node_.IsMap()) return false;
  for (const auto& entry : node_)
    if (entry.first.IsScalar() && entry.first.Scalar() == key) return true;
  return false;
}

YamlNode YamlNode::at(const std::string& key) const {
  if (node_.IsMap())
    for (const auto& entry : node_)
      if (entry.first.IsScalar() && entry.first.Scalar() == key)
        return YamlNode(entry.second, file_, path_.empty() ? key : path_ + "." + key,
                        entry.first.Mark().line + 1);
  throw error(path_.empty() ? "needs the key " + key : "needs the key " + key + " in it");
}

std::vector<std::string> YamlNode::keys() const {
  std::vector<std::string> result;
  if (node_.IsMap())
    for (const auto& entry : node_)
      if (entry.first.IsScalar()) result.push_back(entry.first.Scalar());
  return result;
}

std::vector<YamlNode> YamlNode::items() const {
  std::vector<YamlNode> result;
  if (is_null()) return result;
  if (!node_.IsSequence()) throw error("must be a list", shown(node_));
  std::size_t i = 0;
  for (const auto& item : node_) {
    const int line = item.Mark().line + 1;
    result.push_back(YamlNode(item, file_, fmt::format("{}[{}]", path_, i++), line > 0 ? line : line_));
  }
  return result;
}

double YamlNode::number(Range allowed) const {
  const auto value = node_.IsScalar() ? parse_double(node_.Scalar()) : std::nullopt;
  if (!value) throw error("must be a finite number", shown(node_));
  if (!allowed.contains(*value)) throw error("must be in " + range_text(allowed), shown(node_));
  return *value;
}

int YamlNode::integer(Range allowed) const {
  const double value = number(allowed);
  if (value != std::floor(value) || std::abs(value) > std::numeric_limits<int>::max())
    throw error("must be a whole number", shown(node_));
  return static_cast<int>(value);
}

bool YamlNode::flag() const {
  if (node_.IsScalar()) {
    const std::string& text = node_.Scalar();
    if (text == "true" || text == "yes" || text == "on") return true;
    if (text == "false" || text == "no" || text == "off") return false;
  }
  throw error("must be true or false", shown(node_));
}

std::string YamlNode::text() const {
  if (!node_.IsScalar()) throw error("must be a text", shown(node_));
  return node_.Scalar();
}

std::vector<double> YamlNode::numbers() const {
  std::vector<double> result;
  for (const YamlNode& item : items()) result.push_back(item.number());
  return result;
}

Vec2<double> YamlNode::point() const {
  const auto values = is_list() ? numbers() : std::vector<double>{};
  if (values.size() != 2) throw error("must be a point [x, y]", shown(node_));
  return {values[0], values[1]};
}

Vec3<double> YamlNode::point3() const {
  const auto values = is_list() ? numbers() : std::vector<double>{};
  if (values.size() != 3) throw error("must be three numbers [x, y, z]", shown(node_));
  return {values[0], values[1], values[2]};
}

std::size_t YamlNode::choice(const std::vector<std::string>& words) const {
  const std::string word = text();
  const auto found = std::find(words.begin(), words.end(), word);
  if (found == words.end()) throw error("is not known; the nearest is " + nearest_of(words, word), word);
  return static_cast<std::size_t>(found - words.begin());
}

void YamlNode::read(const std::string& key, double& value, Range allowed) const {
  if (has(key)) value = at(key).number(allowed);
}
void YamlNode::read(const std::string& key, int& value, Range allowed) const {
  if (has(key)) value = at(key).integer(allowed);
}
void YamlNode::read(const std::string& key, bool& value) const {
  if (has(key)) value = at(key).flag();
}
void YamlNode::read(const std::string& key, std::string& value) const {
  if (has(key)) value = at(key).text();
}
void YamlNode::read_degrees(const std::string& key, double& value, Range allowed) const {
  if (has(key)) value = at(key).number(allowed) * std::numbers::pi / 180;
}

void YamlNode::read_options(const OptionList& options) const {
  if (is_null()) return;
  const auto read_group = [&](const auto& self, const YamlNode& node, const std::string& prefix) -> void {
    std::vector<std::string> known;
    const auto own = [&](const std::string& path) {
      if (path.size() > prefix.size() && path.compare(0, prefix.size(), prefix) == 0 &&
          path.find('.', prefix.size()) == std::string::npos)
        known.push_back(path.substr(prefix.size()));
    };
    for (const OptionRef& option : options) own(option.path);
    for (const OptionGroup& group : options.groups) own(group.path);
    node.allow(known);
    for (const std::string& key : node.keys()) {
      const YamlNode value = node.at(key);
      const OptionRef* option = options.find(prefix + key);
      if (!option) {
        if (!value.is_null()) self(self, value, prefix + key + ".");
        continue;
      }
      std::string text;
      if (value.is_list())
        for (const double number : value.numbers()) text += (text.empty() ? "[" : ", ") + number_text(number);
      if (value.is_list())
        text = text.empty() ? "[]" : text + "]";
      else
        text = value.text();
      try {
        set_option(options, option->path + "=" + text);
      } catch (const Error& e) {
        // The path is said by the place already.
        std::string message = e.what();
        if (message.compare(0, e.place().size(), e.place()) == 0) message.erase(0, e.place().size() + 2);
        throw value.error(message);
      }
    }
  };
  read_group(read_group, *this, "");
}

Error YamlNode::error(const std::string& message, const std::string& value) const {
  return Error(ErrorKind::data, place(), message, value);
}

std::string YamlNode::place() const {
  return fmt::format("{}:{}{}", file_, line(), path_.empty() ? "" : ": " + path_);
}

int YamlNode::line() const { return line_; }

}  // namespace sweepkit
