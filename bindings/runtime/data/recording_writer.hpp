// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "sweepkit/core/view.hpp"

namespace sweepkit {

/// The bytes of an image file. Compression of PNG is the fast kind.
std::vector<std::uint8_t> encode_png(GrayView image);
std::vector<std::uint8_t> encode_png(View2d<const std::uint16_t> image);
/// @param quality 1 .. 100
std::vector<std::uint8_t> encode_jpeg(GrayView image, int quality);

/// A folder that appears under its name when all of it has been written: until then it is NAME.partial, which
/// goes away with this object. Any number of threads may write files into it.
class FolderWriter {
 public:
  /// A folder of that name is replaced at the end if it is empty or has the file `mark`, which only we write.
  /// @throws Error(io) if it has not, or nothing can be written there
  FolderWriter(std::filesystem::path folder, std::string mark);
  ~FolderWriter();
  FolderWriter(const FolderWriter&) = delete;
  FolderWriter& operator=(const FolderWriter&) = delete;

  /// Where files lie for now.
  const std::filesystem::path& path() const { return partial_; }
  void make_folder(const std::filesystem::path& name) const;
  /// @throws Error(io) that says why: a full disk
  void write(const std::filesystem::path& name, std::string_view bytes) const;
  void write(const std::filesystem::path& name, const std::vector<std::uint8_t>& bytes) const;
  /// Gives the folder its name. @throws Error(io)
  void finish();

 private:
  std::filesystem::path folder_, partial_;
  std::string mark_;
  bool finished_ = false;
};

}  // namespace sweepkit
