// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
// Damaged and hostile atlases: each is refused with an Error or comes back as a map that holds all
// invariants, and reading takes no memory on the file's word.
#include <malloc.h>
#include <zlib.h>

#include <catch2/catch.hpp>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <limits>
#include <map>
#include <new>
#include <string>

#include "data/random_atlas.hpp"
#include "sweepkit/core/error.hpp"
#include "sweepkit/data/atlas_file.hpp"

namespace {
thread_local std::ptrdiff_t held = 0, most_held = 0;
}

// The whole test binary counts. Sanitizers replace these themselves.
#if !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
#define SWEEPKIT_COUNTS_MEMORY
void* operator new(std::size_t size) {
  if (void* p = std::malloc(size)) {
    held += static_cast<std::ptrdiff_t>(malloc_usable_size(p));
    most_held = std::max(most_held, held);
    return p;
  }
  throw std::bad_alloc();
}
void operator delete(void* p) noexcept {
  if (p) held -= static_cast<std::ptrdiff_t>(malloc_usable_size(p));
  std::free(p);
}
void operator delete(void* p, std::size_t) noexcept { operator delete(p); }
#endif

using namespace sweepkit;

namespace {

using Bytes = std::vector<std::byte>;
constexpr std::size_t kHeader = 32, kEntry = 40;

template <class T>
T get(const Bytes& bytes, std::size_t at) {
  T value;
  std::memcpy(&value, &bytes[at], sizeof(T));
  return value;
}
template <class T>
void put(Bytes& bytes, std::size_t at, T value) {
  std::memcpy(&bytes[at], &value, sizeof(T));
}
std::uint32_t crc_of(const Bytes& bytes, std::size_t from, std::size_t count) {
  return static_cast<std::uint32_t>(crc32_z(0, reinterpret_cast<const Bytef*>(bytes.data() + from), count));
}

// Makes size and checksums right again, so that what is behind them has to see the damage.
void repair_checks(Bytes& bytes) {
  if (bytes.size() < kHeader) return;
  put<std::uint64_t>(bytes, 16, bytes.size());
  const auto count = get<std::uint32_t>(bytes, 24);
  if (count > 100 || kHeader + count * kEntry > bytes.size()) return;
  for (std::size_t i = 0; i < count; ++i) {
    const std::size_t entry = kHeader + i * kEntry;
    const auto offset = get<std::uint64_t>(bytes, entry + 16), size = get<std::uint64_t>(bytes, entry + 24);
    if (offset > bytes.size() || size > bytes.size() - offset) continue;
    put(bytes, entry + 32, crc_of(bytes, offset, size));
  }
  put(bytes, 28, crc_of(bytes, kHeader, count * kEntry));
}

struct Tally {
  int refused = 0, read = 0;
  std::map<std::string, int> reasons;
};

void check(const Bytes& bytes, Tally& tally) {
  const std::ptrdiff_t before = held;
  most_held = held;
  try {
    const Atlas atlas = decode_atlas(bytes, "fuzzed.swk");
    ++tally.read;
    const auto broken = atlas.map.broken_invariant();
    if (broken) FAIL("a map came back broken: " << *broken);
    for (std::uint32_t i = 0; i < atlas.map.keyframe_id_end(); ++i)
      if (!atlas.map.T_camera_world(KeyframeId{i}).translation().allFinite()) FAIL("a keyframe is nowhere");
  } catch (const Error& error) {
    ++tally.refused;
    if (error.kind() != ErrorKind::data) FAIL("the error is of kind " << to_string(error.kind()));
    if (error.place().rfind("fuzzed.swk", 0) != 0) FAIL("the error names no file: " << error.what());
    std::string reason = error.what();
    reason.resize(std::min(reason.size(), reason.find(" (got")));
    if (const auto byte = reason.find(", byte "); byte != std::string::npos)
      reason.erase(byte, reason.find(':', byte) - byte);
    ++tally.reasons[reason];
  }
#ifdef SWEEPKIT_COUNTS_MEMORY
  if (most_held - before > static_cast<std::ptrdiff_t>(4 * bytes.size() + 1000000))
    FAIL("reading " << bytes.size() << " bytes took " << most_held - before);
#else
  (void)before;
#endif
}

Bytes small_file(std::uint64_t seed) {
  const Map map = random_map(seed);
  return encode_atlas(random_info(seed, map), map);
}

}  // namespace

TEST_CASE("a file cut anywhere is refused") {
  const Bytes whole = small_file(1);
  Tally tally;
  for (std::size_t size = 0; size < whole.size(); ++size) {
    Bytes cut(whole.begin(), whole.begin() + static_cast<std::ptrdiff_t>(size));
    check(cut, tally);
    repair_checks(cut);
    check(cut, tally);
  }
  CHECK(tally.read == 0);
}

TEST_CASE("a flipped bit anywhere is refused") {
  const Bytes whole = small_file(1);
  Tally tally;
  for (std::size_t at = 0; at < whole.size(); ++at) {
    Bytes flipped = whole;
    flipped[at] ^= static_cast<std::byte>(1 << at % 8);
    check(flipped, tally);
  }
  // The four bytes of an entry that mean nothing yet are under the table's CRC as well.
  CHECK(tally.read == 0);
}

TEST_CASE("damage behind right checksums is refused or harmless") {
  const double infinity = std::numeric_limits<double>::infinity();
  Tally tally;
  for (const std::uint64_t seed : {1, 2}) {
    const Bytes whole = small_file(seed);
    Random random(seed);
    for (int round = 0; round < 12000; ++round) {
      Bytes damaged = whole;
      const int wounds = 1 + static_cast<int>(random.index(3));
      for (int w = 0; w < wounds; ++w) {
        const std::size_t at = random.index(damaged.size() - 8);
        const std::uint32_t values[] = {0, 1, 2, 7, 100, 0x7fffffff, 0x80000000, 0xffffffff, 0xfffffffe};
        switch (random.index(8)) {
          case 0:
            damaged[at] ^= static_cast<std::byte>(1 << random.index(8));
            break;
          case 1:
            damaged[at] = static_cast<std::byte>(random());
            break;
          case 2:
          case 3:
            put(damaged, at, values[random.index(std::size(values))]);
            break;
          case 4:
            put(damaged, at, get<std::uint32_t>(damaged, at) + (random.index(2) ? 1 : -1));
            break;
          case 5:
            put(damaged, at, random.index(2) ? infinity : std::nan(""));
            break;
          case 6:  // bytes of another place
            std::memmove(&damaged[at], &damaged[random.index(damaged.size() - 64)],
                         std::min<std::size_t>(damaged.size() - at, 1 + random.index(64)));
            break;
          case 7: {  // a section that is longer or shorter, those behind it moved
            const auto count = get<std::uint32_t>(whole, 24);
            const std::size_t section = random.index(count);
            const auto entry = kHeader + section * kEntry;
            const auto offset = get<std::uint64_t>(damaged, entry + 16),
                       size = get<std::uint64_t>(damaged, entry + 24);
            if (offset > damaged.size() || size > damaged.size() - offset || size < 65) break;
            const auto by = 1 + random.index(64);
            const auto begin =
                damaged.begin() + static_cast<std::ptrdiff_t>(offset + random.index(size - by));
            const bool longer = random.index(2) == 1;
            if (longer)
              damaged.insert(begin, by, static_cast<std::byte>(random.index(3)));
            else
              damaged.erase(begin, begin + static_cast<std::ptrdiff_t>(by));
            put(damaged, entry + 24, longer ? size + by : size - by);
            for (std::size_t later = section + 1; later < count; ++later) {
              const auto place = kHeader + later * kEntry + 16;
              put(damaged, place, get<std::uint64_t>(damaged, place) + (longer ? by : 0 - by));
            }
            break;
          }
        }
      }
      if (random.index(20) > 0) put(damaged, 24, get<std::uint32_t>(whole, 24));
      repair_checks(damaged);
      check(damaged, tally);
    }
  }
  // Both ends are met, and the parser is seen from all sides.
  CHECK(tally.refused > 10000);
  CHECK(tally.read > 500);
  CHECK(tally.reasons.size() > 40);
  if (std::getenv("SWEEPKIT_SHOW_FUZZ"))
    for (const auto& [reason, count] : tally.reasons) WARN(count << "  " << reason);
}

TEST_CASE("counts without bytes behind them take no memory") {
  const Bytes whole = small_file(3);
  Tally tally;
  // Each 32-bit field of all sections in turn claims much.
  for (std::size_t at = kHeader + get<std::uint32_t>(whole, 24) * kEntry; at + 4 <= whole.size(); ++at)
    for (const std::uint32_t claim : {0xffffffffu, 0x10000000u, 100000u}) {
      Bytes greedy = whole;
      put(greedy, at, claim);
      repair_checks(greedy);
      check(greedy, tally);
    }
  CHECK(tally.refused > 1000);
}
