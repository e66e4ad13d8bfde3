// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/bow/recall.hpp"

#include <catch2/catch.hpp>

#include "sweepkit/bow/point_line.hpp"
#include "sweepkit/bow/vocabulary_training.hpp"
#include "sweepkit/core/random.hpp"

using namespace sweepkit;

namespace {

constexpr auto X = PlaceRelation::ignored;
constexpr auto W = PlaceRelation::wrong;
constexpr auto R = PlaceRelation::right;

}  // namespace

TEST_CASE("Recall_N counts right ones among the N most similar against what there is to find") {
  RecallMeter meter({1, 2, 3, 10});
  // By score: right, wrong, right, wrong; the best of all is not to be found.
  meter.add(std::vector<double>{0.9, 0.5, 0.8, 0.7, 0.1}, std::vector{X, W, R, W, R});
  Recall recall = meter.result();
  CHECK(recall.images == 1);
  CHECK(recall.values[0] == Approx(1.0));      // 1 of 1
  CHECK(recall.values[1] == Approx(1.0 / 2));  // 1 of min(2, 2)
  CHECK(recall.values[2] == Approx(1.0 / 2));  // order is R W W R
  CHECK(recall.values[3] == Approx(1.0));      // all found
  CHECK(recall.short_of == std::vector<std::size_t>{0, 0, 1, 1});
  // An image without a true neighbour does not count, one that finds nothing does.
  meter.add(std::vector<double>{1.0, 2.0}, std::vector{W, X});
  meter.add(std::vector<double>{1.0, 2.0}, std::vector{R, W});
  recall = meter.result();
  CHECK(recall.images == 2);
  CHECK(recall.without == 1);
  CHECK(recall.values[0] == Approx(0.5));
  CHECK(recall.values[1] == Approx(0.75));
}

TEST_CASE("of equally similar images the first are taken") {
  RecallMeter meter({1});
  meter.add(std::vector<double>{0.5, 0.5}, std::vector{R, W});
  meter.add(std::vector<double>{0.5, 0.5}, std::vector{W, R});
  CHECK(meter.result().values[0] == Approx(0.5));
}

TEST_CASE("Recall_N lies in [0, 1], is 1 for scores that know the truth and has no value without images") {
  Random random(4);
  RecallMeter perfect({1, 4, 16}), chance({1, 4, 16});
  for (int query = 0; query < 50; ++query) {
    std::vector<double> scores, truth;
    std::vector<PlaceRelation> relations;
    for (int i = 0; i < 40; ++i) {
      relations.push_back(random.index(5) == 0 ? R : random.index(4) == 0 ? X : W);
      scores.push_back(random.uniform());
      truth.push_back(relations.back() == R ? 1 : 0);
    }
    perfect.add(truth, relations);
    chance.add(scores, relations);
  }
  for (const double value : perfect.result().values) CHECK(value == Approx(1.0));
  for (const double value : chance.result().values) CHECK((value > 0 && value < 1));
  CHECK(RecallMeter().result().values == std::vector<double>(4, 0.0));
  CHECK_THROWS_AS(RecallMeter({0}), Error);
  CHECK_THROWS_AS(perfect.add(std::vector<double>{1.0}, std::vector<PlaceRelation>{}), Error);
}

TEST_CASE("points and lines share a score by weight") {
  Random random(9);
  const auto images = [&](int count) {
    std::vector<std::vector<OrbDescriptor>> all(static_cast<std::size_t>(count));
    for (auto& image : all)
      for (int i = 0; i < 60; ++i) {
        image.emplace_back();
        for (auto& word : image.back().words) word = random();
      }
    return all;
  };
  const auto points = images(6), lines = images(6);
  const VocabularyTrainingOptions training{.branching = 4, .depth = 2, .weighting = BagWeighting::tf};
  const Vocabulary<256> point_words(train_vocabulary<256>(points, training)),
      line_words(train_vocabulary<256>(lines, training));
  const PointLineVocabulary<> both(point_words, line_words, 0.3), only_points(point_words, line_words, 0),
      only_lines(point_words, line_words, 1);
  const PointLineBag a = both.transform(points[0], lines[0]), b = both.transform(points[1], lines[1]);
  CHECK(both.score(a, a) == Approx(1.0));
  CHECK(both.score(a, b) == Approx(both.score(b, a)));
  CHECK(only_points.score(a, b) == point_words.score(a.points, b.points));
  CHECK(only_lines.score(a, b) == Approx(line_words.score(a.lines, b.lines)));
  CHECK(both.score(a, b) == Approx(0.7 * only_points.score(a, b) + 0.3 * only_lines.score(a, b)));
  // Without lines the points decide.
  const PointLineBag bare = both.transform(points[1], {});
  CHECK(both.score(a, bare) == point_words.score(a.points, bare.points));
  CHECK_THROWS_AS(PointLineVocabulary<>(point_words, line_words, 1.5), Error);
  const Vocabulary<256> other(
      train_vocabulary<256>(lines, {.branching = 4, .depth = 2, .score = BagScore::l2}));
  CHECK_THROWS_AS(PointLineVocabulary<>(point_words, other, 0.5), Error);
}
