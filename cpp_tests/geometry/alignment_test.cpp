// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/geometry/alignment.hpp"

#include <catch2/catch.hpp>
#include <cmath>
#include <limits>
#include <vector>

#include "sweepkit/core/random.hpp"

namespace {

using sweepkit::Random;
using sweepkit::SE3;
using sweepkit::SE3d;
using sweepkit::SO3;
using sweepkit::Vec3;
using Vec3d = Vec3<double>;

Vec3d random_vector(Random& random, double size) {
  return {random.uniform(-size, size), random.uniform(-size, size), random.uniform(-size, size)};
}

std::vector<Vec3d> random_points(Random& random, int count, double size = 2.0) {
  std::vector<Vec3d> points;
  for (int i = 0; i < count; ++i) points.push_back(random_vector(random, size));
  return points;
}

double squared_error(const std::vector<Vec3d>& src, const std::vector<Vec3d>& dst, double scale,
                     const SE3d& T) {
  double sum = 0.0;
  for (std::size_t i = 0; i < src.size(); ++i)
    sum += (scale * (T.rotation() * src[i]) + T.translation() - dst[i]).squaredNorm();
  return sum;
}

}  // namespace

TEMPLATE_TEST_CASE("a moved and scaled set is brought back exactly", "[alignment]", float, double) {
  using S = TestType;
  const double tolerance = std::is_same_v<S, float> ? 1e-5 : 1e-12;
  Random random(2);
  for (int i = 0; i < 200; ++i) {
    auto points = random_points(random, 3 + i % 10);  // three points are a plane: no reflection may come out
    const SE3d T(SO3<double>::exp(random_vector(random, 1.8)), random_vector(random, 3.0));
    const double scale = i % 2 ? 1.0 : random.uniform(0.2, 5.0);
    std::vector<Vec3<S>> src, dst;
    for (const auto& p : points) {
      src.push_back(p.cast<S>());
      dst.push_back((scale * (T.rotation() * p) + T.translation()).cast<S>());
    }
    const auto found = i % 2 ? sweepkit::align_se3<S>(src, dst) : sweepkit::align_sim3<S>(src, dst);
    REQUIRE(found);
    const SE3d error = T.inverse() * found->T_dst_src.template cast<double>();
    const double spread = 300.0;  // thin triangles turn a small error into a larger angle
    CHECK(error.log().norm() < spread * tolerance);
    CHECK(std::abs(found->scale / scale - 1.0) < 10 * tolerance);
    CHECK(found->rmse < 10 * tolerance * scale);
    if (points.size() > 3) CHECK_FALSE(found->mirrored);
    CHECK((found->similarity() * src[0] - *found * src[0]).norm() < 10 * tolerance * scale);
    CHECK((*found * src[0] - dst[0]).norm() < 50 * tolerance * scale);
  }
}

TEST_CASE("no small motion fits better than the one found", "[alignment]") {
  Random random(4);
  for (const bool with_scale : {false, true}) {
    const auto src = random_points(random, 20);
    const SE3d T(SO3<double>::exp({0.4, -1.0, 0.7}), Vec3d(1, 2, 3));
    std::vector<Vec3d> dst;
    for (const auto& p : src) dst.push_back(1.3 * (T * p) + 0.1 * random_vector(random, 1.0));
    const auto found =
        with_scale ? sweepkit::align_sim3<double>(src, dst) : sweepkit::align_se3<double>(src, dst);
    REQUIRE(found);
    const double best = squared_error(src, dst, found->scale, found->T_dst_src);
    CHECK(found->rmse == Approx(std::sqrt(best / 20)).epsilon(1e-12));
    if (!with_scale) CHECK(found->scale == 1.0);
    for (int i = 0; i < 200; ++i) {
      sweepkit::Vec6<double> xi;
      xi << random_vector(random, 1e-2), random_vector(random, 1e-2);
      const double scale = found->scale * (with_scale ? random.uniform(0.99, 1.01) : 1.0);
      CHECK(squared_error(src, dst, scale, found->T_dst_src * SE3d::exp(xi)) > best);
    }
  }
}

TEST_CASE("a weight counts as so many copies of the pair", "[alignment]") {
  Random random(6);
  const auto src = random_points(random, 8);
  auto dst = src;
  for (auto& p : dst) p += random_vector(random, 0.2);
  std::vector<double> weights;
  std::vector<Vec3d> many_src, many_dst;
  for (std::size_t i = 0; i < src.size(); ++i) {
    weights.push_back(static_cast<double>(i % 4));  // some of them zero
    for (std::size_t k = 0; k < i % 4; ++k) {
      many_src.push_back(src[i]);
      many_dst.push_back(dst[i]);
    }
  }
  const auto weighted = sweepkit::align_sim3<double>(src, dst, weights);
  const auto copied = sweepkit::align_sim3<double>(many_src, many_dst);
  REQUIRE((weighted && copied));
  CHECK((weighted->T_dst_src.inverse() * copied->T_dst_src).log().norm() < 1e-12);
  CHECK(weighted->scale == Approx(copied->scale).epsilon(1e-12));
  CHECK(weighted->rmse == Approx(copied->rmse).epsilon(1e-12));
}

TEST_CASE("mirrored sets get a rotation and are told", "[alignment]") {
  Random random(9);
  std::vector<Vec3d> src, dst;
  for (int i = 0; i < 50; ++i) {
    src.push_back(random_vector(random, 1.0).cwiseProduct(Vec3d(1, 2, 4)));
    dst.push_back(Vec3d(-src.back().x(), src.back().y(), src.back().z()));
  }
  const auto found = sweepkit::align_se3<double>(src, dst);
  REQUIRE(found);
  CHECK(found->mirrored);
  CHECK(found->T_dst_src.rotation().matrix().determinant() == Approx(1.0));
  // An octahedron and its mirror image with two axes alike: any turn about the third is as good.
  const std::vector<Vec3d> ball{{1, 0, 0}, {-1, 0, 0}, {0, 1, 0}, {0, -1, 0}, {0, 0, 2}, {0, 0, -2}};
  std::vector<Vec3d> mirror;
  for (const auto& p : ball) mirror.push_back(-p);
  mirror[4] = ball[4];
  mirror[5] = ball[5];
  CHECK(sweepkit::align_se3<double>(ball, mirror));  // half a turn about z does it
  for (std::size_t i = 0; i < ball.size(); ++i) mirror[i] = Vec3d(-ball[i].x(), ball[i].y(), ball[i].z());
  CHECK_FALSE(sweepkit::align_se3<double>(ball, mirror));
}

TEST_CASE("sets that fix no rotation give nothing", "[alignment]") {
  Random random(10);
  const auto points = random_points(random, 5);
  const std::span<const Vec3d> all(points);
  CHECK_FALSE(sweepkit::align_se3<double>(all.first(2), all.first(2)));
  CHECK_FALSE(sweepkit::align_se3<double>(all.first(0), all.first(0)));
  const std::vector<Vec3d> same(5, Vec3d(1, 2, 3));
  CHECK_FALSE(sweepkit::align_sim3<double>(same, all));
  CHECK_FALSE(sweepkit::align_sim3<double>(all, same));
  for (const double offset : {0.0, 1.0, 1e3, 1e6}) {
    std::vector<Vec3d> line;
    std::vector<Vec3<float>> line_f, points_f;
    for (int i = 0; i < 5; ++i) {
      line.push_back(Vec3d(0.3, -0.7, 0.2) * random.uniform(-1.0, 1.0) + Vec3d::Constant(offset));
      line_f.push_back(line.back().cast<float>());
      points_f.push_back(points[static_cast<std::size_t>(i)].cast<float>());
    }
    CHECK_FALSE(sweepkit::align_se3<double>(line, all));
    CHECK_FALSE(sweepkit::align_se3<double>(all, line));
    CHECK_FALSE(sweepkit::align_se3<double>(line, line));
    CHECK_FALSE(sweepkit::align_se3<float>(line_f, line_f));
    CHECK_FALSE(sweepkit::align_sim3<float>(points_f, line_f));
  }
  auto broken = points;
  broken[2].y() = std::numeric_limits<double>::quiet_NaN();
  CHECK_FALSE(sweepkit::align_se3<double>(broken, all));
  const std::vector<double> zero(5, 0.0), negative(5, -1.0), short_list(4, 1.0);
  CHECK_FALSE(sweepkit::align_se3<double>(all, all, zero));
  CHECK_FALSE(sweepkit::align_se3<double>(all, all, negative));
  CHECK_THROWS_AS(sweepkit::align_se3<double>(all, all, short_list), sweepkit::Error);
  CHECK_THROWS_AS(sweepkit::align_se3<double>(all, all.first(4)), sweepkit::Error);
}
