// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/slam/place_database.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "sweepkit/bow/vocabulary_file.hpp"

namespace sweepkit {
namespace {

// Of a posting and of the word that an image keeps with it, and of the tables that lead there.
constexpr std::size_t kBytesOfWord = 32;

}  // namespace

std::shared_ptr<const OrbVocabulary> open_place_vocabulary(const std::string& path) {
  return std::make_shared<const OrbVocabulary>(load_vocabulary<256>(path));
}

PlaceDatabase::PlaceDatabase(std::shared_ptr<const OrbVocabulary> vocabulary,
                             const PlaceDatabaseOptions& options)
    : vocabulary_(std::move(vocabulary)), options_(options) {
  check_options(options_);
  require(vocabulary_ != nullptr && !vocabulary_->empty(), "PlaceDatabase vocabulary", "must have words", 0);
  const VocabularyInfo& info = vocabulary_->info();
  require(info.score != BagScore::kl, "PlaceDatabase vocabulary",
          "must have a score that grows with likeness, not the Kullback-Leibler divergence", "kl");
  require(options_.index_level <= info.depth, "PlaceDatabase index_level",
          "must not exceed the vocabulary's depth of " + std::to_string(info.depth), options_.index_level);
  file_ = InvertedFile(info.score);
}

template <class Source>
PlaceImage PlaceDatabase::make_image(const Source& source) const {
  require(source.measurements.size() == source.descriptors.size(), "PlaceDatabase::image descriptors",
          "must be as many as measurements", source.descriptors.size());
  PlaceImage image;
  image.t = source.t;
  image.measurements = source.measurements;
  image.descriptors = source.descriptors;
  image.grid.build(image.measurements);
  TransformBuffers buffers;
  vocabulary_->transform(image.descriptors, options_.index_level, image.bag, image.index, buffers);
  return image;
}

PlaceImage PlaceDatabase::image(const StereoFrame& frame) const { return make_image(frame); }

PlaceImage PlaceDatabase::image(const Keyframe& keyframe) const {
  PlaceImage image = make_image(keyframe);
  image.keyframe = keyframe.id;
  return image;
}

bool PlaceDatabase::add(const Keyframe& keyframe) {
  if (keyframe.blind() || contains(keyframe.id)) return false;
  TransformBuffers buffers;
  PlaceImage image;
  image.keyframe = keyframe.id;
  vocabulary_->transform(keyframe.descriptors, options_.index_level, image.bag, image.index, buffers);
  return add(image);
}

bool PlaceDatabase::add(const PlaceImage& image) {
  require(image.keyframe.valid(), "PlaceDatabase::add image", "must be that of a keyframe", 0);
  if (image.bag.empty() || contains(image.keyframe)) return false;
  file_.insert(image.keyframe.value, image.bag);
  words_ += image.bag.size();
  indices_.emplace(image.keyframe, Entry{image.index, image.bag.size()});
  return true;
}

bool PlaceDatabase::erase(KeyframeId id) {
  const auto found = indices_.find(id);
  if (found == indices_.end()) return false;
  words_ -= found->second.words;
  indices_.erase(found);
  file_.remove(id.value);
  return true;
}

void PlaceDatabase::follow(const Map& map) {
  for (auto it = indices_.begin(); it != indices_.end();) {
    const KeyframeId id = (it++)->first;
    if (!map.find(id)) erase(id);
  }
  for (std::uint32_t i = 0; i < map.keyframe_id_end(); ++i)
    if (const Keyframe* keyframe = map.find(KeyframeId{i})) add(*keyframe);
}

void PlaceDatabase::clear() {
  indices_.clear();
  file_.clear();
  words_ = 0;
}

const DirectIndex* PlaceDatabase::index(KeyframeId id) const {
  const auto found = indices_.find(id);
  return found == indices_.end() ? nullptr : &found->second.index;
}

std::size_t PlaceDatabase::memory_bytes() const {
  std::size_t bytes = words_ * kBytesOfWord;
  for (const auto& [id, entry] : indices_)
    bytes +=
        sizeof(entry) + sizeof(std::uint32_t) * (entry.index.features.capacity() +
                                                 entry.index.nodes.capacity() + entry.index.begin.capacity());
  return bytes;
}

std::vector<PlaceGroup> PlaceDatabase::candidates(const PlaceImage& image, const Map& map,
                                                  std::span<const MapId> without) const {
  const Keyframe* self = image.keyframe.valid() ? map.find(image.keyframe) : nullptr;
  const auto excluded = [&](const Keyframe& other) {
    if (!self) return false;
    if (options_.exclude_covisible && map.shared_points(self->id, other.id) > 0) return true;
    return other.map == self->map && std::abs(to_seconds(other.t - self->t)) < options_.exclusion_time;
  };
  double reference = 0;
  std::uint32_t most_common = 0;
  std::map<MapId, std::vector<BagMatch>> matches;
  for (const BagMatch& match : file_.query(image.bag)) {
    const Keyframe* other = map.find(KeyframeId{match.id});
    if (!other || other->id == image.keyframe ||
        std::find(without.begin(), without.end(), other->map) != without.end())
      continue;
    if (excluded(*other)) {
      reference = std::max(reference, match.score);
      continue;
    }
    most_common = std::max(most_common, match.common_words);
    matches[other->map].push_back(match);
  }
  const double least_score = options_.min_relative_score * reference;
  const double least_common = options_.min_common * most_common;
  std::vector<std::vector<PlaceGroup>> by_map;
  for (auto& [map_id, alike] : matches) {
    std::erase_if(alike, [&](const BagMatch& match) {
      return match.score < least_score || match.common_words < least_common;
    });
    const auto covisible = [&](std::uint32_t id) {
      std::vector<std::uint32_t> ids;
      for (const Covisible& c :
           map.best_covisible(KeyframeId{id}, static_cast<std::size_t>(options_.neighbours)))
        ids.push_back(c.keyframe.value);
      return ids;
    };
    std::vector<PlaceGroup> groups;
    for (BagGroup& group : group_matches(alike, covisible, options_.min_share)) {
      if (groups.size() == static_cast<std::size_t>(options_.max_candidates)) break;
      PlaceGroup& made = groups.emplace_back();
      made = {.best = KeyframeId{group.best.id}, .map = map_id, .score = group.score, .members = {}};
      for (const std::uint32_t member : group.members) made.members.push_back(KeyframeId{member});
    }
    if (!groups.empty()) by_map.push_back(std::move(groups));
  }
  std::stable_sort(by_map.begin(), by_map.end(),
                   [](const auto& a, const auto& b) { return a.front().score > b.front().score; });
  std::vector<PlaceGroup> groups;
  for (auto& of_map : by_map) std::move(of_map.begin(), of_map.end(), std::back_inserter(groups));
  return groups;
}

}  // namespace sweepkit
