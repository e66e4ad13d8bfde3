// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "scene_solid.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "sweepkit/core/random.hpp"

namespace sweepkit {
namespace {

using Vec3d = Vec3<double>;
using Vec2d = Vec2<double>;

constexpr double kPi = std::numbers::pi;

SO3<double> rotation_z(double yaw) { return SO3<double>::exp(Vec3d(0, 0, yaw)); }

/// Collects an object's solids, placed in its own frame: x to its right, y to its back, z up from its base.
class Builder {
 public:
  Builder(const SceneObject& object, int index) : object_(object), index_(index) {
    size_ = object.size.isZero() ? usual_size(object.kind) : object.size;
    label_ = label_of(object.kind, size_);
    T_world_object_ = SE3d(rotation_z(object.yaw), Vec3d(object.centre.x(), object.centre.y(), object.base));
  }

  const Vec3d& size() const { return size_; }
  std::string material(const char* usual) const {
    return object_.material.empty() ? usual : object_.material;
  }
  unsigned seed() const { return static_cast<unsigned>(object_.seed); }

  /// A body by its centre, half size and rotation in the object's frame.
  void add(Solid::Shape shape, const Vec3d& centre, const Vec3d& half, const std::string& material,
           const SO3<double>& R = {}) {
    solids_.push_back({shape, T_world_object_ * SE3d(R, centre), half, material,
                       seed() * 977u + static_cast<unsigned>(solids_.size()), label_, index_});
  }
  /// A box by its extent along each axis.
  void box(double x0, double x1, double y0, double y1, double z0, double z1, const std::string& material) {
    add(Solid::Shape::box, {(x0 + x1) / 2, (y0 + y1) / 2, (z0 + z1) / 2},
        {(x1 - x0) / 2, (y1 - y0) / 2, (z1 - z0) / 2}, material);
  }
  void post(double x, double y, double z0, double z1, double below, double above,
            const std::string& material) {
    add(Solid::Shape::frustum, {x, y, (z0 + z1) / 2}, {below, above, (z1 - z0) / 2}, material);
  }
  /// A round bar from a to b.
  void bar(const Vec3d& a, const Vec3d& b, double radius, const std::string& material) {
    const Vec3d d = b - a;
    const double length = d.norm();
    if (!(length > 0)) return;
    const Vec3d z = d / length, side = Vec3d::UnitZ().cross(z);
    const double angle = std::atan2(side.norm(), z.z());
    const SO3<double> R = side.norm() > 1e-12 ? SO3<double>::exp(side.normalized() * angle) : SO3<double>();
    add(Solid::Shape::frustum, (a + b) / 2, {radius, radius, length / 2}, material, R);
  }

  std::vector<Solid> take() { return std::move(solids_); }

 private:
  const SceneObject& object_;
  int index_;
  Vec3d size_;
  SceneLabel label_;
  SE3d T_world_object_;
  std::vector<Solid> solids_;
};

void build_table(Builder& b) {
  const Vec3d& s = b.size();
  const double x = s.x() / 2, y = s.y() / 2, top = std::min(0.03, s.z() / 3), leg = std::min(0.06, x / 3);
  const std::string wood = b.material("beech");
  b.box(-x, x, -y, y, s.z() - top, s.z(), wood);
  b.box(-x + leg, x - leg, -y + leg * 0.4, -y + leg * 0.75, s.z() - top - 0.07, s.z() - top, wood);
  b.box(-x + leg, x - leg, y - leg * 0.75, y - leg * 0.4, s.z() - top - 0.07, s.z() - top, wood);
  for (const double i : {-1.0, 1.0})
    for (const double j : {-1.0, 1.0}) {
      const double cx = i * (x - leg / 2), cy = j * (y - leg / 2);
      b.box(cx - leg / 2, cx + leg / 2, cy - leg / 2, cy + leg / 2, 0, s.z() - top, wood);
    }
}

void build_chair(Builder& b) {
  const Vec3d& s = b.size();
  const double x = s.x() / 2, y = s.y() / 2, seat = 0.5 * s.z(), leg = 0.018;
  const std::string wood = b.material("teak");
  b.box(-x, x, -y, y, seat - 0.03, seat, wood);
  for (const double i : {-1.0, 1.0}) {
    b.post(i * (x - leg), -y + leg, 0, seat - 0.03, 0.8 * leg, leg, wood);
    b.box(i * (x - leg) - leg, i * (x - leg) + leg, y - 2 * leg, y, 0, s.z(), wood);
    b.bar({i * (x - leg), -y + leg, 0.3 * seat}, {i * (x - leg), y - leg, 0.3 * seat}, 0.009, wood);
  }
  for (int i = 0; i < 3; ++i) {
    const double z = seat + (s.z() - seat) * (0.25 + 0.3 * i);
    b.box(-x + 2 * leg, x - 2 * leg, y - 1.5 * leg, y - 0.5 * leg, z, z + 0.05, wood);
  }
}

void build_shelf(Builder& b) {
  const Vec3d& s = b.size();
  const double x = s.x() / 2, y = s.y() / 2, board = 0.02;
  const std::string wood = b.material("pine");
  b.box(-x, -x + board, -y, y, 0, s.z(), wood);
  b.box(x - board, x, -y, y, 0, s.z(), wood);
  b.box(-x + board, x - board, y - 0.008, y, 0, s.z(), wood);
  const int rows = std::max(1, static_cast<int>(std::lround((s.z() - 0.06) / 0.32)));
  const double step = (s.z() - 0.06 - board) / rows;
  Random random(b.seed() * 31u + 7u);
  for (int row = 0; row <= rows; ++row) {
    const double z = 0.06 + row * step;
    b.box(-x + board, x - board, -y, y - 0.008, z, z + board, wood);
    if (row == rows) break;
    // Books of all sizes, with gaps, some of them leaning.
    double at = -x + board + 0.005;
    while (true) {
      const double thick = random.uniform(0.012, 0.055);
      const double tall = std::min(random.uniform(0.55, 0.93) * (step - board), 0.36);
      const double deep = std::min(random.uniform(0.6, 0.85) * s.y(), 0.26);
      if (at + thick > x - board - 0.01) break;
      if (random.uniform() < 0.1) {
        at += random.uniform(0.03, 0.16);
        continue;
      }
      const double front = -y + 0.015 + random.uniform(0.0, 0.03);
      b.box(at, at + thick - 0.001, front, std::min(front + deep, y - 0.01), z + board, z + board + tall,
            "book");
      at += thick;
    }
  }
  b.box(-x + board, x - board, -y + 0.02, -y + 0.035, 0, 0.06, wood);
}

void build_cabinet(Builder& b) {
  const Vec3d& s = b.size();
  const double x = s.x() / 2, y = s.y() / 2, foot = std::min(0.07, 0.2 * s.z());
  const std::string wood = b.material("teak");
  b.box(-x, x, -y + 0.018, y, foot, s.z(), wood);
  b.box(-x + 0.01, x - 0.01, -y + 0.06, y - 0.01, 0, foot, "black");
  const int columns = std::max(1, static_cast<int>(std::lround(s.x() / 0.5)));
  const int rows = std::max(1, static_cast<int>(std::lround((s.z() - foot) / 0.35)));
  const double w = s.x() / columns, h = (s.z() - foot) / rows;
  for (int i = 0; i < columns; ++i)
    for (int j = 0; j < rows; ++j) {
      const double x0 = -x + i * w, z0 = foot + j * h;
      b.box(x0 + 0.004, x0 + w - 0.004, -y, -y + 0.018, z0 + 0.004, z0 + h - 0.004, wood);
      b.bar({x0 + w / 2 - 0.05, -y - 0.012, z0 + 0.75 * h}, {x0 + w / 2 + 0.05, -y - 0.012, z0 + 0.75 * h},
            0.006, "metal");
    }
}

void build_sofa(Builder& b) {
  const Vec3d& s = b.size();
  const double x = s.x() / 2, y = s.y() / 2, leg = std::min(0.06, 0.1 * s.z()), seat = 0.5 * s.z();
  const double arm = std::min(0.18, 0.2 * s.x()), back = std::min(0.22, 0.3 * s.y());
  const std::string cloth = b.material("fabric");
  for (const double i : {-1.0, 1.0})
    for (const double j : {-1.0, 1.0}) b.post(i * (x - 0.06), j * (y - 0.06), 0, leg, 0.02, 0.025, "teak");
  b.box(-x + arm, x - arm, -y + 0.03, y - back, leg, 0.6 * seat, cloth);
  b.box(-x, x, y - back, y, leg, s.z(), cloth);
  for (const double i : {-1.0, 1.0})
    b.box(std::min(i * x, i * (x - arm)), std::max(i * x, i * (x - arm)), -y, y - back, leg, 0.75 * s.z(),
          cloth);
  const int cushions = std::max(1, static_cast<int>(std::lround((s.x() - 2 * arm) / 0.65)));
  const double w = (s.x() - 2 * arm) / cushions;
  for (int i = 0; i < cushions; ++i) {
    const double x0 = -x + arm + i * w;
    b.box(x0 + 0.004, x0 + w - 0.004, -y + 0.01, y - back, 0.6 * seat, seat, cloth);
  }
}

void build_bed(Builder& b) {
  const Vec3d& s = b.size();
  const double x = s.x() / 2, y = s.y() / 2, low = 0.12;
  const double frame = std::max(0.35 * s.z(), low + 0.08), mattress = 0.62 * s.z();
  const std::string wood = b.material("pine");
  for (const double i : {-1.0, 1.0})
    for (const double j : {-1.0, 1.0}) {
      const double cx = i * (x - 0.035), cy = j * (y - 0.035);
      b.box(cx - 0.035, cx + 0.035, cy - 0.035, cy + 0.035, 0, frame, wood);
    }
  b.box(-x + 0.005, x - 0.005, -y + 0.005, y - 0.07, low, frame, wood);
  b.box(-x + 0.03, x - 0.03, -y + 0.03, y - 0.08, frame, mattress, "check");
  b.box(-x, x, y - 0.07, y - 0.03, frame, s.z(), wood);
  b.box(-0.8 * x, 0.8 * x, y - 0.45, y - 0.12, mattress, mattress + 0.1, "linen");
}

void build_radiator(Builder& b) {
  const Vec3d& s = b.size();
  const double x = s.x() / 2, y = s.y() / 2, low = std::min(0.12, 0.2 * s.z());
  const std::string paint = b.material("white");
  const int ribs = std::max(2, static_cast<int>(std::lround(s.x() / 0.055)));
  const double w = s.x() / ribs;
  for (int i = 0; i < ribs; ++i)
    b.box(-x + i * w + 0.006, -x + (i + 1) * w - 0.006, -y, y - 0.01, low, s.z(), paint);
  b.box(-x, x, -0.5 * y, 0.5 * y, low + 0.03, low + 0.06, paint);
  b.box(-x, x, -0.5 * y, 0.5 * y, s.z() - 0.06, s.z() - 0.03, paint);
  b.post(-x + 0.03, 0, 0, low + 0.03, 0.009, 0.009, paint);
  b.post(x - 0.03, 0, 0, low + 0.03, 0.009, 0.009, paint);
}

void build_plant(Builder& b) {
  const Vec3d& s = b.size();
  const double pot = std::min({0.35 * s.z(), 0.3, 0.6 * s.x()}), r = std::min(0.3 * s.x(), 0.3 * s.y());
  b.post(0, 0, 0, pot, 0.75 * r, r, b.material("clay"));
  b.post(0, 0, pot - 0.02, pot - 0.015, 0.97 * r, 0.97 * r, "soil");
  Random random(b.seed() * 13u + 5u);
  const int leaves = 14;
  for (int i = 0; i < leaves; ++i) {
    const double turn = 2 * kPi * (i + 0.6 * random.uniform()) / leaves * 2.4;
    const double reach = random.uniform(0.45, 0.95), rise = random.uniform(0.45, 1.0);
    const Vec3d root(0.2 * r * std::cos(turn), 0.2 * r * std::sin(turn), pot - 0.02);
    const Vec3d tip(0.45 * s.x() * reach * std::cos(turn), 0.45 * s.y() * reach * std::sin(turn),
                    pot + (s.z() - pot) * rise * 0.96);
    const Vec3d middle = 0.5 * (root + tip) + Vec3d(0, 0, 0.06 * s.z());
    b.bar(root, middle, 0.006, "leaf");
    const Vec3d d = tip - middle;
    const double length = d.norm();
    const Vec3d z = d / length;
    const SO3<double> R = SO3<double>::exp(Vec3d(0, 0, std::atan2(z.y(), z.x()))) *
                          SO3<double>::exp(Vec3d(0, std::acos(std::clamp(z.z(), -1.0, 1.0)), 0));
    b.add(Solid::Shape::ellipsoid, middle + d / 2, {0.004, std::min(0.035, 0.1 * s.x()), length / 2}, "leaf",
          R);
  }
}

void build_lamp(Builder& b) {
  const Vec3d& s = b.size();
  const double r = std::min(s.x(), s.y()) / 2, shade = std::min(0.3, 0.25 * s.z());
  b.post(0, 0, 0, 0.025, 0.7 * r, 0.68 * r, b.material("metal"));
  b.post(0, 0, 0.025, s.z() - shade, 0.012, 0.012, "metal");
  b.post(0, 0, s.z() - shade, s.z(), r, 0.6 * r, "linen");
}

void build_shuttlecock(Builder& b) {
  // It lies on its side: cork ahead (x), skirt of feathers behind, its rim and the cork on the floor.
  const Vec3d& s = b.size();
  const double length = s.x(), rim = s.y() / 2, cork = 0.2 * s.y();
  const double tilt = std::atan2(rim - cork, length - 1.2 * cork);
  const SO3<double> R = SO3<double>::exp(Vec3d(0, kPi / 2 + tilt, 0));
  const double x = length / 2 - cork;
  const Vec3d head(x, 0, cork);
  const Vec3d axis = R * Vec3d(0, 0, 1);  // from the rim to the cork
  b.add(Solid::Shape::ellipsoid, head, {cork, cork, 1.05 * cork}, "cork", R);
  const double skirt = length - 1.4 * cork;
  b.add(Solid::Shape::frustum, head - axis * (0.5 * skirt + 0.2 * cork), {rim * 0.96, cork * 0.95, skirt / 2},
        "feather", R);
}

void build_pet_waste(Builder& b) {
  const Vec3d& s = b.size();
  Random random(b.seed() * 17u + 3u);
  const double r = 0.5 * s.z() * 0.62;
  Vec3d at(-0.5 * s.x() + r, 0, r);
  for (int i = 0; i < 7; ++i) {
    b.add(Solid::Shape::ellipsoid, at,
          {r * random.uniform(0.95, 1.25), r * random.uniform(0.85, 1.0), r * random.uniform(0.85, 1.0)},
          b.material("soil"), rotation_z(random.uniform(0, kPi)));
    at.x() += (s.x() - 2.5 * r) / 6;
    at.y() = 0.3 * (s.y() - 2 * r) * std::sin(1.9 * i);
    at.z() = r + (i % 3 == 1 ? 0.45 * (s.z() - 2 * r) + 0.2 * r : 0);
  }
}

void build_shoe(Builder& b) {
  // Toe towards +x.
  const Vec3d& s = b.size();
  const double x = s.x() / 2, y = s.y() / 2;
  const std::string leather = b.material("leather");
  b.add(Solid::Shape::ellipsoid, {0.42 * x, 0, 0.012}, {0.58 * x, y, 0.012}, "rubber");
  b.add(Solid::Shape::ellipsoid, {-0.5 * x, 0, 0.012}, {0.5 * x, 0.85 * y, 0.012}, "rubber");
  b.add(Solid::Shape::ellipsoid, {0.4 * x, 0, 0.35 * s.z()}, {0.58 * x, 0.95 * y, 0.32 * s.z()}, leather);
  b.add(Solid::Shape::ellipsoid, {-0.5 * x, 0, 0.5 * s.z()}, {0.48 * x, 0.78 * y, 0.47 * s.z()}, leather);
  b.add(Solid::Shape::ellipsoid, {-0.5 * x, 0, 0.9 * s.z()}, {0.33 * x, 0.5 * y, 0.1 * s.z()}, "soil");
  for (int i = 0; i < 4; ++i)
    b.bar({(0.02 + 0.1 * i) * x, -0.35 * y, (0.72 - 0.025 * i) * s.z()},
          {(0.05 + 0.1 * i) * x, 0.35 * y, (0.72 - 0.025 * i) * s.z()}, 0.0025, "linen");
}

void build_cable(Builder& b, const SceneObject& object) {
  const double radius = std::max(0.002, 0.5 * std::min(b.size().z(), 0.012));
  const std::string rubber = b.material("rubber");
  std::vector<Vec2d> path = object.path;
  if (path.size() < 2) {
    const double x = b.size().x() / 2, y = b.size().y() / 2;
    for (int i = 0; i <= 8; ++i) path.emplace_back(x * (i / 4.0 - 1), y * std::sin(2.4 * i));
  }
  // Catmull and Rom's spline through the points, in short straight pieces.
  const auto point = [&](int i) { return path[std::clamp(i, 0, static_cast<int>(path.size()) - 1)]; };
  Vec2d last = path.front();
  for (int i = 0; i + 1 < static_cast<int>(path.size()); ++i)
    for (int j = 1; j <= 6; ++j) {
      const double t = j / 6.0;
      const Vec2d p = 0.5 * ((2 * point(i)) + (point(i + 1) - point(i - 1)) * t +
                             (2 * point(i - 1) - 5 * point(i) + 4 * point(i + 1) - point(i + 2)) * t * t +
                             (3 * point(i) - point(i - 1) - 3 * point(i + 1) + point(i + 2)) * t * t * t);
      b.bar({last.x(), last.y(), radius}, {p.x(), p.y(), radius}, radius, rubber);
      last = p;
    }
}

}  // namespace

std::vector<Solid> object_solids(const SceneObject& object, int index) {
  Builder b(object, index);
  const Vec3d& s = b.size();
  const Vec3d half = s / 2;
  const Vec3d middle(0, 0, half.z());
  switch (object.kind) {
    case ObjectKind::box:
      b.add(Solid::Shape::box, middle, half, b.material("beech"));
      break;
    case ObjectKind::cylinder:
      b.add(Solid::Shape::frustum, middle,
            {std::min(half.x(), half.y()), std::min(half.x(), half.y()), half.z()}, b.material("clay"));
      break;
    case ObjectKind::table:
      build_table(b);
      break;
    case ObjectKind::chair:
      build_chair(b);
      break;
    case ObjectKind::shelf:
      build_shelf(b);
      break;
    case ObjectKind::cabinet:
      build_cabinet(b);
      break;
    case ObjectKind::sofa:
      build_sofa(b);
      break;
    case ObjectKind::bed:
      build_bed(b);
      break;
    case ObjectKind::radiator:
      build_radiator(b);
      break;
    case ObjectKind::plant:
      build_plant(b);
      break;
    case ObjectKind::lamp:
      build_lamp(b);
      break;
    case ObjectKind::bin: {
      const double r = std::min(half.x(), half.y());
      b.add(Solid::Shape::frustum, middle, {0.8 * r, r, half.z()}, b.material("grey"));
      break;
    }
    case ObjectKind::carton:
      b.add(Solid::Shape::box, middle, half, b.material("cardboard"));
      break;
    case ObjectKind::carpet:
      b.add(Solid::Shape::slab, middle, half, b.material("ornament"));
      break;
    case ObjectKind::shuttlecock:
      build_shuttlecock(b);
      break;
    case ObjectKind::mahjong:
      b.box(-half.x(), half.x(), -half.y(), half.y(), 0, 0.35 * s.z(), "teak");
      b.box(-half.x(), half.x(), -half.y(), half.y(), 0.35 * s.z(), s.z(), b.material("tile_face"));
      break;
    case ObjectKind::cable:
      build_cable(b, object);
      break;
    case ObjectKind::pet_waste:
      build_pet_waste(b);
      break;
    case ObjectKind::shoe:
      build_shoe(b);
      break;
    case ObjectKind::ball:
      b.add(Solid::Shape::ellipsoid, middle, half, b.material("check"));
      break;
  }
  return b.take();
}

namespace {

/// Half of what a solid takes along each axis of the world.
Vec3d half_extent(const Solid& solid) {
  const Mat3<double> R = solid.T_world_solid.rotation().matrix();
  Vec3d half = solid.half;
  if (solid.shape == Solid::Shape::frustum) {
    // A disc of radius r perpendicular to the axis a reaches r sqrt(1 - a_i^2) along the axis i.
    const double r = std::max(half.x(), half.y());
    const Vec3d a = R.col(2);
    return half.z() * a.cwiseAbs() + r * (Vec3d::Ones() - a.cwiseAbs2()).cwiseMax(0.0).cwiseSqrt();
  }
  if (solid.shape == Solid::Shape::ellipsoid) return ((R * half.asDiagonal()).rowwise().norm());
  return R.cwiseAbs() * half;
}

}  // namespace

HeightSpan height_span(const Solid& solid) {
  const double z = solid.T_world_solid.translation().z(), half = half_extent(solid).z();
  return {z - half, z + half};
}

Footprint footprint(const Solid& solid) {
  const HeightSpan span = height_span(solid);
  const Mat3<double> R = solid.T_world_solid.rotation().matrix();
  Footprint f;
  f.centre = solid.T_world_solid.translation().head<2>();
  f.low = span.low;
  f.high = span.high;
  f.object = solid.object;
  f.axis = Vec2d::UnitX();
  const bool upright = R(2, 2) > 1 - 1e-9;
  if (solid.shape == Solid::Shape::frustum && upright) {
    f.disc = true;
    f.half = Vec2d::Constant(std::max(solid.half.x(), solid.half.y()));
    return f;
  }
  if (solid.shape == Solid::Shape::ellipsoid && upright && std::abs(solid.half.x() - solid.half.y()) < 1e-9) {
    f.disc = true;
    f.half = Vec2d::Constant(solid.half.x());
    return f;
  }
  // Along the longest of its horizontal axes.
  Vec2d best = R.col(0).head<2>();
  if (!upright)
    for (int i = 1; i < 3; ++i)
      if (R.col(i).head<2>().norm() > best.norm()) best = R.col(i).head<2>();
  if (best.norm() > 1e-9) f.axis = best.normalized();
  Solid turned = solid;
  turned.T_world_solid =
      SE3d(rotation_z(-std::atan2(f.axis.y(), f.axis.x())), Vec3d::Zero()) * solid.T_world_solid;
  f.half = half_extent(turned).head<2>();
  return f;
}

double Footprint::distance(const Vec2d& p) const {
  const Vec2d d = p - centre;
  if (disc) return d.norm() - half.x();
  const Vec2d q(std::abs(d.dot(axis)) - half.x(), std::abs(-d.x() * axis.y() + d.y() * axis.x()) - half.y());
  return q.cwiseMax(0.0).norm() + std::min(q.maxCoeff(), 0.0);
}

std::vector<Vec2d> Footprint::corners() const {
  const Vec2d side(-axis.y(), axis.x());
  std::vector<Vec2d> result;
  if (disc) {
    for (int i = 0; i < 16; ++i)
      result.push_back(centre + half.x() * Vec2d(std::cos(i * kPi / 8), std::sin(i * kPi / 8)));
    return result;
  }
  for (const auto& [i, j] : {std::pair{-1, -1}, {1, -1}, {1, 1}, {-1, 1}})
    result.push_back(centre + i * half.x() * axis + j * half.y() * side);
  return result;
}

bool overlap(const Footprint& a, const Footprint& b, double slack) {
  if (std::min(a.high, b.high) - std::max(a.low, b.low) <= slack) return false;
  if (a.disc && b.disc) return (a.centre - b.centre).norm() < a.half.x() + b.half.x() - slack;
  if (a.disc) return b.distance(a.centre) < a.half.x() - slack;
  if (b.disc) return a.distance(b.centre) < b.half.x() - slack;
  // Separating axes.
  const auto ca = a.corners(), cb = b.corners();
  for (const Vec2d& axis : {a.axis, Vec2d(-a.axis.y(), a.axis.x()), b.axis, Vec2d(-b.axis.y(), b.axis.x())}) {
    double a0 = 1e300, a1 = -1e300, b0 = 1e300, b1 = -1e300;
    for (const auto& p : ca) a0 = std::min(a0, axis.dot(p)), a1 = std::max(a1, axis.dot(p));
    for (const auto& p : cb) b0 = std::min(b0, axis.dot(p)), b1 = std::max(b1, axis.dot(p));
    if (std::min(a1, b1) - std::max(a0, b0) <= slack) return false;
  }
  return true;
}

double segment_distance(const Vec2d& a, const Vec2d& b, const Vec2d& p) {
  const Vec2d d = b - a;
  const double length = d.squaredNorm();
  const double t = length > 0 ? std::clamp((p - a).dot(d) / length, 0.0, 1.0) : 0.0;
  return (a + t * d - p).norm();
}

double polygon_distance(const std::vector<Vec2d>& corners, const Vec2d& p) {
  double nearest = std::numeric_limits<double>::infinity();
  bool inside = false;
  for (std::size_t i = 0, j = corners.size() - 1; i < corners.size(); j = i++) {
    const Vec2d &a = corners[j], &b = corners[i];
    nearest = std::min(nearest, segment_distance(a, b, p));
    if ((a.y() > p.y()) != (b.y() > p.y()) &&
        p.x() < (b.x() - a.x()) * (p.y() - a.y()) / (b.y() - a.y()) + a.x())
      inside = !inside;
  }
  return inside ? -nearest : nearest;
}

double twice_area(const std::vector<Vec2d>& corners) {
  double sum = 0;
  for (std::size_t i = 0, j = corners.size() - 1; i < corners.size(); j = i++)
    sum += corners[j].x() * corners[i].y() - corners[i].x() * corners[j].y();
  return sum;
}

}  // namespace sweepkit
