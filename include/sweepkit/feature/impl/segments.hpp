// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <numbers>

#include "sweepkit/feature/segments.hpp"

namespace sweepkit {

template <EdgePixel Pixel, SegmentValidation Validation>
void BasicSegmentDetector<Pixel, Validation>::Fit::add(const EdgePoint& p) {
  const double u = p.x, v = p.y;
  n += 1;
  x += u;
  y += v;
  xx += u * u;
  xy += u * v;
  yy += v * v;
}

template <EdgePixel Pixel, SegmentValidation Validation>
void BasicSegmentDetector<Pixel, Validation>::Fit::add(const Fit& other) {
  n += other.n;
  x += other.x;
  y += other.y;
  xx += other.xx;
  xy += other.xy;
  yy += other.yy;
}

template <EdgePixel Pixel, SegmentValidation Validation>
auto BasicSegmentDetector<Pixel, Validation>::Fit::solve() const -> Line {
  const double mx = x / n, my = y / n;
  const double sxx = xx / n - mx * mx, sxy = xy / n - mx * my, syy = yy / n - my * my;
  // Larger eigenvalue of the scatter, and its vector from the row that is better conditioned.
  const double half = 0.5 * (sxx - syy), root = std::sqrt(half * half + sxy * sxy);
  const double dx = half >= 0 ? half + root : sxy, dy = half >= 0 ? sxy : root - half;
  const double norm = std::sqrt(dx * dx + dy * dy);
  const double sigma = std::sqrt(std::max(0.0, 0.5 * (sxx + syy) - root));
  if (!(norm > 0)) return {mx, my, 1, 0, sigma};
  return {mx, my, dx / norm, dy / norm, sigma};
}

template <EdgePixel Pixel, SegmentValidation Validation>
auto BasicSegmentDetector<Pixel, Validation>::point_at(int x, int y) const -> EdgePoint {
  const auto m = map_.magnitude();
  const impl::EdgeGradient g = map_.gradient()(x, y);
  EdgePoint p{static_cast<float>(x), static_cast<float>(y), g.x, g.y};
  const bool steep = std::abs(p.gx) >= std::abs(p.gy);
  const int here = m(x, y);
  const int before = steep ? m(x - 1, y) : m(x, y - 1), after = steep ? m(x + 1, y) : m(x, y + 1);
  // Vertex of the parabola through the three; on a ridge it opens downwards and |offset| <= 0.5.
  const float offset =
      0.5f * static_cast<float>(after - before) / static_cast<float>(2 * here - before - after);
  (steep ? p.x : p.y) += offset;
  return p;
}

template <EdgePixel Pixel, SegmentValidation Validation>
void BasicSegmentDetector<Pixel, Validation>::link_one_way(int x, int y, int sign,
                                                           std::vector<EdgePoint>& points) {
  const auto ridge = map_.ridge();
  const auto gradient = map_.gradient();
  const auto m = map_.magnitude();
  for (;;) {
    // The edge runs along (gy, -gx), dark on its left.
    const int hx = gradient(x, y).x, hy = gradient(x, y).y;
    const bool steep = std::abs(hx) >= std::abs(hy);
    const int step = (steep ? hx < 0 : hy > 0) ? sign : -sign;
    const float half_length = 0.5f * m(x, y);
    int best = 0, best_x = 0, best_y = 0;
    for (int side = -1; side <= 1; ++side) {
      const int nx = steep ? x + side : x + step, ny = steep ? y + step : y + side;
      if (!ridge(nx, ny) || m(nx, ny) <= best) continue;
      // Gradients at most 60 degrees apart.
      const impl::EdgeGradient g = gradient(nx, ny);
      const float dot = static_cast<float>(hx) * g.x + static_cast<float>(hy) * g.y;
      if (dot >= half_length * m(nx, ny)) best = m(nx, ny), best_x = nx, best_y = ny;
    }
    if (best == 0) return;
    x = best_x;
    y = best_y;
    ridge(x, y) = 0;
    points.push_back(point_at(x, y));
  }
}

/// Makes the chain of ridge pixels through one of them.
template <EdgePixel Pixel, SegmentValidation Validation>
void BasicSegmentDetector<Pixel, Validation>::link(int x, int y) {
  chain_.clear();
  back_.clear();
  map_.ridge()(x, y) = 0;
  link_one_way(x, y, -1, back_);
  chain_.assign(back_.rbegin(), back_.rend());
  chain_.push_back(point_at(x, y));
  link_one_way(x, y, 1, chain_);
}

/// Cuts the chain into stretches: a few points that lie on a line are a start; the line is then carried on at
/// both ends while points stay near it, and fitted anew to all of them as they come.
template <EdgePixel Pixel, SegmentValidation Validation>
void BasicSegmentDetector<Pixel, Validation>::cut_chain() {
  constexpr int kStart = 7;        // points
  constexpr int kMaxOutliers = 3;  // in a row
  constexpr double kRenew = 1.15;  // the line is fitted again when it has so many times the points
  const int count = static_cast<int>(chain_.size());
  int begin = 0;  // what lies before is spent
  for (int first = 0; first + kStart <= count;) {
    Fit fit;
    for (int i = first; i < first + kStart; ++i) fit.add(chain_[i]);
    Line line = fit.solve();
    if (line.sigma > 0.35 * options_.tolerance) {
      ++first;
      continue;
    }
    double renew_at = kStart + 4;
    const auto extend = [&](int from, int to, int step) {
      int end = from - step;
      for (int i = from, outliers = 0; i != to && outliers <= kMaxOutliers; i += step) {
        const EdgePoint& p = chain_[i];
        if (std::abs((p.x - line.cx) * line.dy - (p.y - line.cy) * line.dx) > options_.tolerance) {
          ++outliers;
          continue;
        }
        outliers = 0;
        end = i;
        fit.add(p);
        if (fit.n < renew_at) continue;
        line = fit.solve();
        renew_at = fit.n * kRenew + 2;
      }
      line = fit.solve();
      return end;
    };
    const int last = extend(first + kStart, count, 1);
    measure(extend(first - 1, begin - 1, -1), last, fit);
    begin = first = last + 1;
  }
}

/// Keeps the points first .. last of the chain as a stretch about the line that was fitted to them.
template <EdgePixel Pixel, SegmentValidation Validation>
void BasicSegmentDetector<Pixel, Validation>::measure(int first, int last, const Fit& fit) {
  Stretch s{fit, fit.solve(), 0, 0, last - first + 1, 0, 0, true};
  double forward = 0;
  for (int i = first; i <= last; ++i) forward += s.line.dx * chain_[i].gy - s.line.dy * chain_[i].gx;
  if (forward < 0) s.line.dx = -s.line.dx, s.line.dy = -s.line.dy;
  s.contrast = std::abs(forward);
  const double cosine = std::cos(options_.angle_tolerance * std::numbers::pi / 180);
  for (int i = first; i <= last; ++i) {
    const EdgePoint& p = chain_[i];
    const double length = std::sqrt(static_cast<double>(p.gx) * p.gx + static_cast<double>(p.gy) * p.gy);
    s.aligned +=
        s.line.dx * p.gy - s.line.dy * p.gx >= cosine * length &&
        std::abs((p.x - s.line.cx) * s.line.dy - (p.y - s.line.cy) * s.line.dx) <= options_.tolerance;
  }
  const auto along = [&](const EdgePoint& p) {
    return (p.x - s.line.cx) * s.line.dx + (p.y - s.line.cy) * s.line.dy;
  };
  s.t1 = std::min(along(chain_[first]), along(chain_[last]));
  s.t2 = std::max(along(chain_[first]), along(chain_[last]));
  stretches_.push_back(s);
}

/// Joins b, which begins near the end of a, to a if both lie on one line and are surer together.
template <EdgePixel Pixel, SegmentValidation Validation>
bool BasicSegmentDetector<Pixel, Validation>::join(Stretch& a, Stretch& b) const {
  constexpr double kCosine = 0.985;  // 10 degrees
  const double cosine = a.line.dx * b.line.dx + a.line.dy * b.line.dy;
  if (cosine < kCosine) return false;
  const double gx = b.x(b.t1) - a.x(a.t2), gy = b.y(b.t1) - a.y(a.t2);
  const double gap = gx * a.line.dx + gy * a.line.dy;
  const double shorter = std::min(a.t2 - a.t1, b.t2 - b.t1);
  if (gap < -2 || gap > std::min(options_.max_gap, shorter) || std::abs(gx * a.line.dy - gy * a.line.dx) > 3)
    return false;
  Stretch both{a.fit, {}, 0, 0, 0, a.aligned + b.aligned, a.contrast + b.contrast, true};
  both.fit.add(b.fit);
  both.line = both.fit.solve();
  if (both.line.dx * a.line.dx + both.line.dy * a.line.dy < 0)
    both.line.dx = -both.line.dx, both.line.dy = -both.line.dy;
  for (const Stretch* s : {&a, &b})
    for (const double t : {s->t1, s->t2}) {
      const double x = s->x(t) - both.line.cx, y = s->y(t) - both.line.cy;
      if (std::abs(x * both.line.dy - y * both.line.dx) > 0.75 * options_.tolerance) return false;
      const double along = x * both.line.dx + y * both.line.dy;
      both.t1 = std::min(both.t1, along);
      both.t2 = std::max(both.t2, along);
    }
  both.points = a.points + b.points + std::max(0, static_cast<int>(gap));
  if (response(both) < std::max(response(a), response(b))) return false;
  a = both;
  b.alive = false;
  return true;
}

template <EdgePixel Pixel, SegmentValidation Validation>
void BasicSegmentDetector<Pixel, Validation>::join_stretches() {
  // Stretches sorted into cells by their starts, as wide as a gap.
  const double side = std::max(8.0, options_.max_gap + 3);
  const int columns = 1 + static_cast<int>(map_.width() / side),
            rows = 1 + static_cast<int>(map_.height() / side);
  const auto column = [&](double x) { return std::clamp(static_cast<int>(x / side), 0, columns - 1); };
  const auto row = [&](double y) { return std::clamp(static_cast<int>(y / side), 0, rows - 1); };
  const int count = static_cast<int>(stretches_.size());
  cell_of_.resize(count);
  in_cell_.resize(count);
  cell_start_.assign(static_cast<std::size_t>(columns) * rows + 2, 0);
  for (int i = 0; i < count; ++i) {
    const Stretch& s = stretches_[i];
    cell_of_[i] = row(s.y(s.t1)) * columns + column(s.x(s.t1));
    ++cell_start_[cell_of_[i] + 2];
  }
  for (std::size_t c = 2; c < cell_start_.size(); ++c) cell_start_[c] += cell_start_[c - 1];
  for (int i = 0; i < count; ++i) in_cell_[cell_start_[cell_of_[i] + 1]++] = i;

  for (int i = 0; i < count; ++i) {
    Stretch& a = stretches_[i];
    for (bool joined = a.alive; joined;) {
      joined = false;
      const int c = column(a.x(a.t2)), r = row(a.y(a.t2));
      for (int y = std::max(0, r - 1); y <= std::min(rows - 1, r + 1) && !joined; ++y)
        for (int x = std::max(0, c - 1); x <= std::min(columns - 1, c + 1) && !joined; ++x)
          for (int k = cell_start_[y * columns + x]; k < cell_start_[y * columns + x + 1] && !joined; ++k) {
            Stretch& b = stretches_[in_cell_[k]];
            joined = in_cell_[k] != i && b.alive && join(a, b);
          }
    }
  }
}

template <EdgePixel Pixel, SegmentValidation Validation>
void BasicSegmentDetector<Pixel, Validation>::detect(View2d<const Pixel> image,
                                                     std::vector<LineSegment>& segments) {
  segments.clear();
  stretches_.clear();
  map_.build<Pixel>(image, options_.threshold);
  if (map_.width() == 0) return;
  validation_.prepare(map_.width(), map_.height(), options_.angle_tolerance / 180);
  const auto ridge = map_.ridge();
  for (int y = EdgeMap::kMargin; y < map_.height() - EdgeMap::kMargin; ++y) {
    const std::uint8_t* row = ridge.row(y);
    for (int x = 0; x < map_.width(); x += 8) {
      std::uint64_t eight;
      std::memcpy(&eight, row + x, 8);
      if (!eight) continue;
      for (int i = x; i < std::min(x + 8, map_.width()); ++i)
        if (row[i]) {
          link(i, y);
          cut_chain();
        }
    }
  }
  if (options_.max_gap > 0) join_stretches();
  for (const Stretch& s : stretches_) {
    if (!s.alive || s.t2 - s.t1 < options_.min_length) continue;
    const double sure = response(s);
    if (!validation_.accepts(sure, options_.max_false_alarms)) continue;
    segments.push_back(
        {static_cast<float>(s.x(s.t1)), static_cast<float>(s.y(s.t1)), static_cast<float>(s.x(s.t2)),
         static_cast<float>(s.y(s.t2)), static_cast<float>(2 * s.line.sigma),
         static_cast<float>(s.contrast / (s.fit.n * EdgeMap::kUnit)), static_cast<float>(sure), 0});
  }
}

}  // namespace sweepkit
