// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
// dense_accuracy [--set path=value ...] FOLDER: dense disparities on rectified pairs with true ones, by
// method. FOLDER holds the Middlebury pairs teddy, cones, art, laundry, reindeer and aloe, each with
// left.png, right.png and disp_left.png (multiples of the disparity, 0: unknown). `found`: part of the pixels
// with a true disparity, and a partner in the right image, that have one; errors and `bad` (off by more than
// 1 and 2 px) are over those.

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <string>
#include <vector>

#include "sweepkit/core/error.hpp"
#include "sweepkit/core/option_text.hpp"
#include "sweepkit/data/image_file.hpp"
#include "sweepkit/image/dense_disparity.hpp"

namespace {

using namespace sweepkit;
namespace fs = std::filesystem;

struct Known {
  const char* name;
  double unit;  // of disp_left.png [1/px]
};
constexpr Known kPairs[] = {{"teddy", 4},   {"cones", 4},    {"art", 3},
                            {"laundry", 3}, {"reindeer", 3}, {"aloe", 2}};

struct Figures {
  std::size_t pixels = 0;
  std::vector<double> errors;

  void print(const std::string& method, const std::string& pair) {
    const double found = static_cast<double>(errors.size());
    const auto beyond = [&](double size) {
      return 100 *
             static_cast<double>(
                 std::count_if(errors.begin(), errors.end(), [&](double e) { return e > size; })) /
             found;
    };
    std::nth_element(errors.begin(), errors.begin() + static_cast<std::ptrdiff_t>(errors.size() / 2),
                     errors.end());
    fmt::print("{:<11}{:<10}{:>9.1f}{:>9.2f}{:>8.1f}{:>8.1f}\n", method, pair,
               100 * found / static_cast<double>(pixels), errors[errors.size() / 2], beyond(1), beyond(2));
  }
};

void run(const std::string& method, const fs::path& folder, const std::vector<std::string>& settings) {
  DisparityOptions options;
  set_option(list_options(options), "method=" + method);
  for (const std::string& setting : settings) set_option(list_options(options), setting);
  DenseMatcher matcher(options);
  Figures all;
  for (const Known& pair : kPairs) {
    const SharedGray left = read_gray(folder / pair.name / "left.png"),
                     right = read_gray(folder / pair.name / "right.png"),
                     truth = read_gray(folder / pair.name / "disp_left.png");
    const DisparityView found = matcher.match(left.view, right.view);
    Figures figures;
    for (int v = 0; v < found.height; ++v)
      for (int u = 0; u < found.width; ++u) {
        const double d = truth.view(u, v) / pair.unit;
        if (d <= 0 || d > u) continue;
        ++figures.pixels;
        if (found(u, v) > 0) figures.errors.push_back(std::abs(found(u, v) / 16.0 - d));
      }
    all.pixels += figures.pixels;
    all.errors.insert(all.errors.end(), figures.errors.begin(), figures.errors.end());
    if (!figures.errors.empty()) figures.print(method, pair.name);
  }
  if (!all.errors.empty()) all.print(method, "all");
}

}  // namespace

int main(int argc, char** argv) {
  try {
    std::vector<std::string> settings;
    std::string folder;
    for (int i = 1; i < argc; ++i) {
      if (std::string(argv[i]) == "--set" && i + 1 < argc)
        settings.emplace_back(argv[++i]);
      else
        folder = argv[i];
    }
    if (folder.empty()) {
      fmt::print(stderr, "usage: dense_accuracy [--set path=value ...] FOLDER\n");
      return 2;
    }
    fmt::print("{:<11}{:<10}{:>9}{:>9}{:>8}{:>8}\n", "", "", "found %", "median", "bad1 %", "bad2 %");
    for (const char* method : {"bm", "sgbm", "sgbm_3way", "sgbm_8way"}) run(method, folder, settings);
  } catch (const Error& error) {
    fmt::print(stderr, "dense_accuracy: {}\n", error.what());
    return error.kind() == ErrorKind::option ? 2 : 3;
  }
}
