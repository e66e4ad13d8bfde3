// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "sweepkit/core/ids.hpp"
#include "sweepkit/feature/descriptor.hpp"
#include "sweepkit/map/map.hpp"
#include "sweepkit/map/rig_identity.hpp"

namespace sweepkit {

/// What somebody else keeps with a keyframe; the map does not look into it.
struct KeyframeAttachment {
  KeyframeId keyframe;
  std::vector<std::byte> bytes;
};

/// All that has to be known beside the maps to go on with them in another run.
struct AtlasInfo {
  RigIdentity rig;
  std::string descriptor_type = "orb";
  int descriptor_bits = OrbDescriptor::kBits;
  std::string vocabulary;                 ///< name of the one in use; empty if there was none
  std::uint64_t vocabulary_checksum = 0;  ///< of its content
  double disparity_bias = 0;              ///< taken off the disparities already [px]
  double disparity_bias_sigma = 0;        ///< how well it is known [px]; 0: not told
  /// By map: whether z of its world is up. As many as there are maps; those that lack stand for false.
  std::vector<bool> gravity_known;
  /// By name, of at most one piece for each keyframe, sorted by keyframe.
  std::map<std::string, std::vector<KeyframeAttachment>> attachments;
  std::string software;  ///< version of sweepkit that wrote it; set by writing
};

/// Maps and what a later run needs to go on with them.
struct Atlas {
  AtlasInfo info;
  Map map;
};

}  // namespace sweepkit
