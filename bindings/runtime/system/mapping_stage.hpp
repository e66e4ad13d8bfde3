// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "sweepkit/core/event.hpp"
#include "sweepkit/core/stage_clock.hpp"
#include "sweepkit/geometry/stereo_rig.hpp"
#include "sweepkit/map/atlas.hpp"
#include "sweepkit/slam/global_adjustment.hpp"
#include "sweepkit/slam/local_mapper.hpp"
#include "sweepkit/slam/place_recognition.hpp"
#include "sweepkit/system/sweeper.hpp"

namespace sweepkit {

/// The maps of a Sweeper, beside its frame path: takes keyframes, looks for known places, closes loops, joins
/// maps, adjusts them as a whole. In real time mapping and adjustment have a thread each; otherwise hand_over
/// does everything before it returns, so that runs are repeatable.
class MappingStage {
 public:
  /// What the tracker is to take over at the next image.
  struct Update {
    std::shared_ptr<const LocalMap> map;  ///< null: nothing new
    std::vector<Event> events;            ///< to be told when it is taken
    bool seeks = false;                   ///< other maps: keyframes are to be made closely
  };
  struct Places {
    std::int64_t joined = 0, closed = 0, rejected = 0;
  };
  /// What mapping tells by itself, from its own threads.
  struct Listener {
    std::function<void(const Event&)> tell;
    std::function<void(TimeNs, const std::string&)> failed;  ///< a keyframe was given up, and why
  };

  /// @param rig, options, clock must outlive this
  /// @param gravity_known maps have their z upwards
  MappingStage(const StereoRig& rig, const SweeperOptions& options, bool gravity_known, StageClock& clock,
               Listener listener);
  ~MappingStage();
  MappingStage(const MappingStage&) = delete;
  MappingStage& operator=(const MappingStage&) = delete;

  /// Goes on with the maps of another run, before the first keyframe.
  void resume(Atlas&& atlas);
  /// @throws Error as write_atlas
  void save_atlas(const std::string& path) const;

  bool has_room() const;
  void hand_over(KeyframeCandidate&& candidate);
  Update take();
  /// Gives up what still waits: comes before finish.
  void leave();
  /// Returns when all that waits is mapped and the current map adjusted as a whole; the threads end.
  void finish();

  /// In real time only after finish; `read` below at any time.
  const Map& map() const { return mapper_.map(); }
  template <class Read>
  auto read(Read&& read) const {
    const std::scoped_lock lock(map_mutex_);
    return read(mapper_.map(), mapper_.current_map());
  }
  Places places() const;
  const PlaceCounts& place_counts() const;

 private:
  template <class Step>
  void guard(TimeNs t, Step&& step);
  void map_keyframe(KeyframeCandidate&& candidate);
  void look_around(KeyframeId newest);
  bool seeks() const;
  void publish(std::shared_ptr<const LocalMap> local_map, std::vector<Event> events = {});
  void adjust_map();
  void run_mapping();
  void run_adjusting();

  const StereoRig& rig_;
  const SweeperOptions& options_;
  StageClock& clock_;
  const Listener listener_;

  mutable std::mutex map_mutex_;  // held while the map changes, and by who reads it
  LocalMapper mapper_;
  AtlasInfo resumed_;
  std::size_t resumed_maps_ = 0;
  std::optional<PlaceRecognizer> recognizer_;
  std::optional<Vec3<double>> gravity_;  // in all maps, unit
  std::vector<MapId> one_frame_;         // maps left behind whose frames go on in the current one's
  TimeNs last_mapped_ = 0, map_begun_at_ = 0;
  std::atomic<bool> hurry_ = false;           // another keyframe waits: mapping leaves early
  std::atomic<bool> stop_adjusting_ = false;  // what the whole map is adjusted from has changed

  mutable std::mutex queue_mutex_;
  std::condition_variable queue_changed_;
  std::deque<KeyframeCandidate> candidates_;
  Update update_;
  Places places_;
  std::optional<GlobalAdjustment> to_adjust_, adjusted_;
  bool adjusting_ = false, last_came_ = false, mapping_done_ = false, leaving_ = false;
  bool finished_ = false;

  std::thread mapping_thread_, adjusting_thread_;
};

}  // namespace sweepkit
