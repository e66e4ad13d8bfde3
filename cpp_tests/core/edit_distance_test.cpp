// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/core/edit_distance.hpp"

#include <catch2/catch.hpp>

#include "sweepkit/core/random.hpp"

using namespace sweepkit;

namespace {

// By its definition: the first letters are the same, or one is inserted, removed or replaced.
std::size_t slow(std::string_view a, std::string_view b) {
  if (a.empty() || b.empty()) return a.size() + b.size();
  if (a.front() == b.front()) return slow(a.substr(1), b.substr(1));
  return 1 + std::min({slow(a.substr(1), b), slow(a, b.substr(1)), slow(a.substr(1), b.substr(1))});
}

}  // namespace

TEST_CASE("edit_distance agrees with its definition, is symmetric and keeps the triangle", "[core]") {
  CHECK(edit_distance("kitten", "sitting") == 3);
  Random random(1);
  const auto word = [&] {
    std::string text;
    for (auto n = random.index(7); n > 0; --n) text += static_cast<char>('a' + random.index(3));
    return text;
  };
  for (int i = 0; i < 200; ++i) {
    const std::string a = word(), b = word(), c = word();
    CAPTURE(a, b, c);
    CHECK(edit_distance(a, b) == slow(a, b));
    CHECK(edit_distance(a, b) == edit_distance(b, a));
    CHECK(edit_distance(a, c) <= edit_distance(a, b) + edit_distance(b, c));
  }
}
