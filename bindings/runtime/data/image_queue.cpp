// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "image_queue.hpp"

#include "sweepkit/core/error.hpp"

namespace sweepkit {

ImageQueue::ImageQueue(std::vector<ListedFrame> frames, ImageSize left_size, ImageSize right_size,
                       int capacity)
    : frames_(std::move(frames)),
      left_size_(left_size),
      right_size_(right_size),
      capacity_(static_cast<std::size_t>(capacity)) {
  if (capacity_ > 0 && !frames_.empty()) thread_ = std::jthread([this](std::stop_token stop) { run(stop); });
}

std::optional<TimeNs> ImageQueue::next_stamp() const {
  if (popped_ == frames_.size()) return std::nullopt;
  return frames_[popped_].t;
}

StereoImage ImageQueue::decode(const ListedFrame& frame) const {
  const auto read = [](const ListedImage& image, ImageSize size) -> SharedGray {
    if (image.file.empty()) return {};
    try {
      return read_gray(image.file, size);
    } catch (const Error& error) {
      // The list is named too: a recording is repaired there.
      throw Error(error.kind(), image.place, error.what());
    }
  };
  return {frame.t, read(frame.left, left_size_), read(frame.right, right_size_)};
}

void ImageQueue::run(std::stop_token stop) {
  for (const ListedFrame& frame : frames_) {
    {
      std::unique_lock lock(mutex_);
      if (!changed_.wait(lock, stop, [&] { return ready_.size() < capacity_; })) return;
    }
    StereoImage image;
    std::exception_ptr failure;
    try {
      image = decode(frame);
    } catch (...) {
      failure = std::current_exception();
    }
    const std::scoped_lock lock(mutex_);
    if (failure)
      failure_ = failure;
    else
      ready_.push_back(std::move(image));
    changed_.notify_all();
    if (failure) return;
  }
}

StereoImage ImageQueue::pop() {
  if (capacity_ == 0) {
    StereoImage image = decode(frames_.at(popped_));
    ++popped_;
    return image;
  }
  std::unique_lock lock(mutex_);
  changed_.wait(lock, [&] { return !ready_.empty() || failure_; });
  if (ready_.empty()) std::rethrow_exception(failure_);
  StereoImage image = std::move(ready_.front());
  ready_.pop_front();
  ++popped_;
  changed_.notify_all();
  return image;
}

}  // namespace sweepkit
