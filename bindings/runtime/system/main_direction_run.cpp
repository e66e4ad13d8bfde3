// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/system/main_direction_run.hpp"

#include <array>
#include <cmath>
#include <exception>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <numbers>

#include "canvas.hpp"
#include "sweepkit/core/option_text.hpp"
#include "sweepkit/core/stage_clock.hpp"
#include "sweepkit/core/version.hpp"
#include "sweepkit/data/main_directions.hpp"

namespace sweepkit {
namespace {

constexpr double kDegree = std::numbers::pi / 180;

// Of the labels -1 (none), 0 (horizontal), 1 (vertical), 2 (the other horizontal).
constexpr std::array<Color, 4> kColors{{{150, 150, 150}, {235, 60, 50}, {60, 120, 255}, {50, 210, 70}}};

/// Segments coloured by direction; in the lower left corner the room from above, the camera looking up the
/// picture.
void write_picture(const std::filesystem::path& file, GrayView image, std::span<const LineSegment> segments,
                   std::span<const std::int8_t> labels, double angle) {
  // Darker, so that the lines stand out.
  Canvas picture(image, 0.5);
  for (std::size_t i = 0; i < segments.size(); ++i) {
    const LineSegment& s = segments[i];
    picture.line(s.x1, s.y1, s.x2, s.y2, kColors[static_cast<std::size_t>(labels[i] + 1)]);
  }
  const double radius = 0.06 * image.width, x = 1.4 * radius, y = image.height - 1.4 * radius;
  // The third column of the frame is the axis nearest to the camera's forward axis.
  for (const auto& [turn, color] :
       {std::pair(0.0, kColors[3]), std::pair(std::numbers::pi / 2, kColors[1])}) {
    const double dx = -radius * std::sin(angle + turn), dy = -radius * std::cos(angle + turn);
    picture.line(x - dx, y - dy, x + dx, y + dy, color);
  }
  picture.line(x, y, x, y - 0.5 * radius, {255, 255, 255});
  picture.write(file);
}

double milliseconds_since(std::chrono::steady_clock::time_point begin) {
  return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - begin).count();
}

class Run {
 public:
  Run(const MainDirectionRunOptions& options, const MainDirectionHooks& hooks)
      : options_(options),
        hooks_(hooks),
        recording_(open_recording(options.data_path, options.recording)),
        estimator_(recording_->rig().stereo(), options.direction),
        odometry_(recording_->rig().motion(), recording_->rig().left->T_body_camera, options.odometry),
        detector_(options.segments) {
    if (!options_.save_path.empty()) std::filesystem::create_directories(options_.save_path);
  }

  MainDirectionRunResult operator()() {
    std::exception_ptr damage;
    try {
      play();
    } catch (const Error&) {
      damage = std::current_exception();
    }
    result_.restarts = estimator_.window().restarts();
    result_.last_confidence = estimator_.window().last_confidence();
    result_.lines_ms = clock_.times(Stage::lines).median_ms;
    result_.direction_ms = clock_.times(Stage::track).median_ms;
    if (!options_.save_path.empty()) {
      const std::filesystem::path folder = options_.save_path;
      write_main_directions(folder / "main_direction_result.txt", result_.detections);
      write_summary(folder / "summary.json");
    }
    if (damage) std::rethrow_exception(damage);
    return std::move(result_);
  }

 private:
  void play() {
    const auto total = static_cast<std::int64_t>(recording_->info().images);
    while (options_.detections == 0 ||
           result_.detections.size() < static_cast<std::size_t>(options_.detections)) {
      if (hooks_.stop && hooks_.stop()) {
        result_.stopped = true;
        return;
      }
      const std::optional<Sample> sample = recording_->next();
      if (!sample) return;
      if (const auto* imu = std::get_if<ImuSample>(&*sample)) odometry_.add(*imu);
      if (const auto* wheels = std::get_if<WheelSample>(&*sample)) odometry_.add(*wheels);
      if (const auto* image = std::get_if<StereoImage>(&*sample)) {
        look(*image);
        if (hooks_.progress) hooks_.progress(static_cast<std::int64_t>(result_.frames.size()), total);
      }
    }
  }

  void look(const StereoImage& image) {
    auto begin = std::chrono::steady_clock::now();
    left_.clear();
    right_.clear();
    if (!image.left.empty()) detector_.detect(image.left.view, left_);
    if (!image.right.empty()) detector_.detect(image.right.view, right_);
    clock_.add(Stage::lines, milliseconds_since(begin));
    begin = std::chrono::steady_clock::now();
    const bool window_begins =
        result_.frames.size() % static_cast<std::size_t>(options_.direction.window) == 0;
    const SO3d R_world_body = odometry_.orientation(image.t);
    const auto answer = estimator_.add(image.t, left_, right_, R_world_body, odometry_.drift());
    clock_.add(Stage::track, milliseconds_since(begin));
    result_.frames.push_back(estimator_.last());
    if (window_begins) {
      first_image_ = image.left;
      first_segments_ = left_;
      const auto labels = estimator_.finder().labels(Side::left);
      first_labels_.assign(labels.begin(), labels.end());
    }
    if (!answer) return;
    result_.detections.push_back(*answer);
    if (!options_.save_path.empty() && !first_image_.empty())
      write_picture(std::filesystem::path(options_.save_path) /
                        ("main_direction_" + std::to_string(answer->window_begin) + ".png"),
                    first_image_.view, first_segments_, first_labels_, answer->angle);
  }

  void write_summary(const std::filesystem::path& file) {
    using Json = nlohmann::json;
    Json detections = Json::array();
    for (const MainDirection& d : result_.detections)
      detections.push_back({{"t", to_seconds(d.window_begin)},
                            {"angle_deg", d.angle / kDegree},
                            {"confidence", d.confidence},
                            {"run_t", to_seconds(d.run_begin)},
                            {"run_angle_deg", d.run_angle / kDegree},
                            {"seconds", to_seconds(d.window_end - d.run_begin)},
                            {"frames", d.frames},
                            {"collected", d.collected},
                            {"inliers", d.inliers},
                            {"drift_deg_per_s", d.drift / kDegree},
                            {"sigma_deg", d.sigma / kDegree}});
    MainDirectionRunOptions used = options_;
    const Json summary = {{"version", version()},
                          {"recording", recording_->info().path.string()},
                          {"missing_sensors", recording_->info().missing_sensors},
                          {"frames", result_.frames.size()},
                          {"windows_rejected", result_.restarts},
                          {"detections", detections},
                          {"stages",
                           {{"lines", {{"median_ms", result_.lines_ms}}},
                            {"direction", {{"median_ms", result_.direction_ms}}}}},
                          {"options", Json::parse(options_to_json(list_options(used)))}};
    std::ofstream out(file, std::ios::binary);
    out << summary.dump(2, ' ', false, Json::error_handler_t::replace) << '\n';
    out.close();
    if (!out) throw Error(ErrorKind::io, file.string(), "cannot be written");
  }

  const MainDirectionRunOptions options_;
  const MainDirectionHooks& hooks_;
  std::unique_ptr<Recording> recording_;
  MainDirectionEstimator estimator_;
  LevelOdometry odometry_;
  SegmentDetector detector_;
  StageClock clock_;
  MainDirectionRunResult result_;
  std::vector<LineSegment> left_, right_;
  // Of the window's first frame.
  SharedGray first_image_;
  std::vector<LineSegment> first_segments_;
  std::vector<std::int8_t> first_labels_;
};

}  // namespace

MainDirectionRunResult find_main_direction(const MainDirectionRunOptions& options,
                                           const MainDirectionHooks& hooks) {
  check_options(options);
  if (options.data_path.empty()) throw Error(ErrorKind::option, "data_path", "must be given");
  return Run(options, hooks)();
}

}  // namespace sweepkit
