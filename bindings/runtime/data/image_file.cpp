// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/data/image_file.hpp"

#include <dlfcn.h>
#include <fmt/format.h>
#include <png.h>

// jpeglib.h needs FILE and size_t before it.
#include <cstdio>

#include <jerror.h>
#include <jpeglib.h>

#include <csetjmp>
#include <cstring>
#include <opencv2/core.hpp>
#include <string>
#include <vector>

#include "sweepkit/core/error.hpp"

namespace sweepkit {
namespace {

using Bytes = std::vector<std::uint8_t>;

Bytes read_bytes(const std::filesystem::path& file) {
  std::FILE* stream = std::fopen(file.c_str(), "rb");
  if (!stream)
    throw Error(ErrorKind::io, file.string(), std::string("cannot be opened: ") + std::strerror(errno));
  Bytes bytes;
  constexpr std::size_t kStep = 1 << 18;
  // Grown by what is really there: a directory or a pipe has no honest length.
  for (std::size_t got = kStep; got == kStep;) {
    const std::size_t size = bytes.size();
    bytes.resize(size + kStep);
    got = std::fread(bytes.data() + size, 1, kStep, stream);
    bytes.resize(size + got);
  }
  const bool failed = std::ferror(stream) != 0;
  std::fclose(stream);
  if (failed) throw Error(ErrorKind::io, file.string(), "cannot be read");
  if (bytes.empty()) throw Error(ErrorKind::data, file.string(), "is empty");
  return bytes;
}

/// Refuses a size that is not wanted, or that so short a file cannot hold: deflate packs at most 1032 to 1,
/// JPEG less.
void check_size(const std::filesystem::path& file, long width, long height, ImageSize expected,
                std::size_t bytes) {
  const std::string size = fmt::format("{}x{}", width, height);
  if (width <= 0 || height <= 0 || width > 65535 || height > 65535)
    throw Error(ErrorKind::data, file.string(), "the size of the image cannot be", size);
  if (expected != ImageSize{} && (width != expected.width || height != expected.height))
    throw Error(ErrorKind::data, file.string(),
                fmt::format("the image must be {}x{} pixels", expected.width, expected.height), size);
  if (static_cast<std::size_t>(width) * height / 2048 > bytes + 512)
    throw Error(ErrorKind::data, file.string(),
                fmt::format("is truncated: {} bytes cannot hold the image that it announces", bytes), size);
}

struct JpegFailure {
  jpeg_error_mgr manager;
  std::jmp_buf jump;
  char message[JMSG_LENGTH_MAX];
};

void on_jpeg_error(j_common_ptr info) {
  auto* failure = reinterpret_cast<JpegFailure*>(info->err);
  info->err->format_message(info, failure->message);
  std::longjmp(failure->jump, 1);
}

void on_jpeg_message(j_common_ptr info, int level) {
  // Level -1 is damaged data, which libjpeg would paper over with grey. Bytes between markers do no harm.
  if (level < 0 && info->err->msg_code != JWRN_EXTRANEOUS_DATA) on_jpeg_error(info);
}

/// The part of the decoding that longjmp may leave: no object with a destructor lives in it.
/// @return false with failure.message set
bool jpeg_header(jpeg_decompress_struct& info, JpegFailure& failure, const Bytes& bytes) {
  if (setjmp(failure.jump)) return false;
  jpeg_mem_src(&info, bytes.data(), bytes.size());
  jpeg_read_header(&info, TRUE);
  return true;
}

bool jpeg_pixels(jpeg_decompress_struct& info, JpegFailure& failure, View2d<std::uint8_t> pixels) {
  if (setjmp(failure.jump)) return false;
  info.out_color_space = JCS_GRAYSCALE;
  jpeg_start_decompress(&info);
  while (info.output_scanline < info.output_height) {
    JSAMPROW row = pixels.row(static_cast<int>(info.output_scanline));
    jpeg_read_scanlines(&info, &row, 1);
  }
  jpeg_finish_decompress(&info);
  return true;
}

SharedGray decode_jpeg(const std::filesystem::path& file, const Bytes& bytes, ImageSize expected) {
  jpeg_decompress_struct info;
  JpegFailure failure;
  info.err = jpeg_std_error(&failure.manager);
  failure.manager.error_exit = on_jpeg_error;
  failure.manager.emit_message = on_jpeg_message;
  failure.message[0] = '\0';
  jpeg_create_decompress(&info);
  struct Closer {
    jpeg_decompress_struct& info;
    ~Closer() { jpeg_destroy_decompress(&info); }
  } closer{info};
  const auto fail = [&] {
    throw Error(ErrorKind::data, file.string(), std::string("is truncated or damaged: ") + failure.message);
  };
  if (!jpeg_header(info, failure, bytes)) fail();
  if (info.jpeg_color_space == JCS_CMYK || info.jpeg_color_space == JCS_YCCK)
    throw Error(ErrorKind::data, file.string(), "is a JPEG in printing colours");
  if (info.data_precision != 8)
    throw Error(ErrorKind::data, file.string(), "must have 8 bits a channel",
                std::to_string(info.data_precision));
  check_size(file, info.image_width, info.image_height, expected, bytes.size());
  NewGray image = make_gray(static_cast<int>(info.image_width), static_cast<int>(info.image_height));
  if (!jpeg_pixels(info, failure, image.pixels)) fail();
  return image.image;
}

struct PngState {
  const Bytes* bytes;
  std::size_t position;
  char message[128];
};

void on_png_error(png_structp png, png_const_charp message) {
  auto* state = static_cast<PngState*>(png_get_error_ptr(png));
  std::snprintf(state->message, sizeof(state->message), "%s", message);
  png_longjmp(png, 1);
}

void on_png_warning(png_structp, png_const_charp) {}

void on_png_read(png_structp png, png_bytep out, png_size_t count) {
  auto* state = static_cast<PngState*>(png_get_io_ptr(png));
  if (count > state->bytes->size() - state->position) png_error(png, "the file ends early");
  std::memcpy(out, state->bytes->data() + state->position, count);
  state->position += count;
}

bool png_header(png_structp png, png_infop info, PngState& state) {
  if (setjmp(png_jmpbuf(png))) return false;
  png_set_read_fn(png, &state, on_png_read);
  png_read_info(png, info);
  return true;
}

bool png_pixels(png_structp png, png_infop info, std::uint8_t** rows) {
  if (setjmp(png_jmpbuf(png))) return false;
  png_set_expand(png);
  if (png_get_color_type(png, info) & PNG_COLOR_MASK_ALPHA || png_get_valid(png, info, PNG_INFO_tRNS))
    png_set_strip_alpha(png);
  if (png_get_color_type(png, info) & PNG_COLOR_MASK_COLOR) png_set_rgb_to_gray_fixed(png, 1, 29900, 58700);
  png_set_interlace_handling(png);
  png_read_update_info(png, info);
  png_read_image(png, rows);
  png_read_end(png, nullptr);
  return true;
}

SharedGray decode_png(const std::filesystem::path& file, const Bytes& bytes, ImageSize expected) {
  PngState state{&bytes, 0, {}};
  struct Closer {
    png_structp png = nullptr;
    png_infop info = nullptr;
    ~Closer() { png_destroy_read_struct(&png, &info, nullptr); }
  } closer;
  closer.png = png_create_read_struct(PNG_LIBPNG_VER_STRING, &state, on_png_error, on_png_warning);
  closer.info = png_create_info_struct(closer.png);
  const auto fail = [&] {
    throw Error(ErrorKind::data, file.string(), std::string("is truncated or damaged: ") + state.message);
  };
  if (!png_header(closer.png, closer.info, state)) fail();
  const int depth = png_get_bit_depth(closer.png, closer.info);
  if (depth > 8)
    throw Error(ErrorKind::data, file.string(), "must have 8 bits a channel", std::to_string(depth));
  const long width = png_get_image_width(closer.png, closer.info);
  const long height = png_get_image_height(closer.png, closer.info);
  check_size(file, width, height, expected, bytes.size());
  NewGray image = make_gray(static_cast<int>(width), static_cast<int>(height));
  std::vector<std::uint8_t*> rows(height);
  for (int y = 0; y < height; ++y) rows[y] = image.pixels.row(y);
  if (!png_pixels(closer.png, closer.info, rows.data())) fail();
  return image.image;
}

SharedGray decode_pgm(const std::filesystem::path& file, const Bytes& bytes, ImageSize expected) {
  std::size_t at = 2;
  const auto number = [&]() -> long {
    while (at < bytes.size() && (std::isspace(bytes[at]) || bytes[at] == '#')) {
      if (bytes[at] == '#')
        while (at < bytes.size() && bytes[at] != '\n') ++at;
      else
        ++at;
    }
    long value = -1;
    for (; at < bytes.size() && std::isdigit(bytes[at]); ++at)
      value = std::min(10 * std::max(value, 0L) + (bytes[at] - '0'), 1000000L);
    return value;
  };
  const long width = number(), height = number(), maximum = number();
  if (maximum > 255)
    throw Error(ErrorKind::data, file.string(), "must have 8 bits a channel",
                fmt::format("maximum {}", maximum));
  if (maximum < 1) throw Error(ErrorKind::data, file.string(), "the header of the PGM is damaged");
  check_size(file, width, height, expected, bytes.size());
  ++at;  // the one white space after the maximum
  const std::size_t count = static_cast<std::size_t>(width) * height;
  if (at > bytes.size() || bytes.size() - at < count)
    throw Error(ErrorKind::data, file.string(),
                fmt::format("is truncated: {} bytes of pixels expected", count),
                std::to_string(bytes.size()));
  NewGray image = make_gray(static_cast<int>(width), static_cast<int>(height));
  std::memcpy(image.pixels.data, bytes.data() + at, count);
  return image.image;
}

/// Any other format. libopencv_imgcodecs pulls in GDAL and a hundred libraries more (measured: 38 MB and 0.1
/// s before main), so it is not linked but opened when first needed, and its one function called by its
/// mangled name.
SharedGray decode_by_opencv(const std::filesystem::path& file, const Bytes& bytes, ImageSize expected) {
  using Decode = cv::Mat (*)(const cv::_InputArray&, int);
  static const Decode decode = [] {
    void* library = dlopen(SWEEPKIT_OPENCV_IMGCODECS, RTLD_NOW | RTLD_LOCAL);
    return library ? reinterpret_cast<Decode>(dlsym(library, "_ZN2cv8imdecodeERKNS_11_InputArrayEi"))
                   : nullptr;
  }();
  if (!decode)
    throw Error(ErrorKind::data, file.string(),
                "is neither JPEG, PNG nor PGM, and " SWEEPKIT_OPENCV_IMGCODECS
                " for other formats is not there");
  cv::Mat mat;
  try {
    constexpr int kUnchanged = -1;  // cv::IMREAD_UNCHANGED
    mat = decode(cv::Mat(1, static_cast<int>(bytes.size()), CV_8U, const_cast<std::uint8_t*>(bytes.data())),
                 kUnchanged);
  } catch (const cv::Exception& exception) {
    throw Error(ErrorKind::data, file.string(),
                std::string("is no image that OpenCV reads: ") + exception.what());
  }
  if (mat.empty()) throw Error(ErrorKind::data, file.string(), "is no image, or a damaged one");
  if (mat.depth() != CV_8U) throw Error(ErrorKind::data, file.string(), "must have 8 bits a channel");
  check_size(file, mat.cols, mat.rows, expected, mat.total());
  NewGray image = make_gray(mat.cols, mat.rows);
  const int channels = mat.channels();
  for (int y = 0; y < mat.rows; ++y) {
    const std::uint8_t* in = mat.ptr(y);
    std::uint8_t* out = image.pixels.row(y);
    for (int x = 0; x < mat.cols; ++x, in += channels)
      out[x] = channels < 3
                   ? in[0]
                   : static_cast<std::uint8_t>((299 * in[2] + 587 * in[1] + 114 * in[0] + 500) / 1000);
  }
  return image.image;
}

}  // namespace

SharedGray read_gray(const std::filesystem::path& file, ImageSize expected) {
  const Bytes bytes = read_bytes(file);
  const auto starts_with = [&](std::initializer_list<int> magic) {
    return bytes.size() >= magic.size() && std::equal(magic.begin(), magic.end(), bytes.begin());
  };
  if (starts_with({0xff, 0xd8})) return decode_jpeg(file, bytes, expected);
  if (starts_with({0x89, 'P', 'N', 'G'})) return decode_png(file, bytes, expected);
  if (starts_with({'P', '5'})) return decode_pgm(file, bytes, expected);
  return decode_by_opencv(file, bytes, expected);
}

void write_png(const std::filesystem::path& file, GrayView image) {
  png_image header{};
  header.version = PNG_IMAGE_VERSION;
  header.width = image.width;
  header.height = image.height;
  header.format = PNG_FORMAT_GRAY;
  if (!png_image_write_to_file(&header, file.c_str(), 0, image.data, static_cast<png_int_32>(image.stride),
                               nullptr))
    throw Error(ErrorKind::io, file.string(), std::string("cannot be written: ") + header.message);
}

}  // namespace sweepkit
