// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "recording_writer.hpp"

#include <png.h>

// jpeglib.h needs FILE and size_t before it.
#include <cstdio>

#include <jpeglib.h>

#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <memory>

#include "sweepkit/core/error.hpp"

namespace sweepkit {
namespace {

namespace fs = std::filesystem;
using Bytes = std::vector<std::uint8_t>;

void append(png_structp png, png_bytep data, png_size_t size) {
  auto* bytes = static_cast<Bytes*>(png_get_io_ptr(png));
  bytes->insert(bytes->end(), data, data + size);
}

[[noreturn]] void fail(png_structp, png_const_charp message) {
  throw Error(ErrorKind::argument, "encode_png", message);
}

// Rows of grey pixels; 16 bits are stored with the high byte first, as the format wants.
template <class Pixel>
Bytes png_bytes(View2d<const Pixel> image) {
  require(!image.empty(), "encode_png image", "must not be empty", image.width);
  Bytes bytes;
  png_structp png = png_create_write_struct(PNG_LIBPNG_VER_STRING, nullptr, fail, nullptr);
  if (!png) throw std::bad_alloc();
  png_infop info = png_create_info_struct(png);
  const auto release = [&](png_structp p) { png_destroy_write_struct(&p, &info); };
  const std::unique_ptr<png_struct, decltype(release)> guard(png, release);
  png_set_write_fn(png, &bytes, append, nullptr);
  png_set_compression_level(png, 1);
  png_set_filter(png, 0, sizeof(Pixel) == 1 ? PNG_FILTER_SUB : PNG_FILTER_UP);
  png_set_IHDR(png, info, static_cast<png_uint_32>(image.width), static_cast<png_uint_32>(image.height),
               8 * sizeof(Pixel), PNG_COLOR_TYPE_GRAY, PNG_INTERLACE_NONE, PNG_COMPRESSION_TYPE_DEFAULT,
               PNG_FILTER_TYPE_DEFAULT);
  png_write_info(png, info);
  Bytes row(static_cast<std::size_t>(image.width) * sizeof(Pixel));
  for (int y = 0; y < image.height; ++y) {
    for (int x = 0; x < image.width; ++x) {
      const auto value = static_cast<unsigned>(image(x, y));
      if constexpr (sizeof(Pixel) == 1)
        row[static_cast<std::size_t>(x)] = static_cast<std::uint8_t>(value);
      else {
        row[2 * static_cast<std::size_t>(x)] = static_cast<std::uint8_t>(value >> 8);
        row[2 * static_cast<std::size_t>(x) + 1] = static_cast<std::uint8_t>(value & 255);
      }
    }
    png_write_row(png, row.data());
  }
  png_write_end(png, nullptr);
  return bytes;
}

[[noreturn]] void cannot_write(const fs::path& file, int error) {
  throw Error(ErrorKind::io, file.string(), std::string("cannot be written: ") + std::strerror(error));
}

}  // namespace

std::vector<std::uint8_t> encode_png(GrayView image) { return png_bytes(image); }
std::vector<std::uint8_t> encode_png(View2d<const std::uint16_t> image) { return png_bytes(image); }

std::vector<std::uint8_t> encode_jpeg(GrayView image, int quality) {
  require(!image.empty(), "encode_jpeg image", "must not be empty", image.width);
  require(quality >= 1 && quality <= 100, "encode_jpeg quality", "must be in [1, 100]", quality);
  jpeg_compress_struct jpeg{};
  jpeg_error_mgr errors{};
  jpeg.err = jpeg_std_error(&errors);
  // Compression into memory of a valid image fails only when memory does.
  errors.error_exit = [](j_common_ptr) { throw std::bad_alloc(); };
  jpeg_create_compress(&jpeg);
  unsigned char* buffer = nullptr;
  unsigned long size = 0;
  jpeg_mem_dest(&jpeg, &buffer, &size);
  jpeg.image_width = static_cast<JDIMENSION>(image.width);
  jpeg.image_height = static_cast<JDIMENSION>(image.height);
  jpeg.input_components = 1;
  jpeg.in_color_space = JCS_GRAYSCALE;
  jpeg_set_defaults(&jpeg);
  jpeg_set_quality(&jpeg, quality, TRUE);
  jpeg_start_compress(&jpeg, TRUE);
  for (int y = 0; y < image.height; ++y) {
    JSAMPROW row = const_cast<JSAMPROW>(image.row(y));
    jpeg_write_scanlines(&jpeg, &row, 1);
  }
  jpeg_finish_compress(&jpeg);
  jpeg_destroy_compress(&jpeg);
  Bytes bytes(buffer, buffer + size);
  std::free(buffer);
  return bytes;
}

FolderWriter::FolderWriter(fs::path folder, std::string mark)
    : folder_(std::move(folder)), mark_(std::move(mark)) {
  if (folder_.filename().empty()) folder_ = folder_.parent_path();
  if (folder_.empty()) throw Error(ErrorKind::option, "save_path", "is needed: --out DIR");
  std::error_code error;
  if (fs::exists(folder_, error) && !fs::exists(folder_ / mark_, error) &&
      !(fs::is_directory(folder_, error) && fs::is_empty(folder_, error)))
    throw Error(ErrorKind::io, folder_.string(), "exists and is no simulated recording: it is left as it is");
  partial_ = folder_;
  partial_ += ".partial";
  fs::remove_all(partial_, error);
  fs::create_directories(partial_, error);
  if (error) cannot_write(partial_, error.value());
}

FolderWriter::~FolderWriter() {
  std::error_code error;
  if (!finished_) fs::remove_all(partial_, error);
}

void FolderWriter::make_folder(const fs::path& name) const {
  std::error_code error;
  fs::create_directories(partial_ / name, error);
  if (error) cannot_write(partial_ / name, error.value());
}

void FolderWriter::write(const fs::path& name, std::string_view bytes) const {
  const fs::path file = partial_ / name;
  std::FILE* stream = std::fopen(file.c_str(), "wb");
  if (!stream) cannot_write(file, errno);
  errno = 0;
  const bool written = std::fwrite(bytes.data(), 1, bytes.size(), stream) == bytes.size();
  const int error = errno;
  const bool closed = std::fclose(stream) == 0;
  if (!written || !closed) cannot_write(file, written ? errno : error);
}

void FolderWriter::write(const fs::path& name, const std::vector<std::uint8_t>& bytes) const {
  write(name, std::string_view(reinterpret_cast<const char*>(bytes.data()), bytes.size()));
}

void FolderWriter::finish() {
  std::error_code error;
  fs::path old = folder_;
  old += ".old";
  const bool replaces = fs::exists(folder_, error);
  if (replaces) {
    fs::remove_all(old, error);
    fs::rename(folder_, old, error);
    if (error) cannot_write(folder_, error.value());
  }
  fs::rename(partial_, folder_, error);
  if (error) {
    const int reason = error.value();
    if (replaces) fs::rename(old, folder_, error);
    cannot_write(folder_, reason);
  }
  finished_ = true;
  if (replaces) fs::remove_all(old, error);
}

}  // namespace sweepkit
