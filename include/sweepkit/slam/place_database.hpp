// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <map>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "sweepkit/bow/inverted_file.hpp"
#include "sweepkit/bow/vocabulary.hpp"
#include "sweepkit/core/options.hpp"
#include "sweepkit/map/map.hpp"
#include "sweepkit/match/keypoint_grid.hpp"
#include "sweepkit/slam/stereo_frame.hpp"

namespace sweepkit {

struct PlaceDatabaseOptions {
  int index_level = 2;
  int neighbours = 10;
  double min_common = 0.5;
  double min_relative_score = 0.5;
  double min_share = 0.4;
  int max_candidates = 6;
  bool exclude_covisible = true;
  double exclusion_time = 10;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(index_level, "index_level", "", range(0, 10),
      "level of the vocabulary below which features of two images are compared; 0: each with each");
    v(neighbours, "neighbours", "keyframes", range(0, 100),
      "covisible keyframes whose likeness counts with that of a candidate");
    v(min_common, "min_common", "", range(0, 1),
      "least number of common words, as a part of the most that any keyframe has that is not excluded");
    v(min_relative_score, "min_relative_score", "", range(0, 10),
      "least likeness of a candidate, as a part of that of the keyframe most alike of those excluded");
    v(min_share, "min_share", "", range(0, 1),
      "least summed likeness of a group, as a part of the best group's of its map");
    v(max_candidates, "max_candidates", "", range(1, 1000), "most groups to give of each map");
    v(exclude_covisible, "exclude_covisible", "", any_value(),
      "keyframes that share points with the one asked about are no candidates");
    v(exclusion_time, "exclusion_time", "s", range(0, 1e9),
      "nor are those of its map made within this time of it");
  }
};

/// An image as place recognition looks at it.
struct PlaceImage {
  KeyframeId keyframe;  ///< that it is; none for a frame that is not in the map
  TimeNs t = 0;
  std::vector<Measurement> measurements;
  std::vector<OrbDescriptor> descriptors;
  KeypointGrid grid;  ///< over the measurements
  Bag bag;
  DirectIndex index;  ///< on the database's level
};

/// Covisible keyframes that look like an image.
struct PlaceGroup {
  KeyframeId best;  ///< the one most alike
  MapId map;
  double score = 0;                 ///< sum over the members
  std::vector<KeyframeId> members;  ///< the one most alike among them
};

/// Which keyframes look like an image: their bags of words in an inverted file, and for each its direct
/// index (Galvez-Lopez and Tardos, Bags of binary words for fast place recognition in image sequences, T-RO
/// 2012; groups by covisibility as Mur-Artal and Tardos, ORB-SLAM, T-RO 2015). Results do not depend on the
/// order in which keyframes came. Const members may be called by several threads at once.
class PlaceDatabase {
 public:
  /// Throws Error(argument) for a null or empty vocabulary or one whose score does not grow with likeness
  /// (Kullback-Leibler), and for an index level that it does not have.
  explicit PlaceDatabase(std::shared_ptr<const OrbVocabulary> vocabulary,
                         const PlaceDatabaseOptions& options = {});

  const PlaceDatabaseOptions& options() const { return options_; }
  const OrbVocabulary& vocabulary() const { return *vocabulary_; }

  /// What recognition needs of a frame or a keyframe. Throws Error(argument) where measurements and
  /// descriptors differ in number.
  PlaceImage image(const StereoFrame& frame) const;
  PlaceImage image(const Keyframe& keyframe) const;

  /// False, and nothing changes, for a keyframe that is there already, or a blind one.
  bool add(const Keyframe& keyframe);
  /// As add, for one whose words are known: `image.keyframe` names it.
  bool add(const PlaceImage& image);
  /// False if there is no such keyframe.
  bool erase(KeyframeId id);
  /// Adds the keyframes of the map that are missing and erases those that it has no more.
  void follow(const Map& map);
  void clear();

  bool contains(KeyframeId id) const { return indices_.count(id) > 0; }
  std::size_t size() const { return indices_.size(); }
  /// The direct index of a keyframe, or null. Valid until it is erased.
  const DirectIndex* index(KeyframeId id) const;
  /// What it takes, without the vocabulary [bytes].
  std::size_t memory_bytes() const;

  /// Groups of keyframes that look like the image, over all maps, best first within each map, maps in the
  /// order of their best; ties by id. A keyframe that the image is, and what the options exclude for it, is
  /// no candidate and in no group.
  /// @param without maps that are left out, nor set the standard of likeness
  std::vector<PlaceGroup> candidates(const PlaceImage& image, const Map& map,
                                     std::span<const MapId> without = {}) const;

 private:
  struct Entry {
    DirectIndex index;
    std::size_t words = 0;
  };

  template <class Source>
  PlaceImage make_image(const Source& source) const;

  std::shared_ptr<const OrbVocabulary> vocabulary_;
  PlaceDatabaseOptions options_;
  InvertedFile file_;
  std::map<KeyframeId, Entry> indices_;
  std::size_t words_ = 0;  // in all bags
};

/// The vocabulary of a file for place recognition; throws Error(io), or Error(data) with both lengths where
/// its descriptors are not those of ORB.
std::shared_ptr<const OrbVocabulary> open_place_vocabulary(const std::string& path);

}  // namespace sweepkit
