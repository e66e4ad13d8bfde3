// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include <catch2/catch.hpp>
#include <cstdlib>
#include <new>

#include "feature/scene.hpp"
#include "sweepkit/feature/orb.hpp"
#include "sweepkit/feature/segments.hpp"

namespace {
long allocations = 0;
}

// The whole test binary counts. Sanitizers replace these themselves.
#if !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
void* operator new(std::size_t size) {
  ++allocations;
  if (void* p = std::malloc(size)) return p;
  throw std::bad_alloc();
}
void operator delete(void* p) noexcept { std::free(p); }
void operator delete(void* p, std::size_t) noexcept { std::free(p); }
#endif

using namespace sweepkit;

TEST_CASE("An extractor that has seen an image allocates nothing for the next") {
  const GrayImage first = random_scene(640, 400, 1), second = random_scene(640, 400, 2);
  OrbExtractor extractor;
  Features<256> features;
  extractor.extract(second, features);
  extractor.extract(first, features);
  const long before = allocations;
  extractor.extract(second, features);
  CHECK(allocations == before);
  CHECK(features.size() == 1000);
}

TEST_CASE("A segment detector that has seen an image allocates nothing for the next") {
  const GrayImage first = random_scene(640, 400, 1), second = random_scene(640, 400, 2);
  SegmentDetector detector;
  std::vector<LineSegment> segments;
  detector.detect(second, segments);
  detector.detect(first, segments);
  const long before = allocations;
  detector.detect(second, segments);
  CHECK(allocations == before);
  CHECK(segments.size() > 50);
}
