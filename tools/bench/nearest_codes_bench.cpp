// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
//
// Hamming search among 10^4 to 10^6 descriptors. They are what OrbExtractor finds (1000 an image, 8 levels)
// on all images below SWEEPKIT_DATA, taken image by image in a shuffled order until there are enough; queries
// are descriptors of the images that follow. So most queries have been seen from nearby, as in a map.
#include <benchmark/benchmark.h>

#include <algorithm>
#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <map>
#include <opencv2/features2d.hpp>
#include <opencv2/flann.hpp>
#include <string>
#include <vector>

#include "sweepkit/core/random.hpp"
#include "sweepkit/data/image_file.hpp"
#include "sweepkit/feature/orb.hpp"
#include "sweepkit/match/nearest_codes.hpp"

using namespace sweepkit;

namespace {

constexpr std::size_t kQueries = 256;

/// Descriptors of images in a fixed random order; as many as were asked for, fewer if there are no more.
const std::vector<OrbDescriptor>& descriptors(std::size_t wanted) {
  static std::vector<std::filesystem::path> files = [] {
    std::vector<std::filesystem::path> all;
    const char* folder = std::getenv("SWEEPKIT_DATA");
    if (folder == nullptr) return all;
    for (const auto& entry : std::filesystem::recursive_directory_iterator(folder)) {
      const std::string name = entry.path().string(), end = entry.path().extension().string();
      const bool is_image = end == ".jpg" || end == ".png";
      const bool is_depth =
          name.find("depth0") != std::string::npos || name.find("disp_") != std::string::npos;
      if (is_image && !is_depth) all.push_back(entry.path());
    }
    std::ranges::sort(all);
    Random(1).shuffle(std::span(all));
    return all;
  }();
  static std::size_t next = 0;
  static std::vector<OrbDescriptor> found;
  OrbExtractor orb;
  Features<256> features;
  for (; found.size() < wanted && next < files.size(); ++next) {
    orb.extract(read_gray(files[next]).view, features);
    found.insert(found.end(), features.descriptors.begin(), features.descriptors.end());
  }
  return found;
}

struct Codes {
  std::vector<OrbDescriptor> stored, queries;
  std::vector<int> nearest;  // distance of each query's nearest

  static const Codes* get(std::size_t count) {
    static std::map<std::size_t, Codes> made;
    if (const auto at = made.find(count); at != made.end()) return &at->second;
    const auto& all = descriptors(count + 2000);
    if (all.size() < count + 2000) return nullptr;
    Codes codes;
    codes.stored.assign(all.begin(), all.begin() + static_cast<std::ptrdiff_t>(count));
    for (std::size_t i = 0; i < kQueries; ++i)
      codes.queries.push_back(all[count + 1000 + i * 1000 / kQueries]);
    NearestCodes<256> search;
    search.insert(codes.stored);
    NeighbourLists lists;
    search.nearest(codes.queries, 1, lists);
    for (std::size_t i = 0; i < kQueries; ++i) codes.nearest.push_back(lists[i][0].distance);
    return &(made[count] = std::move(codes));
  }
};

cv::Mat rows(const std::vector<OrbDescriptor>& codes, std::size_t count) {
  return cv::Mat(static_cast<int>(count), 32, CV_8U, const_cast<OrbDescriptor*>(codes.data()));
}

benchmark::Counter per_query(std::size_t queries) {
  return {static_cast<double>(queries),
          benchmark::Counter::kIsIterationInvariantRate | benchmark::Counter::kInvert};
}

/// The time of a clock cycle [s]: a chain of dependent additions takes one each.
double cycle_time() {
  static const double time = [] {
    double best = 1;
    for (int k = 0; k < 20; ++k) {
      std::uint64_t x = 1;
      constexpr int kSteps = 200000;
      const auto start = std::chrono::steady_clock::now();
      for (int i = 0; i < kSteps; ++i) {
        x += 3;
        benchmark::DoNotOptimize(x);
        asm volatile("" : "+r"(x));
      }
      best = std::min(
          best, std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count() / kSteps);
    }
    return best;
  }();
  return time;
}

/// Vector instructions of a scan for a code whose group does not pass the test, four of them a cycle: counted
/// from the kernels. For each word read a load with exclusive or, a count and an addition for 8 codes
/// (AVX-512) or eight instructions for 4 codes (AVX2), then the least of a group and its comparison.
double bound_of_code(impl::ScanKernel kernel, std::size_t words) {
  const auto w = static_cast<double>(words);
  const double instructions = kernel == impl::ScanKernel::avx512 ? (24 * w - 8 + 8) / 64 : (64 * w + 17) / 32;
  return instructions / 4 * cycle_time();
}

void nearest(benchmark::State& state, CodeSearch how, bool batch) {
  const Codes* codes = Codes::get(static_cast<std::size_t>(state.range(0)));
  if (codes == nullptr) return state.SkipWithError("SWEEPKIT_DATA has too few images");
  NearestCodes<256> search({.search = how});
  search.insert(codes->stored);
  NeighbourLists lists;
  std::vector<Match> matches;
  for (auto _ : state) {
    if (batch)
      search.nearest(codes->queries, 1, lists);
    else
      for (const auto& query : codes->queries) search.nearest(query, 1, matches);
  }
  state.counters["per_query"] = per_query(kQueries);
  state.counters["recall"] = 1;
  state.counters["bytes_a_code"] = static_cast<double>(search.memory()) / static_cast<double>(search.size());
  if (how == CodeSearch::scan && impl::scan_kernel() != impl::ScanKernel::portable) {
    // Each query at the words that its own nearest distance makes it read.
    double bound = 0;
    for (const int distance : codes->nearest)
      bound += bound_of_code(impl::scan_kernel(), impl::words_before_test(distance, 4));
    state.counters["bound_per_query"] = bound / kQueries * static_cast<double>(search.size());
  }
}
BENCHMARK_CAPTURE(nearest, sweepkit, CodeSearch::automatic, true)
    ->Name("match/nearest_codes/sweepkit")
    ->Arg(10000)
    ->Arg(100000)
    ->Arg(1000000)
    ->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(nearest, scan, CodeSearch::scan, true)
    ->Name("match/nearest_codes/sweepkit_scan")
    ->Arg(10000)
    ->Arg(100000)
    ->Arg(1000000)
    ->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(nearest, single, CodeSearch::automatic, false)
    ->Name("match/nearest_codes_single/sweepkit")
    ->Arg(10000)
    ->Arg(100000)
    ->Arg(1000000)
    ->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(nearest, single_scan, CodeSearch::scan, false)
    ->Name("match/nearest_codes_single/sweepkit_scan")
    ->Arg(10000)
    ->Arg(100000)
    ->Arg(1000000)
    ->Unit(benchmark::kMillisecond);

/// One loop with the population count of the processor, code by code.
SWEEPKIT_TARGET_AVX2 int nearest_by_loop(const OrbDescriptor& query,
                                         const std::vector<OrbDescriptor>& codes) {
  int best = 257;
  for (const OrbDescriptor& code : codes) {
    int distance = 0;
    for (int w = 0; w < 4; ++w) distance += static_cast<int>(_mm_popcnt_u64(query.words[w] ^ code.words[w]));
    best = std::min(best, distance);
  }
  return best;
}

void scalar(benchmark::State& state) {
  const Codes* codes = Codes::get(static_cast<std::size_t>(state.range(0)));
  if (codes == nullptr) return state.SkipWithError("SWEEPKIT_DATA has too few images");
  for (auto _ : state)
    for (std::size_t i = 0; i < 32; ++i)
      benchmark::DoNotOptimize(nearest_by_loop(codes->queries[i], codes->stored));
  state.counters["per_query"] = per_query(32);
}
BENCHMARK(scalar)->Name("match/nearest_codes/scalar")->Arg(10000)->Arg(100000)->Unit(benchmark::kMillisecond);

void opencv_bf(benchmark::State& state) {
  const Codes* codes = Codes::get(static_cast<std::size_t>(state.range(0)));
  if (codes == nullptr) return state.SkipWithError("SWEEPKIT_DATA has too few images");
  cv::setNumThreads(1);
  const cv::BFMatcher matcher(cv::NORM_HAMMING);
  const std::size_t queries = state.range(0) > 10000 ? 32 : kQueries;
  std::vector<cv::DMatch> matches;
  for (auto _ : state)
    matcher.match(rows(codes->queries, queries), rows(codes->stored, codes->stored.size()), matches);
  for (std::size_t i = 0; i < queries; ++i)
    if (static_cast<int>(matches[i].distance) != codes->nearest[i]) state.SkipWithError("not the nearest");
  state.counters["per_query"] = per_query(queries);
}
BENCHMARK(opencv_bf)
    ->Name("match/nearest_codes/opencv_bf")
    ->Arg(10000)
    ->Arg(100000)
    ->Unit(benchmark::kMillisecond);

void flann(benchmark::State& state, const cv::flann::IndexParams& parameters, int checks) {
  const Codes* codes = Codes::get(static_cast<std::size_t>(state.range(0)));
  if (codes == nullptr) return state.SkipWithError("SWEEPKIT_DATA has too few images");
  cv::setNumThreads(1);
  cvflann::seed_random(1);
  cv::flann::Index index(rows(codes->stored, codes->stored.size()), parameters, cvflann::FLANN_DIST_HAMMING);
  cv::Mat found, distances;
  for (auto _ : state)
    index.knnSearch(rows(codes->queries, kQueries), found, distances, 1, cv::flann::SearchParams(checks));
  int right = 0;
  for (std::size_t i = 0; i < kQueries; ++i) {
    const int at = found.at<int>(static_cast<int>(i), 0);
    right += at >= 0 && hamming_distance(codes->queries[i], codes->stored[static_cast<std::size_t>(at)]) ==
                            codes->nearest[i];
  }
  state.counters["per_query"] = per_query(kQueries);
  state.counters["recall"] = static_cast<double>(right) / kQueries;
}
BENCHMARK_CAPTURE(flann, lsh, cv::flann::LshIndexParams(12, 20, 1), 32)
    ->Name("match/nearest_codes/flann_lsh")
    ->Arg(100000)
    ->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(flann, lsh_wide, cv::flann::LshIndexParams(12, 20, 2), 32)
    ->Name("match/nearest_codes/flann_lsh_2_probes")
    ->Arg(100000)
    ->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(flann, hierarchical,
                  cv::flann::HierarchicalClusteringIndexParams(32, cvflann::FLANN_CENTERS_RANDOM, 4, 100),
                  2000)
    ->Name("match/nearest_codes/flann_hierarchical")
    ->Arg(100000)
    ->Unit(benchmark::kMillisecond);

void within(benchmark::State& state, CodeSearch how, bool batch) {
  const Codes* codes = Codes::get(static_cast<std::size_t>(state.range(0)));
  if (codes == nullptr) return state.SkipWithError("SWEEPKIT_DATA has too few images");
  const auto radius = static_cast<int>(state.range(1));
  NearestCodes<256> search({.search = how});
  search.insert(codes->stored);
  NeighbourLists lists;
  std::vector<Match> matches;
  std::size_t hits = 0;
  for (auto _ : state) {
    hits = 0;
    if (batch) {
      search.within(codes->queries, radius, lists);
      hits = lists.matches.size();
    } else {
      for (const auto& query : codes->queries) {
        search.within(query, radius, matches);
        hits += matches.size();
      }
    }
  }
  state.counters["per_query"] = per_query(kQueries);
  state.counters["hits_a_query"] = static_cast<double>(hits) / kQueries;
  state.counters["bytes_a_code"] = static_cast<double>(search.memory()) / static_cast<double>(search.size());
}
BENCHMARK_CAPTURE(within, sweepkit, CodeSearch::automatic, true)
    ->Name("match/codes_within/sweepkit")
    ->ArgsProduct({{10000, 100000, 1000000}, {5, 10, 20, 30, 50}});
BENCHMARK_CAPTURE(within, scan, CodeSearch::scan, true)
    ->Name("match/codes_within/sweepkit_scan")
    ->ArgsProduct({{10000, 100000, 1000000}, {5, 10, 20, 30, 50}});
BENCHMARK_CAPTURE(within, single, CodeSearch::automatic, false)
    ->Name("match/codes_within_single/sweepkit")
    ->ArgsProduct({{10000, 100000, 1000000}, {10}});

/// Codes one by one, tables built whenever they are due.
void insert(benchmark::State& state) {
  const Codes* codes = Codes::get(static_cast<std::size_t>(state.range(0)));
  if (codes == nullptr) return state.SkipWithError("SWEEPKIT_DATA has too few images");
  for (auto _ : state) {
    NearestCodes<256> search;
    for (const auto& code : codes->stored) search.insert(code);
    benchmark::DoNotOptimize(search.size());
  }
  state.counters["per_code"] = per_query(codes->stored.size());
}
BENCHMARK(insert)
    ->Name("match/codes_insert/sweepkit")
    ->Arg(100000)
    ->Arg(1000000)
    ->Unit(benchmark::kMillisecond);

/// Codes all at once.
void build(benchmark::State& state) {
  const Codes* codes = Codes::get(static_cast<std::size_t>(state.range(0)));
  if (codes == nullptr) return state.SkipWithError("SWEEPKIT_DATA has too few images");
  for (auto _ : state) {
    NearestCodes<256> search;
    search.insert(codes->stored);
    benchmark::DoNotOptimize(search.size());
  }
  state.counters["per_code"] = per_query(codes->stored.size());
}
BENCHMARK(build)
    ->Name("match/codes_build/sweepkit")
    ->Arg(100000)
    ->Arg(1000000)
    ->Unit(benchmark::kMillisecond);

}  // namespace
