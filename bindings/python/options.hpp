// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <cstddef>
#include <string>
#include <type_traits>
#include <vector>

#include "sweepkit/core/option_text.hpp"
#include "sweepkit/core/options.hpp"

namespace sweepkit::python {

namespace py = pybind11;

/// The value of an option as a Python object; an enum as its name.
py::object option_to_python(const OptionRef& option);

/// Sets an option from a Python object of its type (an int for a float will do). Throws Error(option) for
/// another type, or a value out of range: the option keeps its value then.
void option_from_python(const OptionRef& option, const py::handle& value);

/// All options as dict, groups as dicts in it.
py::dict options_to_dict(const OptionList& list);

/// What each option is: list of dicts with path, type, default, unit, min, max, choices, doc.
py::list describe_options(const OptionList& list);

/// "Name(field=value, ...)".
std::string options_repr(const std::string& name, const OptionList& list);

/// Error(option) for a keyword that is no option, naming the nearest one.
[[noreturn]] void refuse_keyword(const OptionList& list, const std::string& keyword);

/// Declares a property for each direct member; where it lies is told from a fresh struct.
template <class Options>
struct OptionBinder {
  py::class_<Options>& cls;
  Options& fresh;

  template <class Member>
  std::size_t offset_of(Member& member) const {
    return static_cast<std::size_t>(reinterpret_cast<char*>(&member) - reinterpret_cast<char*>(&fresh));
  }
  void value(std::string_view option, std::string_view unit, const Range& range, std::string_view doc) {
    const std::string path(option);
    std::string text(doc);
    if (!unit.empty()) text += " [" + std::string(unit) + "]";
    if (range.bounded()) text += ", " + range_text(range);
    cls.def_property(
        path.c_str(), [path](Options& o) { return option_to_python(*list_options(o).find(path)); },
        [path](Options& o, const py::object& v) { option_from_python(*list_options(o).find(path), v); },
        text.c_str());
  }
  template <class Member>
  void operator()(Member&, std::string_view option, std::string_view unit, Range range,
                  std::string_view doc) {
    value(option, unit, range, doc);
  }
  template <class Enum>
  void choice(Enum&, std::string_view option,
              std::type_identity_t<std::initializer_list<Choice<Enum>>> choices, std::string_view doc) {
    std::string text(doc);
    text += "; one of";
    for (const auto& c : choices) {
      text += ' ';
      text += c.name;
    }
    value(option, "", any_value(), text);
  }
  template <class Struct>
  void group(Struct& member, std::string_view option, std::string_view doc) {
    const std::size_t offset = offset_of(member);
    const auto at = [offset](Options& o) -> Struct& {
      return *reinterpret_cast<Struct*>(reinterpret_cast<char*>(&o) + offset);
    };
    cls.def_property(
        std::string(option).c_str(), py::cpp_function(at, py::return_value_policy::reference_internal),
        py::cpp_function([at](Options& o, const Struct& v) { at(o) = v; }), std::string(doc).c_str());
  }
};
/// Binds a struct of options as a class like a dataclass: keyword arguments, fields with documentation,
/// checked on every assignment, equality, repr, copy, pickle. Structs within it must have been bound before.
template <HasOptions Options>
py::class_<Options> bind_options(py::module_& m, const char* name, const char* doc) {
  py::class_<Options> cls(m, name, doc);

  Options fresh{};
  OptionBinder<Options> binder{cls, fresh};
  fresh.visit_options(binder);

  const auto update = [](const py::object& self, const py::dict& values) {
    const OptionList list = list_options(self.cast<Options&>());
    for (const auto& [key, value] : values) {
      const auto keyword = key.template cast<std::string>();
      bool is_group = false;
      for (const auto& group : list.groups) is_group = is_group || group.path == keyword;
      if (keyword.find('.') != std::string::npos || (!is_group && !list.find(keyword)))
        refuse_keyword(list, keyword);
      if (is_group && py::isinstance<py::dict>(value))
        self.attr(keyword.c_str()).attr("update")(**py::reinterpret_borrow<py::dict>(value));
      else
        self.attr(keyword.c_str()) = value;
    }
  };
  const auto copy = [](const Options& o) { return Options(o); };
  cls.def(py::init([update](const py::kwargs& values) {
            // Checked one by one on a Python object, which then gives the value.
            py::object made = py::cast(Options{});
            update(made, values);
            return made.cast<Options>();
          }),
          "Defaults, but for the fields that are named.")
      .def(
          "update", [update](const py::object& self, const py::kwargs& values) { update(self, values); },
          "Sets the fields that are named; groups also from dicts.")
      .def(
          "replace",
          [update](const Options& o, const py::kwargs& values) {
            py::object made = py::cast(Options(o));
            update(made, values);
            return made.cast<Options>();
          },
          "A copy in which the named fields are set.")
      .def(
          "to_dict", [](Options& o) { return options_to_dict(list_options(o)); },
          "All fields by name, groups as dicts.")
      .def(
          "to_yaml", [](Options& o) { return options_to_yaml(list_options(o)); },
          "A YAML file with documentation.")
      .def_static(
          "from_yaml",
          [](const std::string& path) {
            Options o{};
            read_yaml_options(list_options(o), path);
            return o;
          },
          py::arg("path"), "Reads a YAML file; keys that are missing keep their defaults.")
      .def_static(
          "describe",
          []() {
            Options o{};
            return describe_options(list_options(o));
          },
          "What each field is: path, type, default, unit, min, max, choices, doc.")
      .def("__repr__", [name = std::string(name)](Options& o) { return options_repr(name, list_options(o)); })
      .def(
          "__eq__",
          [](Options& a, const py::object& other) -> py::object {
            if (!py::isinstance<Options>(other)) return py::reinterpret_borrow<py::object>(Py_NotImplemented);
            const OptionList left = list_options(a), right = list_options(other.cast<Options&>());
            for (std::size_t i = 0; i < left.size(); ++i)
              if (left[i].value() != right[i].value()) return py::bool_(false);
            return py::bool_(true);
          },
          py::arg("other"))
      .def("__copy__", copy)
      .def(
          "__deepcopy__", [copy](const Options& o, const py::dict&) { return copy(o); }, py::arg("memo"))
      .def(py::pickle([](Options& o) { return options_to_dict(list_options(o)); },
                      [update](const py::dict& values) {
                        py::object made = py::cast(Options{});
                        update(made, values);
                        return made.cast<Options>();
                      }));
  return cls;
}

}  // namespace sweepkit::python
