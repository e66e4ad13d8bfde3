// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <bit>
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "sweepkit/map/keyframe.hpp"

// The layout of atlas.swk; include/sweepkit/data/README.md tells it field by field.
namespace sweepkit::atlas_format {

static_assert(std::endian::native == std::endian::little, "atlases are little endian");
// Measurements and descriptors are copied as they lie in memory.
static_assert(sizeof(Measurement) == 28 && offsetof(Measurement, u) == 0 && offsetof(Measurement, v) == 4 &&
              offsetof(Measurement, u_right) == 8 && offsetof(Measurement, sigma) == 12 &&
              offsetof(Measurement, sigma_right) == 16 && offsetof(Measurement, angle) == 20 &&
              offsetof(Measurement, octave) == 24);
static_assert(sizeof(OrbDescriptor) == 32);

inline constexpr char kMagic[8] = {'s', 'w', 'k', 'a', 't', 'l', '\r', '\n'};
inline constexpr std::uint32_t kVersion = 1;
inline constexpr std::uint32_t kByteOrder = 0x01020304;

/// magic 8, version 4, byte order 4, bytes of the file 8, number of sections 4, CRC-32 of the table 4.
inline constexpr std::size_t kHeaderBytes = 32;
/// name 16, offset 8, bytes 8, CRC-32 4, zero 4; the table follows the header.
inline constexpr std::size_t kEntryBytes = 40;
inline constexpr std::size_t kNameBytes = 16;

/// The sections that each file has, in this order; attachments follow.
inline constexpr std::string_view kSections[] = {"about", "rig", "removed", "keyframes", "points"};
inline constexpr std::string_view kAttachment = "attachment";
inline constexpr std::uint32_t kMaxAttachments = 64;
inline constexpr std::uint32_t kMaxText = 4096;

inline constexpr std::size_t kPoseBytes = 7 * 8;
inline constexpr std::size_t kCovarianceBytes = 36 * 8;
inline constexpr std::size_t kRemovedBytes = 8 + kPoseBytes;
/// Without odometry, measurements and covisible keyframes.
inline constexpr std::size_t kKeyframeBytes = 32 + kPoseBytes + kCovarianceBytes;
inline constexpr std::size_t kMeasurementBytes = sizeof(Measurement) + sizeof(OrbDescriptor);
inline constexpr std::size_t kCovisibleBytes = 8;
/// Without observations.
inline constexpr std::size_t kPointBytes = 24 + 32 + 20 + 16;
inline constexpr std::size_t kObservationBytes = 8;
inline constexpr std::size_t kPieceBytes = 16;
inline constexpr std::uint32_t kHasOdometry = 1;
inline constexpr std::int32_t kMaxOctave = 63;

}  // namespace sweepkit::atlas_format
