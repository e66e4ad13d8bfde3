// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/core/options.hpp"

#include <catch2/catch.hpp>

#include "core/sample_options.hpp"

using namespace sweepkit;

TEST_CASE(
    "options are listed in the order of their declaration, with paths, defaults and pointers into the "
    "struct") {
  SampleOptions options;
  options.count = 7;
  options.inner.kind = SampleKind::slow;
  const OptionList list = list_options(options);
  std::vector<std::string> paths;
  for (const auto& option : list) paths.push_back(option.path);
  CHECK(paths == std::vector<std::string>{"count", "share", "verbose", "name", "weights", "inner.gain",
                                          "inner.kind", "inner.deep.step", "last"});
  CHECK(list.groups.size() == 2);
  CHECK(list.groups[1].path == "inner.deep");

  const OptionRef& count = *list.find("count");
  CHECK(std::get<int>(count.value()) == 7);
  CHECK(std::get<int>(count.default_value) == 3);
  CHECK(count.unit == "px");
  *std::get<int*>(count.pointer) = 9;
  CHECK(options.count == 9);

  const OptionRef& kind = *list.find("inner.kind");
  CHECK(kind.choices() == std::vector<std::string>{"fast", "slow"});
  CHECK(std::get<std::string>(kind.value()) == "slow");
  CHECK(std::get<std::string>(kind.default_value) == "fast");
  CHECK(std::get<EnumRef>(kind.pointer).set("fast"));
  CHECK(options.inner.kind == SampleKind::fast);
  CHECK_FALSE(std::get<EnumRef>(kind.pointer).set("medium"));
  CHECK(list.find("nothing") == nullptr);
}

TEST_CASE("check_options refuses what is out of range or not finite, and names it") {
  SampleOptions options;
  CHECK_NOTHROW(check_options(options));
  const auto message = [&] {
    try {
      check_options(options);
    } catch (const Error& error) {
      CHECK(error.kind() == ErrorKind::option);
      return std::string(error.what());
    }
    return std::string();
  };
  options.count = 0;
  CHECK(message() == "count: must be in [1, 20] px (got 0)");
  options.count = 20;
  CHECK(message().empty());
  options.share = std::nan("");
  CHECK(message() == "share: must be a finite number (got nan)");
  options.share = std::numeric_limits<double>::infinity();
  CHECK(message() == "share: must be a finite number (got inf)");
  options.share = 0.5;
  options.weights = {0.0, -2.0};
  CHECK(message() == "weights: must be at least -1 (got -2)");
  options.weights = {};
  options.inner.kind = static_cast<SampleKind>(7);
  CHECK(message() == "inner.kind: is none of its choices");
  options.inner.kind = SampleKind::slow;
  options.inner.deep.step = std::nan("");
  CHECK(message() == "inner.deep.step: must be a finite number (got nan)");
}
