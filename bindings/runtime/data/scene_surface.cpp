// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "scene_surface.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <set>

#include "sweepkit/core/error.hpp"

namespace sweepkit {
namespace {

using Vec2d = Vec2<double>;
using Vec3d = Vec3<double>;

constexpr double kPi = std::numbers::pi;
constexpr double kWindowDepth = 0.1;  // panes lie so far behind the wall [m]

/// A scrambled number for seeds.
unsigned scramble(unsigned x) {
  x ^= x >> 16;
  x *= 0x7feb352du;
  x ^= x >> 15;
  x *= 0x846ca68bu;
  return x ^ (x >> 16);
}

class SurfaceBuilder {
 public:
  SurfaceBuilder(const Scene& scene, double floor_texel) : scene_(scene), floor_texel_(floor_texel) {}

  SurfaceMesh build() {
    for (const Door& door : scene_.doors) passages_.push_back(door_passage(scene_, door));
    for (std::size_t i = 0; i < scene_.rooms.size(); ++i) add_room(i);
    for (std::size_t i = 0; i < scene_.doors.size(); ++i) add_passage(scene_.doors[i], passages_[i]);
    for (std::size_t i = 0; i < scene_.objects.size(); ++i)
      for (const Solid& solid : object_solids(scene_.objects[i], static_cast<int>(i))) add_solid(solid);
    for (const Light& light : scene_.lights)
      if (light.radius > 0) {
        Solid bulb{Solid::Shape::ellipsoid,
                   SE3d(SO3<double>(), light.position),
                   Vec3d::Constant(light.radius),
                   "white",
                   0,
                   SceneLabel::background,
                   -1};
        const std::size_t first = mesh_.patches.size();
        add_solid(bulb);
        for (std::size_t p = first; p < mesh_.patches.size(); ++p) {
          mesh_.patches[p].emission =
              static_cast<float>(std::min(8.0, light.power / (kPi * light.radius * light.radius)));
          mesh_.patches[p].shadow = false;
        }
      }
    return std::move(mesh_);
  }

 private:
  const Skin& skin(const std::string& name) {
    const auto found = skins_.find(name);
    if (found != skins_.end()) return found->second;
    const Material* material = scene_.find_material(name);
    if (!material) throw Error(ErrorKind::data, "material", "no such material", name);
    const Skin& made = skins_[name] = make_skin(*material);
    mesh_.textures.push_back(made.texture);
    return made;
  }

  /// Sets how a patch of that extent looks. `seed` picks the part of the texture.
  void dress(Patch& patch, const std::string& material, unsigned seed, bool shifted) {
    const Skin& s = skin(material);
    patch.texture = s.texture.get();
    patch.detail = s.detail;
    patch.detail_strength = s.detail_strength;
    const unsigned chance = scramble(seed + 0x9e37u);
    if (s.columns > 0) {
      const auto column = static_cast<float>(chance % static_cast<unsigned>(s.columns));
      const auto row = static_cast<float>((chance >> 8) % static_cast<unsigned>(s.rows));
      // A little within its picture, so that the neighbours do not show at its edges.
      constexpr float kInset = 0.01f;
      const float w = 1 / static_cast<float>(s.columns), h = 1 / static_cast<float>(s.rows);
      patch.u_s = w * (1 - 2 * kInset) / patch.extent_s;
      patch.v_t = h * (1 - 2 * kInset) / patch.extent_t;
      patch.u_0 = w * (column + kInset);
      patch.v_0 = h * (row + kInset);
      return;
    }
    const float scale = 1 / s.texture->period();
    const bool turned = s.along_longest && patch.extent_t > patch.extent_s;
    (turned ? patch.u_t : patch.u_s) = scale;
    (turned ? patch.v_s : patch.v_t) = scale;
    if (shifted) {
      patch.u_0 = static_cast<float>(chance & 0xffffu) / 65536.0f;
      patch.v_0 = static_cast<float>(chance >> 16) / 65536.0f;
    }
  }

  std::uint32_t vertex(const Vec3d& p) {
    mesh_.vertices.push_back(
        {static_cast<float>(p.x()), static_cast<float>(p.y()), static_cast<float>(p.z())});
    return static_cast<std::uint32_t>(mesh_.vertices.size() - 1);
  }

  /// A triangle of the patch at hand, from points with their (s, t).
  void triangle(const std::array<Vec3d, 3>& p, const std::array<Vec2d, 3>& st) {
    const Vec3d a = p[1] - p[0], b = p[2] - p[0], n = a.cross(b);
    const double area = n.squaredNorm();
    if (area < 1e-16) return;
    // The gradient within the plane that takes the differences of s and t along both edges.
    const Vec3d along_a = b.cross(n) / area, along_b = n.cross(a) / area;
    SurfaceMesh::Triangle t;
    const auto gradient = [&](int i, float* g, float& offset) {
      const Vec3d d = along_a * (st[1][i] - st[0][i]) + along_b * (st[2][i] - st[0][i]);
      for (int k = 0; k < 3; ++k) g[k] = static_cast<float>(d[k]);
      offset = static_cast<float>(st[0][i] - d.dot(p[0]));
    };
    gradient(0, t.grad_s, t.s0);
    gradient(1, t.grad_t, t.t0);
    const Vec3d unit = n.normalized();
    for (int k = 0; k < 3; ++k) t.normal[k] = static_cast<float>(unit[k]);
    for (int k = 0; k < 3; ++k) t.vertex[k] = vertex(p[static_cast<std::size_t>(k)]);
    t.patch = static_cast<std::uint32_t>(mesh_.patches.size() - 1);
    mesh_.triangles.push_back(t);
  }

  /// A rectangle of the plane patch at hand.
  void rectangle(double s0, double s1, double t0, double t1) {
    const Patch& patch = mesh_.patches.back();
    const auto p = [&](double s, double t) {
      return Vec3d(patch.origin + s * patch.axis_s + t * patch.axis_t);
    };
    triangle({p(s0, t0), p(s1, t0), p(s1, t1)}, {Vec2d(s0, t0), Vec2d(s1, t0), Vec2d(s1, t1)});
    triangle({p(s0, t0), p(s1, t1), p(s0, t1)}, {Vec2d(s0, t0), Vec2d(s1, t1), Vec2d(s0, t1)});
  }

  Patch& plane(const Vec3d& origin, const Vec3d& axis_s, const Vec3d& axis_t, const Vec3d& normal,
               double extent_s, double extent_t, SceneLabel label, double texel) {
    Patch patch;
    patch.origin = origin;
    patch.axis_s = axis_s;
    patch.axis_t = axis_t;
    patch.normal = normal;
    patch.extent_s = static_cast<float>(extent_s);
    patch.extent_t = static_cast<float>(extent_t);
    patch.label = label;
    patch.texel = static_cast<float>(texel);
    mesh_.patches.push_back(patch);
    return mesh_.patches.back();
  }

  /// A horizontal polygon, by cutting ears off.
  void polygon(const std::vector<Vec2d>& corners, double z, const std::string& material, SceneLabel label,
               bool upwards, double texel) {
    Vec2d low = corners.front(), high = low;
    for (const Vec2d& c : corners) low = low.cwiseMin(c), high = high.cwiseMax(c);
    // Along the file's axes, so that boards run along the walls.
    const double c = std::cos(scene_.yaw), s = std::sin(scene_.yaw);
    const Vec2d ex(c, s), ey(-s, c);
    Vec2d first(1e9, 1e9), last(-1e9, -1e9);
    for (const Vec2d& p : corners) {
      const Vec2d q(p.dot(ex), p.dot(ey));
      first = first.cwiseMin(q);
      last = last.cwiseMax(q);
    }
    const Vec2d o = first.x() * ex + first.y() * ey;
    Patch& patch =
        plane({o.x(), o.y(), z}, {ex.x(), ex.y(), 0}, {ey.x(), ey.y(), 0}, {0, 0, upwards ? 1.0 : -1.0},
              last.x() - first.x(), last.y() - first.y(), label, texel);
    dress(patch, material, static_cast<unsigned>(mesh_.patches.size()), true);
    const auto st = [&](const Vec2d& p) { return Vec2d(p.dot(ex) - first.x(), p.dot(ey) - first.y()); };
    std::vector<Vec2d> rest = corners;
    while (rest.size() > 2) {
      bool cut = false;
      for (std::size_t i = 0; i < rest.size() && !cut; ++i) {
        const std::size_t n = rest.size();
        const Vec2d &a = rest[(i + n - 1) % n], &b = rest[i], &d = rest[(i + 1) % n];
        const auto side = [](const Vec2d& p, const Vec2d& q, const Vec2d& r) {
          return (q - p).x() * (r - p).y() - (q - p).y() * (r - p).x();
        };
        if (side(a, b, d) <= 0 && n > 3) continue;
        bool ear = true;
        for (std::size_t j = 0; j < n && ear; ++j) {
          if (j == i || j == (i + 1) % n || j == (i + n - 1) % n) continue;
          const Vec2d& q = rest[j];
          ear = !(side(a, b, q) >= 0 && side(b, d, q) >= 0 && side(d, a, q) >= 0);
        }
        if (!ear && n > 3) continue;
        triangle({Vec3d(a.x(), a.y(), z), Vec3d(b.x(), b.y(), z), Vec3d(d.x(), d.y(), z)},
                 {st(a), st(b), st(d)});
        rest.erase(rest.begin() + static_cast<std::ptrdiff_t>(i));
        cut = true;
      }
      if (!cut) break;
    }
  }

  struct Hole {
    double s0, s1, t0, t1;
  };

  void add_room(std::size_t index) {
    const Room& room = scene_.rooms[index];
    const std::size_t n = room.corners.size();
    polygon(room.corners, 0, room.floor, SceneLabel::floor, true, floor_texel_);
    polygon(room.corners, room.height, room.ceiling, SceneLabel::background, false, 8 * floor_texel_);
    for (std::size_t i = 0; i < n; ++i) {
      const Vec2d a = room.corners[i], b = room.corners[(i + 1) % n];
      const double length = (b - a).norm();
      const Vec2d d = (b - a) / length;
      const Vec3d along(d.x(), d.y(), 0), in(-d.y(), d.x(), 0), corner(a.x(), a.y(), 0);
      std::vector<Hole> holes;
      std::vector<Hole> doors;
      for (std::size_t k = 0; k < scene_.doors.size(); ++k)
        for (const auto& [name, wall] : {std::pair{scene_.doors[k].from, passages_[k].from_wall},
                                         {scene_.doors[k].to, passages_[k].to_wall}})
          if (name == room.name && wall == static_cast<int>(i)) {
            const double at = (passages_[k].centre - a).dot(d), half = scene_.doors[k].width / 2;
            holes.push_back({at - half, at + half, 0, scene_.doors[k].height});
            doors.push_back(holes.back());
            add_casing(corner, along, in, holes.back(), scene_.doors[k].material);
          }
      for (const Window& w : scene_.windows)
        if (w.room == room.name && w.wall == static_cast<int>(i)) {
          holes.push_back({w.along - w.width / 2, w.along + w.width / 2, w.base, w.base + w.height});
          add_window(corner, along, in, holes.back());
        }
      for (const Picture& p : scene_.pictures)
        if (p.room == room.name && p.wall == static_cast<int>(i)) add_picture(p, corner, along, in);
      const auto own = room.wall_materials.find(static_cast<int>(i));
      Patch& wall = plane(corner, along, Vec3d::UnitZ(), in, length, room.height, SceneLabel::background,
                          2 * floor_texel_);
      dress(wall, own == room.wall_materials.end() ? room.walls : own->second,
            static_cast<unsigned>(100 * index + i), true);
      std::set<double> cuts_s{0, length}, cuts_t{0, room.height};
      for (const Hole& h : holes) {
        for (const double s : {h.s0, h.s1}) cuts_s.insert(std::clamp(s, 0.0, length));
        for (const double t : {h.t0, h.t1}) cuts_t.insert(std::clamp(t, 0.0, room.height));
      }
      for (auto s = cuts_s.begin(); std::next(s) != cuts_s.end(); ++s)
        for (auto t = cuts_t.begin(); std::next(t) != cuts_t.end(); ++t) {
          const double ms = (*s + *std::next(s)) / 2, mt = (*t + *std::next(t)) / 2;
          const bool open = std::any_of(holes.begin(), holes.end(), [&](const Hole& h) {
            return ms > h.s0 && ms < h.s1 && mt > h.t0 && mt < h.t1;
          });
          if (!open) rectangle(*s, *std::next(s), *t, *std::next(t));
        }
      if (!room.skirting.empty() && room.skirting_height > 0) {
        std::sort(doors.begin(), doors.end(), [](const Hole& p, const Hole& q) { return p.s0 < q.s0; });
        double from = 0;
        constexpr double kCasing = 0.07;
        for (const Hole& h : doors) {
          wall_box(corner, along, in, from, h.s0 - kCasing, 0, room.skirting_height, 0, 0.012, room.skirting);
          from = h.s1 + kCasing;
        }
        wall_box(corner, along, in, from, length, 0, room.skirting_height, 0, 0.012, room.skirting);
      }
    }
  }

  /// A box against a wall: along it from s0 to s1, t0 to t1 high, in front of it from d0 to d1.
  void wall_box(const Vec3d& corner, const Vec3d& along, const Vec3d& in, double s0, double s1, double t0,
                double t1, double d0, double d1, const std::string& material) {
    if (s1 - s0 < 1e-3 || t1 - t0 < 1e-3) return;
    Mat3<double> R;
    R.col(0) = -along;
    R.col(1) = -in;
    R.col(2) = Vec3d::UnitZ();
    const Vec3d centre =
        corner + along * ((s0 + s1) / 2) + Vec3d::UnitZ() * ((t0 + t1) / 2) + in * ((d0 + d1) / 2);
    Solid solid{Solid::Shape::box,
                SE3d(SO3<double>(R), centre),
                {(s1 - s0) / 2, (d1 - d0) / 2, (t1 - t0) / 2},
                material,
                static_cast<unsigned>(mesh_.patches.size()),
                SceneLabel::background,
                -1};
    add_solid(solid);
  }

  void add_casing(const Vec3d& corner, const Vec3d& along, const Vec3d& in, const Hole& h,
                  const std::string& material) {
    constexpr double kWidth = 0.07, kThick = 0.015;
    wall_box(corner, along, in, h.s0 - kWidth, h.s0, 0, h.t1 + kWidth, 0, kThick, material);
    wall_box(corner, along, in, h.s1, h.s1 + kWidth, 0, h.t1 + kWidth, 0, kThick, material);
    wall_box(corner, along, in, h.s0, h.s1, h.t1, h.t1 + kWidth, 0, kThick, material);
  }

  void add_window(const Vec3d& corner, const Vec3d& along, const Vec3d& in, const Hole& h) {
    constexpr double kFrame = 0.05;
    const double d = -kWindowDepth, w = h.s1 - h.s0, t = h.t1 - h.t0;
    // The reveal, the frame, a board below.
    wall_box(corner, along, in, h.s0 - 0.01, h.s0, h.t0, h.t1, d, 0, "white");
    wall_box(corner, along, in, h.s1, h.s1 + 0.01, h.t0, h.t1, d, 0, "white");
    wall_box(corner, along, in, h.s0, h.s1, h.t1, h.t1 + 0.01, d, 0, "white");
    wall_box(corner, along, in, h.s0 - 0.04, h.s1 + 0.04, h.t0 - 0.03, h.t0, d, 0.05, "white");
    for (const double s : {h.s0, h.s0 + (w - kFrame) / 2, h.s1 - kFrame})
      wall_box(corner, along, in, s, s + kFrame, h.t0, h.t1, d, d + kFrame, "white");
    for (const double z : {h.t0, h.t1 - kFrame})
      wall_box(corner, along, in, h.s0, h.s1, z, z + kFrame, d, d + kFrame, "white");
    Patch& pane = plane(corner + along * h.s0 + in * d + Vec3d::UnitZ() * h.t0, along, Vec3d::UnitZ(), in, w,
                        t, SceneLabel::background, 0.5);
    pane.emission = static_cast<float>(scene_.daylight.sky);
    pane.daylight = true;
    pane.shadow = false;
    dress(pane, "white", 0, false);
    mesh_.windows.push_back(static_cast<std::uint32_t>(mesh_.patches.size() - 1));
    rectangle(0, w, 0, t);
  }

  void add_picture(const Picture& p, const Vec3d& corner, const Vec3d& along, const Vec3d& in) {
    const double w = p.width / 2, h = p.height / 2,
                 frame = std::min(0.025, 0.1 * std::min(p.width, p.height));
    wall_box(corner, along, in, p.along - w, p.along + w, p.centre - h, p.centre + h, 0, 0.018,
             p.seed % 2 ? "teak" : "black");
    const Vec3d origin =
        corner + along * (p.along + w - frame) + Vec3d::UnitZ() * (p.centre - h + frame) + in * 0.0185;
    Patch& face = plane(origin, -along, Vec3d::UnitZ(), in, 2 * (w - frame), 2 * (h - frame),
                        SceneLabel::background, 0.05);
    dress(face, "picture", static_cast<unsigned>(p.seed), false);
    rectangle(0, 2 * (w - frame), 0, 2 * (h - frame));
  }

  void add_passage(const Door& door, const DoorPassage& p) {
    const double c = std::cos(p.yaw), s = std::sin(p.yaw);
    const Vec3d x(c, s, 0), y(-s, c, 0), z = Vec3d::UnitZ(), centre(p.centre.x(), p.centre.y(), 0);
    const double d = p.depth, w = p.width, h = door.height;
    const Vec3d left = centre - x * (d / 2) - y * (w / 2);
    const auto face = [&](const Vec3d& origin, const Vec3d& es, const Vec3d& et, const Vec3d& normal,
                          double ls, double lt, const std::string& material, SceneLabel label, double texel) {
      Patch& patch = plane(origin, es, et, normal, ls, lt, label, texel);
      dress(patch, material, static_cast<unsigned>(mesh_.patches.size()), true);
      rectangle(0, ls, 0, lt);
    };
    face(left, x, y, z, d, w, scene_.find_room(door.from)->floor, SceneLabel::floor, floor_texel_);
    face(left, x, z, y, d, h, door.material, SceneLabel::background, 2 * floor_texel_);
    face(left + y * w, x, z, -y, d, h, door.material, SceneLabel::background, 2 * floor_texel_);
    face(left + z * h, x, y, -z, d, w, door.material, SceneLabel::background, 2 * floor_texel_);
    if (door.sill > 0) {
      Mat3<double> R;
      R.col(0) = x;
      R.col(1) = y;
      R.col(2) = z;
      add_solid({Solid::Shape::slab,
                 SE3d(SO3<double>(R), centre + z * (door.sill / 2)),
                 {d / 2, w / 2, door.sill / 2},
                 "beech",
                 5,
                 SceneLabel::floor,
                 -1});
    }
  }

  void add_solid(const Solid& solid) {
    const Mat3<double> R = solid.T_world_solid.rotation().matrix();
    const Vec3d o = solid.T_world_solid.translation(), half = solid.half;
    const double texel = solid.label == SceneLabel::carpet
                             ? floor_texel_
                             : std::min(2 * floor_texel_, 0.3 * half.maxCoeff() + 1e-3);
    if (solid.shape == Solid::Shape::box || solid.shape == Solid::Shape::slab) {
      const double slope = solid.shape == Solid::Shape::slab ? 2 * half.z() : 0.0;
      const Skin& look = skin(solid.material);
      const bool only_front = look.columns == 16;  // a book: lettered on its spine alone
      for (int side = 0; side < 6; ++side) {
        const int axis = side / 2;
        const double sign = side % 2 ? 1.0 : -1.0;
        if (axis == 2 && sign < 0 && o.z() - half.z() < 1e-6) continue;  // lies on the floor
        // s to the right and t up, seen from outside.
        Vec3d es, et;
        double ls, lt;
        if (axis == 2) {
          es = R.col(0);
          et = R.col(1) * sign;
          ls = half.x() - slope;
          lt = half.y() - slope;
        } else {
          es = axis == 0 ? Vec3d(R.col(1) * sign) : Vec3d(R.col(0) * -sign);
          et = R.col(2);
          ls = axis == 0 ? half.y() : half.x();
          lt = half.z();
        }
        const Vec3d normal = R.col(axis) * sign;
        if (axis != 2 && slope > 0) {
          sloped_side(o, R, half, axis, sign, slope, solid);
          continue;
        }
        const Vec3d centre = o + normal * half[axis];
        Patch& patch = plane(centre - es * ls - et * lt, es, et, normal, 2 * ls, 2 * lt, solid.label, texel);
        dress(patch,
              only_front && side != 2 ? (axis == 1        ? "black"
                                         : solid.seed % 3 ? "linen"
                                                          : "grey")
                                      : solid.material,
              solid.seed * 6u + (look.columns > 0 && !only_front ? static_cast<unsigned>(side)
                                 : only_front                    ? 0u
                                                                 : static_cast<unsigned>(side)),
              true);
        rectangle(0, 2 * ls, 0, 2 * lt);
      }
      return;
    }
    round_body(solid, R, o, texel);
  }

  /// A side of a slab: from its foot inwards and up.
  void sloped_side(const Vec3d& o, const Mat3<double>& R, const Vec3d& half, int axis, double sign,
                   double slope, const Solid& solid) {
    const Vec3d out = R.col(axis) * sign, es = axis == 0 ? Vec3d(R.col(1) * sign) : Vec3d(R.col(0) * -sign);
    const double length = axis == 0 ? half.y() : half.x();
    const Vec3d foot = o + out * half[axis] - R.col(2) * half.z();
    const Vec3d rise = -out * slope + R.col(2) * (2 * half.z());
    const double lt = rise.norm();
    const Vec3d et = rise / lt;
    Patch& patch = plane(foot - es * length, es, et, (out + R.col(2)).normalized(), 2 * length, lt,
                         solid.label, floor_texel_);
    dress(patch, solid.material, solid.seed, true);
    // A trapezium: its corners meet those of the neighbours.
    const auto p = [&](double s, double t) { return Vec3d(foot - es * length + es * s + et * t); };
    const Vec2d a(0, 0), b(2 * length, 0), c(2 * length - slope, lt), d(slope, lt);
    triangle({p(a.x(), a.y()), p(b.x(), b.y()), p(c.x(), c.y())}, {a, b, c});
    triangle({p(a.x(), a.y()), p(c.x(), c.y()), p(d.x(), d.y())}, {a, c, d});
  }

  void round_body(const Solid& solid, const Mat3<double>& R, const Vec3d& o, double texel) {
    const Vec3d& half = solid.half;
    const bool frustum = solid.shape == Solid::Shape::frustum;
    const double radius = frustum ? std::max(half.x(), half.y()) : std::max(half.x(), half.y());
    Patch patch;
    patch.shape = frustum ? Patch::Shape::frustum : Patch::Shape::ellipsoid;
    patch.label = solid.label;
    patch.origin = o;
    patch.R = R;
    patch.half = half;
    patch.texel = static_cast<float>(texel);
    patch.extent_s = static_cast<float>(2 * kPi * radius);
    patch.extent_t = static_cast<float>(frustum ? 2 * half.z() : kPi * half.z());
    mesh_.patches.push_back(patch);
    dress(mesh_.patches.back(), solid.material, solid.seed, true);
    const int around = std::clamp(static_cast<int>(std::lround(10 + 120 * radius)), 8, 48);
    const int up = frustum ? 1 : std::max(4, around / 2);
    const double ls = 2 * kPi * radius, lt = frustum ? 2 * half.z() : kPi * half.z();
    const auto corner = [&](int i, int j) {
      Vec3d p, n;
      patch.at(ls * i / around, lt * j / up, p, n);
      return p;
    };
    const auto st = [&](int i, int j) { return Vec2d(ls * i / around, lt * j / up); };
    for (int j = 0; j < up; ++j)
      for (int i = 0; i < around; ++i) {
        triangle({corner(i, j), corner(i + 1, j), corner(i + 1, j + 1)},
                 {st(i, j), st(i + 1, j), st(i + 1, j + 1)});
        triangle({corner(i, j), corner(i + 1, j + 1), corner(i, j + 1)},
                 {st(i, j), st(i + 1, j + 1), st(i, j + 1)});
      }
    if (!frustum) return;
    for (const double end : {-1.0, 1.0}) {
      const double r = end < 0 ? half.x() : half.y();
      if (solid.material == "feather" || r < 0.002 || (end < 0 && o.z() - half.z() < 1e-6)) continue;
      const Vec3d centre = o + R.col(2) * (end * half.z());
      Patch& cap = plane(centre - R.col(0) * r - R.col(1) * (r * end), R.col(0), R.col(1) * end,
                         R.col(2) * end, 2 * r, 2 * r, solid.label, texel);
      dress(cap, solid.material, solid.seed + 1, true);
      const auto rim = [&](int i) {
        return Vec2d(r * (1 + std::cos(2 * kPi * i / around)), r * (1 + std::sin(2 * kPi * i / around)));
      };
      const auto p = [&](const Vec2d& q) {
        return Vec3d(centre + R.col(0) * (q.x() - r) + R.col(1) * (end * (q.y() - r)));
      };
      for (int i = 0; i < around; ++i) {
        const Vec2d a(r, r), b = rim(i), c = rim(i + 1);
        triangle({p(a), p(b), p(c)}, {a, b, c});
      }
    }
  }

  const Scene& scene_;
  double floor_texel_;
  SurfaceMesh mesh_;
  std::vector<DoorPassage> passages_;
  std::map<std::string, Skin> skins_;
};

}  // namespace

void Patch::at(double s, double t, Vec3<double>& point, Vec3<double>& direction) const {
  if (shape == Shape::plane) {
    point = origin + s * axis_s + t * axis_t;
    direction = normal;
    return;
  }
  const double a = s / extent_s * 2 * kPi, c = std::cos(a), d = std::sin(a);
  if (shape == Shape::frustum) {
    const double z = t - half.z(), r = half.x() + (half.y() - half.x()) * t / (2 * half.z());
    point = origin + R * Vec3d(r * c, r * d, z);
    direction = R * Vec3d(c, d, (half.x() - half.y()) / (2 * half.z())).normalized();
    return;
  }
  const double b = t / extent_t * kPi, q = std::sin(b);
  const Vec3d unit(q * c, q * d, -std::cos(b));
  point = origin + R * unit.cwiseProduct(half);
  direction = R * unit.cwiseQuotient(half).normalized();
}

SurfaceMesh build_surfaces(const Scene& scene, double floor_texel) {
  return SurfaceBuilder(scene, floor_texel).build();
}

}  // namespace sweepkit
