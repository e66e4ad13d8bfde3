// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "atlas_format.hpp"
#include "sweepkit/core/error.hpp"
#include "sweepkit/geometry/se3.hpp"

namespace sweepkit::atlas_format {

// Where bytes come from.
struct Origin {
  Origin(std::string place, std::uint64_t size) : place(std::move(place)), size(size) {}
  virtual ~Origin() = default;
  /// Exactly these, which lie within `size`.
  virtual void read(std::uint64_t offset, void* to, std::size_t bytes) = 0;

  std::string place;
  std::uint64_t size;
};

struct MemoryOrigin : Origin {
  MemoryOrigin(std::span<const std::byte> bytes, const std::string& place)
      : Origin(place, bytes.size()), bytes(bytes) {}
  void read(std::uint64_t offset, void* to, std::size_t count) override {
    if (count > 0) std::memcpy(to, bytes.data() + offset, count);
  }
  std::span<const std::byte> bytes;
};

class FileOrigin : public Origin {
 public:
  /// Throws Error(io).
  explicit FileOrigin(const std::string& path);
  ~FileOrigin() override;
  FileOrigin(const FileOrigin&) = delete;
  FileOrigin& operator=(const FileOrigin&) = delete;

  void read(std::uint64_t offset, void* to, std::size_t count) override;

 private:
  int fd_;
};

struct Section {
  std::string name;
  std::uint64_t offset = 0, bytes = 0;
};

/// How much is read at a time: what a window given to the functions below holds.
inline constexpr std::size_t kWindow = 1 << 16;

/// The sections of a file whose size, table and checksums are right. Throws Error(data).
std::vector<Section> read_table(Origin& origin, std::vector<std::byte>& window);

/// The fields of one section, none of them taken on trust. Errors name the byte of the field that was read
// last.
class Reader {
 public:
  Reader(Origin& origin, const Section& section, std::vector<std::byte>& window)
      : origin_(origin), section_(section), window_(window) {}

  std::uint64_t remaining() const { return section_.bytes - at_; }

  template <class Value>
  [[noreturn]] void fail(const char* what, const Value& value) const {
    throw Error(
        ErrorKind::data,
        origin_.place + ", section " + section_.name + ", byte " + std::to_string(section_.offset + last_),
        what, std::to_string(value));
  }

  /// That so many records of at least so many bytes can still come.
  void expect(std::uint64_t count, std::size_t bytes, const char* what) const {
    if (count > remaining() / bytes) fail(what, count);
  }
  void bytes(void* to, std::size_t count);
  template <class T>
  T number() {
    T value;
    bytes(&value, sizeof(value));
    return value;
  }
  template <class T>
  T number(T least, T most, const char* what) {
    const T value = number<T>();
    if (!(value >= least && value <= most)) fail(what, value);
    return value;
  }
  /// Numbers that are none are refused.
  void finite(auto& list, const char* what) {
    bytes(list.data(), sizeof(*list.data()) * static_cast<std::size_t>(list.size()));
    for (const auto value : list.reshaped())
      if (!std::isfinite(value)) fail(what, value);
  }
  template <class T>
  T finite(const char* what) {
    const T value = number<T>();
    if (!std::isfinite(value)) fail(what, value);
    return value;
  }
  std::string text() {
    const auto size = number<std::uint32_t>(0, kMaxText, "a text is too long");
    expect(size, 1, "a text is longer than the section");
    std::string text(size, '\0');
    bytes(text.data(), size);
    return text;
  }
  SE3d pose();
  Mat6<double> covariance() {
    Mat6<double> C;
    finite(C, "a covariance is no number");
    return C;
  }
  void end() {
    last_ = at_;
    if (remaining() > 0) fail("has bytes that belong to nothing", remaining());
  }

 private:
  Origin& origin_;
  const Section& section_;
  std::vector<std::byte>& window_;  // holds the bytes from begin_ to end_ of the section
  std::uint64_t at_ = 0, last_ = 0, begin_ = 0, end_ = 0;
};

}  // namespace sweepkit::atlas_format
