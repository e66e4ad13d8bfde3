// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <embree3/rtcore.h>

#include <cstdint>

#include "scene_surface.hpp"

namespace sweepkit {

/// Finds what rays hit first, by Embree. Built by one thread, so that it is the same each time; any number of
/// threads may cast rays. Eight rays go together: those of neighbouring samples take the same way.
class RayCaster {
 public:
  static constexpr int kPacket = 8;
  static constexpr std::uint32_t kNone = 0xffffffffu;

  explicit RayCaster(const SurfaceMesh& mesh);
  ~RayCaster();
  RayCaster(const RayCaster&) = delete;
  RayCaster& operator=(const RayCaster&) = delete;

  /// Eight rays; distances are in units of their directions' lengths.
  struct alignas(32) Rays {
    float ox[kPacket], oy[kPacket], oz[kPacket];
    float dx[kPacket], dy[kPacket], dz[kPacket];
    float far[kPacket];               ///< in: how far to look; intersect: the distance of what is hit
    std::uint32_t triangle[kPacket];  ///< intersect: what is hit, or kNone
    int valid[kPacket] = {};          ///< -1: cast it, 0: leave it out
    float near = 0.0f;
  };

  /// @param coherent whether the rays go much the same way
  void intersect(Rays& rays, bool coherent) const;
  /// Sets `far` below zero for rays that meet something that casts a shadow.
  void occlude(Rays& rays, bool coherent) const;

 private:
  RTCDevice device_ = nullptr;
  RTCScene scene_ = nullptr;
};

}  // namespace sweepkit
