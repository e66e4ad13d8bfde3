// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/floor/grid_file.hpp"

#include <algorithm>
#include <catch2/catch.hpp>
#include <fstream>
#include <sstream>

#include "scratch_folder.hpp"
#include "sweepkit/core/random.hpp"

using namespace sweepkit;

namespace {

OccupancyImage random_map(Random& random, int width, int height) {
  OccupancyImage map;
  map.cell = random.uniform(0.01, 0.2);
  map.origin = {random.uniform(-50, 50), random.uniform(-50, 50)};
  map.cells.resize(width, height);
  constexpr std::uint8_t kValues[] = {OccupancyImage::kFree, OccupancyImage::kOccupied,
                                      OccupancyImage::kUnknown};
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) map.cells(x, y) = kValues[random.index(3)];
  return map;
}

std::string yaml(const std::string& image, const std::string& more = "") {
  return "image: " + image +
         "\nresolution: 0.05\norigin: [-1.0, 2.0, 0.0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: "
         "0.196\n" +
         more;
}

std::string error_of(const std::filesystem::path& file) {
  try {
    read_grid(file);
  } catch (const Error& error) {
    return error.what();
  }
  return "";
}

std::string content(const std::filesystem::path& file) {
  std::ostringstream text;
  text << std::ifstream(file, std::ios::binary).rdbuf();
  return text.str();
}

}  // namespace

TEST_CASE("a grid that is written reads back the same") {
  ScratchFolder folder;
  Random random(9);
  for (const auto& [width, height] : {std::pair{1, 1}, {7, 3}, {130, 65}}) {
    const OccupancyImage map = random_map(random, width, height);
    write_grid(map, folder.path());
    const OccupancyImage back = read_grid(folder / "grid.yaml");
    CHECK(back.cell == map.cell);
    CHECK(back.origin == map.origin);
    REQUIRE(back.cells.width() == width);
    REQUIRE(back.cells.height() == height);
    for (int y = 0; y < height; ++y)
      CHECK(std::equal(map.cells.row(y), map.cells.row(y) + width, back.cells.row(y)));
  }
  write_grid(OccupancyImage(), folder.path(), "empty");
  CHECK(read_grid(folder / "empty.yaml").cells(0, 0) == OccupancyImage::kUnknown);
  CHECK_THROWS_AS(write_grid(OccupancyImage(), folder / "missing"), Error);
}

TEST_CASE("thresholds, negation, comments and plain PGM are read as map_server does") {
  ScratchFolder folder;
  folder.write("a.pgm", "P2\n# a comment\n3 1 # another\n255\n254 205 0\n");
  folder.write("a.yaml", yaml("a.pgm"));
  OccupancyImage map = read_grid(folder / "a.yaml");
  CHECK(map.cells(0, 0) == OccupancyImage::kFree);
  CHECK(map.cells(1, 0) == OccupancyImage::kUnknown);
  CHECK(map.cells(2, 0) == OccupancyImage::kOccupied);
  CHECK(map.origin == Vec2<double>(-1, 2));
  std::string negated = yaml("a.pgm", "mode: trinary\n");
  negated.replace(negated.find("negate: 0"), 9, "negate: 1");
  folder.write("b.yaml", negated);
  map = read_grid(folder / "b.yaml");
  CHECK(map.cells(0, 0) == OccupancyImage::kOccupied);
  CHECK(map.cells(2, 0) == OccupancyImage::kFree);
}

TEST_CASE("files that cannot be are refused by name and place, and take no memory on their word") {
  ScratchFolder folder;
  const auto refused = [&](const std::string& text, const std::string& pgm, const std::string& part) {
    folder.write("m.pgm", pgm);
    const std::string error = error_of(folder.write("m.yaml", text));
    INFO(error);
    CHECK(error.find(part) != std::string::npos);
  };
  const std::string good = "P5\n1 1\n255\nx";
  refused(yaml("m.pgm"), "P5\n30000 30000\n255\nxyz", "size");
  refused(yaml("m.pgm"), "P5\n4000 4000\n255\nxyz", "too short");
  refused(yaml("m.pgm"), "P5\n999999999 999999999\n255\n", "size");
  refused(yaml("m.pgm"), "P5\n0 4\n255\n", "size");
  refused(yaml("m.pgm"), "P5\n2 2\n65535\n12345678", "grey levels");
  refused(yaml("m.pgm"), "P5\n2", "height");
  refused(yaml("m.pgm"), "P2\n2 1\n255\n3 999\n", "above its grey levels");
  refused(yaml("m.pgm"), "GIF89a", "neither PGM nor PNG");
  refused(yaml("m.pgm"), "", "neither PGM nor PNG");
  refused(yaml("m.pgm"), "\x89PNG\r\n\x1a\n rubbish", "PNG");
  refused("just text", good, "must be a map of keys");
  refused("image: m.pgm\n", good, "resolution");
  refused(yaml("m.pgm", "mode: scale\n"), good, "trinary");
  refused("{", good, "no YAML");
  for (const auto& [from, to, part] : {std::tuple{"0.05", "-1", "resolution"},
                                       {"0.05", ".nan", "resolution"},
                                       {"0.05", "[1]", "resolution"},
                                       {"[-1.0, 2.0, 0.0]", "[1, 2]", "origin"},
                                       {"[-1.0, 2.0, 0.0]", "[1, 2, 0.5]", "yaw"},
                                       {"[-1.0, 2.0, 0.0]", "[1e300, 2, 0]", "origin"},
                                       {"negate: 0", "negate: 7", "negate"},
                                       {"0.196", "0.9", "free_thresh"},
                                       {"m.pgm", "other.pgm", "other.pgm"}}) {
    std::string text = yaml("m.pgm");
    text.replace(text.find(from), std::string(from).size(), to);
    refused(text, good, part);
  }
  CHECK(error_of(folder / "missing.yaml").find("missing.yaml") != std::string::npos);
  CHECK_THROWS_AS(read_grid(folder.path()), Error);
}

TEST_CASE("damaged files give an error or a map, nothing else") {
  ScratchFolder folder;
  Random random(21);
  write_grid(random_map(random, 20, 10), folder.path());
  const std::string texts[] = {content(folder / "grid.yaml"), content(folder / "grid.pgm")};
  const char* names[] = {"grid.yaml", "grid.pgm"};
  int read = 0;
  for (int n = 0; n < 400; ++n) {
    const int which = n % 2;
    std::string text = texts[which];
    for (std::uint64_t k = 0; k <= random.index(3); ++k) {
      const std::size_t at = random.index(std::min<std::size_t>(text.size(), which ? 16 : text.size()));
      if (random.uniform() < 0.3)
        text.erase(at, 1 + random.index(4));
      else
        text[at] = static_cast<char>(random.index(256));
      if (text.empty()) text = "P";
    }
    folder.write(names[which], text);
    try {
      read += read_grid(folder / "grid.yaml").cells.width() > 0;
    } catch (const Error& error) {
      CHECK_FALSE(error.place().empty());
    }
    folder.write(names[which], texts[which]);
  }
  CHECK(read > 0);
}
