// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>
#include <utility>
#include <vector>

namespace sweepkit {

/// A symmetric positive definite matrix of D x D blocks, sparse by blocks: its Cholesky factor H = L L', and
/// those blocks of its inverse that lie where L has blocks. The order of elimination (approximate minimum
/// degree) and the places of all blocks are found once; the values may change as often as one likes.
/// Columns of L are panels, whose rows lie in runs side by side; so kernels work on long columns of doubles.
/// Portable and AVX2 kernels give identical bits. Not thread-safe.
template <int D>
class BlockCholesky {
 public:
  using Block = Eigen::Matrix<double, D, D>;

  /// Where the block of a pair lies.
  struct Slot {
    int index = -1;
    bool transposed = false;  ///< it is the block (j, i) that is kept
  };

  BlockCholesky() = default;
  /// @param size rows of blocks
  /// @param pairs (i, j), i != j, that have a block off the diagonal; in any order, also repeated
  BlockCholesky(int size, const std::vector<std::pair<int, int>>& pairs);

  int size() const { return static_cast<int>(position_.size()); }
  /// Blocks of L below the diagonal.
  std::size_t factor_blocks() const { return rows_.size(); }
  /// Multiplications that a factorisation takes.
  double factor_products() const;

  /// One of the pairs given.
  Slot slot(int i, int j) const;

  void set_zero();
  Block& diagonal(int i) {
    return diagonal_[static_cast<std::size_t>(position_[static_cast<std::size_t>(i)])];
  }
  const Block& diagonal(int i) const {
    return diagonal_[static_cast<std::size_t>(position_[static_cast<std::size_t>(i)])];
  }
  /// The block as it is kept: transpose what is added where the slot says so.
  Block& off_diagonal(const Slot& slot) { return off_diagonal_[static_cast<std::size_t>(slot.index)]; }

  /// Factorises H + damping diag(H). False if that is not positive definite.
  bool factorize(double damping = 0.0);
  /// x = (L L')^-1 x.
  void solve(Eigen::VectorXd& x) const;

  /// Computes the blocks of (L L')^-1 where L has some: Takahashi, Fagan and Chin, Formation of a sparse bus
  /// impedance matrix and its application to short circuit study (1973).
  void invert();
  const Block& inverse(int i) const {
    return inverse_diagonal_[static_cast<std::size_t>(position_[static_cast<std::size_t>(i)])];
  }
  /// The block (i, j) of the inverse for the pair of that slot.
  Block inverse(const Slot& slot) const;

 private:
  /// Rows `from` to `from + count` of a panel as blocks lie from `to` on in the panel of another column.
  struct Run {
    int from, count, to;
  };
  struct Place {
    int column, row;  ///< row: the place among the column's blocks
  };

  int count(int column) const {
    return begin_[static_cast<std::size_t>(column) + 1] - begin_[static_cast<std::size_t>(column)];
  }
  const int* rows(int column) const { return rows_.data() + begin_[static_cast<std::size_t>(column)]; }
  static double* panel(std::vector<double>& values, int begin) {
    return values.data() + static_cast<std::ptrdiff_t>(begin) * D * D;
  }
  static const double* panel(const std::vector<double>& values, int begin) {
    return values.data() + static_cast<std::ptrdiff_t>(begin) * D * D;
  }

  std::vector<int> position_;                   // of a row in the order of elimination
  std::vector<std::pair<int, int>> pairs_;      // (later, earlier) by position, sorted by column
  std::vector<Place> places_;                   // of each pair
  std::vector<Block> diagonal_, off_diagonal_;  // H
  std::vector<int> begin_, rows_;               // the blocks of L by columns
  std::vector<int> run_begin_;                  // for each block of L
  std::vector<Run> runs_;
  std::vector<Block> factor_diagonal_;
  std::vector<double> factor_;  // panels by columns, each column-major
  std::vector<Block> inverse_diagonal_;
  std::vector<double> inverse_;
};

extern template class BlockCholesky<4>;
extern template class BlockCholesky<6>;
extern template class BlockCholesky<7>;

}  // namespace sweepkit
