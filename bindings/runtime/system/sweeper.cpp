// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/system/sweeper.hpp"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <condition_variable>
#include <deque>
#include <exception>
#include <limits>
#include <mutex>
#include <numbers>
#include <string>
#include <thread>
#include <tuple>
#include <utility>
#include <variant>

#include "mapping_stage.hpp"
#include "sweepkit/data/atlas_file.hpp"

namespace sweepkit {
namespace {

// The rig's bias of disparities is told again when it has changed by so much [px].
constexpr double kNewsOfDisparityBias = 0.05;
// Samples kept while no image comes: 20 s of an IMU and wheels.
constexpr std::size_t kPendingSamples = 5000;
constexpr TimeNs kNever = std::numeric_limits<TimeNs>::min();

bool fits(const SharedGray& image, const Camera& camera) {
  return image.view.width == camera.width() && image.view.height == camera.height();
}

std::string size_of(const SharedGray& image) {
  return std::to_string(image.view.width) + "x" + std::to_string(image.view.height);
}

}  // namespace

class Sweeper::Impl {
 public:
  Impl(const StereoRig& rig, const MotionSensors& sensors, const SweeperOptions& options, EventSink* events,
       FrameSink* frames)
      : rig_(rig),
        options_(options),
        events_(events),
        frames_(frames),
        T_camera_body_(rig.T_body_camera().inverse()),
        frontend_(rig, options.frontend),
        tracker_(rectified_camera(rig), rig.bounds(), levels(), options.tracker, T_camera_body_),
        bridge_(sensors, options.odometry),
        live_(bridge_.filter()),
        mapping_(rig_, options_, sensors.imu.has_value(), clock_,
                 {[this](const Event& event) { tell(event); },
                  [this](TimeNs t, const std::string& reason) { drop(t, "mapping", reason); }}) {
    if (sensors.imu && options_.main_direction.enabled)
      direction_search_.emplace(
          DirectionSearch{MainDirectionEstimator(rig, options_.main_direction.direction),
                          SegmentDetector(options_.main_direction.segments),
                          {},
                          {},
                          std::nullopt});
    if (options_.realtime) tracking_thread_ = std::thread([this] { run_tracking(); });
  }

  ~Impl() {
    {
      const std::scoped_lock lock(queue_mutex_);
      images_.clear();
    }
    mapping_.leave();
    finish();
  }

  void resume(Atlas&& atlas, const std::string& place) {
    check_same_rig(atlas.info, rig_, place);
    const std::scoped_lock lock(feed_mutex_);
    require(last_imu_ == kNever && last_wheels_ == kNever && last_image_ == kNever, "Sweeper::resume",
            "comes before the first sample", place);
    first_map_ = static_cast<int>(atlas.map.map_count());
    frontend_.set_disparity_bias(atlas.info.disparity_bias);
    mapping_.resume(std::move(atlas));
  }

  void save_atlas(const std::string& path) const { mapping_.save_atlas(path); }

  template <class Inertial>
  void feed_inertial(const Inertial& sample, bool finite, const char* sensor,
                     std::int64_t SweeperCounts::*count, TimeNs& last_t) {
    const std::scoped_lock lock(feed_mutex_);
    if (const char* reason = finished_            ? "finished"
                             : !finite            ? "not finite"
                             : sample.t <= last_t ? "time does not advance"
                                                  : nullptr) {
      drop(sample.t, sensor, reason);
      return;
    }
    last_t = sample.t;
    {
      const std::scoped_lock state(state_mutex_);
      ++(counts_.*count);
      newest_sample_ = std::max(newest_sample_, sample.t);
      if (bridge_.usable()) take_sample(sample);
      if (std::same_as<Inertial, ImuSample> || last_imu_ == kNever) last_motion_ = sample.t;
    }
    samples_came_.notify_all();
  }

  void feed(const ImuSample& s) {
    feed_inertial(s, s.gyro.allFinite() && s.accel.allFinite(), "imu", &SweeperCounts::imu_samples,
                  last_imu_);
  }
  void feed(const WheelSample& s) {
    feed_inertial(s, std::isfinite(s.left) && std::isfinite(s.right), "wheels", &SweeperCounts::wheel_samples,
                  last_wheels_);
  }

  void feed(StereoImage image) {
    {
      const std::scoped_lock lock(feed_mutex_);
      if (finished_) return drop(image.t, "cameras", "finished");
      if (image.t <= last_image_) return drop(image.t, "cameras", "time does not advance");
      for (const Side side : {Side::left, Side::right}) {
        const SharedGray& gray = side == Side::left ? image.left : image.right;
        if (!gray.empty() && !fits(gray, rig_.camera(side)))
          return drop(image.t, side == Side::left ? "cam0" : "cam1", "size " + size_of(gray));
      }
      if (last_image_ == kNever) tell(Event(image.t, "started").with("realtime", options_.realtime));
      last_image_ = image.t;
      const std::scoped_lock state(state_mutex_);
      newest_sample_ = std::max(newest_sample_, image.t);
    }
    if (!options_.realtime) return guard(image.t, "cameras", [&] { process(image); });
    std::optional<TimeNs> dropped;
    {
      const std::scoped_lock lock(queue_mutex_);
      if (images_.size() >= static_cast<std::size_t>(options_.image_queue)) {
        dropped = images_.front().t;
        dropped_.push_back(*dropped);
        images_.pop_front();
      }
      images_.push_back(std::move(image));
    }
    queue_changed_.notify_all();
    if (dropped) {
      std::int64_t total;
      {
        const std::scoped_lock lock(state_mutex_);
        total = ++counts_.images_dropped;
      }
      tell(Event(*dropped, "overload").with("images_dropped", total));
    }
  }

  void finish() {
    {
      const std::scoped_lock lock(feed_mutex_, queue_mutex_);
      if (std::exchange(finished_, true)) return;
    }
    queue_changed_.notify_all();
    if (tracking_thread_.joinable()) tracking_thread_.join();
    mapping_.finish();
    if (obstacles_) obstacles_->finish();
    take_local_map();  // the last keyframe's, so that its image follows it
    if (direction_search_ && last_image_ != kNever)
      tell(Event(last_image_, "main_direction").with("found", false));
    if (last_image_ != kNever) tell(Event(last_image_, "stopped").with("images", counts().images));
  }

  std::optional<BodyPose> pose_at(TimeNs t, Frame frame) const {
    const std::scoped_lock lock(state_mutex_);
    if (history_.empty() || t < history_.front().t) return std::nullopt;
    const auto pose_of = [&](const TrackedImage& image) {
      return frame == Frame::odom ? image.T_odom_body : image.T_map_body;
    };
    const auto after = std::lower_bound(history_.begin(), history_.end(), t,
                                        [](const TrackedImage& image, TimeNs key) { return image.t < key; });
    if (after == history_.end()) {
      const TrackedImage& last = history_.back();
      if (t > std::max(newest_sample_, last.t)) return std::nullopt;
      if (!live_poses_.empty()) return live_pose(t, frame);
      BodyPose pose{t, pose_of(last), last.covariance, PoseBasis::guess};
      if (history_.size() > 1) {
        const TrackedImage& before = history_[history_.size() - 2];
        const double share = to_seconds(t - last.t) / to_seconds(last.t - before.t);
        // In odom, where nothing steps; the motion itself is the same in both frames.
        const Vec6<double> twist = (before.T_odom_body.inverse() * last.T_odom_body).log();
        pose.T_frame_body = pose.T_frame_body * SE3d::exp(share * twist);
      }
      return pose;
    }
    BodyPose pose{t, pose_of(*after), after->covariance, after->basis};
    if (after->t == t) return pose;
    const TrackedImage& before = *(after - 1);
    const double share = to_seconds(t - before.t) / to_seconds(after->t - before.t);
    pose.T_frame_body = interpolate(pose_of(before), pose_of(*after), share);
    if (before.basis > pose.basis) pose.basis = before.basis;
    return pose;
  }

  SE3d optimized_pose(const TrackedImage& image) const {
    if (!image.reference.valid()) return image.T_map_body;
    const SE3d T_camera_map = image.T_camera_reference * mapping_.map().T_camera_world(image.reference);
    return T_camera_map.inverse() * T_camera_body_;
  }

  SweeperCounts counts() const {
    const MappingStage::Places places = mapping_.places();
    const std::scoped_lock lock(state_mutex_);
    SweeperCounts counts = counts_;
    counts.maps_joined = places.joined;
    counts.loops_closed = places.closed;
    counts.loops_rejected = places.rejected;
    return counts;
  }
  std::vector<TrackedImage> images(std::size_t first) const {
    const std::scoped_lock lock(state_mutex_);
    const std::size_t skip = first > forgotten_ ? std::min(first - forgotten_, history_.size()) : 0;
    return {history_.begin() + static_cast<std::ptrdiff_t>(skip), history_.end()};
  }

  const StereoRig& rig() const { return rig_; }
  const SweeperOptions& options() const { return options_; }
  const StageClock& stage_clock() const { return clock_; }
  const Map& map() const { return mapping_.map(); }
  std::shared_ptr<const ObstacleReport> obstacles() const {
    return obstacles_ ? obstacles_->latest() : nullptr;
  }
  std::optional<OccupancyImage> grid() const {
    if (!grid_) return std::nullopt;
    return mapping_.read([&](const Map& map, MapId current) { return grid_->image(map, current); });
  }
  // Before the first sample. @param mounted with the wheels, which tell where the floor is, if there are any
  void start_floor(const Rig& mounted) {
    const FloorStageOptions& floor = options_.floor;
    if (!floor.enabled) return;
    const GroundPlaneSeed seed = floor.mounting.seed(mounted);
    grid_ = std::make_unique<GridStage>(rectified_camera(rig_), seed.wheels_camera, floor.grid);
    obstacles_ =
        std::make_unique<ObstacleStage>(rig_, seed, floor.detector, options_.realtime, &clock_, grid_.get());
  }
  const PlaceCounts& place_counts() const { return mapping_.place_counts(); }
  std::optional<NavigationState> navigation() const {
    const std::scoped_lock lock(state_mutex_);
    return navigation_;
  }
  std::optional<MainDirection> main_direction() const {
    const std::scoped_lock lock(state_mutex_);
    return main_direction_;
  }

 private:
  using MotionSample = std::variant<ImuSample, WheelSample>;
  struct LivePose {
    TimeNs t;
    SE3d T_map_body;
  };
  static TimeNs stamp_of(const MotionSample& sample) {
    return std::visit([](const auto& s) { return s.t; }, sample);
  }

  void look_at_floor(const StereoImage& image, const TrackedImage& tracked) {
    if (image.t < look_at_floor_from_) return;
    look_at_floor_from_ = image.t + from_seconds(options_.floor.every);
    obstacles_->feed(image, tracked.T_odom_body, tracked.reference, tracked.T_camera_reference);
  }

  // Keeps a sample for the next image, and carries the pose between images on by it. Under state_mutex_.
  void take_sample(const MotionSample& sample) {
    const auto place = std::upper_bound(pending_.begin(), pending_.end(), stamp_of(sample),
                                        [](TimeNs t, const MotionSample& s) { return t < stamp_of(s); });
    pending_.insert(place, sample);
    // Without images for long the oldest go: nothing may grow for ever.
    if (pending_.size() > kPendingSamples) pending_.pop_front();
    if (live_.started()) run_live(sample);
  }

  void run_live(const MotionSample& sample) {
    if (stamp_of(sample) < live_.state().t) return;  // late: the next image takes it in its turn
    std::visit([&](const auto& s) { live_.add(s); }, sample);
    if (live_poses_.size() < kPendingSamples)
      live_poses_.push_back({live_.state().t, live_.state().T_world_body});
  }

  // After the last image, from what came since. Under state_mutex_.
  BodyPose live_pose(TimeNs t, Frame frame) const {
    const auto after = std::lower_bound(live_poses_.begin(), live_poses_.end(), t,
                                        [](const LivePose& pose, TimeNs key) { return pose.t < key; });
    SE3d T_map_body;
    if (after == live_poses_.end()) {
      NavigationFilter filter = live_;
      filter.advance(t);
      T_map_body = filter.state().T_world_body;
    } else if (after == live_poses_.begin()) {
      T_map_body = after->T_map_body;
    } else {
      const LivePose& before = *(after - 1);
      const double share = to_seconds(t - before.t) / to_seconds(after->t - before.t);
      T_map_body = interpolate(before.T_map_body, after->T_map_body, share);
    }
    const Mat6<double> covariance = live_.state().pose_covariance() + live_drift_;
    return {t, frame == Frame::odom ? live_T_odom_map_ * T_map_body : T_map_body, covariance,
            PoseBasis::odometry};
  }

  ScaleLevels levels() const { return {options_.frontend.orb.scale_factor, options_.frontend.orb.levels}; }

  void tell(const Event& event) {
    if (events_) events_->on_event(event);
  }

  void drop(TimeNs t, const char* sensor, const std::string& reason) {
    std::int64_t total;
    {
      const std::scoped_lock lock(state_mutex_);
      total = ++counts_.samples_dropped;
    }
    tell(Event(t, "sample_dropped")
             .with("sensor", sensor)
             .with("reason", reason)
             .with("samples_dropped", total));
  }

  // Runs a step of the frame path or of mapping; what goes wrong there costs the image, never the run.
  template <class Step>
  void guard(TimeNs t, const char* sensor, Step&& step) {
    try {
      step();
    } catch (const std::exception& error) {
      drop(t, sensor, error.what());
    }
  }

  // Hands the bridge what IMU and wheels said up to an image.
  void run_bridge(TimeNs t) {
    if (!bridge_.usable()) return;
    {
      const std::scoped_lock lock(state_mutex_);
      const auto end = std::upper_bound(pending_.begin(), pending_.end(), t,
                                        [](TimeNs key, const MotionSample& s) { return key < stamp_of(s); });
      due_.assign(pending_.begin(), end);
      pending_.erase(pending_.begin(), end);
    }
    for (const MotionSample& sample : due_) std::visit([&](const auto& s) { bridge_.add(s); }, sample);
    if (!bridge_.started()) bridge_.start(t);
    bridge_.advance(t);
    for (const Event& event : bridge_.take_events()) tell(event);
    // Carried, or about to be: what comes next may be anywhere.
    if (bridge_.lifted() && !lifted_) leave_map_ = "lifted";
    lifted_ = bridge_.lifted();
  }

  // What came after the image carries the pose on from what is known now.
  void restart_live() {
    if (!bridge_.started()) return;
    const std::scoped_lock lock(state_mutex_);
    live_ = bridge_.filter();
    navigation_ = live_.state();
    live_poses_.assign(1, {live_.state().t, live_.state().T_world_body});
    live_T_odom_map_ = T_odom_map_;
    live_drift_ = drift(live_.state().T_world_body);
    for (const MotionSample& sample : pending_) run_live(sample);
  }

  // The frame path, in the thread of the feed or of tracking.
  void process(const StereoImage& image) {
    take_local_map();
    run_bridge(image.t);
    TrackedImage tracked;
    tracked.t = image.t;
    std::optional<KeyframeCandidate> candidate;
    if (image.left.empty() || image.right.empty()) {
      tracked = pass_over(image.t);
      tell_missing(image);
    } else {
      const auto scope = clock_.time(Stage::frame);
      candidate = track(image, tracked);
    }
    record(tracked);
    restart_live();
    if (direction_search_ && !image.left.empty() && !image.right.empty()) search_direction(image, tracked);
    {
      const std::scoped_lock lock(state_mutex_);
      ++counts_.images;
    }
    if (obstacles_ && !image.left.empty() && !image.right.empty()) look_at_floor(image, tracked);
    if (frames_) frames_->on_frame(image, frame_, tracked);
    if (candidate) hand_over(std::move(*candidate));
  }

  std::optional<KeyframeCandidate> track(const StereoImage& image, TrackedImage& tracked) {
    frame_.t = image.t;
    {
      const auto scope = clock_.time(Stage::extract);
      frontend_.extract(image.left.view, image.right.view);
    }
    {
      const auto scope = clock_.time(Stage::stereo);
      frontend_.match(frame_);
    }
    tell_darkness(image);
    TrackResult result;
    std::optional<MotionPrior> prior;
    if (bridge_.started()) prior = prior_of(bridge_.pose());
    {
      const auto scope = clock_.time(Stage::track);
      result = tracker_.track(frame_, prior ? &*prior : nullptr);
    }
    // Without odometry nobody knows where the robot is when it sees again.
    if (result.state == TrackingState::lost && result.starts_map && !prior) leave_map_ = "lost";
    const bool begins = leave_map_ && result.state != TrackingState::starting && tracker_.begin_map(frame_);
    if (begins) {
      ++begun_;
      result.wants_keyframe = result.starts_map = true;
      result.blind = false;
      tell(Event(image.t, "map_created")
               .with("map", first_map_ + begun_)
               .with("reason", *std::exchange(leave_map_, std::nullopt)));
    }
    if (seeks_ && result.state == TrackingState::tracking && frame_.reference.valid())
      result.wants_keyframe = result.wants_keyframe || looks_elsewhere(frame_.T_camera_reference);
    tracked.T_map_body = frame_.T_camera_world.inverse() * T_camera_body_;
    tracked.reference = frame_.reference;
    tracked.T_camera_reference = frame_.T_camera_reference;
    tracked.points = result.points;
    if (result.state == TrackingState::tracking) {
      const Mat6<double> Ad = rig_.T_body_camera().adjoint();
      tracked.covariance = Ad * frame_.covariance * Ad.transpose();
      tracked.basis = PoseBasis::vision;
      if (prior) {
        // Where odometry went wrong unseen, seeing again moves the map under the robot, not the robot.
        if (state_ == TrackingState::lost)
          T_odom_map_ = T_odom_map_ * bridge_.pose().T * tracked.T_map_body.inverse();
        bridge_.correct(tracked.T_map_body, tracked.covariance);
      }
    } else if (prior) {
      tracked.covariance = bridge_.pose().covariance;
      tracked.basis = PoseBasis::odometry;
    }
    tracked.covariance += drift(tracked.T_map_body);
    tell_state(image.t, result);
    if (!result.wants_keyframe || !((result.starts_map && !result.blind) || mapping_.has_room()))
      return std::nullopt;
    KeyframeCandidate candidate{.frame = frame_,
                                .counts = tracker_.take_counts(),
                                .starts_map = result.starts_map,
                                .begins_map = begins,
                                .begun = begun_,
                                .odometry = std::nullopt};
    if (result.blind) {
      candidate.frame.measurements.clear();
      candidate.frame.descriptors.clear();
      candidate.frame.points.clear();
    }
    if (bridge_.started()) {
      const UncertainMotion<double> moved = bridge_.take_motion();
      const SE3d& T_body_camera = rig_.T_body_camera();
      if (moved_before_)
        candidate.odometry = {T_camera_body_ * moved.T * T_body_camera,
                              carry_covariance(moved.covariance, T_body_camera)};
      moved_before_ = true;
    }
    return candidate;
  }

  // Enough to be asked where it is, for one that does not know.
  bool looks_elsewhere(const SE3d& T_camera_reference) const {
    return T_camera_reference.translation().norm() > options_.places.seek_distance ||
           T_camera_reference.rotation().angle() > options_.places.seek_angle * std::numbers::pi / 180;
  }

  MotionPrior prior_of(const UncertainMotion<double>& T_map_body) const {
    return {T_camera_body_ * T_map_body.T.inverse(),
            carry_covariance(T_map_body.covariance, rig_.T_body_camera())};
  }

  // How uncertain the map is here, since its start: of a right perturbation of the body's pose.
  Mat6<double> drift(const SE3d& T_map_body) const {
    const SE3d* T_anchor_map = local_map_ ? local_map_->find(local_map_->anchor) : nullptr;
    if (!T_anchor_map) return Mat6<double>::Zero();
    Mat6<double> drift = carry_covariance(local_map_->anchor_covariance, *T_anchor_map * T_map_body);
    // A rig whose disparities are all off by a little makes the map too large or too small as a whole.
    const Vec3<double> from_start =
        options_.map_scale_sigma * (T_map_body.rotation().inverse() * T_map_body.translation());
    drift.topLeftCorner<3, 3>() += from_start * from_start.transpose();
    return drift;
  }

  // An image that cannot be looked at still gets a pose: by odometry, or running on as before.
  TrackedImage pass_over(TimeNs t) const {
    TrackedImage tracked;
    tracked.t = t;
    std::optional<SE3d> T_camera_world = tracker_.predict(t);
    if (bridge_.started()) {
      T_camera_world = prior_of(bridge_.pose()).T_camera_world;
      tracked.covariance = bridge_.pose().covariance;
      tracked.basis = PoseBasis::odometry;
    }
    if (T_camera_world) {
      tracked.T_map_body = T_camera_world->inverse() * T_camera_body_;
      std::tie(tracked.reference, tracked.T_camera_reference) = tracker_.refer(*T_camera_world);
      tracked.covariance += drift(tracked.T_map_body);
    }
    return tracked;
  }

  // After the frame path: it costs an image some milliseconds until the direction is known.
  void search_direction(const StereoImage& image, const TrackedImage& tracked) {
    DirectionSearch& search = *direction_search_;
    const auto scope = clock_.time(Stage::lines);
    if (!search.begun) search.begun = image.t;
    search.detector.detect(image.left.view, search.left);
    search.detector.detect(image.right.view, search.right);
    // Upright even where the map is not quite.
    const Vec3<double>& up = bridge_.filter().state().up;
    const SO3d R_level_map(Eigen::Quaterniond::FromTwoVectors(up, Vec3<double>::UnitZ()));
    const auto found =
        search.estimator.add(image.t, search.left, search.right, R_level_map * tracked.T_map_body.rotation());
    if (found) {
      constexpr double kDegrees = 180 / std::numbers::pi;
      tell(Event(image.t, "main_direction")
               .with("found", true)
               .with("angle_deg", found->run_angle * kDegrees)
               .with("confidence", found->confidence)
               .with("window_begin", to_seconds(found->window_begin))
               .with("window_angle_deg", found->angle * kDegrees));
      const std::scoped_lock lock(state_mutex_);
      main_direction_ = found;
    } else if (to_seconds(image.t - *search.begun) > options_.main_direction.give_up_after) {
      tell(Event(image.t, "main_direction").with("found", false));
    } else {
      return;
    }
    direction_search_.reset();
  }

  void tell_darkness(const StereoImage& image) {
    const GrayView& view = image.left.view;
    std::int64_t sum = 0, count = 0;
    for (int y = 2; y < view.height; y += 4)
      for (int x = 2; x < view.width; x += 4, ++count) sum += view.row(y)[x];
    const double mean = count > 0 ? static_cast<double>(sum) / static_cast<double>(count) : 0;
    const bool dark = mean < options_.dark_level;
    if (dark && !dark_) tell(Event(image.t, "dark").with("mean_grey", mean));
    dark_ = dark;
  }

  void tell_missing(const StereoImage& image) {
    {
      const std::scoped_lock lock(state_mutex_);
      ++counts_.images_missing;
    }
    tell(Event(image.t, "image_missing").with("camera", image.left.empty() ? "cam0" : "cam1"));
  }

  void tell_state(TimeNs t, const TrackResult& result) {
    if (result.state == TrackingState::lost && state_ == TrackingState::tracking) {
      lost_since_ = t;
      tell(Event(t, "lost"));
    } else if (result.state == TrackingState::tracking && state_ == TrackingState::lost) {
      tell(Event(t, "recovered")
               .with("seconds", to_seconds(t - lost_since_))
               .with("points", result.points)
               .with("restarted", restarted_));
      restarted_ = false;
    }
    if (result.state == TrackingState::tracking && state_ == TrackingState::starting)
      tell(Event(t, "map_created").with("map", first_map_).with("reason", "start"));
    restarted_ |= result.state == TrackingState::lost && result.starts_map;
    state_ = result.state;
    const std::scoped_lock lock(state_mutex_);
    counts_.images_lost += result.state == TrackingState::lost;
  }

  void record(TrackedImage& tracked) {
    tracked.T_odom_body = T_odom_map_ * tracked.T_map_body;
    const std::scoped_lock lock(state_mutex_);
    history_.push_back(tracked);
    if (options_.history > 0 && history_.size() > static_cast<std::size_t>(options_.history)) {
      history_.pop_front();
      ++forgotten_;
    }
    newest_sample_ = std::max(newest_sample_, tracked.t);
  }

  void hand_over(KeyframeCandidate&& candidate) {
    {
      const std::scoped_lock lock(state_mutex_);
      ++counts_.keyframes_made;
    }
    mapping_.hand_over(std::move(candidate));
  }

  void take_local_map() {
    auto [map, news, seeks] = mapping_.take();
    if (!map || map->begun != begun_) {
      for (const Event& event : news) tell(event);
      return;
    }
    const SE3d T_map_body_before = tracker_.last_T_camera_world().inverse() * T_camera_body_;
    tracker_.set_local_map(map);
    local_map_ = map;
    seeks_ = seeks;
    frontend_.set_disparity_bias(map->disparity_bias);
    if (std::abs(map->disparity_bias - told_disparity_bias_) > kNewsOfDisparityBias) {
      told_disparity_bias_ = map->disparity_bias;
      tell(Event(map->newest_t, "calibrated").with("disparity_bias_px", map->disparity_bias));
    }
    const SE3d T_map_body_after = tracker_.last_T_camera_world().inverse() * T_camera_body_;
    // The map was corrected under the robot: odom stays, and the correction goes between the two frames.
    T_odom_map_ = T_odom_map_ * T_map_body_before * T_map_body_after.inverse();
    const SE3d T_moved = T_map_body_before.inverse() * T_map_body_after;
    for (Event& event : news)
      tell(event.with("moved_m", T_moved.translation().norm())
               .with("turned_deg", T_moved.rotation().angle() * 180 / std::numbers::pi));
    if (bridge_.started()) {
      const SE3d T_new_old = T_map_body_after * T_map_body_before.inverse();
      if (map->corrections != corrections_)
        bridge_.move_map(T_new_old);
      else
        bridge_.follow_map(T_new_old);
    }
    corrections_ = map->corrections;
    const std::scoped_lock lock(state_mutex_);
    const auto it = std::lower_bound(history_.begin(), history_.end(), map->newest_t,
                                     [](const TrackedImage& image, TimeNs key) { return image.t < key; });
    if (it != history_.end() && it->t == map->newest_t) {
      it->reference = map->newest;
      it->T_camera_reference = SE3d();
    }
  }

  void run_tracking() {
    for (;;) {
      StereoImage image;
      std::vector<TimeNs> dropped;  // since the last image, all before this one
      {
        std::unique_lock lock(queue_mutex_);
        queue_changed_.wait(lock, [this] { return finished_ || !images_.empty(); });
        if (images_.empty()) return;
        image = std::move(images_.front());
        images_.pop_front();
        dropped.swap(dropped_);
      }
      wait_for_samples(image.t);
      for (const TimeNs t : dropped) {
        run_bridge(t);
        TrackedImage tracked = pass_over(t);
        record(tracked);
      }
      guard(image.t, "cameras", [&] { process(image); });
    }
  }

  // Images come before the samples of their time where sensors have delays of their own.
  void wait_for_samples(TimeNs t) {
    if (!bridge_.usable()) return;
    const auto until = std::chrono::steady_clock::now() + std::chrono::duration<double>(options_.sample_wait);
    std::unique_lock lock(state_mutex_);
    samples_came_.wait_until(lock, until, [&] { return last_motion_ >= t; });
  }

  const StereoRig rig_;
  const SweeperOptions options_;
  EventSink* const events_;
  FrameSink* const frames_;
  const SE3d T_camera_body_;
  StageClock clock_;

  // Of the frame path.
  Frontend frontend_;
  Tracker tracker_;
  StereoFrame frame_;
  SE3d T_odom_map_;
  TrackingState state_ = TrackingState::starting;
  TimeNs lost_since_ = 0;
  double told_disparity_bias_ = 0;
  bool restarted_ = false;                // since it was lost vision has started again at the last pose
  std::optional<const char*> leave_map_;  // a new map is to begin, and why
  bool lifted_ = false;
  int first_map_ = 0;    // id of the first that this run began
  int begun_ = 0;        // maps left behind
  int corrections_ = 0;  // of this map, as known
  bool seeks_ = false;   // keyframes are made closely

  std::shared_ptr<const LocalMap> local_map_;  // the tracker's
  struct DirectionSearch {
    MainDirectionEstimator estimator;
    SegmentDetector detector;
    std::vector<LineSegment> left, right;
    std::optional<TimeNs> begun;
  };
  std::optional<DirectionSearch> direction_search_;  // until it is found, or given up
  std::unique_ptr<GridStage> grid_;
  std::unique_ptr<ObstacleStage> obstacles_;
  TimeNs look_at_floor_from_ = 0;
  bool dark_ = false;
  bool moved_before_ = false;  // there was a keyframe from which odometry counts

  OdometryBridge bridge_;  // of the frame path
  std::vector<MotionSample> due_;

  std::mutex feed_mutex_;
  TimeNs last_imu_ = kNever, last_wheels_ = kNever, last_image_ = kNever;

  std::mutex queue_mutex_;
  std::condition_variable queue_changed_;
  std::deque<StereoImage> images_;
  std::vector<TimeNs> dropped_;  // stamps of images that went unseen
  bool finished_ = false;        // guarded by feed_mutex_ and queue_mutex_

  mutable std::mutex state_mutex_;    // never held for longer than a copy
  std::deque<TrackedImage> history_;  // never empty once there was an image
  std::size_t forgotten_ = 0;         // images before its first
  SweeperCounts counts_;
  TimeNs newest_sample_ = kNever;
  TimeNs last_motion_ = kNever;       // newest of IMU, or of wheels without one
  std::deque<MotionSample> pending_;  // since the last image, by stamp
  // Carried on from the last image by what came since; poses at the rate of the samples.
  NavigationFilter live_;
  std::vector<LivePose> live_poses_;
  SE3d live_T_odom_map_;
  Mat6<double> live_drift_ = Mat6<double>::Zero();
  std::optional<NavigationState> navigation_;
  std::optional<MainDirection> main_direction_;
  std::condition_variable samples_came_;

  MappingStage mapping_;  // tells events and counts what failed: of all above
  std::thread tracking_thread_;
};

Sweeper::Sweeper(const StereoRig& rig, const SweeperOptions& options, EventSink* events, FrameSink* frames) {
  check_options(options);
  impl_ = std::make_unique<Impl>(rig, MotionSensors{}, options, events, frames);
  impl_->start_floor({});
}
Sweeper::Sweeper(const Rig& rig, const SweeperOptions& options, EventSink* events, FrameSink* frames) {
  check_options(options);
  impl_ = std::make_unique<Impl>(rig.stereo(), rig.motion(), options, events, frames);
  impl_->start_floor(rig);
}
Sweeper::~Sweeper() = default;
void Sweeper::resume(Atlas&& atlas, const std::string& place) { impl_->resume(std::move(atlas), place); }
void Sweeper::save_atlas(const std::string& path) const { impl_->save_atlas(path); }
void Sweeper::feed(const ImuSample& sample) noexcept { impl_->feed(sample); }
void Sweeper::feed(const WheelSample& sample) noexcept { impl_->feed(sample); }
void Sweeper::feed(StereoImage image) noexcept { impl_->feed(std::move(image)); }
std::optional<BodyPose> Sweeper::pose_at(TimeNs t, Frame frame) const { return impl_->pose_at(t, frame); }
void Sweeper::finish() { impl_->finish(); }
const StereoRig& Sweeper::rig() const { return impl_->rig(); }
const SweeperOptions& Sweeper::options() const { return impl_->options(); }
SweeperCounts Sweeper::counts() const { return impl_->counts(); }
std::vector<TrackedImage> Sweeper::images(std::size_t first) const { return impl_->images(first); }
SE3d Sweeper::optimized_pose(const TrackedImage& image) const { return impl_->optimized_pose(image); }
const StageClock& Sweeper::stage_clock() const { return impl_->stage_clock(); }
const Map& Sweeper::map() const { return impl_->map(); }
std::optional<NavigationState> Sweeper::navigation() const { return impl_->navigation(); }
std::shared_ptr<const ObstacleReport> Sweeper::obstacles() const { return impl_->obstacles(); }
std::optional<OccupancyImage> Sweeper::grid() const { return impl_->grid(); }
const PlaceCounts& Sweeper::place_counts() const { return impl_->place_counts(); }
std::optional<MainDirection> Sweeper::main_direction() const { return impl_->main_direction(); }

}  // namespace sweepkit
