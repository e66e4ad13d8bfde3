// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/solve/pose_graph.hpp"

#include <pybind11/stl.h>
#include <pybind11/stl/filesystem.h>

#include <algorithm>
#include <optional>
#include <string>
#include <type_traits>
#include <vector>

#include "arrays.hpp"
#include "options.hpp"
#include "sweepkit/data/g2o.hpp"

namespace sweepkit::python {

void register_pose_graph(py::module_& m);
void register_g2o(py::module_& m);

namespace {

using Pairs = ArrayOf<std::int32_t, -1, 2>;
using Flags = py::array_t<bool, py::array::c_style | py::array::forcecast>;

// A pose as a row: x y z, qx qy qz qw, and the scale of a similarity.
template <class Pose>
constexpr int kColumns = std::is_same_v<Pose, Sim3d> ? 8 : 7;
template <class Pose>
constexpr int kTangent = Pose::Tangent::RowsAtCompileTime;

template <class Pose>
Pose pose_of(const double* row) {
  const Eigen::Quaterniond q(row[6], row[3], row[4], row[5]);
  const double norm = q.norm();
  require(norm > 0.5 && norm < 2.0, "pose quaternion", "must have length 1", norm);
  const Vec3<double> t(row[0], row[1], row[2]);
  if constexpr (std::is_same_v<Pose, Sim3d>)
    return Sim3d(SO3d(q), t, row[7]);
  else
    return SE3d(SO3d(q), t);
}

void to_row(const SE3d& T, double* row) {
  const Eigen::Quaterniond& q = T.rotation().quaternion();
  const double values[] = {
      T.translation().x(), T.translation().y(), T.translation().z(), q.x(), q.y(), q.z(), q.w()};
  std::copy(std::begin(values), std::end(values), row);
}
void to_row(const Sim3d& T, double* row) {
  to_row(SE3d(T.rotation(), T.translation()), row);
  row[7] = T.scale();
}

// Rows, or for SE(3) also 4x4 matrices.
template <class Pose>
std::vector<Pose> poses_of(const py::object& given) {
  std::vector<Pose> poses;
  if constexpr (std::is_same_v<Pose, SE3d>) {
    if (const py::array array = py::array::ensure(given); array && array.ndim() == 3) {
      const auto matrices = given.cast<ArrayOf<double, -1, 4, 4>>();
      for (std::size_t k = 0; k < matrices.size(); ++k)
        poses.emplace_back(Eigen::Matrix4d(
            Eigen::Map<const Eigen::Matrix<double, 4, 4, Eigen::RowMajor>>(matrices.data() + 16 * k)));
      return poses;
    }
    PyErr_Clear();
  }
  const auto rows = given.cast<ArrayOf<double, -1, kColumns<Pose>>>();
  for (std::size_t k = 0; k < rows.size(); ++k)
    poses.push_back(pose_of<Pose>(rows.data() + k * kColumns<Pose>));
  return poses;
}

template <class Pose, class Element, class PoseOf>
py::array_t<double> rows_of(const std::vector<Element>& elements, const PoseOf& pose) {
  py::array_t<double> rows(
      {static_cast<py::ssize_t>(elements.size()), static_cast<py::ssize_t>(kColumns<Pose>)});
  for (std::size_t k = 0; k < elements.size(); ++k)
    to_row(pose(elements[k]), rows.mutable_data() + k * kColumns<Pose>);
  return rows;
}

// Symmetric matrices, so the order of elements does not matter.
template <class Pose, class Element, class MatrixOf>
py::array_t<double> matrices_of(const std::vector<Element>& elements, const MatrixOf& matrix) {
  constexpr py::ssize_t kSize = kTangent<Pose>;
  py::array_t<double> result({static_cast<py::ssize_t>(elements.size()), kSize, kSize});
  for (std::size_t k = 0; k < elements.size(); ++k)
    std::copy_n(matrix(elements[k]).data(), kSize * kSize,
                result.mutable_data() + static_cast<py::ssize_t>(k) * kSize * kSize);
  return result;
}

template <class Element, class FlagOf>
py::array_t<bool> flags_of(const std::vector<Element>& elements, const FlagOf& flag) {
  py::array_t<bool> result(static_cast<py::ssize_t>(elements.size()));
  for (std::size_t k = 0; k < elements.size(); ++k) result.mutable_data()[k] = flag(elements[k]);
  return result;
}

template <class T>
py::array_t<T> array_of(const std::vector<T>& values) {
  return py::array_t<T>(static_cast<py::ssize_t>(values.size()), values.data());
}

void check_count(std::size_t count, std::size_t expected, const char* name, const char* of) {
  if (count != expected)
    throw py::value_error(std::string(name) + " must have one entry for each " + of + ": " +
                          std::to_string(expected) + ", got " + std::to_string(count));
}

const bool* flags(const std::optional<Flags>& given, std::size_t expected, const char* name, const char* of) {
  if (!given) return nullptr;
  if (given->ndim() != 1) throw py::value_error(std::string(name) + " must be bool of shape (n,)");
  check_count(static_cast<std::size_t>(given->size()), expected, name, of);
  return given->data();
}

template <class Pose>
BasicPoseGraph<Pose> make_graph(const py::object& poses, const Pairs& edges, const py::object& measurements,
                                const ArrayOf<double, -1, kTangent<Pose>, kTangent<Pose>>& information,
                                const std::optional<Flags>& fixed, const std::optional<Flags>& robust,
                                const Vector3& up_world) {
  BasicPoseGraph<Pose> graph;
  const std::vector<Pose> nodes = poses_of<Pose>(poses), motions = poses_of<Pose>(measurements);
  check_count(motions.size(), edges.size(), "measurements", "edge");
  check_count(information.size(), edges.size(), "information", "edge");
  const bool* is_fixed = flags(fixed, nodes.size(), "fixed", "pose");
  const bool* is_robust = flags(robust, edges.size(), "robust", "edge");
  for (std::size_t k = 0; k < nodes.size(); ++k) graph.add_node(nodes[k], is_fixed && is_fixed[k]);
  using Information = typename PoseGraphEdge<Pose>::Information;
  for (std::size_t l = 0; l < motions.size(); ++l)
    graph.add_edge(
        {edges.data()[2 * l], edges.data()[2 * l + 1], motions[l],
         Information(Eigen::Map<const Information>(information.data() + l * Information::SizeAtCompileTime)),
         is_robust && is_robust[l]});
  graph.up_world = up_world.eigen<Vec3<double>>();
  return graph;
}

template <class Pose>
void bind_graph(py::module_& m, const char* graph_name, const char* result_name, const std::string& row) {
  using Graph = BasicPoseGraph<Pose>;
  using Result = PoseGraphResult<Pose>;
  const std::string graph_doc =
      "Poses and the motions measured between them. A pose is a row " + row +
      ", T_world_node; a measurement of edge (i, j) is T_i_j with the information of its error, (rho, phi" +
      (kTangent<Pose> == 7 ? ", sigma" : "") + ") in j's axes. Robust edges may be wrong altogether.";
  py::class_<Graph>(m, graph_name, graph_doc.c_str())
      .def(py::init(&make_graph<Pose>), py::arg("poses"), py::arg("edges"), py::arg("measurements"),
           py::arg("information"), py::arg("fixed") = py::none(), py::arg("robust") = py::none(),
           py::arg("up_world") = std::vector<double>{0, 0, 1},
           "Arrays of shapes (n, columns) or, for SE(3), (n, 4, 4); (m, 2); as poses; (m, d, d); bool (n,); "
           "bool (m,).")
      .def_property_readonly(
          "poses",
          [](const Graph& g) { return rows_of<Pose>(g.nodes, [](const auto& n) { return n.T_world_node; }); })
      .def_property_readonly(
          "fixed", [](const Graph& g) { return flags_of(g.nodes, [](const auto& n) { return n.fixed; }); })
      .def_property_readonly(
          "edges",
          [](const Graph& g) {
            py::array_t<std::int32_t> pairs({static_cast<py::ssize_t>(g.edges.size()), py::ssize_t{2}});
            for (std::size_t l = 0; l < g.edges.size(); ++l) {
              pairs.mutable_data()[2 * l] = g.edges[l].i;
              pairs.mutable_data()[2 * l + 1] = g.edges[l].j;
            }
            return pairs;
          })
      .def_property_readonly(
          "measurements",
          [](const Graph& g) { return rows_of<Pose>(g.edges, [](const auto& e) { return e.T_i_j; }); })
      .def_property_readonly("information",
                             [](const Graph& g) {
                               return matrices_of<Pose>(
                                   g.edges, [](const auto& e) -> const auto& { return e.information; });
                             })
      .def_property_readonly(
          "robust", [](const Graph& g) { return flags_of(g.edges, [](const auto& e) { return e.robust; }); })
      .def_property_readonly(
          "up_world",
          [](const Graph& g) {
            return array_of(std::vector<double>{g.up_world.x(), g.up_world.y(), g.up_world.z()});
          })
      .def("__repr__", [name = std::string(graph_name)](const Graph& g) {
        return "<" + name + ": " + std::to_string(g.nodes.size()) + " nodes, " +
               std::to_string(g.edges.size()) + " edges>";
      });
  py::class_<Result>(m, result_name,
                     "What solve_pose_graph found; arrays have an entry for each node or edge.")
      .def_readonly("usable", &Result::usable)
      .def_readonly("converged", &Result::converged)
      .def_readonly("iterations", &Result::iterations)
      .def_readonly("initial_cost", &Result::initial_cost,
                    "Half the sum of chi2, robust edges by their loss.")
      .def_readonly("final_cost", &Result::final_cost)
      .def_readonly("components", &Result::components, "Parts that no edge connects.")
      .def_property_readonly(
          "poses",
          [](const Result& r) { return rows_of<Pose>(r.T_world_node, [](const Pose& T) { return T; }); })
      .def_property_readonly("chi2", [](const Result& r) { return array_of(r.chi2); })
      .def_property_readonly("weight", [](const Result& r) { return array_of(r.weight); })
      .def_property_readonly(
          "contradiction", [](const Result& r) { return array_of(r.contradiction); },
          "Of robust edges, how far all else is from what they say: chi-square if they are right.")
      .def_property_readonly(
          "rejected", [](const Result& r) { return array_of(r.rejected); }, "Indices of edges.")
      .def_property_readonly(
          "held", [](const Result& r) { return array_of(r.held); },
          "Nodes held because nothing fixed is connected with them.")
      .def_property_readonly(
          "covariance",
          [](const Result& r) {
            return matrices_of<Pose>(
                r.covariance, [](const auto& c) -> const auto& { return c; });
          },
          "Of each pose, empty unless asked for.");
  m.def(
      "solve_pose_graph",
      [](const Graph& graph, const PoseGraphOptions& options) {
        py::gil_scoped_release release;
        return solve_pose_graph(graph, options);
      },
      py::arg("graph"), py::arg("options") = PoseGraphOptions{},
      "Moves the nodes to where the edges fit best. ValueError naming the node or edge that cannot be.");
}

G2oRotation rotation_named(const std::string& name) {
  if (name == "quaternion") return G2oRotation::quaternion;
  if (name == "vector") return G2oRotation::vector;
  throw Error(ErrorKind::argument, "rotation", "must be quaternion or vector", name);
}

}  // namespace

void register_pose_graph(py::module_& m) {
  bind_options<PoseGraphOptions>(m, "PoseGraphOptions", "Pose graph.");
  bind_graph<SE3d>(m, "PoseGraph", "PoseGraphResult", "x y z qx qy qz qw");
  bind_graph<Sim3d>(m, "SimilarityGraph", "SimilarityGraphResult", "x y z qx qy qz qw scale");
}

void register_g2o(py::module_& m) {
  m.def(
      "read_g2o",
      [](const std::filesystem::path& file, const std::string& rotation, bool robust_loops) {
        const G2oRotation meaning = rotation_named(rotation);
        G2oGraph read;
        {
          py::gil_scoped_release release;
          read = read_g2o(file, meaning, robust_loops);
        }
        return py::make_tuple(std::move(read.graph), array_of(read.ids));
      },
      py::arg("file"), py::arg("rotation") = "quaternion", py::arg("robust_loops") = false,
      "A pose graph in the format of g2o, and the ids of its nodes. rotation: what the information's "
      "rotation rows are "
      "of, the error's quaternion (as the program g2o reckons) or its rotation vector. robust_loops: edges "
      "between ids "
      "that are not neighbours are robust.");
  m.def(
      "write_g2o",
      [](const std::filesystem::path& file, const PoseGraph& graph, const std::string& rotation,
         const std::optional<ArrayOf<std::int64_t, -1>>& ids) {
        const G2oRotation meaning = rotation_named(rotation);
        const std::vector<std::int64_t> names =
            ids ? std::vector<std::int64_t>(ids->data(), ids->data() + ids->size())
                : std::vector<std::int64_t>{};
        py::gil_scoped_release release;
        write_g2o(file, graph, meaning, names);
      },
      py::arg("file"), py::arg("graph"), py::arg("rotation") = "quaternion", py::arg("ids") = py::none());
}

}  // namespace sweepkit::python
