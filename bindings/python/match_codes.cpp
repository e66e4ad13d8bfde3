// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include <pybind11/stl.h>

#include <cstring>
#include <vector>

#include "arrays.hpp"
#include "options.hpp"
#include "sweepkit/match/nearest_codes.hpp"

namespace sweepkit::python {

void register_match_codes(py::module_& m);

namespace {

template <class T>
py::array_t<T> array_of(const std::vector<T>& values) {
  return py::array_t<T>(static_cast<py::ssize_t>(values.size()), values.data());
}

using Codes = ArrayOf<std::uint8_t, -1, 32>;

/// Rows of 32 bytes as codes; copied, since rows need not be aligned.
std::vector<OrbDescriptor> codes_of(const Codes& rows) {
  std::vector<OrbDescriptor> codes(rows.size());
  if (!codes.empty()) std::memcpy(codes.data(), rows.data(), rows.size() * sizeof(OrbDescriptor));
  return codes;
}

py::tuple lists_of(const NeighbourLists& lists) {
  const std::vector<std::int64_t> begins(lists.begins.begin(), lists.begins.end());
  return py::make_tuple(array_of(lists.matches), array_of(begins));
}

}  // namespace

void register_match_codes(py::module_& m) {
  bind_options<NearestCodesOptions>(m, "NearestCodesOptions", "How NearestCodes searches.");
  py::class_<NearestCodes<256>>(m, "NearestCodes",
                                "Exact neighbours in Hamming distance among many codes of 256 bits (rows of "
                                "32 bytes): scans, or looks up "
                                "tables of substrings (multi-index hashing), whichever is less work. "
                                "Searches may run in several threads.")
      .def(py::init<const NearestCodesOptions&>(), py::arg("options") = NearestCodesOptions{})
      .def_property_readonly("options", [](const NearestCodes<256>& c) { return c.options(); })
      .def("__len__", &NearestCodes<256>::size)
      .def("__contains__", &NearestCodes<256>::contains)
      .def_property_readonly("memory", &NearestCodes<256>::memory, "Bytes taken.")
      .def(
          "insert",
          [](NearestCodes<256>& codes, const Codes& rows) {
            const auto added = codes_of(rows);
            std::vector<std::int32_t> ids;
            {
              py::gil_scoped_release release;
              ids = codes.insert(added);
            }
            return array_of(ids);
          },
          py::arg("codes"), "Adds codes, an array of shape (n, 32), and returns their ids.")
      .def("remove", &NearestCodes<256>::remove, py::arg("id"),
           "ValueError if there is no code of that id; the id will be given to a later code.")
      .def("clear", &NearestCodes<256>::clear)
      .def(
          "code",
          [](const NearestCodes<256>& codes, std::int32_t id) {
            const OrbDescriptor code = codes.code(id);
            return py::array_t<std::uint8_t>(32, reinterpret_cast<const std::uint8_t*>(code.words.data()));
          },
          py::arg("id"), "The code of that id.")
      .def(
          "within",
          [](const NearestCodes<256>& codes, const Codes& queries, int radius) {
            const auto asked = codes_of(queries);
            NeighbourLists lists;
            {
              py::gil_scoped_release release;
              codes.within(asked, radius, lists);
            }
            return lists_of(lists);
          },
          py::arg("queries"), py::arg("radius"),
          "For each query all codes at a distance of at most radius, nearest first: an array of match_dtype "
          "(index "
          "is the id) and where in it the list of each query begins, with the end of the last.")
      .def(
          "nearest",
          [](const NearestCodes<256>& codes, const Codes& queries, std::size_t count) {
            const auto asked = codes_of(queries);
            NeighbourLists lists;
            {
              py::gil_scoped_release release;
              codes.nearest(asked, count, lists);
            }
            return lists_of(lists);
          },
          py::arg("queries"), py::arg("count") = 1, "The same for the count nearest codes of each query.");
}

}  // namespace sweepkit::python
