// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <condition_variable>
#include <deque>
#include <exception>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "sweepkit/core/sample.hpp"
#include "sweepkit/data/image_file.hpp"

namespace sweepkit {

/// One image in a list: where it lies and where it is named.
struct ListedImage {
  std::filesystem::path file;  ///< empty: that camera has none at this instant
  std::string place;           ///< "data.csv:17", for errors
};

struct ListedFrame {
  TimeNs t = 0;
  ListedImage left;
  ListedImage right;
};

/// Decodes a list of image pairs in order, ahead of the reader in a thread of its own. At most `capacity`
/// pairs wait.
class ImageQueue {
 public:
  /// @param capacity 0: decoded on demand, no thread
  ImageQueue(std::vector<ListedFrame> frames, ImageSize left_size, ImageSize right_size, int capacity);

  /// Stamp of the frame that pop gives next; nothing at the end. Does not wait.
  std::optional<TimeNs> next_stamp() const;

  /// The next pair; waits for it. @throws Error as read_gray, at the place of the frame that cannot be read;
  /// that frame stays the next one
  StereoImage pop();

 private:
  StereoImage decode(const ListedFrame& frame) const;
  void run(std::stop_token stop);

  std::vector<ListedFrame> frames_;
  ImageSize left_size_;
  ImageSize right_size_;
  std::size_t capacity_;
  std::size_t popped_ = 0;

  std::mutex mutex_;
  std::condition_variable_any changed_;
  std::deque<StereoImage> ready_;
  std::exception_ptr failure_;
  std::jthread thread_;  // last: it stops before the rest goes
};

}  // namespace sweepkit
