// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include <cstdio>

#include "sweepkit/sweepkit.hpp"

int main() {
  const sweepkit::Map map{};
  std::printf("runtime: a new map has %zu points\n", static_cast<std::size_t>(map.point_count()));
  return map.point_count() == 0 ? 0 : 1;
}
