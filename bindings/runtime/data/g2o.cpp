// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/data/g2o.hpp"

#include <fmt/format.h>

#include <Eigen/Cholesky>
#include <cerrno>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <iterator>
#include <map>

#include "sweepkit/core/error.hpp"
#include "text_file.hpp"

namespace sweepkit {
namespace {

using Fields = std::vector<std::string_view>;
using Information = Mat6<double>;

// Rotation rows and columns from one meaning to the other: an error of half the size has twice the weight.
void scale_rotation(Information& information, double factor) {
  information.topRightCorner<3, 3>() *= factor;
  information.bottomLeftCorner<3, 3>() *= factor;
  information.bottomRightCorner<3, 3>() *= factor * factor;
}

class Reader {
 public:
  Reader(const std::filesystem::path& file, G2oRotation rotation) : file_(file), rotation_(rotation) {
    while (file_.next_data()) read_line();
    if (result_.graph.nodes.empty())
      throw Error(ErrorKind::data, file.string(), "holds no nodes of a pose graph");
    tie();
  }

  G2oGraph take() { return std::move(result_); }

 private:
  struct EdgeLine {
    std::int64_t i, j;
    int line;
    bool planar;
  };
  struct FixLine {
    std::int64_t id;
    int line;
  };

  void read_line() {
    const Fields& fields = file_.fields(1);
    const std::string_view tag = fields[0];
    if (tag == "PARAMS_SE3OFFSET") return;
    if (tag == "FIX") {
      if (fields.size() < 2) throw file_.error("FIX names no node");
      for (std::size_t k = 1; k < fields.size(); ++k) fixed_.push_back({id_of(fields[k]), file_.number()});
      return;
    }
    const bool planar = tag == "VERTEX_SE2" || tag == "EDGE_SE2";
    if (tag == "VERTEX_SE3:QUAT" || tag == "VERTEX_SE2") {
      check_columns(fields, planar ? 5 : 9);
      const std::int64_t id = id_of(fields[1]);
      if (!index_.emplace(id, static_cast<int>(result_.ids.size())).second)
        throw file_.error("there is a node of this id already", fields[1]);
      result_.ids.push_back(id);
      planar_.push_back(planar);
      result_.graph.add_node(planar ? planar_pose(fields, 2) : pose(fields, 2));
    } else if (tag == "EDGE_SE3:QUAT" || tag == "EDGE_SE2") {
      check_columns(fields, planar ? 12 : 31);
      PoseGraphEdge<SE3d> edge;
      edge.T_i_j = planar ? planar_pose(fields, 3) : pose(fields, 3);
      edge.information = planar ? planar_information(fields, 6) : information(fields, 10);
      if (edge.information.llt().info() != Eigen::Success)
        throw file_.error("the information is not positive definite", fields[planar ? 6 : 10]);
      edges_.push_back({id_of(fields[1]), id_of(fields[2]), file_.number(), planar});
      result_.graph.add_edge(edge);
    } else {
      throw file_.error(
          "is no line of a pose graph; read are VERTEX_SE3:QUAT, EDGE_SE3:QUAT, VERTEX_SE2, "
          "EDGE_SE2, FIX",
          tag.substr(0, 40));
    }
  }

  // Nodes may come after the edges that name them.
  void tie() {
    for (std::size_t l = 0; l < edges_.size(); ++l) {
      const EdgeLine& line = edges_[l];
      PoseGraphEdge<SE3d>& edge = result_.graph.edges[l];
      edge.i = node_of(line.i, line.line);
      edge.j = node_of(line.j, line.line);
      if (edge.i == edge.j) fail(line.line, "the edge leads from a node to itself", line.i);
      for (const auto& [node, id] : {std::pair(edge.i, line.i), std::pair(edge.j, line.j)})
        if (planar_[static_cast<std::size_t>(node)] != line.planar)
          fail(line.line, "an edge of the plane needs nodes of the plane, one of space nodes of space", id);
    }
    for (const FixLine& line : fixed_)
      result_.graph.nodes[static_cast<std::size_t>(node_of(line.id, line.line))].fixed = true;
  }

  [[noreturn]] void fail(int line, std::string_view message, std::int64_t id) const {
    throw Error(ErrorKind::data, file_.place(line), message, std::to_string(id));
  }
  int node_of(std::int64_t id, int line) const {
    const auto at = index_.find(id);
    if (at == index_.end()) fail(line, "there is no node of this id", id);
    return at->second;
  }
  std::int64_t id_of(std::string_view field) const {
    std::int64_t id = 0;
    const auto result = std::from_chars(field.data(), field.data() + field.size(), id);
    if (result.ec != std::errc() || result.ptr != field.data() + field.size() || id < 0)
      throw file_.error("is not an id, a whole number from 0 on", field.substr(0, 40));
    return id;
  }
  void check_columns(const Fields& fields, std::size_t count) const {
    if (fields.size() != count)
      throw file_.error(fmt::format("{} has {} columns", fields[0], count), std::to_string(fields.size()));
  }
  double number(const Fields& fields, std::size_t k) const {
    const double value = file_.number_of(fields[k]);
    // Squares of what is larger would not be finite.
    if (std::abs(value) > 1e100) throw file_.error("the number is too large", fields[k]);
    return value;
  }

  SE3d pose(const Fields& fields, std::size_t k) const {
    const Vec3<double> t(number(fields, k), number(fields, k + 1), number(fields, k + 2));
    const Eigen::Quaterniond q(number(fields, k + 6), number(fields, k + 3), number(fields, k + 4),
                               number(fields, k + 5));
    if (!(std::abs(q.norm() - 1.0) <= 1e-2))
      throw file_.error("the quaternion must have length 1", fmt::format("{:.6g}", q.norm()));
    return {SO3d(q), t};
  }
  SE3d planar_pose(const Fields& fields, std::size_t k) const {
    return {SO3d::exp(Vec3<double>(0, 0, number(fields, k + 2))),
            Vec3<double>(number(fields, k), number(fields, k + 1), 0)};
  }
  Information information(const Fields& fields, std::size_t k) const {
    Information result;
    for (int r = 0; r < 6; ++r)
      for (int c = r; c < 6; ++c) result(r, c) = result(c, r) = number(fields, k++);
    if (rotation_ == G2oRotation::quaternion) scale_rotation(result, 0.5);
    return result;
  }
  Information planar_information(const Fields& fields, std::size_t k) const {
    constexpr int kRow[] = {0, 1, 5};
    Information result = Information::Zero();
    for (int r = 0; r < 3; ++r)
      for (int c = r; c < 3; ++c) result(kRow[r], kRow[c]) = result(kRow[c], kRow[r]) = number(fields, k++);
    result(2, 2) = 0.5 * (result(0, 0) + result(1, 1));
    result(3, 3) = result(4, 4) = result(5, 5);
    return result;
  }

  TextFile file_;
  G2oRotation rotation_;
  G2oGraph result_;
  std::map<std::int64_t, int> index_;
  std::vector<bool> planar_;
  std::vector<EdgeLine> edges_;
  std::vector<FixLine> fixed_;
};

void append_pose(std::string& text, const SE3d& T) {
  const Vec3<double>& t = T.translation();
  const Eigen::Quaterniond& q = T.rotation().quaternion();
  fmt::format_to(std::back_inserter(text), " {} {} {} {} {} {} {}", t.x(), t.y(), t.z(), q.x(), q.y(), q.z(),
                 q.w());
}

}  // namespace

G2oGraph read_g2o(const std::filesystem::path& file, G2oRotation rotation, bool robust_loops) {
  G2oGraph result = Reader(file, rotation).take();
  if (robust_loops)
    for (auto& edge : result.graph.edges) {
      const std::int64_t a = result.ids[static_cast<std::size_t>(edge.i)];
      const std::int64_t b = result.ids[static_cast<std::size_t>(edge.j)];
      edge.robust = std::max(a, b) - std::min(a, b) != 1;
    }
  return result;
}

void write_g2o(const std::filesystem::path& file, const PoseGraph& graph, G2oRotation rotation,
               std::span<const std::int64_t> ids) {
  require(ids.empty() || ids.size() == graph.nodes.size(), "write_g2o ids", "must be one for each node",
          ids.size());
  const auto id = [&](int node) { return ids.empty() ? node : ids[static_cast<std::size_t>(node)]; };
  const int size = static_cast<int>(graph.nodes.size());
  std::string text;
  for (int k = 0; k < size; ++k) {
    text += fmt::format("VERTEX_SE3:QUAT {}", id(k));
    append_pose(text, graph.nodes[static_cast<std::size_t>(k)].T_world_node);
    text += '\n';
  }
  for (int k = 0; k < size; ++k)
    if (graph.nodes[static_cast<std::size_t>(k)].fixed) text += fmt::format("FIX {}\n", id(k));
  for (const auto& edge : graph.edges) {
    for (const int node : {edge.i, edge.j})
      require(node >= 0 && node < size, "write_g2o edge", "there is no such node", node);
    text += fmt::format("EDGE_SE3:QUAT {} {}", id(edge.i), id(edge.j));
    append_pose(text, edge.T_i_j);
    Information information = edge.information;
    if (rotation == G2oRotation::quaternion) scale_rotation(information, 2.0);
    for (int r = 0; r < 6; ++r)
      for (int c = r; c < 6; ++c) text += fmt::format(" {}", information(r, c));
    text += '\n';
  }
  std::FILE* stream = std::fopen(file.c_str(), "wb");
  bool good = stream != nullptr;
  if (stream) {
    good = std::fwrite(text.data(), 1, text.size(), stream) == text.size();
    good = std::fclose(stream) == 0 && good;
  }
  if (!good)
    throw Error(ErrorKind::io, file.string(), std::string("cannot be written: ") + std::strerror(errno));
}

}  // namespace sweepkit
