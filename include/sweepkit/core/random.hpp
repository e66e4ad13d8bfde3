// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <numbers>
#include <span>
#include <utility>

#include "sweepkit/core/error.hpp"

namespace sweepkit {

/// Random numbers from a seed: xoshiro256** of Blackman and Vigna (2018), seeded by splitmix64. The sequence
/// is the same on every machine, unlike that of the distributions of the standard library; normal() goes
/// through log and cos, whose last bit may differ between C libraries. Meets
/// std::uniform_random_bit_generator. Not thread-safe: give each thread its own.
class Random {
 public:
  using result_type = std::uint64_t;

  explicit Random(std::uint64_t seed = 1) {
    for (auto& word : state_) {
      seed += 0x9e3779b97f4a7c15u;
      std::uint64_t z = seed;
      z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
      z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
      word = z ^ (z >> 31);
    }
  }

  static constexpr result_type min() { return 0; }
  static constexpr result_type max() { return ~std::uint64_t{0}; }

  /// 64 random bits.
  result_type operator()() {
    const std::uint64_t result = std::rotl(state_[1] * 5, 7) * 9;
    const std::uint64_t t = state_[1] << 17;
    state_[2] ^= state_[0];
    state_[3] ^= state_[1];
    state_[1] ^= state_[2];
    state_[0] ^= state_[3];
    state_[2] ^= t;
    state_[3] = std::rotl(state_[3], 45);
    return result;
  }

  /// Uniform in [0, 1), a multiple of 2^-53.
  double uniform() { return static_cast<double>((*this)() >> 11) * 0x1.0p-53; }

  /// Uniform in [low, high).
  double uniform(double low, double high) { return low + (high - low) * uniform(); }

  /// Uniform in 0 .. count - 1, without bias; count is at least 1 (else an argument error).
  std::uint64_t index(std::uint64_t count) {
    require(count > 0, "Random::index count", "must be at least 1", count);
    // The lowest values are refused so that the rest is a whole multiple of count.
    const std::uint64_t refused = (0 - count) % count;
    std::uint64_t bits = (*this)();
    while (bits < refused) bits = (*this)();
    return bits % count;
  }

  /// Standard normal (Box and Muller 1958); the second number of each pair is kept for the next call.
  double normal() {
    if (has_spare_) {
      has_spare_ = false;
      return spare_;
    }
    const double radius = std::sqrt(-2.0 * std::log(1.0 - uniform()));
    const double angle = 2.0 * std::numbers::pi * uniform();
    spare_ = radius * std::sin(angle);
    has_spare_ = true;
    return radius * std::cos(angle);
  }

  /// Normal of that mean and standard deviation.
  double normal(double mean, double sigma) { return mean + sigma * normal(); }

  /// Puts values into a uniformly random order (Fisher and Yates).
  template <class T>
  void shuffle(std::span<T> values) {
    for (std::size_t i = values.size(); i > 1; --i) std::swap(values[i - 1], values[index(i)]);
  }

  /// Fills `chosen` with distinct numbers of 0 .. count - 1, every set and order alike (Floyd's method, then
  /// a shuffle). Meant for small samples: time grows with the square of their size. chosen.size() <= count.
  template <class Integer>
  void sample(std::size_t count, std::span<Integer> chosen) {
    require(chosen.size() <= count, "Random::sample chosen", "must not be larger than count", chosen.size());
    for (std::size_t i = 0; i < chosen.size(); ++i) {
      const std::size_t last = count - chosen.size() + i;
      auto value = static_cast<Integer>(index(last + 1));
      for (std::size_t j = 0; j < i; ++j)
        if (chosen[j] == value) {
          value = static_cast<Integer>(last);
          break;
        }
      chosen[i] = value;
    }
    shuffle(chosen);
  }

 private:
  std::uint64_t state_[4];
  double spare_ = 0.0;
  bool has_spare_ = false;
};

}  // namespace sweepkit
