// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/bow/inverted_file.hpp"

#include <catch2/catch.hpp>
#include <cmath>
#include <fstream>
#include <map>

#include "scratch_folder.hpp"
#include "sweepkit/bow/bag_score.hpp"
#include "sweepkit/core/random.hpp"

using namespace sweepkit;

namespace {

constexpr std::uint32_t kWords = 5000;

Bag random_bag(Random& random, BagScore score, std::uint32_t word_count = kWords) {
  std::vector<std::uint32_t> words;
  std::vector<double> weights;
  for (int i = 0; i < 300; ++i) {
    // Some words are frequent, so that bags have some in common.
    words.push_back(static_cast<std::uint32_t>(random.index(random.index(2) ? 200 : word_count)));
    weights.push_back(random.uniform(0.1, 3.0));
  }
  Bag bag;
  BagMaker().make_bag(words, weights, word_count, BagWeighting::tf_idf, score, bag);
  return bag;
}

void check_query(const InvertedFile& file, const std::map<std::uint32_t, Bag>& bags, const Bag& query) {
  const auto matches = file.query(query);
  std::size_t common = 0;
  for (const auto& [id, bag] : bags) {
    std::vector<std::uint32_t> both;
    std::set_intersection(bag.words().begin(), bag.words().end(), query.words().begin(), query.words().end(),
                          std::back_inserter(both));
    if (both.empty()) continue;
    ++common;
    const auto match =
        std::find_if(matches.begin(), matches.end(), [&](const BagMatch& m) { return m.id == id; });
    REQUIRE(match != matches.end());
    CHECK(match->common_words == both.size());
    CHECK(match->score == Approx(bag_score(query, bag, file.score())).margin(1e-12));
  }
  CHECK(matches.size() == common);
  for (std::size_t i = 1; i < matches.size(); ++i)
    CHECK((file.score() == BagScore::kl ? matches[i - 1].score <= matches[i].score
                                        : matches[i - 1].score >= matches[i].score));
}

}  // namespace

TEST_CASE("queries give the scores of all images, while images come and go", "[bow]") {
  for (int score = 0; score < 6; ++score) {
    Random random(static_cast<std::uint64_t>(score) + 1);
    InvertedFile file(static_cast<BagScore>(score));
    std::map<std::uint32_t, Bag> bags;
    for (int round = 0; round < 60; ++round) {
      const auto id = static_cast<std::uint32_t>(random.index(40) * 1000003u);
      if (bags.count(id)) {
        CHECK_THROWS_AS(file.insert(id, bags[id]), Error);
        CHECK(file.remove(id));
        CHECK_FALSE(file.remove(id));
        bags.erase(id);
      } else {
        bags[id] = random_bag(random, file.score());
        file.insert(id, bags[id]);
      }
      CHECK(file.size() == bags.size());
      CHECK(file.contains(id) == (bags.count(id) > 0));
      if (round % 10 == 0) check_query(file, bags, random_bag(random, file.score()));
    }
    check_query(file, bags, bags.begin()->second);
    file.clear();
    CHECK(file.query(random_bag(random, file.score())).empty());
  }
}

TEST_CASE("an image is most like itself", "[bow]") {
  Random random(3);
  InvertedFile file;
  std::vector<Bag> bags;
  for (std::uint32_t id = 0; id < 30; ++id) {
    bags.push_back(random_bag(random, BagScore::l1));
    file.insert(id, bags.back());
  }
  for (std::uint32_t id = 0; id < 30; ++id) {
    const auto matches = file.query(bags[id]);
    CHECK(matches.front().id == id);
    CHECK(matches.front().score == Approx(1.0));
  }
}

TEST_CASE("options and exclusion leave out what they say", "[bow]") {
  Random random(4);
  InvertedFile file;
  for (std::uint32_t id = 0; id < 50; ++id) file.insert(id, random_bag(random, BagScore::l1));
  const Bag query = random_bag(random, BagScore::l1);
  const auto all = file.query(query);
  REQUIRE(all.size() == 50);
  BagQueryOptions few;
  few.max_results = 7;
  CHECK(file.query(query, few) == std::vector<BagMatch>(all.begin(), all.begin() + 7));
  BagQueryOptions good;
  good.min_score = all[20].score;
  CHECK(file.query(query, good).size() == 21);
  const std::vector<std::uint32_t> excluded{all[0].id, all[3].id, 4711};
  const auto rest = file.query(query, {}, excluded);
  CHECK(rest.size() == 48);
  CHECK(rest[0] == all[1]);
  CHECK(rest[2] == all[4]);
  BagQueryOptions common;
  common.min_common = 0.9;
  std::uint32_t most = 0;
  for (const auto& match : all) most = std::max(most, match.common_words);
  for (const auto& match : file.query(query, common)) CHECK(match.common_words >= 0.9 * most);
  few.max_results = -1;
  CHECK_THROWS_AS(file.query(query, few), Error);
}

TEST_CASE("groups join what belongs together", "[bow]") {
  const std::vector<BagMatch> matches{{1, 10, 0.5}, {2, 10, 0.4}, {7, 5, 0.3}, {3, 10, 0.1}, {9, 1, 0.05}};
  const auto neighbours = [](std::uint32_t id) { return std::vector<std::uint32_t>{id - 1, id + 1}; };
  const auto groups = group_matches(matches, neighbours, 0.0);
  // 1 with 2: 0.9; 2 with 1 and 3: 1.0, the same best; 3 with 2: best 2; 7 and 9 alone.
  REQUIRE(groups.size() == 4);
  CHECK(groups[0].best.id == 1);
  CHECK(groups[0].score == Approx(1.0));
  CHECK(groups[0].members == std::vector<std::uint32_t>{1, 2, 3});
  CHECK(groups[1].best.id == 2);
  CHECK(groups[1].score == Approx(0.5));
  CHECK(groups[2].best.id == 7);
  CHECK(groups[3].best.id == 9);
  CHECK(group_matches(matches, neighbours, 0.75).size() == 1);
  CHECK(group_matches({}, neighbours).empty());
  CHECK_THROWS_AS(group_matches(matches, neighbours, 2.0), Error);
}

TEST_CASE("an inverted file survives its file, and damage is noticed", "[bow]") {
  const ScratchFolder folder;
  const std::string path = (folder / "bags.swi").string();
  Random random(5);
  InvertedFile file(BagScore::l2);
  for (std::uint32_t id = 0; id < 10; ++id) file.insert(id * 17, random_bag(random, BagScore::l2));
  file.insert(1, Bag());
  file.remove(34);
  file.save(path);
  const InvertedFile back = InvertedFile::load(path);
  CHECK(back == file);
  const Bag query = random_bag(random, BagScore::l2);
  CHECK(back.query(query) == file.query(query));
  std::ifstream in(path, std::ios::binary);
  const std::string whole((std::istreambuf_iterator<char>(in)), {});
  for (int trial = 0; trial < 300; ++trial) {
    std::string damaged = whole;
    if (trial % 3 == 0)
      damaged.resize(random.index(whole.size()));
    else
      damaged[random.index(trial % 3 == 1 ? 40 : whole.size())] ^= static_cast<char>(1 + random.index(255));
    try {
      const auto other = InvertedFile::load(folder.write("damaged", damaged).string());
      // Only the score may differ and still be one.
      CHECK(other.ids() == file.ids());
    } catch (const Error& error) {
      CHECK(error.kind() == ErrorKind::data);
    }
  }
  CHECK_THROWS_AS(InvertedFile::load((folder / "absent").string()), Error);
}
