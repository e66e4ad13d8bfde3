// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/bow/recall.hpp"

#include <pybind11/stl.h>

#include <cstring>
#include <vector>

#include "arrays.hpp"
#include "sweepkit/bow/point_line.hpp"

namespace sweepkit::python {

void register_recall(py::module_& m);

namespace {

using Rows = ArrayOf<std::uint8_t, -1, 32>;

std::vector<OrbDescriptor> rows_of(const Rows& rows) {
  std::vector<OrbDescriptor> descriptors(rows.size());
  if (!descriptors.empty()) std::memcpy(descriptors.data(), rows.data(), rows.size() * sizeof(OrbDescriptor));
  return descriptors;
}

}  // namespace

void register_recall(py::module_& m) {
  py::enum_<PlaceRelation>(m, "PlaceRelation", "What an image of the database is to one that is looked for.")
      .value("ignored", PlaceRelation::ignored)
      .value("wrong", PlaceRelation::wrong)
      .value("right", PlaceRelation::right);
  py::class_<Recall>(m, "Recall", "Recall_N for several N.")
      .def_readonly("counts", &Recall::counts)
      .def_readonly("values", &Recall::values, "Mean of Recall_N over the images, in [0, 1].")
      .def_readonly("short_of", &Recall::short_of, "Images with fewer than N true neighbours.")
      .def_readonly("images", &Recall::images, "Images that were looked for and have a true neighbour.")
      .def_readonly("without", &Recall::without, "Images left out, since they have none.");
  py::class_<RecallMeter>(
      m, "RecallMeter",
      "Of the N most similar images M are right: M / min(N, right ones there are), in the mean.")
      .def(py::init<std::vector<int>>(), py::arg("counts") = std::vector<int>{1, 20, 40, 60})
      .def(
          "add",
          [](RecallMeter& meter, const Numbers& scores, const ArrayOf<std::uint8_t, -1>& relations) {
            std::vector<PlaceRelation> kinds(relations.size());
            for (std::size_t i = 0; i < kinds.size(); ++i) {
              require(relations.data()[i] <= 2, "RecallMeter.add relations",
                      "must be values of PlaceRelation", static_cast<int>(relations.data()[i]));
              kinds[i] = static_cast<PlaceRelation>(relations.data()[i]);
            }
            meter.add(std::span(scores.data(), scores.size()), kinds);
          },
          py::arg("scores"), py::arg("relations"),
          "Counts one image: how alike it is to each of the database, and what each is to it (uint8: 0 "
          "ignored, 1 "
          "wrong, 2 right).")
      .def("result", &RecallMeter::result);
  py::class_<PointLineBag>(m, "PointLineBag", "The words of the points and of the lines of an image.")
      .def_readonly("points", &PointLineBag::points)
      .def_readonly("lines", &PointLineBag::lines);
  py::class_<PointLineVocabulary<>>(m, "PointLineVocabulary",
                                    "Two vocabularies, of points and of lines, with one score.")
      .def(py::init<Vocabulary<256>, Vocabulary<256>, double>(), py::arg("points"), py::arg("lines"),
           py::arg("line_weight") = 0.2)
      .def_property_readonly("line_weight", &PointLineVocabulary<>::line_weight)
      .def(
          "transform",
          [](const PointLineVocabulary<>& vocabulary, const Rows& points, const Rows& lines) {
            const auto p = rows_of(points), l = rows_of(lines);
            py::gil_scoped_release release;
            return vocabulary.transform(p, l);
          },
          py::arg("points"), py::arg("lines"), "Descriptors of shape (n, 32) each; gives a PointLineBag.")
      .def("score", &PointLineVocabulary<>::score, py::arg("a"), py::arg("b"),
           "(1 - line_weight) times the score of the points plus line_weight times that of the lines; the "
           "points "
           "alone where one has no lines.");
}

}  // namespace sweepkit::python
