// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/match/lines.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "sweepkit/core/error.hpp"

namespace sweepkit {

namespace {

constexpr double kRadian = std::numbers::pi / 180;
constexpr std::uint64_t kNobody = ~std::uint64_t{0};

bool is_finite(const Segment2d& s) {
  return std::isfinite(s.u1) && std::isfinite(s.v1) && std::isfinite(s.u2) && std::isfinite(s.v2);
}

double cosine(const Segment2d& a, const Segment2d& b) {
  return (static_cast<double>(a.du()) * b.du() + static_cast<double>(a.dv()) * b.dv()) /
         std::max(1e-9, static_cast<double>(a.length()) * b.length());
}

double distance_from_line(const Segment2d& line, float u, float v) {
  return std::abs((u - line.u1) * line.dv() - (v - line.v1) * line.du()) / std::max(1e-6f, line.length());
}

/// Whether two segments are pieces of one edge, or the same edge on two levels: the second is then no rival
/// of the first.
bool same_edge(const Segment2d& a, const Segment2d& b) {
  // Directions alike without a root: most pairs end here.
  if (!(a.du() * b.du() + a.dv() * b.dv() > 0)) return false;
  return cosine(a, b) > 0.99 && distance_from_line(a, 0.5f * (b.u1 + b.u2), 0.5f * (b.v1 + b.v2)) < 2.5;
}

/// The nearest two descriptors among the candidates of a segment.
struct Nearest {
  int best = std::numeric_limits<int>::max(), second = best;
  std::int32_t index = -1;

  void offer(std::int32_t i, int distance, std::span<const Segment2d> segments) {
    if (distance >= second) return;
    const bool rival = index >= 0 && !same_edge(segments[index], segments[i]);
    if (distance < best || (distance == best && i < index)) {
      if (rival) second = best;
      best = distance;
      index = i;
    } else if (rival) {
      second = std::min(second, distance);
    }
  }
  bool accepted(int max_distance, double ratio) const {
    return index >= 0 && best <= max_distance &&
           (ratio >= 1 || second == std::numeric_limits<int>::max() || best < ratio * second);
  }
};

std::uint64_t key(int distance, std::size_t index) {
  return static_cast<std::uint64_t>(distance) << 32 | static_cast<std::uint64_t>(index);
}

/// Standard deviation across a fitted line at a place along it (0 one end, 1 the other), from that of a point
/// on it; about one point a pixel.
double line_sigma(double sigma, double length, double place) {
  const double from_middle = 2 * place - 1;
  return sigma * std::sqrt((1 + 3 * from_middle * from_middle) / std::max(1.0, length));
}

}  // namespace

LineStereoMatcher::LineStereoMatcher(const StereoRig& rig, const LineStereoOptions& options)
    : rig_(rig), options_(options) {
  check_options(options_);
  cos_max_turn_ = static_cast<float>(std::cos(options_.max_turn * kRadian));
  sin_min_angle_ = static_cast<float>(std::sin(options_.min_angle * kRadian));
}

void LineStereoMatcher::rectify(Side side, const LineFeatures<256>& lines, Side2d& rectified) const {
  rectified.segments.assign(lines.size(), {});
  rectified.directions.assign(lines.size(), Vec2<float>::Zero());
  rectified.skip.assign(lines.size(), 1);
  for (std::size_t i = 0; i < lines.size(); ++i) {
    const LineSegment& s = lines.segments[i];
    const auto p = rig_.rectify_fast(side, Vec2<float>(s.x1, s.y1));
    const auto q = rig_.rectify_fast(side, Vec2<float>(s.x2, s.y2));
    if (!p || !q) continue;
    const Segment2d segment{p->x(), p->y(), q->x(), q->y()};
    if (!is_finite(segment)) continue;
    rectified.segments[i] = segment;
    const float length = segment.length();
    if (!(length > 0) || !std::isfinite(length)) continue;
    rectified.directions[i] = {segment.du() / length, segment.dv() / length};
    rectified.skip[i] = std::abs(rectified.directions[i].y()) < sin_min_angle_;
  }
}

auto LineStereoMatcher::pair(std::size_t i, std::size_t j) const -> std::optional<Pairing> {
  const Segment2d &left = left_.segments[i], &right = right_.segments[j];
  const float low = std::max(std::min(left.v1, left.v2), std::min(right.v1, right.v2));
  const float high = std::min(std::max(left.v1, left.v2), std::max(right.v1, right.v2));
  if (high - low <
          static_cast<float>(options_.min_overlap) * std::min(std::abs(left.dv()), std::abs(right.dv())) ||
      left_.directions[i].dot(right_.directions[j]) < cos_max_turn_)
    return std::nullopt;
  const float slope = right.du() / right.dv();
  Pairing p{0, 0, (left.v1 - right.v1) / right.dv(), (left.v2 - right.v1) / right.dv()};
  p.disparity1 = left.u1 - (right.u1 + (left.v1 - right.v1) * slope);
  p.disparity2 = left.u2 - (right.u1 + (left.v2 - right.v1) * slope);
  const auto most = static_cast<float>(options_.max_disparity);
  if (!(p.disparity1 > 0 && p.disparity2 > 0 && p.disparity1 <= most && p.disparity2 <= most))
    return std::nullopt;
  return p;
}

int LineStereoMatcher::match(const LineFeatures<256>& left, const LineFeatures<256>& right,
                             std::vector<LineStereoMatch>& matches) {
  for (const LineFeatures<256>* lines : {&left, &right})
    require(lines->segments.size() == lines->descriptors.size(), "LineStereoMatcher::match",
            "segments and descriptors must be equally many", lines->descriptors.size());
  rectify(Side::left, left, left_);
  rectify(Side::right, right, right_);
  grid_.build(right_.segments, right_.skip);
  best_left_.assign(right.size(), kNobody);
  matches.assign(left.size(), {});
  for (std::size_t i = 0; i < left.size(); ++i) {
    LineStereoMatch& m = matches[i];
    const Segment2d& s = left_.segments[i];
    m.left = s;
    m.rectified = s.length() > 0;
    if (left_.skip[i]) continue;
    Nearest nearest;
    grid_.for_each(
        std::min(s.u1, s.u2) - static_cast<float>(options_.max_disparity), std::max(s.u1, s.u2),
        std::min(s.v1, s.v2), std::max(s.v1, s.v2), [&](std::int32_t j) {
          if (std::abs(left.segments[i].octave - right.segments[j].octave) > options_.max_octave_difference ||
              !pair(i, static_cast<std::size_t>(j)))
            return;
          const int distance = hamming_distance(left.descriptors[i], right.descriptors[j]);
          nearest.offer(j, distance, right_.segments);
          best_left_[j] = std::min(best_left_[j], key(distance, i));
        });
    if (!nearest.accepted(options_.max_distance, options_.ratio)) continue;
    m.right = nearest.index;
    m.distance = nearest.best;
  }
  int count = 0;
  for (std::size_t i = 0; i < left.size(); ++i) {
    LineStereoMatch& m = matches[i];
    if (!m.found()) continue;
    const Segment2d &s = m.left, &r = right_.segments[m.right];
    if (options_.left_right_check && best_left_[m.right] != key(m.distance, i)) {
      // Another piece of the same edge may fit the right one better: both lie on it.
      const auto other = static_cast<std::size_t>(best_left_[m.right] & 0xffffffffu);
      if (!same_edge(left_.segments[other], s)) {
        m.right = -1;
        m.distance = 0;
        continue;
      }
    }
    const auto p = pair(i, static_cast<std::size_t>(m.right));
    m.disparity1 = p->disparity1;
    m.disparity2 = p->disparity2;
    // Across the line to along the row.
    const double left_sine = std::abs(s.dv()) / s.length(), right_sine = std::abs(r.dv()) / r.length();
    const double level =
        std::pow(options_.scale_factor, std::max(left.segments[i].octave, right.segments[m.right].octave));
    const auto sigma = [&](double left_place, double right_place) {
      return static_cast<float>(level *
                                std::hypot(line_sigma(options_.sigma, s.length(), left_place) / left_sine,
                                           line_sigma(options_.sigma, r.length(), right_place) / right_sine));
    };
    m.sigma1 = sigma(0, p->place1);
    m.sigma2 = sigma(1, p->place2);
    ++count;
  }
  return count;
}

std::optional<Segment3d> LineStereoMatcher::triangulate(const LineStereoMatch& match) const {
  if (!match.found()) return std::nullopt;
  const double f = rig_.focal();
  const auto ray = [&](double u, double v) {
    return Vec3<double>((u - rig_.center().x()) / f, (v - rig_.center().y()) / f, 1);
  };
  const Segment2d& s = match.left;
  const double sine = std::abs(s.dv()) / s.length();
  const double own = line_sigma(options_.sigma, s.length(), 0) / f;
  SegmentView left{ray(s.u1, s.v1), ray(s.u2, s.v2), own, own, options_.sigma / f};
  // What the disparity's deviation has beyond the left line's is the right line's.
  const auto rest = [&](double sigma) {
    const double across = sigma * sine / f;
    return std::sqrt(std::max(across * across - own * own, 0.25 * across * across));
  };
  const SegmentView right{ray(s.u1 - match.disparity1, s.v1), ray(s.u2 - match.disparity2, s.v2),
                          rest(match.sigma1), rest(match.sigma2), options_.sigma / f};
  return triangulate_segment(SE3d(SO3d(), Vec3<double>(rig_.baseline(), 0, 0)), left, right, 1e-5);
}

std::optional<LineQuery> predict_line(const RectifiedCamera& camera, const SE3d& T_camera_frame,
                                      const Segment3d& segment, float radius) {
  constexpr double kNear = 0.02;  // [m]
  Vec3<double> p = T_camera_frame * segment.p1, q = T_camera_frame * segment.p2;
  if (!(p.z() > kNear) && !(q.z() > kNear)) return std::nullopt;
  const auto cut = [&](Vec3<double>& behind, const Vec3<double>& before) {
    if (behind.z() < kNear)
      behind = before + (behind - before) * ((before.z() - kNear) / (before.z() - behind.z()));
    behind.z() = std::max(behind.z(), kNear);
  };
  cut(p, q);
  cut(q, p);
  const auto a = camera.project(p), b = camera.project(q);
  if (!a || !b) return std::nullopt;
  LineQuery query;
  query.predicted = {static_cast<float>(a->x()), static_cast<float>(a->y()), static_cast<float>(b->x()),
                     static_cast<float>(b->y())};
  query.radius = radius;
  if (!is_finite(query.predicted)) return std::nullopt;
  return query;
}

LineProjectionMatcher::LineProjectionMatcher(const LineProjectionOptions& options) : options_(options) {
  check_options(options_);
}

int LineProjectionMatcher::match(std::span<const LineQuery> queries,
                                 std::span<const LineDescriptor> query_descriptors,
                                 std::span<const Segment2d> segments, std::span<const std::int32_t> octaves,
                                 std::span<const LineDescriptor> descriptors, std::vector<Match>& matches) {
  require(query_descriptors.size() == queries.size(), "LineProjectionMatcher::match query_descriptors",
          "must be as many as queries", query_descriptors.size());
  require(octaves.size() == segments.size() && descriptors.size() == segments.size(),
          "LineProjectionMatcher::match descriptors and octaves", "must be as many as segments",
          descriptors.size());
  skip_.resize(segments.size());
  for (std::size_t j = 0; j < segments.size(); ++j) skip_[j] = !is_finite(segments[j]);
  grid_.build(segments, skip_);
  best_query_.assign(segments.size(), kNobody);
  matches.assign(queries.size(), {});
  const double cos_max_turn = std::cos(options_.max_turn * kRadian);
  for (std::size_t i = 0; i < queries.size(); ++i) {
    const LineQuery& query = queries[i];
    const Segment2d& q = query.predicted;
    const double length = q.length();
    if (!is_finite(q) || !(length > 0)) continue;
    Nearest nearest;
    grid_.for_each(std::min(q.u1, q.u2) - query.radius, std::max(q.u1, q.u2) + query.radius,
                   std::min(q.v1, q.v2) - query.radius, std::max(q.v1, q.v2) + query.radius,
                   [&](std::int32_t j) {
                     const Segment2d& s = segments[j];
                     if (octaves[j] < query.min_octave || octaves[j] > query.max_octave ||
                         cosine(q, s) < cos_max_turn || distance_from_line(q, s.u1, s.v1) > query.radius ||
                         distance_from_line(q, s.u2, s.v2) > query.radius)
                       return;
                     const auto along = [&](float u, float v) {
                       return ((u - q.u1) * q.du() + (v - q.v1) * q.dv()) / length;
                     };
                     const double from = std::max(0.0, std::min(along(s.u1, s.v1), along(s.u2, s.v2)));
                     const double to = std::min(length, std::max(along(s.u1, s.v1), along(s.u2, s.v2)));
                     if (to - from < options_.min_overlap * std::min(length, static_cast<double>(s.length())))
                       return;
                     nearest.offer(j, hamming_distance(query_descriptors[i], descriptors[j]), segments);
                   });
    if (!nearest.accepted(options_.max_distance, options_.ratio)) continue;
    matches[i] = {nearest.index, nearest.best};
    best_query_[nearest.index] = std::min(best_query_[nearest.index], key(nearest.best, i));
  }
  int count = 0;
  for (std::size_t i = 0; i < queries.size(); ++i) {
    if (!matches[i].found()) continue;
    if (best_query_[matches[i].index] == key(matches[i].distance, i))
      ++count;
    else
      matches[i] = {};
  }
  return count;
}

}  // namespace sweepkit
