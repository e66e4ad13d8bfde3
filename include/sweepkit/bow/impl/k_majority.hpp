// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <span>
#include <utility>
#include <vector>

#include "sweepkit/bow/impl/majority.hpp"
#include "sweepkit/bow/impl/nearest_child.hpp"
#include "sweepkit/core/parallel.hpp"
#include "sweepkit/core/random.hpp"
#include "sweepkit/feature/hamming.hpp"

namespace sweepkit::impl {

/// Clusters binary descriptors about centres whose bits are those of the majority (k-majority, Grana et al.
/// 2013), which is k-means where bits are coordinates. Seeding is greedy k-means++ (Arthur and Vassilvitskii
/// 2007): each new centre is the best of a few drawn with probability proportional to the distance to the
/// centres so far. Keeps its buffers. The result does not depend on the number of threads.
template <int Bits>
class KMajority {
 public:
  using Descriptor = BinaryDescriptor<Bits>;

  struct Options {
    int clusters;
    int iterations;
    int candidates;
    int threads;
  };

  /// Leaves at most `clusters` centres, none without members and no two alike, and for each descriptor the
  /// nearest one (of equally near ones the first).
  void run(std::span<const Descriptor> descriptors, const Options& options, Random& random) {
    descriptors_ = descriptors;
    // Threads pay for large inputs alone.
    threads_ = descriptors.size() >= 8192 ? options.threads : 1;
    labels_.assign(descriptors.size(), 0);
    distances_.resize(descriptors.size());
    seed(options, random);
    std::uint64_t error = assign();
    for (int i = 0; i < options.iterations && centres_.size() > 1; ++i) {
      sort_members();
      if (!move_centres()) break;
      const std::uint64_t before = error;
      error = assign();
      // Neither step makes it larger: without gain it has settled.
      if (error == before) break;
    }
    drop_empty();
  }

  std::span<const Descriptor> centres() const { return centres_; }
  std::span<const std::uint16_t> labels() const { return labels_; }

 private:
  static constexpr int kWords = Descriptor::kWords;
  static constexpr std::size_t kBatch = 64;

  /// distances[i] = min(distances[i], distance to the centre); returns their sum.
  std::uint64_t distances_with(const Descriptor& centre, std::span<const std::uint16_t> before,
                               std::vector<std::uint16_t>& after) {
    const std::size_t size = descriptors_.size();
    after.resize(size);
    sums_.assign(static_cast<std::size_t>(thread_count(threads_)), 0);
    parallel_blocks(size, threads_, [&](std::size_t begin, std::size_t end, std::size_t block) {
      hamming_distances<Bits>(centre, descriptors_.subspan(begin, end - begin),
                              std::span(after).subspan(begin, end - begin));
      std::uint64_t sum = 0;
      for (std::size_t i = begin; i < end; ++i) {
        after[i] = std::min(after[i], before[i]);
        sum += after[i];
      }
      sums_[block] = sum;
    });
    std::uint64_t sum = 0;
    for (const std::uint64_t part : sums_) sum += part;
    return sum;
  }

  /// The first descriptor at which the running sum of distances exceeds `target`.
  std::size_t draw(std::uint64_t target) const {
    std::uint64_t sum = 0;
    for (std::size_t i = 0; i < distances_.size(); ++i) {
      sum += distances_[i];
      if (sum > target) return i;
    }
    return distances_.size() - 1;
  }

  void seed(const Options& options, Random& random) {
    centres_.clear();
    centres_.push_back(descriptors_[random.index(descriptors_.size())]);
    distances_.assign(descriptors_.size(), std::numeric_limits<std::uint16_t>::max());
    std::uint64_t sum = distances_with(centres_[0], distances_, best_);
    distances_.swap(best_);
    // Once the sum is 0 there is a centre for each different descriptor.
    while (static_cast<int>(centres_.size()) < options.clusters && sum > 0) {
      std::uint64_t best_sum = std::numeric_limits<std::uint64_t>::max();
      std::size_t best = 0;
      for (int c = 0; c < options.candidates; ++c) {
        const std::size_t candidate = draw(random.index(sum));
        const std::uint64_t with = distances_with(descriptors_[candidate], distances_, trial_);
        if (with >= best_sum) continue;
        best_sum = with;
        best = candidate;
        best_.swap(trial_);
      }
      centres_.push_back(descriptors_[best]);
      distances_.swap(best_);
      sum = best_sum;
    }
  }

  /// Gives each descriptor its nearest centre; returns the sum of distances.
  std::uint64_t assign() {
    const auto count = static_cast<std::uint32_t>(centres_.size());
    planes_.resize(count * static_cast<std::size_t>(kWords));
    for (std::uint32_t c = 0; c < count; ++c)
      for (int w = 0; w < kWords; ++w) planes_[w * std::size_t{count} + c] = centres_[c].words[w];
    sums_.assign(static_cast<std::size_t>(thread_count(threads_)), 0);
    parallel_blocks(descriptors_.size(), threads_,
                    [&](std::size_t begin, std::size_t end, std::size_t block) {
                      std::array<ChildSearch, kBatch> searches;
                      std::uint64_t sum = 0;
                      for (std::size_t from = begin; from < end; from += kBatch) {
                        const std::size_t size = std::min(kBatch, end - from);
                        for (std::size_t i = 0; i < size; ++i)
                          searches[i] = {descriptors_[from + i].words.data(), planes_.data(), count, 0, 0};
                        nearest_children<kWords>(searches.data(), size);
                        for (std::size_t i = 0; i < size; ++i) {
                          labels_[from + i] = static_cast<std::uint16_t>(searches[i].best);
                          distances_[from + i] = static_cast<std::uint16_t>(searches[i].distance);
                          sum += searches[i].distance;
                        }
                      }
                      sums_[block] = sum;
                    });
    std::uint64_t sum = 0;
    for (const std::uint64_t part : sums_) sum += part;
    return sum;
  }

  /// Lists the members of each cluster, ascending.
  void sort_members() {
    begin_.assign(centres_.size() + 1, 0);
    for (const std::uint16_t label : labels_) ++begin_[label + 1u];
    for (std::size_t c = 0; c < centres_.size(); ++c) begin_[c + 1] += begin_[c];
    members_.resize(labels_.size());
    next_.assign(begin_.begin(), begin_.end() - 1);
    for (std::size_t i = 0; i < labels_.size(); ++i)
      members_[next_[labels_[i]]++] = static_cast<std::uint32_t>(i);
  }

  /// Puts each centre amid its members, and one without members where a descriptor is farthest from its own.
  /// False if none moved.
  bool move_centres() {
    moved_.assign(centres_.size(), 0);
    parallel_for(centres_.size(), threads_, [&](std::size_t c) {
      if (begin_[c] == begin_[c + 1]) return;
      MajorityCounter<Bits> counter;
      for (std::uint32_t m = begin_[c]; m < begin_[c + 1]; ++m) counter.add(descriptors_[members_[m]]);
      const Descriptor centre = counter.majority(centres_[c]);
      moved_[c] = !(centre == centres_[c]);
      centres_[c] = centre;
    });
    for (std::size_t c = 0; c < centres_.size(); ++c) {
      if (begin_[c] != begin_[c + 1]) continue;
      const auto farthest = std::max_element(distances_.begin(), distances_.end());
      if (*farthest == 0) continue;
      centres_[c] = descriptors_[static_cast<std::size_t>(farthest - distances_.begin())];
      *farthest = 0;
      moved_[c] = 1;
    }
    return std::find(moved_.begin(), moved_.end(), 1) != moved_.end();
  }

  /// Of two centres alike the second has no members.
  void drop_empty() {
    sort_members();
    std::vector<std::uint16_t> number(centres_.size(), 0);
    std::size_t kept = 0;
    for (std::size_t c = 0; c < centres_.size(); ++c) {
      if (begin_[c] == begin_[c + 1]) continue;
      number[c] = static_cast<std::uint16_t>(kept);
      centres_[kept++] = centres_[c];
    }
    centres_.resize(kept);
    for (std::uint16_t& label : labels_) label = number[label];
  }

  std::span<const Descriptor> descriptors_;
  int threads_ = 1;
  std::vector<Descriptor> centres_;
  std::vector<std::uint16_t> labels_, distances_, best_, trial_;
  std::vector<std::uint64_t> planes_, sums_;
  std::vector<std::uint32_t> begin_, next_, members_;
  std::vector<std::uint8_t> moved_;
};

}  // namespace sweepkit::impl
