// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/floor/grid_file.hpp"

#include <fmt/format.h>
#include <png.h>
#include <yaml-cpp/yaml.h>

#include <array>
#include <cerrno>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <memory>
#include <optional>
#include <vector>

#include "sweepkit/core/error.hpp"

namespace sweepkit {
namespace {

namespace fs = std::filesystem;
using Bytes = std::vector<std::uint8_t>;

constexpr int kLargestSide = 32768;                         // [cells]
constexpr std::size_t kMostCells = std::size_t{1} << 27;    // of a picture that is read
constexpr std::size_t kLongestText = std::size_t{1} << 16;  // of a YAML file [bytes]
constexpr std::size_t kLongestFile = std::size_t{1} << 30;  // of a picture's file [bytes]
constexpr double kOccupied = 0.65, kFree = 0.196;           // thresholds written

Bytes read_bytes(const fs::path& file, std::size_t longest) {
  const std::unique_ptr<std::FILE, int (*)(std::FILE*)> stream(std::fopen(file.c_str(), "rb"), std::fclose);
  if (!stream)
    throw Error(ErrorKind::io, file.string(), std::string("cannot be opened: ") + std::strerror(errno));
  Bytes bytes;
  constexpr std::size_t kStep = std::size_t{1} << 18;
  // Grown by what is there: a directory or a pipe has no honest length.
  for (std::size_t got = kStep; got == kStep;) {
    const std::size_t size = bytes.size();
    if (size > longest)
      throw Error(ErrorKind::data, file.string(), "is too long", fmt::format("over {} bytes", longest));
    bytes.resize(size + kStep);
    got = std::fread(bytes.data() + size, 1, kStep, stream.get());
    bytes.resize(size + got);
  }
  if (std::ferror(stream.get())) throw Error(ErrorKind::io, file.string(), "cannot be read");
  return bytes;
}

/// Refuses a picture that is no size for a map, or that so short a file cannot hold.
void check_size(const fs::path& file, std::uint64_t width, std::uint64_t height, std::size_t bytes,
                std::uint64_t most_per_byte) {
  const std::string size = fmt::format("{}x{}", width, height);
  if (width == 0 || height == 0 || width > kLargestSide || height > kLargestSide ||
      width * height > kMostCells)
    throw Error(ErrorKind::data, file.string(), "the size of the map cannot be", size);
  if (width * height > most_per_byte * bytes)
    throw Error(ErrorKind::data, file.string(), "is too short for its size", size);
}

GrayImage read_png(const fs::path& file, const Bytes& bytes) {
  png_image png{};
  png.version = PNG_IMAGE_VERSION;
  const std::unique_ptr<png_image, void (*)(png_image*)> guard(&png, [](png_image* p) { png_image_free(p); });
  if (!png_image_begin_read_from_memory(&png, bytes.data(), bytes.size()))
    throw Error(ErrorKind::data, file.string(), std::string("is no PNG that can be read: ") + png.message);
  check_size(file, png.width, png.height, bytes.size(), 8 * 1032);  // one bit a pixel, packed 1032 to 1
  png.format = PNG_FORMAT_GRAY;
  GrayImage image(static_cast<int>(png.width), static_cast<int>(png.height));
  const png_color black{0, 0, 0};
  if (!png_image_finish_read(&png, &black, image.row(0), static_cast<png_int_32>(image.stride()), nullptr))
    throw Error(ErrorKind::data, file.string(), std::string("is a damaged PNG: ") + png.message);
  return image;
}

/// Reads the header of a PGM word by word.
class PgmReader {
 public:
  PgmReader(const fs::path& file, const Bytes& bytes) : file_(file), bytes_(bytes) {}

  /// The next number; nothing at the end. Comments run from # to the end of the line.
  std::uint64_t number(const char* what) {
    while (at_ < bytes_.size() && (is_space(bytes_[at_]) || bytes_[at_] == '#')) {
      if (bytes_[at_] == '#')
        while (at_ < bytes_.size() && bytes_[at_] != '\n') ++at_;
      else
        ++at_;
    }
    std::uint64_t value = 0;
    const std::size_t begin = at_;
    for (; at_ < bytes_.size() && bytes_[at_] >= '0' && bytes_[at_] <= '9' && at_ - begin < 9; ++at_)
      value = 10 * value + (bytes_[at_] - '0');
    if (at_ == begin) throw Error(ErrorKind::data, file_.string(), fmt::format("the PGM has no {}", what));
    return value;
  }

  GrayImage read() {
    const bool binary = bytes_[1] == '5';
    at_ = 2;
    const std::uint64_t width = number("width"), height = number("height"), levels = number("grey levels");
    if (levels == 0 || levels > 255)
      throw Error(ErrorKind::data, file_.string(), "the PGM must have 1 to 255 grey levels",
                  std::to_string(levels));
    if (binary && at_ < bytes_.size()) ++at_;  // one white space
    check_size(file_, width, height, bytes_.size() - at_, 1);
    GrayImage image(static_cast<int>(width), static_cast<int>(height));
    for (int y = 0; y < image.height(); ++y)
      for (int x = 0; x < image.width(); ++x) {
        const std::uint64_t value = binary ? bytes_[at_++] : number("pixel");
        if (value > levels)
          throw Error(ErrorKind::data, file_.string(), "a pixel of the PGM is above its grey levels",
                      std::to_string(value));
        image(x, y) = static_cast<std::uint8_t>(value * 255 / levels);
      }
    return image;
  }

 private:
  static bool is_space(std::uint8_t c) { return c == ' ' || (c >= 9 && c <= 13); }

  const fs::path& file_;
  const Bytes& bytes_;
  std::size_t at_ = 0;
};

GrayImage read_picture(const fs::path& file) {
  const Bytes bytes = read_bytes(file, kLongestFile);
  if (bytes.size() >= 8 && png_sig_cmp(bytes.data(), 0, 8) == 0) return read_png(file, bytes);
  if (bytes.size() >= 2 && bytes[0] == 'P' && (bytes[1] == '2' || bytes[1] == '5'))
    return PgmReader(file, bytes).read();
  throw Error(ErrorKind::data, file.string(), "is neither PGM nor PNG");
}

/// The keys of a map's YAML.
class MapKeys {
 public:
  explicit MapKeys(const fs::path& file) : file_(file.string()) {
    const Bytes bytes = read_bytes(file, kLongestText);
    try {
      root_ = YAML::Load(std::string(bytes.begin(), bytes.end()));
    } catch (const YAML::Exception& error) {
      throw Error(ErrorKind::data, file_, std::string("is no YAML: ") + error.what());
    }
    if (!root_.IsMap()) throw Error(ErrorKind::data, file_, "must be a map of keys: image, resolution, ...");
  }

  std::string text(const std::string& key) const { return value<std::string>(key, at(key), "a text"); }
  double number(const std::string& key) const { return number(key, at(key)); }
  double number_or(const std::string& key, double missing) const {
    return root_[key] ? number(key) : missing;
  }
  bool flag_or(const std::string& key, bool missing) const {
    if (!root_[key]) return missing;
    const std::string word = text(key);
    if (word == "0" || word == "false") return false;
    if (word == "1" || word == "true") return true;
    throw bad(key, "must be 0 or 1", word);
  }
  bool has(const std::string& key) const { return static_cast<bool>(root_[key]); }
  std::array<double, 3> numbers3(const std::string& key) const {
    const YAML::Node node = at(key);
    if (!node.IsSequence() || node.size() != 3) throw bad(key, "must be three numbers: x, y, yaw", "");
    return {number(key, node[0]), number(key, node[1]), number(key, node[2])};
  }
  Error bad(const std::string& key, const std::string& message, const std::string& got) const {
    return Error(ErrorKind::data, file_ + ": " + key, message, got);
  }

 private:
  YAML::Node at(const std::string& key) const {
    const YAML::Node node = root_[key];
    if (!node) throw Error(ErrorKind::data, file_, "has no key " + key);
    return node;
  }
  double number(const std::string& key, const YAML::Node& node) const {
    const double result = value<double>(key, node, "a number");
    if (!std::isfinite(result)) throw bad(key, "must be a finite number", node.Scalar());
    return result;
  }
  template <class T>
  T value(const std::string& key, const YAML::Node& node, const char* kind) const {
    try {
      return node.as<T>();
    } catch (const YAML::Exception&) {
      throw bad(key, std::string("must be ") + kind, node.IsScalar() ? node.Scalar() : "");
    }
  }

  std::string file_;
  YAML::Node root_;
};

}  // namespace

void write_grid(const OccupancyImage& map, const fs::path& folder, const std::string& name) {
  require(std::isfinite(map.cell) && map.cell > 0, "write_grid map.cell", "must be positive", map.cell);
  require(map.origin.allFinite(), "write_grid map.origin", "must be finite", map.origin.transpose());
  GrayImage unknown(1, 1);
  unknown.fill(OccupancyImage::kUnknown);
  const GrayView cells = map.cells.empty() ? unknown.view() : map.cells.view();
  const auto write = [&](const fs::path& file, const std::string& content) {
    std::ofstream stream(file, std::ios::binary);
    stream << content;
    stream.close();
    if (!stream) throw Error(ErrorKind::io, file.string(), "cannot be written");
  };
  std::string pgm = fmt::format("P5\n{} {}\n255\n", cells.width, cells.height);
  for (int y = 0; y < cells.height; ++y)
    pgm.append(reinterpret_cast<const char*>(cells.row(y)), static_cast<std::size_t>(cells.width));
  write(folder / (name + ".pgm"), pgm);
  // The shortest texts that read back as the same numbers.
  write(folder / (name + ".yaml"),
        fmt::format("image: {}.pgm\nresolution: {}\norigin: [{}, {}, 0.0]\nnegate: 0\noccupied_thresh: "
                    "{}\nfree_thresh: {}\nmode: trinary\n",
                    name, map.cell, map.origin.x(), map.origin.y(), kOccupied, kFree));
}

OccupancyImage read_grid(const fs::path& yaml) {
  const MapKeys keys(yaml);
  OccupancyImage map;
  map.cell = keys.number("resolution");
  if (!(map.cell > 1e-4 && map.cell < 1e3))
    throw keys.bad("resolution", "must lie in 0.0001 .. 1000 m", fmt::format("{}", map.cell));
  const auto [x, y, yaw] = keys.numbers3("origin");
  if (std::abs(x) > 1e7 || std::abs(y) > 1e7)
    throw keys.bad("origin", "is farther away than any map", fmt::format("{}, {}", x, y));
  if (std::abs(yaw) > 1e-9)
    throw keys.bad("origin", "must have yaw 0: turned maps are not read", fmt::format("{}", yaw));
  map.origin = {x, y};
  const bool negate = keys.flag_or("negate", false);
  const double occupied = keys.number("occupied_thresh"), free = keys.number("free_thresh");
  if (!(free >= 0 && free <= occupied && occupied <= 1))
    throw keys.bad("free_thresh", "must lie between 0 and occupied_thresh, and that below 1",
                   fmt::format("{} and {}", free, occupied));
  if (keys.has("mode") && keys.text("mode") != "trinary")
    throw keys.bad("mode", "must be trinary", keys.text("mode"));
  const fs::path picture = keys.text("image");
  if (picture.empty()) throw keys.bad("image", "must name a file", "");
  map.cells = read_picture(picture.is_absolute() ? picture : yaml.parent_path() / picture);
  for (int row = 0; row < map.cells.height(); ++row)
    for (int column = 0; column < map.cells.width(); ++column) {
      std::uint8_t& cell = map.cells(column, row);
      const double p = (negate ? cell : 255 - cell) / 255.0;
      cell = p > occupied ? OccupancyImage::kOccupied
             : p < free   ? OccupancyImage::kFree
                          : OccupancyImage::kUnknown;
    }
  return map;
}

}  // namespace sweepkit
