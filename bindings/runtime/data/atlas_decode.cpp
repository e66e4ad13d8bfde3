// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <cstring>
#include <utility>

#include "atlas_reader.hpp"
#include "sweepkit/core/error.hpp"
#include "sweepkit/data/atlas_file.hpp"

namespace sweepkit {
namespace {

namespace format = atlas_format;
using format::Origin, format::Reader, format::Section;

struct Counts {
  std::uint32_t keyframes = 0, keyframe_id_end = 0, points = 0;
};

void read_about(Reader& in, AtlasInfo& info, MapParts& parts, Counts& counts) {
  info.software = in.text();
  info.descriptor_type = in.text();
  const auto bits = in.number<std::uint32_t>();
  if (info.descriptor_type != "orb" || bits != OrbDescriptor::kBits)
    in.fail("has descriptors that are not orb of 256 bits; bits", bits);
  info.descriptor_bits = static_cast<int>(bits);
  info.vocabulary = in.text();
  info.vocabulary_checksum = in.number<std::uint64_t>();
  info.disparity_bias = in.finite<double>("the bias of disparities is no number");
  info.disparity_bias_sigma = in.finite<double>("the sigma of that bias is no number");
  if (info.disparity_bias_sigma < 0)
    in.fail("the sigma of the bias of disparities is negative", info.disparity_bias_sigma);
  counts.keyframes = in.number<std::uint32_t>();
  counts.keyframe_id_end = in.number<std::uint32_t>();
  counts.points = in.number<std::uint32_t>();
  parts.map_count = in.number<std::uint32_t>();
  in.expect(parts.map_count, 1, "says of too few maps whether gravity is known; maps");
  info.gravity_known.reserve(parts.map_count);
  for (std::uint32_t i = 0; i < parts.map_count; ++i)
    info.gravity_known.push_back(in.number<std::uint8_t>(0, 1, "gravity is neither known nor unknown") != 0);
  in.end();
}

CameraIdentity read_camera(Reader& in) {
  CameraIdentity camera;
  camera.width = static_cast<int>(in.number<std::uint32_t>(1, 1u << 20, "a camera has a wrong width"));
  camera.height = static_cast<int>(in.number<std::uint32_t>(1, 1u << 20, "a camera has a wrong height"));
  for (int i = 0; i < 4; ++i) camera.intrinsics.push_back(in.finite<double>("intrinsics are no number"));
  const std::string name = in.text();
  const auto models = {Distortion::none, Distortion::radial_tangential, Distortion::equidistant};
  const auto* found =
      std::find_if(models.begin(), models.end(), [&](Distortion d) { return to_string(d) == name; });
  if (found == models.end()) in.fail("has an unknown model of distortion; letters", name.size());
  camera.distortion = *found;
  const auto count = in.number<std::uint32_t>(0, 8, "a distortion has too many coefficients");
  for (std::uint32_t i = 0; i < count; ++i)
    camera.coefficients.push_back(in.finite<double>("a coefficient is no number"));
  camera.T_body_camera = in.pose();
  return camera;
}

void read_removed(Reader& in, MapParts& parts, const Counts& counts) {
  const std::uint64_t count = in.remaining() / format::kRemovedBytes;
  if (counts.keyframe_id_end != counts.keyframes + count) in.fail("has a wrong number of keyframes", count);
  parts.removed.reserve(static_cast<std::size_t>(count));
  for (std::uint64_t i = 0; i < count; ++i) {
    const KeyframeId id{in.number<std::uint32_t>(0, counts.keyframe_id_end - 1, "there is no such keyframe")};
    if (parts.removed.contains(id)) in.fail("a keyframe was removed twice", id.value);
    const KeyframeId parent{
        in.number<std::uint32_t>(0, counts.keyframe_id_end - 1, "there is no such parent")};
    parts.removed[id] = {parent, in.pose()};
  }
  in.end();
}

void read_measurements(Reader& in, Keyframe& keyframe, std::uint32_t count) {
  keyframe.measurements.resize(count);
  in.bytes(keyframe.measurements.data(), count * sizeof(Measurement));
  for (const Measurement& m : keyframe.measurements) {
    for (const float value : {m.u, m.v, m.u_right, m.angle})
      if (!std::isfinite(value)) in.fail("a measurement is no number", value);
    for (const float value : {m.sigma, m.sigma_right})
      if (!std::isfinite(value) || !(value > 0)) in.fail("a measurement has a wrong sigma", value);
    if (m.octave < 0 || m.octave > format::kMaxOctave) in.fail("a measurement has a wrong octave", m.octave);
  }
  keyframe.descriptors.resize(count);
  in.bytes(keyframe.descriptors.data(), count * sizeof(OrbDescriptor));
  keyframe.points.assign(count, PointId{});
}

void read_keyframes(Reader& in, MapParts& parts, const Counts& counts) {
  in.expect(counts.keyframes, format::kKeyframeBytes, "has a wrong number of keyframes");
  parts.keyframes.resize(counts.keyframe_id_end);
  std::vector<std::uint32_t> later(counts.keyframe_id_end, 0);  // covisible keyframes with larger ids
  std::uint32_t least = 0;
  for (std::uint32_t i = 0; i < counts.keyframes; ++i) {
    const KeyframeId id{
        in.number<std::uint32_t>(least, counts.keyframe_id_end - 1, "keyframes are out of order")};
    if (parts.removed.contains(id)) in.fail("a removed keyframe lives", id.value);
    least = id.value + 1;
    auto keyframe = std::make_unique<Keyframe>();
    keyframe->id = id;
    keyframe->map = MapId{in.number<std::uint32_t>()};
    if (keyframe->map.value >= parts.map_count) in.fail("there is no such map", keyframe->map.value);
    keyframe->t = in.number<std::int64_t>();
    keyframe->parent = KeyframeId{in.number<std::uint32_t>()};
    const auto flags = in.number<std::uint32_t>(0, format::kHasOdometry, "has unknown flags");
    const auto count = in.number<std::uint32_t>();
    in.expect(count, format::kMeasurementBytes, "a keyframe has more measurements than bytes");
    const auto before = in.number<std::uint32_t>();
    in.expect(before, format::kCovisibleBytes, "a keyframe has more covisible ones than bytes");
    keyframe->T_camera_world = in.pose();
    keyframe->covariance = in.covariance();
    if (flags & format::kHasOdometry) {
      const KeyframeId from{in.number<std::uint32_t>()};
      const SE3d T = in.pose();
      keyframe->odometry = OdometryEdge{from, {T, in.covariance()}};
    }
    read_measurements(in, *keyframe, count);
    in.expect(before, format::kCovisibleBytes, "a keyframe has more covisible ones than bytes");
    keyframe->covisible.reserve(before);
    for (std::uint32_t c = 0; c < before; ++c) {
      const KeyframeId other{in.number<std::uint32_t>()};
      if (other >= id || !parts.keyframes[other.value] ||
          (c > 0 && keyframe->covisible.back().keyframe >= other))
        in.fail("a keyframe is covisible with a wrong one", other.value);
      ++later[other.value];
      const auto points = in.number<std::uint32_t>(1, count, "keyframes share a wrong number of points");
      keyframe->covisible.push_back({other, static_cast<int>(points)});
    }
    parts.keyframes[id.value] = std::move(keyframe);
  }
  in.end();

  // The other half of each pair, in the order of ids by itself.
  for (const auto& keyframe : parts.keyframes) {
    if (!keyframe) continue;
    const auto before = keyframe->covisible.size();
    std::vector<Covisible> all;
    all.reserve(before + later[keyframe->id.value]);
    all.assign(keyframe->covisible.begin(), keyframe->covisible.end());
    keyframe->covisible = std::move(all);
    for (std::size_t c = 0; c < before; ++c) {
      const Covisible pair = keyframe->covisible[c];
      parts.keyframes[pair.keyframe.value]->covisible.push_back({keyframe->id, pair.points});
    }
  }
}

void read_points(Reader& in, MapParts& parts, const Counts& counts) {
  in.expect(counts.points, format::kPointBytes + format::kObservationBytes, "has a wrong number of points");
  parts.points.resize(counts.points);
  for (std::uint32_t i = 0; i < counts.points; ++i) {
    auto point = std::make_unique<MapPoint>();
    point->id = PointId{i};
    in.finite(point->p_world, "a point is no number");
    in.bytes(&point->descriptor, sizeof(OrbDescriptor));
    in.finite(point->normal, "a normal is no number");
    point->min_distance = in.finite<float>("a distance is no number");
    point->max_distance = in.finite<float>("a distance is no number");
    point->first_keyframe = KeyframeId{in.number<std::uint32_t>()};
    if (point->first_keyframe.value >= counts.keyframe_id_end)
      in.fail("there is no such keyframe", point->first_keyframe.value);
    point->predicted = in.number<std::int32_t>(0, INT32_MAX, "a point was predicted less than never");
    point->found = in.number<std::int32_t>(0, INT32_MAX, "a point was found less than never");
    const auto count = in.number<std::uint32_t>(1, UINT32_MAX, "a point has no observation");
    in.expect(count, format::kObservationBytes, "a point has more observations than bytes");
    point->observations.reserve(count);
    for (std::uint32_t k = 0; k < count; ++k) {
      const KeyframeId id{in.number<std::uint32_t>()};
      if (id.value >= parts.keyframes.size() || !parts.keyframes[id.value] ||
          (k > 0 && point->observations.back().keyframe >= id))
        in.fail("a point is seen by a wrong keyframe", id.value);
      Keyframe& keyframe = *parts.keyframes[id.value];
      const auto index = in.number<std::uint32_t>();
      if (index >= keyframe.points.size() || keyframe.points[index].valid())
        in.fail("a point is seen at a wrong measurement", index);
      keyframe.points[index] = point->id;
      point->observations.push_back({id, index});
    }
    parts.points[i] = std::move(point);
  }
  in.end();
}

void read_attachments(Reader& in, AtlasInfo& info, const MapParts& parts) {
  const std::string name = in.text();
  if (name.empty() || info.attachments.contains(name))
    in.fail("has no name of its own; letters", name.size());
  const auto count = in.number<std::uint64_t>();
  in.expect(count, format::kPieceBytes, "has more pieces than bytes");
  std::vector<KeyframeAttachment>& pieces = info.attachments[name];
  pieces.reserve(static_cast<std::size_t>(count));
  for (std::uint64_t i = 0; i < count; ++i) {
    const auto id = in.number<std::uint64_t>();
    if (id >= parts.keyframes.size() || !parts.keyframes[id] || (i > 0 && pieces.back().keyframe.value >= id))
      in.fail("belongs to a wrong keyframe", id);
    const auto bytes = in.number<std::uint64_t>();
    in.expect(bytes, 1, "a piece is longer than the section; bytes");
    KeyframeAttachment& piece = pieces.emplace_back();
    piece.keyframe = KeyframeId{static_cast<std::uint32_t>(id)};
    piece.bytes.resize(static_cast<std::size_t>(bytes));
    in.bytes(piece.bytes.data(), piece.bytes.size());
  }
  in.end();
}

Atlas decode(Origin& origin) {
  std::vector<std::byte> window(format::kWindow);
  const std::vector<Section> sections = format::read_table(origin, window);
  const auto reader = [&](std::size_t i) { return Reader(origin, sections[i], window); };
  Atlas atlas;
  MapParts parts;
  Counts counts;
  Reader about = reader(0), rig = reader(1), removed = reader(2), keyframes = reader(3), points = reader(4);
  read_about(about, atlas.info, parts, counts);
  atlas.info.rig.left = read_camera(rig);
  atlas.info.rig.right = read_camera(rig);
  rig.end();
  read_removed(removed, parts, counts);
  read_keyframes(keyframes, parts, counts);
  read_points(points, parts, counts);
  for (std::size_t i = std::size(format::kSections); i < sections.size(); ++i) {
    Reader attachment = reader(i);
    read_attachments(attachment, atlas.info, parts);
  }
  try {
    atlas.map = Map(std::move(parts));
  } catch (const Error& error) {
    throw Error(ErrorKind::data, origin.place, std::string("holds a map that cannot be: ") + error.what());
  }
  return atlas;
}

}  // namespace

Atlas read_atlas(const std::string& path) {
  format::FileOrigin file(path);
  return decode(file);
}

Atlas decode_atlas(std::span<const std::byte> bytes, const std::string& place) {
  format::MemoryOrigin memory(bytes, place);
  return decode(memory);
}

void check_same_rig(const AtlasInfo& info, const StereoRig& rig, const std::string& place) {
  if (const auto what = difference(info.rig, identity_of(rig)))
    throw Error(ErrorKind::data, place, "was made with another rig: " + *what);
}

}  // namespace sweepkit
