// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <limits>
#include <string>
#include <vector>

#include "sweepkit/core/options.hpp"

namespace sweepkit {

enum class SampleKind { fast, slow };

struct DeepOptions {
  double step = 1e-3;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(step, "step", "m", any_value(), "a number without a range");
  }
};

struct InnerOptions {
  double gain = 2.5;
  SampleKind kind = SampleKind::fast;
  DeepOptions deep;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(gain, "gain", "", range(0, 10), "how much");
    v.choice(kind, "kind", {{SampleKind::fast, "fast"}, {SampleKind::slow, "slow"}}, "which way");
    v.group(deep, "deep", "a group in a group");
  }
};

/// An option of each kind.
struct SampleOptions {
  int count = 3;
  double share = 0.25;
  bool verbose = false;
  std::string name = "a \"name\": #1";
  std::vector<double> weights = {1.0, 0.1};
  InnerOptions inner;
  int last = -4;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(count, "count", "px", range(1, 20), "how many");
    v(share, "share", "", range(0, 1), "part of all");
    v(verbose, "verbose", "", any_value(), "say more");
    v(name, "name", "", any_value(), "a text");
    v(weights, "weights", "", range(-1, std::numeric_limits<double>::infinity()), "a list");
    v.group(inner, "inner", "a group");
    v(last, "last", "", any_value(), "after the group");
  }
};

}  // namespace sweepkit
