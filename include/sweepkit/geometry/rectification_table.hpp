// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>
#include <concepts>
#include <cstdint>
#include <optional>
#include <vector>

#include "sweepkit/geometry/so3.hpp"

namespace sweepkit {

/// A smooth map of an image's pixels to the plane, kept as one cubic polynomial for each cell of 8x8 px:
/// a few cache lines and two dozen multiplications a point instead of an iteration. A cell where the
/// polynomial is not good enough, or where the map is not defined everywhere, says so, and the caller takes
/// the slow way. Immutable after construction.
class RectificationTable {
 public:
  static constexpr int kCellSize = 8;  ///< [px]
  /// The largest error of a cell that is used, at the points it was fitted to [px].
  static constexpr double kMaxError = 5e-4;

  RectificationTable() = default;

  /// @param map std::optional<Vec2<double>>(const Vec2<double>& pixel): the exact map
  template <std::invocable<const Vec2<double>&> Map>
  RectificationTable(int width, int height, const Map& map);

  /// Writes the image of a pixel; false (and nothing written) where the table does not know it.
  bool lookup(float x, float y, Vec2<float>& mapped) const {
    const Cell* cell = find(x, y);
    if (!cell) return false;
    for (int i = 0; i < 2; ++i) {
      const float* c = cell->c[i];
      mapped[i] = (c[0] + y * (c[2] + y * (c[5] + y * c[9]))) +
                  x * ((c[1] + y * (c[4] + y * c[8])) + x * ((c[3] + y * c[7]) + x * c[6]));
    }
    return true;
  }
  /// The same, with the derivative of the mapped point by the pixel.
  bool lookup(float x, float y, Vec2<float>& mapped, Eigen::Matrix2f& J) const {
    if (!lookup(x, y, mapped)) return false;
    const Cell* cell = find(x, y);
    for (int i = 0; i < 2; ++i) {
      const float* c = cell->c[i];
      J(i, 0) = (c[1] + y * (c[4] + y * c[8])) + x * (2 * (c[3] + y * c[7]) + 3 * x * c[6]);
      J(i, 1) = (c[2] + x * (c[4] + x * c[7])) + y * (2 * (c[5] + x * c[8]) + 3 * y * c[9]);
    }
    return true;
  }

  /// Part of the cells that the table answers for, from 0 to 1.
  double coverage() const { return coverage_; }
  std::size_t bytes() const { return cells_.size() * sizeof(Cell); }

 private:
  static constexpr int kTerms = 10;

  // With x, y from the cell's centre, for each coordinate: c0 + c1 x + c2 y + c3 x^2 + c4 x y + c5 y^2 + c6
  // x^3 + c7 x^2 y + c8 x y^2 + c9 y^3.
  struct alignas(32) Cell {
    float c[2][kTerms];
    std::uint32_t usable = 0;
  };

  /// The usable cell of a pixel; x and y become the offsets from its centre.
  const Cell* find(float& x, float& y) const {
    // Cell (0, 0) begins at the image's edge, -0.5.
    const float u = x + 0.5f, v = y + 0.5f;
    if (!(u >= 0 && v >= 0 && u < limit_x_ && v < limit_y_)) return nullptr;
    const int column = static_cast<int>(u) / kCellSize, row = static_cast<int>(v) / kCellSize;
    const Cell& cell = cells_[static_cast<std::size_t>(row) * columns_ + column];
    x = u - (column * kCellSize + 0.5f * kCellSize);
    y = v - (row * kCellSize + 0.5f * kCellSize);
    return cell.usable ? &cell : nullptr;
  }

  int columns_ = 0, rows_ = 0;
  float limit_x_ = 0, limit_y_ = 0;
  double coverage_ = 0;
  std::vector<Cell> cells_;
};

template <std::invocable<const Vec2<double>&> Map>
RectificationTable::RectificationTable(int width, int height, const Map& map)
    : columns_((width + kCellSize - 1) / kCellSize),
      rows_((height + kCellSize - 1) / kCellSize),
      limit_x_(static_cast<float>(width)),
      limit_y_(static_cast<float>(height)),
      cells_(static_cast<std::size_t>(columns_) * rows_) {
  // Samples on a lattice that neighbouring cells share: five by five a cell. The polynomial is their
  // least-squares fit, whose largest error is at the corners and on the edges, which are among them.
  constexpr int kSteps = 4;
  constexpr double kStep = double(kCellSize) / kSteps;
  const int lattice_columns = columns_ * kSteps + 1, lattice_rows = rows_ * kSteps + 1;
  std::vector<std::optional<Vec2<double>>> lattice(static_cast<std::size_t>(lattice_columns) * lattice_rows);
  for (int i = 0; i < lattice_rows; ++i)
    for (int j = 0; j < lattice_columns; ++j)
      lattice[static_cast<std::size_t>(i) * lattice_columns + j] =
          map(Vec2<double>(j * kStep - 0.5, i * kStep - 0.5));

  // The polynomials 1, t, t^2 - 2, t^3 - 3.4 t are orthogonal on t = -2 .. 2, so that each coefficient of the
  // fit in their products is a sum of samples.
  constexpr double kP[4][5] = {
      {1, 1, 1, 1, 1}, {-2, -1, 0, 1, 2}, {2, -1, -2, -1, 2}, {-1.2, 2.4, 0, -2.4, 1.2}};
  constexpr double kNorm[4] = {5, 10, 14, 14.4};

  std::size_t usable = 0;
  for (int row = 0; row < rows_; ++row) {
    for (int column = 0; column < columns_; ++column) {
      Cell& cell = cells_[static_cast<std::size_t>(row) * columns_ + column];
      double samples[2][5][5];
      bool good = true;
      for (int k = 0; k < 25 && good; ++k) {
        const auto& sample = lattice[static_cast<std::size_t>(row * kSteps + k / 5) * lattice_columns +
                                     column * kSteps + k % 5];
        good = sample.has_value();
        for (int i = 0; i < 2 && good; ++i) samples[i][k / 5][k % 5] = (*sample)[i];
      }
      double squared_error[25] = {};
      for (int i = 0; i < 2 && good; ++i) {
        double g[4][4];  // of P_m(x) P_n(y), m + n <= 3
        double rows[4][5];
        for (int m = 0; m < 4; ++m)
          for (int y = 0; y < 5; ++y) {
            double sum = 0;
            for (int x = 0; x < 5; ++x) sum += samples[i][y][x] * kP[m][x];
            rows[m][y] = sum / kNorm[m];
          }
        for (int m = 0; m < 4; ++m)
          for (int n = 0; n < 4; ++n) {
            double sum = 0;
            for (int y = 0; y < 5; ++y) sum += rows[m][y] * kP[n][y];
            g[m][n] = m + n < 4 ? sum / kNorm[n] : 0;
          }
        for (int y = 0; y < 5; ++y) {
          double fitted[4] = {};
          for (int m = 0; m < 4; ++m)
            for (int n = 0; n < 4; ++n) fitted[m] += g[m][n] * kP[n][y];
          for (int x = 0; x < 5; ++x) {
            double error = -samples[i][y][x];
            for (int m = 0; m < 4; ++m) error += fitted[m] * kP[m][x];
            squared_error[y * 5 + x] += error * error;
          }
        }
        // From products of P to powers of the offset in pixels.
        const double s = 1 / kStep, s2 = s * s, s3 = s2 * s;
        const double c[kTerms] = {g[0][0] - 2 * g[2][0] - 2 * g[0][2],
                                  (g[1][0] - 2 * g[1][2] - 3.4 * g[3][0]) * s,
                                  (g[0][1] - 2 * g[2][1] - 3.4 * g[0][3]) * s,
                                  g[2][0] * s2,
                                  g[1][1] * s2,
                                  g[0][2] * s2,
                                  g[3][0] * s3,
                                  g[2][1] * s3,
                                  g[1][2] * s3,
                                  g[0][3] * s3};
        for (int k = 0; k < kTerms; ++k) cell.c[i][k] = static_cast<float>(c[k]);
      }
      for (const double e : squared_error) good = good && e <= kMaxError * kMaxError;
      cell.usable = good;
      usable += good;
    }
  }
  coverage_ = cells_.empty() ? 0 : static_cast<double>(usable) / static_cast<double>(cells_.size());
}

}  // namespace sweepkit
