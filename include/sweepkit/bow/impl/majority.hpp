// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "sweepkit/feature/descriptor.hpp"

namespace sweepkit::impl {

/// Counts, for each bit, the descriptors that have it set, all bits at once: counts lie bit by bit in planes
/// (carry-save adders, as Harley and Seal count bits), so that a descriptor costs about five operations a
/// word. Counts up to 2^31 - 1 descriptors.
template <int Bits>
class MajorityCounter {
  static constexpr int kWords = BinaryDescriptor<Bits>::kWords;
  static constexpr int kPlanes = 32;
  using Plane = std::array<std::uint64_t, kWords>;

 public:
  MajorityCounter() { clear(); }

  void clear() {
    count_ = 0;
    planes_ = 0;
    waits_ = 0;
  }

  void add(const BinaryDescriptor<Bits>& descriptor) {
    Plane in = descriptor.words;
    ++count_;
    // On each plane every second one waits; two together with the sum so far make a new sum and a carry.
    for (int p = 0;; ++p) {
      if (p == planes_) {
        sum_[p].fill(0);
        ++planes_;
      }
      const std::uint32_t bit = std::uint32_t{1} << p;
      if (!(waits_ & bit)) {
        waits_ |= bit;
        waiting_[p] = in;
        return;
      }
      waits_ ^= bit;
      for (int w = 0; w < kWords; ++w) {
        const std::uint64_t a = sum_[p][w], b = waiting_[p][w], c = in[w], half = a ^ b;
        sum_[p][w] = half ^ c;
        in[w] = (a & b) | (half & c);
      }
    }
  }

  std::uint64_t count() const { return count_; }

  /// Bits that more than half of the descriptors have; where it is exactly half, the bit of `tie`.
  BinaryDescriptor<Bits> majority(const BinaryDescriptor<Bits>& tie) const {
    BinaryDescriptor<Bits> result;
    for (int w = 0; w < kWords; ++w) {
      std::array<std::uint64_t, kPlanes + 1> bits;
      std::uint64_t carry = 0;
      for (int p = 0; p < planes_; ++p) {
        const std::uint64_t a = sum_[p][w], b = waits_ >> p & 1 ? waiting_[p][w] : 0, half = a ^ b;
        bits[p] = half ^ carry;
        carry = (a & b) | (half & carry);
      }
      bits[planes_] = carry;
      // 2 * counted against count_, from the highest plane down.
      std::uint64_t more = 0, equal = ~std::uint64_t{0};
      for (int p = planes_ + 1; p >= 0; --p) {
        const std::uint64_t twice = p > 0 ? bits[p - 1] : 0;
        const std::uint64_t limit = count_ >> p & 1 ? ~std::uint64_t{0} : 0;
        more |= equal & twice & ~limit;
        equal &= ~(twice ^ limit);
      }
      result.words[w] = more | (equal & tie.words[w]);
    }
    return result;
  }

 private:
  std::uint64_t count_;
  int planes_;
  std::uint32_t waits_;
  std::array<Plane, kPlanes> sum_, waiting_;
};

}  // namespace sweepkit::impl
