// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "atlas_reader.hpp"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>
#include <zlib.h>

#include <algorithm>
#include <array>
#include <cerrno>

namespace sweepkit::atlas_format {

FileOrigin::FileOrigin(const std::string& path)
    : Origin(path, 0), fd_(::open(path.c_str(), O_RDONLY | O_CLOEXEC)) {
  if (fd_ < 0) throw Error(ErrorKind::io, path, "cannot be opened", std::strerror(errno));
  struct stat status = {};
  const bool known = ::fstat(fd_, &status) == 0;
  if (!known || !S_ISREG(status.st_mode)) {
    ::close(fd_);
    throw Error(ErrorKind::io, path, known ? "is no file" : "cannot be read");
  }
  size = static_cast<std::uint64_t>(status.st_size);
}

FileOrigin::~FileOrigin() { ::close(fd_); }

void FileOrigin::read(std::uint64_t offset, void* to, std::size_t count) {
  auto* p = static_cast<std::byte*>(to);
  while (count > 0) {
    const ::ssize_t got = ::pread(fd_, p, count, static_cast<::off_t>(offset));
    if (got < 0 && errno == EINTR) continue;
    if (got < 0) throw Error(ErrorKind::io, place, "cannot be read", std::strerror(errno));
    if (got == 0)
      throw Error(ErrorKind::data, place, "grew shorter while it was read", std::to_string(offset));
    p += got;
    offset += static_cast<std::uint64_t>(got);
    count -= static_cast<std::size_t>(got);
  }
}

void Reader::bytes(void* to, std::size_t count) {
  last_ = at_;
  if (count > remaining()) fail("the section ends too soon; bytes missing", count - remaining());
  auto* p = static_cast<std::byte*>(to);
  while (count > 0) {
    if (at_ < begin_ || at_ >= end_) {
      if (count >= kWindow) {  // straight to where it belongs
        origin_.read(section_.offset + at_, p, count);
        at_ += count;
        return;
      }
      begin_ = at_;
      end_ = at_ + std::min<std::uint64_t>(kWindow, remaining());
      origin_.read(section_.offset + begin_, window_.data(), static_cast<std::size_t>(end_ - begin_));
    }
    const std::size_t now = std::min(count, static_cast<std::size_t>(end_ - at_));
    std::memcpy(p, window_.data() + (at_ - begin_), now);
    p += now;
    at_ += now;
    count -= now;
  }
}

SE3d Reader::pose() {
  Eigen::Vector4d q;
  finite(q, "a rotation is no number");
  if (std::abs(q.squaredNorm() - 1) > 1e-9)
    fail("a rotation is no unit quaternion; its squared norm", q.squaredNorm());
  Vec3<double> t;
  finite(t, "a position is no number");
  SO3d R;
  // Not through the constructor: it normalises, which would move the last bit.
  const_cast<Eigen::Quaterniond&>(R.quaternion()).coeffs() = q;
  return {R, t};
}

std::vector<Section> read_table(Origin& origin, std::vector<std::byte>& window) {
  const auto wrong = [&](const char* what, std::uint64_t value) {
    throw Error(ErrorKind::data, origin.place, what, std::to_string(value));
  };
  std::array<std::byte, kHeaderBytes> head;
  if (origin.size < head.size()) wrong("is too short for an atlas; bytes", origin.size);
  origin.read(0, head.data(), head.size());
  const auto get = [](const std::byte* from, auto value) {
    std::memcpy(&value, from, sizeof(value));
    return value;
  };
  if (std::memcmp(head.data(), kMagic, sizeof(kMagic)) != 0)
    throw Error(ErrorKind::data, origin.place, "is no atlas");
  const auto order = get(&head[12], std::uint32_t{});
  if (order != kByteOrder) wrong("has another byte order", order);
  const auto file_version = get(&head[8], std::uint32_t{});
  if (file_version != kVersion) wrong("has an unknown version", file_version);
  const auto size = get(&head[16], std::uint64_t{});
  if (size != origin.size) wrong("is cut short or too long: bytes as its header says", size);
  const auto count = get(&head[24], std::uint32_t{});
  if (count < std::size(kSections) || count > std::size(kSections) + kMaxAttachments)
    wrong("has a wrong number of sections", count);
  if (count * kEntryBytes > size - kHeaderBytes) wrong("has more sections than bytes", count);

  std::vector<std::byte> table(count * kEntryBytes);
  origin.read(kHeaderBytes, table.data(), table.size());
  const auto crc_of = [](std::uint32_t crc, const std::byte* data, std::size_t bytes) {
    return static_cast<std::uint32_t>(::crc32_z(crc, reinterpret_cast<const Bytef*>(data), bytes));
  };
  const auto table_crc = get(&head[28], std::uint32_t{});
  if (crc_of(0, table.data(), table.size()) != table_crc)
    wrong("has a damaged table of sections: its CRC should be", table_crc);

  // Sections fill the file without gaps: every byte is under a CRC.
  std::vector<Section> sections(count);
  std::uint64_t next = kHeaderBytes + table.size();
  for (std::uint32_t i = 0; i < count; ++i) {
    const std::byte* entry = &table[i * kEntryBytes];
    const auto* name = reinterpret_cast<const char*>(entry);
    Section& section = sections[i];
    section.name.assign(name, ::strnlen(name, kNameBytes));
    const std::string_view expected = i < std::size(kSections) ? kSections[i] : kAttachment;
    if (section.name != expected) wrong("has another section than it should; number", i);
    section.offset = get(entry + 16, std::uint64_t{});
    section.bytes = get(entry + 24, std::uint64_t{});
    if (section.offset != next)
      wrong("has a section that is not where it belongs; its offset", section.offset);
    if (section.bytes > size - next)
      wrong("has a section that is longer than the file; bytes", section.bytes);
    next += section.bytes;
    const auto expected_crc = get(entry + 32, std::uint32_t{});
    std::uint32_t crc = 0;
    for (std::uint64_t done = 0; done < section.bytes;) {
      const auto now = static_cast<std::size_t>(std::min<std::uint64_t>(kWindow, section.bytes - done));
      origin.read(section.offset + done, window.data(), now);
      crc = crc_of(crc, window.data(), now);
      done += now;
    }
    if (crc != expected_crc)
      throw Error(ErrorKind::data,
                  origin.place + ", section " + section.name + ", byte " + std::to_string(section.offset),
                  "is damaged: its CRC should be", std::to_string(expected_crc));
  }
  if (next != size) wrong("has bytes that belong to no section; from", next);
  return sections;
}

}  // namespace sweepkit::atlas_format
