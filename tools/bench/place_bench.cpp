// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include <benchmark/benchmark.h>

#include <cmath>
#include <cstring>
#include <memory>
#include <numbers>
#include <opencv2/calib3d.hpp>
#include <opencv2/features2d.hpp>
#include <optional>
#include <utility>
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

// A box of points seen by the only keyframe of a map, and by images on a way away from it.
struct Scene {
  Map map;
  std::unique_ptr<PlaceDatabase> database;
  KeyframeId candidate;
  std::vector<PlaceImage> images;
  std::vector<SE3d> T_true;         // T_camera_world of the images
  std::vector<cv::Point3f> points;  // by measurement of the keyframe
  cv::Mat keyframe_descriptors;
  std::vector<cv::Mat> image_descriptors;

  // `repeats`: the share that looks the same of what both could see; `alike`: the share of the rest that
  // looks like another point.
  Scene(std::size_t views, double repeats, double alike) {
    Random random(3);
    const RectifiedCamera camera{kFocal, kCx, kCy, kBaseline};
    const SE3d T_first = SE3d::exp(Vec6<double>{0.2, 0.05, -0.3, 0.03, -0.2, 0.02});
    for (std::size_t k = 0; k < views; ++k)
      T_true.push_back(SE3d::exp(static_cast<double>(k) * Vec6<double>{0, 0, -0.03, 0, 0.02, 0}) * T_first);
    Keyframe keyframe;
    std::vector<StereoFrame> frames(views);
    std::vector<Vec3<double>> world;
    std::vector<OrbDescriptor> looks;
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
      looks.push_back(descriptor);
      for (std::size_t k = 0; k < views; ++k)
        if (random.uniform() < repeats) see(T_true[k], p, descriptor, frames[k]);
    }
    for (StereoFrame& frame : frames)
      while (frame.measurements.size() < kFeatures)
        see(SE3d(), world[random.index(world.size())],
            random.uniform() < alike ? looks[random.index(looks.size())] : random_descriptor(random), frame);
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
    for (const StereoFrame& frame : frames) image_descriptors.push_back(rows(frame.descriptors));
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
    for (const StereoFrame& frame : frames) images.push_back(database->image(frame));
  }

  static cv::Mat rows(const std::vector<OrbDescriptor>& descriptors) {
    cv::Mat mat(static_cast<int>(descriptors.size()), 32, CV_8U);
    for (int i = 0; i < mat.rows; ++i)
      std::memcpy(mat.ptr(i), descriptors[static_cast<std::size_t>(i)].words.data(), 32);
    return mat;
  }
};

void report(benchmark::State& state, const Scene& scene, const SE3d& T, double inliers) {
  const SE3d error = T * scene.T_true[0].inverse();
  state.counters["error_mm"] = 1e3 * error.translation().norm();
  state.counters["error_deg"] = error.rotation().angle() * 180 / std::numbers::pi;
  state.counters["inliers"] = inliers;
}

// The distances below common nodes (a tenth of all pairs, forwards and back) of an image at 0.7 ns each: what
// no order of work can save.
constexpr double kMatchingBoundUs = 0.1 * kFeatures * kFeatures * 0.7e-3;

void place_verification(benchmark::State& state, bool gravity) {
  const Scene scene(1, 0.5, 0);
  PlaceVerifier verifier({kFocal, kCx, kCy, kBaseline}, {0, 639, 0, 399}, {});
  PlaceHints hints;
  if (gravity) {
    hints.gravity_world = Vec3<double>(0, 1, 0);
    hints.gravity_camera = scene.T_true[0].rotation() * Vec3<double>(0, 1, 0);
  }
  PlaceCheck check;
  for (auto _ : state)
    check = verifier.verify(scene.images[0], scene.map, *scene.database, scene.candidate, hints);
  report(state, scene, check.match.T_camera_world, static_cast<double>(check.match.pairs.size()));
  // And the same number of points projected three times at 10 ns.
  state.counters["bound_us"] = kMatchingBoundUs + 3 * kFeatures * 10e-3;
}

// Brute force, then P3P in RANSAC.
std::pair<SE3d, int> locate_opencv(const Scene& scene, std::size_t image) {
  const cv::Matx33d K(kFocal, 0, kCx, 0, kFocal, kCy, 0, 0, 1);
  cv::Mat rotation, translation;
  std::vector<int> inliers;
  std::vector<std::vector<cv::DMatch>> nearest;
  cv::BFMatcher(cv::NORM_HAMMING)
      .knnMatch(scene.image_descriptors[image], scene.keyframe_descriptors, nearest, 2);
  std::vector<cv::Point3f> points;
  std::vector<cv::Point2f> pixels;
  for (const auto& two : nearest) {
    if (two.size() < 2 || two[0].distance > 64 || two[0].distance > 0.9F * two[1].distance) continue;
    points.push_back(scene.points[static_cast<std::size_t>(two[0].trainIdx)]);
    const Measurement& m = scene.images[image].measurements[static_cast<std::size_t>(two[0].queryIdx)];
    pixels.emplace_back(m.u, m.v);
  }
  if (points.size() < 4 || !cv::solvePnPRansac(points, pixels, K, cv::noArray(), rotation, translation, false,
                                               500, 1.6F, 0.999, inliers, cv::SOLVEPNP_P3P))
    return {SE3d(), 0};
  const Vec3<double> w(rotation.at<double>(0), rotation.at<double>(1), rotation.at<double>(2));
  const Vec3<double> t(translation.at<double>(0), translation.at<double>(1), translation.at<double>(2));
  return {SE3d(SO3<double>::exp(w), t), static_cast<int>(inliers.size())};
}

void place_verification_opencv(benchmark::State& state) {
  const Scene scene(1, 0.5, 0);
  std::pair<SE3d, int> found;
  for (auto _ : state) found = locate_opencv(scene, 0);
  report(state, scene, found.first, found.second);
}

// Ten images of which none has enough to be located alone.
constexpr std::size_t kPooled = 10;
constexpr double kFewRepeat = 0.03, kAlike = 0.2;

void place_pooling(benchmark::State& state) {
  const Scene scene(kPooled, kFewRepeat, kAlike);
  PlaceVerifier verifier({kFocal, kCx, kCy, kBaseline}, {0, 639, 0, 399}, {});
  const Vec3<double> gravity_world(0, 1, 0), gravity_first = scene.T_true[0].rotation() * gravity_world;
  std::vector<PlaceView> views;
  for (std::size_t k = 0; k < kPooled; ++k)
    views.push_back({&scene.images[k], scene.T_true[k] * scene.T_true[0].inverse()});
  std::optional<PlaceProposal> found;
  for (auto _ : state)
    found =
        verifier.propose(views, scene.map, *scene.database, scene.candidate, gravity_first, gravity_world);
  int alone = 0;
  for (const PlaceImage& image : scene.images)
    alone += verifier.verify(image, scene.map, *scene.database, scene.candidate).ok();
  if (found) report(state, scene, found->T_first_world, found->inliers);
  state.counters["located"] = found ? 1 : 0;
  state.counters["located_alone"] = alone;
  state.counters["bound_us"] = kPooled * kMatchingBoundUs;
}

void place_pooling_opencv(benchmark::State& state) {
  const Scene scene(kPooled, kFewRepeat, kAlike);
  int located = 0;
  for (auto _ : state) {
    located = 0;
    for (std::size_t k = 0; k < kPooled; ++k) {
      const auto [T, inliers] = locate_opencv(scene, k);
      located += (T * scene.T_true[k].inverse()).translation().norm() < 0.1;
    }
  }
  state.counters["located"] = located;
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
BENCHMARK(place_pooling)->Name("slam/place_pooling/sweepkit")->Unit(benchmark::kMicrosecond);
BENCHMARK(place_pooling_opencv)->Name("slam/place_pooling/opencv_bf_pnp_each")->Unit(benchmark::kMicrosecond);

}  // namespace
