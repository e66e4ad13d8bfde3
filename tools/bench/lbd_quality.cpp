// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
//
// Matching score of LBD beside line_descriptor's, and the time of both, one thread. Pairs of images whose
// homography is known: opencv-doc's graf1 and graf3, and images of York Urban warped by rotation, scale,
// light and small changes of view. A pair of segments is right if the first, carried into the second image,
// runs within 3 px of it at both ends of what they share, within 5 degrees and to the same side dark, and
// they share at least half of the shorter. Matches are mutual nearest neighbours by Hamming distance; the
// matching score is right matches over the smaller number of segments in the overlap of both images.
// "same segments": both describe the segments of our detector, at one size of the image. "own pyramid": each
// finds and describes segments with its own detector on three octaves.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <functional>
#include <numbers>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <opencv2/line_descriptor.hpp>
#include <stdexcept>
#include <string>
#include <vector>

#include "sweepkit/core/option_text.hpp"
#include "sweepkit/feature/hamming.hpp"
#include "sweepkit/feature/line_extractor.hpp"

namespace {

using namespace sweepkit;
namespace rival = cv::line_descriptor;

GrayView view(const cv::Mat& m) { return {m.data, m.cols, m.rows, static_cast<std::ptrdiff_t>(m.step)}; }

struct Pair {
  std::string kind;
  cv::Mat first, second;
  cv::Matx33d H;  // first to second
};

cv::Point2d carried(const cv::Matx33d& H, double x, double y) {
  const cv::Vec3d p = H * cv::Vec3d(x, y, 1);
  return {p[0] / p[2], p[1] / p[2]};
}

bool lies_in(const LineSegment& s, const cv::Matx33d& H, const cv::Mat& image) {
  for (const auto& p : {carried(H, s.x1, s.y1), carried(H, s.x2, s.y2)})
    if (!(p.x >= 0 && p.y >= 0 && p.x < image.cols && p.y < image.rows)) return false;
  return true;
}

bool right(const LineSegment& a, const LineSegment& b, const cv::Matx33d& H) {
  const cv::Point2d p = carried(H, a.x1, a.y1), q = carried(H, a.x2, a.y2);
  const double length = std::hypot(q.x - p.x, q.y - p.y), other = b.length();
  if (!(length > 0) || !(other > 0)) return false;
  const double ux = (q.x - p.x) / length, uy = (q.y - p.y) / length;
  if ((ux * b.dx() + uy * b.dy()) / other < std::cos(5 * std::numbers::pi / 180)) return false;
  const auto along = [&](double x, double y) { return (x - p.x) * ux + (y - p.y) * uy; };
  const double from = std::max(0.0, along(b.x1, b.y1)), to = std::min(length, along(b.x2, b.y2));
  if (to - from < 0.5 * std::min(length, other)) return false;
  for (const double t : {from, to}) {
    const double x = p.x + t * ux, y = p.y + t * uy;
    if (std::abs((x - b.x1) * b.dy() - (y - b.y1) * b.dx()) / other > 3) return false;
  }
  return true;
}

struct Score {
  long right = 0, matches = 0, smaller = 0;
  void add(const Score& s) { right += s.right, matches += s.matches, smaller += s.smaller; }
};

Score score(const LineFeatures<256>& a, const LineFeatures<256>& b, const Pair& pair) {
  // Only segments in the overlap take part.
  const auto visible = [](const LineFeatures<256>& lines, const cv::Matx33d& H, const cv::Mat& image) {
    LineFeatures<256> chosen;
    for (std::size_t i = 0; i < lines.size(); ++i)
      if (lies_in(lines.segments[i], H, image)) {
        chosen.segments.push_back(lines.segments[i]);
        chosen.descriptors.push_back(lines.descriptors[i]);
      }
    return chosen;
  };
  const auto first = visible(a, pair.H, pair.second), second = visible(b, pair.H.inv(), pair.first);
  Score result;
  result.smaller = static_cast<long>(std::min(first.size(), second.size()));
  if (result.smaller == 0) return result;
  std::vector<std::uint16_t> distances(first.size() * second.size());
  hamming_distance_matrix<256>(first.descriptors, second.descriptors, distances);
  std::vector<std::size_t> best_first(second.size(), 0);
  const auto at = [&](std::size_t i, std::size_t j) { return distances[i * second.size() + j]; };
  for (std::size_t j = 0; j < second.size(); ++j)
    for (std::size_t i = 1; i < first.size(); ++i)
      if (at(i, j) < at(best_first[j], j)) best_first[j] = i;
  for (std::size_t i = 0; i < first.size(); ++i) {
    std::size_t best = 0;
    for (std::size_t j = 1; j < second.size(); ++j)
      if (at(i, j) < at(i, best)) best = j;
    if (best_first[best] != i) continue;
    ++result.matches;
    result.right += right(first.segments[i], second.segments[best], pair.H);
  }
  return result;
}

/// What line_descriptor wants of a segment; it crashes on lines out of the image and on gaps in class_id.
std::vector<rival::KeyLine> to_keylines(const std::vector<LineSegment>& segments, const cv::Mat& image) {
  std::vector<rival::KeyLine> keylines;
  for (const LineSegment& s : segments) {
    rival::KeyLine k;
    const auto x = [&](float v) { return std::clamp(v, 0.0f, static_cast<float>(image.cols - 1)); };
    const auto y = [&](float v) { return std::clamp(v, 0.0f, static_cast<float>(image.rows - 1)); };
    k.startPointX = k.sPointInOctaveX = x(s.x1);
    k.startPointY = k.sPointInOctaveY = y(s.y1);
    k.endPointX = k.ePointInOctaveX = x(s.x2);
    k.endPointY = k.ePointInOctaveY = y(s.y2);
    k.angle = s.angle();
    k.octave = 0;
    k.class_id = static_cast<int>(keylines.size());
    k.lineLength = s.length();
    k.numOfPixels = static_cast<int>(std::max(std::abs(s.dx()), std::abs(s.dy()))) + 1;
    k.pt = {0.5f * (s.x1 + s.x2), 0.5f * (s.y1 + s.y2)};
    k.response = k.lineLength / static_cast<float>(std::max(image.cols, image.rows));
    k.size = std::abs(s.dx() * s.dy());
    keylines.push_back(k);
  }
  return keylines;
}

void copy_codes(const cv::Mat& codes, std::vector<LineDescriptor>& descriptors) {
  descriptors.resize(static_cast<std::size_t>(codes.rows));
  for (int i = 0; i < codes.rows; ++i) std::memcpy(&descriptors[i], codes.ptr(i), 32);
}

std::vector<Pair> make_pairs(const std::filesystem::path& york, int images) {
  std::vector<Pair> pairs;
  const std::filesystem::path doc = "/usr/share/doc/opencv-doc/examples/data";
  Pair graf{"graf1-graf3",
            cv::imread((doc / "graf1.png").string(), cv::IMREAD_GRAYSCALE),
            cv::imread((doc / "graf3.png").string(), cv::IMREAD_GRAYSCALE),
            {}};
  cv::Mat H;
  cv::FileStorage((doc / "H1to3p.xml").string(), cv::FileStorage::READ)["H13"] >> H;
  if (graf.first.empty() || H.empty()) throw std::runtime_error("opencv-doc's graf is missing");
  graf.H = cv::Matx33d(H);
  pairs.push_back(graf);
  if (york.empty()) return pairs;
  std::vector<std::filesystem::path> files;
  for (const auto& entry : std::filesystem::directory_iterator(york / "images"))
    files.push_back(entry.path());
  std::sort(files.begin(), files.end());
  const std::size_t step = std::max<std::size_t>(1, files.size() / static_cast<std::size_t>(images));
  for (std::size_t f = 0; f < files.size(); f += step) {
    const cv::Mat image = cv::imread(files[f].string(), cv::IMREAD_GRAYSCALE);
    const double cx = 0.5 * image.cols, cy = 0.5 * image.rows;
    const cv::Matx33d to_middle(1, 0, -cx, 0, 1, -cy, 0, 0, 1), back(1, 0, cx, 0, 1, cy, 0, 0, 1);
    const auto warp = [&](const std::string& kind, const cv::Matx33d& middle) {
      Pair p{kind, image, {}, back * middle * to_middle};
      // Smoothing before making it smaller, so that it does not alias.
      cv::Mat source = image;
      const double scale = std::sqrt(std::abs(cv::determinant(middle)));
      if (scale < 0.9) cv::GaussianBlur(image, source, {0, 0}, 0.5 / scale);
      cv::warpPerspective(source, p.second, p.H, image.size(), cv::INTER_CUBIC, cv::BORDER_REPLICATE);
      pairs.push_back(p);
    };
    for (const int degrees : {10, 45, 90}) {
      const double c = std::cos(degrees * std::numbers::pi / 180),
                   s = std::sin(degrees * std::numbers::pi / 180);
      warp("rotation " + std::to_string(degrees), {c, -s, 0, s, c, 0, 0, 0, 1});
    }
    for (const double scale : {0.8, 0.65, 0.5}) {
      char name[32];
      std::snprintf(name, sizeof(name), "scale %.2f", scale);
      warp(name, {scale, 0, 0, 0, scale, 0, 0, 0, 1});
    }
    warp("view, small", {0.95, 0.03, 0, -0.02, 0.97, 0, 2e-4, -1e-4, 1});
    warp("view, larger", {0.85, 0.1, 0, -0.06, 0.95, 0, 6e-4, 3e-4, 1});
    const cv::Matx33d one = cv::Matx33d::eye();
    cv::RNG random(f + 1);
    Pair light{"light", image, {}, one};
    image.convertTo(light.second, CV_8U, 0.45, 15);
    cv::Mat noise(image.size(), CV_16S), sum;
    random.fill(noise, cv::RNG::NORMAL, 0, 3);
    light.second.convertTo(sum, CV_16S);
    sum += noise;
    sum.convertTo(light.second, CV_8U);
    pairs.push_back(light);
  }
  return pairs;
}

double best_ms(const std::function<void()>& work, int repeats) {
  double best = 1e9;
  for (int i = 0; i < repeats; ++i) {
    const auto start = std::chrono::steady_clock::now();
    work();
    best = std::min(
        best, std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count());
  }
  return best;
}

}  // namespace

int main(int argc, char** argv) try {
  cv::setNumThreads(1);
  LineOptions options;
  int images = 10;
  for (int i = 1; i < argc; ++i) {
    if (std::strcmp(argv[i], "--set") == 0 && i + 1 < argc)
      set_option(list_options(options), argv[++i], "--set");
    else if (std::strcmp(argv[i], "--images") == 0 && i + 1 < argc)
      images = std::max(1, std::atoi(argv[++i]));
    else {
      std::fprintf(stderr, "usage: [SWEEPKIT_DATA=...] lbd_quality [--images N] [--set option=value]...\n");
      return 2;
    }
  }
  const char* data = std::getenv("SWEEPKIT_DATA");
  if (!data) std::fprintf(stderr, "SWEEPKIT_DATA is not set: without York Urban\n");
  const auto pairs =
      make_pairs(data ? std::filesystem::path(data) / "york_urban" : std::filesystem::path(), images);

  LineOptions single = options;
  single.octaves = 1;
  LineExtractor one_size(single), pyramid(options);
  const auto theirs = rival::BinaryDescriptor::createBinaryDescriptor();
  rival::BinaryDescriptor::Params params;
  params.numOfOctave_ = 3;
  params.reductionRatio = 2;
  const auto theirs_pyramid = rival::BinaryDescriptor::createBinaryDescriptor(params);

  using Extract = std::function<void(const cv::Mat&, LineFeatures<256>&)>;
  const Extract extracts[4] = {
      [&](const cv::Mat& image, LineFeatures<256>& lines) { one_size.extract(view(image), lines); },
      [&](const cv::Mat& image, LineFeatures<256>& lines) {
        one_size.extract(view(image), lines);
        auto keylines = to_keylines(lines.segments, image);
        cv::Mat codes;
        if (!keylines.empty()) theirs->compute(image, keylines, codes);
        if (static_cast<std::size_t>(codes.rows) != lines.size())
          throw std::runtime_error("line_descriptor left segments out");
        copy_codes(codes, lines.descriptors);
      },
      [&](const cv::Mat& image, LineFeatures<256>& lines) { pyramid.extract(view(image), lines); },
      [&](const cv::Mat& image, LineFeatures<256>& lines) {
        lines.clear();
        std::vector<rival::KeyLine> keylines;
        cv::Mat codes;
        theirs_pyramid->detect(image, keylines);
        if (keylines.empty()) return;
        theirs_pyramid->compute(image, keylines, codes);
        for (const auto& k : keylines) {
          LineSegment s;
          s.x1 = k.startPointX, s.y1 = k.startPointY, s.x2 = k.endPointX, s.y2 = k.endPointY;
          s.octave = k.octave;
          lines.segments.push_back(s);
        }
        copy_codes(codes, lines.descriptors);
      }};

  std::vector<std::string> kinds;
  for (const Pair& p : pairs)
    if (std::find(kinds.begin(), kinds.end(), p.kind) == kinds.end()) kinds.push_back(p.kind);
  std::printf("matching score (right of matches)         same segments                        own pyramid\n");
  std::printf(
      "                                  sweepkit     line_descriptor        sweepkit     line_descriptor\n");
  Score total[4];
  for (const std::string& kind : kinds) {
    Score sums[4];
    for (const Pair& p : pairs) {
      if (p.kind != kind) continue;
      for (int e = 0; e < 4; ++e) {
        LineFeatures<256> first, second;
        extracts[e](p.first, first);
        extracts[e](p.second, second);
        const Score s = score(first, second, p);
        sums[e].add(s);
        total[e].add(s);
      }
    }
    std::printf("%-28s", kind.c_str());
    for (const Score& s : sums)
      std::printf("   %5.1f %% (%5.1f %%)", 100.0 * s.right / std::max(1L, s.smaller),
                  100.0 * s.right / std::max(1L, s.matches));
    std::printf("\n");
  }
  std::printf("%-28s", "all");
  for (const Score& s : total)
    std::printf("   %5.1f %% (%5.1f %%)", 100.0 * s.right / std::max(1L, s.smaller),
                100.0 * s.right / std::max(1L, s.matches));

  // Time for the same segments, gradient of the image included; ours also builds its pyramid.
  const cv::Mat image = pairs.front().first;
  LineFeatures<256> lines;
  one_size.extract(view(image), lines);
  std::vector<LineDescriptor> descriptors;
  ImagePyramid single_level;
  const double ours_ms = best_ms(
      [&] {
        single_level.build(view(image), 1, 2.0);
        one_size.describe(single_level, lines.segments, descriptors);
      },
      20);
  auto keylines = to_keylines(lines.segments, image);
  cv::Mat codes;
  const double theirs_ms = best_ms([&] { theirs->compute(image, keylines, codes); }, 5);
  std::printf(
      "\n\ntime for %zu segments of graf1 (%d x %d): sweepkit %.2f ms, line_descriptor %.2f ms, ratio %.1f\n",
      lines.size(), image.cols, image.rows, ours_ms, theirs_ms, theirs_ms / ours_ms);
  return 0;
} catch (const std::exception& error) {
  std::fprintf(stderr, "%s\n", error.what());
  return 1;
}
