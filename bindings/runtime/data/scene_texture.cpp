// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "scene_texture.hpp"

#include <array>
#include <map>
#include <mutex>
#include <numbers>
#include <opencv2/imgproc.hpp>
#include <tuple>

#include "sweepkit/core/random.hpp"

namespace sweepkit {
namespace {

using Canvas = cv::Mat1f;

constexpr float kPi = std::numbers::pi_v<float>;

/// Adds smooth noise of nx by ny cells (a cubic B-spline over random values) with that standard deviation;
/// it repeats at the edges.
void add_noise(Canvas& image, int nx, int ny, float sigma, Random& random) {
  const int w = image.cols, h = image.rows;
  std::vector<float> lattice(static_cast<std::size_t>(nx) * static_cast<std::size_t>(ny));
  for (float& value : lattice) value = static_cast<float>(random.uniform(-1.7320508, 1.7320508));
  // A B-spline over independent values of variance 1 has, on average, the variance 0.479 in each direction.
  const float gain = sigma / 0.479f;
  const auto weights = [](float t) {
    const float u = 1 - t;
    return std::array<float, 4>{u * u * u / 6, (3 * t * t * t - 6 * t * t + 4) / 6,
                                (3 * u * u * u - 6 * u * u + 4) / 6, t * t * t / 6};
  };
  std::vector<float> rows(static_cast<std::size_t>(ny) * static_cast<std::size_t>(w));
  for (int x = 0; x < w; ++x) {
    const float at = (static_cast<float>(x) + 0.5f) * static_cast<float>(nx) / static_cast<float>(w);
    const int i = static_cast<int>(at);
    const auto k = weights(at - static_cast<float>(i));
    int index[4];
    for (int j = 0; j < 4; ++j) index[j] = (i + j) % nx;
    for (int y = 0; y < ny; ++y) {
      const float* row = lattice.data() + static_cast<std::size_t>(y) * static_cast<std::size_t>(nx);
      rows[static_cast<std::size_t>(y) * static_cast<std::size_t>(w) + static_cast<std::size_t>(x)] =
          gain * (k[0] * row[index[0]] + k[1] * row[index[1]] + k[2] * row[index[2]] + k[3] * row[index[3]]);
    }
  }
  for (int y = 0; y < h; ++y) {
    const float at = (static_cast<float>(y) + 0.5f) * static_cast<float>(ny) / static_cast<float>(h);
    const int i = static_cast<int>(at);
    const auto k = weights(at - static_cast<float>(i));
    const float* r[4];
    for (int j = 0; j < 4; ++j)
      r[j] = rows.data() + static_cast<std::size_t>((i + j) % ny) * static_cast<std::size_t>(w);
    float* out = image[y];
    for (int x = 0; x < w; ++x) out[x] += k[0] * r[0][x] + k[1] * r[1][x] + k[2] * r[2][x] + k[3] * r[3][x];
  }
}

/// Octaves of noise from `cells` on, alike in power by `fall`.
void add_octaves(Canvas& image, int cells_x, int cells_y, int octaves, float sigma, float fall,
                 Random& random) {
  for (int i = 0; i < octaves && (cells_x << i) <= image.cols && (cells_y << i) <= image.rows;
       ++i, sigma *= fall)
    add_noise(image, cells_x << i, cells_y << i, sigma, random);
}

/// Specks of all sizes, few large and many small, dark or bright: dirt, pores, dents. Wraps around.
void add_specks(Canvas& image, float period, float per_square_metre, float smallest, float largest,
                float strength, Random& random) {
  const float texel = period / static_cast<float>(image.cols);
  const int count = static_cast<int>(per_square_metre * period * period);
  for (int n = 0; n < count; ++n) {
    const float share = static_cast<float>(random.uniform());
    const float radius =
        smallest / std::sqrt(1 - share * (1 - smallest * smallest / (largest * largest))) / texel;
    const float value =
        strength * static_cast<float>(random.uniform(0.4, 1.0)) * (random.uniform() < 0.75 ? -1.0f : 0.8f);
    const float stretch = static_cast<float>(random.uniform(0.6, 1.6)),
                turn = static_cast<float>(random.uniform(0, kPi));
    const float c = std::cos(turn), s = std::sin(turn);
    const auto cx = static_cast<float>(random.uniform(0, image.cols)),
               cy = static_cast<float>(random.uniform(0, image.rows));
    const int reach = static_cast<int>(radius * 1.7f) + 2;
    for (int dy = -reach; dy <= reach; ++dy)
      for (int dx = -reach; dx <= reach; ++dx) {
        const int x = static_cast<int>(cx) + dx, y = static_cast<int>(cy) + dy;
        const float px = static_cast<float>(x) + 0.5f - cx, py = static_cast<float>(y) + 0.5f - cy;
        const float u = (c * px + s * py) / stretch, v = (-s * px + c * py) * stretch;
        const float cover = std::clamp(radius + 0.5f - std::sqrt(u * u + v * v), 0.0f, 1.0f);
        if (cover > 0) image((y + image.rows) % image.rows, (x + image.cols) % image.cols) += value * cover;
      }
  }
}

/// Fibres along x: noise long in x and short in y, bent a little.
Canvas grain(int size, float period, Random& random) {
  Canvas straight = Canvas::zeros(size, size), bend = Canvas::zeros(size, size);
  const auto cells = [&](float length) {
    return std::clamp(static_cast<int>(std::lround(period / length)), 1, size);
  };
  add_noise(straight, cells(1.0f), cells(0.06f), 0.055f, random);
  add_noise(straight, cells(0.8f), cells(0.02f), 0.06f, random);
  add_noise(straight, cells(0.5f), cells(0.008f), 0.045f, random);
  add_noise(straight, cells(0.25f), cells(0.004f), 0.032f, random);
  add_noise(straight, cells(0.1f), cells(0.0025f), 0.018f, random);
  add_octaves(bend, cells(0.6f), cells(0.25f), 3, 0.006f, 0.5f, random);
  // Rings: waves across the grain, wavering with the bend.
  Canvas result(size, size);
  const float texel = period / static_cast<float>(size);
  for (int y = 0; y < size; ++y)
    for (int x = 0; x < size; ++x) {
      const float shift = bend(y, x) / texel;
      const float at = static_cast<float>(y) + shift;
      const float base = std::floor(at);
      const int y0 = ((static_cast<int>(base) % size) + size) % size, y1 = (y0 + 1) % size;
      const float share = at - base;
      result(y, x) = straight(y0, x) + share * (straight(y1, x) - straight(y0, x));
    }
  // Pores: short dark dashes along the grain.
  const int dashes = static_cast<int>(900 * period * period);
  for (int n = 0; n < dashes; ++n) {
    const int x = static_cast<int>(random.index(static_cast<std::uint64_t>(size)));
    const int y = static_cast<int>(random.index(static_cast<std::uint64_t>(size)));
    const int length = static_cast<int>(random.uniform(0.004, 0.025) / texel) + 1;
    const auto depth = static_cast<float>(random.uniform(0.04, 0.22));
    for (int i = 0; i < length; ++i) result(y, (x + i) % size) -= depth;
  }
  // Knots: dark, with the grain pushed around them.
  const int knots = static_cast<int>(2.2f * period * period + 0.5f);
  for (int n = 0; n < knots; ++n) {
    const auto cx = static_cast<float>(random.uniform(0, size)),
               cy = static_cast<float>(random.uniform(0, size));
    const float radius = static_cast<float>(random.uniform(0.004, 0.013)) / texel;
    const int reach = static_cast<int>(5 * radius);
    for (int dy = -reach; dy <= reach; ++dy)
      for (int dx = -reach; dx <= reach; ++dx) {
        const float u = static_cast<float>(dx) / (1.6f * radius), v = static_cast<float>(dy) / radius;
        const float r = std::sqrt(u * u + v * v);
        if (r > 3) continue;
        const float value =
            r < 1 ? -0.55f + 0.12f * std::cos(9 * r) : 0.16f * std::cos(5 * r) * (3 - r) * 0.5f;
        result((static_cast<int>(cy) + dy + 2 * size) % size,
               (static_cast<int>(cx) + dx + 2 * size) % size) += value;
      }
  }
  return result;
}

/// Floor boards of that width along x, staggered, each cut from another part of the grain.
Canvas planks(int size, float period, float width, Random& random) {
  const Canvas wood = grain(size, period, random);
  Canvas result(size, size);
  const float texel = period / static_cast<float>(size);
  const int rows = std::max(1, static_cast<int>(std::lround(period / width)));
  for (int row = 0; row < rows; ++row) {
    const int top = size * row / rows, bottom = size * (row + 1) / rows;
    // Joints of this row.
    std::vector<int> joints;
    int at = static_cast<int>(random.index(static_cast<std::uint64_t>(size)));
    const int boards =
        std::max(1, static_cast<int>(std::lround(period / static_cast<float>(random.uniform(0.9, 1.5)))));
    for (int i = 0; i < boards; ++i) {
      joints.push_back(at % size);
      at += size / boards + static_cast<int>(0.15 * size / boards * random.uniform(-1, 1));
    }
    std::sort(joints.begin(), joints.end());
    std::vector<std::array<float, 4>> look;
    for (int i = 0; i < boards; ++i)
      look.push_back({static_cast<float>(random.uniform(0, size)),
                      static_cast<float>(random.uniform(0, size)), static_cast<float>(random.normal(0, 0.13)),
                      static_cast<float>(random.uniform(0.7, 1.3))});
    for (int x = 0; x < size; ++x) {
      int board = 0;
      float joint_distance = 1e9f;
      for (int i = 0; i < boards; ++i) {
        if (x >= joints[static_cast<std::size_t>(i)]) board = i + 1;
        const int d = std::abs(x - joints[static_cast<std::size_t>(i)]);
        joint_distance = std::min(joint_distance, static_cast<float>(std::min(d, size - d)) * texel);
      }
      const auto& l = look[static_cast<std::size_t>(board % boards)];
      const int sx = (x + static_cast<int>(l[0])) % size;
      for (int y = top; y < bottom; ++y) {
        float value = l[2] + l[3] * wood((y + static_cast<int>(l[1])) % size, sx);
        const float edge = std::min({joint_distance, static_cast<float>(y - top) * texel,
                                     static_cast<float>(bottom - 1 - y) * texel});
        if (edge < 0.0012f)
          value -= 0.65f;
        else if (edge < 0.004f)
          value += 0.06f;
        result(y, x) = value;
      }
    }
  }
  add_specks(result, period, 60, 0.0015f, 0.012f, 0.25f, random);
  return result;
}

Canvas tiles(int size, float period, float cell, Random& random) {
  Canvas stone = Canvas::zeros(size, size), result(size, size), veins = Canvas::zeros(size, size);
  add_octaves(stone, 8, 8, 7, 0.09f, 0.75f, random);
  add_octaves(veins, 6, 6, 5, 0.5f, 0.6f, random);
  const float texel = period / static_cast<float>(size);
  const int n = std::max(1, static_cast<int>(std::lround(period / cell)));
  std::vector<std::array<int, 2>> shift(static_cast<std::size_t>(n * n));
  std::vector<float> tone(static_cast<std::size_t>(n * n));
  for (auto& s : shift)
    s = {static_cast<int>(random.index(static_cast<std::uint64_t>(size))),
         static_cast<int>(random.index(static_cast<std::uint64_t>(size)))};
  for (auto& t : tone) t = static_cast<float>(random.normal(0, 0.05));
  Canvas joint = Canvas::zeros(size, size);
  add_octaves(joint, size / 16, size / 16, 3, 0.06f, 0.7f, random);
  for (int y = 0; y < size; ++y)
    for (int x = 0; x < size; ++x) {
      const int i = x * n / size, j = y * n / size;
      const auto id = static_cast<std::size_t>(j * n + i);
      const int left = size * i / n, right = size * (i + 1) / n, top = size * j / n,
                bottom = size * (j + 1) / n;
      const float edge =
          static_cast<float>(std::min({x - left, right - 1 - x, y - top, bottom - 1 - y})) * texel;
      const int sx = (x + shift[id][0]) % size, sy = (y + shift[id][1]) % size;
      const float vein = std::exp(-60.0f * veins(sy, sx) * veins(sy, sx));
      const float face = tone[id] + stone(sy, sx) - 0.22f * vein;
      if (edge < 0.002f)
        result(y, x) = -0.4f + joint(y, x);
      else if (edge < 0.004f)
        result(y, x) = face + 0.1f;
      else
        result(y, x) = face;
    }
  add_specks(result, period, 160, 0.0015f, 0.006f, 0.3f, random);
  return result;
}

/// Printed motifs on a lattice: flowers, stars, rings or sprigs.
Canvas wallpaper(int size, float period, float cell, int seed, Random& random) {
  cv::Mat1b print(size, size, static_cast<unsigned char>(128));
  const int n = std::max(1, static_cast<int>(std::lround(period / cell)));
  const float step = static_cast<float>(size) / static_cast<float>(n);
  const int motif = ((seed % 4) + 4) % 4;
  // Motifs at the border are drawn again at the opposite side.
  const auto draw = [&](float cx, float cy, float scale, float turn, int value) {
    for (const int ox : {-size, 0, size})
      for (const int oy : {-size, 0, size}) {
        const cv::Point c(static_cast<int>((cx + static_cast<float>(ox)) * 16),
                          static_cast<int>((cy + static_cast<float>(oy)) * 16));
        if (c.x < -8 * size || c.x > 24 * size || c.y < -8 * size || c.y > 24 * size) continue;
        const auto at = [&](float angle, float r) {
          return cv::Point(c.x + static_cast<int>(16 * r * std::cos(angle + turn)),
                           c.y + static_cast<int>(16 * r * std::sin(angle + turn)));
        };
        const cv::Scalar color(value);
        if (motif == 3) {  // flower of petals
          for (int i = 0; i < 6; ++i) {
            const float a = static_cast<float>(i) * kPi / 3;
            cv::ellipse(print, at(a, 0.55f * scale),
                        {static_cast<int>(16 * 0.38f * scale), static_cast<int>(16 * 0.17f * scale)},
                        (a + turn) * 180 / kPi, 0, 360, color, cv::FILLED, cv::LINE_AA, 4);
          }
          cv::circle(print, c, static_cast<int>(16 * 0.16f * scale), cv::Scalar(255 - value), cv::FILLED,
                     cv::LINE_AA, 4);
        } else if (motif == 0) {  // star of points, and dots
          std::vector<cv::Point> star;
          for (int i = 0; i < 10; ++i)
            star.push_back(at(static_cast<float>(i) * kPi / 5, (i % 2 ? 0.4f : 1.0f) * scale * 0.8f));
          cv::fillPoly(print, std::vector<std::vector<cv::Point>>{star}, color, cv::LINE_AA, 4);
          for (int i = 0; i < 5; ++i)
            cv::circle(print, at(static_cast<float>(2 * i + 1) * kPi / 5, scale),
                       static_cast<int>(16 * 0.12f * scale), color, cv::FILLED, cv::LINE_AA, 4);
        } else if (motif == 1) {  // sprig with leaves
          cv::line(print, at(kPi / 2, scale), at(-kPi / 2, scale), color,
                   std::max(1, static_cast<int>(0.08f * scale)), cv::LINE_AA, 4);
          for (int i = 0; i < 6; ++i) {
            const float y = (static_cast<float>(i / 2) - 1) * 0.6f * scale, side = i % 2 ? 1.0f : -1.0f;
            const float r = std::hypot(0.3f * scale, y), a = std::atan2(y, side * 0.3f * scale);
            cv::ellipse(print, at(a, r),
                        {static_cast<int>(16 * 0.3f * scale), static_cast<int>(16 * 0.1f * scale)},
                        (turn * 180 / kPi) + side * 30, 0, 360, color, cv::FILLED, cv::LINE_AA, 4);
          }
        } else {  // rings
          cv::circle(print, c, static_cast<int>(16 * 0.8f * scale), color,
                     std::max(1, static_cast<int>(0.14f * scale)), cv::LINE_AA, 4);
          cv::circle(print, c, static_cast<int>(16 * 0.4f * scale), color, cv::FILLED, cv::LINE_AA, 4);
          cv::line(print, at(0.7f, 0.9f * scale), at(0.7f, 1.3f * scale), color,
                   std::max(1, static_cast<int>(0.1f * scale)), cv::LINE_AA, 4);
        }
      }
  };
  for (int j = 0; j < n; ++j)
    for (int i = 0; i < n; ++i) {
      const float x = (static_cast<float>(i) + (j % 2 && n % 2 == 0 ? 0.5f : 0.0f)) * step,
                  y = static_cast<float>(j) * step;
      draw(x + step / 2, y + step / 2, 0.36f * step, static_cast<float>(random.uniform(-0.15, 0.15)), 70);
      draw(x, y, 0.15f * step, static_cast<float>(random.uniform(0, kPi)), 185);
    }
  Canvas result;
  print.convertTo(result, CV_32F, 1.0 / 128, -1.0);
  result *= 0.6f;
  add_octaves(result, 3, 3, 4, 0.03f, 0.8f, random);
  add_octaves(result, size / 8, size / 8, 2, 0.03f, 0.9f, random);
  return result;
}

Canvas bricks(int size, float period, float cell, Random& random) {
  Canvas result = Canvas::zeros(size, size), rough = Canvas::zeros(size, size),
         wobble = Canvas::zeros(size, size);
  add_octaves(rough, 16, 16, 6, 0.09f, 0.85f, random);
  add_octaves(wobble, 64, 64, 3, 1.3f, 0.7f, random);
  const int nx = std::max(2, static_cast<int>(std::lround(period / cell))),
            ny = 2 * std::max(1, static_cast<int>(std::lround(period / cell * 1.45f)));
  std::vector<float> tone(static_cast<std::size_t>(nx * ny));
  for (float& t : tone) t = static_cast<float>(random.normal(0, 0.2));
  for (int y = 0; y < size; ++y)
    for (int x = 0; x < size; ++x) {
      const float fy = static_cast<float>(y) * static_cast<float>(ny) / static_cast<float>(size);
      const int j = static_cast<int>(fy);
      const float fx =
          static_cast<float>(x) * static_cast<float>(nx) / static_cast<float>(size) + (j % 2 ? 0.5f : 0.0f);
      const int i = static_cast<int>(fx);
      const float ex = std::min(fx - std::floor(fx), std::ceil(fx) - fx) * static_cast<float>(size) /
                           static_cast<float>(nx) +
                       wobble(y, x);
      const float ey = std::min(fy - std::floor(fy), std::ceil(fy) - fy) * static_cast<float>(size) /
                           static_cast<float>(ny) +
                       wobble(y, x);
      const float edge = std::min(ex, ey) * period / static_cast<float>(size);
      result(y, x) = edge < 0.005f ? 0.55f + 0.7f * rough(y, x)
                                   : tone[static_cast<std::size_t>(j * nx + i % nx)] + rough(y, x);
    }
  return result;
}

/// Boards on edge: grooves across x.
Canvas panels(int size, float period, float cell, Random& random) {
  Canvas result = grain(size, period, random).t();
  const int n = std::max(1, static_cast<int>(std::lround(period / cell)));
  std::vector<float> tone(static_cast<std::size_t>(n));
  for (float& t : tone) t = static_cast<float>(random.normal(0, 0.09));
  for (int x = 0; x < size; ++x) {
    const int i = x * n / size, left = size * i / n, right = size * (i + 1) / n;
    const float edge =
        static_cast<float>(std::min(x - left, right - 1 - x)) / static_cast<float>(right - left);
    const float groove = edge < 0.02f ? -0.55f : edge < 0.06f ? 0.12f : 0.0f;
    for (int y = 0; y < size; ++y)
      result(y, x) = 0.6f * result(y, x) + tone[static_cast<std::size_t>(i)] + groove;
  }
  return result;
}

/// A carpet: an ornament of lozenges and bands, woven in rows of loops.
Canvas weave(int size, float period, int seed, Random& random) {
  cv::Mat1b print(size, size, static_cast<unsigned char>(118));
  const int n = 4;
  const int step = size / n;
  for (int j = 0; j < n; ++j)
    for (int i = 0; i < n; ++i) {
      const cv::Point c(i * step + step / 2, j * step + step / 2);
      const auto lozenge = [&](double r, int value) {
        const int k = static_cast<int>(r * step);
        std::vector<cv::Point> points{{c.x - k, c.y}, {c.x, c.y - k}, {c.x + k, c.y}, {c.x, c.y + k}};
        cv::fillPoly(print, std::vector<std::vector<cv::Point>>{points}, cv::Scalar(value), cv::LINE_AA);
      };
      const bool odd = (i + j + seed) % 2;
      lozenge(0.42, odd ? 60 : 175);
      lozenge(0.33, odd ? 200 : 90);
      lozenge(0.2, odd ? 80 : 210);
      lozenge(0.08, 230);
      for (int k = 0; k < 5; ++k)
        cv::rectangle(print, cv::Point(i * step + k * step / 5 + 4, j * step - 14),
                      cv::Point(i * step + k * step / 5 + step / 10, j * step + 14),
                      cv::Scalar(k % 2 ? 205 : 55), cv::FILLED, cv::LINE_AA);
    }
  Canvas result;
  print.convertTo(result, CV_32F, 1.0 / 118, -1.0);
  result *= 0.75f;
  const int loops = static_cast<int>(period / 0.006f);
  Canvas shade = Canvas::zeros(size, size);
  add_noise(shade, loops, loops, 0.07f, random);
  add_noise(shade, loops * 2, loops * 2, 0.06f, random);
  add_octaves(shade, 4, 4, 4, 0.05f, 0.8f, random);
  for (int y = 0; y < size; ++y)
    for (int x = 0; x < size; ++x) {
      const float u = static_cast<float>(x * loops) / static_cast<float>(size),
                  v = static_cast<float>(y * loops) / static_cast<float>(size);
      result(y, x) += shade(y, x) + 0.1f * std::cos(2 * kPi * v) *
                                        std::cos(2 * kPi * (u + (static_cast<int>(v) % 2 ? 0.5f : 0.0f)));
    }
  add_specks(result, period, 90, 0.002f, 0.008f, 0.35f, random);
  return result;
}

Canvas fabric(int size, float period, float cell, Random& random) {
  Canvas result = Canvas::zeros(size, size);
  const int n = std::max(1, static_cast<int>(std::lround(period / cell)));
  const int threads = static_cast<int>(period / 0.0022f);
  for (int y = 0; y < size; ++y)
    for (int x = 0; x < size; ++x) {
      const float u = static_cast<float>(x * n) / static_cast<float>(size),
                  v = static_cast<float>(y * n) / static_cast<float>(size);
      const float fu = u - std::floor(u), fv = v - std::floor(v);
      float value = (fu < 0.5f ? 0.2f : -0.2f) + (fv < 0.5f ? 0.2f : -0.2f);
      if (std::abs(fu - 0.25f) < 0.03f || std::abs(fv - 0.25f) < 0.03f) value -= 0.45f;
      if (std::abs(fu - 0.75f) < 0.02f || std::abs(fv - 0.75f) < 0.02f) value += 0.5f;
      const float a = static_cast<float>(x * threads) / static_cast<float>(size),
                  b = static_cast<float>(y * threads) / static_cast<float>(size);
      result(y, x) = value + 0.07f * std::cos(2 * kPi * a) * std::cos(2 * kPi * b);
    }
  add_octaves(result, 4, 4, 7, 0.05f, 0.9f, random);
  return result;
}

void put_word(cv::Mat1b& print, const cv::Rect& box, int value, Random& random) {
  static constexpr std::array<const char*, 24> kWords{
      "Sweep",  "Atlas", "Garden", "Marine",  "Novel", "Physics", "Birds", "Cooking",
      "Travel", "Music", "Math",   "Fragile", "Home",  "Nordic",  "Tools", "Poems",
      "Maps",   "Wood",  "Stars",  "History", "Paper", "Kitchen", "Sport", "Light"};
  const char* word = kWords[random.index(kWords.size())];
  const int font = random.uniform() < 0.5 ? cv::FONT_HERSHEY_DUPLEX : cv::FONT_HERSHEY_TRIPLEX;
  int below = 0;
  const cv::Size unit = cv::getTextSize(word, font, 1.0, 2, &below);
  const double scale = std::min(static_cast<double>(box.width) / unit.width,
                                static_cast<double>(box.height) / (unit.height + below));
  cv::putText(print, word, {box.x, box.y + static_cast<int>(unit.height * scale)}, font, scale,
              cv::Scalar(value), std::max(1, static_cast<int>(2.5 * scale)), cv::LINE_AA);
}

/// Single pictures, columns by rows of them.
Canvas pictures(int size, Pattern pattern, int columns, int rows, Random& random) {
  cv::Mat1b all(size, size, static_cast<unsigned char>(128));
  for (int row = 0; row < rows; ++row)
    for (int column = 0; column < columns; ++column) {
      cv::Rect area(size * column / columns, size * row / rows, size / columns, size / rows);
      // Painted upright in a picture of its own; rows of the texture grow upwards on walls.
      cv::Mat1b print(area.size(), static_cast<unsigned char>(128));
      const int w = print.cols, h = print.rows;
      const auto tone = [&](double low, double high) { return static_cast<int>(random.uniform(low, high)); };
      if (pattern == Pattern::spines) {
        const int ground = random.uniform() < 0.6 ? tone(30, 110) : tone(130, 245);
        const int ink = ground < 120 ? tone(190, 255) : tone(10, 60);
        print.setTo(ground);
        // Lettered along the spine: drawn lying, then turned.
        cv::Mat1b lying(w, h, static_cast<unsigned char>(ground));
        put_word(lying, {h / 4, w / 4, h / 2, w / 2}, ink, random);
        cv::Mat turned;
        cv::rotate(lying, turned, cv::ROTATE_90_CLOCKWISE);
        turned.copyTo(print);
        for (const double at : {0.06, 0.1, 0.86, 0.92})
          if (random.uniform() < 0.7)
            cv::rectangle(print, {0, static_cast<int>(at * h)}, {w, static_cast<int>((at + 0.02) * h)},
                          cv::Scalar(ink), cv::FILLED);
        cv::rectangle(print, {w / 4, static_cast<int>(0.13 * h)}, {3 * w / 4, static_cast<int>(0.2 * h)},
                      cv::Scalar(tone(20, 240)), cv::FILLED);
      } else if (pattern == Pattern::print) {
        print.setTo(tone(118, 140));
        cv::rectangle(print, {0, static_cast<int>(0.47 * h)}, {w, static_cast<int>(0.53 * h)},
                      cv::Scalar(tone(140, 165)), cv::FILLED);
        put_word(print, {w / 12, h / 10, w / 2, h / 5}, tone(15, 60), random);
        put_word(print, {w / 12, h / 3, w / 3, h / 9}, tone(15, 60), random);
        int x = static_cast<int>(0.62 * w);
        cv::rectangle(print, {x - 8, static_cast<int>(0.6 * h)},
                      {static_cast<int>(0.94 * w), static_cast<int>(0.92 * h)}, cv::Scalar(235), cv::FILLED);
        while (x < 0.92 * w) {
          const int bar = 2 + static_cast<int>(random.index(7));
          cv::rectangle(print, {x, static_cast<int>(0.64 * h)}, {x + bar, static_cast<int>(0.84 * h)},
                        cv::Scalar(20), cv::FILLED);
          x += bar + 3 + static_cast<int>(random.index(8));
        }
        for (int i = 0; i < 3; ++i) {
          const int left = static_cast<int>((0.08 + 0.16 * i) * w);
          cv::rectangle(print, {left, static_cast<int>(0.68 * h)}, {left + w / 9, static_cast<int>(0.88 * h)},
                        cv::Scalar(30), 3, cv::LINE_AA);
          cv::line(print, {left + w / 18, static_cast<int>(0.72 * h)},
                   {left + w / 18, static_cast<int>(0.84 * h)}, cv::Scalar(30), 4, cv::LINE_AA);
          cv::circle(print, {left + w / 18, static_cast<int>(0.74 * h)}, w / 40, cv::Scalar(30), cv::FILLED,
                     cv::LINE_AA);
        }
      } else if (pattern == Pattern::glyph) {
        print.setTo(215);
        const int n = 1 + static_cast<int>(random.index(5));
        for (int i = 0; i < n; ++i)
          cv::circle(print, {w / 4 + (i % 2) * w / 2, h / (n > 2 ? 5 : 3) * (1 + i / 2)}, w / 7,
                     cv::Scalar(tone(20, 90)), w / 24, cv::LINE_AA);
        cv::line(print, {w / 5, 4 * h / 5}, {4 * w / 5, 4 * h / 5}, cv::Scalar(40), w / 20, cv::LINE_AA);
      } else {
        // A landscape of overlapping shapes within a pale mount.
        print.setTo(tone(190, 235));
        const cv::Rect inner(w / 9, h / 9, w - 2 * (w / 9), h - 2 * (h / 9));
        cv::Mat1b scene = print(inner);
        scene.setTo(tone(60, 200));
        for (int i = 0; i < 26; ++i) {
          const cv::Point c(static_cast<int>(random.uniform(0, inner.width)),
                            static_cast<int>(random.uniform(0, inner.height)));
          const double r = inner.width * 0.25 * std::pow(random.uniform(0.05, 1.0), 1.6);
          const int value = tone(5, 250);
          if (i % 3 == 0) {
            cv::ellipse(scene, c, {static_cast<int>(r), static_cast<int>(0.6 * r) + 1},
                        random.uniform(0, 180), 0, 360, cv::Scalar(value), cv::FILLED, cv::LINE_AA);
          } else if (i % 3 == 1) {
            std::vector<cv::Point> corners;
            for (int k = 0; k < 4; ++k)
              corners.emplace_back(c.x + static_cast<int>(random.uniform(-r, r)),
                                   c.y + static_cast<int>(random.uniform(-r, r)));
            cv::fillConvexPoly(scene, corners, cv::Scalar(value), cv::LINE_AA);
          } else {
            cv::line(scene, c,
                     {c.x + static_cast<int>(random.uniform(-2 * r, 2 * r)),
                      c.y + static_cast<int>(random.uniform(-2 * r, 2 * r))},
                     cv::Scalar(value), 1 + static_cast<int>(r / 20), cv::LINE_AA);
          }
        }
        if (random.uniform() < 0.5)
          put_word(scene, {inner.width / 8, inner.height / 8, inner.width / 2, inner.height / 6},
                   tone(0, 255), random);
      }
      cv::Mat1b flipped;
      cv::flip(print, flipped, 0);
      flipped.copyTo(all(area)(cv::Rect(0, 0, flipped.cols, flipped.rows)));
    }
  Canvas result;
  all.convertTo(result, CV_32F, 1.0 / 128, -1.0);
  add_octaves(result, size / 64, size / 64, 4, 0.015f, 1.0f, random);
  return result;
}

Skin paint_skin(const Material& m) {
  Skin skin;
  Random random(static_cast<std::uint64_t>(m.seed) * 7919u + 17u);
  Canvas canvas;
  int size = 1024;
  float period = 1.024f;
  const auto cell = [&](double usual) { return static_cast<float>(m.cell > 0 ? m.cell : usual); };
  const auto detail = [&](Detail kind, float strength) {
    skin.detail = kind;
    skin.detail_strength = strength * static_cast<float>(m.contrast);
  };
  switch (m.pattern) {
    case Pattern::plain:
      size = 512;
      canvas = Canvas::zeros(size, size);
      add_octaves(canvas, 2, 2, 4, 0.004f, 0.9f, random);
      break;
    case Pattern::plaster:
      period = 2.048f;
      canvas = Canvas::zeros(size, size);
      add_octaves(canvas, 2, 2, 5, 0.014f, 0.85f, random);
      add_octaves(canvas, 128, 128, 3, 0.014f, 0.8f, random);
      add_specks(canvas, period, 70, 0.002f, 0.012f, 0.12f, random);
      detail(Detail::grain, 0.05f);
      break;
    case Pattern::wallpaper:
      size = 2048;
      period = 2.048f;
      canvas = wallpaper(size, period, cell(0.25), m.seed, random);
      detail(Detail::grain, 0.05f);
      break;
    case Pattern::panels:
      canvas = panels(size, period, cell(0.12), random);
      detail(Detail::grain, 0.06f);
      break;
    case Pattern::bricks:
      period = 2.048f;
      canvas = bricks(size, period, cell(0.24), random);
      detail(Detail::grain, 0.25f);
      break;
    case Pattern::planks:
      size = 2048;
      period = 3.072f;
      canvas = planks(size, period, cell(0.14), random);
      detail(Detail::fibre, 0.07f);
      break;
    case Pattern::tiles:
      size = 2048;
      period = static_cast<float>(std::max(1.0, std::round(3.0 / cell(0.33)))) * cell(0.33);
      canvas = tiles(size, period, cell(0.33), random);
      detail(Detail::grain, 0.05f);
      break;
    case Pattern::wood:
      canvas = grain(size, period, random);
      skin.along_longest = true;
      detail(Detail::fibre, 0.07f);
      break;
    case Pattern::weave:
      size = 2048;
      period = 2.048f;
      canvas = weave(size, period, m.seed, random);
      detail(Detail::cloth, 0.1f);
      break;
    case Pattern::fabric:
      canvas = fabric(size, period, cell(0.07), random);
      detail(Detail::cloth, 0.14f);
      break;
    case Pattern::print:
      size = 2048;
      skin.columns = skin.rows = 4;
      break;
    case Pattern::spines:
      size = 2048;
      skin.columns = 16;
      skin.rows = 4;
      break;
    case Pattern::picture:
      size = 2048;
      skin.columns = skin.rows = 4;
      break;
    case Pattern::glyph:
      size = 512;
      skin.columns = skin.rows = 4;
      break;
    case Pattern::paint:
      period = 1.536f;
      canvas = Canvas::zeros(size, size);
      add_octaves(canvas, 2, 2, 6, 0.02f, 0.7f, random);
      add_specks(canvas, period, 90, 0.0015f, 0.01f, 0.2f, random);
      detail(Detail::grain, 0.05f);
      break;
  }
  if (skin.columns > 0) canvas = pictures(size, m.pattern, skin.columns, skin.rows, random);
  // Relative values to albedo of the right mean.
  std::vector<float> values(canvas.total());
  const auto albedo = static_cast<float>(m.albedo), contrast = static_cast<float>(m.contrast);
  double sum = 0;
  std::size_t n = 0;
  for (int y = 0; y < size; ++y)
    for (int x = 0; x < size; ++x) {
      const float value = std::clamp(1 + contrast * canvas(y, x), 0.06f, 2.6f);
      values[n++] = value;
      sum += value;
    }
  const float gain = albedo / static_cast<float>(sum / static_cast<double>(n));
  for (float& value : values) value = std::min(value * gain, 0.97f);
  skin.texture = std::make_shared<const Texture>(values, size, period);
  return skin;
}

}  // namespace

Texture::Texture(const std::vector<float>& values, int size, float period) : size_(size), period_(period) {
  std::vector<float> level = values;
  while (true) {
    Level stored{size, std::vector<std::uint16_t>(level.size())};
    for (std::size_t i = 0; i < level.size(); ++i)
      stored.texels[i] = static_cast<std::uint16_t>(std::clamp(level[i], 0.0f, 1.0f) * 65535.0f + 0.5f);
    levels_.push_back(std::move(stored));
    if (size == 1) break;
    const int half = size / 2;
    std::vector<float> next(static_cast<std::size_t>(half) * static_cast<std::size_t>(half));
    for (int y = 0; y < half; ++y)
      for (int x = 0; x < half; ++x) {
        const float* p =
            level.data() + static_cast<std::size_t>(2 * y) * static_cast<std::size_t>(size) + 2 * x;
        next[static_cast<std::size_t>(y) * static_cast<std::size_t>(half) + static_cast<std::size_t>(x)] =
            0.25f * (p[0] + p[1] + p[size] + p[size + 1]);
      }
    level = std::move(next);
    size = half;
  }
}

Skin make_skin(const Material& m) {
  struct Kept {
    Skin skin;  // without its texture
    std::weak_ptr<const Texture> texture;
  };
  using Key = std::tuple<int, double, double, double, int>;
  static std::mutex mutex;
  static std::map<Key, Kept> kept;
  const Key key{static_cast<int>(m.pattern), m.albedo, m.contrast, m.cell, m.seed};
  {
    const std::lock_guard lock(mutex);
    if (const auto found = kept.find(key); found != kept.end())
      if (auto texture = found->second.texture.lock()) {
        Skin skin = found->second.skin;
        skin.texture = std::move(texture);
        return skin;
      }
  }
  Skin skin = paint_skin(m);
  Kept entry{skin, skin.texture};
  entry.skin.texture.reset();
  const std::lock_guard lock(mutex);
  kept[key] = std::move(entry);
  return skin;
}

std::shared_ptr<const Texture> detail_texture(Detail detail) {
  if (detail == Detail::none) return nullptr;
  static std::mutex mutex;
  static std::array<std::shared_ptr<const Texture>, 4> made;
  const std::lock_guard lock(mutex);
  auto& texture = made[static_cast<std::size_t>(detail)];
  if (texture) return texture;
  constexpr int kSize = 1024;
  constexpr float kPeriod = 0.256f;
  Random random(static_cast<std::uint64_t>(detail) + 100u);
  Canvas canvas = Canvas::zeros(kSize, kSize);
  if (detail == Detail::grain) {
    add_octaves(canvas, 64, 64, 5, 0.45f, 0.9f, random);
  } else if (detail == Detail::fibre) {
    add_noise(canvas, 4, 160, 0.4f, random);
    add_noise(canvas, 8, 320, 0.5f, random);
    add_noise(canvas, 20, 512, 0.4f, random);
    add_noise(canvas, 64, 1024, 0.3f, random);
  } else {
    add_octaves(canvas, 100, 100, 4, 0.5f, 0.9f, random);
  }
  std::vector<float> values(canvas.total());
  double sum = 0;
  for (int y = 0; y < kSize; ++y)
    for (int x = 0; x < kSize; ++x)
      sum += values[static_cast<std::size_t>(y * kSize + x)] =
          std::clamp(0.5f + 0.2f * canvas(y, x), 0.0f, 1.0f);
  const auto shift = static_cast<float>(0.5 - sum / static_cast<double>(values.size()));
  for (float& value : values) value += shift;
  texture = std::make_shared<const Texture>(values, kSize, kPeriod);
  return texture;
}

}  // namespace sweepkit
