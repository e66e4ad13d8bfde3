// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/data/g2o.hpp"

#include <catch2/catch.hpp>
#include <fstream>
#include <iterator>

#include "data/error_text.hpp"
#include "scratch_folder.hpp"
#include "solve/random_graph.hpp"

using namespace sweepkit;

namespace {

const std::string kUnitInformation = " 1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 4 0 0 4 0 4\n";

std::string content_of(const std::filesystem::path& file) {
  std::ifstream stream(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), std::istreambuf_iterator<char>()};
}

}  // namespace

TEST_CASE("a pose graph is written so that it reads back bit by bit", "[data]") {
  const ScratchFolder folder;
  auto rounds = test::make_rounds<SE3d>({});
  Random random(4);
  for (auto& edge : rounds.graph.edges) {
    const Mat6<double> A = Mat6<double>::NullaryExpr([&] { return random.normal(); });
    edge.information = A * A.transpose() + Mat6<double>::Identity();
    edge.information = Mat6<double>(edge.information.selfadjointView<Eigen::Upper>());
  }
  std::vector<std::int64_t> ids;
  for (std::size_t k = 0; k < rounds.graph.nodes.size(); ++k)
    ids.push_back(static_cast<std::int64_t>(7 * k + 3));
  for (const G2oRotation rotation : {G2oRotation::quaternion, G2oRotation::vector}) {
    write_g2o(folder / "graph.g2o", rounds.graph, rotation, ids);
    const G2oGraph read = read_g2o(folder / "graph.g2o", rotation);
    REQUIRE(read.ids == ids);
    REQUIRE(read.graph.nodes.size() == rounds.graph.nodes.size());
    REQUIRE(read.graph.edges.size() == rounds.graph.edges.size());
    for (std::size_t k = 0; k < ids.size(); ++k) {
      REQUIRE((read.graph.nodes[k].T_world_node.matrix() - rounds.graph.nodes[k].T_world_node.matrix())
                  .cwiseAbs()
                  .maxCoeff() < 1e-14);
      REQUIRE(read.graph.nodes[k].fixed == rounds.graph.nodes[k].fixed);
    }
    for (std::size_t l = 0; l < read.graph.edges.size(); ++l) {
      const auto &a = read.graph.edges[l], &b = rounds.graph.edges[l];
      REQUIRE((a.i == b.i && a.j == b.j));
      REQUIRE((a.T_i_j.matrix() - b.T_i_j.matrix()).cwiseAbs().maxCoeff() < 1e-14);
      REQUIRE(a.information == b.information);
      REQUIRE_FALSE(a.robust);
    }
  }
  write_g2o(folder / "again.g2o", rounds.graph);
  CHECK(content_of(folder / "again.g2o").substr(0, 18) == "VERTEX_SE3:QUAT 0 ");
  const auto loops = read_g2o(folder / "again.g2o", G2oRotation::quaternion, true).graph;
  for (const auto& edge : loops.edges) REQUIRE(edge.robust == (std::abs(edge.i - edge.j) != 1));
}

TEST_CASE("columns of a g2o file mean what they should", "[data]") {
  const ScratchFolder folder;
  const std::string half = "0.70710678118654752";
  std::string edge = "EDGE_SE3:QUAT 12 5 1 2 3 0 0 " + half + " " + half;
  // The upper triangle by rows counts 1 to 21, with a diagonal that is large.
  Mat6<double> written;
  int count = 0;
  for (int r = 0; r < 6; ++r)
    for (int c = r; c < 6; ++c) {
      ++count;
      written(r, c) = written(c, r) = r == c ? 1000.0 + count : count;
      edge += " " + std::to_string(static_cast<int>(written(r, c)));
    }
  const auto file =
      folder.write("graph.g2o", "# a comment\nPARAMS_SE3OFFSET 0 0 0 0 0 0 0 1\n" + edge +
                                    "\nVERTEX_SE3:QUAT 5 1 2 3 0 0 0 1\nVERTEX_SE3:QUAT 12 4 5 6 " + half +
                                    " 0 0 " + half + "\nFIX 12\n");
  const G2oGraph read = read_g2o(file, G2oRotation::vector);
  CHECK(read.ids == std::vector<std::int64_t>{5, 12});
  CHECK_FALSE(read.graph.nodes[0].fixed);
  CHECK(read.graph.nodes[1].fixed);
  CHECK(read.graph.nodes[1].T_world_node.translation() == Vec3<double>(4, 5, 6));
  CHECK((read.graph.nodes[1].T_world_node * Vec3<double>(0, 1, 0) - Vec3<double>(4, 5, 7)).norm() < 1e-15);
  REQUIRE(read.graph.edges.size() == 1);
  CHECK(read.graph.edges[0].i == 1);
  CHECK(read.graph.edges[0].j == 0);
  CHECK((read.graph.edges[0].T_i_j * Vec3<double>(1, 0, 0) - Vec3<double>(1, 3, 3)).norm() < 1e-15);
  CHECK(read.graph.edges[0].information == written);

  // As the program g2o reckons: chi2 of a small error by x y z of its quaternion is that by its rotation
  // vector.
  const Mat6<double> ours = read_g2o(file).graph.edges[0].information;
  const Vec6<double> e = 1e-5 * (Vec6<double>() << 1, -2, 3, 3, 2, -1).finished();
  Vec6<double> by_quaternion = e;
  by_quaternion.tail<3>() = SO3d::exp(e.tail<3>()).quaternion().vec();
  CHECK(e.dot(ours * e) == Approx(by_quaternion.dot(written * by_quaternion)).epsilon(1e-9));
}

TEST_CASE("a graph of the plane is solved in the plane", "[data]") {
  const ScratchFolder folder;
  // A square whose last side is 10 cm short.
  const auto file = folder.write("square.g2o",
                                 "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 1.5707963267948966\n"
                                 "VERTEX_SE2 2 1 1 3.141592653589793\nVERTEX_SE2 3 0 1 -1.5707963267948966\n"
                                 "EDGE_SE2 0 1 1 0 1.5707963267948966 100 0 0 100 0 1000\n"
                                 "EDGE_SE2 1 2 1 0 1.5707963267948966 100 0 0 100 0 1000\n"
                                 "EDGE_SE2 2 3 1 0 1.5707963267948966 100 0 0 100 0 1000\n"
                                 "EDGE_SE2 3 0 0.9 0 1.5707963267948966 100 0 0 100 0 1000\n");
  const G2oGraph read = read_g2o(file);
  const auto result = solve_pose_graph(read.graph);
  REQUIRE(result.usable);
  CHECK(result.held == std::vector<int>{0});
  CHECK(result.final_cost < result.initial_cost);
  for (const SE3d& T : result.T_world_node) {
    CHECK(std::abs(T.translation().z()) < 1e-12);
    CHECK((T.rotation() * Vec3<double>::UnitZ() - Vec3<double>::UnitZ()).norm() < 1e-12);
  }
}

TEST_CASE("a g2o file that cannot be is refused by file, line and value", "[data]") {
  const ScratchFolder folder;
  const auto told = [&](const std::string& content) {
    const auto file = folder.write("bad.g2o", content);
    return error_text([&] { read_g2o(file); });
  };
  const std::string two = "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\nVERTEX_SE3:QUAT 1 0 0 0 0 0 0 1\n";
  const std::string edge = "EDGE_SE3:QUAT 0 1 0 0 0 0 0 0 1";
  using Catch::Contains;
  CHECK(told(two + edge + kUnitInformation).empty());
  CHECK_THAT(told(""), Contains("data: ") && Contains("no nodes"));
  CHECK_THAT(told(two + "VERTEX_XY 2 0 0\n"), Contains("bad.g2o:3") && Contains("VERTEX_XY"));
  CHECK_THAT(told(two + edge + " 1 0 0\n"),
             Contains("bad.g2o:3") && Contains("31 columns") && Contains("got 13"));
  CHECK_THAT(told(two + edge + " 7" + kUnitInformation), Contains("bad.g2o:3") && Contains("columns"));
  CHECK_THAT(told("VERTEX_SE3:QUAT 0 0 nan 0 0 0 0 1\n"), Contains("bad.g2o:1") && Contains("nan"));
  CHECK_THAT(told("VERTEX_SE3:QUAT 0 0 1e200 0 0 0 0 1\n"), Contains("bad.g2o:1") && Contains("1e200"));
  CHECK_THAT(told("VERTEX_SE3:QUAT 0 0 0 0 0 0 0 0.5\n"), Contains("bad.g2o:1") && Contains("0.5"));
  CHECK_THAT(told("VERTEX_SE3:QUAT 0 0 0 0 0 0 0 0\n"), Contains("length 1"));
  CHECK_THAT(told("VERTEX_SE3:QUAT -1 0 0 0 0 0 0 1\n"), Contains("id") && Contains("-1"));
  CHECK_THAT(told("VERTEX_SE3:QUAT 99999999999999999999 0 0 0 0 0 0 1\n"), Contains("id"));
  CHECK_THAT(told(two + "VERTEX_SE3:QUAT 1 0 0 0 0 0 0 1\n"), Contains("bad.g2o:3") && Contains("already"));
  CHECK_THAT(told(two + "EDGE_SE3:QUAT 0 8 0 0 0 0 0 0 1" + kUnitInformation),
             Contains("bad.g2o:3") && Contains("8"));
  CHECK_THAT(told(two + "EDGE_SE3:QUAT 1 1 0 0 0 0 0 0 1" + kUnitInformation), Contains("itself"));
  CHECK_THAT(told(two + "FIX 4\n"), Contains("bad.g2o:3") && Contains("4"));
  CHECK_THAT(told(two + "FIX\n"), Contains("FIX"));
  CHECK_THAT(told(two + "EDGE_SE2 0 1 0 0 0 1 0 0 1 0 1\n"), Contains("plane"));
  CHECK_THAT(told(two + edge + " 1 2 0 0 0 0 1 0 0 0 0 1 0 0 0 4 0 0 4 0 4\n"),
             Contains("positive definite"));
  CHECK_THAT(told(two + std::string(1 << 17, 'x')), Contains("too long"));
  CHECK_THAT(error_text([&] { read_g2o(folder / "none.g2o"); }), Contains("io: ") && Contains("none.g2o"));
  PoseGraph graph;
  graph.add_node(SE3d());
  CHECK_THAT(error_text([&] { write_g2o(folder / "no" / "folder.g2o", graph); }), Contains("io: "));
  CHECK_THAT(error_text([&] {
               write_g2o(folder / "x.g2o", graph, G2oRotation::vector, std::vector<std::int64_t>{1, 2});
             }),
             Contains("ids"));
  if (std::filesystem::exists("/dev/full"))
    CHECK_THAT(error_text([&] { write_g2o("/dev/full", graph); }), Contains("io: "));
}
