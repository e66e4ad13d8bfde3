// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/data/scene_file.hpp"

#include <catch2/catch.hpp>
#include <filesystem>
#include <fstream>

#include "scratch_folder.hpp"
#include "sweepkit/core/error.hpp"
#include "sweepkit/core/random.hpp"
#include "sweepkit/data/flat.hpp"

using namespace sweepkit;
using Catch::Matchers::Contains;

namespace {

const char* const kScene = R"(name: test
frame: {yaw: 90, origin: [1, 2]}
materials:
  cream: {pattern: plaster, albedo: 0.7}
rooms:
  - {name: a, rect: [0, 0, 4, 3], floor: oak, walls: cream, wall_materials: {1: bricks}}
  - name: b
    corners: [[4.1, 0], [7, 0], [7, 3], [4.1, 3]]
doors:
  - {between: [a, b], at: [4.05, 1.5], sill: 0.01}
windows:
  - {room: a, wall: 2, along: 2, width: 1}
pictures:
  - {room: b, wall: 0, along: 1.2, seed: 4}
objects:
  - {kind: shelf, at: [1, 2.7], yaw: 1.5, seed: 3}
  - kind: cable
    at: [2, 1]
    path: [[-0.2, 0], [0, 0.1], [0.2, 0]]
lights:
  - {at: [2, 1.5, 2.2], power: 3}
daylight: {azimuth: 30, elevation: 40, sun: 2, sky: 1}
drive: {whatever: 1}
)";

std::string complaint(const std::string& text) {
  try {
    parse_scene(text, "f.yaml");
  } catch (const Error& e) {
    CHECK(e.kind() == ErrorKind::data);
    return e.what();
  }
  return {};
}

std::string spoiled(const std::string& what, const std::string& with) {
  std::string text = kScene;
  const auto at = text.find(what);
  REQUIRE(at != std::string::npos);
  return text.replace(at, what.size(), with);
}

}  // namespace

TEST_CASE("a scene is read in the frame of its file") {
  const Scene scene = parse_scene(kScene, "f.yaml");
  CHECK(scene.name == "test");
  REQUIRE(scene.rooms.size() == 2);
  // Turned by 90 degrees and shifted: (4, 0) comes to (1, 6).
  CHECK((scene.rooms[0].corners[1] - Vec2<double>(1, 6)).norm() < 1e-12);
  CHECK(scene.rooms[0].wall_materials.at(1) == "bricks");
  CHECK(scene.doors[0].sill == 0.01);
  CHECK(scene.objects[0].yaw == Approx(91.5 * 3.14159265358979 / 180));
  CHECK(scene.objects[1].path.size() == 3);
  CHECK(scene.find_material("cream")->albedo == 0.7);
  CHECK(scene.daylight.azimuth == Approx(120 * 3.14159265358979 / 180));
}

TEST_CASE("what is wrong in a scene file is named with line and nearest key") {
  const auto refused = [&](const std::string& text, const std::string& place, const std::string& what) {
    const std::string message = complaint(text);
    INFO(message);
    CHECK_THAT(message, Contains("f.yaml:" + place));
    CHECK_THAT(message, Contains(what));
  };
  refused(spoiled("rooms:", "roomz:"), "5: roomz", "the nearest is rooms");
  refused(spoiled("floor: oak", "flor: oak"), "6: rooms[0].flor", "the nearest is floor");
  refused(spoiled("kind: shelf", "kind: shelve"), "16: objects[0].kind", "the nearest is shelf");
  refused(spoiled("floor: oak", "floor: oka"), "6", "the nearest is oak");
  refused(spoiled("[0, 0, 4, 3]", "[0, 0, 0, 3]"), "6: rooms[0].rect", "has no area");
  refused(spoiled("[0, 0, 4, 3]", "[0, 0, 4]"), "6", "[x0, y0, x1, y1]");
  refused(spoiled("[0, 0, 4, 3]", "[0, 0, .nan, 3]"), "6", "finite number");
  refused(spoiled("[[4.1, 0], [7, 0], [7, 3], [4.1, 3]]", "[[4.1, 0], [4.1, 0], [4.1, 3], [4.1, 3]]"),
          "7: rooms[1]", "area");
  refused(spoiled("at: [1, 2.7]", "at: [1, 2.95]"), "16: objects[0]", "reaches through a wall");
  refused(spoiled("at: [1, 2.7]", "at: [1]"), "16: objects[0].at", "a point [x, y]");
  refused(spoiled("{kind: shelf, at: [1, 2.7]", "{kind: shelf"), "16: objects[0]", "needs the key at");
  refused(spoiled("yaw: 1.5", "yaw: 1.5, yaw: 2"), "16: objects[0].yaw", "stands twice");
  refused(spoiled("along: 2,", "along: 3.9,"), "12: windows[0]", "beyond its wall");
  refused(spoiled("[a, b]", "[a, c]"), "10: doors[0]", "no such room");
  refused(spoiled("sill: 0.01", "sill: 0.5"), "10: doors[0]", "sill");
  refused(spoiled("power: 3", "power: -3"), "21: lights[0]", "power");
  refused(spoiled("albedo: 0.7", "albedo: 1.7"), "4: materials.cream.albedo", "must be in [0.01, 0.95]");
  refused(spoiled("{whatever: 1}", "{whatever: 1}\nflat: {seeds: 1}"), "24: flat.seeds",
          "the nearest is seed");
  refused("[1, 2]", "1", "must hold keys and values");
  refused("a: [", "", "is no YAML");
  refused("name: x", "1", "needs rooms");
  refused("rooms: 3", "1: rooms", "must be a list");
  refused("flat: {room_min: 5, room_max: 4}", "1: flat", "room_min");
  CHECK_THROWS_AS(read_scene("/no/such/file.yaml"), Error);
}

TEST_CASE("things are added to a generated flat") {
  const Scene plain = generate_flat({});
  const Scene scene = parse_scene("flat: {seed: 1}\nlights:\n  - {at: [1, 1, 2], power: 0.5}\n", "f.yaml");
  CHECK(scene.objects.size() == plain.objects.size());
  CHECK(scene.lights.size() == plain.lights.size() + 1);
}

TEST_CASE("a scene that is written reads as the same scene") {
  const ScratchFolder folder;
  for (int seed = 0; seed < 5; ++seed) {
    FlatOptions options;
    options.seed = seed;
    Scene scene = generate_flat(options);
    scene.materials["own"] = {Pattern::bricks, 0.3, 1.0, 0.2, 9};
    scene.rooms[0].wall_materials[2] = "own";
    write_scene(scene, folder.path() / "scene.yaml");
    const Scene again = read_scene(folder.path() / "scene.yaml");
    CHECK(scene_to_yaml(again) == scene_to_yaml(scene));
    REQUIRE(again.objects.size() == scene.objects.size());
    for (std::size_t i = 0; i < scene.objects.size(); ++i) {
      CHECK((again.objects[i].centre - scene.objects[i].centre).norm() < 3e-9);
      CHECK(std::abs(std::remainder(again.objects[i].yaw - scene.objects[i].yaw, 2 * 3.141592653589793)) <
            1e-9);
    }
  }
  CHECK_FALSE(std::filesystem::exists(folder.path() / "scene.yaml.part"));
  CHECK_THROWS_AS(write_scene(generate_flat({}), "/dev/full/scene.yaml"), Error);
}

TEST_CASE("broken scene files are refused by an Error, whatever is broken") {
  Random random(11);
  const std::string source = kScene;
  const std::string spice = "{}[]:,-#&*!|>'\"%@`\n\t 0.9aZ\x80";
  int refused = 0;
  for (int n = 0; n < 400; ++n) {
    std::string text = source;
    for (int k = 0; k < 1 + n % 4; ++k) {
      const std::size_t at = random.index(text.size());
      switch (random.index(3)) {
        case 0:
          text[at] = spice[random.index(spice.size())];
          break;
        case 1:
          text.erase(at, 1 + random.index(20));
          break;
        default:
          text.insert(at, 1, spice[random.index(spice.size())]);
      }
      if (text.empty()) text = "x";
    }
    try {
      parse_scene(text, "f.yaml");
    } catch (const Error&) {
      ++refused;
    }
  }
  CHECK(refused > 100);
}
