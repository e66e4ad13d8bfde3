// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
// line_accuracy RECORDING...: line segments of a recording against its truth.
//
// Left to right: the disparity of each matched segment at five places along it, against true depth. Where
// depth varies by over 3 % within 2 px of a place, an edge may belong to any surface there: the nearest of
// these disparities counts, and such segments are told apart. A match is wrong if the median of its five
// errors exceeds 1.5 px.
// "across" is the distance of the middle of the triangulated segment from the true point, taken across the
// segment, in units of what its covariance says (1.2 is right for two normal components).
//
// Frame to frame: triangulated segments of one image are looked for in the third image after it, with a prior
// that is wrong by 1 degree and 2 cm; a match is right if the segment lies within 2.5 px of where the true
// motion puts its line.
// A recording needs `depth0` (16-bit z-depth of the raw left camera in 0.1 mm, 0: none) and a truth.
#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <ctime>
#include <deque>
#include <filesystem>
#include <numbers>
#include <opencv2/imgcodecs.hpp>
#include <optional>
#include <string>
#include <vector>

#include "sweepkit/core/error.hpp"
#include "sweepkit/core/option_text.hpp"
#include "sweepkit/core/random.hpp"
#include "sweepkit/data/recording.hpp"
#include "sweepkit/data/trajectory.hpp"
#include "sweepkit/feature/line_extractor.hpp"
#include "sweepkit/match/lines.hpp"

namespace {

using namespace sweepkit;
namespace fs = std::filesystem;

constexpr double kDepthUnit = 1e-4;  // m

struct TrueDisparity {
  double error;  // of the given disparity [px]
  bool flat;
  Vec3<double> point;  // in the rectified left camera
};

std::optional<TrueDisparity> compare(const StereoRig& rig, const cv::Mat& depth, double u, double v,
                                     double disparity) {
  const auto pixel = rig.unrectify(Side::left, {u, v});
  if (!pixel) return std::nullopt;
  const int x = static_cast<int>(std::lround(pixel->x())), y = static_cast<int>(std::lround(pixel->y()));
  if (x < 2 || y < 2 || x >= depth.cols - 2 || y >= depth.rows - 2) return std::nullopt;
  double low, high;
  cv::minMaxIdx(depth(cv::Rect(x - 2, y - 2, 5, 5)), &low, &high);
  if (low <= 0) return std::nullopt;
  const auto ray = rig.camera(Side::left).unproject(*pixel);
  if (!ray) return std::nullopt;
  TrueDisparity best{1e9, high - low <= 0.03 * high, Vec3<double>::Zero()};
  const int reach = best.flat ? 0 : 2;
  for (int j = -reach; j <= reach; ++j)
    for (int i = -reach; i <= reach; ++i) {
      const double z = kDepthUnit * depth.at<std::uint16_t>(y + j, x + i);
      const Vec3<double> p = rig.R_camera_raw(Side::left) * (z * *ray);
      const double error = disparity - rig.focal() * rig.baseline() / p.z();
      if (std::abs(error) < std::abs(best.error)) best.error = error, best.point = p;
    }
  return best;
}

/// Processor time of this thread; readers work beside it.
double thread_us() {
  timespec t{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
  return 1e6 * static_cast<double>(t.tv_sec) + 1e-3 * static_cast<double>(t.tv_nsec);
}

double quantile(std::vector<double> values, double share) {
  if (values.empty()) return 0;
  const auto at =
      values.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

struct Seen {
  std::optional<SE3d> T_world_camera;
  std::vector<Segment3d> segments;
  std::vector<LineDescriptor> descriptors;
  std::vector<std::int32_t> octaves;
};

double percent(long part, long whole) {
  return 100.0 * static_cast<double>(part) / static_cast<double>(std::max(1L, whole));
}

void run(const char* folder, const LineStereoOptions& stereo_options) {
  RecordingOptions options;
  options.use_imu = options.use_wheels = false;
  const auto recording = open_recording(folder, options);
  const Trajectory truth = read_trajectory(recording->info().truth);
  const StereoRig rig = recording->rig().stereo();
  const RectifiedCamera camera{rig.focal(), rig.center().x(), rig.center().y(), rig.baseline()};
  LineExtractor extractor;
  LineStereoMatcher stereo(rig, stereo_options);
  LineProjectionMatcher by_prior;
  LineFeatures<256> left, right;
  std::vector<LineStereoMatch> matches;
  std::vector<Match> found;
  std::deque<Seen> past;
  Random random(1);
  std::vector<double> errors[2], across, times;
  long images = 0, segments = 0, paired = 0, judged = 0, wrong = 0, queries = 0, tracked = 0,
       right_tracks = 0;
  while (const auto sample = recording->next()) {
    const auto* image = std::get_if<StereoImage>(&*sample);
    if (!image || image->left.empty() || image->right.empty()) continue;
    const fs::path file = recording->info().path / "depth0" / "data" / (std::to_string(image->t) + ".png");
    cv::Mat depth;
    if (fs::exists(file)) depth = cv::imread(file.string(), cv::IMREAD_UNCHANGED);
    if (!depth.empty() && depth.type() != CV_16U)
      throw Error(ErrorKind::data, file.string(), "is no 16-bit image");
    extractor.extract(image->left.view, left);
    extractor.extract(image->right.view, right);
    const double start = thread_us();
    paired += stereo.match(left, right, matches);
    times.push_back(thread_us() - start);
    ++images;
    segments += static_cast<long>(left.size());

    Seen seen;
    if (const auto T = interpolate(truth, image->t)) seen.T_world_camera = *T * rig.T_body_camera();
    std::vector<Segment2d> rectified;
    std::vector<std::int32_t> octaves;
    for (std::size_t i = 0; i < matches.size(); ++i) {
      const LineStereoMatch& m = matches[i];
      rectified.push_back(m.left);
      octaves.push_back(left.segments[i].octave);
      if (!m.found()) continue;
      std::vector<double> own;
      bool flat = true;
      for (const double t : {0.1, 0.3, 0.5, 0.7, 0.9}) {
        if (depth.empty()) break;
        const auto found_here = compare(rig, depth, m.left.u1 + t * m.left.du(), m.left.v1 + t * m.left.dv(),
                                        m.disparity1 + t * (m.disparity2 - m.disparity1));
        if (!found_here) continue;
        flat = flat && found_here->flat;
        own.push_back(found_here->error);
      }
      const auto segment = stereo.triangulate(m);
      if (own.size() >= 3) {
        ++judged;
        const double error = quantile(own, 0.5);
        errors[flat ? 0 : 1].push_back(error);
        const bool bad = std::abs(error) > 1.5;
        wrong += bad;
        const auto middle =
            compare(rig, depth, m.left.u1 + 0.5 * m.left.du(), m.left.v1 + 0.5 * m.left.dv(), 0);
        if (segment && middle && flat && !bad) {
          const Vec3<double> d = segment->direction(), u = d.unitOrthogonal(), v = d.cross(u);
          Eigen::Matrix<double, 2, 3> basis;
          basis << u.transpose(), v.transpose();
          // The middle of two ends whose errors are opposite in sign by one half.
          const Mat3<double> covariance = 0.125 * (segment->covariance1 + segment->covariance2);
          const Eigen::Vector2d e = basis * (0.5 * (segment->p1 + segment->p2) - middle->point);
          across.push_back(std::sqrt(e.dot((basis * covariance * basis.transpose()).inverse() * e)));
        }
      }
      if (segment) {
        seen.segments.push_back(*segment);
        seen.descriptors.push_back(left.descriptors[i]);
        seen.octaves.push_back(left.segments[i].octave);
      }
    }

    if (past.size() == 3 && past.front().T_world_camera && seen.T_world_camera) {
      const Seen& before = past.front();
      const SE3d T_true = seen.T_world_camera->inverse() * *before.T_world_camera;
      const auto direction = [&] {
        return Vec3<double>(random.normal(), random.normal(), random.normal()).normalized();
      };
      const SE3d T_prior = SE3d(SO3d::exp(std::numbers::pi / 180 * direction()), 0.02 * direction()) * T_true;
      std::vector<LineQuery> wanted;
      std::vector<LineDescriptor> codes;
      std::vector<std::size_t> index;
      for (std::size_t k = 0; k < before.segments.size(); ++k)
        if (auto q = predict_line(camera, T_prior, before.segments[k], 25)) {
          const auto& p = q->predicted;
          const auto& b = rig.bounds();
          if (std::max(p.u1, p.u2) < b.u_min || std::min(p.u1, p.u2) > b.u_max ||
              std::max(p.v1, p.v2) < b.v_min || std::min(p.v1, p.v2) > b.v_max)
            continue;
          q->min_octave = before.octaves[k] - 1;
          q->max_octave = before.octaves[k] + 1;
          wanted.push_back(*q);
          codes.push_back(before.descriptors[k]);
          index.push_back(k);
        }
      tracked += by_prior.match(wanted, codes, rectified, octaves, left.descriptors, found);
      queries += static_cast<long>(wanted.size());
      for (std::size_t k = 0; k < found.size(); ++k) {
        if (!found[k].found()) continue;
        const auto expected = predict_line(camera, T_true, before.segments[index[k]], 0);
        if (!expected) continue;
        const Segment2d &p = expected->predicted, &s = rectified[found[k].index];
        const auto off = [&](float u, float v) {
          return std::abs((u - p.u1) * p.dv() - (v - p.v1) * p.du()) / std::max(1e-6f, p.length());
        };
        right_tracks += std::max(off(s.u1, s.v1), off(s.u2, s.v2)) <= 2.5f;
      }
    }
    past.push_back(std::move(seen));
    if (past.size() > 3) past.pop_front();
  }
  if (judged == 0) throw Error(ErrorKind::data, folder, "has no depth0 for its images");

  fmt::print("{}: {} images, {} segments and {} pairs an image, {:.0f} us to match (median)\n", folder,
             images, segments / images, paired / images, quantile(times, 0.5));
  fmt::print("  left-right: {:.1f} % of {} judged pairs within 1.5 px of true disparity\n",
             percent(judged - wrong, judged), judged);
  for (int k = 0; k < 2; ++k) {
    std::vector<double> sizes;
    for (const double e : errors[k]) sizes.push_back(std::abs(e));
    const auto bad = std::count_if(sizes.begin(), sizes.end(), [](double e) { return e > 1.5; });
    fmt::print(
        "    {:<22} {:>7} pairs, wrong {:.1f} %, error median {:+.3f}, of sizes {:.3f}, 90 % {:.3f} px\n",
        k == 0 ? "on surfaces" : "at edges of surfaces", sizes.size(),
        percent(bad, static_cast<long>(sizes.size())), quantile(errors[k], 0.5), quantile(sizes, 0.5),
        quantile(sizes, 0.9));
  }
  fmt::print("  in space: error across / standard deviation, median {:.2f}, 90 % {:.2f}\n",
             quantile(across, 0.5), quantile(across, 0.9));
  fmt::print("  frame to frame: {} lines predicted, {:.1f} % found, {:.1f} % of those right\n", queries,
             percent(tracked, queries), percent(right_tracks, tracked));
}

}  // namespace

int main(int argc, char** argv) {
  LineStereoOptions options;
  std::vector<const char*> folders;
  try {
    for (int i = 1; i < argc; ++i) {
      if (std::string(argv[i]) == "--set" && i + 1 < argc)
        set_option(list_options(options), argv[++i], "--set");
      else
        folders.push_back(argv[i]);
    }
    if (folders.empty()) {
      fmt::print(stderr, "usage: line_accuracy [--set option=value]... RECORDING...\n");
      return 2;
    }
    for (const char* folder : folders) run(folder, options);
  } catch (const Error& error) {
    fmt::print(stderr, "line_accuracy: {}\n", error.what());
    return 3;
  }
}
