// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "mapping_stage.hpp"

#include <algorithm>
#include <exception>
#include <utility>

#include "sweepkit/bow/default_vocabulary.hpp"
#include "sweepkit/data/atlas_file.hpp"

namespace sweepkit {
namespace {

ScaleLevels levels_of(const SweeperOptions& options) {
  return {options.frontend.orb.scale_factor, options.frontend.orb.levels};
}

}  // namespace

MappingStage::MappingStage(const StereoRig& rig, const SweeperOptions& options, bool gravity_known,
                           StageClock& clock, Listener listener)
    : rig_(rig),
      options_(options),
      clock_(clock),
      listener_(std::move(listener)),
      mapper_(rectified_camera(rig), rig.bounds(), levels_of(options), options.mapper) {
  if (options.places.enabled) {
    const std::string& file = options.places.vocabulary;
    recognizer_.emplace(rectified_camera(rig), rig.bounds(), levels_of(options),
                        file.empty() ? default_orb_vocabulary() : open_place_vocabulary(file),
                        options.places.recognizer);
  }
  if (gravity_known) gravity_ = -Vec3<double>::UnitZ();
  if (options.realtime) {
    adjusting_thread_ = std::thread([this] { run_adjusting(); });
    mapping_thread_ = std::thread([this] { run_mapping(); });
  }
}

MappingStage::~MappingStage() {
  leave();
  finish();
}

void MappingStage::leave() {
  const std::scoped_lock lock(queue_mutex_);
  candidates_.clear();
  leaving_ = true;
}

void MappingStage::resume(Atlas&& atlas) {
  const std::scoped_lock lock(map_mutex_);
  resumed_maps_ = atlas.map.map_count();
  mapper_.resume(std::move(atlas.map), atlas.info.disparity_bias, atlas.info.disparity_bias_sigma);
  if (recognizer_) recognizer_->database().follow(mapper_.map());
  resumed_ = std::move(atlas.info);
}

void MappingStage::save_atlas(const std::string& path) const {
  const std::scoped_lock lock(map_mutex_);
  const Map& map = mapper_.map();
  AtlasInfo info;
  info.rig = identity_of(rig_);
  if (recognizer_) {
    info.vocabulary = options_.places.vocabulary.empty() ? "default" : options_.places.vocabulary;
    info.vocabulary_checksum = recognizer_->database().vocabulary().info().checksum;
  }
  info.disparity_bias = mapper_.disparity_bias();
  info.disparity_bias_sigma = mapper_.disparity_bias_sigma();
  info.gravity_known = resumed_.gravity_known;
  info.gravity_known.resize(resumed_maps_, false);
  info.gravity_known.resize(map.map_count(), gravity_.has_value());
  // What others keep with keyframes that are still there.
  for (const auto& [name, pieces] : resumed_.attachments)
    for (const KeyframeAttachment& piece : pieces)
      if (map.find(piece.keyframe)) info.attachments[name].push_back(piece);
  write_atlas(path, info, map);
}

bool MappingStage::has_room() const {
  if (!options_.realtime) return true;
  const std::scoped_lock lock(queue_mutex_);
  return candidates_.size() < static_cast<std::size_t>(options_.keyframe_queue);
}

void MappingStage::hand_over(KeyframeCandidate&& candidate) {
  if (!options_.realtime) {
    map_keyframe(std::move(candidate));
    return;
  }
  {
    const std::scoped_lock lock(queue_mutex_);
    candidates_.push_back(std::move(candidate));
  }
  hurry_ = true;
  queue_changed_.notify_all();
}

MappingStage::Update MappingStage::take() {
  const std::scoped_lock lock(queue_mutex_);
  return std::exchange(update_, {});
}

void MappingStage::finish() {
  {
    const std::scoped_lock lock(queue_mutex_);
    last_came_ = true;
  }
  queue_changed_.notify_all();
  if (mapping_thread_.joinable()) mapping_thread_.join();
  if (adjusting_thread_.joinable()) adjusting_thread_.join();
  if (!leaving_ && !finished_) guard(last_mapped_, [&] { adjust_map(); });
  finished_ = true;
}

MappingStage::Places MappingStage::places() const {
  const std::scoped_lock lock(queue_mutex_);
  return places_;
}

const PlaceCounts& MappingStage::place_counts() const {
  static const PlaceCounts kNone;
  return recognizer_ ? recognizer_->counts() : kNone;
}

// What goes wrong here costs a keyframe, never the run.
template <class Step>
void MappingStage::guard(TimeNs t, Step&& step) {
  try {
    step();
  } catch (const std::exception& error) {
    listener_.failed(t, error.what());
  }
}

void MappingStage::map_keyframe(KeyframeCandidate&& candidate) {
  const std::scoped_lock changing(map_mutex_);
  last_mapped_ = candidate.frame.t;
  std::shared_ptr<const LocalMap> local_map;
  if (candidate.begins_map || !mapper_.current_map().valid()) {
    map_begun_at_ = candidate.frame.t;
    // Odometry carries the frame of the map over into the new one.
    if (!candidate.odometry)
      one_frame_.clear();
    else if (mapper_.current_map().valid())
      one_frame_.push_back(mapper_.current_map());
  }
  {
    const auto scope = clock_.time(Stage::local_ba);
    local_map = mapper_.process(std::move(candidate), &hurry_);
  }
  publish(local_map);
  if (recognizer_) look_around(local_map->newest);
}

void MappingStage::publish(std::shared_ptr<const LocalMap> local_map, std::vector<Event> events) {
  if (!local_map) return;
  const bool seeking = seeks();
  const std::scoped_lock lock(queue_mutex_);
  update_.map = std::move(local_map);
  update_.seeks = seeking;
  update_.events.insert(update_.events.end(), events.begin(), events.end());
}

// Whether the current map is new and there are others that it knows no way to.
bool MappingStage::seeks() const {
  const PlaceOptions& places = options_.places;
  if (!recognizer_ || places.recognizer.twins || to_seconds(last_mapped_ - map_begun_at_) > places.seek_time)
    return false;
  const std::vector<MapId> maps = mapper_.map().maps();
  return std::any_of(maps.begin(), maps.end(), [&](MapId id) {
    return id != mapper_.current_map() &&
           std::find(one_frame_.begin(), one_frame_.end(), id) == one_frame_.end();
  });
}

// Was the robot here before?
void MappingStage::look_around(KeyframeId newest) {
  std::optional<PlaceMatch> match;
  {
    const auto scope = clock_.time(Stage::place);
    recognizer_->database().follow(mapper_.map());
    match = recognizer_->feed(mapper_.map(), newest, gravity_ ? &*gravity_ : nullptr, one_frame_);
  }
  if (!match) return;
  const auto scope = clock_.time(Stage::loop);
  const TimeNs t = mapper_.map().keyframe(newest).t;
  const MapId from = mapper_.map().keyframe(newest).map;
  const LoopCorrection correction = mapper_.take_place(*match);
  Event event(t, !correction.accepted ? "loop_rejected" : correction.joined ? "maps_joined" : "loop_closed");
  event.with("keyframe", match->candidate.value).with("points", match->pairs.size());
  if (correction.joined) event.with("map", match->map.value).with("joined", from.value);
  if (!correction.joined) event.with("contradiction", correction.contradiction);
  {
    const std::scoped_lock lock(queue_mutex_);
    ++(correction.joined ? places_.joined : correction.accepted ? places_.closed : places_.rejected);
  }
  if (!correction.accepted) return listener_.tell(event);
  std::vector<Event> events{event};
  if (correction.joined)
    events.push_back(
        Event(t, "relocalized").with("map", match->map.value).with("seconds", to_seconds(t - map_begun_at_)));
  publish(mapper_.copy_newest(), events);
  GlobalAdjustment global = mapper_.begin_global_adjustment();
  if (!options_.realtime) {
    global.solve(rectified_camera(rig_), options_.mapper.global_bundle);
    publish(mapper_.finish_global_adjustment(global));
    return;
  }
  {
    const std::scoped_lock lock(queue_mutex_);
    to_adjust_ = std::move(global);
    stop_adjusting_ = true;  // an older one is of no use any more
  }
  queue_changed_.notify_all();
}

// The whole current map, here and now.
void MappingStage::adjust_map() {
  const std::scoped_lock changing(map_mutex_);
  if (!mapper_.current_map().valid()) return;
  GlobalAdjustment global = mapper_.begin_global_adjustment();
  global.solve(rectified_camera(rig_), options_.mapper.global_bundle);
  publish(mapper_.finish_global_adjustment(global));
}

void MappingStage::run_mapping() {
  for (;;) {
    std::optional<GlobalAdjustment> adjusted;
    std::optional<KeyframeCandidate> candidate;
    {
      std::unique_lock lock(queue_mutex_);
      const auto adjusting = [this] { return to_adjust_ || adjusting_; };
      queue_changed_.wait(lock, [&] {
        return adjusted_ || !candidates_.empty() || (last_came_ && (!adjusting() || leaving_));
      });
      adjusted.swap(adjusted_);
      if (!candidates_.empty()) {
        candidate = std::move(candidates_.front());
        candidates_.pop_front();
        hurry_ = !candidates_.empty();
      }
      if (!adjusted && !candidate) {
        mapping_done_ = true;
        stop_adjusting_ = true;
        break;
      }
    }
    if (adjusted)
      guard(last_mapped_, [&] {
        const std::scoped_lock changing(map_mutex_);
        publish(mapper_.finish_global_adjustment(*adjusted));
      });
    if (!candidate) continue;
    guard(candidate->frame.t, [&] { map_keyframe(std::move(*candidate)); });
  }
  queue_changed_.notify_all();
}

// Whole maps are adjusted beside mapping, which goes on.
void MappingStage::run_adjusting() {
  for (;;) {
    GlobalAdjustment global;
    {
      std::unique_lock lock(queue_mutex_);
      queue_changed_.wait(lock, [this] { return mapping_done_ || to_adjust_; });
      if (mapping_done_) return;
      global = std::move(*to_adjust_);
      to_adjust_.reset();
      adjusting_ = true;
      stop_adjusting_ = false;
    }
    guard(global.t, [&] {
      const auto scope = clock_.time(Stage::loop);
      global.solve(rectified_camera(rig_), options_.mapper.global_bundle, &stop_adjusting_);
    });
    {
      const std::scoped_lock lock(queue_mutex_);
      adjusting_ = false;
      adjusted_ = std::move(global);
    }
    queue_changed_.notify_all();
  }
}

}  // namespace sweepkit
