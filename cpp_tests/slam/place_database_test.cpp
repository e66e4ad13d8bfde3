// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/slam/place_database.hpp"

#include <catch2/catch.hpp>
#include <filesystem>

#include "scratch_folder.hpp"
#include "slam/place_world.hpp"
#include "sweepkit/bow/vocabulary_file.hpp"

using namespace sweepkit;

namespace {

constexpr TimeNs kSecond = 1000000000LL;

// Three rooms, seen one after the other by keyframes that look along x; then the first one again.
struct Rooms {
  PlaceWorld world;
  Map map;
  MapId id;
  std::vector<KeyframeId> keyframes;  // four of each room, then four of the first
  std::shared_ptr<const OrbVocabulary> vocabulary;

  Rooms() {
    for (int room = 0; room < 3; ++room)
      world.add_room(10 * room, 0, 900, static_cast<std::uint64_t>(room + 1));
    id = map.add_map();
    for (int k = 0; k < 16; ++k) {
      const SE3d T = PlaceWorld::level_view(10 * (k / 4 % 3) - 1, 0.1 * (k % 4), 0.03 * k);
      keyframes.push_back(
          world.add_keyframe(map, id, T, T, static_cast<std::uint64_t>(k + 1), k * 10 * kSecond, k == 12));
    }
    vocabulary = world.vocabulary();
  }
};

bool same(const std::vector<PlaceGroup>& a, const std::vector<PlaceGroup>& b) {
  if (a.size() != b.size()) return false;
  for (std::size_t i = 0; i < a.size(); ++i)
    if (a[i].best != b[i].best || a[i].score != b[i].score || a[i].members != b[i].members) return false;
  return true;
}

VocabularyTree tree_of(int bits, BagScore score) {
  Random random(5);
  VocabularyTrainingOptions options;
  options.depth = 1;
  options.score = score;
  options.threads = 1;
  if (bits == 256) {
    std::vector<std::vector<BinaryDescriptor<256>>> images(2, std::vector<BinaryDescriptor<256>>(20));
    for (auto& image : images)
      for (auto& d : image)
        for (auto& word : d.words) word = random();
    return train_vocabulary<256>(std::span<const std::vector<BinaryDescriptor<256>>>(images), options);
  }
  std::vector<std::vector<BinaryDescriptor<128>>> images(2, std::vector<BinaryDescriptor<128>>(20));
  for (auto& image : images)
    for (auto& d : image)
      for (auto& word : d.words) word = random();
  return train_vocabulary<128>(std::span<const std::vector<BinaryDescriptor<128>>>(images), options);
}

}  // namespace

TEST_CASE("A place seen again is the first candidate, but not what is covisible or near in time", "[place]") {
  Rooms rooms;
  PlaceDatabase database(rooms.vocabulary);
  database.follow(rooms.map);
  CHECK(database.size() == 16);
  const PlaceImage image = database.image(rooms.map.keyframe(rooms.keyframes[13]));
  const auto groups = database.candidates(image, rooms.map);
  REQUIRE_FALSE(groups.empty());
  CHECK(groups.front().best < rooms.keyframes[4]);
  CHECK(groups.front().map == rooms.id);
  for (const PlaceGroup& group : groups)
    for (const KeyframeId member : group.members) {
      CHECK(rooms.map.shared_points(member, image.keyframe) == 0);
      CHECK(member != image.keyframe);
    }

  PlaceDatabaseOptions options;
  options.exclusion_time = 125;  // back to the keyframe of second 10
  options.min_share = 0;
  PlaceDatabase strict(rooms.vocabulary, options);
  strict.follow(rooms.map);
  for (const PlaceGroup& group : strict.candidates(image, rooms.map))
    for (const KeyframeId member : group.members) CHECK(member == rooms.keyframes[0]);

  options.exclusion_time = 0;
  options.exclude_covisible = false;
  PlaceDatabase open(rooms.vocabulary, options);
  open.follow(rooms.map);
  bool neighbour = false;
  for (const PlaceGroup& group : open.candidates(image, rooms.map))
    for (const KeyframeId member : group.members) neighbour = neighbour || member == rooms.keyframes[12];
  CHECK(neighbour);
}

TEST_CASE("Candidates do not depend on the order in which keyframes came", "[place]") {
  Rooms rooms;
  PlaceDatabase forward(rooms.vocabulary), backward(rooms.vocabulary), twice(rooms.vocabulary);
  forward.follow(rooms.map);
  for (std::size_t k = rooms.keyframes.size(); k-- > 0;)
    CHECK(backward.add(rooms.map.keyframe(rooms.keyframes[k])));
  twice.follow(rooms.map);
  for (const int k : {3, 7, 12}) CHECK(twice.erase(rooms.keyframes[static_cast<std::size_t>(k)]));
  CHECK_FALSE(twice.erase(rooms.keyframes[3]));
  CHECK(twice.size() == 13);
  CHECK(twice.memory_bytes() < forward.memory_bytes());
  twice.follow(rooms.map);
  CHECK_FALSE(twice.add(rooms.map.keyframe(rooms.keyframes[3])));
  CHECK(twice.size() == 16);
  for (const KeyframeId id : rooms.keyframes) {
    const PlaceImage image = forward.image(rooms.map.keyframe(id));
    CHECK(same(forward.candidates(image, rooms.map), backward.candidates(image, rooms.map)));
    CHECK(same(forward.candidates(image, rooms.map), twice.candidates(image, rooms.map)));
  }
  // A keyframe that has left the map is no candidate, and goes with the next follow().
  const PlaceImage image = forward.image(rooms.map.keyframe(rooms.keyframes[13]));
  rooms.map.remove_keyframe(rooms.keyframes[1]);
  for (const PlaceGroup& group : forward.candidates(image, rooms.map))
    CHECK(group.best != rooms.keyframes[1]);
  forward.follow(rooms.map);
  CHECK_FALSE(forward.contains(rooms.keyframes[1]));
}

TEST_CASE("A vocabulary that does not fit is refused", "[place]") {
  CHECK_THROWS_AS(PlaceDatabase(nullptr), Error);
  CHECK_THROWS_AS(PlaceDatabase(std::make_shared<const OrbVocabulary>()), Error);
  CHECK_THROWS_WITH(
      PlaceDatabase(std::make_shared<const OrbVocabulary>(tree_of(256, BagScore::kl)), {.index_level = 1}),
      Catch::Contains("Kullback"));
  CHECK_THROWS_WITH(
      PlaceDatabase(std::make_shared<const OrbVocabulary>(tree_of(256, BagScore::l1)), {.index_level = 3}),
      Catch::Contains("depth of 1"));
  const ScratchFolder folder;
  const std::string path = (folder / "short.swv").string();
  write_vocabulary(path, tree_of(128, BagScore::l1), VocabularyFormat::sweepkit);
  CHECK_THROWS_WITH(open_place_vocabulary(path), Catch::Contains("256") && Catch::Contains("128"));
  CHECK_THROWS_AS(open_place_vocabulary((folder / "absent.swv").string()), Error);
}

TEST_CASE("An image without features has no candidates", "[place]") {
  Rooms rooms;
  PlaceDatabase database(rooms.vocabulary);
  database.follow(rooms.map);
  const PlaceImage image = database.image(StereoFrame{});
  CHECK(database.candidates(image, rooms.map).empty());
  Keyframe blind;
  blind.id = KeyframeId{99};
  CHECK_FALSE(database.add(blind));
  StereoFrame odd;
  odd.measurements.resize(3);
  CHECK_THROWS_AS(database.image(odd), Error);
}
