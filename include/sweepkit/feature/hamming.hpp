// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <span>
#include <type_traits>

#include "sweepkit/core/error.hpp"
#include "sweepkit/core/simd.hpp"
#include "sweepkit/feature/descriptor.hpp"
#include "sweepkit/feature/impl/hamming_rows.hpp"

namespace sweepkit {

/// distances[i] = number of bits in which `query` and candidates[i] differ.
template <int Bits>
void hamming_distances(const BinaryDescriptor<Bits>& query,
                       std::type_identity_t<std::span<const BinaryDescriptor<Bits>>> candidates,
                       std::span<std::uint16_t> distances) {
  require(distances.size() >= candidates.size(), "hamming_distances",
          "room for fewer distances than candidates", distances.size());
  impl::hamming_row(query, candidates.data(), candidates.size(), distances.data());
}

/// The same for the candidates with the given indices into `descriptors`: distances[i] belongs to indices[i].
template <int Bits>
void hamming_distances(const BinaryDescriptor<Bits>& query,
                       std::type_identity_t<std::span<const BinaryDescriptor<Bits>>> descriptors,
                       std::span<const std::int32_t> indices, std::span<std::uint16_t> distances) {
  require(distances.size() >= indices.size(), "hamming_distances", "room for fewer distances than indices",
          distances.size());
  impl::hamming_listed(query, descriptors.data(), indices.data(), indices.size(), distances.data());
}

/// All distances between two sets: row i, column j of the row-major matrix is that of queries[i] and
/// candidates[j].
template <int Bits>
void hamming_distance_matrix(std::span<const BinaryDescriptor<Bits>> queries,
                             std::type_identity_t<std::span<const BinaryDescriptor<Bits>>> candidates,
                             std::span<std::uint16_t> distances) {
  require(distances.size() >= queries.size() * candidates.size(), "hamming_distance_matrix",
          "the matrix has too little room", distances.size());
  // A block of candidates stays in the first-level cache while all queries pass.
  constexpr std::size_t kBlock = 16384 / sizeof(BinaryDescriptor<Bits>);
  for (std::size_t from = 0; from < candidates.size(); from += kBlock) {
    const std::size_t count = std::min(kBlock, candidates.size() - from);
    for (std::size_t i = 0; i < queries.size(); ++i)
      impl::hamming_row(queries[i], candidates.data() + from, count,
                        distances.data() + i * candidates.size() + from);
  }
}

}  // namespace sweepkit
