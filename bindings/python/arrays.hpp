// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <type_traits>

#include "sweepkit/core/view.hpp"

namespace sweepkit::python {

namespace py = pybind11;

/// "float64 of shape (3, 4)".
inline std::string describe(const py::array& a) {
  std::string text = py::str(a.dtype()).cast<std::string>() + " of shape (";
  for (py::ssize_t i = 0; i < a.ndim(); ++i) text += (i ? ", " : "") + std::to_string(a.shape(i));
  return text + (a.ndim() == 1 ? ",)" : ")");
}

/// A parameter that takes numbers in an array of that shape; -1 stands for any length. An array of the type
/// itself in C order is used where it lies; other real numbers, also in lists, are converted. Anything else
/// is a ValueError that names what was expected and what was given.
template <class Scalar, int... Shape>
struct ArrayOf {
  py::array_t<Scalar, py::array::c_style> array;

  std::size_t size() const { return static_cast<std::size_t>(array.shape(0)); }
  const Scalar* data() const { return array.data(); }
  /// The elements as fixed-size Eigen vectors or matrices by rows, one after the other.
  template <class Element>
  std::span<const Element> as() const {
    static_assert(std::is_same_v<typename Element::Scalar, Scalar> &&
                  sizeof(Element) == sizeof(Scalar) * Element::SizeAtCompileTime);
    return {reinterpret_cast<const Element*>(array.data()), size()};
  }
  /// A whole array of fixed shape as an Eigen vector or, by rows, matrix.
  template <class Result>
  Result eigen() const {
    constexpr int kOrder = Result::ColsAtCompileTime == 1 ? Eigen::ColMajor : Eigen::RowMajor;
    return Eigen::Map<
        const Eigen::Matrix<Scalar, Result::RowsAtCompileTime, Result::ColsAtCompileTime, kOrder>>(
        array.data());
  }

  static std::string expected() {
    std::string text = py::str(py::dtype::of<Scalar>()).template cast<std::string>() + " of shape (";
    constexpr std::array<int, sizeof...(Shape)> kShape{Shape...};
    for (std::size_t i = 0; i < kShape.size(); ++i)
      text += (i ? ", " : "") + (kShape[i] < 0 ? std::string("n") : std::to_string(kShape[i]));
    return text + (kShape.size() == 1 ? ",)" : ")");
  }
};

using Vector2 = ArrayOf<double, 2>;
using Vector3 = ArrayOf<double, 3>;
using Vector6 = ArrayOf<double, 6>;
using Vector7 = ArrayOf<double, 7>;
using Matrix3 = ArrayOf<double, 3, 3>;
using Matrix4 = ArrayOf<double, 4, 4>;
using Points2 = ArrayOf<double, -1, 2>;
using Points3 = ArrayOf<double, -1, 3>;
using Numbers = ArrayOf<double, -1>;

/// A parameter that takes an 8-bit grey image: uint8 of shape (height, width). Rows may be padded or turned
/// round; only where pixels of a row are not side by side is it copied.
struct Gray {
  py::array_t<std::uint8_t> array;

  GrayView view() const {
    return {array.data(), static_cast<int>(array.shape(1)), static_cast<int>(array.shape(0)),
            array.strides(0)};
  }
};

/// An array that looks at memory of `owner`, which it keeps alive; cannot be written to.
template <class T>
py::array view_of(const T* data, std::vector<py::ssize_t> shape, std::vector<py::ssize_t> strides,
                  const py::handle& owner) {
  py::array result(py::dtype::of<T>(), std::move(shape), std::move(strides), data, owner);
  py::detail::array_proxy(result.ptr())->flags &= ~py::detail::npy_api::NPY_ARRAY_WRITEABLE_;
  return result;
}

/// The same for a grey image.
inline py::array image_view(const GrayView& view, const py::handle& owner) {
  return view_of(view.data, {view.height, view.width}, {view.stride, 1}, owner);
}

}  // namespace sweepkit::python

namespace pybind11::detail {

template <class Scalar, int... Shape>
struct type_caster<sweepkit::python::ArrayOf<Scalar, Shape...>> {
  using Value = sweepkit::python::ArrayOf<Scalar, Shape...>;
  PYBIND11_TYPE_CASTER(Value, const_name("numpy.typing.ArrayLike"));

  bool load(handle source, bool) {
    if (source.is_none()) return false;  // left to std::optional
    array given = array::ensure(source);
    if (!given) {
      PyErr_Clear();
      throw value_error("expected " + Value::expected() + ", got " +
                        std::string(str(type::handle_of(source).attr("__name__"))));
    }
    constexpr std::array<int, sizeof...(Shape)> kShape{Shape...};
    const char kind = given.dtype().kind();
    const bool is_number = kind == 'f' || kind == 'i' || kind == 'u';
    bool fits = given.ndim() == static_cast<ssize_t>(kShape.size()) && (is_number || given.size() == 0);
    for (std::size_t i = 0; fits && i < kShape.size(); ++i)
      fits = kShape[i] < 0 || given.shape(static_cast<ssize_t>(i)) == kShape[i];
    // An integer parameter (indices, descriptors) does not take fractions.
    if (std::is_integral_v<Scalar> && kind == 'f' && given.size() > 0) fits = false;
    if (!fits)
      throw value_error("expected " + Value::expected() + ", got " + sweepkit::python::describe(given));
    value.array = array_t<Scalar, array::c_style | array::forcecast>::ensure(given);
    return static_cast<bool>(value.array);
  }
  static handle cast(const Value& source, return_value_policy, handle) {
    return object(source.array).release();
  }
};

template <>
struct type_caster<sweepkit::python::Gray> {
  PYBIND11_TYPE_CASTER(sweepkit::python::Gray, const_name("numpy.typing.NDArray[numpy.uint8]"));

  bool load(handle source, bool) {
    if (source.is_none()) return false;
    if (!isinstance<array>(source))
      throw value_error("expected an image, uint8 of shape (height, width), got " +
                        std::string(str(type::handle_of(source).attr("__name__"))));
    auto given = reinterpret_borrow<array>(source);
    if (given.dtype().kind() != 'u' || given.dtype().itemsize() != 1 || given.ndim() != 2)
      throw value_error("expected an image, uint8 of shape (height, width), got " +
                        sweepkit::python::describe(given));
    if (given.strides(1) != 1 && given.shape(1) > 1) given = array_t<std::uint8_t, array::c_style>(given);
    value.array = reinterpret_borrow<array_t<std::uint8_t>>(given);
    return true;
  }
  static handle cast(const sweepkit::python::Gray& source, return_value_policy, handle) {
    return object(source.array).release();
  }
};

}  // namespace pybind11::detail
