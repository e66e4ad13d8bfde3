// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <array>
#include <cstdint>

#include "sweepkit/core/error.hpp"
#include "vocabulary_formats.hpp"

// QuickLZ 1.5, level 1, after the description of its format that the ReSpeak project publishes (Format.md of
// ReSpeak/quicklz, MIT or Apache-2.0).

namespace sweepkit::impl {
namespace {

constexpr std::uint32_t kHashes = 4096;

struct Chunk {
  bool packed;
  std::size_t header, packed_size, size;
};

class Unpacker {
 public:
  Unpacker(std::string_view in, std::size_t size, const std::string& place, std::string& out)
      : in_(in), size_(size), place_(place), out_(out), start_(out.size()) {}

  void run() {
    std::uint32_t control = 1;
    while (length() < size_) {
      if (control == 1) control = take(4);
      if (control & 1) {
        control >>= 1;
        copy_match();
      } else if (length() + 10 < size_) {
        control >>= 1;
        out_.push_back(static_cast<char>(take(1)));
        if (length() >= 3) hash_up_to(length() - 2);
      } else {
        // The last bytes are as they are; control words between them mean nothing.
        while (length() < size_) {
          if (control == 1) {
            take(4);
            control = 1u << 31;
          }
          control >>= 1;
          out_.push_back(static_cast<char>(take(1)));
        }
      }
    }
  }

 private:
  std::size_t length() const { return out_.size() - start_; }
  std::uint8_t byte(std::size_t i) const { return static_cast<std::uint8_t>(out_[start_ + i]); }
  [[noreturn]] void fail(const char* what) const { throw Error(ErrorKind::data, place_, what); }

  std::uint32_t take(std::size_t bytes) {
    if (in_.size() < bytes) fail("a compressed chunk ends early");
    std::uint32_t value = 0;
    for (std::size_t i = 0; i < bytes; ++i)
      value |= std::uint32_t{static_cast<std::uint8_t>(in_[i])} << (8 * i);
    in_.remove_prefix(bytes);
    return value;
  }

  /// Positions before `end` can be referred to from now on.
  void hash_up_to(std::size_t end) {
    for (; hashed_ < end; ++hashed_) {
      const std::uint32_t next =
          byte(hashed_) | std::uint32_t{byte(hashed_ + 1)} << 8 | std::uint32_t{byte(hashed_ + 2)} << 16;
      place_of_[(next >> 12 ^ next) & (kHashes - 1)] = static_cast<std::uint32_t>(hashed_);
    }
  }

  void copy_match() {
    const std::uint32_t head = take(2);
    std::size_t count = (head & 15) + 2;
    if ((head & 15) == 0) count = take(1);
    if (count < 3) fail("a compressed chunk has a wrong match");
    const std::size_t from = place_of_[head >> 4];
    if (from >= length()) fail("a compressed chunk refers to what is not there");
    if (count > size_ - length()) fail("a compressed chunk is longer than it says");
    // Byte by byte: a match may reach into what it writes.
    for (std::size_t i = 0; i < count; ++i) out_.push_back(static_cast<char>(byte(from + i)));
    hash_up_to(length() + 1 - count);
    hashed_ = length();
  }

  std::string_view in_;
  std::size_t size_;
  const std::string& place_;
  std::string& out_;
  std::size_t start_, hashed_ = 0;
  std::array<std::uint32_t, kHashes> place_of_{};
};

Chunk read_header(std::string_view in, const std::string& place) {
  const auto number = [&](std::size_t at, std::size_t bytes) {
    std::size_t value = 0;
    if (in.size() < at + bytes) throw Error(ErrorKind::data, place, "a compressed chunk ends early");
    for (std::size_t i = 0; i < bytes; ++i)
      value |= std::size_t{static_cast<std::uint8_t>(in[at + i])} << (8 * i);
    return value;
  };
  const std::size_t flags = number(0, 1);
  Chunk chunk;
  chunk.packed = flags & 1;
  const std::size_t bytes = flags & 2 ? 4 : 1;
  chunk.header = 1 + 2 * bytes;
  chunk.packed_size = number(1, bytes);
  chunk.size = number(1 + bytes, bytes);
  const bool streamed = (flags & 0x30) != 0;
  if (chunk.packed && ((flags >> 2 & 3) != 1 || streamed))
    throw Error(ErrorKind::data, place,
                "is compressed by a variant of QuickLZ that cannot be read here; save it uncompressed with "
                "DBoW3",
                std::to_string(flags));
  return chunk;
}

/// Packs a chunk for level 1. What it may refer to is kept as one who unpacks it will: positions of which
/// three bytes are known, but for those inside matches.
class Packer {
 public:
  explicit Packer(std::string_view in) : in_(in) {}

  std::string run() {
    begin_control();
    while (at_ < in_.size()) {
      if (items_ == 31) {
        end_control();
        begin_control();
      }
      ++items_;
      // The last bytes are literals.
      const std::size_t count = at_ + 10 < in_.size() ? match_length() : 0;
      if (count < 3) {
        out_ += in_[at_++];
        if (at_ >= 3) hash_up_to(at_ - 2);
        continue;
      }
      control_ |= 1u << (items_ - 1);
      const std::uint32_t hash = hash_at(at_);
      const bool brief = count < 18;
      out_ += static_cast<char>((hash & 15) << 4 | (brief ? count - 2 : 0));
      out_ += static_cast<char>(hash >> 4);
      if (!brief) out_ += static_cast<char>(count);
      hash_up_to(at_ + 1);
      at_ += count;
      hashed_ = at_;
    }
    end_control();
    return std::move(out_);
  }

 private:
  std::uint32_t hash_at(std::size_t i) const {
    const auto byte = [&](std::size_t k) { return std::uint32_t{static_cast<std::uint8_t>(in_[k])}; };
    const std::uint32_t next = byte(i) | byte(i + 1) << 8 | byte(i + 2) << 16;
    return (next >> 12 ^ next) & (kHashes - 1);
  }
  void hash_up_to(std::size_t end) {
    for (; hashed_ < end; ++hashed_) place_of_[hash_at(hashed_)] = static_cast<std::uint32_t>(hashed_) + 1;
  }
  std::size_t match_length() const {
    const std::uint32_t place = place_of_[hash_at(at_)];
    if (place == 0) return 0;
    const std::size_t from = place - 1, most = std::min<std::size_t>(255, in_.size() - 4 - at_);
    std::size_t count = 0;
    while (count < most && in_[from + count] == in_[at_ + count]) ++count;
    return count;
  }
  void begin_control() {
    control_at_ = out_.size();
    out_.append(4, '\0');
    control_ = 0;
    items_ = 0;
  }
  void end_control() {
    const std::uint32_t word = control_ | 1u << 31;
    for (int i = 0; i < 4; ++i)
      out_[control_at_ + static_cast<std::size_t>(i)] = static_cast<char>(word >> (8 * i));
  }

  std::string_view in_;
  std::string out_;
  std::size_t at_ = 0, hashed_ = 0, control_at_ = 0;
  std::uint32_t control_ = 0;
  int items_ = 0;
  std::array<std::uint32_t, kHashes> place_of_{};  // and one; 0 for none
};

}  // namespace

std::string pack_quicklz(std::string_view piece) {
  std::string body = Packer(piece).run();
  const bool packed = body.size() < piece.size();
  if (!packed) body = piece;
  // Level 1, long header.
  std::string chunk(1, static_cast<char>(0x40 | 0x04 | 0x02 | (packed ? 1 : 0)));
  for (const std::size_t number : {body.size() + 9, piece.size()})
    for (int i = 0; i < 4; ++i) chunk += static_cast<char>(number >> (8 * i));
  return chunk + body;
}

std::size_t unpack_quicklz(std::string_view in, std::size_t limit, const std::string& place,
                           std::string& out) {
  const Chunk chunk = read_header(in, place);
  if (chunk.packed_size < chunk.header || chunk.packed_size > in.size())
    throw Error(ErrorKind::data, place, "a compressed chunk ends early", std::to_string(chunk.packed_size));
  if (chunk.size > limit)
    throw Error(ErrorKind::data, place, "a compressed chunk is too large", std::to_string(chunk.size));
  const std::string_view body = in.substr(chunk.header, chunk.packed_size - chunk.header);
  if (chunk.packed) {
    Unpacker(body, chunk.size, place, out).run();
  } else {
    if (body.size() != chunk.size)
      throw Error(ErrorKind::data, place, "a stored chunk has a wrong length", std::to_string(chunk.size));
    out.append(body);
  }
  return chunk.packed_size;
}

}  // namespace sweepkit::impl
