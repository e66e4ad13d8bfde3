// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/data/image_file.hpp"

#include <catch2/catch.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "data/error_text.hpp"
#include "scratch_folder.hpp"
#include "sweepkit/core/random.hpp"

using namespace sweepkit;

#ifdef __SANITIZE_THREAD__
// GDAL, which OpenCV's other formats start, takes two locks of its own in either order while it is being set
// up.
extern "C" const char* __tsan_default_suppressions() { return "deadlock:libgdal\n"; }
#endif

namespace {

cv::Mat texture(int width, int height, int type = CV_8UC1) {
  Random random(static_cast<std::uint64_t>(width + height));
  cv::Mat image(height, width, type);
  for (int y = 0; y < height; ++y)
    for (std::size_t x = 0; x < width * image.elemSize(); ++x)
      image.ptr(y)[x] = static_cast<std::uint8_t>(random() >> 56);
  cv::GaussianBlur(image, image, {0, 0}, 1.5);
  return image;
}

int largest_difference(const SharedGray& image, const cv::Mat& expected) {
  REQUIRE(image.view.width == expected.cols);
  REQUIRE(image.view.height == expected.rows);
  int largest = 0;
  for (int y = 0; y < expected.rows; ++y)
    for (int x = 0; x < expected.cols; ++x)
      largest = std::max(largest, std::abs(image.view(x, y) - expected.at<std::uint8_t>(y, x)));
  return largest;
}

std::string bytes_of(const std::string& suffix, const cv::Mat& image) {
  std::vector<std::uint8_t> bytes;
  REQUIRE(cv::imencode(suffix, image, bytes));
  return {bytes.begin(), bytes.end()};
}

}  // namespace

TEST_CASE("grey images are decoded as OpenCV decodes them, of any format") {
  const ScratchFolder folder;
  const cv::Mat image = texture(123, 45);
  for (const char* suffix : {".jpg", ".png", ".pgm", ".bmp", ".tiff", ".webp"}) {
    INFO(suffix);
    const auto file = folder.write(std::string("a") + suffix, bytes_of(suffix, image));
    CHECK(largest_difference(read_gray(file), cv::imread(file.string(), cv::IMREAD_GRAYSCALE)) == 0);
    CHECK_NOTHROW(read_gray(file, {123, 45}));
  }
}

TEST_CASE("colour becomes grey, transparency is ignored") {
  const ScratchFolder folder;
  const cv::Mat color = texture(64, 48, CV_8UC3), transparent = texture(64, 48, CV_8UC4);
  for (const char* suffix : {".jpg", ".png", ".bmp"}) {
    INFO(suffix);
    const auto file = folder.write(std::string("a") + suffix, bytes_of(suffix, color));
    CHECK(largest_difference(read_gray(file), cv::imread(file.string(), cv::IMREAD_GRAYSCALE)) <= 1);
  }
  cv::Mat grey;
  cv::cvtColor(transparent, grey, cv::COLOR_BGRA2GRAY);
  CHECK(largest_difference(read_gray(folder.write("t.png", bytes_of(".png", transparent))), grey) <= 1);
}

TEST_CASE("an image of one bit and a palette are grey as well") {
  const ScratchFolder folder;
  const cv::Mat image = texture(33, 20) > 127;
  std::vector<std::uint8_t> bytes;
  cv::imencode(".png", image, bytes, {cv::IMWRITE_PNG_BILEVEL, 1});
  CHECK(largest_difference(read_gray(folder.write("b.png", {bytes.begin(), bytes.end()})), image) == 0);
}

TEST_CASE("a truncated image is refused wherever it was cut") {
  const ScratchFolder folder;
  const cv::Mat image = texture(160, 120);
  for (const char* suffix : {".jpg", ".png", ".pgm", ".bmp"}) {
    const std::string bytes = bytes_of(suffix, image);
    for (std::size_t length = 0; length < bytes.size(); length += bytes.size() / 13 + 1) {
      INFO(suffix << " cut to " << length << " of " << bytes.size());
      const auto file = folder.write(std::string("cut") + suffix, bytes.substr(0, length));
      CHECK(error_text([&] { read_gray(file); }).find("data: " + file.string()) == 0);
    }
  }
}

TEST_CASE("a damaged image does no harm") {
  const ScratchFolder folder;
  Random random(12);
  const cv::Mat image = texture(80, 60);
  for (const char* suffix : {".jpg", ".png", ".pgm"}) {
    const std::string good = bytes_of(suffix, image);
    for (int trial = 0; trial < 150; ++trial) {
      std::string bytes = good;
      for (int k = 0; k < 3; ++k) bytes[random.index(bytes.size())] = static_cast<char>(random());
      const auto file = folder.write("damaged", bytes);
      // Either it is an image still or an Error says why not.
      error_text([&] { read_gray(file, {80, 60}); });
    }
  }
}

TEST_CASE("an image of the wrong size or depth, or none at all, is refused with the file named") {
  const ScratchFolder folder;
  const auto file = folder.write("a.png", bytes_of(".png", texture(32, 24)));
  CHECK(error_text([&] {
          read_gray(file, {32, 25});
        }) == "data: " + file.string() + ": the image must be 32x25 pixels (got 32x24)");
  for (const char* suffix : {".png", ".pgm", ".tiff"}) {
    const cv::Mat deep(24, 32, CV_16UC1, cv::Scalar(1000));
    const auto deep_file = folder.write(std::string("deep") + suffix, bytes_of(suffix, deep));
    CHECK(error_text([&] {
            read_gray(deep_file);
          }).find("data: " + deep_file.string() + ": must have 8 bits a channel") == 0);
  }
  CHECK(error_text([&] { read_gray(folder.write("t.png", "no image at all")); }).find("data: ") == 0);
  CHECK(error_text([&] { read_gray(folder.write("e.png", "")); }).find("is empty") != std::string::npos);
  CHECK(error_text([&] { read_gray(folder / "none.png"); }).find("io: ") == 0);
  CHECK(error_text([&] { read_gray(folder.path()); }).find("io: ") == 0);
}

TEST_CASE("no memory is taken on a file's word") {
  const ScratchFolder folder;
  // A few bytes that announce an image of 60000 x 60000.
  const auto pgm = folder.write("a.pgm", "P5\n60000 60000\n255\nxyz");
  CHECK(error_text([&] {
          read_gray(pgm);
        }).find("cannot hold the image that it announces (got 60000x60000)") != std::string::npos);
  std::string png = bytes_of(".png", texture(16, 16));
  png[18] = png[22] = '\x7f';  // width and height in IHDR; the checksum no longer fits either
  CHECK(error_text([&] { read_gray(folder.write("a.png", png)); }).find("data: ") == 0);
  std::string jpeg = bytes_of(".jpg", texture(16, 16));
  const std::size_t frame = jpeg.find("\xff\xc0");
  REQUIRE(frame != std::string::npos);
  jpeg[frame + 5] = jpeg[frame + 7] = '\x7f';
  CHECK(error_text([&] { read_gray(folder.write("a.jpg", jpeg)); }).find("cannot hold") != std::string::npos);
}

TEST_CASE("a written PNG reads back, padded rows too") {
  const ScratchFolder folder;
  const cv::Mat image = texture(50, 40);
  const GrayView part(image.ptr(5) + 3, 20, 30, static_cast<std::ptrdiff_t>(image.step));
  write_png(folder / "p.png", part);
  CHECK(largest_difference(read_gray(folder / "p.png"), image(cv::Rect(3, 5, 20, 30))) == 0);
  CHECK(error_text([&] { write_png("/nowhere/p.png", part); }).find("io: /nowhere/p.png") == 0);
}
