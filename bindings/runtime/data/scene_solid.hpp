// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

#include "sweepkit/data/scene.hpp"
#include "sweepkit/geometry/se3.hpp"

namespace sweepkit {

/// A simple body, one of those that objects are made of. Its origin is its centre.
struct Solid {
  enum class Shape {
    box,
    frustum,    ///< along z; half.x is the radius below, half.y above, half.z half its height
    ellipsoid,  ///< half: semi-axes
    slab,       ///< a box whose sides slope inwards by its height: carpets
  };
  Shape shape = Shape::box;
  SE3d T_world_solid;
  Vec3<double> half = Vec3<double>::Zero();
  std::string material;
  unsigned seed = 0;
  SceneLabel label = SceneLabel::furniture;
  int object = -1;  ///< index in the scene; -1: part of a wall
};

/// What an object is made of. `index` is noted in the solids.
std::vector<Solid> object_solids(const SceneObject& object, int index);

/// The height above the floor that a solid spans.
struct HeightSpan {
  double low, high;
};
HeightSpan height_span(const Solid& solid);

/// A solid from above: the rectangle around it along its own axes, or a disc.
struct Footprint {
  Vec2<double> centre;
  Vec2<double> axis;  ///< unit, its x axis
  Vec2<double> half;
  bool disc = false;  ///< of radius half.x
  double low, high;   ///< height
  int object;

  /// Distance of a point from it, negative within.
  double distance(const Vec2<double>& p) const;
  std::vector<Vec2<double>> corners() const;
};
Footprint footprint(const Solid& solid);

/// Whether two footprints overlap by more than `slack`, in plan and in height.
bool overlap(const Footprint& a, const Footprint& b, double slack);

/// Distance of a point from a closed polygon's edge, negative within.
double polygon_distance(const std::vector<Vec2<double>>& corners, const Vec2<double>& p);
/// Distance of a point from a line segment.
double segment_distance(const Vec2<double>& a, const Vec2<double>& b, const Vec2<double>& p);
/// Twice the area, positive if counter-clockwise.
double twice_area(const std::vector<Vec2<double>>& corners);

}  // namespace sweepkit
