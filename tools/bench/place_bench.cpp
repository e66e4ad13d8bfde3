// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include <benchmark/benchmark.h>

#include <cmath>
#include <cstring>
#include <memory>
#include <numbers>
#include <opencv2/calib3d.hpp>
#include <opencv2/features2d.hpp>
#include <vector>

#include "sweepkit/bow/vocabulary_training.hpp"
#include "sweepkit/core/random.hpp"
#include "sweepkit/map/map.hpp"
#include "sweepkit/slam/place_database.hpp"
#include "sweepkit/slam/place_verification.hpp"

namespace {

using namespace sweepkit;

constexpr int kFeatures = 800;  // of an image
constexpr double kFocal = 350, kCx = 319.5, kCy = 199.5, kBaseline = 0.1;

OrbDescriptor random_descriptor(Random& random) {
  OrbDescriptor descriptor;
  for (auto& word : descriptor.words) word = random();
  return descriptor;
}

OrbDescriptor with_flips(OrbDescriptor descriptor, int flips, Random& random) {
  for (int k = 0; k < flips; ++k) {
    const auto bit = random.index(256);
    descriptor.words[bit / 64] ^= std::uint64_t{1} << (bit % 64);
  }
  return descriptor;
}

// Descriptors of places around which keyframes stand: each shows those of its place, and some of any.
struct Places {
  Map map;
  std::shared_ptr<const OrbVocabulary> vocabulary;
  std::unique_ptr<PlaceDatabase> database;
  PlaceImage query;
  std::vector<Bag> bags;

  explicit Places(int keyframes) {
    Random random(1);
    std::vector<std::vector<OrbDescriptor>> training(20);
    std::vector<OrbDescriptor> pool;
    for (auto& image : training)
      for (int i = 0; i < 500; ++i) pool.push_back(image.emplace_back(random_descriptor(random)));
    VocabularyTrainingOptions options;
    options.depth = 4;
    options.iterations = 3;
    options.weighting = BagWeighting::tf;
    vocabulary = std::make_shared<const OrbVocabulary>(
        train_vocabulary<256>(std::span<const std::vector<OrbDescriptor>>(training), options));
    database = std::make_unique<PlaceDatabase>(vocabulary);
    const MapId id = map.add_map();
    for (int k = 0; k <= keyframes; ++k) {
      Keyframe keyframe;
      keyframe.map = id;
      keyframe.t = k * 20000000000LL;
      const std::size_t from = static_cast<std::size_t>(k % 50) * 200;
      for (int i = 0; i < kFeatures; ++i) {
        const std::size_t which = i < kFeatures / 2 ? from + random.index(400) : random.index(pool.size());
        keyframe.descriptors.push_back(with_flips(pool[which % pool.size()], 10, random));
      }
      keyframe.measurements.resize(kFeatures);
      const Keyframe& added = map.keyframe(map.add_keyframe(std::move(keyframe)));
      if (k == keyframes) {
        query = database->image(added);
      } else {
        database->add(added);
        bags.push_back(vocabulary->transform(added.descriptors));
      }
    }
  }
};

void place_query(benchmark::State& state) {
  const Places places(static_cast<int>(state.range(0)));
  std::size_t groups = 0;
  for (auto _ : state) groups += places.database->candidates(places.query, places.map).size();
  // Each posting of each of its words has to be looked at: 16 bytes, at what memory gives (10 GB/s).
  double postings = 0;
  for (const BagMatch& match : [&] {
         InvertedFile file(places.vocabulary->info().score);
         for (std::uint32_t i = 0; i < places.bags.size(); ++i) file.insert(i, places.bags[i]);
         return file.query(places.query.bag);
       }())
    postings += match.common_words;
  state.counters["groups"] = static_cast<double>(groups) / static_cast<double>(state.iterations());
  state.counters["bound_us"] = postings * 16 / 10e9 * 1e6;
  state.counters["bytes_a_keyframe"] =
      static_cast<double>(places.database->memory_bytes()) / static_cast<double>(places.database->size());
}

void place_query_each(benchmark::State& state) {
  const Places places(static_cast<int>(state.range(0)));
  for (auto _ : state) {
    double best = 0;
    for (const Bag& bag : places.bags) best = std::max(best, places.vocabulary->score(places.query.bag, bag));
    benchmark::DoNotOptimize(best);
  }
}

// A box of points seen from two places a step apart: a map of one keyframe and an image.
struct Pair {
  Map map;
  std::unique_ptr<PlaceDatabase> database;
  KeyframeId candidate;
  PlaceImage image;
  SE3d T_true;
  std::vector<cv::Point3f> points;  // by measurement of the keyframe
  cv::Mat keyframe_descriptors, image_descriptors;

  Pair() {
    Random random(3);
    const RectifiedCamera camera{kFocal, kCx, kCy, kBaseline};
    T_true = SE3d::exp(Vec6<double>{0.2, 0.05, -0.3, 0.03, -0.2, 0.02});
    Keyframe keyframe;
    StereoFrame frame;
    std::vector<Vec3<double>> world;
    const auto see = [&](const SE3d& T, const Vec3<double>& p, OrbDescriptor descriptor, auto& into) {
      const auto uvr = camera.project_stereo(T * p);
      if (!uvr || uvr->x() < 0 || uvr->x() > 639 || uvr->y() < 0 || uvr->y() > 399) return false;
      Measurement m;
      m.u = static_cast<float>(uvr->x() + 0.4 * random.normal());
      m.v = static_cast<float>(uvr->y() + 0.4 * random.normal());
      m.u_right = static_cast<float>(m.u - (uvr->x() - uvr->z()) + 0.15 * random.normal());
      m.sigma = 0.4F;
      m.sigma_right = 0.15F;
      into.measurements.push_back(m);
      into.descriptors.push_back(with_flips(descriptor, 15, random));
      return true;
    };
    while (keyframe.measurements.size() < kFeatures) {
      const Vec3<double> p(random.uniform(-3, 3), random.uniform(-2, 2), random.uniform(1.5, 5));
      const OrbDescriptor descriptor = random_descriptor(random);
      if (!see(SE3d(), p, descriptor, keyframe)) continue;
      world.push_back(p);
      // Half of what both could see repeats.
      if (random.uniform() < 0.5) see(T_true, p, descriptor, frame);
    }
    while (frame.measurements.size() < kFeatures)
      see(SE3d(), world[random.index(world.size())], random_descriptor(random), frame);
    keyframe.map = map.add_map();
    std::vector<std::vector<OrbDescriptor>> training{keyframe.descriptors};
    VocabularyTrainingOptions options;
    options.depth = 2;
    options.weighting = BagWeighting::tf;
    database =
        std::make_unique<PlaceDatabase>(std::make_shared<const OrbVocabulary>(train_vocabulary<256>(
                                            std::span<const std::vector<OrbDescriptor>>(training), options)),
                                        PlaceDatabaseOptions{.index_level = 1});
    keyframe_descriptors = rows(keyframe.descriptors);
    image_descriptors = rows(frame.descriptors);
    candidate = map.add_keyframe(std::move(keyframe));
    for (std::uint32_t i = 0; i < world.size(); ++i) {
      map.set_appearance(map.add_point(world[i], candidate, i), map.keyframe(candidate).descriptors[i],
                         Vec3<float>((-world[i].normalized()).cast<float>()),
                         static_cast<float>(0.5 * world[i].norm()),
                         static_cast<float>(1.1 * world[i].norm()));
      points.emplace_back(static_cast<float>(world[i].x()), static_cast<float>(world[i].y()),
                          static_cast<float>(world[i].z()));
    }
    database->follow(map);
    image = database->image(frame);
  }

  static cv::Mat rows(const std::vector<OrbDescriptor>& descriptors) {
    cv::Mat mat(static_cast<int>(descriptors.size()), 32, CV_8U);
    for (int i = 0; i < mat.rows; ++i)
      std::memcpy(mat.ptr(i), descriptors[static_cast<std::size_t>(i)].words.data(), 32);
    return mat;
  }
};

void report(benchmark::State& state, const Pair& pair, const SE3d& T, double inliers) {
  const SE3d error = T * pair.T_true.inverse();
  state.counters["error_mm"] = 1e3 * error.translation().norm();
  state.counters["error_deg"] = error.rotation().angle() * 180 / std::numbers::pi;
  state.counters["inliers"] = inliers;
}

void place_verification(benchmark::State& state, bool gravity) {
  const Pair pair;
  PlaceVerifier verifier({kFocal, kCx, kCy, kBaseline}, {0, 639, 0, 399}, {});
  PlaceHints hints;
  if (gravity) {
    hints.gravity_world = Vec3<double>(0, 1, 0);
    hints.gravity_camera = pair.T_true.rotation() * Vec3<double>(0, 1, 0);
  }
  PlaceCheck check;
  for (auto _ : state) check = verifier.verify(pair.image, pair.map, *pair.database, pair.candidate, hints);
  report(state, pair, check.match.T_camera_world, static_cast<double>(check.match.pairs.size()));
  // The distances below common nodes (a tenth of all pairs, forwards and back) at 0.7 ns each, and the same
  // number of points projected three times at 10 ns: what no order of work can save.
  state.counters["bound_us"] = (0.1 * kFeatures * kFeatures * 0.7 + 3 * kFeatures * 10) * 1e-3;
}

void place_verification_opencv(benchmark::State& state) {
  const Pair pair;
  const cv::Matx33d K(kFocal, 0, kCx, 0, kFocal, kCy, 0, 0, 1);
  cv::Mat rotation, translation;
  std::vector<int> inliers;
  for (auto _ : state) {
    std::vector<std::vector<cv::DMatch>> nearest;
    cv::BFMatcher(cv::NORM_HAMMING).knnMatch(pair.image_descriptors, pair.keyframe_descriptors, nearest, 2);
    std::vector<cv::Point3f> points;
    std::vector<cv::Point2f> pixels;
    for (const auto& two : nearest) {
      if (two.size() < 2 || two[0].distance > 64 || two[0].distance > 0.9F * two[1].distance) continue;
      points.push_back(pair.points[static_cast<std::size_t>(two[0].trainIdx)]);
      const Measurement& m = pair.image.measurements[static_cast<std::size_t>(two[0].queryIdx)];
      pixels.emplace_back(m.u, m.v);
    }
    cv::solvePnPRansac(points, pixels, K, cv::noArray(), rotation, translation, false, 500, 1.6F, 0.999,
                       inliers, cv::SOLVEPNP_P3P);
  }
  const Vec3<double> w(rotation.at<double>(0), rotation.at<double>(1), rotation.at<double>(2));
  const Vec3<double> t(translation.at<double>(0), translation.at<double>(1), translation.at<double>(2));
  report(state, pair, SE3d(SO3<double>::exp(w), t), static_cast<double>(inliers.size()));
}

BENCHMARK(place_query)->Name("slam/place_query/sweepkit")->Arg(100)->Arg(1000)->Unit(benchmark::kMicrosecond);
BENCHMARK(place_query_each)
    ->Name("slam/place_query/each_bag")
    ->Arg(100)
    ->Arg(1000)
    ->Unit(benchmark::kMicrosecond);
BENCHMARK_CAPTURE(place_verification, gravity, true)
    ->Name("slam/place_verification/sweepkit/gravity")
    ->Unit(benchmark::kMicrosecond);
BENCHMARK_CAPTURE(place_verification, free, false)
    ->Name("slam/place_verification/sweepkit/free")
    ->Unit(benchmark::kMicrosecond);
BENCHMARK(place_verification_opencv)
    ->Name("slam/place_verification/opencv_bf_pnp")
    ->Unit(benchmark::kMicrosecond);

}  // namespace
