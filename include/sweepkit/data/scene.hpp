// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "sweepkit/geometry/so3.hpp"

namespace sweepkit {

// A furnished flat as plain data: what a scene file says and what a renderer draws. The world frame has z up
// and the bare floor at z = 0. Lengths in m, angles in rad, counter-clockwise seen from above.

/// What a pixel shows, as label images have it.
enum class SceneLabel : std::uint8_t {
  background = 0,  ///< walls, ceiling, windows, doors, pictures
  floor = 1,       ///< also sills, although they rise above it
  carpet = 2,
  furniture = 3,
  shuttlecock = 10,
  cable = 11,
  mahjong = 12,
  pet_waste = 13,
  small = 14,  ///< shoes, balls, small boxes
  moving = 20,
};

/// How a surface looks.
enum class Pattern {
  plain,      ///< one colour with a very faint grain: a bare wall
  plaster,    ///< small bumps
  wallpaper,  ///< printed motifs
  panels,     ///< boards on edge with grooves
  bricks,
  planks,   ///< floor boards with grain and gaps
  tiles,    ///< with grout
  wood,     ///< grain without gaps
  weave,    ///< woven, with an ornament: carpets
  fabric,   ///< cloth, checked
  print,    ///< lettering and bar codes: cartons
  spines,   ///< of books
  picture,  ///< what hangs framed on walls
  glyph,    ///< signs of mahjong tiles
  paint,    ///< painted surfaces with dirt and scratches
};

/// A look that can be used under its name.
struct Material {
  Pattern pattern = Pattern::paint;
  double albedo = 0.5;    ///< mean share of light that is thrown back, (0, 1)
  double contrast = 1.0;  ///< of the pattern; 0 makes it plain
  double cell = 0.0;      ///< size of a plank's width, a tile, a motif, ...; 0: usual for the pattern [m]
  int seed = 0;           ///< of the pattern's details
};

/// The materials that every scene knows. A scene's own of the same name take precedence.
const std::map<std::string, Material, std::less<>>& standard_materials();

/// A room: a polygon without self-intersections, walls all around. Between neighbours there is a gap: the
/// thickness of the wall.
struct Room {
  std::string name;
  std::vector<Vec2<double>> corners;  ///< in the world, counter-clockwise; wall i goes from corner i to i + 1
  double height = 2.5;
  std::string floor = "oak";
  std::string walls = "wallpaper";
  std::string ceiling = "white";
  std::map<int, std::string> wall_materials;  ///< of walls that differ from `walls`
  std::string skirting = "white";             ///< empty: none
  double skirting_height = 0.07;
};

/// An opening through the walls between two rooms whose walls run parallel there.
struct Door {
  std::string from, to;                        ///< names of rooms
  Vec2<double> centre = Vec2<double>::Zero();  ///< in the world, about the middle of the wall
  double width = 0.85;
  double height = 2.0;
  double sill = 0.0;        ///< height of a sill across the opening; 0: none
  double sill_ramp = 0.04;  ///< length over which wheels come up at each side of the sill
  std::string material = "white";
};

/// A bright opening in a wall.
struct Window {
  std::string room;
  int wall = 0;        ///< index of the wall
  double along = 1.0;  ///< centre, from the wall's first corner
  double base = 0.9;   ///< height of its lower edge
  double width = 1.2;
  double height = 1.2;
};

/// A framed picture on a wall.
struct Picture {
  std::string room;
  int wall = 0;
  double along = 1.0;   ///< centre, from the wall's first corner
  double centre = 1.3;  ///< height of its centre
  double width = 0.5;
  double height = 0.4;
  int seed = 0;
};

/// What can stand or lie in a room.
enum class ObjectKind {
  box,
  cylinder,
  table,
  chair,
  shelf,  ///< with books
  cabinet,
  sofa,
  bed,
  radiator,
  plant,
  lamp,
  bin,
  carton,  ///< a printed box
  carpet,
  shuttlecock,
  mahjong,
  cable,
  pet_waste,
  shoe,
  ball,
};

/// The name of a kind in files.
std::string_view to_string(ObjectKind kind);
std::optional<ObjectKind> object_kind(std::string_view name);
/// The size that a kind has where none is given.
Vec3<double> usual_size(ObjectKind kind);
/// The label of a kind's pixels. A carton, box or cylinder lower and narrower than 0.3 m is `small`.
SceneLabel label_of(ObjectKind kind, const Vec3<double>& size);

/// A thing in the flat.
struct SceneObject {
  ObjectKind kind = ObjectKind::box;
  std::string name;                            ///< free; empty: its kind
  Vec2<double> centre = Vec2<double>::Zero();  ///< of its bounding box, in the world
  double yaw = 0.0;  ///< of its own x axis; the front of furniture looks along -y of its own
  Vec3<double> size = Vec3<double>::Zero();  ///< along its own axes; zero: usual_size
  double base = 0.0;                         ///< height of its underside
  double ramp = 0.03;                        ///< carpet: length over which wheels come up at its edges
  std::string material;                      ///< empty: usual for its kind
  std::vector<Vec2<double>> path;            ///< cable: where it lies, from `centre`, along its own axes
  int seed = 0;
};

/// A lamp: irradiance at the distance r, facing it, is power / r^2.
struct Light {
  Vec3<double> position = Vec3<double>::Zero();
  double power = 2.0;
  double radius = 0.1;  ///< of the lamp: softens shadows
};

/// Daylight: the sun as a parallel beam that comes in by windows, and the sky seen through them.
struct Daylight {
  double azimuth = 0.0;    ///< direction to the sun, counter-clockwise from x of the world
  double elevation = 0.6;  ///< above the horizon
  double sun = 0.0;        ///< irradiance facing the sun; 0: overcast
  double sky = 1.0;        ///< brightness of windows
};

/// A flat. Free of invariants until check() has passed.
struct Scene {
  std::string name = "flat";
  double yaw = 0.0;                            ///< of the frame that a scene file is written in
  Vec2<double> origin = Vec2<double>::Zero();  ///< the origin of that frame in the world
  std::vector<Room> rooms;
  std::vector<Door> doors;
  std::vector<Window> windows;
  std::vector<Picture> pictures;
  std::vector<SceneObject> objects;
  std::vector<Light> lights;
  Daylight daylight;
  std::map<std::string, Material, std::less<>> materials;

  /// A point of the file's frame in the world.
  Vec2<double> to_world(const Vec2<double>& p_file) const;
  Vec2<double> from_world(const Vec2<double>& p_world) const;

  const Room* find_room(std::string_view name) const;  ///< null if there is none
  const Material* find_material(std::string_view name) const;

  /// The direction of a room's walls in the world, in [0, 90) degrees as radians; nullopt where its walls
  /// have no common one (to 1 degree): round rooms, odd angles.
  std::optional<double> main_direction(const Room& room) const;

  /// @throws Error(data) that names what is wrong: rooms that have no area, cross themselves or each other,
  ///   doors between walls that do not face each other, objects that stand in walls, doorways or one another,
  ///   carpets that overlap, unknown rooms and materials, numbers out of their range. @param place stands
  ///   before it in the message: the file
  void check(const std::string& place = {}) const;
};

/// The passage of a door: a rectangle between the walls of its two rooms.
struct DoorPassage {
  Vec2<double> centre;  ///< in the world
  double yaw = 0.0;     ///< of its x axis, which leads from `from` to `to`
  double depth = 0.0;   ///< along x: thickness of the wall
  double width = 0.0;   ///< along y
  int from_wall = 0, to_wall = 0;
};

/// @throws Error(data) if the door lies in no wall of its rooms or these do not run parallel
DoorPassage door_passage(const Scene& scene, const Door& door);

/// An object as truth files have it.
struct ObjectTruth {
  std::string object_class;  ///< furniture, carpet, shuttlecock, cable, mahjong, pet_waste, small, radiator
  std::string name;
  SceneLabel label = SceneLabel::furniture;
  Vec3<double> centre;  ///< of its bounding box, in the world
  Vec3<double> size;    ///< along its own axes
  double yaw = 0.0;
};

/// All objects with the bounding boxes of what is drawn.
std::vector<ObjectTruth> object_truth(const Scene& scene);

}  // namespace sweepkit
