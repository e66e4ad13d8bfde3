// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
//
// Recall and precision of line segments on York Urban beside cv::createLineSegmentDetector with standard
// refinement, and the time of both, one thread.
//
// Every labelled and every detected segment is sampled each pixel. A labelled sample is found if a detected
// segment passes within the lateral tolerance (1 or 2 px) of it, end points included, and its direction is
// within 5 degrees of the label's; recall is the share of labelled samples found. A detected sample is right
// if a labelled segment passes it in the same way; precision is the share of detected samples that are right.
// The labels hold by far not all straight edges, only marked ones that run to one of three vanishing points:
// this precision is low for every detector and says how much is found beside the labels. So a second one is
// printed: the share of detected length that runs within 2 degrees to one of the true vanishing points. Both
// weigh by length, so that cutting a segment in two changes nothing; how whole the segments are tells
// `whole`: the share of labelled segments of which a single detected segment finds at least three quarters.
// Detectors differ in the shortest segments that they report, so all is printed for segments of 0, 15 and 30
// px and longer; and, since who finds more has less precision, the precision at the same recall, reached by
// leaving out the shortest segments of each. False alarms are counted in images of noise.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <functional>
#include <iterator>
#include <map>
#include <numbers>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

#include "sweepkit/core/option_text.hpp"
#include "sweepkit/feature/segments.hpp"

namespace {

using namespace sweepkit;

struct Scene {
  std::string name;
  cv::Mat image;
  std::vector<LineSegment> labels;
  double vanishing_points[3][3];  // homogeneous, in pixels
};

GrayView view(const cv::Mat& m) { return {m.data, m.cols, m.rows, static_cast<std::ptrdiff_t>(m.step)}; }

std::vector<std::string> fields_of(const std::string& line) {
  std::vector<std::string> fields;
  std::stringstream stream(line);
  for (std::string field; std::getline(stream, field, ',');) fields.push_back(field);
  return fields;
}

std::vector<Scene> read_york_urban(const std::filesystem::path& folder) {
  constexpr double kFocal = 674.918, kCx = 306.551, kCy = 250.454;
  std::vector<Scene> scenes;
  std::map<std::string, std::size_t> index;
  std::ifstream directions(folder / "vanishing_points.csv");
  std::string line;
  std::getline(directions, line);
  while (std::getline(directions, line)) {
    const auto f = fields_of(line);
    Scene scene;
    scene.name = f.at(0);
    for (const char* suffix : {".jpg", ".png"})
      if (scene.image.empty())
        scene.image = cv::imread((folder / "images" / (f[0] + suffix)).string(), cv::IMREAD_GRAYSCALE);
    if (scene.image.empty()) throw std::runtime_error("cannot read the image " + f[0]);
    for (int i = 0; i < 3; ++i) {  // the columns orth1 to orth3
      const double x = std::stod(f.at(10 + 3 * i)), y = std::stod(f.at(11 + 3 * i)),
                   z = std::stod(f.at(12 + 3 * i));
      scene.vanishing_points[i][0] = kFocal * x + kCx * z;
      scene.vanishing_points[i][1] = kFocal * y + kCy * z;
      scene.vanishing_points[i][2] = z;
    }
    index[scene.name] = scenes.size();
    scenes.push_back(std::move(scene));
  }
  std::ifstream lines(folder / "lines.csv");
  std::getline(lines, line);
  while (std::getline(lines, line)) {
    const auto f = fields_of(line);
    LineSegment s;
    s.x1 = std::stof(f.at(1)), s.y1 = std::stof(f.at(2)), s.x2 = std::stof(f.at(3)),
    s.y2 = std::stof(f.at(4));
    scenes.at(index.at(f[0])).labels.push_back(s);
  }
  if (scenes.empty()) throw std::runtime_error("no images under " + folder.string());
  return scenes;
}

double angle_between(double ax, double ay, double bx, double by) {  // of lines without direction [degrees]
  return std::atan2(std::abs(ax * by - ay * bx), std::abs(ax * bx + ay * by)) * 180 / std::numbers::pi;
}

struct Found {
  long samples = 0, near = 0;
  long whole = 0, segments = 0;
};

/// Of the samples of `segments`, how many lie on one of `others`.
Found count_found(const std::vector<LineSegment>& segments, const std::vector<LineSegment>& others,
                  double tolerance) {
  Found found;
  std::vector<char> hit;
  for (const LineSegment& s : segments) {
    const int count = std::max(1, static_cast<int>(std::lround(s.length())));
    hit.assign(count, 0);
    int longest = 0;
    for (const LineSegment& o : others) {
      const double length = o.length();
      if (length <= 0 || angle_between(s.dx(), s.dy(), o.dx(), o.dy()) > 5) continue;
      const double ux = o.dx() / length, uy = o.dy() / length;
      int by_this = 0;
      for (int i = 0; i < count; ++i) {
        const double t = (i + 0.5) / count;
        const double x = s.x1 + t * s.dx() - o.x1, y = s.y1 + t * s.dy() - o.y1;
        const double along = x * ux + y * uy;
        if (along < 0 || along > length || std::abs(x * uy - y * ux) > tolerance) continue;
        hit[i] = 1;
        ++by_this;
      }
      longest = std::max(longest, by_this);
    }
    found.samples += count;
    found.near += std::count(hit.begin(), hit.end(), 1);
    found.whole += longest >= 0.75 * count;
    ++found.segments;
  }
  return found;
}

/// Length that runs within 2 degrees to a vanishing point, and all length.
std::pair<double, double> length_to_vanishing_points(const std::vector<LineSegment>& segments,
                                                     const Scene& scene) {
  double right = 0, all = 0;
  for (const LineSegment& s : segments) {
    const double x = 0.5 * (s.x1 + s.x2), y = 0.5 * (s.y1 + s.y2);
    bool good = false;
    for (const auto& v : scene.vanishing_points)
      good = good || angle_between(s.dx(), s.dy(), v[0] - x * v[2], v[1] - y * v[2]) <= 2;
    all += s.length();
    if (good) right += s.length();
  }
  return {right, all};
}

void add(Found& sum, const Found& f) {
  sum.samples += f.samples, sum.near += f.near, sum.whole += f.whole, sum.segments += f.segments;
}

double percent(const Found& f) { return 100.0 * f.near / std::max(1L, f.samples); }

std::vector<LineSegment> at_least(const std::vector<LineSegment>& segments, double length) {
  std::vector<LineSegment> chosen;
  std::copy_if(segments.begin(), segments.end(), std::back_inserter(chosen),
               [&](const LineSegment& s) { return s.length() >= length; });
  return chosen;
}

using Detect = std::function<void(const cv::Mat&, std::vector<LineSegment>&)>;

double time_ms(const Detect& detect, const cv::Mat& image, int repeats) {
  std::vector<LineSegment> segments;
  double best = 1e9;
  for (int i = 0; i < repeats; ++i) {
    const auto start = std::chrono::steady_clock::now();
    detect(image, segments);
    best = std::min(
        best, std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count());
  }
  return best;
}

}  // namespace

int main(int argc, char** argv) try {
  cv::setNumThreads(1);
  SegmentOptions options;
  bool ours_only = false;
  for (int i = 1; i < argc; ++i) {
    if (std::strcmp(argv[i], "--set") == 0 && i + 1 < argc)
      set_option(list_options(options), argv[++i], "--set");
    else if (std::strcmp(argv[i], "--ours") == 0)
      ours_only = true;
    else {
      std::fprintf(stderr, "usage: SWEEPKIT_DATA=... segment_quality [--ours] [--set option=value]...\n");
      return 2;
    }
  }
  const char* data = std::getenv("SWEEPKIT_DATA");
  if (!data) {
    std::fprintf(stderr, "SWEEPKIT_DATA is not set: no images\n");
    return 77;
  }
  const std::vector<Scene> scenes = read_york_urban(std::filesystem::path(data) / "york_urban");

  SegmentDetector detector(options);
  const auto lsd = cv::createLineSegmentDetector(cv::LSD_REFINE_STD);
  std::vector<cv::Vec4f> lines;
  std::vector<std::pair<std::string, Detect>> detectors;
  detectors.emplace_back("sweepkit", [&](const cv::Mat& image, std::vector<LineSegment>& segments) {
    detector.detect(view(image), segments);
  });
  if (!ours_only)
    detectors.emplace_back("cv LSD, standard", [&](const cv::Mat& image, std::vector<LineSegment>& segments) {
      lsd->detect(image, lines);
      segments.clear();
      for (const cv::Vec4f& l : lines) {
        LineSegment s;
        s.x1 = l[0], s.y1 = l[1], s.x2 = l[2], s.y2 = l[3];
        segments.push_back(s);
      }
    });

  std::printf(
      "York Urban, %zu images       recall       precision     to vanishing   whole   segments    length\n",
      scenes.size());
  std::printf(
      "                   from   1 px  2 px    1 px   2 px      points         2 px   an image   an image\n");
  std::vector<std::vector<std::vector<LineSegment>>> found(detectors.size());
  for (std::size_t d = 0; d < detectors.size(); ++d) {
    const auto& [name, detect] = detectors[d];
    auto& all = found[d];
    all.resize(scenes.size());
    for (std::size_t i = 0; i < scenes.size(); ++i) detect(scenes[i].image, all[i]);
    for (const int least : {0, 15, 30}) {
      Found recall[2], precision[2];
      double right = 0, length = 0;
      std::size_t count = 0;
      for (std::size_t i = 0; i < scenes.size(); ++i) {
        const auto segments = at_least(all[i], least);
        count += segments.size();
        for (int t = 0; t < 2; ++t) {
          add(recall[t], count_found(scenes[i].labels, segments, 1.0 + t));
          add(precision[t], count_found(segments, scenes[i].labels, 1.0 + t));
        }
        const auto [r, a] = length_to_vanishing_points(segments, scenes[i]);
        right += r, length += a;
      }
      std::printf("%-16s %3d px  %5.1f %5.1f   %5.1f  %5.1f %%   %6.1f %%     %5.1f %%  %7.1f  %8.0f px\n",
                  name.c_str(), least, percent(recall[0]), percent(recall[1]), percent(precision[0]),
                  percent(precision[1]), 100 * right / length, 100.0 * recall[1].whole / recall[1].segments,
                  static_cast<double>(count) / scenes.size(), length / scenes.size());
    }
  }

  std::printf("\nprecision at the same recall, 2 px (- where it is not reached):");
  for (int r = 40; r <= 75; r += 5) std::printf("%8d %%", r);
  for (std::size_t d = 0; d < detectors.size(); ++d) {
    std::printf("\n%-16s", detectors[d].first.c_str());
    std::vector<std::pair<double, double>> curve;  // recall, precision; recall falls
    for (int least = 0; least <= 70; least += 2) {
      Found recall, precision;
      for (std::size_t i = 0; i < scenes.size(); ++i) {
        const auto segments = at_least(found[d][i], least);
        add(recall, count_found(scenes[i].labels, segments, 2.0));
        add(precision, count_found(segments, scenes[i].labels, 2.0));
      }
      curve.emplace_back(percent(recall), percent(precision));
    }
    std::printf("%46s", "");
    for (int r = 40; r <= 75; r += 5) {
      std::size_t k = 0;
      while (k + 1 < curve.size() && curve[k + 1].first >= r) ++k;
      if (curve[0].first < r || k + 1 == curve.size()) {
        std::printf("%10s", "-");
        continue;
      }
      const double part = (curve[k].first - r) / (curve[k].first - curve[k + 1].first);
      std::printf("%8.1f %%", curve[k].second + part * (curve[k + 1].second - curve[k].second));
    }
  }

  std::printf("\n\nsegments found in noise, mean of 20 images 640x480: ");
  cv::RNG random(7);
  std::vector<cv::Mat> noise(20);
  for (cv::Mat& image : noise) {
    image.create(480, 640, CV_8U);
    random.fill(image, cv::RNG::NORMAL, 128, 20);
  }
  std::vector<LineSegment> segments;
  for (const auto& [name, detect] : detectors) {
    std::size_t count = 0;
    for (const cv::Mat& image : noise) detect(image, segments), count += segments.size();
    std::printf("%s %.1f  ", name.c_str(), count / 20.0);
  }
  std::printf("\ntime, best of 5, mean of the images 640x480:");
  for (const auto& [name, detect] : detectors) {
    double sum = 0;
    for (const Scene& scene : scenes) sum += time_ms(detect, scene.image, 5);
    std::printf(" %s %.2f ms ", name.c_str(), sum / scenes.size());
  }
  std::printf("\n");
  return 0;
} catch (const std::exception& error) {
  std::fprintf(stderr, "%s\n", error.what());
  return 1;
}
