// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/data/scene_file.hpp"

#include <fmt/format.h>

#include <array>
#include <cmath>
#include <fstream>
#include <functional>
#include <numbers>
#include <system_error>
#include <utility>

#include "sweepkit/data/flat.hpp"
#include "yaml_node.hpp"

namespace sweepkit {
namespace {

using Vec2d = Vec2<double>;
using Vec3d = Vec3<double>;

constexpr double kDegree = std::numbers::pi / 180;
constexpr std::array<std::pair<Pattern, const char*>, 15> kPatterns{{{Pattern::plain, "plain"},
                                                                     {Pattern::plaster, "plaster"},
                                                                     {Pattern::wallpaper, "wallpaper"},
                                                                     {Pattern::panels, "panels"},
                                                                     {Pattern::bricks, "bricks"},
                                                                     {Pattern::planks, "planks"},
                                                                     {Pattern::tiles, "tiles"},
                                                                     {Pattern::wood, "wood"},
                                                                     {Pattern::weave, "weave"},
                                                                     {Pattern::fabric, "fabric"},
                                                                     {Pattern::print, "print"},
                                                                     {Pattern::spines, "spines"},
                                                                     {Pattern::picture, "picture"},
                                                                     {Pattern::glyph, "glyph"},
                                                                     {Pattern::paint, "paint"}}};

/// Reads a world; knows where each part stood, so that Scene::check's complaints can name the line.
class SceneReader {
 public:
  explicit SceneReader(const YamlNode& root) : root_(root) {}

  Scene read() {
    root_.allow({"name", "frame", "flat", "rooms", "doors", "windows", "pictures", "objects", "lights",
                 "daylight", "materials", "robot", "drive", "events", "sensors"});
    if (root_.has("flat")) {
      FlatOptions options;
      const YamlNode node = root_.at("flat");
      node.read_options(list_options(options));
      if (options.room_min > options.room_max) throw node.error("room_min must not exceed room_max");
      scene_ = generate_flat(options);
    }
    root_.read("name", scene_.name);
    if (root_.has("frame")) {
      const YamlNode frame = root_.at("frame");
      if (root_.has("flat")) throw frame.error("a generated flat has a frame of its own");
      frame.allow({"yaw", "origin"});
      frame.read_degrees("yaw", scene_.yaw, range(-360, 360));
      if (frame.has("origin")) scene_.origin = frame.at("origin").point();
    }
    if (root_.has("materials")) read_materials(root_.at("materials"));
    list("rooms", [&](const YamlNode& n) { read_room(n); });
    list("doors", [&](const YamlNode& n) { read_door(n); });
    list("windows", [&](const YamlNode& n) { read_window(n); });
    list("pictures", [&](const YamlNode& n) { read_picture(n); });
    list("objects", [&](const YamlNode& n) { read_object(n); });
    list("lights", [&](const YamlNode& n) { read_light(n); });
    if (root_.has("daylight")) {
      const YamlNode day = root_.at("daylight");
      day.allow({"azimuth", "elevation", "sun", "sky"});
      if (day.has("azimuth")) scene_.daylight.azimuth = day.at("azimuth").number() * kDegree + scene_.yaw;
      day.read_degrees("elevation", scene_.daylight.elevation);
      day.read("sun", scene_.daylight.sun);
      day.read("sky", scene_.daylight.sky);
    }
    if (scene_.rooms.empty()) throw root_.error("a scene needs rooms, or a flat");
    check();
    return std::move(scene_);
  }

 private:
  template <class Read>
  void list(const std::string& key, Read&& read) {
    if (!root_.has(key)) return;
    for (const YamlNode& item : root_.at(key).items()) {
      if (!item.is_map()) throw item.error("must hold keys and values, key: value");
      read(item);
    }
  }

  void read_materials(const YamlNode& node) {
    if (!node.is_map()) throw node.error("must hold names and what they look like");
    std::vector<std::string> words;
    for (const auto& entry : kPatterns) words.emplace_back(entry.second);
    for (const std::string& name : node.keys()) {
      const YamlNode item = node.at(name);
      item.allow({"pattern", "albedo", "contrast", "cell", "seed"});
      Material m;
      m.pattern = kPatterns[item.at("pattern").choice(words)].first;
      item.read("albedo", m.albedo, range(0.01, 0.95));
      item.read("contrast", m.contrast, range(0, 4));
      item.read("cell", m.cell, range(0, 2));
      item.read("seed", m.seed, range(0, 2147483647));
      if (!scene_.materials.emplace(name, m).second) throw item.error("stands twice");
    }
  }

  void material(const YamlNode& node, const std::string& key, std::string& value) const {
    if (!node.has(key)) return;
    value = node.at(key).text();
    if (!scene_.find_material(value)) {
      std::vector<std::string> known;
      for (const auto& entry : scene_.materials) known.push_back(entry.first);
      for (const auto& entry : standard_materials()) known.push_back(entry.first);
      node.at(key).choice(known);  // says which is the nearest
    }
  }

  void read_room(const YamlNode& node) {
    node.allow({"name", "rect", "corners", "height", "floor", "walls", "ceiling", "wall_materials",
                "skirting", "skirting_height"});
    Room room;
    room.name = node.at("name").text();
    if (node.has("rect") == node.has("corners")) throw node.error("needs either rect or corners");
    if (node.has("rect")) {
      const YamlNode rect = node.at("rect");
      const auto v = rect.numbers();
      if (v.size() != 4) throw rect.error("must be [x0, y0, x1, y1]");
      if (!(v[2] > v[0] && v[3] > v[1])) throw rect.error("has no area: x1 must exceed x0, and y1 y0");
      room.corners = {{v[0], v[1]}, {v[2], v[1]}, {v[2], v[3]}, {v[0], v[3]}};
    } else {
      for (const YamlNode& corner : node.at("corners").items()) room.corners.push_back(corner.point());
    }
    for (Vec2d& corner : room.corners) corner = scene_.to_world(corner);
    node.read("height", room.height);
    material(node, "floor", room.floor);
    material(node, "walls", room.walls);
    material(node, "ceiling", room.ceiling);
    if (node.has("skirting") && node.at("skirting").text() == "none")
      room.skirting.clear();
    else
      material(node, "skirting", room.skirting);
    node.read("skirting_height", room.skirting_height);
    if (node.has("wall_materials")) {
      const YamlNode own = node.at("wall_materials");
      if (!own.is_map()) throw own.error("must hold numbers of walls and materials");
      for (const std::string& key : own.keys()) {
        if (key.empty() || key.size() > 3 || key.find_first_not_of("0123456789") != std::string::npos)
          throw own.at(key).error("a wall is named by its number", key);
        material(own, key, room.wall_materials[std::stoi(key)]);
      }
    }
    note("room " + room.name, node);
    scene_.rooms.push_back(std::move(room));
  }

  void read_door(const YamlNode& node) {
    node.allow({"between", "at", "width", "height", "sill", "sill_ramp", "material"});
    Door door;
    const auto rooms = node.at("between").items();
    if (rooms.size() != 2) throw node.at("between").error("must name two rooms");
    door.from = rooms[0].text();
    door.to = rooms[1].text();
    door.centre = scene_.to_world(node.at("at").point());
    node.read("width", door.width);
    node.read("height", door.height);
    node.read("sill", door.sill);
    node.read("sill_ramp", door.sill_ramp);
    material(node, "material", door.material);
    note("door " + door.from + " - " + door.to, node);
    scene_.doors.push_back(std::move(door));
  }

  void read_window(const YamlNode& node) {
    node.allow({"room", "wall", "along", "base", "width", "height"});
    Window w;
    w.room = node.at("room").text();
    w.wall = node.at("wall").integer();
    w.along = node.at("along").number();
    node.read("base", w.base);
    node.read("width", w.width);
    node.read("height", w.height);
    note(fmt::format("windows[{}]", scene_.windows.size()), node);
    scene_.windows.push_back(std::move(w));
  }

  void read_picture(const YamlNode& node) {
    node.allow({"room", "wall", "along", "centre", "width", "height", "seed"});
    Picture p;
    p.room = node.at("room").text();
    p.wall = node.at("wall").integer();
    p.along = node.at("along").number();
    node.read("centre", p.centre);
    node.read("width", p.width);
    node.read("height", p.height);
    node.read("seed", p.seed, range(0, 2147483647));
    note(fmt::format("pictures[{}]", scene_.pictures.size()), node);
    scene_.pictures.push_back(std::move(p));
  }

  void read_object(const YamlNode& node) {
    node.allow({"kind", "name", "at", "yaw", "size", "base", "ramp", "material", "path", "seed"});
    std::vector<std::string> kinds;
    for (int i = 0; i <= static_cast<int>(ObjectKind::ball); ++i)
      kinds.emplace_back(to_string(static_cast<ObjectKind>(i)));
    SceneObject object;
    object.kind = static_cast<ObjectKind>(node.at("kind").choice(kinds));
    node.read("name", object.name);
    object.centre = scene_.to_world(node.at("at").point());
    node.read_degrees("yaw", object.yaw, range(-720, 720));
    object.yaw += scene_.yaw;
    if (node.has("size")) {
      object.size = node.at("size").point3();
      if (!(object.size.minCoeff() > 0)) throw node.at("size").error("must be three lengths above zero");
    }
    node.read("base", object.base);
    node.read("ramp", object.ramp);
    material(node, "material", object.material);
    if (node.has("path")) {
      if (object.kind != ObjectKind::cable) throw node.at("path").error("only cables have one");
      for (const YamlNode& p : node.at("path").items()) object.path.push_back(p.point());
    }
    node.read("seed", object.seed, range(0, 2147483647));
    note(fmt::format("objects[{}]", scene_.objects.size()), node);
    scene_.objects.push_back(std::move(object));
  }

  void read_light(const YamlNode& node) {
    node.allow({"at", "power", "radius"});
    Light light;
    light.position = node.at("at").point3();
    light.position.head<2>() = scene_.to_world(light.position.head<2>());
    node.read("power", light.power);
    node.read("radius", light.radius);
    note(fmt::format("lights[{}]", scene_.lights.size()), node);
    scene_.lights.push_back(light);
  }

  void note(const std::string& what, const YamlNode& node) { places_.emplace_back(what, node.place()); }

  void check() const {
    try {
      scene_.check();
    } catch (const Error& e) {
      // The part of the file that the complaint is about; of two of a name the later, which was refused.
      const std::string& what = e.place();
      std::string place = root_.place();
      for (const auto& [name, at] : places_)
        if (what.compare(0, name.size(), name) == 0 &&
            (what.size() == name.size() || what[name.size()] == ' ' || what[name.size()] == '['))
          place = at;
      throw Error(ErrorKind::data, place, e.what());
    }
  }

  const YamlNode& root_;
  Scene scene_;
  std::vector<std::pair<std::string, std::string>> places_;
};

std::string number(double value) {
  // To 1e-9, which hides what turning to and fro did to the last digits.
  const double rounded = std::round(value * 1e9) / 1e9;
  return number_text(rounded == 0 ? 0.0 : rounded);
}

std::string quoted(const std::string& text) {
  YAML::Emitter emitter;
  emitter << YAML::DoubleQuoted << text;
  return emitter.c_str();
}

std::string degrees(double angle) { return number(std::remainder(angle, 2 * std::numbers::pi) / kDegree); }

}  // namespace

Scene parse_scene(const std::string& text, const std::string& name) {
  const YamlNode root = YamlNode::parse(text, name);
  return SceneReader(root).read();
}

Scene read_scene(const std::filesystem::path& file) {
  const YamlNode root = YamlNode::load(file.string());
  return SceneReader(root).read();
}

std::string scene_to_yaml(const Scene& scene) {
  std::string out = fmt::format("name: {}\nframe: {{yaw: {}, origin: [{}, {}]}}\n", quoted(scene.name),
                                degrees(scene.yaw), number(scene.origin.x()), number(scene.origin.y()));
  const auto point = [&](const Vec2d& p_world) {
    const Vec2d p = scene.from_world(p_world);
    return fmt::format("[{}, {}]", number(p.x()), number(p.y()));
  };
  if (!scene.materials.empty()) out += "materials:\n";
  for (const auto& [name, m] : scene.materials) {
    const char* pattern = "";
    for (const auto& entry : kPatterns)
      if (entry.first == m.pattern) pattern = entry.second;
    out += fmt::format("  {}: {{pattern: {}, albedo: {}, contrast: {}, cell: {}, seed: {}}}\n", quoted(name),
                       pattern, number(m.albedo), number(m.contrast), number(m.cell), m.seed);
  }
  out += "rooms:\n";
  for (const Room& room : scene.rooms) {
    out += fmt::format("  - name: {}\n    corners: [", quoted(room.name));
    for (std::size_t i = 0; i < room.corners.size(); ++i) out += (i ? ", " : "") + point(room.corners[i]);
    out += fmt::format("]\n    height: {}\n    floor: {}\n    walls: {}\n    ceiling: {}\n",
                       number(room.height), quoted(room.floor), quoted(room.walls), quoted(room.ceiling));
    out += fmt::format("    skirting: {}\n    skirting_height: {}\n",
                       room.skirting.empty() ? "none" : quoted(room.skirting), number(room.skirting_height));
    if (!room.wall_materials.empty()) {
      std::string own;
      for (const auto& [wall, name] : room.wall_materials)
        own += fmt::format("{}{}: {}", own.empty() ? "" : ", ", wall, quoted(name));
      out += "    wall_materials: {" + own + "}\n";
    }
  }
  if (!scene.doors.empty()) out += "doors:\n";
  for (const Door& d : scene.doors)
    out += fmt::format(
        "  - {{between: [{}, {}], at: {}, width: {}, height: {}, sill: {}, sill_ramp: {}, material: {}}}\n",
        quoted(d.from), quoted(d.to), point(d.centre), number(d.width), number(d.height), number(d.sill),
        number(d.sill_ramp), quoted(d.material));
  if (!scene.windows.empty()) out += "windows:\n";
  for (const Window& w : scene.windows)
    out += fmt::format("  - {{room: {}, wall: {}, along: {}, base: {}, width: {}, height: {}}}\n",
                       quoted(w.room), w.wall, number(w.along), number(w.base), number(w.width),
                       number(w.height));
  if (!scene.pictures.empty()) out += "pictures:\n";
  for (const Picture& p : scene.pictures)
    out += fmt::format("  - {{room: {}, wall: {}, along: {}, centre: {}, width: {}, height: {}, seed: {}}}\n",
                       quoted(p.room), p.wall, number(p.along), number(p.centre), number(p.width),
                       number(p.height), p.seed);
  if (!scene.objects.empty()) out += "objects:\n";
  for (const SceneObject& o : scene.objects) {
    out += fmt::format("  - {{kind: {}, at: {}, yaw: {}", to_string(o.kind), point(o.centre),
                       degrees(o.yaw - scene.yaw));
    if (!o.name.empty()) out += ", name: " + quoted(o.name);
    if (!o.size.isZero())
      out += fmt::format(", size: [{}, {}, {}]", number(o.size.x()), number(o.size.y()), number(o.size.z()));
    if (o.base != 0) out += ", base: " + number(o.base);
    if (o.kind == ObjectKind::carpet) out += ", ramp: " + number(o.ramp);
    if (!o.material.empty()) out += ", material: " + quoted(o.material);
    if (!o.path.empty()) {
      out += ", path: [";
      for (std::size_t i = 0; i < o.path.size(); ++i)
        out += fmt::format("{}[{}, {}]", i ? ", " : "", number(o.path[i].x()), number(o.path[i].y()));
      out += "]";
    }
    if (o.seed != 0) out += fmt::format(", seed: {}", o.seed);
    out += "}\n";
  }
  if (!scene.lights.empty()) out += "lights:\n";
  for (const Light& l : scene.lights) {
    const Vec2d p = scene.from_world(l.position.head<2>());
    out += fmt::format("  - {{at: [{}, {}, {}], power: {}, radius: {}}}\n", number(p.x()), number(p.y()),
                       number(l.position.z()), number(l.power), number(l.radius));
  }
  out += fmt::format("daylight: {{azimuth: {}, elevation: {}, sun: {}, sky: {}}}\n",
                     degrees(scene.daylight.azimuth - scene.yaw), degrees(scene.daylight.elevation),
                     number(scene.daylight.sun), number(scene.daylight.sky));
  return out;
}

void write_scene(const Scene& scene, const std::filesystem::path& file) {
  // Written beside and renamed: a full disk leaves no half file under the final name.
  const std::filesystem::path half = file.string() + ".part";
  std::error_code ignored;
  {
    std::ofstream out(half, std::ios::binary);
    out << scene_to_yaml(scene);
    out.close();
    if (!out) {
      std::filesystem::remove(half, ignored);
      throw Error(ErrorKind::io, file.string(), "cannot be written");
    }
  }
  std::error_code failure;
  std::filesystem::rename(half, file, failure);
  if (failure) {
    std::filesystem::remove(half, ignored);
    throw Error(ErrorKind::io, file.string(), "cannot be written: " + failure.message());
  }
}

}  // namespace sweepkit
