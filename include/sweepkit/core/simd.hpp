// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstdlib>
#include <string_view>

#if defined(__x86_64__) && defined(__GNUC__)
#include <immintrin.h>
/// Defined where AVX2 kernels can be compiled; whether they run is decided at run time.
#define SWEEPKIT_HAVE_AVX2 1
/// Put before a function that uses AVX2 intrinsics: the rest of the program stays baseline code.
#define SWEEPKIT_TARGET_AVX2 __attribute__((target("avx2,bmi,popcnt")))
#endif

namespace sweepkit {

/// Which kernels run. All give bit-identical results.
enum class SimdLevel { portable, avx2 };

namespace impl {

#ifdef SWEEPKIT_HAVE_AVX2
SWEEPKIT_TARGET_AVX2 inline __m128i load_16(const void* p) {
  return _mm_loadu_si128(static_cast<const __m128i*>(p));
}
SWEEPKIT_TARGET_AVX2 inline __m256i load_32(const void* p) {
  return _mm256_loadu_si256(static_cast<const __m256i*>(p));
}
SWEEPKIT_TARGET_AVX2 inline void store_32(void* p, __m256i v) {
  _mm256_storeu_si256(static_cast<__m256i*>(p), v);
}
#endif

inline SimdLevel detect_simd_level() {
#ifdef SWEEPKIT_HAVE_AVX2
  const bool avx2 =
      __builtin_cpu_supports("avx2") && __builtin_cpu_supports("bmi") && __builtin_cpu_supports("popcnt");
#else
  const bool avx2 = false;
#endif
  if (const char* wish = std::getenv("SWEEPKIT_SIMD"))
    if (std::string_view(wish) == "portable") return SimdLevel::portable;
  return avx2 ? SimdLevel::avx2 : SimdLevel::portable;
}

inline std::atomic<SimdLevel>& simd_level_in_use() {
  static std::atomic<SimdLevel> level{detect_simd_level()};
  return level;
}

}  // namespace impl

/// The best level that this machine has; the environment variable SWEEPKIT_SIMD=portable lowers it (read
/// once).
inline SimdLevel simd_level() { return impl::simd_level_in_use().load(std::memory_order_relaxed); }

/// Lowers the level while it lives, for comparisons in tests and benchmarks. It holds for all threads: do not
/// use it beside running extractors. A level that the machine lacks is not taken.
class ScopedSimdLevel {
 public:
  explicit ScopedSimdLevel(SimdLevel level) : before_(simd_level()) {
    if (level < before_) impl::simd_level_in_use().store(level, std::memory_order_relaxed);
  }
  ~ScopedSimdLevel() { impl::simd_level_in_use().store(before_, std::memory_order_relaxed); }
  ScopedSimdLevel(const ScopedSimdLevel&) = delete;
  ScopedSimdLevel& operator=(const ScopedSimdLevel&) = delete;

 private:
  SimdLevel before_;
};

}  // namespace sweepkit
