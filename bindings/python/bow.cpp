// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include <pybind11/functional.h>
#include <pybind11/stl.h>

#include <cstring>
#include <functional>
#include <memory>
#include <optional>
#include <vector>

#include "arrays.hpp"
#include "options.hpp"
#include "register.hpp"
#include "sweepkit/bow/bag_score.hpp"
#include "sweepkit/bow/inverted_file.hpp"
#include "sweepkit/bow/vocabulary.hpp"
#include "sweepkit/bow/vocabulary_file.hpp"
#include "sweepkit/bow/vocabulary_training.hpp"

namespace sweepkit::python {

void register_recall(py::module_& m);  // recall.cpp

namespace {

using Rows = ArrayOf<std::uint8_t, -1, 32>;
using Ids = ArrayOf<std::uint32_t, -1>;

template <class T>
py::array_t<T> array_of(std::span<const T> values) {
  return py::array_t<T>(static_cast<py::ssize_t>(values.size()), values.data());
}

std::vector<OrbDescriptor> descriptors_of(const Rows& rows) {
  std::vector<OrbDescriptor> descriptors(rows.size());
  if (!descriptors.empty()) std::memcpy(descriptors.data(), rows.data(), rows.size() * sizeof(OrbDescriptor));
  return descriptors;
}

template <class T>
std::vector<T> vector_of(const ArrayOf<T, -1>& array) {
  return {array.data(), array.data() + array.size()};
}

void bind_tree(py::module_& m) {
  py::enum_<BagWeighting>(m, "BagWeighting", "What a word of an image is worth.")
      .value("tf_idf", BagWeighting::tf_idf)
      .value("tf", BagWeighting::tf)
      .value("idf", BagWeighting::idf)
      .value("binary", BagWeighting::binary);
  py::enum_<BagScore>(m, "BagScore", "How alike two bags are; for kl the smaller, else the larger.")
      .value("l1", BagScore::l1)
      .value("l2", BagScore::l2)
      .value("chi_square", BagScore::chi_square)
      .value("kl", BagScore::kl)
      .value("bhattacharyya", BagScore::bhattacharyya)
      .value("dot", BagScore::dot);
  py::class_<VocabularyTree>(m, "VocabularyTree", "A vocabulary as plain data: what training and files give.")
      .def_readonly("bits", &VocabularyTree::bits)
      .def_readonly("branching", &VocabularyTree::branching)
      .def_readonly("depth", &VocabularyTree::depth)
      .def_readonly("weighting", &VocabularyTree::weighting)
      .def_readonly("score", &VocabularyTree::score)
      .def("__len__", &VocabularyTree::size)
      .def("__eq__", [](const VocabularyTree& a, const VocabularyTree& b) { return a == b; })
      .def_property_readonly(
          "parent", [](const VocabularyTree& t) { return array_of(std::span(t.parent)); },
          "For each node its parent; 0 for the root, which is node 0.")
      .def_property_readonly(
          "word", [](const VocabularyTree& t) { return array_of(std::span(t.word)); },
          "For each node its word; 2^32 - 1 for none.")
      .def_property_readonly("weight", [](const VocabularyTree& t) { return array_of(std::span(t.weight)); })
      .def_property_readonly(
          "descriptors",
          [](const VocabularyTree& t) {
            py::array_t<std::uint8_t> rows({static_cast<py::ssize_t>(t.size()), py::ssize_t{t.bits / 8}});
            std::memcpy(rows.mutable_data(), t.descriptors.data(), t.descriptors.size() * 8);
            return rows;
          },
          "uint8, a row for each node.");
  m.def("sorted_by_level", &sorted_by_level, py::arg("tree"), py::call_guard<py::gil_scoped_release>(),
        "The same tree, its nodes level by level: so two trees can be compared.");
  m.def("renumbered", &renumbered, py::arg("tree"), py::call_guard<py::gil_scoped_release>(),
        "The same tree, its words numbered from 0 without gaps.");
}

void bind_bags(py::module_& m) {
  py::class_<Bag>(m, "Bag", "The words of an image, ascending, with their weights.")
      .def(py::init([](const Ids& words, const Numbers& weights, std::uint32_t word_count) {
             return Bag(vector_of<std::uint32_t>(words), vector_of<double>(weights), word_count);
           }),
           py::arg("words"), py::arg("weights"), py::arg("word_count"))
      .def_property_readonly("words", [](const Bag& b) { return array_of(b.words()); })
      .def_property_readonly("weights", [](const Bag& b) { return array_of(b.weights()); })
      .def("__len__", &Bag::size)
      .def("__eq__", [](const Bag& a, const Bag& b) { return a == b; });
  m.def("bag_score", &bag_score, py::arg("a"), py::arg("b"), py::arg("score"),
        "How alike two bags are; for BagScore.kl the divergence of b from a.");
  py::class_<DirectIndex>(m, "DirectIndex", "Which features lie below which node.")
      .def_property_readonly("nodes", [](const DirectIndex& d) { return array_of(std::span(d.nodes)); })
      .def("__len__", &DirectIndex::size)
      .def(
          "features_of",
          [](const DirectIndex& d, std::size_t i) {
            if (i >= d.size()) throw py::index_error("DirectIndex.features_of");
            return array_of(d.features_of(i));
          },
          py::arg("i"), "Indices of the features below nodes[i].");
}

void bind_vocabulary(py::module_& m) {
  bind_options<VocabularyTrainingOptions>(m, "VocabularyTrainingOptions", "Training of a vocabulary.");
  m.def(
      "train_vocabulary",
      [](const std::vector<Rows>& images, const VocabularyTrainingOptions& options,
         const std::optional<std::function<void(double)>>& progress) {
        std::vector<std::vector<OrbDescriptor>> descriptors;
        for (const Rows& rows : images) descriptors.push_back(descriptors_of(rows));
        py::gil_scoped_release release;
        return train_vocabulary<256>(descriptors, options, [&](double done) {
          py::gil_scoped_acquire acquire;
          if (PyErr_CheckSignals() != 0) throw py::error_already_set();
          if (progress) (*progress)(done);
        });
      },
      py::arg("images"), py::arg("options") = VocabularyTrainingOptions{}, py::arg("progress") = py::none(),
      "Trains a vocabulary (hierarchical k-majority) from the descriptors of each image, uint8 of shape (n, "
      "32). "
      "progress is called with the part done. The same input gives the same tree for any number of threads.");

  using Self = OrbVocabulary;
  py::class_<Self, std::shared_ptr<Self>>(m, "OrbVocabulary",
                                          "A tree of visual words for 256-bit descriptors.")
      .def(py::init<const VocabularyTree&>(), py::arg("tree"))
      .def_static("open", &Self::open, py::arg("path"), "Maps a file of our own format, in no time.")
      .def("save", &Self::save, py::arg("path"), py::call_guard<py::gil_scoped_release>())
      .def("tree", &Self::tree, py::call_guard<py::gil_scoped_release>())
      .def(
          "verify", [](const Self& v) { v.image().verify(); }, py::call_guard<py::gil_scoped_release>(),
          "Reads and checks everything; raises Error where the file is damaged.")
      .def_property_readonly("word_count", &Self::word_count)
      .def_property_readonly("node_count", [](const Self& v) { return v.info().node_count; })
      .def_property_readonly("branching", [](const Self& v) { return v.info().branching; })
      .def_property_readonly("depth", [](const Self& v) { return v.info().depth; })
      .def_property_readonly("weighting", [](const Self& v) { return v.info().weighting; })
      .def_property_readonly("score_type", [](const Self& v) { return v.info().score; })
      .def(
          "find_words",
          [](const Self& v, const Rows& rows, int level) {
            const auto count = static_cast<py::ssize_t>(rows.size());
            py::array_t<std::uint32_t> words(count), nodes(count);
            py::array_t<double> weights(count);
            const auto descriptors = descriptors_of(rows);
            const std::span<std::uint32_t> w(words.mutable_data(), rows.size()),
                n(nodes.mutable_data(), rows.size());
            const std::span<double> x(weights.mutable_data(), rows.size());
            {
              py::gil_scoped_release release;
              v.find_words(descriptors, w, x, level, n);
            }
            return py::make_tuple(words, weights, nodes);
          },
          py::arg("descriptors"), py::arg("level") = 0,
          "Words, weights and the nodes passed on a level, for uint8 of shape (n, 32).")
      .def(
          "transform",
          [](const Self& v, const Rows& rows) {
            const auto descriptors = descriptors_of(rows);
            py::gil_scoped_release release;
            return v.transform(descriptors);
          },
          py::arg("descriptors"), "The bag of an image, for uint8 of shape (n, 32).")
      .def(
          "transform",
          [](const Self& v, const Rows& rows, int level) {
            const auto descriptors = descriptors_of(rows);
            std::pair<Bag, DirectIndex> result;
            TransformBuffers buffers;
            py::gil_scoped_release release;
            v.transform(descriptors, level, result.first, result.second, buffers);
            return result;
          },
          py::arg("descriptors"), py::arg("level"),
          "The bag, and which features lie below which node of a level.")
      .def("score", &Self::score, py::arg("a"), py::arg("b"), "How alike two bags are.");

  m.def("load_vocabulary", &load_vocabulary<256>, py::arg("path"), py::call_guard<py::gil_scoped_release>(),
        "A vocabulary from a file of any format; our own is mapped.");
  m.def("read_vocabulary", &read_vocabulary, py::arg("path"), py::call_guard<py::gil_scoped_release>(),
        "The tree in a file of any format: ours, DBoW2, ORB-SLAM's text, DBoW3, FBoW.");
  m.def(
      "write_vocabulary",
      [](const std::string& path, const VocabularyTree& tree, const std::optional<std::string>& format) {
        const VocabularyFormat chosen = format ? vocabulary_format(*format) : vocabulary_format_of_name(path);
        py::gil_scoped_release release;
        write_vocabulary(path, tree, chosen);
      },
      py::arg("path"), py::arg("tree"), py::arg("format") = py::none(),
      "format: sweepkit, dbow2_yaml, orbslam_text, dbow3_yaml, dbow3_binary, dbow3_compressed, fbow; without "
      "it, "
      "what the name tells.");
  m.def(
      "detect_vocabulary_format",
      [](const std::string& path) { return std::string(to_string(detect_vocabulary_format(path))); },
      py::arg("path"), "The name of a file's format, by its content.");
}

void bind_inverted_file(py::module_& m) {
  PYBIND11_NUMPY_DTYPE(BagMatch, id, common_words, score);
  m.attr("bag_match_dtype") = py::dtype::of<BagMatch>();
  bind_options<BagQueryOptions>(m, "BagQueryOptions", "Which images a query gives.");
  py::class_<InvertedFile>(m, "InvertedFile", "Images by their words.")
      .def(py::init<BagScore>(), py::arg("score") = BagScore::l1)
      .def_property_readonly("score", &InvertedFile::score)
      .def("__len__", &InvertedFile::size)
      .def("__contains__", &InvertedFile::contains)
      .def("__eq__", [](const InvertedFile& a, const InvertedFile& b) { return a == b; })
      .def("ids", [](const InvertedFile& f) { return array_of(std::span<const std::uint32_t>(f.ids())); })
      .def("insert", &InvertedFile::insert, py::arg("id"), py::arg("bag"))
      .def("remove", &InvertedFile::remove, py::arg("id"), "False if there is no image of that id.")
      .def("clear", &InvertedFile::clear)
      .def(
          "query",
          [](const InvertedFile& f, const Bag& bag, const BagQueryOptions& options,
             const std::optional<Ids>& excluded) {
            const std::span<const std::uint32_t> ids =
                excluded ? std::span(excluded->data(), excluded->size()) : std::span<const std::uint32_t>();
            std::vector<BagMatch> matches;
            {
              py::gil_scoped_release release;
              matches = f.query(bag, options, ids);
            }
            return array_of(std::span<const BagMatch>(matches));
          },
          py::arg("bag"), py::arg("options") = BagQueryOptions{}, py::arg("excluded") = py::none(),
          "Images that share words with the bag, best first: an array of bag_match_dtype.")
      .def("save", &InvertedFile::save, py::arg("path"), py::call_guard<py::gil_scoped_release>())
      .def_static("load", &InvertedFile::load, py::arg("path"), py::call_guard<py::gil_scoped_release>());
  py::class_<BagGroup>(m, "BagGroup", "Images that belong together, by their best.")
      .def_property_readonly("best", [](const BagGroup& g) { return g.best.id; })
      .def_property_readonly("best_score", [](const BagGroup& g) { return g.best.score; })
      .def_readonly("score", &BagGroup::score)
      .def_readonly("members", &BagGroup::members);
  m.def(
      "group_matches",
      [](const py::array_t<BagMatch, py::array::c_style>& matches,
         const std::function<std::vector<std::int64_t>(std::uint32_t)>& related, double min_share) {
        // A neighbour in time may come out below 0: nobody has such an id.
        const auto ids = [&](std::uint32_t id) {
          std::vector<std::uint32_t> known;
          for (const std::int64_t other : related(id))
            if (other >= 0 && other <= 0xffffffff) known.push_back(static_cast<std::uint32_t>(other));
          return known;
        };
        return group_matches(std::span(matches.data(), static_cast<std::size_t>(matches.size())), ids,
                             min_share);
      },
      py::arg("matches"), py::arg("related"), py::arg("min_share") = 0.75,
      "Joins matches that belong together; related(id) gives the ids that belong to one.");
}

}  // namespace

void register_bow(py::module_& m) {
  bind_tree(m);
  bind_bags(m);
  bind_vocabulary(m);
  bind_inverted_file(m);
  register_recall(m);
}

}  // namespace sweepkit::python
