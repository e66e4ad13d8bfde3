// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
// The keys of a scene file that tell of the robot: robot, sensors, drive, events.
#include <cmath>
#include <fstream>
#include <numbers>
#include <sstream>

#include "sweepkit/data/scene_file.hpp"
#include "sweepkit/data/simulate.hpp"
#include "yaml_node.hpp"

namespace sweepkit {
namespace {

constexpr double kRad = std::numbers::pi / 180.0;
constexpr Range kTime{0.0, 36000.0};
constexpr Range kLength{0.0, 1000.0};
constexpr Range kAngle{-3600.0, 3600.0};

// Where a robot stands and looks: [x, y] or [x, y, yaw in degrees], in the frame of the file.
struct Place {
  Vec2<double> p;
  std::optional<double> yaw;
};

Place read_place(const YamlNode& node, const Scene& scene) {
  const std::vector<double> v = node.numbers();
  if (v.size() != 2 && v.size() != 3) throw node.error("must be [x, y] or [x, y, yaw]");
  Place place{scene.to_world({v[0], v[1]}), std::nullopt};
  if (v.size() == 3) place.yaw = v[2] * kRad + scene.yaw;
  return place;
}

std::vector<Vec2<double>> read_points(const YamlNode& node, const Scene& scene) {
  std::vector<Vec2<double>> points;
  for (const YamlNode& item : node.items()) points.push_back(scene.to_world(item.point()));
  if (points.empty()) throw node.error("must be a list of points [x, y]");
  return points;
}

// A step is one key with what belongs to it.
DriveStep read_step(const YamlNode& node, const Scene& scene) {
  using Kind = DriveStep::Kind;
  DriveStep step;
  std::string name;
  if (!node.is_map()) {
    name = node.text();  // "home" needs nothing
    if (name != "home" && name != "cover")
      throw node.error("must be one of home, cover, or a step with its value", name);
  } else {
    static const std::vector<std::string> kNames = {"stand", "drive",   "go",          "back",
                                                    "turn",  "turn_to", "follow_wall", "face_wall",
                                                    "carry", "lanes",   "cover",       "home"};
    node.allow(kNames);
    if (node.keys().size() != 1) throw node.error("a step has one key");
    name = node.keys()[0];
  }
  step.place = node.place();
  if (name == "home" || name == "cover") step.kind = name == "home" ? Kind::home : Kind::cover;
  if (!node.is_map()) {
    if (step.kind == Kind::cover) step.spacing = 0.4;
    return step;
  }

  const YamlNode value = node.at(name);
  step.place = value.place();
  if (name == "stand") {
    step.seconds = value.number(kTime);
  } else if (name == "drive") {
    step.kind = Kind::drive;
    if (value.is_map()) {
      value.allow({"points", "yaw"});
      step.points = read_points(value.at("points"), scene);
      if (value.has("yaw")) step.yaw = value.at("yaw").number(kAngle) * kRad + scene.yaw;
    } else {
      step.points = read_points(value, scene);
    }
  } else if (name == "go") {
    step.kind = Kind::go;
    const Place place = read_place(value, scene);
    step.points = {place.p};
    step.yaw = place.yaw;
  } else if (name == "back") {
    step.kind = Kind::back;
    step.length = value.number(kLength);
  } else if (name == "turn") {
    step.kind = Kind::turn;
    step.angle = value.number(kAngle) * kRad;
  } else if (name == "turn_to") {
    step.kind = Kind::turn_to;
    step.yaw = value.number(kAngle) * kRad + scene.yaw;
  } else if (name == "lanes") {
    value.allow({"room", "spacing", "seconds"});
    step.kind = Kind::lanes;
    step.room = value.at("room").text();
    value.read("spacing", step.spacing, range(0.02, 10.0));
    value.read("seconds", step.seconds, kTime);
  } else if (name == "follow_wall") {
    value.allow({"distance", "length"});
    step.kind = Kind::follow_wall;
    step.length = 3.0;
    value.read("distance", step.distance, range(0.02, 5.0));
    value.read("length", step.length, kLength);
  } else if (name == "face_wall") {
    value.allow({"room", "wall", "along", "gap", "seconds", "sway"});
    step.kind = Kind::face_wall;
    step.room = value.at("room").text();
    step.wall = value.at("wall").integer(range(0, 1000));
    step.along = value.at("along").number(kLength);
    step.distance = 0.05;
    step.seconds = 3.0;
    step.angle = 14.0 * kRad;
    value.read("gap", step.distance, range(0.0, 2.0));
    value.read("seconds", step.seconds, kTime);
    value.read_degrees("sway", step.angle, range(-90.0, 90.0));
  } else if (name == "carry") {
    value.allow({"to", "height", "seconds"});
    step.kind = Kind::carry;
    if (const YamlNode goal = value.at("to"); goal.is_list()) {
      const Place place = read_place(goal, scene);
      step.points = {place.p};
      step.yaw = place.yaw;
    } else if (goal.text() != "anywhere") {
      throw goal.error("must be [x, y], [x, y, yaw] or anywhere", goal.text());
    }
    step.seconds = 5.0;
    value.read("height", step.height, range(0.01, 2.0));
    value.read("seconds", step.seconds, range(0.5, 600.0));
  } else if (name == "cover") {
    value.allow({"spacing", "seconds"});
    step.spacing = 0.4;
    value.read("spacing", step.spacing, range(0.02, 10.0));
    value.read("seconds", step.seconds, kTime);
  }
  return step;
}

DriveScript read_script(const YamlNode& node, const Scene& scene) {
  node.allow({"start", "steps"});
  DriveScript script;
  script.place = node.place();
  if (node.has("start")) {
    const YamlNode start = node.at("start");
    const Place place = read_place(start, scene);
    script.start = place.p;
    script.yaw = place.yaw.value_or(scene.yaw);
    script.place = start.place();
  }
  if (node.has("steps"))
    for (const YamlNode& item : node.at("steps").items()) script.steps.push_back(read_step(item, scene));
  return script;
}

void read_event(const YamlNode& node, SimulatedScene& s) {
  static const std::vector<std::string> kKinds = {"dark", "exposure_step", "person", "missing", "late",
                                                  "slip", "free_spin",     "bump",   "dropout"};
  if (!node.is_map()) throw node.error("must be a map with the key `kind`");
  const std::string kind = kKinds[node.at("kind").choice(kKinds)];
  SceneEvent event;
  DriveDisturbance disturbance;
  event.place = disturbance.place = node.place();
  const double begin = node.at("start").number(kTime);
  const bool at_once = kind == "exposure_step" || kind == "bump";
  const double end = begin + (at_once ? 1.0 : node.at("seconds").number(range(1e-3, 36000.0)));
  event.begin = disturbance.begin = begin;
  event.end = disturbance.end = end;
  static const std::vector<std::string> kSensors = {"cameras", "left", "right", "imu", "wheels"};
  const auto read_sensor = [&] {
    if (node.has("sensor"))
      event.sensor = static_cast<SceneEvent::Sensor>(node.at("sensor").choice(kSensors));
  };
  if (kind == "dark") {
    node.allow({"kind", "start", "seconds", "level"});
    event.kind = SceneEvent::Kind::dark;
    node.read("level", event.level, range(0.0, 10.0));
  } else if (kind == "exposure_step") {
    node.allow({"kind", "start", "factor"});
    event.kind = SceneEvent::Kind::exposure_step;
    node.read("factor", event.factor, range(0.01, 100.0));
  } else if (kind == "person") {
    node.allow({"kind", "start", "seconds", "path"});
    event.kind = SceneEvent::Kind::person;
    event.path = read_points(node.at("path"), s.scene);
    if (event.path.size() < 2) throw node.at("path").error("must have two points or more");
  } else if (kind == "missing" || kind == "dropout") {
    node.allow({"kind", "start", "seconds", "sensor", "share"});
    event.kind = SceneEvent::Kind::missing;
    read_sensor();
    node.read("share", event.share, range(0.0, 1.0));
  } else if (kind == "late") {
    node.allow({"kind", "start", "seconds", "sensor", "delay"});
    event.kind = SceneEvent::Kind::late;
    read_sensor();
    node.read("delay", event.delay, range(0.0, 10.0));
  } else if (kind == "slip") {
    node.allow({"kind", "start", "seconds", "grip", "wheels"});
    disturbance.kind = DriveDisturbance::Kind::slip;
    node.read("grip", disturbance.grip, range(0.001, 1.0));
    if (node.has("wheels")) {
      const std::size_t which = node.at("wheels").choice({"both", "left", "right"});
      disturbance.left = which != 2;
      disturbance.right = which != 1;
    }
  } else if (kind == "free_spin") {
    node.allow({"kind", "start", "seconds", "left", "right"});
    disturbance.kind = DriveDisturbance::Kind::free_spin;
    node.read("left", disturbance.speed_left, range(-10.0, 10.0));
    node.read("right", disturbance.speed_right, range(-10.0, 10.0));
  } else {
    node.allow({"kind", "start", "strength"});
    disturbance.kind = DriveDisturbance::Kind::bump;
    node.read("strength", disturbance.strength, range(0.0, 20.0));
  }
  if (kind == "slip" || kind == "free_spin" || kind == "bump")
    s.disturbances.push_back(disturbance);
  else
    s.events.push_back(event);
}

}  // namespace

SimulatedScene parse_simulated_scene(const std::string& text, const std::string& name,
                                     SimulationOptions& options) {
  SimulatedScene s;
  s.scene = parse_scene(text, name);
  const YamlNode root = YamlNode::parse(text, name);
  if (root.has("robot")) root.at("robot").read_options(list_options(options.robot));
  if (root.has("sensors")) root.at("sensors").read_options(list_options(options.sensors));
  if (root.has("drive")) s.script = read_script(root.at("drive"), s.scene);
  if (s.script.place.empty()) s.script.place = name;
  if (root.has("events"))
    for (const YamlNode& item : root.at("events").items()) read_event(item, s);
  return s;
}

SimulatedScene read_simulated_scene(const std::filesystem::path& file, SimulationOptions& options) {
  std::ifstream stream(file, std::ios::binary);
  if (!stream) throw Error(ErrorKind::io, file.string(), "cannot be opened");
  // A scene that people write has some kilobytes.
  constexpr std::size_t kMost = 4 << 20;
  std::string text(kMost + 1, '\0');
  stream.read(text.data(), static_cast<std::streamsize>(text.size()));
  if (stream.bad() || stream.gcount() == 0)
    throw Error(ErrorKind::io, file.string(), "cannot be read, or is empty");
  text.resize(static_cast<std::size_t>(stream.gcount()));
  if (text.size() > kMost) throw Error(ErrorKind::data, file.string(), "is too long for a scene");
  return parse_simulated_scene(text, file.string(), options);
}

}  // namespace sweepkit
