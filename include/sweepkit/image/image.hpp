// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <new>
#include <type_traits>
#include <utility>

#include "sweepkit/core/error.hpp"
#include "sweepkit/core/view.hpp"

namespace sweepkit {

/// A rectangle of pixels that owns its memory. Rows start at multiples of 64 bytes. 64 bytes before the first
/// and after the last row are readable, so that vector loads may reach over a row's ends; what they read
/// there is unspecified.
template <class Pixel>
class Image {
  static_assert(std::is_trivially_copyable_v<Pixel> && 64 % sizeof(Pixel) == 0);

 public:
  static constexpr std::size_t kAlignment = 64;  ///< [bytes]

  Image() = default;
  Image(int width, int height) { resize(width, height); }
  explicit Image(View2d<const Pixel> source) { assign(source); }
  Image(const Image& other) { assign(other.view()); }
  Image(Image&& other) noexcept { swap(other); }
  Image& operator=(Image other) noexcept {
    swap(other);
    return *this;
  }

  int width() const { return width_; }
  int height() const { return height_; }
  std::ptrdiff_t stride() const { return stride_; }  ///< from a row to the next [elements]
  bool empty() const { return width_ == 0 || height_ == 0; }

  Pixel* row(int y) { return pixels() + y * stride_; }
  const Pixel* row(int y) const { return pixels() + y * stride_; }
  Pixel& operator()(int x, int y) { return row(y)[x]; }
  const Pixel& operator()(int x, int y) const { return row(y)[x]; }

  View2d<Pixel> view() { return {pixels(), width_, height_, stride_}; }
  View2d<const Pixel> view() const { return {pixels(), width_, height_, stride_}; }
  operator View2d<const Pixel>() const { return view(); }

  /// Sets the size; pixels are unspecified afterwards (zero in memory that is new). Memory is kept and only
  /// grows, so that a buffer used for every frame allocates once.
  /// @param min_stride rows are at least this far apart [elements]
  void resize(int width, int height, std::ptrdiff_t min_stride = 0) {
    require(width >= 0 && height >= 0, "Image::resize", "a size cannot be negative", std::min(width, height));
    constexpr std::ptrdiff_t kStep = kAlignment / sizeof(Pixel);
    width_ = width;
    height_ = height;
    stride_ = (std::max<std::ptrdiff_t>(width, min_stride) + kStep - 1) / kStep * kStep;
    const std::size_t bytes =
        static_cast<std::size_t>(stride_) * static_cast<std::size_t>(height) * sizeof(Pixel) + 2 * kAlignment;
    if (bytes <= capacity_) return;
    memory_.reset(static_cast<std::byte*>(::operator new (bytes, std::align_val_t{kAlignment})));
    std::fill_n(memory_.get(), bytes, std::byte{0});
    capacity_ = bytes;
  }

  void fill(Pixel value) {
    for (int y = 0; y < height_; ++y) std::fill_n(row(y), width_, value);
  }

  /// Copies size and pixels.
  void assign(View2d<const Pixel> source) {
    resize(std::max(source.width, 0), std::max(source.height, 0));
    for (int y = 0; y < height_; ++y) std::copy_n(source.row(y), width_, row(y));
  }

  void swap(Image& other) noexcept {
    std::swap(memory_, other.memory_);
    std::swap(capacity_, other.capacity_);
    std::swap(width_, other.width_);
    std::swap(height_, other.height_);
    std::swap(stride_, other.stride_);
  }

 private:
  struct Free {
    void operator()(std::byte* p) const { ::operator delete (p, std::align_val_t{kAlignment}); }
  };

  Pixel* pixels() const { return memory_ ? reinterpret_cast<Pixel*>(memory_.get() + kAlignment) : nullptr; }

  std::unique_ptr<std::byte, Free> memory_;
  std::size_t capacity_ = 0;  // [bytes]
  int width_ = 0;
  int height_ = 0;
  std::ptrdiff_t stride_ = 0;
};

using GrayImage = Image<std::uint8_t>;

}  // namespace sweepkit
