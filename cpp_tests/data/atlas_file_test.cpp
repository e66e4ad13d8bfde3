// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/data/atlas_file.hpp"

#include <sys/resource.h>

#include <catch2/catch.hpp>
#include <csignal>
#include <cstring>
#include <fstream>
#include <iterator>
#include <limits>
#include <string>

#include "data/error_text.hpp"
#include "data/random_atlas.hpp"
#include "scratch_folder.hpp"
#include "sweepkit/core/version.hpp"

using namespace sweepkit;

namespace {

bool same(const SE3d& a, const SE3d& b) {
  return a.rotation().quaternion().coeffs() == b.rotation().quaternion().coeffs() &&
         a.translation() == b.translation();
}

bool same(const CameraIdentity& a, const CameraIdentity& b) {
  return a.width == b.width && a.height == b.height && a.intrinsics == b.intrinsics &&
         a.distortion == b.distortion && a.coefficients == b.coefficients &&
         same(a.T_body_camera, b.T_body_camera);
}

// Where the points of the saved map are in the loaded one.
std::vector<PointId> new_numbers(const Map& saved) {
  std::vector<PointId> number(saved.point_id_end());
  std::uint32_t next = 0;
  for (std::uint32_t i = 0; i < saved.point_id_end(); ++i)
    if (saved.find(PointId{i})) number[i] = PointId{next++};
  return number;
}

void require_same(const Map& saved, const Map& loaded) {
  REQUIRE(!loaded.broken_invariant());
  REQUIRE(loaded.map_count() == saved.map_count());
  REQUIRE(loaded.keyframe_id_end() == saved.keyframe_id_end());
  REQUIRE(loaded.keyframe_count() == saved.keyframe_count());
  REQUIRE(loaded.point_count() == saved.point_count());
  const std::vector<PointId> number = new_numbers(saved);
  for (std::uint32_t i = 0; i < saved.keyframe_id_end(); ++i) {
    const KeyframeId id{i};
    const Keyframe *a = saved.find(id), *b = loaded.find(id);
    REQUIRE((a == nullptr) == (b == nullptr));
    REQUIRE(same(saved.T_camera_world(id), loaded.T_camera_world(id)));
    if (!a) continue;
    CHECK(a->id == b->id);
    CHECK(a->map == b->map);
    CHECK(a->t == b->t);
    CHECK(a->parent == b->parent);
    CHECK(a->covariance == b->covariance);
    REQUIRE(a->measurements.size() == b->measurements.size());
    if (!a->blind())
      CHECK(std::memcmp(a->measurements.data(), b->measurements.data(),
                        a->measurements.size() * sizeof(Measurement)) == 0);
    CHECK(a->descriptors == b->descriptors);
    for (std::size_t m = 0; m < a->points.size(); ++m)
      CHECK(b->points[m] == (a->points[m].valid() ? number[a->points[m].value] : PointId{}));
    REQUIRE(a->covisible.size() == b->covisible.size());
    for (std::size_t c = 0; c < a->covisible.size(); ++c) {
      CHECK(a->covisible[c].keyframe == b->covisible[c].keyframe);
      CHECK(a->covisible[c].points == b->covisible[c].points);
    }
    REQUIRE(a->odometry.has_value() == b->odometry.has_value());
    if (!a->odometry) continue;
    CHECK(a->odometry->from == b->odometry->from);
    CHECK(same(a->odometry->motion.T, b->odometry->motion.T));
    CHECK(a->odometry->motion.covariance == b->odometry->motion.covariance);
  }
  for (std::uint32_t i = 0; i < saved.point_id_end(); ++i) {
    const MapPoint* a = saved.find(PointId{i});
    if (!a) continue;
    const MapPoint& b = loaded.point(number[i]);
    CHECK(b.id == number[i]);
    CHECK(a->p_world == b.p_world);
    CHECK(a->descriptor == b.descriptor);
    CHECK(a->normal == b.normal);
    CHECK(a->min_distance == b.min_distance);
    CHECK(a->max_distance == b.max_distance);
    CHECK(a->first_keyframe == b.first_keyframe);
    CHECK(a->predicted == b.predicted);
    CHECK(a->found == b.found);
    REQUIRE(a->observations.size() == b.observations.size());
    for (std::size_t o = 0; o < a->observations.size(); ++o) {
      CHECK(a->observations[o].keyframe == b.observations[o].keyframe);
      CHECK(a->observations[o].index == b.observations[o].index);
    }
  }
}

std::string content(const std::filesystem::path& file) {
  std::ifstream stream(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), {}};
}

std::size_t files_in(const std::filesystem::path& folder) {
  return static_cast<std::size_t>(std::distance(std::filesystem::directory_iterator(folder), {}));
}

}  // namespace

TEST_CASE("an atlas comes back as it was written, to the bit") {
  ScratchFolder folder;
  const std::string path = (folder / "atlas.swk").string();
  for (const std::uint64_t seed : {1, 2, 3, 4}) {
    const Map map = random_map(seed, 6 + 5 * static_cast<int>(seed), 40);
    REQUIRE(map.keyframe_count() < map.keyframe_id_end());
    REQUIRE(map.point_count() < map.point_id_end());
    const AtlasInfo info = random_info(seed, map);
    write_atlas(path, info, map);
    const Atlas atlas = read_atlas(path);
    require_same(map, atlas.map);
    CHECK(same(atlas.info.rig.left, info.rig.left));
    CHECK(same(atlas.info.rig.right, info.rig.right));
    CHECK(atlas.info.descriptor_type == "orb");
    CHECK(atlas.info.descriptor_bits == 256);
    CHECK(atlas.info.vocabulary == "default");
    CHECK(atlas.info.vocabulary_checksum == info.vocabulary_checksum);
    CHECK(atlas.info.disparity_bias == info.disparity_bias);
    CHECK(atlas.info.disparity_bias_sigma == info.disparity_bias_sigma);
    CHECK(atlas.info.gravity_known == info.gravity_known);
    CHECK(atlas.info.software == version());
    REQUIRE(atlas.info.attachments.size() == 2);
    const auto& scans = atlas.info.attachments.at("floor_scans");
    REQUIRE(scans.size() == map.keyframe_count());
    for (std::size_t i = 0; i < scans.size(); ++i) {
      CHECK(scans[i].keyframe == info.attachments.at("floor_scans")[i].keyframe);
      CHECK(scans[i].bytes == info.attachments.at("floor_scans")[i].bytes);
    }
    // The loaded one is written as the same bytes, to a file and to memory.
    const std::string first = content(path);
    write_atlas(path, atlas);
    CHECK(content(path) == first);
    const auto memory = encode_atlas(info, map);
    REQUIRE(memory.size() == first.size());
    CHECK(std::memcmp(memory.data(), first.data(), first.size()) == 0);
    require_same(map, decode_atlas(memory).map);
  }
  CHECK(files_in(folder.path()) == 1);
}

TEST_CASE("sections larger than every buffer come back as well") {
  Map map = random_map(5, 40, 3000);
  AtlasInfo info = random_info(5, map);
  info.attachments["floor_scans"].front().bytes.assign(300000, std::byte{3});
  ScratchFolder folder;
  const std::string path = (folder / "atlas.swk").string();
  write_atlas(path, info, map);
  CHECK(std::filesystem::file_size(path) > 5000000);
  const Atlas atlas = read_atlas(path);
  CHECK(encode_atlas(info, map) == encode_atlas(atlas.info, atlas.map));
  CHECK(atlas.info.attachments.at("floor_scans").front().bytes ==
        info.attachments.at("floor_scans").front().bytes);
}

TEST_CASE("an atlas of nothing can be written and read") {
  AtlasInfo info;
  info.rig = identity_of(small_rig());
  Map empty, begun;
  begun.add_map();
  for (const Map* map : {&empty, &begun}) {
    const Atlas atlas = decode_atlas(encode_atlas(info, *map));
    require_same(*map, atlas.map);
    CHECK(atlas.info.gravity_known == std::vector<bool>(map->map_count(), false));
    CHECK(atlas.info.vocabulary.empty());
  }
}

TEST_CASE("a map goes on where it was saved") {
  Map map = random_map(7, 14, 30);
  Map loaded = decode_atlas(encode_atlas(random_info(7, map), map)).map;
  const auto go_on = [](Map& m) {
    const KeyframeId parent = m.find(KeyframeId{m.keyframe_id_end() - 1})->id;
    Keyframe next;
    next.map = m.keyframe(parent).map;
    next.parent = parent;
    next.measurements.resize(3);
    next.descriptors.resize(3);
    const KeyframeId id = m.add_keyframe(next);
    m.remove_keyframe(parent);
    m.add_point({1, 2, 3}, id, 1);
    return id;
  };
  const KeyframeId a = go_on(map), b = go_on(loaded);
  CHECK(a == b);
  // But for the numbers of points that are gone: written again they are the same.
  const AtlasInfo info = random_info(7, map);
  CHECK(encode_atlas(info, map) == encode_atlas(info, loaded));
}

TEST_CASE("attachments of keyframes that are gone go with them") {
  const Map map = random_map(1);
  AtlasInfo info;
  info.rig = identity_of(small_rig());
  for (std::uint32_t i = 0; i < map.keyframe_id_end(); ++i)
    info.attachments["all"].push_back({KeyframeId{i}, {std::byte{1}}});
  CHECK(decode_atlas(encode_atlas(info, map)).info.attachments.at("all").size() == map.keyframe_count());
  std::swap(info.attachments["all"][0], info.attachments["all"][1]);
  CHECK_THAT(error_text([&] { encode_atlas(info, map); }), Catch::Contains("sorted by keyframe"));
}

TEST_CASE("a disk that is full leaves the old atlas alone") {
  ScratchFolder folder;
  const std::string path = (folder / "atlas.swk").string();
  const Map small = random_map(1), large = random_map(2, 40, 2000);
  write_atlas(path, random_info(1, small), small);
  const std::string before = content(path);
  // What a full disk does to write(): no file may grow beyond this.
  rlimit old = {};
  getrlimit(RLIMIT_FSIZE, &old);
  auto* const handler = std::signal(SIGXFSZ, SIG_IGN);
  for (const rlim_t limit : {0, 100, 300000}) {
    const rlimit full = {limit, old.rlim_max};
    setrlimit(RLIMIT_FSIZE, &full);
    const std::string text = error_text([&] { write_atlas(path, random_info(2, large), large); });
    setrlimit(RLIMIT_FSIZE, &old);
    CHECK_THAT(text, Catch::StartsWith("io: " + path + ": cannot be written"));
    CHECK(content(path) == before);
    CHECK(files_in(folder.path()) == 1);
  }
  std::signal(SIGXFSZ, handler);
  write_atlas(path, random_info(2, large), large);
  CHECK(read_atlas(path).map.keyframe_count() == large.keyframe_count());
}

TEST_CASE("what cannot be written or read is named") {
  ScratchFolder folder;
  const Map map = random_map(1);
  const AtlasInfo info = random_info(1, map);
  const std::string nowhere = (folder / "none" / "atlas.swk").string();
  CHECK(error_text([&] { write_atlas(nowhere, info, map); }) ==
        "io: " + nowhere + ": cannot be written (got No such file or directory)");
  CHECK_THAT(error_text([&] { write_atlas(folder.path().string(), info, map); }),
             Catch::Contains("it is no file"));
  CHECK_THAT(error_text([&] { write_atlas("/dev/full", info, map); }), Catch::Contains("it is no file"));
  CHECK_THAT(error_text([&] { read_atlas(nowhere); }), Catch::Contains("cannot be opened"));
  CHECK_THAT(error_text([&] { read_atlas(folder.path().string()); }), Catch::Contains("is no file"));
  CHECK_THAT(error_text([&] { read_atlas(folder.write("empty", "").string()); }),
             Catch::Contains("too short"));
  CHECK_THAT(error_text([&] { read_atlas(folder.write("text", std::string(100, 'x')).string()); }),
             Catch::Contains("text: is no atlas"));
}

TEST_CASE("an atlas of another rig is refused by what differs") {
  AtlasInfo info;
  info.rig = identity_of(small_rig());
  CHECK(error_text([&] { check_same_rig(info, small_rig()); }).empty());
  const auto refusal = [&](auto change) {
    AtlasInfo other = info;
    change(other.rig);
    return error_text([&] { check_same_rig(other, small_rig(), "atlas.swk"); });
  };
  CHECK(refusal([](RigIdentity& r) { r.left.intrinsics[0] += 2; }) ==
        "data: atlas.swk: was made with another rig: left fx: 402.5 there, 400.5 here (tolerance 0.001 px)");
  CHECK_THAT(refusal([](RigIdentity& r) { r.right.width = 752; }),
             Catch::Contains("right image size: 752x400"));
  CHECK_THAT(refusal([](RigIdentity& r) { r.right.coefficients[1] = 0.3; }),
             Catch::Contains("right distortion coefficient 2: 0.3 there, 0.09 here"));
  CHECK_THAT(refusal([](RigIdentity& r) { r.left.distortion = Distortion::equidistant; }),
             Catch::Contains("left distortion model: equidistant there, radial-tangential here"));
  CHECK_THAT(refusal([](RigIdentity& r) {
               r.right.T_body_camera = SE3d(r.right.T_body_camera.rotation(),
                                            r.right.T_body_camera.translation() + Vec3<double>(0, 0.001, 0));
             }),
             Catch::Contains("right camera in the body, y: ") && Catch::Contains("tolerance 1e-05 m"));
  CHECK_THAT(
      refusal([](RigIdentity& r) {
        r.left.T_body_camera = SE3d(r.left.T_body_camera.rotation() * SO3d::exp({0.01, 0, 0}),
                                    r.left.T_body_camera.translation());
      }),
      Catch::Contains("left camera in the body, rotation vector") && Catch::Contains("0.573 deg apart"));
  // Written with fewer digits it is the same rig; so is one whose fifth coefficient is told to be zero.
  CHECK(refusal([](RigIdentity& r) {
          r.left.intrinsics[2] += 1e-5;
          r.left.coefficients.push_back(0);
          r.left.T_body_camera = r.left.T_body_camera * SE3d::exp(Vec6<double>::Constant(1e-7));
        }).empty());
}
