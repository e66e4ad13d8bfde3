// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <compare>
#include <cstdint>
#include <functional>
#include <limits>

namespace sweepkit {

/// An index that cannot be mistaken for another kind of index. A default one names nothing.
template <class Tag>
struct Id {
  static constexpr std::uint32_t kNone = std::numeric_limits<std::uint32_t>::max();

  std::uint32_t value = kNone;

  constexpr bool valid() const { return value != kNone; }
  friend constexpr auto operator<=>(Id, Id) = default;
};

using KeyframeId = Id<struct KeyframeTag>;
using PointId = Id<struct PointTag>;
using MapId = Id<struct MapTag>;

}  // namespace sweepkit

template <class Tag>
struct std::hash<sweepkit::Id<Tag>> {
  std::size_t operator()(sweepkit::Id<Tag> id) const noexcept { return std::hash<std::uint32_t>()(id.value); }
};
