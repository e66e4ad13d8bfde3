// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
//
// Quality and time of sweepkit's ORB beside cv::ORB, 1000 key points, one thread.
//
//   orb_quality [--count N] [--set option=value ...]
//
// Quality: opencv-doc's graf1 and graf3 with their homography. A key point of graf1 repeats if a key point of
// graf3 lies within the radius of where the homography takes it; only those count that the homography takes
// into the other image. Repeatability: repeated ones over the smaller of the two images' numbers in the
// overlap (at 1, 2 and 3 px), and over graf1's number (at 3 px). Matching score: mutual nearest neighbours of
// the descriptors that are right within 3 px, over the smaller number. Spread: share of 40 px cells of the
// image that hold a key point. Time: median of 40 runs (processor time, as other programs may run) on 640x400
// crops of opencv-doc's images, mean over the images; frames of sweephome dev01 are added where SWEEPKIT_DATA
// is set. Ours builds its pyramid within the time.
#include <time.h>

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <functional>
#include <opencv2/core.hpp>
#include <opencv2/features2d.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <set>
#include <string>
#include <vector>

#include "sweepkit/feature/orb.hpp"

namespace {

using Extract = std::function<void(const cv::Mat&, sweepkit::Features<256>&)>;

sweepkit::GrayView view(const cv::Mat& m) {
  return {m.data, m.cols, m.rows, static_cast<std::ptrdiff_t>(m.step)};
}

cv::Point2d through(const cv::Matx33d& H, double x, double y) {
  const cv::Vec3d p = H * cv::Vec3d(x, y, 1);
  return {p[0] / p[2], p[1] / p[2]};
}

bool inside(cv::Point2d p, const cv::Mat& image) {
  return p.x >= 0 && p.y >= 0 && p.x <= image.cols - 1 && p.y <= image.rows - 1;
}

double spread(const sweepkit::Features<256>& f, const cv::Mat& image) {
  constexpr int kCell = 40;
  std::set<std::pair<int, int>> cells;
  for (const auto& k : f.keypoints)
    cells.insert({static_cast<int>(k.x) / kCell, static_cast<int>(k.y) / kCell});
  return static_cast<double>(cells.size()) /
         (((image.cols + kCell - 1) / kCell) * ((image.rows + kCell - 1) / kCell));
}

struct Quality {
  double repeatability[3];  // at 1, 2 and 3 px
  double repeated_of_first;
  double matching_score;
  double error_px;  // median of right matches
  double spread;
};

Quality quality(const Extract& extract, const cv::Mat& a, const cv::Mat& b, const cv::Matx33d& H_b_a) {
  const cv::Matx33d H_a_b = H_b_a.inv();
  sweepkit::Features<256> fa, fb;
  extract(a, fa);
  extract(b, fb);
  std::vector<cv::Point2d> a_in_b(fa.size());
  std::vector<int> common_a, common_b;
  for (std::size_t i = 0; i < fa.size(); ++i) {
    a_in_b[i] = through(H_b_a, fa.keypoints[i].x, fa.keypoints[i].y);
    if (inside(a_in_b[i], b)) common_a.push_back(static_cast<int>(i));
  }
  for (std::size_t i = 0; i < fb.size(); ++i)
    if (inside(through(H_a_b, fb.keypoints[i].x, fb.keypoints[i].y), a))
      common_b.push_back(static_cast<int>(i));
  const auto error = [&](int i, int j) {
    return std::hypot(a_in_b[i].x - fb.keypoints[j].x, a_in_b[i].y - fb.keypoints[j].y);
  };
  Quality q{};
  for (const int i : common_a) {
    double nearest = 1e9;
    for (const int j : common_b) nearest = std::min(nearest, error(i, j));
    for (int r = 0; r < 3; ++r) q.repeatability[r] += nearest <= r + 1;
  }
  const auto smaller =
      static_cast<double>(std::max<std::size_t>(1, std::min(common_a.size(), common_b.size())));
  q.repeated_of_first = q.repeatability[2] / static_cast<double>(std::max<std::size_t>(1, common_a.size()));
  for (double& r : q.repeatability) r /= smaller;
  const auto best = [](const sweepkit::Features<256>& f, int i, const sweepkit::Features<256>& g,
                       const std::vector<int>& among) {
    int found = -1, distance = 257;
    for (const int j : among) {
      const int d = sweepkit::hamming_distance(f.descriptors[i], g.descriptors[j]);
      if (d < distance) distance = d, found = j;
    }
    return found;
  };
  std::vector<double> errors;
  for (const int i : common_a) {
    const int j = best(fa, i, fb, common_b);
    if (j >= 0 && error(i, j) <= 3 && best(fb, j, fa, common_a) == i) errors.push_back(error(i, j));
  }
  q.matching_score = static_cast<double>(errors.size()) / smaller;
  if (!errors.empty()) {
    std::nth_element(errors.begin(), errors.begin() + errors.size() / 2, errors.end());
    q.error_px = errors[errors.size() / 2];
  }
  q.spread = spread(fa, a);
  return q;
}

double processor_ms() {
  timespec t{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
  return 1e3 * static_cast<double>(t.tv_sec) + 1e-6 * static_cast<double>(t.tv_nsec);
}

double median_ms(const std::function<void()>& run) {
  std::vector<double> times;
  for (int i = 0; i < 45; ++i) {
    const double start = processor_ms();
    run();
    if (i >= 5) times.push_back(processor_ms() - start);
  }
  std::nth_element(times.begin(), times.begin() + times.size() / 2, times.end());
  return times[times.size() / 2];
}

/// The middle of an image at 640x400: resized to cover that, then cropped.
cv::Mat to_640x400(const cv::Mat& image) {
  const double scale = std::max(640.0 / image.cols, 400.0 / image.rows);
  cv::Mat resized;
  cv::resize(image, resized,
             cv::Size(std::max(640, cvRound(image.cols * scale)), std::max(400, cvRound(image.rows * scale))),
             0, 0, scale < 1 ? cv::INTER_AREA : cv::INTER_LINEAR);
  return resized(cv::Rect((resized.cols - 640) / 2, (resized.rows - 400) / 2, 640, 400)).clone();
}

void set_option(sweepkit::OrbOptions& options, const std::string& path, double value) {
  for (const auto& option : sweepkit::list_options(options)) {
    if (option.path != path) continue;
    if (auto* const* i = std::get_if<int*>(&option.pointer)) **i = static_cast<int>(value);
    if (auto* const* d = std::get_if<double*>(&option.pointer)) **d = value;
    if (auto* const* b = std::get_if<bool*>(&option.pointer)) **b = value != 0;
    return;
  }
  throw sweepkit::Error(sweepkit::ErrorKind::option, path, "no such option");
}

}  // namespace

int main(int argc, char** argv) try {
  cv::setNumThreads(1);
  sweepkit::OrbOptions options;
  for (int i = 1; i + 1 < argc; i += 2) {
    const std::string name = argv[i], text = argv[i + 1];
    const std::size_t equals = text.find('=');
    if (name == "--count")
      set_option(options, "count", std::stod(text));
    else if (name == "--set" && equals != std::string::npos)
      set_option(options, text.substr(0, equals), std::stod(text.substr(equals + 1)));
    else
      throw sweepkit::Error(sweepkit::ErrorKind::option, "orb_quality", "unknown argument", name);
  }
  const std::filesystem::path folder = "/usr/share/doc/opencv-doc/examples/data";
  const auto read = [&](const std::filesystem::path& file) {
    const cv::Mat image = cv::imread(file.string(), cv::IMREAD_GRAYSCALE);
    if (image.empty()) throw sweepkit::Error(sweepkit::ErrorKind::io, file.string(), "cannot be read");
    return image;
  };
  const cv::Mat graf1 = read(folder / "graf1.png"), graf3 = read(folder / "graf3.png");
  cv::Mat H;
  cv::FileStorage((folder / "H1to3p.xml").string(), cv::FileStorage::READ)["H13"] >> H;
  if (H.empty()) throw sweepkit::Error(sweepkit::ErrorKind::data, "H1to3p.xml", "has no matrix H13");
  H.convertTo(H, CV_64F);

  sweepkit::OrbExtractor ours(options);
  const Extract by_ours = [&](const cv::Mat& m, sweepkit::Features<256>& f) { ours.extract(view(m), f); };
  const auto rival = cv::ORB::create(options.count, 1.2f, 8, 31, 0, 2, cv::ORB::FAST_SCORE);
  std::vector<cv::KeyPoint> keypoints;
  cv::Mat descriptors;
  const Extract by_opencv = [&](const cv::Mat& m, sweepkit::Features<256>& f) {
    rival->detectAndCompute(m, cv::noArray(), keypoints, descriptors);
    f.keypoints.resize(keypoints.size());
    f.descriptors.resize(keypoints.size());
    for (std::size_t i = 0; i < keypoints.size(); ++i) {
      f.keypoints[i].x = keypoints[i].pt.x;
      f.keypoints[i].y = keypoints[i].pt.y;
      std::memcpy(&f.descriptors[i], descriptors.ptr(static_cast<int>(i)), 32);
    }
  };
  std::printf(
      "graf1-graf3  repeatability 1 px  2 px  3 px  of graf1's  matching score  median error  spread\n");
  for (const auto& [name, extract] : {std::pair{"sweepkit", &by_ours}, {"cv::ORB", &by_opencv}}) {
    const Quality q = quality(*extract, graf1, graf3, cv::Matx33d(H));
    std::printf("%-11s %16.1f %% %4.1f %% %4.1f %% %8.1f %% %13.1f %% %10.2f px %6.1f %%\n", name,
                100 * q.repeatability[0], 100 * q.repeatability[1], 100 * q.repeatability[2],
                100 * q.repeated_of_first, 100 * q.matching_score, q.error_px, 100 * q.spread);
  }

  std::vector<std::pair<std::string, cv::Mat>> images;
  for (const char* name :
       {"graf1.png", "box_in_scene.png", "messi5.jpg", "fruits.jpg", "aloeL.jpg", "left01.jpg", "home.jpg"})
    if (std::filesystem::exists(folder / name)) images.emplace_back(name, to_640x400(read(folder / name)));
  const std::size_t averaged = images.size();
  if (const char* data = std::getenv("SWEEPKIT_DATA")) {
    std::vector<std::filesystem::path> frames;
    const std::filesystem::path dev01 = std::filesystem::path(data) / "sweephome/dev01/mav0/cam0/data";
    if (std::filesystem::exists(dev01))
      for (const auto& entry : std::filesystem::directory_iterator(dev01)) frames.push_back(entry.path());
    std::sort(frames.begin(), frames.end());
    for (std::size_t i = 0; i < frames.size(); i += std::max<std::size_t>(1, frames.size() / 4))
      images.emplace_back("dev01 " + std::to_string(i), to_640x400(read(frames[i])));
  }
  std::printf("\n640x400            sweepkit             cv::ORB       ratio   spread\n");
  double sum_ours = 0, sum_rival = 0;
  for (std::size_t i = 0; i < images.size(); ++i) {
    const auto& [name, image] = images[i];
    sweepkit::Features<256> f, g;
    const double t = median_ms([&] { by_ours(image, f); });
    const double u =
        median_ms([&] { rival->detectAndCompute(image, cv::noArray(), keypoints, descriptors); });
    by_opencv(image, g);
    std::printf("%-16s %6.3f ms (%4zu) %6.3f ms (%4zu)   %.3f   %.0f %% / %.0f %%\n", name.c_str(), t,
                f.size(), u, keypoints.size(), t / u, 100 * spread(f, image), 100 * spread(g, image));
    if (i < averaged) sum_ours += t, sum_rival += u;
  }
  std::printf("mean of %zu %13.3f ms %13.3f ms          %.3f   (images of opencv-doc)\n", averaged,
              sum_ours / averaged, sum_rival / averaged, sum_ours / sum_rival);
  return 0;
} catch (const std::exception& error) {
  std::fprintf(stderr, "%s\n", error.what());
  return 1;
}
