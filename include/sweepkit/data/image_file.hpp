// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>

#include "sweepkit/core/sample.hpp"

namespace sweepkit {

/// Width and height of an image [pixels]; zero where any will do.
struct ImageSize {
  int width = 0;
  int height = 0;

  friend bool operator==(ImageSize, ImageSize) = default;
};

/// Reads an image file as 8-bit grey. JPEG, PNG and binary PGM are decoded here, any other format by OpenCV,
/// which is loaded only then (it brings some 40 MB of libraries). Colour becomes grey by 0.299 R + 0.587 G +
/// 0.114 B (JPEG: its own luminance); transparency is ignored. Memory is taken only after the size has been
/// compared with `expected` and with the length of the file.
/// @throws Error(io) if the file cannot be read; Error(data) if it is no image, truncated, deeper than 8 bits
/// a
///   channel or not of the expected size. Messages name the file.
SharedGray read_gray(const std::filesystem::path& file, ImageSize expected = {});

/// Writes an 8-bit grey PNG. @throws Error(io) if the file cannot be written.
void write_png(const std::filesystem::path& file, GrayView image);

}  // namespace sweepkit
