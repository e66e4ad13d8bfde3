// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <utility>
#include <vector>

namespace sweepkit::impl {

/// Owns values by ids that are given in order and never again. Ids whose values are gone cost next to
/// nothing: they lie in blocks, and a block goes with its last value.
template <class T>
class IdTable {
 public:
  /// The value of an id, or null. Stays where it is until it is erased.
  T* find(std::uint32_t id) const {
    if (id >= end_) return nullptr;
    const std::unique_ptr<Block>& block = blocks_[id / kBlock];
    return block ? block->values[id % kBlock].get() : nullptr;
  }
  /// One past the largest id so far.
  std::uint32_t end() const { return end_; }
  std::size_t living() const { return living_; }

  /// Gives the next id to a value; null stands for one that is gone already.
  void push_back(std::unique_ptr<T> value) {
    if (end_ % kBlock == 0) blocks_.emplace_back();
    if (value) {
      std::unique_ptr<Block>& block = blocks_.back();
      if (!block) block = std::make_unique<Block>();
      block->values[end_ % kBlock] = std::move(value);
      ++block->living;
      ++living_;
    }
    ++end_;
  }
  /// There must be such a value.
  void erase(std::uint32_t id) {
    std::unique_ptr<Block>& block = blocks_[id / kBlock];
    block->values[id % kBlock].reset();
    --living_;
    if (--block->living == 0) block.reset();
  }

  /// Without the values themselves [bytes].
  std::size_t memory_bytes() const {
    std::size_t bytes = blocks_.capacity() * sizeof(blocks_[0]);
    for (const auto& block : blocks_)
      if (block) bytes += sizeof(Block);
    return bytes;
  }

 private:
  static constexpr std::uint32_t kBlock = 256;
  struct Block {
    std::array<std::unique_ptr<T>, kBlock> values;
    std::uint32_t living = 0;
  };

  std::vector<std::unique_ptr<Block>> blocks_;
  std::uint32_t end_ = 0;
  std::size_t living_ = 0;
};

}  // namespace sweepkit::impl
