// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>
#include <zlib.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <functional>
#include <type_traits>
#include <utility>

#include "atlas_format.hpp"
#include "sweepkit/core/error.hpp"
#include "sweepkit/core/version.hpp"
#include "sweepkit/data/atlas_file.hpp"

namespace sweepkit {
namespace {

namespace format = atlas_format;

// Where bytes go: the next ones, or those of a place already written.
struct Sink {
  virtual ~Sink() = default;
  virtual void append(std::span<const std::byte> bytes) = 0;
  virtual void overwrite(std::size_t offset, std::span<const std::byte> bytes) = 0;
};

struct MemorySink : Sink {
  std::vector<std::byte> bytes;
  void append(std::span<const std::byte> more) override {
    bytes.insert(bytes.end(), more.begin(), more.end());
  }
  void overwrite(std::size_t offset, std::span<const std::byte> again) override {
    std::copy(again.begin(), again.end(), bytes.begin() + static_cast<std::ptrdiff_t>(offset));
  }
};

// A file beside `path` that takes its place when all is written, and is gone if that does not come to pass.
class FileSink : public Sink {
 public:
  explicit FileSink(const std::string& path)
      : path_(path), part_(path + "." + std::to_string(::getpid()) + ".part") {
    struct stat status = {};
    // A device or a folder is not to be replaced by a file.
    if (::stat(path.c_str(), &status) == 0 && !S_ISREG(status.st_mode))
      throw Error(ErrorKind::io, path, "cannot be written: it is no file");
    fd_ = ::open(part_.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0666);
    if (fd_ < 0) fail();
  }
  ~FileSink() override {
    if (fd_ >= 0) ::close(fd_);
    if (!done_) ::unlink(part_.c_str());
  }
  FileSink(const FileSink&) = delete;
  FileSink& operator=(const FileSink&) = delete;

  void append(std::span<const std::byte> bytes) override {
    while (!bytes.empty()) {
      const ::ssize_t written = ::write(fd_, bytes.data(), bytes.size());
      if (written < 0 && errno == EINTR) continue;
      if (written <= 0) fail();
      bytes = bytes.subspan(static_cast<std::size_t>(written));
    }
  }
  void overwrite(std::size_t offset, std::span<const std::byte> bytes) override {
    if (::lseek(fd_, static_cast<::off_t>(offset), SEEK_SET) < 0) fail();
    append(bytes);
  }
  void finish() {
    // On the disk before the old file goes: else a loss of power could leave neither.
    if (::fsync(fd_) != 0) fail();
    if (::close(std::exchange(fd_, -1)) != 0) fail();
    if (::rename(part_.c_str(), path_.c_str()) != 0) fail();
    done_ = true;
    const std::string folder = std::filesystem::path(path_).parent_path().string();
    const int fd = ::open(folder.empty() ? "." : folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    if (fd < 0) return;
    ::fsync(fd);  // of the name alone; some file systems have no such thing
    ::close(fd);
  }

 private:
  [[noreturn]] void fail() const {
    throw Error(ErrorKind::io, path_, "cannot be written", std::strerror(errno));
  }

  std::string path_, part_;
  int fd_ = -1;
  bool done_ = false;
};

// Fields one after the other, in sections.
class Writer {
 public:
  Writer(Sink& sink, std::size_t section_count) : sink_(sink) {
    table_.reserve(section_count);
    buffer_.reserve(kBuffer);
    const std::vector<std::byte> head(format::kHeaderBytes + section_count * format::kEntryBytes);
    sink_.append(head);
    offset_ = head.size();
  }

  void section(std::string_view name) { table_.push_back({name, offset_, 0, 0}); }

  void bytes(const void* data, std::size_t size) {
    const auto* p = static_cast<const std::byte*>(data);
    table_.back().bytes += size;
    offset_ += size;
    while (size > 0) {
      const std::size_t now = std::min(size, kBuffer - buffer_.size());
      buffer_.insert(buffer_.end(), p, p + now);
      p += now;
      size -= now;
      if (buffer_.size() == kBuffer) flush();
    }
  }
  template <class T>
  void number(T value) {
    static_assert(std::is_arithmetic_v<T>);
    bytes(&value, sizeof(value));
  }
  void text(std::string_view text) {
    text = text.substr(0, format::kMaxText);
    number(static_cast<std::uint32_t>(text.size()));
    bytes(text.data(), text.size());
  }
  void pose(const SE3d& T) {
    bytes(T.rotation().quaternion().coeffs().data(), 4 * sizeof(double));
    bytes(T.translation().data(), 3 * sizeof(double));
  }
  void end_section() { flush(); }

  void finish() {
    std::vector<std::byte> head(format::kHeaderBytes + table_.size() * format::kEntryBytes);
    const auto put = [&head](std::size_t at, const auto& value) {
      std::memcpy(&head[at], &value, sizeof(value));
    };
    for (std::size_t i = 0; i < table_.size(); ++i) {
      const std::size_t at = format::kHeaderBytes + i * format::kEntryBytes;
      std::memcpy(&head[at], table_[i].name.data(), table_[i].name.size());
      put(at + 16, table_[i].offset);
      put(at + 24, table_[i].bytes);
      put(at + 32, table_[i].crc);
    }
    const auto crc = static_cast<std::uint32_t>(::crc32_z(
        0, reinterpret_cast<const Bytef*>(&head[format::kHeaderBytes]), head.size() - format::kHeaderBytes));
    put(0, format::kMagic);
    put(8, format::kVersion);
    put(12, format::kByteOrder);
    put(16, static_cast<std::uint64_t>(offset_));
    put(24, static_cast<std::uint32_t>(table_.size()));
    put(28, crc);
    sink_.overwrite(0, head);
  }

 private:
  static constexpr std::size_t kBuffer = 1 << 18;
  struct Entry {
    std::string_view name;
    std::uint64_t offset, bytes;
    std::uint32_t crc;
  };

  void flush() {
    Entry& entry = table_.back();
    entry.crc = static_cast<std::uint32_t>(
        ::crc32_z(entry.crc, reinterpret_cast<const Bytef*>(buffer_.data()), buffer_.size()));
    sink_.append(buffer_);
    buffer_.clear();
  }

  Sink& sink_;
  std::vector<Entry> table_;
  std::vector<std::byte> buffer_;
  std::uint64_t offset_;
};

void write_about(Writer& out, const AtlasInfo& info, const Map& map) {
  out.text(version());
  out.text(info.descriptor_type);
  out.number(static_cast<std::uint32_t>(info.descriptor_bits));
  out.text(info.vocabulary);
  out.number(info.vocabulary_checksum);
  out.number(info.disparity_bias);
  out.number(info.disparity_bias_sigma);
  out.number(static_cast<std::uint32_t>(map.keyframe_count()));
  out.number(map.keyframe_id_end());
  out.number(static_cast<std::uint32_t>(map.point_count()));
  out.number(map.map_count());
  for (std::uint32_t i = 0; i < map.map_count(); ++i)
    out.number(static_cast<std::uint8_t>(i < info.gravity_known.size() && info.gravity_known[i]));
}

void write_camera(Writer& out, const CameraIdentity& camera) {
  out.number(static_cast<std::uint32_t>(camera.width));
  out.number(static_cast<std::uint32_t>(camera.height));
  for (int i = 0; i < 4; ++i) out.number(camera.intrinsics.at(static_cast<std::size_t>(i)));
  out.text(to_string(camera.distortion));
  out.number(static_cast<std::uint32_t>(camera.coefficients.size()));
  for (const double c : camera.coefficients) out.number(c);
  out.pose(camera.T_body_camera);
}

void write_keyframe(Writer& out, const Keyframe& keyframe) {
  const auto before =
      static_cast<std::uint32_t>(std::count_if(keyframe.covisible.begin(), keyframe.covisible.end(),
                                               [&](const Covisible& c) { return c.keyframe < keyframe.id; }));
  out.number(keyframe.id.value);
  out.number(keyframe.map.value);
  out.number(static_cast<std::int64_t>(keyframe.t));
  out.number(keyframe.parent.value);
  out.number(keyframe.odometry ? format::kHasOdometry : 0);
  out.number(static_cast<std::uint32_t>(keyframe.measurements.size()));
  out.number(before);
  out.pose(keyframe.T_camera_world);
  out.bytes(keyframe.covariance.data(), format::kCovarianceBytes);
  if (keyframe.odometry) {
    out.number(keyframe.odometry->from.value);
    out.pose(keyframe.odometry->motion.T);
    out.bytes(keyframe.odometry->motion.covariance.data(), format::kCovarianceBytes);
  }
  out.bytes(keyframe.measurements.data(), keyframe.measurements.size() * sizeof(Measurement));
  out.bytes(keyframe.descriptors.data(), keyframe.descriptors.size() * sizeof(OrbDescriptor));
  // Each pair once, with the later keyframe.
  for (const Covisible& c : keyframe.covisible) {
    if (!(c.keyframe < keyframe.id)) break;
    out.number(c.keyframe.value);
    out.number(static_cast<std::uint32_t>(c.points));
  }
}

void write_point(Writer& out, const MapPoint& point) {
  out.bytes(point.p_world.data(), 3 * sizeof(double));
  out.bytes(&point.descriptor, sizeof(OrbDescriptor));
  out.bytes(point.normal.data(), 3 * sizeof(float));
  out.number(point.min_distance);
  out.number(point.max_distance);
  out.number(point.first_keyframe.value);
  out.number(static_cast<std::uint32_t>(point.predicted));
  out.number(static_cast<std::uint32_t>(point.found));
  out.number(static_cast<std::uint32_t>(point.observations.size()));
  for (const Observation& o : point.observations) {
    out.number(o.keyframe.value);
    out.number(o.index);
  }
}

void write_attachments(Writer& out, const std::string& name, const std::vector<KeyframeAttachment>& pieces,
                       const Map& map) {
  // Keyframes go; what was kept with them goes with them.
  const auto lives = [&](const KeyframeAttachment& piece) { return map.find(piece.keyframe) != nullptr; };
  out.text(name);
  out.number(static_cast<std::uint64_t>(std::count_if(pieces.begin(), pieces.end(), lives)));
  for (const KeyframeAttachment& piece : pieces) {
    if (!lives(piece)) continue;
    out.number(std::uint64_t{piece.keyframe.value});
    out.number(static_cast<std::uint64_t>(piece.bytes.size()));
    out.bytes(piece.bytes.data(), piece.bytes.size());
  }
}

void encode(Sink& sink, const AtlasInfo& info, const Map& map) {
  require(info.rig.left.intrinsics.size() == 4 && info.rig.right.intrinsics.size() == 4,
          "write_atlas info.rig", "both cameras must have fx, fy, cx, cy", info.rig.left.intrinsics.size());
  require(info.attachments.size() <= format::kMaxAttachments, "write_atlas info.attachments",
          "there are too many names", info.attachments.size());
  for (const auto& [name, pieces] : info.attachments) {
    require(!name.empty() && name.size() <= format::kMaxText, "write_atlas info.attachments",
            "a name is empty or too long", name.size());
    for (std::size_t i = 1; i < pieces.size(); ++i)
      require(pieces[i - 1].keyframe < pieces[i].keyframe, "write_atlas info.attachments",
              "pieces must be sorted by keyframe, one for each", pieces[i].keyframe.value);
  }
  Writer out(sink, std::size(format::kSections) + info.attachments.size());
  out.section("about");
  write_about(out, info, map);
  out.end_section();

  out.section("rig");
  write_camera(out, info.rig.left);
  write_camera(out, info.rig.right);
  out.end_section();

  out.section("removed");
  for (std::uint32_t i = 0; i < map.keyframe_id_end(); ++i) {
    const RemovedKeyframe* removed = map.find_removed(KeyframeId{i});
    if (!removed) continue;
    out.number(i);
    out.number(removed->parent.value);
    out.pose(removed->T_camera_parent);
  }
  out.end_section();

  out.section("keyframes");
  for (std::uint32_t i = 0; i < map.keyframe_id_end(); ++i)
    if (const Keyframe* keyframe = map.find(KeyframeId{i})) write_keyframe(out, *keyframe);
  out.end_section();

  out.section("points");
  for (std::uint32_t i = 0; i < map.point_id_end(); ++i)
    if (const MapPoint* point = map.find(PointId{i})) write_point(out, *point);
  out.end_section();

  for (const auto& [name, pieces] : info.attachments) {
    out.section(format::kAttachment);
    write_attachments(out, name, pieces, map);
    out.end_section();
  }
  out.finish();
}

}  // namespace

void write_atlas(const std::string& path, const AtlasInfo& info, const Map& map) {
  FileSink file(path);
  encode(file, info, map);
  file.finish();
}

void write_atlas(const std::string& path, const Atlas& atlas) { write_atlas(path, atlas.info, atlas.map); }

std::vector<std::byte> encode_atlas(const AtlasInfo& info, const Map& map) {
  MemorySink memory;
  encode(memory, info, map);
  return std::move(memory.bytes);
}

}  // namespace sweepkit
