// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include <pybind11/stl.h>

#include "register.hpp"
#include "sweepkit/core/error.hpp"
#include "sweepkit/core/memory.hpp"
#include "sweepkit/core/random.hpp"
#include "sweepkit/core/version.hpp"

namespace sweepkit::python {

namespace py = pybind11;

namespace {

// Indexed by ErrorKind; live as long as the interpreter.
PyObject* error_types[5] = {};

void register_errors(py::module_& m) {
  const py::object base = py::reinterpret_steal<py::object>(
      PyErr_NewExceptionWithDoc("sweepkit.core.Error",
                                "What sweepkit throws. kind is one of argument, option, calibration, data, "
                                "io; place says where (a file "
                                "and line, an option, a parameter), value what was given; both may be empty.",
                                PyExc_RuntimeError, nullptr));
  m.attr("Error") = base;
  const auto derive = [&](ErrorKind kind, const char* name, const char* doc, PyObject* other) {
    const py::tuple bases = other ? py::make_tuple(base, py::handle(other)) : py::make_tuple(base);
    const std::string full = std::string("sweepkit.core.") + name;
    PyObject* type = PyErr_NewExceptionWithDoc(full.c_str(), doc, bases.ptr(), nullptr);
    error_types[static_cast<int>(kind)] = type;
    m.attr(name) = py::reinterpret_borrow<py::object>(type);
  };
  derive(ErrorKind::argument, "ArgumentError", "A call with a wrong value.", PyExc_ValueError);
  derive(ErrorKind::option, "OptionError", "An option that does not exist or is out of its range.",
         PyExc_ValueError);
  derive(ErrorKind::calibration, "CalibrationError", "A camera or rig that cannot be.", nullptr);
  derive(ErrorKind::data, "DataError", "A file whose content is wrong.", nullptr);
  derive(ErrorKind::io, "IoError", "A file that cannot be opened, read or written.", nullptr);

  py::register_exception_translator([](std::exception_ptr thrown) {
    if (!thrown) return;
    try {
      std::rethrow_exception(thrown);
    } catch (const Error& e) {
      const py::handle type(error_types[static_cast<int>(e.kind())]);
      py::object error = type(e.what());
      error.attr("kind") = std::string(to_string(e.kind()));
      error.attr("place") = e.place();
      error.attr("value") = e.value();
      PyErr_SetObject(type.ptr(), error.ptr());
    }
  });
}

}  // namespace

void register_core(py::module_& m) {
  register_errors(m);
  m.def("version", &version, "The version of sweepkit.");
  m.def("library_versions", &library_versions, "Names and versions of the libraries it was built with.");
  m.def("peak_memory_mb", &peak_memory_mb, "The most memory that this process has held so far [MB].");

  py::class_<Random>(m, "Random", "Random numbers from a seed, the same on every machine (xoshiro256**).")
      .def(py::init<std::uint64_t>(), py::arg("seed") = 1)
      .def("uniform", py::overload_cast<double, double>(&Random::uniform), py::arg("low") = 0.0,
           py::arg("high") = 1.0, "Uniform in [low, high).")
      .def("normal", py::overload_cast<double, double>(&Random::normal), py::arg("mean") = 0.0,
           py::arg("sigma") = 1.0, "Normal of that mean and standard deviation.")
      .def("index", &Random::index, py::arg("count"), "Uniform in 0 .. count - 1.")
      .def("__call__", &Random::operator(), "64 random bits.");
}

}  // namespace sweepkit::python
