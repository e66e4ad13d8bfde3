// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "sweepkit/core/options.hpp"
#include "sweepkit/data/scene.hpp"

namespace sweepkit {

/// What a generated flat is like.
struct FlatOptions {
  int seed = 1;
  int rooms = 2;
  double room_min = 3.4;
  double room_max = 4.8;
  double furniture = 1.0;
  double clutter = 1.0;
  int carpets = 2;
  double odd_angles = 0.1;
  double sill = 0.0;
  bool bare_walls = false;
  double sun = 0.0;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(seed, "seed", "", range(0, 2147483647), "all chance comes from it");
    v(rooms, "rooms", "", range(1, 6), "how many, in a row, with doors between");
    v(room_min, "room_min", "m", range(2.5, 10), "shortest side of a room");
    v(room_max, "room_max", "m", range(2.5, 12), "longest side of a room");
    v(furniture, "furniture", "", range(0, 2), "how much stands along the walls; 0 for none");
    v(clutter, "clutter", "", range(0, 5), "how much lies about on the floor; 0 for nothing");
    v(carpets, "carpets", "", range(0, 6), "how many, at most one a room");
    v(odd_angles, "odd_angles", "", range(0, 1), "share of furniture that stands at odd angles");
    v(sill, "sill", "m", range(0, 0.02), "height of sills in the doors; 0 for none");
    v(bare_walls, "bare_walls", "", any_value(), "plain walls without pictures");
    v(sun, "sun", "", range(0, 20), "irradiance of sunlight through the windows; 0 for an overcast day");
  }
};

/// A flat from a seed: rooms in a row, furniture along the walls, things on the floor, lamps, windows. Passes
/// check(); each room and door can be reached by a robot of 0.18 m radius. The same on every machine.
/// @throws Error(argument) if room_min exceeds room_max
Scene generate_flat(const FlatOptions& options = {});

}  // namespace sweepkit
