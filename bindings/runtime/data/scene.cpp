// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/data/scene.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <set>
#include <utility>

#include "scene_solid.hpp"
#include "sweepkit/core/error.hpp"

namespace sweepkit {
namespace {

using Vec2d = Vec2<double>;
using Vec3d = Vec3<double>;

constexpr double kPi = std::numbers::pi;
constexpr double kTouch = 0.002;       // things may be closer by this before they count as overlapping [m]
constexpr double kParallel = 0.02;     // two walls run parallel up to this [rad]
constexpr double kThickestWall = 0.6;  // rooms farther apart have no common wall [m]
constexpr double kFar = 100.0;         // nothing of a flat is farther from the origin [m]

struct KindEntry {
  ObjectKind kind;
  std::string_view name;
  std::array<double, 3> size;
  SceneLabel label;
  std::string_view truth_class;
};

constexpr std::array<KindEntry, 20> kKinds{{
    {ObjectKind::box, "box", {0.4, 0.4, 0.4}, SceneLabel::furniture, "furniture"},
    {ObjectKind::cylinder, "cylinder", {0.3, 0.3, 0.4}, SceneLabel::furniture, "furniture"},
    {ObjectKind::table, "table", {1.4, 0.8, 0.74}, SceneLabel::furniture, "furniture"},
    {ObjectKind::chair, "chair", {0.43, 0.45, 0.9}, SceneLabel::furniture, "furniture"},
    {ObjectKind::shelf, "shelf", {0.9, 0.3, 1.8}, SceneLabel::furniture, "furniture"},
    {ObjectKind::cabinet, "cabinet", {1.2, 0.45, 0.8}, SceneLabel::furniture, "furniture"},
    {ObjectKind::sofa, "sofa", {1.9, 0.85, 0.8}, SceneLabel::furniture, "furniture"},
    {ObjectKind::bed, "bed", {1.2, 2.0, 0.85}, SceneLabel::furniture, "furniture"},
    {ObjectKind::radiator, "radiator", {1.1, 0.08, 0.62}, SceneLabel::furniture, "radiator"},
    {ObjectKind::plant, "plant", {0.6, 0.6, 0.95}, SceneLabel::furniture, "furniture"},
    {ObjectKind::lamp, "lamp", {0.4, 0.4, 1.6}, SceneLabel::furniture, "furniture"},
    {ObjectKind::bin, "bin", {0.29, 0.29, 0.38}, SceneLabel::furniture, "furniture"},
    {ObjectKind::carton, "carton", {0.4, 0.3, 0.25}, SceneLabel::furniture, "furniture"},
    {ObjectKind::carpet, "carpet", {1.6, 1.1, 0.008}, SceneLabel::carpet, "carpet"},
    {ObjectKind::shuttlecock, "shuttlecock", {0.083, 0.066, 0.066}, SceneLabel::shuttlecock, "shuttlecock"},
    {ObjectKind::mahjong, "mahjong", {0.026, 0.036, 0.02}, SceneLabel::mahjong, "mahjong"},
    {ObjectKind::cable, "cable", {0.6, 0.25, 0.01}, SceneLabel::cable, "cable"},
    {ObjectKind::pet_waste, "pet_waste", {0.1, 0.06, 0.035}, SceneLabel::pet_waste, "pet_waste"},
    {ObjectKind::shoe, "shoe", {0.29, 0.1, 0.11}, SceneLabel::small, "small"},
    {ObjectKind::ball, "ball", {0.08, 0.08, 0.08}, SceneLabel::small, "small"},
}};

const KindEntry& entry(ObjectKind kind) { return kKinds[static_cast<std::size_t>(kind)]; }

/// Throws for the part of a scene at hand.
struct Complaint {
  std::string place;

  [[noreturn]] void operator()(const std::string& what, const std::string& message,
                               const std::string& value = {}) const {
    throw Error(ErrorKind::data, place.empty() ? what : place + ": " + what, message, value);
  }
  void number(const std::string& what, double value, double low, double high) const {
    if (!(value >= low && value <= high))
      (*this)(what, fmt::format("must lie in {:g} .. {:g}", low, high), fmt::format("{:g}", value));
  }
};

/// Whether two segments cross or touch.
bool segments_meet(const Vec2d& a, const Vec2d& b, const Vec2d& c, const Vec2d& d) {
  const auto side = [](const Vec2d& p, const Vec2d& q, const Vec2d& r) {
    return (q - p).x() * (r - p).y() - (q - p).y() * (r - p).x();
  };
  const double s1 = side(a, b, c), s2 = side(a, b, d), s3 = side(c, d, a), s4 = side(c, d, b);
  return ((s1 > 0) != (s2 > 0)) && ((s3 > 0) != (s4 > 0));
}

std::string object_name(const Scene& scene, std::size_t i) {
  const SceneObject& object = scene.objects[i];
  const std::string kind(to_string(object.kind));
  const Vec2d p = scene.from_world(object.centre);
  return fmt::format("objects[{}] ({}{} at [{:.2f}, {:.2f}])", i, kind,
                     object.name.empty() || object.name == kind ? "" : " " + object.name, p.x(), p.y());
}

void check_room(const Scene& scene, const Room& room, const Complaint& complain) {
  const std::string what = "room " + room.name;
  if (room.name.empty()) complain("rooms", "a room needs a name");
  if (room.corners.size() < 3 || room.corners.size() > 200)
    complain(what, "needs 3 to 200 corners", std::to_string(room.corners.size()));
  for (const Vec2d& corner : room.corners)
    if (!corner.allFinite() || corner.cwiseAbs().maxCoeff() > kFar)
      complain(what, "a corner lies farther than 100 m from the origin");
  const double area = 0.5 * twice_area(room.corners);
  if (!(area >= 0.25))
    complain(what, "must have an area of at least 0.25 m^2, its corners counter-clockwise",
             fmt::format("{:g}", area));
  const std::size_t n = room.corners.size();
  for (std::size_t i = 0; i < n; ++i) {
    if ((room.corners[(i + 1) % n] - room.corners[i]).norm() < 0.01) complain(what, "two corners coincide");
    for (std::size_t j = i + 2; j < n; ++j)
      if (!(i == 0 && j == n - 1) &&
          segments_meet(room.corners[i], room.corners[i + 1], room.corners[j], room.corners[(j + 1) % n]))
        complain(what, "its walls cross each other");
  }
  complain.number(what + " height", room.height, 1.0, 20.0);
  complain.number(what + " skirting_height", room.skirting_height, 0.0, 0.5 * room.height);
  const auto material = [&](const std::string& name, const char* part) {
    if (!scene.find_material(name)) complain(what + " " + part, "no such material", name);
  };
  material(room.floor, "floor");
  material(room.walls, "walls");
  material(room.ceiling, "ceiling");
  if (!room.skirting.empty()) material(room.skirting, "skirting");
  for (const auto& [wall, name] : room.wall_materials) {
    if (wall < 0 || wall >= static_cast<int>(n))
      complain(what + " wall_materials", "no such wall", std::to_string(wall));
    material(name, "wall_materials");
  }
}

/// Something that takes part of a wall.
struct WallPart {
  std::string what;
  double low, high, bottom, top;
};

}  // namespace

std::string_view to_string(ObjectKind kind) { return entry(kind).name; }

std::optional<ObjectKind> object_kind(std::string_view name) {
  for (const KindEntry& e : kKinds)
    if (e.name == name) return e.kind;
  return std::nullopt;
}

Vec3d usual_size(ObjectKind kind) {
  const auto& s = entry(kind).size;
  return {s[0], s[1], s[2]};
}

SceneLabel label_of(ObjectKind kind, const Vec3d& size) {
  const bool plain = kind == ObjectKind::box || kind == ObjectKind::cylinder || kind == ObjectKind::carton;
  return plain && size.maxCoeff() < 0.3 ? SceneLabel::small : entry(kind).label;
}

const std::map<std::string, Material, std::less<>>& standard_materials() {
  static const std::map<std::string, Material, std::less<>> kMaterials{
      {"oak", {Pattern::planks, 0.36, 1.0, 0.14, 1}},
      {"walnut", {Pattern::planks, 0.15, 1.1, 0.11, 2}},
      {"ash", {Pattern::planks, 0.5, 0.9, 0.18, 3}},
      {"white_tiles", {Pattern::tiles, 0.6, 1.0, 0.33, 4}},
      {"grey_tiles", {Pattern::tiles, 0.35, 1.0, 0.45, 5}},
      {"dark_tiles", {Pattern::tiles, 0.1, 1.0, 0.3, 6}},
      {"wallpaper", {Pattern::wallpaper, 0.42, 1.0, 0.26, 7}},
      {"wallpaper_light", {Pattern::wallpaper, 0.6, 0.7, 0.18, 8}},
      {"wallpaper_dark", {Pattern::wallpaper, 0.22, 1.0, 0.3, 9}},
      {"plaster", {Pattern::plaster, 0.62, 1.0, 0.0, 10}},
      {"bare", {Pattern::plain, 0.6, 1.0, 0.0, 11}},
      {"panels", {Pattern::panels, 0.4, 1.0, 0.12, 12}},
      {"bricks", {Pattern::bricks, 0.28, 1.0, 0.24, 13}},
      {"white", {Pattern::paint, 0.75, 0.6, 0.0, 14}},
      {"grey", {Pattern::paint, 0.35, 1.0, 0.0, 15}},
      {"black", {Pattern::paint, 0.05, 1.0, 0.0, 16}},
      {"metal", {Pattern::paint, 0.5, 0.7, 0.0, 17}},
      {"clay", {Pattern::paint, 0.25, 1.5, 0.0, 18}},
      {"soil", {Pattern::plaster, 0.07, 3.0, 0.0, 19}},
      {"leaf", {Pattern::wood, 0.14, 0.8, 0.0, 20}},
      {"rubber", {Pattern::paint, 0.045, 1.0, 0.0, 21}},
      {"leather", {Pattern::paint, 0.12, 1.5, 0.0, 22}},
      {"cork", {Pattern::plaster, 0.62, 2.0, 0.0, 23}},
      {"feather", {Pattern::panels, 0.66, 1.0, 0.013, 24}},
      {"tile_face", {Pattern::glyph, 0.7, 0.8, 0.04, 25}},
      {"pine", {Pattern::wood, 0.5, 0.9, 0.0, 26}},
      {"beech", {Pattern::wood, 0.4, 1.0, 0.0, 27}},
      {"teak", {Pattern::wood, 0.16, 1.1, 0.0, 28}},
      {"wool", {Pattern::weave, 0.3, 0.7, 0.0, 29}},
      {"ornament", {Pattern::weave, 0.32, 1.0, 0.0, 30}},
      {"fabric", {Pattern::fabric, 0.3, 0.8, 0.09, 31}},
      {"check", {Pattern::fabric, 0.28, 1.2, 0.06, 32}},
      {"linen", {Pattern::fabric, 0.65, 0.3, 0.05, 33}},
      {"cardboard", {Pattern::print, 0.4, 1.0, 0.3, 34}},
      {"book", {Pattern::spines, 0.3, 1.2, 0.25, 35}},
      {"picture", {Pattern::picture, 0.35, 1.3, 0.5, 36}},
  };
  return kMaterials;
}

Vec2d Scene::to_world(const Vec2d& p) const {
  const double c = std::cos(yaw), s = std::sin(yaw);
  return {origin.x() + c * p.x() - s * p.y(), origin.y() + s * p.x() + c * p.y()};
}

Vec2d Scene::from_world(const Vec2d& p_world) const {
  const double c = std::cos(yaw), s = std::sin(yaw);
  const Vec2d p = p_world - origin;
  return {c * p.x() + s * p.y(), -s * p.x() + c * p.y()};
}

const Room* Scene::find_room(std::string_view room) const {
  for (const Room& r : rooms)
    if (r.name == room) return &r;
  return nullptr;
}

const Material* Scene::find_material(std::string_view material) const {
  if (const auto own = materials.find(material); own != materials.end()) return &own->second;
  const auto& known = standard_materials();
  const auto found = known.find(material);
  return found == known.end() ? nullptr : &found->second;
}

std::optional<double> Scene::main_direction(const Room& room) const {
  constexpr double kRight = kPi / 2, kClose = kPi / 180;
  const std::size_t n = room.corners.size();
  if (n < 3) return std::nullopt;
  std::optional<double> direction;
  double longest = 0;
  for (std::size_t i = 0; i < n; ++i) {
    const Vec2d d = room.corners[(i + 1) % n] - room.corners[i];
    if (d.norm() > longest) {
      longest = d.norm();
      const double angle = std::fmod(std::atan2(d.y(), d.x()) + 2 * kPi, kRight);
      // The largest angle below 90 degrees and 0 are the same direction.
      direction = kRight - angle < 1e-12 ? 0.0 : angle;
    }
  }
  for (std::size_t i = 0; i < n; ++i) {
    const Vec2d d = room.corners[(i + 1) % n] - room.corners[i];
    if (std::abs(std::remainder(std::atan2(d.y(), d.x()) - *direction, kRight)) > kClose) return std::nullopt;
  }
  return direction;
}

DoorPassage door_passage(const Scene& scene, const Door& door) {
  const std::string what = "door " + door.from + " - " + door.to;
  const auto nearest = [&](const std::string& name) {
    const Room* room = scene.find_room(name);
    if (!room) throw Error(ErrorKind::data, what, "no such room", name);
    int best = 0;
    double distance = std::numeric_limits<double>::infinity();
    const std::size_t n = room->corners.size();
    for (std::size_t i = 0; i < n; ++i) {
      const double d = segment_distance(room->corners[i], room->corners[(i + 1) % n], door.centre);
      if (d < distance) distance = d, best = static_cast<int>(i);
    }
    if (!(distance <= kThickestWall))
      throw Error(ErrorKind::data, what, "lies too far from room " + name, fmt::format("{:.2f} m", distance));
    const Vec2d a = room->corners[static_cast<std::size_t>(best)];
    const Vec2d b = room->corners[(static_cast<std::size_t>(best) + 1) % n];
    return std::tuple{best, a, Vec2d((b - a).normalized()), (b - a).norm()};
  };
  const auto [from_wall, a, da, la] = nearest(door.from);
  const auto [to_wall, b, db, lb] = nearest(door.to);
  if (!(da.dot(-db) > std::cos(kParallel)))
    throw Error(ErrorKind::data, what, "the walls on its two sides do not run parallel");
  // Walls go counter-clockwise round their room, which lies to their left: the way out is to the right.
  const Vec2d out(da.y(), -da.x());
  const double along_from = (door.centre - a).dot(da), along_to = (door.centre - b).dot(db);
  const double depth = (b + db * along_to - a - da * along_from).dot(out);
  if (!(depth > 0.005 && depth <= kThickestWall))
    throw Error(ErrorKind::data, what, "its rooms must lie 0.005 to 0.6 m apart",
                fmt::format("{:.3f} m", depth));
  const double half = door.width / 2;
  if (along_from < half - 1e-9 || along_from > la - half + 1e-9 || along_to < half - 1e-9 ||
      along_to > lb - half + 1e-9)
    throw Error(ErrorKind::data, what, "reaches beyond the end of its wall");
  DoorPassage passage;
  passage.centre = a + da * along_from + out * (depth / 2);
  passage.yaw = std::atan2(out.y(), out.x());
  passage.depth = depth;
  passage.width = door.width;
  passage.from_wall = from_wall;
  passage.to_wall = to_wall;
  return passage;
}

void Scene::check(const std::string& place) const {
  const Complaint complain{place};
  if (rooms.empty()) complain("rooms", "a scene needs at least one room");
  if (rooms.size() > 100 || objects.size() > 10000 || lights.size() > 100)
    complain("scene", "has too many rooms, objects or lights");
  for (const auto& [material_name, m] : materials) {
    const std::string what = "material " + material_name;
    complain.number(what + " albedo", m.albedo, 0.01, 0.95);
    complain.number(what + " contrast", m.contrast, 0.0, 4.0);
    complain.number(what + " cell", m.cell, 0.0, 2.0);
  }
  std::set<std::string> names;
  for (const Room& room : rooms) {
    check_room(*this, room, complain);
    if (!names.insert(room.name).second) complain("room " + room.name, "two rooms have this name");
  }
  for (std::size_t i = 0; i < rooms.size(); ++i)
    for (std::size_t j = i + 1; j < rooms.size(); ++j) {
      const auto& a = rooms[i].corners;
      const auto& b = rooms[j].corners;
      bool meet = false;
      for (const Vec2d& p : a) meet |= polygon_distance(b, p) < -kTouch;
      for (const Vec2d& p : b) meet |= polygon_distance(a, p) < -kTouch;
      for (std::size_t k = 0; k < a.size(); ++k)
        for (std::size_t l = 0; l < b.size(); ++l)
          meet |= segments_meet(a[k], a[(k + 1) % a.size()], b[l], b[(l + 1) % b.size()]);
      if (meet) complain("room " + rooms[j].name, "overlaps room " + rooms[i].name);
    }

  // What is set into walls must lie within one and not overlap.
  std::map<std::pair<std::string, int>, std::vector<WallPart>> parts;
  const auto claim = [&](const std::string& what, const std::string& room_name, int wall, double along,
                         double width, double bottom, double top) {
    const Room* room = find_room(room_name);
    if (!room) complain(what, "no such room", room_name);
    const auto n = static_cast<int>(room->corners.size());
    if (wall < 0 || wall >= n) complain(what, "no such wall of room " + room_name, std::to_string(wall));
    const double length = (room->corners[static_cast<std::size_t>((wall + 1) % n)] -
                           room->corners[static_cast<std::size_t>(wall)])
                              .norm();
    if (!(width > 0.01 && top - bottom > 0.01)) complain(what, "must have a width and height above 0.01 m");
    if (!(along - width / 2 >= -1e-9 && along + width / 2 <= length + 1e-9 && bottom >= -1e-9 &&
          top <= room->height + 1e-9))
      complain(what, "reaches beyond its wall");
    auto& taken = parts[{room_name, wall}];
    for (const WallPart& other : taken)
      if (std::min(along + width / 2, other.high) - std::max(along - width / 2, other.low) > 1e-6 &&
          std::min(top, other.top) - std::max(bottom, other.bottom) > 1e-6)
        complain(what, "overlaps " + other.what);
    taken.push_back({what, along - width / 2, along + width / 2, bottom, top});
  };
  std::vector<DoorPassage> passages;
  for (const Door& door : doors) {
    const std::string what = "door " + door.from + " - " + door.to;
    complain.number(what + " width", door.width, 0.3, 10.0);
    complain.number(what + " height", door.height, 0.5, 10.0);
    complain.number(what + " sill", door.sill, 0.0, 0.03);
    complain.number(what + " sill_ramp", door.sill_ramp, 0.005, 0.3);
    if (!find_material(door.material)) complain(what, "no such material", door.material);
    try {
      passages.push_back(door_passage(*this, door));
    } catch (const Error& e) {
      throw place.empty()
          ? e
          : Error(e.kind(), place + ": " + e.place(), std::string(e.what()).substr(e.place().size() + 2));
    }
    const DoorPassage& p = passages.back();
    for (const auto& [name_of_room, wall] : {std::pair{door.from, p.from_wall}, {door.to, p.to_wall}}) {
      const Room* room = find_room(name_of_room);
      const auto n = room->corners.size();
      const Vec2d a = room->corners[static_cast<std::size_t>(wall)];
      const Vec2d d = (room->corners[(static_cast<std::size_t>(wall) + 1) % n] - a).normalized();
      claim(what, name_of_room, wall, (p.centre - a).dot(d), door.width, 0.0, door.height);
    }
  }
  for (std::size_t i = 0; i < windows.size(); ++i) {
    const Window& w = windows[i];
    claim(fmt::format("windows[{}]", i), w.room, w.wall, w.along, w.width, w.base, w.base + w.height);
  }
  for (std::size_t i = 0; i < pictures.size(); ++i) {
    const Picture& p = pictures[i];
    claim(fmt::format("pictures[{}]", i), p.room, p.wall, p.along, p.width, p.centre - p.height / 2,
          p.centre + p.height / 2);
  }
  for (std::size_t i = 0; i < lights.size(); ++i) {
    const Light& light = lights[i];
    const std::string what = fmt::format("lights[{}]", i);
    if (!light.position.allFinite() || light.position.cwiseAbs().maxCoeff() > kFar)
      complain(what, "lies farther than 100 m away");
    complain.number(what + " power", light.power, 0.0, 1e4);
    complain.number(what + " radius", light.radius, 0.0, 1.0);
  }
  complain.number("daylight sun", daylight.sun, 0.0, 1e3);
  complain.number("daylight sky", daylight.sky, 0.0, 1e3);
  complain.number("daylight elevation", daylight.elevation, 0.0, kPi / 2);

  std::vector<std::vector<Footprint>> prints(objects.size());
  for (std::size_t i = 0; i < objects.size(); ++i) {
    const SceneObject& object = objects[i];
    const auto what = [&] { return object_name(*this, i); };
    if (!object.centre.allFinite() || object.centre.cwiseAbs().maxCoeff() > kFar ||
        !std::isfinite(object.yaw))
      complain(fmt::format("objects[{}] ({})", i, to_string(object.kind)),
               "must lie within 100 m of the origin");
    const Vec3d size = object.size.isZero() ? usual_size(object.kind) : object.size;
    if (!size.allFinite() || size.minCoeff() < 0.001 || size.maxCoeff() > 10.0)
      complain(what() + " size", "must lie in 0.001 .. 10 m",
               fmt::format("[{:g}, {:g}, {:g}]", size.x(), size.y(), size.z()));
    const bool furniture = entry(object.kind).label == SceneLabel::furniture;
    if (furniture && object.kind != ObjectKind::box && object.kind != ObjectKind::cylinder &&
        object.kind != ObjectKind::carton) {
      const Vec3d usual = usual_size(object.kind);
      if ((size.array() < 0.25 * usual.array()).any())
        complain(what() + " size", "is too small for its kind",
                 fmt::format("[{:g}, {:g}, {:g}]", size.x(), size.y(), size.z()));
    }
    complain.number(what() + " base", object.base, 0.0, 5.0);
    if (!object.material.empty() && !find_material(object.material))
      complain(what(), "no such material", object.material);
    if (object.path.size() > 200) complain(what() + " path", "has more than 200 points");
    if (object.kind == ObjectKind::carpet) {
      complain.number(what() + " height", size.z(), 0.001, 0.03);
      complain.number(what() + " ramp", object.ramp, 0.005, 0.3);
      if (std::min(size.x(), size.y()) < 2 * object.ramp + 0.05)
        complain(what(), "is smaller than its ramps");
    }
    for (const Solid& solid : object_solids(object, static_cast<int>(i)))
      prints[i].push_back(footprint(solid));
    const Room* home = nullptr;
    for (const Room& room : rooms)
      if (polygon_distance(room.corners, object.centre) < 0) home = &room;
    if (!home) complain(what(), "stands in no room");
    for (const Footprint& f : prints[i]) {
      if (f.high > home->height + kTouch) complain(what(), "is higher than its room");
      const auto corners = f.corners();
      bool through = false;
      for (std::size_t k = 0; k < corners.size(); ++k) {
        through |= polygon_distance(home->corners, corners[k]) > kTouch;
        const Vec2d middle = f.centre;
        const Vec2d a = middle + (corners[k] - middle) * 0.99,
                    b = middle + (corners[(k + 1) % corners.size()] - middle) * 0.99;
        if ((a - b).norm() > 0.02)
          for (std::size_t l = 0; l < home->corners.size(); ++l)
            through |= segments_meet(a, b, home->corners[l], home->corners[(l + 1) % home->corners.size()]);
      }
      if (through) complain(what(), "reaches through a wall of room " + home->name);
    }
  }
  const auto lies = [&](std::size_t i) {
    return objects[i].kind == ObjectKind::carpet || objects[i].kind == ObjectKind::cable;
  };
  for (std::size_t i = 0; i < objects.size(); ++i)
    for (std::size_t j = i + 1; j < objects.size(); ++j) {
      const bool carpets = objects[i].kind == ObjectKind::carpet && objects[j].kind == ObjectKind::carpet;
      if (!carpets && (lies(i) || lies(j))) continue;
      const Vec3d si = objects[i].size.isZero() ? usual_size(objects[i].kind) : objects[i].size;
      const Vec3d sj = objects[j].size.isZero() ? usual_size(objects[j].kind) : objects[j].size;
      if ((objects[i].centre - objects[j].centre).norm() > si.head<2>().norm() + sj.head<2>().norm())
        continue;
      for (const Footprint& a : prints[i])
        for (const Footprint& b : prints[j])
          if (overlap(a, b, carpets ? 1e-6 : kTouch))
            complain(object_name(*this, j), "stands in " + object_name(*this, i));
    }
}

std::vector<ObjectTruth> object_truth(const Scene& scene) {
  std::vector<ObjectTruth> result;
  for (std::size_t i = 0; i < scene.objects.size(); ++i) {
    const SceneObject& object = scene.objects[i];
    ObjectTruth truth;
    truth.label = label_of(object.kind, object.size.isZero() ? usual_size(object.kind) : object.size);
    truth.object_class =
        truth.label == SceneLabel::small ? "small" : std::string(entry(object.kind).truth_class);
    truth.name = object.name.empty() ? std::string(to_string(object.kind)) : object.name;
    truth.yaw = object.yaw;
    // The box around all solids, along the object's axes.
    SceneObject upright = object;
    upright.yaw = 0;
    Vec2d low = Vec2d::Constant(1e9), high = -low;
    double bottom = 1e9, top = -1e9;
    for (const Solid& solid : object_solids(upright, static_cast<int>(i))) {
      Footprint f = footprint(solid);
      for (const Vec2d& corner : f.corners()) {
        low = low.cwiseMin(corner);
        high = high.cwiseMax(corner);
      }
      bottom = std::min(bottom, f.low);
      top = std::max(top, f.high);
    }
    const Vec2d middle = (low + high) / 2 - object.centre;
    const double c = std::cos(object.yaw), s = std::sin(object.yaw);
    truth.centre = {object.centre.x() + c * middle.x() - s * middle.y(),
                    object.centre.y() + s * middle.x() + c * middle.y(), (bottom + top) / 2};
    truth.size = {high.x() - low.x(), high.y() - low.y(), top - bottom};
    result.push_back(std::move(truth));
  }
  return result;
}

}  // namespace sweepkit
