// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/core/option_text.hpp"

#include <fmt/format.h>
#include <yaml-cpp/yaml.h>

#include <algorithm>
#include <cstring>
#include <fstream>
#include <limits>
#include <nlohmann/json.hpp>
#include <set>

#include "sweepkit/core/edit_distance.hpp"

namespace sweepkit {
namespace {

constexpr std::size_t kLongestFile = 1 << 22;

std::string_view last_name(std::string_view path) {
  const std::size_t dot = path.rfind('.');
  return dot == std::string_view::npos ? path : path.substr(dot + 1);
}

std::string join(const std::vector<std::string>& words) {
  std::string text;
  for (const auto& word : words) text += (text.empty() ? "" : ", ") + word;
  return text;
}

std::string type_name(const OptionRef& option) {
  switch (option.pointer.index()) {
    case 0:
      return "switch";
    case 1:
      return "whole number";
    case 2:
      return "number";
    case 3:
      return "text";
    case 4:
      return "list of numbers";
    default:
      return "choice";
  }
}

const char* wanted(const OptionRef& option) {
  switch (option.pointer.index()) {
    case 0:
      return "must be true or false";
    case 1:
      return "must be a whole number";
    case 2:
      return "must be a finite number";
    case 3:
      return "must be a text";
    case 4:
      return "must be a list of finite numbers, [1, 2]";
    default:
      return "must be a word";
  }
}

/// Whether all of the text is one number.
template <class Number>
bool parse_number(std::string_view text, Number& value) {
  if (!text.empty() && text.front() == '+') text.remove_prefix(1);
  const auto result = std::from_chars(text.data(), text.data() + text.size(), value);
  return result.ec == std::errc() && result.ptr == text.data() + text.size();
}

std::string shown(const YAML::Node& node) {
  if (node.IsScalar()) return node.Scalar().empty() ? "\"\"" : node.Scalar();
  if (node.IsNull() || !node.IsDefined()) return "nothing";
  YAML::Emitter emitter;
  emitter << YAML::Flow << node;
  const std::string text = emitter.c_str();
  return text.size() > 60 ? text.substr(0, 57) + "..." : text;
}

/// Reads the value of an option; the option changes only if all is well.
void assign(const OptionRef& option, const YAML::Node& node, const std::string& place) {
  const std::string at = place.empty() ? option.path : place + ": " + option.path;
  const auto fail = [&](const std::string& message) {
    throw Error(ErrorKind::option, at, message, shown(node));
  };
  const auto number = [&](const YAML::Node& scalar) {
    double value = 0.0;
    if (!scalar.IsScalar() || !parse_number(scalar.Scalar(), value) || !std::isfinite(value))
      fail(wanted(option));
    if (!option.range.contains(value)) fail(requirement_text(option));
    return value;
  };
  if (const auto* list = std::get_if<std::vector<double>*>(&option.pointer)) {
    if (!node.IsSequence()) fail(wanted(option));
    std::vector<double> values;
    for (const YAML::Node& item : node) values.push_back(number(item));
    **list = std::move(values);
    return;
  }
  if (!node.IsScalar()) fail(wanted(option));
  const std::string& text = node.Scalar();
  if (const auto* flag = std::get_if<bool*>(&option.pointer)) {
    const auto is = [&](std::initializer_list<std::string_view> words) {
      return std::find(words.begin(), words.end(), text) != words.end();
    };
    if (is({"true", "True", "yes", "on", "1"}))
      **flag = true;
    else if (is({"false", "False", "no", "off", "0"}))
      **flag = false;
    else
      fail(wanted(option));
  } else if (const auto* integer = std::get_if<int*>(&option.pointer)) {
    long long value = 0;
    if (!parse_number(text, value)) fail(wanted(option));
    if (value < std::numeric_limits<int>::min() || value > std::numeric_limits<int>::max() ||
        !option.range.contains(static_cast<double>(value)))
      fail(requirement_text(option));
    **integer = static_cast<int>(value);
  } else if (const auto* real = std::get_if<double*>(&option.pointer)) {
    **real = number(node);
  } else if (const auto* words = std::get_if<std::string*>(&option.pointer)) {
    **words = text;
  } else {
    const auto& choice = std::get<EnumRef>(option.pointer);
    if (!choice.set(text)) fail("must be one of " + join(choice.names()));
  }
}

[[noreturn]] void refuse_unknown(const OptionList& options, const std::string& path,
                                 const std::string& place) {
  const std::string nearest = nearest_option(options, path);
  throw Error(
      ErrorKind::option, place.empty() ? path : place + ": " + path,
      nearest.empty() ? "there is no such option" : "there is no such option; the nearest is " + nearest);
}

void read_map(const OptionList& options, const YAML::Node& map, const std::string& prefix,
              const std::string& name, std::set<std::string>& seen) {
  for (const auto& entry : map) {
    const std::string place = fmt::format("{}:{}", name, entry.first.Mark().line + 1);
    if (!entry.first.IsScalar())
      throw Error(ErrorKind::option, place, "a key must be a word", shown(entry.first));
    const std::string path = prefix + entry.first.Scalar();
    if (!seen.insert(path).second)
      throw Error(ErrorKind::option, place + ": " + path, "stands twice in the file");
    if (const OptionRef* option = options.find(path)) {
      assign(*option, entry.second, place);
      continue;
    }
    const bool is_group = std::any_of(options.groups.begin(), options.groups.end(),
                                      [&](const auto& group) { return group.path == path; });
    if (!is_group) refuse_unknown(options, path, place);
    if (entry.second.IsNull()) continue;
    if (!entry.second.IsMap())
      throw Error(ErrorKind::option, place + ": " + path, "is a group of options: keys are expected below it",
                  shown(entry.second));
    read_map(options, entry.second, path + ".", name, seen);
  }
}

std::string yaml_string(const std::string& text) {
  // JSON's strings are YAML's double-quoted ones.
  return nlohmann::json(text).dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
}

std::string value_text(const OptionValue& value) {
  if (const auto* flag = std::get_if<bool>(&value)) return *flag ? "true" : "false";
  if (const auto* integer = std::get_if<int>(&value)) return std::to_string(*integer);
  if (const auto* number = std::get_if<double>(&value)) return number_text(*number);
  if (const auto* list = std::get_if<std::vector<double>>(&value)) {
    std::string text;
    for (const double item : *list) text.append(text.empty() ? "[" : ", ").append(number_text(item));
    return text.empty() ? "[]" : text.append("]");
  }
  return std::get<std::string>(value);
}

std::string yaml_value(const OptionRef& option, const OptionValue& value) {
  const bool is_text = std::holds_alternative<std::string*>(option.pointer);
  return is_text ? yaml_string(std::get<std::string>(value)) : value_text(value);
}

/// "whole number, px, [1, 20000]".
std::string constraint_text(const OptionRef& option) {
  std::string text = option.choices().empty() ? type_name(option) : join(option.choices());
  if (!option.unit.empty()) text += "; " + option.unit;
  if (option.range.bounded()) text += "; " + range_text(option.range);
  return text;
}

}  // namespace

std::string nearest_option(const OptionList& options, std::string_view path) {
  std::string nearest;
  std::size_t best = std::numeric_limits<std::size_t>::max();
  const auto consider = [&](const std::string& known) {
    // A right name in the wrong group is nearer than a wrong name: it costs one.
    const std::size_t distance =
        std::min(edit_distance(path, known), edit_distance(last_name(path), last_name(known)) + 1);
    if (distance < best) {
      best = distance;
      nearest = known;
    }
  };
  for (const auto& option : options) consider(option.path);
  for (const auto& group : options.groups) consider(group.path);
  return nearest;
}

void parse_yaml_options(const OptionList& options, const std::string& text, const std::string& name) {
  YAML::Node root;
  try {
    root = YAML::Load(text);
  } catch (const YAML::Exception& exception) {
    throw Error(ErrorKind::option, fmt::format("{}:{}", name, exception.mark.line + 1),
                "is no YAML: " + exception.msg);
  }
  if (root.IsNull()) return;
  if (!root.IsMap()) throw Error(ErrorKind::option, name, "must hold keys and values, key: value");
  std::set<std::string> seen;
  read_map(options, root, "", name, seen);
}

void read_yaml_options(const OptionList& options, const std::filesystem::path& file) {
  std::ifstream stream(file, std::ios::binary);
  if (!stream || std::filesystem::is_directory(file))
    throw Error(ErrorKind::io, file.string(), stream ? "is a folder, not a file" : "cannot be opened");
  std::string text;
  char block[4096];
  while (stream.read(block, sizeof(block)) || stream.gcount() > 0) {
    text.append(block, static_cast<std::size_t>(stream.gcount()));
    if (text.size() > kLongestFile)
      throw Error(ErrorKind::option, file.string(), "is too long for a configuration");
  }
  parse_yaml_options(options, text, file.string());
}

void set_option(const OptionList& options, std::string_view assignment, const std::string& place) {
  const std::size_t equals = assignment.find('=');
  if (equals == std::string_view::npos || equals == 0)
    throw Error(ErrorKind::option, place, "must have the form path.to.key=value", std::string(assignment));
  const std::string path(assignment.substr(0, equals));
  const std::string value(assignment.substr(equals + 1));
  const OptionRef* option = options.find(path);
  if (!option) refuse_unknown(options, path, place);
  // Words are taken as they stand, whatever YAML would make of them.
  if (std::holds_alternative<std::vector<double>*>(option->pointer)) {
    YAML::Node list;
    try {
      list = YAML::Load(value);
    } catch (const YAML::Exception&) {
      list = YAML::Node(value);
    }
    assign(*option, list, place);
  } else {
    assign(*option, YAML::Node(value), place);
  }
}

std::string options_to_yaml(const OptionList& options) {
  std::string text;
  std::set<std::string> opened;
  for (const auto& option : options) {
    std::size_t depth = 0;
    for (std::size_t dot = option.path.find('.'); dot != std::string::npos;
         dot = option.path.find('.', dot + 1)) {
      const std::string group = option.path.substr(0, dot);
      if (opened.insert(group).second) {
        const auto known = std::find_if(options.groups.begin(), options.groups.end(),
                                        [&](const auto& candidate) { return candidate.path == group; });
        const std::string indent(2 * depth, ' ');
        text += fmt::format("\n{0}# {1}\n{0}{2}:\n", indent, known->doc, last_name(group));
      }
      ++depth;
    }
    const std::string indent(2 * depth, ' ');
    text += fmt::format("{0}# {1} ({2}; default {3})\n{0}{4}: {5}\n", indent, option.doc,
                        constraint_text(option), yaml_value(option, option.default_value),
                        last_name(option.path), yaml_value(option, option.value()));
  }
  return text;
}

std::string options_to_json(const OptionList& options) {
  nlohmann::ordered_json root = nlohmann::ordered_json::object();
  for (const auto& option : options) {
    nlohmann::ordered_json* node = &root;
    std::size_t begin = 0;
    for (std::size_t dot = option.path.find('.'); dot != std::string::npos;
         dot = option.path.find('.', begin)) {
      node = &(*node)[option.path.substr(begin, dot - begin)];
      begin = dot + 1;
    }
    std::visit([&](const auto& value) { (*node)[option.path.substr(begin)] = value; }, option.value());
  }
  return root.dump(2, ' ', false, nlohmann::json::error_handler_t::replace);
}

std::string options_help(const OptionList& options) {
  std::size_t width = 0;
  for (const auto& option : options) width = std::max(width, option.path.size());
  std::string text;
  for (const auto& option : options)
    text += fmt::format("  {:<{}}  {}\n  {:<{}}  {}; default {}\n", option.path, width, option.doc, "", width,
                        constraint_text(option), yaml_value(option, option.default_value));
  return text;
}

std::string options_to_markdown(const OptionList& options, const std::string& title) {
  std::string text = fmt::format("# {}\n", title);
  std::string group = "\n";  // no group has this name: the first option opens a table
  for (const auto& option : options) {
    const std::size_t dot = option.path.rfind('.');
    const std::string own = dot == std::string::npos ? "" : option.path.substr(0, dot);
    if (own != group) {
      group = own;
      const auto known = std::find_if(options.groups.begin(), options.groups.end(),
                                      [&](const auto& candidate) { return candidate.path == own; });
      if (known != options.groups.end()) text += fmt::format("\n## {}\n\n{}\n", own, known->doc);
      text += "\n| option | default | unit | values | what it is |\n| --- | --- | --- | --- | --- |\n";
    }
    const std::string numbers = option.range.bounded()
                                    ? fmt::format("{} {}", type_name(option), range_text(option.range))
                                    : type_name(option);
    const std::string values = option.choices().empty() ? numbers : join(option.choices());
    text += fmt::format("| `{}` | `{}` | {} | {} | {} |\n", option.path,
                        yaml_value(option, option.default_value), option.unit, values, option.doc);
  }
  return text;
}

}  // namespace sweepkit
