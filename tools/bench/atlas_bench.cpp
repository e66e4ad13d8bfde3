// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
//
// Saving and loading an atlas, and choosing what to cull, one thread. The maps are made of random numbers in
// the amounts of a drive: 600 measurements a keyframe, 40 new points, each seen by 5 keyframes in a row, as
// maps of simulated flats have. "encode" and "decode" are the same from and to memory.
//
// Nobody else writes the same content, so the rival "bytes" is the least that has to be done with it: the
// same bytes written in one piece to a new file, on the disk (fsync) before it takes the old one's place; and
// read in one piece and run through CRC-32. Counters: bytes of the file, and for culling the keyframes
// chosen.
#include <benchmark/benchmark.h>
#include <fcntl.h>
#include <unistd.h>
#include <zlib.h>

#include <cmath>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <map>
#include <string>
#include <vector>

#include "sweepkit/core/random.hpp"
#include "sweepkit/data/atlas_file.hpp"
#include "sweepkit/slam/map_culling.hpp"

namespace {

using namespace sweepkit;

Map make_map(int keyframes) {
  Random random(1);
  Map map;
  const MapId id = map.add_map();
  KeyframeId last;
  for (int k = 0; k < keyframes; ++k) {
    Keyframe keyframe;
    keyframe.map = id;
    keyframe.parent = last;
    // Round and round through a flat of 8 m by 5 m.
    const double way = 0.02 * k;
    keyframe.T_camera_world =
        SE3d(SO3d::exp({0, way, 0}), {4 * std::sin(way), 0.01 * random.normal(), 2.5 * std::cos(way)})
            .inverse();
    keyframe.measurements.resize(600);
    for (Measurement& m : keyframe.measurements) {
      m.u = static_cast<float>(random.uniform(0, 640));
      m.v = static_cast<float>(random.uniform(0, 400));
      m.u_right = m.u - static_cast<float>(random.uniform(1, 50));
    }
    keyframe.descriptors.resize(600);
    for (OrbDescriptor& d : keyframe.descriptors)
      for (std::uint64_t& word : d.words) word = random();
    const KeyframeId next = map.add_keyframe(std::move(keyframe));
    if (last.valid())
      for (std::uint32_t i = 0; i < 160; ++i)
        if (const PointId point = map.keyframe(last).points[i]; point.valid())
          map.add_observation(point, next, i + 40);
    for (std::uint32_t i = 0; i < 40; ++i)
      map.add_point({random.normal(), random.normal(), random.normal()}, next, i);
    last = next;
  }
  return map;
}

const Map& map_of(int keyframes) {
  static std::map<int, Map> maps;
  auto it = maps.find(keyframes);
  if (it == maps.end()) it = maps.emplace(keyframes, make_map(keyframes)).first;
  return it->second;
}

const AtlasInfo& info() {
  static const AtlasInfo made = [] {
    const Camera camera({400, 400, 320, 200}, Distortion::none, {}, 640, 400);
    AtlasInfo info;
    info.rig = identity_of(StereoRig(camera, camera, SE3d(), SE3d(SO3d(), {0.1, 0, 0})));
    return info;
  }();
  return made;
}

std::string scratch() {
  return (std::filesystem::temp_directory_path() / ("atlas_bench." + std::to_string(::getpid()))).string();
}

void count_bytes(benchmark::State& state, std::size_t bytes) {
  state.counters["bytes"] = static_cast<double>(bytes);
  state.SetBytesProcessed(state.iterations() * static_cast<std::int64_t>(bytes));
}

void save(benchmark::State& state) {
  const Map& map = map_of(static_cast<int>(state.range(0)));
  const std::string path = scratch();
  for (auto _ : state) write_atlas(path, info(), map);
  count_bytes(state, std::filesystem::file_size(path));
  std::filesystem::remove(path);
}

void save_bytes(benchmark::State& state) {
  const auto bytes = encode_atlas(info(), map_of(static_cast<int>(state.range(0))));
  const std::string path = scratch(), part = path + ".part";
  for (auto _ : state) {
    const int fd = ::open(part.c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0666);
    const bool written = ::write(fd, bytes.data(), bytes.size()) == static_cast<::ssize_t>(bytes.size());
    if (!written || ::fsync(fd) != 0) state.SkipWithError("cannot write");
    ::close(fd);
    std::filesystem::rename(part, path);
  }
  count_bytes(state, bytes.size());
  std::filesystem::remove(path);
}

void load(benchmark::State& state) {
  const std::string path = scratch();
  write_atlas(path, info(), map_of(static_cast<int>(state.range(0))));
  for (auto _ : state) benchmark::DoNotOptimize(read_atlas(path));
  count_bytes(state, std::filesystem::file_size(path));
  std::filesystem::remove(path);
}

void load_bytes(benchmark::State& state) {
  const std::string path = scratch();
  write_atlas(path, info(), map_of(static_cast<int>(state.range(0))));
  const std::size_t bytes = std::filesystem::file_size(path);
  for (auto _ : state) {
    std::vector<char> content(bytes);
    std::ifstream(path, std::ios::binary).read(content.data(), static_cast<std::streamsize>(bytes));
    benchmark::DoNotOptimize(crc32_z(0, reinterpret_cast<const Bytef*>(content.data()), bytes));
  }
  count_bytes(state, bytes);
  std::filesystem::remove(path);
}

void encode(benchmark::State& state) {
  const Map& map = map_of(static_cast<int>(state.range(0)));
  std::size_t bytes = 0;
  for (auto _ : state) bytes = encode_atlas(info(), map).size();
  count_bytes(state, bytes);
}

void decode(benchmark::State& state) {
  const auto bytes = encode_atlas(info(), map_of(static_cast<int>(state.range(0))));
  for (auto _ : state) benchmark::DoNotOptimize(decode_atlas(bytes));
  count_bytes(state, bytes.size());
}

void cull(benchmark::State& state) {
  const Map& map = map_of(static_cast<int>(state.range(0)));
  const MapCaps caps{.max_keyframes = static_cast<int>(state.range(0)) - 1, .max_memory = 1e5};
  std::size_t chosen = 0;
  for (auto _ : state) chosen = choose_culls(map, caps).size();
  state.counters["chosen"] = static_cast<double>(chosen);
  state.counters["memory"] = static_cast<double>(map.memory_bytes());
}

BENCHMARK(save)->Name("data/atlas_save/sweepkit")->Arg(200)->Arg(1000)->Unit(benchmark::kMillisecond);
BENCHMARK(save_bytes)->Name("data/atlas_save/bytes")->Arg(200)->Arg(1000)->Unit(benchmark::kMillisecond);
BENCHMARK(load)->Name("data/atlas_load/sweepkit")->Arg(200)->Arg(1000)->Unit(benchmark::kMillisecond);
BENCHMARK(load_bytes)->Name("data/atlas_load/bytes")->Arg(200)->Arg(1000)->Unit(benchmark::kMillisecond);
BENCHMARK(encode)->Name("data/atlas_encode/sweepkit")->Arg(1000)->Unit(benchmark::kMillisecond);
BENCHMARK(decode)->Name("data/atlas_decode/sweepkit")->Arg(1000)->Unit(benchmark::kMillisecond);
BENCHMARK(cull)->Name("slam/cull/sweepkit")->Arg(1000)->Unit(benchmark::kMillisecond);

}  // namespace
