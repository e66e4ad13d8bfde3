// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/data/flat.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <string>

#include "scene_solid.hpp"
#include "sweepkit/core/error.hpp"
#include "sweepkit/core/random.hpp"
#include "sweepkit/data/floor_plan.hpp"

namespace sweepkit {
namespace {

using Vec2d = Vec2<double>;
using Vec3d = Vec3<double>;

constexpr double kPi = std::numbers::pi;
constexpr double kWall = 0.12;       // thickness of walls between rooms [m]
constexpr double kDoorSpace = 0.75;  // kept free around doors [m]
constexpr double kWay = 0.5;         // kept between furniture that stands free and all else [m]
constexpr double kRobotRadius = 0.18;

struct Rect {
  double x0, y0, x1, y1;
};

/// Makes a flat in the frame of its file; the world is that frame turned and shifted at the end.
class FlatGenerator {
 public:
  explicit FlatGenerator(const FlatOptions& options)
      : options_(options), random_(static_cast<std::uint64_t>(options.seed)) {}

  Scene generate() {
    scene_.name = "flat " + std::to_string(options_.seed);
    add_rooms();
    for (std::size_t i = 0; i < rects_.size(); ++i) furnish(i);
    for (std::size_t i = 0; i < rects_.size(); ++i) litter(i);
    open_ways();
    place_in_world();
    return std::move(scene_);
  }

 private:
  template <class T, std::size_t N>
  const T& pick(const std::array<T, N>& from) {
    return from[random_.index(N)];
  }

  void add_rooms() {
    static constexpr std::array<const char*, 6> kNames{"living", "bedroom", "kitchen",
                                                       "study",  "hall",    "guest"};
    static constexpr std::array<const char*, 3> kBoards{"oak", "walnut", "ash"};
    static constexpr std::array<const char*, 3> kTiles{"white_tiles", "grey_tiles", "dark_tiles"};
    static constexpr std::array<const char*, 5> kWalls{"wallpaper", "wallpaper_light", "wallpaper_dark",
                                                       "plaster", "panels"};
    double x = 0;
    for (int i = 0; i < options_.rooms; ++i) {
      const double w = random_.uniform(options_.room_min, options_.room_max),
                   d = random_.uniform(options_.room_min, options_.room_max);
      const double y = i == 0 ? 0.0 : random_.uniform(-0.4, 0.4);
      rects_.push_back({x, y, x + w, y + d});
      Room room;
      room.name = kNames[static_cast<std::size_t>(i)];
      room.corners = {{x, y}, {x + w, y}, {x + w, y + d}, {x, y + d}};
      room.floor = room.name == "kitchen" ? pick(kTiles) : pick(kBoards);
      room.walls = options_.bare_walls ? "bare" : pick(kWalls);
      if (!options_.bare_walls && random_.uniform() < 0.4)
        room.wall_materials[static_cast<int>(random_.index(4))] =
            random_.uniform() < 0.5 ? "bricks" : "plaster";
      room.skirting = pick(std::array<const char*, 3>{"white", "teak", "pine"});
      scene_.rooms.push_back(room);
      lamp(x + w / 2 + random_.uniform(-0.5, 0.5), y + d / 2 + random_.uniform(-0.5, 0.5), 2.3,
           random_.uniform(3.0, 5.0));
      x += w + kWall;
    }
    for (std::size_t i = 0; i + 1 < rects_.size(); ++i) {
      const Rect &a = rects_[i], &b = rects_[i + 1];
      const double low = std::max(a.y0, b.y0) + 0.7, high = std::min(a.y1, b.y1) - 0.7;
      Door door;
      door.from = scene_.rooms[i].name;
      door.to = scene_.rooms[i + 1].name;
      door.width = random_.uniform() < 0.25 ? 1.3 : random_.uniform(0.8, 0.95);
      door.centre = {a.x1 + kWall / 2, random_.uniform(low + 0.1, high - 0.1)};
      door.sill = options_.sill;
      door.material = pick(std::array<const char*, 2>{"white", "beech"});
      scene_.doors.push_back(door);
    }
    for (std::size_t i = 0; i < rects_.size(); ++i) {
      const Rect& r = rects_[i];
      const std::string& name = scene_.rooms[i].name;
      // Windows in the outer walls to the south or north (walls 0 and 2), a radiator below.
      const int wall = random_.uniform() < 0.5 ? 0 : 2;
      const double length = r.x1 - r.x0, along = length / 2 + random_.uniform(-0.4, 0.4),
                   width = random_.uniform(1.0, 1.5);
      scene_.windows.push_back({name, wall, along, 0.85, width, 1.3});
      SceneObject radiator;
      radiator.kind = ObjectKind::radiator;
      const double x_at = wall == 0 ? r.x0 + along : r.x1 - along;
      radiator.centre = {x_at, wall == 0 ? r.y0 + 0.09 : r.y1 - 0.09};
      radiator.yaw = wall == 0 ? kPi : 0.0;
      radiator.size = {width * 0.85, 0.08, 0.6};
      scene_.objects.push_back(radiator);
      if (options_.bare_walls) continue;
      for (int w = 0; w < 4; ++w) {
        if (w == wall) continue;
        const double l = w % 2 ? r.y1 - r.y0 : r.x1 - r.x0;
        const int count = static_cast<int>(random_.index(3));
        for (int k = 0; k < count; ++k) {
          Picture p{name,
                    w,
                    random_.uniform(0.5, l - 0.5),
                    random_.uniform(0.75, 1.5),
                    random_.uniform(0.3, 0.7),
                    random_.uniform(0.25, 0.55),
                    static_cast<int>(random_.index(1000))};
          scene_.pictures.push_back(p);
          if (!sound()) scene_.pictures.pop_back();
        }
      }
    }
    scene_.daylight.azimuth = -0.9 + random_.uniform(-0.5, 0.5);
    scene_.daylight.elevation = random_.uniform(0.45, 0.7);
    scene_.daylight.sky = random_.uniform(1.5, 3.0);
    scene_.daylight.sun = options_.sun;
  }

  void lamp(double x, double y, double z, double power) {
    Light light;
    light.position = {x, y, z};
    light.power = power;
    scene_.lights.push_back(light);
  }

  bool sound() const {
    try {
      scene_.check();
      return true;
    } catch (const Error&) {
      return false;
    }
  }

  /// Whether an object can be added: in its room, free of others and of the space around doors.
  bool fits(const SceneObject& object, double gap) const {
    const Vec3d size = object.size.isZero() ? usual_size(object.kind) : object.size;
    const bool lies = object.kind == ObjectKind::carpet || object.kind == ObjectKind::cable;
    Footprint f;
    f.centre = object.centre;
    f.axis = {std::cos(object.yaw), std::sin(object.yaw)};
    f.half = {size.x() / 2 + gap, size.y() / 2 + gap};
    f.low = 0;
    f.high = 1;
    if (!lies)
      for (const Door& door : scene_.doors)
        if (f.distance(door.centre) < kDoorSpace) return false;
    for (const SceneObject& other : scene_.objects) {
      const bool other_lies = other.kind == ObjectKind::carpet || other.kind == ObjectKind::cable;
      if (lies != other_lies) continue;
      const Vec3d other_size = other.size.isZero() ? usual_size(other.kind) : other.size;
      Footprint g = f;
      g.centre = other.centre;
      g.axis = {std::cos(other.yaw), std::sin(other.yaw)};
      g.half = {other_size.x() / 2, other_size.y() / 2};
      if (overlap(f, g, 0)) return false;
    }
    return true;
  }

  /// Adds an object if the scene stays sound.
  bool add(const SceneObject& object, double gap) {
    if (!fits(object, gap)) return false;
    scene_.objects.push_back(object);
    if (sound()) return true;
    scene_.objects.pop_back();
    return false;
  }

  void furnish(std::size_t index) {
    const Rect& r = rects_[index];
    using K = ObjectKind;
    struct Piece {
      K kind;
      Vec3d size;
      const char* material;
    };
    std::vector<Piece> pieces;
    const std::string& name = scene_.rooms[index].name;
    const char* wood = pick(std::array<const char*, 3>{"pine", "beech", "teak"});
    const auto shelf = [&] {
      return Piece{K::shelf, {random_.uniform(0.7, 1.1), 0.3, random_.uniform(1.2, 1.9)}, wood};
    };
    const auto cabinet = [&] {
      return Piece{K::cabinet, {random_.uniform(0.8, 1.5), 0.45, random_.uniform(0.6, 1.1)}, wood};
    };
    if (name == "bedroom" || name == "guest") {
      pieces = {{K::bed, {random_.uniform(0.95, 1.5), 2.0, 0.85}, wood},
                cabinet(),
                shelf(),
                {K::chair, usual_size(K::chair), wood}};
    } else if (name == "kitchen") {
      pieces = {cabinet(),
                cabinet(),
                {K::cabinet, {1.8, 0.55, 0.9}, "white"},
                {K::bin, usual_size(K::bin), "grey"}};
    } else {
      pieces = {{K::sofa, {random_.uniform(1.5, 2.0), 0.85, 0.8}, "fabric"},
                shelf(),
                cabinet(),
                shelf(),
                {K::plant, usual_size(K::plant), "clay"},
                {K::lamp, usual_size(K::lamp), "metal"}};
    }
    pieces.push_back(
        {K::carton, {random_.uniform(0.3, 0.5), random_.uniform(0.25, 0.4), random_.uniform(0.2, 0.4)}, ""});
    pieces.push_back({K::plant, {0.5, 0.5, random_.uniform(0.7, 1.1)}, "clay"});
    const auto count = static_cast<std::size_t>(
        std::lround(std::min(options_.furniture, 1.0) * static_cast<double>(pieces.size())));
    if (options_.furniture > 1)
      for (int i = 0; i < 4 * (options_.furniture - 1); ++i) pieces.push_back(cabinet());
    const std::size_t total = options_.furniture > 1 ? pieces.size() : count;
    for (std::size_t i = 0; i < total; ++i) {
      const Piece& piece = pieces[i];
      for (int attempt = 0; attempt < 30; ++attempt) {
        SceneObject object;
        object.kind = piece.kind;
        object.size = piece.size;
        object.material = piece.material;
        object.seed = static_cast<int>(random_.index(10000));
        // Its back to a wall, with a gap of a hand's breadth.
        const int wall = static_cast<int>(random_.index(4));
        const bool odd = random_.uniform() < options_.odd_angles;
        const double turn = odd ? random_.uniform(-0.6, 0.6) : random_.normal(0, 0.008);
        const double w = object.size.x() / 2, d = object.size.y() / 2;
        const double deep =
            std::abs(w * std::sin(turn)) + std::abs(d * std::cos(turn)) + random_.uniform(0.03, 0.08);
        const double wide = std::abs(w * std::cos(turn)) + std::abs(d * std::sin(turn)) + 0.04;
        const double length = wall % 2 ? r.y1 - r.y0 : r.x1 - r.x0;
        if (length < 2 * wide + 0.1) continue;
        const double along = random_.uniform(wide, length - wide);
        // The front (-y) looks into the room: wall 0 (south) has its back to -y, so it is turned by 180
        // degrees.
        if (wall == 0) object.centre = {r.x0 + along, r.y0 + deep}, object.yaw = kPi;
        if (wall == 1) object.centre = {r.x1 - deep, r.y0 + along}, object.yaw = -kPi / 2;
        if (wall == 2) object.centre = {r.x0 + along, r.y1 - deep}, object.yaw = 0;
        if (wall == 3) object.centre = {r.x0 + deep, r.y0 + along}, object.yaw = kPi / 2;
        object.yaw += turn;
        if (add(object, 0.02)) break;
      }
    }
    if (random_.uniform() < options_.furniture && name != "bedroom") {
      // A table with chairs, away from the walls.
      for (int attempt = 0; attempt < 20; ++attempt) {
        SceneObject table;
        table.kind = K::table;
        table.size = {random_.uniform(0.9, 1.4), random_.uniform(0.6, 0.85), random_.uniform(0.45, 0.75)};
        table.material = wood;
        table.seed = static_cast<int>(random_.index(10000));
        table.yaw =
            random_.uniform() < options_.odd_angles ? random_.uniform(-0.8, 0.8) : random_.normal(0, 0.01);
        table.centre = {random_.uniform(r.x0 + 1.2, r.x1 - 1.2), random_.uniform(r.y0 + 1.2, r.y1 - 1.2)};
        if (!add(table, kWay)) continue;
        const double c = std::cos(table.yaw), s = std::sin(table.yaw);
        for (const double side : {-1.0, 1.0}) {
          SceneObject chair;
          chair.kind = K::chair;
          chair.material = wood;
          chair.seed = static_cast<int>(random_.index(10000));
          const double y = side * (table.size.y() / 2 + 0.3), x = random_.uniform(-0.2, 0.2);
          chair.centre = table.centre + Vec2d(c * x - s * y, s * x + c * y);
          chair.yaw = table.yaw + (side > 0 ? 0 : kPi) + random_.normal(0, 0.05);
          add(chair, 0.02);
        }
        break;
      }
    }
    int carpets = 0;
    for (const SceneObject& o : scene_.objects) carpets += o.kind == K::carpet;
    if (carpets < options_.carpets && name != "hall")
      for (int attempt = 0; attempt < 20; ++attempt) {
        SceneObject carpet;
        carpet.kind = K::carpet;
        carpet.size = {random_.uniform(1.2, 1.9), random_.uniform(0.8, 1.3),
                       pick(std::array<double, 3>{0.006, 0.008, 0.012})};
        carpet.yaw = (random_.uniform() < 0.5 ? kPi / 2 : 0.0) + random_.normal(0, 0.02);
        carpet.material = pick(std::array<const char*, 2>{"ornament", "wool"});
        carpet.centre = {random_.uniform(r.x0 + 1, r.x1 - 1), random_.uniform(r.y0 + 1, r.y1 - 1)};
        carpet.seed = static_cast<int>(random_.index(10000));
        if (add(carpet, 0.05)) break;
      }
  }

  void litter(std::size_t index) {
    using K = ObjectKind;
    static constexpr std::array<K, 9> kKinds{K::shuttlecock, K::mahjong, K::cable,     K::shoe,  K::ball,
                                             K::shuttlecock, K::mahjong, K::pet_waste, K::carton};
    const Rect& r = rects_[index];
    const int count = static_cast<int>(std::lround(6 * options_.clutter));
    for (int i = 0; i < count; ++i) {
      const K kind = pick(kKinds);
      const Vec2d at(random_.uniform(r.x0 + 0.3, r.x1 - 0.3), random_.uniform(r.y0 + 0.3, r.y1 - 0.3));
      const int group = kind == K::mahjong ? 5 : kind == K::shoe ? 2 : 1;
      const double yaw = random_.uniform(-kPi, kPi);
      for (int k = 0; k < group; ++k) {
        SceneObject object;
        object.kind = kind;
        object.size = kind == K::carton ? Vec3d(random_.uniform(0.12, 0.2), random_.uniform(0.1, 0.16),
                                                random_.uniform(0.06, 0.12))
                                        : usual_size(kind);
        object.seed = static_cast<int>(random_.index(10000));
        object.yaw = kind == K::shoe ? yaw + random_.normal(0, 0.15) : random_.uniform(-kPi, kPi);
        object.centre = at;
        if (k > 0 && kind == K::shoe) object.centre += 0.13 * Vec2d(-std::sin(yaw), std::cos(yaw));
        if (k > 0 && kind == K::mahjong)
          object.centre += Vec2d(random_.normal(0, 0.07), random_.normal(0, 0.07));
        if (kind == K::cable) {
          double x = -0.3, y = 0;
          for (int p = 0; p < 6; ++p, x += 0.12, y = random_.normal(0, 0.08)) object.path.emplace_back(x, y);
        }
        const bool at_door = std::any_of(scene_.doors.begin(), scene_.doors.end(), [&](const Door& d) {
          return (d.centre - object.centre).norm() < kDoorSpace + 0.2;
        });
        // What lies on a carpet lies on its top.
        for (const SceneObject& c : scene_.objects)
          if (c.kind == K::carpet) {
            Footprint f;
            f.centre = c.centre;
            f.axis = {std::cos(c.yaw), std::sin(c.yaw)};
            f.half = {c.size.x() / 2, c.size.y() / 2};
            const double inside = -f.distance(object.centre);
            if (inside > 0) object.base = std::min(c.size.z(), inside);
          }
        if (!at_door) add(object, 0.02);
      }
    }
  }

  /// Takes things away, the last first, until a robot gets from each room into each other.
  void open_ways() {
    while (!connected()) {
      auto last = scene_.objects.end();
      for (auto it = scene_.objects.begin(); it != scene_.objects.end(); ++it)
        if (it->kind != ObjectKind::radiator && it->kind != ObjectKind::carpet) last = it;
      if (last == scene_.objects.end()) return;
      scene_.objects.erase(last);
    }
  }

  bool connected() const {
    const FloorPlan plan(scene_);
    constexpr double kCell = 0.06;
    const Vec2d low = plan.low(), high = plan.high();
    const int w = static_cast<int>((high.x() - low.x()) / kCell) + 1,
              h = static_cast<int>((high.y() - low.y()) / kCell) + 1;
    std::vector<char> free(static_cast<std::size_t>(w) * static_cast<std::size_t>(h));
    std::vector<int> reach(rects_.size(), 0), all(rects_.size(), 0);
    const auto at = [&](int x, int y) -> char& {
      return free[static_cast<std::size_t>(y) * static_cast<std::size_t>(w) + static_cast<std::size_t>(x)];
    };
    std::vector<std::pair<int, int>> starts, stack;
    for (int y = 0; y < h; ++y)
      for (int x = 0; x < w; ++x) {
        const double px = low.x() + (x + 0.5) * kCell, py = low.y() + (y + 0.5) * kCell;
        at(x, y) = plan.is_free(px, py, kRobotRadius);
        const int room = plan.room_at(px, py);
        if (at(x, y) && room >= 0) ++all[static_cast<std::size_t>(room)];
        if (at(x, y) && room == 0) starts.emplace_back(x, y);
      }
    // From the largest part of the first room's free floor: furniture may cut corners off.
    for (const auto& start : starts) {
      if (at(start.first, start.second) != 1) continue;
      std::vector<int> part(rects_.size(), 0);
      stack.push_back(start);
      at(start.first, start.second) = 2;
      while (!stack.empty()) {
        const auto [x, y] = stack.back();
        stack.pop_back();
        const int room = plan.room_at(low.x() + (x + 0.5) * kCell, low.y() + (y + 0.5) * kCell);
        if (room >= 0) ++part[static_cast<std::size_t>(room)];
        for (const auto& [dx, dy] : {std::pair{1, 0}, {-1, 0}, {0, 1}, {0, -1}})
          if (x + dx >= 0 && y + dy >= 0 && x + dx < w && y + dy < h && at(x + dx, y + dy) == 1) {
            at(x + dx, y + dy) = 2;
            stack.emplace_back(x + dx, y + dy);
          }
      }
      if (part[0] > reach[0]) reach = part;
    }
    for (std::size_t i = 0; i < reach.size(); ++i)
      if (all[i] == 0 || reach[i] < 0.7 * all[i]) return false;
    return true;
  }

  /// Turns all by a chance angle and shifts it.
  void place_in_world() {
    Scene& s = scene_;
    s.yaw = random_.uniform(-kPi, kPi);
    s.origin = {random_.uniform(-3, 3), random_.uniform(-3, 3)};
    for (Room& room : s.rooms)
      for (Vec2d& c : room.corners) c = s.to_world(c);
    for (Door& d : s.doors) d.centre = s.to_world(d.centre);
    for (SceneObject& o : s.objects) {
      o.centre = s.to_world(o.centre);
      o.yaw = std::remainder(o.yaw + s.yaw, 2 * kPi);
    }
    for (Light& l : s.lights) l.position.head<2>() = s.to_world(l.position.head<2>());
    s.daylight.azimuth = std::remainder(s.daylight.azimuth + s.yaw, 2 * kPi);
  }

  FlatOptions options_;
  Random random_;
  Scene scene_;
  std::vector<Rect> rects_;
};

}  // namespace

Scene generate_flat(const FlatOptions& options) {
  require(options.rooms >= 1 && options.rooms <= 6, "FlatOptions::rooms", "must lie in 1 .. 6",
          options.rooms);
  require(options.room_min >= 2.5 && options.room_max <= 12 && options.room_min <= options.room_max,
          "FlatOptions::room_min", "must be at least 2.5 m and not exceed room_max", options.room_min);
  return FlatGenerator(options).generate();
}

}  // namespace sweepkit
