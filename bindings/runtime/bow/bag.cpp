// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/bow/bag.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <limits>

namespace sweepkit {
namespace {

constexpr std::uint32_t kDigitBits = 11;

std::size_t dense_size(std::uint32_t word_count) { return (std::size_t{word_count} + 15) / 16 * 16; }

/// Divides by the norm that the score wants.
void normalise(std::span<double> weights, BagWeighting weighting, BagScore score) {
  double norm = 0;
  if (score == BagScore::l2) {
    for (const double w : weights) norm += w * w;
    norm = std::sqrt(norm);
  } else if (score == BagScore::dot) {
    if (weighting == BagWeighting::tf || weighting == BagWeighting::tf_idf)
      norm = static_cast<double>(weights.size());
  } else {
    for (const double w : weights) norm += w;
  }
  if (norm > 0)
    for (double& w : weights) w /= norm;
}

}  // namespace

Bag::Bag(std::vector<std::uint32_t> words, std::vector<double> weights, std::uint32_t word_count)
    : words_(std::move(words)), weights_(std::move(weights)) {
  require(words_.size() == weights_.size(), "Bag weights", "must be as many as words", weights_.size());
  for (std::size_t i = 0; i < words_.size(); ++i) {
    require(i == 0 || words_[i - 1] < words_[i], "Bag words", "must ascend without repetition", words_[i]);
    require(words_[i] < word_count, "Bag words", "must be below the number of words", words_[i]);
    require(weights_[i] >= 0 && weights_[i] <= std::numeric_limits<double>::max(), "Bag weights",
            "must be finite and not negative", weights_[i]);
  }
  if (word_count <= kDenseWords) {
    dense_.resize(dense_size(word_count));
    for (std::size_t i = 0; i < words_.size(); ++i) dense_[words_[i]] = weights_[i];
  }
}

void BagMaker::sort(std::span<const std::uint32_t> keys, std::span<const double> weights) {
  order_.resize(keys.size());
  std::size_t size = 0;
  std::uint32_t all = 0;
  for (std::size_t i = 0; i < keys.size(); ++i) {
    order_[size] = std::uint64_t{keys[i]} << 32 | i;
    const bool kept = weights[i] > 0;
    all |= kept ? keys[i] : 0;
    size += kept;
  }
  order_.resize(size);
  other_.resize(size);
  // By digits from the lowest: each pass keeps the order of the one before.
  const auto bits = static_cast<std::uint32_t>(std::bit_width(all));
  const std::uint32_t passes = (bits + kDigitBits - 1) / kDigitBits;
  const std::uint32_t digit_bits = passes > 0 ? (bits + passes - 1) / passes : 1;
  const std::uint64_t mask = (std::uint64_t{1} << digit_bits) - 1;
  for (std::uint32_t pass = 0; pass < passes; ++pass) {
    const std::uint32_t shift = 32 + pass * digit_bits;
    counts_.assign(std::size_t{1} << digit_bits, 0);
    for (const std::uint64_t entry : order_) ++counts_[entry >> shift & mask];
    std::uint32_t begin = 0;
    for (std::uint32_t& count : counts_) {
      const std::uint32_t n = count;
      count = begin;
      begin += n;
    }
    for (const std::uint64_t entry : order_) other_[counts_[entry >> shift & mask]++] = entry;
    order_.swap(other_);
  }
}

void BagMaker::make_bag(std::span<const std::uint32_t> words, std::span<const double> weights,
                        std::uint32_t word_count, BagWeighting weighting, BagScore score, Bag& bag) {
  require(words.size() == weights.size(), "BagMaker::make_bag weights", "must be as many as words",
          weights.size());
  for (std::size_t i = 0; i < words.size(); ++i)
    if (words[i] >= word_count && weights[i] > 0) [[unlikely]]
      require(false, "BagMaker::make_bag words", "must be below the number of words", words[i]);
  const bool once = weighting == BagWeighting::idf || weighting == BagWeighting::binary;
  if (word_count <= Bag::kDenseWords) {
    bag.dense_.assign(dense_size(word_count), 0.0);
    double* dense = bag.dense_.data();
    for (std::size_t i = 0; i < words.size(); ++i)
      if (weights[i] > 0) dense[words[i]] = once ? weights[i] : dense[words[i]] + weights[i];
    bag.words_.resize(word_count);
    bag.weights_.resize(word_count);
    std::size_t size = 0;
    for (std::uint32_t word = 0; word < word_count; ++word) {
      bag.words_[size] = word;
      bag.weights_[size] = dense[word];
      size += dense[word] > 0;
    }
    bag.words_.resize(size);
    bag.weights_.resize(size);
    normalise(bag.weights_, weighting, score);
    for (std::size_t i = 0; i < size; ++i) dense[bag.words_[i]] = bag.weights_[i];
    return;
  }
  sort(words, weights);
  bag.dense_.clear();
  bag.words_.resize(order_.size());
  bag.weights_.resize(order_.size());
  std::size_t size = 0;
  for (const std::uint64_t entry : order_) {
    const auto word = static_cast<std::uint32_t>(entry >> 32);
    const double weight = weights[entry & 0xffffffffu];
    if (size > 0 && bag.words_[size - 1] == word) {
      if (!once) bag.weights_[size - 1] += weight;
      continue;
    }
    bag.words_[size] = word;
    bag.weights_[size] = weight;
    ++size;
  }
  bag.words_.resize(size);
  bag.weights_.resize(size);
  normalise(bag.weights_, weighting, score);
}

void BagMaker::make_index(std::span<const std::uint32_t> nodes, std::span<const double> weights,
                          DirectIndex& index) {
  require(nodes.size() == weights.size(), "BagMaker::make_index weights", "must be as many as nodes",
          weights.size());
  sort(nodes, weights);
  index.clear();
  index.features.reserve(order_.size());
  for (const std::uint64_t entry : order_) {
    const auto node = static_cast<std::uint32_t>(entry >> 32);
    if (index.nodes.empty() || index.nodes.back() != node) {
      index.nodes.push_back(node);
      index.begin.push_back(0);
    }
    index.features.push_back(static_cast<std::uint32_t>(entry));
    index.begin.back() = static_cast<std::uint32_t>(index.features.size());
  }
}

}  // namespace sweepkit
