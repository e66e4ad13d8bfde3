// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/core/option_text.hpp"

#include <catch2/catch.hpp>
#include <fstream>
#include <nlohmann/json.hpp>

#include "core/sample_options.hpp"
#include "sweepkit/core/random.hpp"

using namespace sweepkit;

namespace {

/// What reading the text complains of; empty if nothing. The options that were read are checked to be legal.
std::string complaint(const std::string& yaml) {
  SampleOptions options;
  std::string message;
  try {
    parse_yaml_options(list_options(options), yaml, "f.yaml");
  } catch (const Error& error) {
    CHECK(error.kind() == ErrorKind::option);
    message = error.what();
  }
  CHECK_NOTHROW(check_options(options));
  return message;
}

std::string set_complaint(const std::string& assignment) {
  SampleOptions options;
  try {
    set_option(list_options(options), assignment, "--set");
  } catch (const Error& error) {
    CHECK(error.kind() == ErrorKind::option);
    return error.what();
  }
  return {};
}

void check_equal(const SampleOptions& a, const SampleOptions& b) {
  CHECK(a.count == b.count);
  CHECK(a.share == b.share);
  CHECK(a.verbose == b.verbose);
  CHECK(a.name == b.name);
  CHECK(a.weights == b.weights);
  CHECK(a.inner.gain == b.inner.gain);
  CHECK(a.inner.kind == b.inner.kind);
  CHECK(a.inner.deep.step == b.inner.deep.step);
  CHECK(a.last == b.last);
}

}  // namespace

TEST_CASE("a dumped configuration reads back as the same values, bit for bit") {
  Random random(5);
  for (int trial = 0; trial < 50; ++trial) {
    SampleOptions options, back;
    options.count = 1 + static_cast<int>(random.index(20));
    options.share = random.uniform();
    options.verbose = random.index(2) == 1;
    options.name = trial == 0 ? "" : std::string("true: ~ \\ \"x\"\t#") + std::to_string(trial) + "\n";
    options.weights.assign(random.index(4), 0.0);
    for (double& weight : options.weights) weight = std::exp(100 * random.normal());
    options.inner.gain = random.uniform(0, 10);
    options.inner.kind = random.index(2) ? SampleKind::fast : SampleKind::slow;
    options.inner.deep.step = random.normal() * std::exp(200 * random.normal());
    options.last = static_cast<int>(random());
    parse_yaml_options(list_options(back), options_to_yaml(list_options(options)), "dump");
    check_equal(options, back);
  }
}

TEST_CASE("a dump explains every key") {
  SampleOptions options;
  const std::string yaml = options_to_yaml(list_options(options));
  CHECK(yaml.find("# how many (whole number; px; [1, 20]; default 3)\ncount: 3\n") != std::string::npos);
  CHECK(yaml.find("# a group\ninner:\n") != std::string::npos);
  CHECK(yaml.find("  # which way (fast, slow; default fast)\n  kind: fast\n") != std::string::npos);
  CHECK(yaml.find("    step: 0.001\n") != std::string::npos);
}

TEST_CASE("a file sets what it names and leaves the rest") {
  SampleOptions options;
  options.last = 11;
  parse_yaml_options(list_options(options),
                     "%YAML 1.2\n---\ncount: 5 # five\nverbose: 1\nname: no quotes\nweights: [1, 2.5e0]\n"
                     "inner:\n  kind: slow\n  deep: {step: 4}\n",
                     "f");
  CHECK(options.count == 5);
  CHECK(options.verbose);
  CHECK(options.name == "no quotes");
  CHECK(options.weights == std::vector<double>{1, 2.5});
  CHECK(options.inner.kind == SampleKind::slow);
  CHECK(options.inner.deep.step == 4);
  CHECK(options.inner.gain == 2.5);
  CHECK(options.last == 11);
  CHECK_NOTHROW(parse_yaml_options(list_options(options), "", "f"));
  CHECK_NOTHROW(parse_yaml_options(list_options(options), "# nothing but a comment\n", "f"));
  CHECK_NOTHROW(parse_yaml_options(list_options(options), "inner:\n", "f"));
}

TEST_CASE("every error of a file names line, path and value") {
  CHECK(complaint("count: 5\n") == "");
  CHECK(complaint("\ncuont: 5\n") == "f.yaml:2: cuont: there is no such option; the nearest is count");
  CHECK(complaint("inner:\n  gian: 5\n") ==
        "f.yaml:2: inner.gian: there is no such option; the nearest is inner.gain");
  CHECK(complaint("step: 5\n") == "f.yaml:1: step: there is no such option; the nearest is inner.deep.step");
  CHECK(complaint("iner: {}\n") == "f.yaml:1: iner: there is no such option; the nearest is inner");
  CHECK(complaint("count: 21\n") == "f.yaml:1: count: must be in [1, 20] px (got 21)");
  CHECK(complaint("count: 99999999999\n") == "f.yaml:1: count: must be in [1, 20] px (got 99999999999)");
  CHECK(complaint("count: 2.5\n") == "f.yaml:1: count: must be a whole number (got 2.5)");
  CHECK(complaint("count: [2]\n") == "f.yaml:1: count: must be a whole number (got [2])");
  CHECK(complaint("count:\n") == "f.yaml:1: count: must be a whole number (got nothing)");
  CHECK(complaint("share: .nan\n") == "f.yaml:1: share: must be a finite number (got .nan)");
  CHECK(complaint("share: nan\n") == "f.yaml:1: share: must be a finite number (got nan)");
  CHECK(complaint("share: -.inf\n") == "f.yaml:1: share: must be a finite number (got -.inf)");
  CHECK(complaint("share: 1e999\n") == "f.yaml:1: share: must be a finite number (got 1e999)");
  CHECK(complaint("share: 1.5\n") == "f.yaml:1: share: must be in [0, 1] (got 1.5)");
  CHECK(complaint("verbose: maybe\n") == "f.yaml:1: verbose: must be true or false (got maybe)");
  CHECK(complaint("weights: 1\n") == "f.yaml:1: weights: must be a list of finite numbers, [1, 2] (got 1)");
  CHECK(complaint("weights: [1, inf]\n") ==
        "f.yaml:1: weights: must be a list of finite numbers, [1, 2] (got [1, inf])");
  CHECK(complaint("inner: 5\n") ==
        "f.yaml:1: inner: is a group of options: keys are expected below it (got 5)");
  CHECK(complaint("inner: {kind: medium}\n") ==
        "f.yaml:1: inner.kind: must be one of fast, slow (got medium)");
  CHECK(complaint("count: 1\ncount: 2\n") == "f.yaml:2: count: stands twice in the file");
  CHECK(complaint("- 1\n") == "f.yaml: must hold keys and values, key: value");
  CHECK(complaint("a: [1\n").find("f.yaml:2: is no YAML") == 0);
}

TEST_CASE("a value that is refused changes nothing") {
  SampleOptions options;
  CHECK_THROWS_AS(set_option(list_options(options), "weights=[5, nan]"), Error);
  CHECK(options.weights == std::vector<double>{1.0, 0.1});
  CHECK_THROWS_AS(set_option(list_options(options), "count=50"), Error);
  CHECK(options.count == 3);
}

TEST_CASE("options are set from the command line") {
  SampleOptions options;
  const OptionList list = list_options(options);
  set_option(list, "inner.deep.step=-0.5");
  set_option(list, "name=~: # = {");
  set_option(list, "weights=[3]");
  set_option(list, "inner.kind=slow");
  CHECK(options.inner.deep.step == -0.5);
  CHECK(options.name == "~: # = {");
  CHECK(options.weights == std::vector<double>{3});
  CHECK(options.inner.kind == SampleKind::slow);
  CHECK(set_complaint("count") == "--set: must have the form path.to.key=value (got count)");
  CHECK(set_complaint("=3") == "--set: must have the form path.to.key=value (got =3)");
  CHECK(set_complaint("inner.gein=3") ==
        "--set: inner.gein: there is no such option; the nearest is inner.gain");
  CHECK(set_complaint("inner=3") == "--set: inner: there is no such option; the nearest is inner");
  CHECK(set_complaint("count=") == "--set: count: must be a whole number (got \"\")");
  CHECK(set_complaint("weights=[1") == "--set: weights: must be a list of finite numbers, [1, 2] (got [1)");
}

TEST_CASE("options become JSON, help and a page") {
  SampleOptions options;
  const OptionList list = list_options(options);
  const auto json = nlohmann::json::parse(options_to_json(list));
  CHECK(json["count"] == 3);
  CHECK(json["inner"]["kind"] == "fast");
  CHECK(json["inner"]["deep"]["step"] == 0.001);
  CHECK(json["weights"] == nlohmann::json({1.0, 0.1}));
  const std::string help = options_help(list), page = options_to_markdown(list, "Options");
  for (const auto& option : list) {
    CHECK(help.find(option.path) != std::string::npos);
    CHECK(help.find(option.doc) != std::string::npos);
    CHECK(page.find("`" + option.path + "`") != std::string::npos);
  }
  CHECK(page.find("## inner.deep") != std::string::npos);
  CHECK(page.find("| `count` | `3` | px | whole number [1, 20] | how many |") != std::string::npos);
}

TEST_CASE("a configuration that cannot be read is told from one that is wrong") {
  SampleOptions options;
  try {
    read_yaml_options(list_options(options), "/nowhere/x.yaml");
    FAIL("no error");
  } catch (const Error& error) {
    CHECK(error.kind() == ErrorKind::io);
    CHECK(error.place() == "/nowhere/x.yaml");
  }
}
