// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <charconv>
#include <cmath>
#include <cstddef>
#include <initializer_list>
#include <limits>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>
#include <variant>
#include <vector>

#include "sweepkit/core/error.hpp"

namespace sweepkit {

/// The closed interval that a number of an option has to lie in. Not-a-number and infinity are never allowed.
struct Range {
  double min = -std::numeric_limits<double>::infinity();
  double max = std::numeric_limits<double>::infinity();

  constexpr bool bounded() const {
    return min > -std::numeric_limits<double>::infinity() || max < std::numeric_limits<double>::infinity();
  }
  bool contains(double value) const { return std::isfinite(value) && value >= min && value <= max; }
};

/// Numbers from min to max, both included.
constexpr Range range(double min, double max) { return {min, max}; }

/// Any finite number; also what switches and texts have.
constexpr Range any_value() { return {}; }

/// One value of an enum and its name in files. Written as `{Kind::a, "a"}`.
template <class Enum>
struct Choice {
  Enum value;
  std::string_view name;
};

/// An enum member whose type was forgotten: read and written by the position among its choices.
class EnumRef {
 public:
  template <class Enum>
  EnumRef(Enum& member, std::initializer_list<Choice<Enum>> choices)
      : member_(&member),
        read_([](const void* m) { return static_cast<long long>(*static_cast<const Enum*>(m)); }),
        write_([](void* m, long long v) { *static_cast<Enum*>(m) = static_cast<Enum>(v); }) {
    for (const auto& choice : choices) {
      values_.push_back(static_cast<long long>(choice.value));
      names_.emplace_back(choice.name);
    }
  }

  const std::vector<std::string>& names() const { return names_; }

  /// The name of the present value; empty if it is none of the choices.
  std::string get() const {
    const long long value = read_(member_);
    for (std::size_t i = 0; i < values_.size(); ++i)
      if (values_[i] == value) return names_[i];
    return {};
  }

  /// False, and nothing changed, if there is no such name.
  bool set(std::string_view name) const {
    for (std::size_t i = 0; i < names_.size(); ++i)
      if (names_[i] == name) {
        write_(member_, values_[i]);
        return true;
      }
    return false;
  }

 private:
  void* member_;
  long long (*read_)(const void*);
  void (*write_)(void*, long long);
  std::vector<long long> values_;
  std::vector<std::string> names_;
};

/// Where an option's value lies.
using OptionPointer = std::variant<bool*, int*, double*, std::string*, std::vector<double>*, EnumRef>;
/// A value of an option; an enum as its name.
using OptionValue = std::variant<bool, int, double, std::string, std::vector<double>>;

/// One option of a struct of options: what is declared beside the member, and where the member is. Valid as
/// long as the struct is.
struct OptionRef {
  std::string path;  ///< names joined by dots, as in `--set`
  OptionPointer pointer;
  std::string unit;  ///< "px", "m", "deg", ...; empty if none
  Range range;
  std::string doc;            ///< one line
  OptionValue default_value;  ///< of a default-constructed struct

  /// Names to choose among; empty unless it is an enum.
  const std::vector<std::string>& choices() const {
    static const std::vector<std::string> kNone;
    const auto* choice = std::get_if<EnumRef>(&pointer);
    return choice ? choice->names() : kNone;
  }

  OptionValue value() const {
    return std::visit(
        [](const auto& p) -> OptionValue {
          if constexpr (std::is_pointer_v<std::decay_t<decltype(p)>>)
            return *p;
          else
            return p.get();
        },
        pointer);
  }
};

/// A struct of options inside another.
struct OptionGroup {
  std::string path;
  std::string doc;
};

/// All options of a struct in the order of their declaration.
struct OptionList {
  std::vector<OptionRef> options;
  std::vector<OptionGroup> groups;

  auto begin() const { return options.begin(); }
  auto end() const { return options.end(); }
  std::size_t size() const { return options.size(); }
  bool empty() const { return options.empty(); }
  const OptionRef& operator[](std::size_t i) const { return options[i]; }
  /// The option of that path, or null.
  const OptionRef* find(std::string_view path) const {
    for (const auto& option : options)
      if (option.path == path) return &option;
    return nullptr;
  }
};

/// The visitor that `visit_options` of a struct is called with. The struct declares each member once:
///
///     struct OrbOptions {
///       int count = 1000;
///       template <class Visitor>
///       void visit_options(Visitor& v) {
///         v(count, "count", "", range(1, 20000), "key points to find in an image");
///       }
///     };
///
/// Members are bool, int, double, std::string, std::vector<double>, enums (`choice`) and structs of options
/// (`group`).
class OptionLister {
 public:
  explicit OptionLister(OptionList& list) : list_(list) {}

  template <class Member>
  void operator()(Member& member, std::string_view name, std::string_view unit, Range range,
                  std::string_view doc) {
    static_assert(std::is_same_v<Member, bool> || std::is_same_v<Member, int> ||
                      std::is_same_v<Member, double> || std::is_same_v<Member, std::string> ||
                      std::is_same_v<Member, std::vector<double>>,
                  "an option is a bool, int, double, std::string or std::vector<double>; enums use choice()");
    add(&member, name, unit, range, doc);
  }

  template <class Enum>
  void choice(Enum& member, std::string_view name,
              std::type_identity_t<std::initializer_list<Choice<Enum>>> choices, std::string_view doc) {
    static_assert(std::is_enum_v<Enum>);
    add(EnumRef(member, choices), name, "", any_value(), doc);
  }

  template <class Struct>
  void group(Struct& member, std::string_view name, std::string_view doc) {
    const std::size_t length = prefix_.size();
    prefix_ += name;
    list_.groups.push_back({prefix_, std::string(doc)});
    prefix_ += '.';
    member.visit_options(*this);
    prefix_.resize(length);
  }

 private:
  void add(OptionPointer pointer, std::string_view name, std::string_view unit, Range range,
           std::string_view doc) {
    OptionRef option{
        prefix_ + std::string(name), std::move(pointer), std::string(unit), range, std::string(doc), {}};
    option.default_value = option.value();
    list_.options.push_back(std::move(option));
  }

  OptionList& list_;
  std::string prefix_;
};

/// A struct that declares its options.
template <class Options>
concept HasOptions = std::is_default_constructible_v<Options> &&
    requires(Options options, OptionLister& lister) {
  options.visit_options(lister);
};

/// Lists the options of a struct, with pointers into it and the defaults of a fresh one.
template <HasOptions Options>
OptionList list_options(Options& options) {
  OptionList list;
  OptionLister lister(list);
  options.visit_options(lister);

  Options fresh{};
  OptionList defaults;
  OptionLister default_lister(defaults);
  fresh.visit_options(default_lister);
  for (std::size_t i = 0; i < list.options.size(); ++i)
    list.options[i].default_value = std::move(defaults.options[i].default_value);
  return list;
}

/// The shortest text that reads back as the same number.
inline std::string number_text(double value) {
  char buffer[32];
  const auto result = std::to_chars(buffer, buffer + sizeof(buffer), value);
  return {buffer, result.ptr};
}

/// A range as messages and help show it: "[1, 20000]", "at least 0", or empty if there is none.
inline std::string range_text(const Range& range) {
  if (!range.bounded()) return {};
  if (range.max == std::numeric_limits<double>::infinity()) return "at least " + number_text(range.min);
  if (range.min == -std::numeric_limits<double>::infinity()) return "at most " + number_text(range.max);
  // Not by operator+ on a literal: gcc 12 then warns of an overlap that there is not (-Wrestrict).
  std::string text = number_text(range.min);
  text.insert(text.begin(), '[');
  return text.append(", ").append(number_text(range.max)).append("]");
}

/// What a number of the option must be: "must be in [1, 20] px", "must be at least 0".
inline std::string requirement_text(const OptionRef& option) {
  if (!option.range.bounded()) return "must be a finite number";
  const std::string allowed = range_text(option.range);
  std::string text = allowed.front() == '[' ? "must be in " : "must be ";
  text += allowed;
  if (!option.unit.empty()) text.append(" ").append(option.unit);
  return text;
}

/// Throws an option error unless each number of the option is finite and in its range and an enum is one of
/// its choices. `place` stands before the path in the message (a file and line); may be empty.
inline void check_option(const OptionRef& option, const std::string& place = {}) {
  const std::string at = place.empty() ? option.path : place + ": " + option.path;
  const auto check_number = [&](double value) {
    if (!std::isfinite(value))
      throw Error(ErrorKind::option, at, "must be a finite number", number_text(value));
    if (!option.range.contains(value))
      throw Error(ErrorKind::option, at, requirement_text(option), number_text(value));
  };
  std::visit(
      [&](const auto& p) {
        using Pointer = std::decay_t<decltype(p)>;
        if constexpr (std::is_same_v<Pointer, int*> || std::is_same_v<Pointer, double*>) {
          check_number(*p);
        } else if constexpr (std::is_same_v<Pointer, std::vector<double>*>) {
          for (const double value : *p) check_number(value);
        } else if constexpr (std::is_same_v<Pointer, EnumRef>) {
          if (p.get().empty()) throw Error(ErrorKind::option, at, "is none of its choices");
        }
      },
      option.pointer);
}

/// Checks every option of a struct; throws Error(option) that names the path, the range and the value.
template <HasOptions Options>
void check_options(const Options& options) {
  // visit_options hands out references and so is not const; the lister only reads.
  for (const auto& option : list_options(const_cast<Options&>(options))) check_option(option);
}

}  // namespace sweepkit
