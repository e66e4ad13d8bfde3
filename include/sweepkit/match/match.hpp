// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>

namespace sweepkit {

/// The key point found for a query or a feature.
struct Match {
  std::int32_t index = -1;    ///< key point; -1 none
  std::int32_t distance = 0;  ///< Hamming distance of the descriptors

  bool found() const { return index >= 0; }
  friend bool operator==(const Match&, const Match&) = default;
};

}  // namespace sweepkit
