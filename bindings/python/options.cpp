// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "options.hpp"

#include "sweepkit/core/error.hpp"

namespace sweepkit::python {

py::object option_to_python(const OptionRef& option) {
  return std::visit([](const auto& value) -> py::object { return py::cast(value); }, option.value());
}

namespace {

const char* type_name(const OptionRef& option) {
  constexpr const char* kNames[] = {"bool", "int", "float", "str", "list[float]", "str"};
  return kNames[option.pointer.index()];
}

[[noreturn]] void refuse_type(const OptionRef& option, const py::handle& value) {
  throw Error(ErrorKind::option, option.path, std::string("takes a value of type ") + type_name(option),
              py::repr(value).cast<std::string>());
}

bool is_bool(const py::handle& value) {
  return PyBool_Check(value.ptr()) || std::string(Py_TYPE(value.ptr())->tp_name) == "numpy.bool_";
}

// Numbers are those of Python and numpy; texts and truth values are none.
bool is_integer(const py::handle& value) { return !is_bool(value) && PyIndex_Check(value.ptr()); }
bool is_real(const py::handle& value) {
  return is_integer(value) ||
         (!is_bool(value) && !py::isinstance<py::str>(value) && PyNumber_Check(value.ptr()) &&
          !PyComplex_Check(value.ptr()) && py::hasattr(value, "__float__"));
}

}  // namespace

void option_from_python(const OptionRef& option, const py::handle& value) {
  const auto checked = [&](auto* member, auto next) {
    std::swap(*member, next);
    try {
      check_option(option);
    } catch (...) {
      std::swap(*member, next);
      throw;
    }
  };
  std::visit(
      [&](const auto& pointer) {
        using Pointer = std::decay_t<decltype(pointer)>;
        if constexpr (std::is_same_v<Pointer, bool*>) {
          if (!is_bool(value)) refuse_type(option, value);
          checked(pointer, py::cast<bool>(py::bool_(py::reinterpret_borrow<py::object>(value))));
        } else if constexpr (std::is_same_v<Pointer, int*>) {
          if (!is_integer(value)) refuse_type(option, value);
          const py::int_ number(py::reinterpret_borrow<py::object>(value));
          int small = 0;
          try {
            small = number.cast<int>();
          } catch (const py::cast_error&) {
            throw Error(ErrorKind::option, option.path, "must be in " + range_text(option.range),
                        py::repr(value).cast<std::string>());
          }
          checked(pointer, small);
        } else if constexpr (std::is_same_v<Pointer, double*>) {
          if (!is_real(value)) refuse_type(option, value);
          checked(pointer, py::float_(py::reinterpret_borrow<py::object>(value)).cast<double>());
        } else if constexpr (std::is_same_v<Pointer, std::string*>) {
          if (!py::isinstance<py::str>(value) && !py::hasattr(value, "__fspath__"))
            refuse_type(option, value);
          checked(pointer, py::str(value).cast<std::string>());
        } else if constexpr (std::is_same_v<Pointer, std::vector<double>*>) {
          if (py::isinstance<py::str>(value) || !py::isinstance<py::iterable>(value))
            refuse_type(option, value);
          std::vector<double> numbers;
          for (const auto& item : py::reinterpret_borrow<py::iterable>(value)) {
            if (!is_real(item)) refuse_type(option, value);
            numbers.push_back(py::float_(py::reinterpret_borrow<py::object>(item)).cast<double>());
          }
          checked(pointer, std::move(numbers));
        } else {
          if (!py::isinstance<py::str>(value)) refuse_type(option, value);
          const auto name = value.cast<std::string>();
          if (pointer.set(name)) return;
          std::string names;
          for (const auto& choice : pointer.names()) names += (names.empty() ? "" : ", ") + choice;
          throw Error(ErrorKind::option, option.path, "must be one of " + names, name);
        }
      },
      option.pointer);
}

py::dict options_to_dict(const OptionList& list) {
  py::dict result;
  for (const auto& option : list) {
    py::dict at = result;
    std::size_t begin = 0;
    for (std::size_t dot; (dot = option.path.find('.', begin)) != std::string::npos; begin = dot + 1) {
      const py::str key(option.path.substr(begin, dot - begin));
      if (!at.contains(key)) at[key] = py::dict();
      at = at[key].cast<py::dict>();
    }
    at[py::str(option.path.substr(begin))] = option_to_python(option);
  }
  return result;
}

py::list describe_options(const OptionList& list) {
  py::list result;
  for (const auto& option : list) {
    py::dict field;
    field["path"] = option.path;
    field["type"] = type_name(option);
    field["default"] =
        std::visit([](const auto& value) -> py::object { return py::cast(value); }, option.default_value);
    field["unit"] = option.unit;
    field["min"] = option.range.min;
    field["max"] = option.range.max;
    field["choices"] = option.choices();
    field["doc"] = option.doc;
    result.append(field);
  }
  return result;
}

std::string options_repr(const std::string& name, const OptionList& list) {
  std::string text = name + "(";
  bool first = true;
  for (const auto& [key, value] : options_to_dict(list)) {
    text += (first ? "" : ", ") + key.cast<std::string>() + "=" + py::repr(value).cast<std::string>();
    first = false;
  }
  return text + ")";
}

void refuse_keyword(const OptionList& list, const std::string& keyword) {
  std::string message = "there is no such option";
  if (!list.empty()) message += "; the nearest is " + nearest_option(list, keyword);
  throw Error(ErrorKind::option, keyword, message);
}

}  // namespace sweepkit::python
