// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/bow/recall.hpp"

#include <fmt/format.h>

#include <filesystem>
#include <fstream>
#include <iterator>
#include <numbers>
#include <optional>
#include <sstream>
#include <vector>

#include "command_line.hpp"
#include "sweepkit/bow/point_line.hpp"
#include "sweepkit/bow/vocabulary_file.hpp"
#include "sweepkit/bow/vocabulary_training.hpp"
#include "sweepkit/core/progress.hpp"
#include "sweepkit/data/image_file.hpp"
#include "sweepkit/data/recording.hpp"
#include "sweepkit/data/trajectory.hpp"
#include "sweepkit/feature/line_extractor.hpp"
#include "sweepkit/feature/orb.hpp"

namespace sweepkit {
namespace {

namespace fs = std::filesystem;

struct RecallRunOptions {
  std::vector<double> counts = {1, 20, 40, 60};
  std::vector<double> line_weights = {0.0, 0.1, 0.2, 0.3, 0.5};
  double max_distance = 0.2;
  double max_angle_deg = 10.0;
  double min_overlap = 0.5;
  int min_apart = 25;
  int every = 1;
  OrbOptions orb;
  LineOptions lines;
  VocabularyTrainingOptions training;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(counts, "counts", "", range(1, 1000000), "the N of Recall_N");
    v(line_weights, "line_weights", "", range(0, 1), "parts of the score that lines have, a row for each");
    v(max_distance, "max_distance", "m", range(0, 1e6), "farthest apart that two images show one place");
    v(max_angle_deg, "max_angle_deg", "deg", range(0, 180), "most that they are turned");
    v(min_overlap, "min_overlap", "", range(0, 1), "in place of both, where the images have overlap.csv");
    v(min_apart, "min_apart", "", range(1, 1000000),
      "without queries of their own, images are looked for among those at least so many before them");
    v(every, "every", "", range(1, 1000000), "take each so manieth image");
    v.group(orb, "orb", "Points.");
    v.group(lines, "lines", "Lines.");
    v.group(training, "training", "Vocabularies that are trained here.");
  }
};

/// Images of one place or way: their descriptors and where they were taken.
struct Views {
  std::vector<std::vector<OrbDescriptor>> points;
  std::vector<std::vector<LineDescriptor>> lines;
  std::vector<std::optional<SE3d>> poses;
  std::vector<std::vector<double>> overlap;  // of each two, or empty

  std::size_t size() const { return points.size(); }
};

class ViewReader {
 public:
  explicit ViewReader(const RecallRunOptions& options)
      : options_(options), orb_(options.orb), lines_(options.lines) {}

  Views read(const fs::path& folder) {
    return fs::exists(folder / "images") ? read_images(folder) : read_recording(folder);
  }

 private:
  static std::vector<std::vector<double>> read_table(const fs::path& file) {
    std::ifstream stream(file);
    if (!stream) throw Error(ErrorKind::io, file.string(), "cannot be opened");
    std::vector<std::vector<double>> rows;
    std::string line, cell;
    for (int number = 1; std::getline(stream, line); ++number) {
      if (line.empty() || line[0] == '#') continue;
      rows.emplace_back();
      std::istringstream cells(line);
      while (std::getline(cells, cell, ',')) {
        std::size_t used = 0;
        double value = 0;
        try {
          value = std::stod(cell, &used);
        } catch (const std::exception&) {
          used = 0;
        }
        if (used == 0 || !std::isfinite(value))
          throw Error(ErrorKind::data, file.string() + ":" + std::to_string(number), "expected numbers",
                      cell);
        rows.back().push_back(value);
      }
    }
    return rows;
  }

  void add(GrayView image, const std::optional<SE3d>& pose, Views& views) {
    if (interrupted()) throw Error(ErrorKind::io, "recall", "was interrupted");
    orb_.extract(image, features_);
    lines_.extract(image, line_features_);
    views.points.push_back(features_.descriptors);
    views.lines.push_back(line_features_.descriptors);
    views.poses.push_back(pose);
  }

  /// A folder with `images`, `poses.csv` (frame, t, q) and perhaps `overlap.csv`.
  Views read_images(const fs::path& folder) {
    const fs::path file = folder / "poses.csv";
    const auto rows = read_table(file);
    Views views;
    Progress progress(stderr, "read", static_cast<int>(rows.size()), "images");
    std::vector<std::size_t> taken;
    for (std::size_t i = 0; i < rows.size(); i += static_cast<std::size_t>(options_.every)) {
      const auto& row = rows[i];
      if (row.size() < 8)
        throw Error(ErrorKind::data, file.string(), "expected frame, x, y, z, qx, qy, qz, qw");
      const auto name = fmt::format("{:06d}", static_cast<int>(row[0]));
      fs::path image = folder / "images" / (name + ".jpg");
      if (!fs::exists(image)) image.replace_extension(".png");
      const Eigen::Quaterniond q = Eigen::Quaterniond(row[7], row[4], row[5], row[6]).normalized();
      add(read_gray(image).view, SE3d(SO3d(q), {row[1], row[2], row[3]}), views);
      taken.push_back(i);
      progress.update(static_cast<int>(i));
    }
    progress.finish();
    if (const fs::path table = folder / "overlap.csv"; fs::exists(table)) {
      const auto all = read_table(table);
      for (const std::size_t i : taken) {
        if (i >= all.size() || all[i].size() != rows.size())
          throw Error(ErrorKind::data, table.string(), "must be a square table over all images");
        views.overlap.emplace_back();
        for (const std::size_t j : taken) views.overlap.back().push_back(all[i][j]);
      }
    }
    return views;
  }

  Views read_recording(const fs::path& folder) {
    RecordingOptions options;
    options.use_imu = options.use_wheels = false;
    const auto recording = open_recording(folder, options);
    Trajectory truth;
    if (!recording->info().truth.empty()) truth = read_trajectory(folder);
    Views views;
    Progress progress(stderr, "read", static_cast<int>(recording->info().images), "images");
    int number = 0;
    while (const auto sample = recording->next()) {
      const auto* image = std::get_if<StereoImage>(&*sample);
      if (!image || image->left.empty()) continue;
      if (number++ % options_.every == 0) add(image->left.view, interpolate(truth, image->t), views);
      progress.update(number);
    }
    progress.finish();
    return views;
  }

  const RecallRunOptions& options_;
  OrbExtractor orb_;
  LineExtractor lines_;
  Features<256> features_;
  LineFeatures<256> line_features_;
};

PlaceRelation relation(const Views& database, std::size_t j, const Views& queries, std::size_t i, bool same,
                       const RecallRunOptions& options) {
  if (same && j + static_cast<std::size_t>(options.min_apart) > i) return PlaceRelation::ignored;
  bool right = false;
  if (same && !database.overlap.empty()) {
    right = database.overlap[i][j] >= options.min_overlap;
  } else {
    if (!database.poses[j] || !queries.poses[i]) return PlaceRelation::ignored;
    const SE3d T = database.poses[j]->inverse() * *queries.poses[i];
    right = T.translation().norm() <= options.max_distance &&
            T.rotation().log().norm() <= options.max_angle_deg * std::numbers::pi / 180;
  }
  return right ? PlaceRelation::right : PlaceRelation::wrong;
}

Vocabulary<256> get_vocabulary(const std::string& file,
                               const std::vector<std::vector<BinaryDescriptor<256>>>& images,
                               const VocabularyTrainingOptions& options) {
  if (!file.empty()) return load_vocabulary<256>(file);
  return Vocabulary<256>(train_vocabulary<256>(images, options));
}

/// Several folders, joined by colons, one after the other.
Views read_all(ViewReader& reader, const std::string& folders) {
  Views all;
  std::istringstream names(folders);
  for (std::string name; std::getline(names, name, ':');) {
    Views views = reader.read(name);
    std::ranges::move(views.points, std::back_inserter(all.points));
    std::ranges::move(views.lines, std::back_inserter(all.lines));
  }
  return all;
}

struct Files {
  std::string database, queries, train, points, lines, save_points, save_lines;
};

int run(const RecallRunOptions& options, const Files& files) {
  ViewReader reader(options);
  const Views database = reader.read(files.database);
  const bool same = files.queries.empty() || files.queries == files.database;
  const Views queries = same ? Views{} : reader.read(files.queries);
  const Views& asked = same ? database : queries;
  const Views own =
      files.train.empty() || files.train == files.database ? Views{} : read_all(reader, files.train);
  const Views& training = own.size() > 0 ? own : database;
  const Vocabulary<256> points = get_vocabulary(files.points, training.points, options.training);
  const Vocabulary<256> lines = get_vocabulary(files.lines, training.lines, options.training);
  if (!files.save_points.empty()) points.save(files.save_points);
  if (!files.save_lines.empty()) lines.save(files.save_lines);

  const PointLineVocabulary<> both(points, lines, 0);
  std::vector<PointLineBag> stored(database.size());
  TransformBuffers buffers;
  std::size_t point_count = 0, line_count = 0;
  for (std::size_t j = 0; j < database.size(); ++j) {
    both.transform(database.points[j], database.lines[j], stored[j], buffers);
    point_count += database.points[j].size();
    line_count += database.lines[j].size();
  }
  std::vector<int> counts;
  for (const double n : options.counts) counts.push_back(static_cast<int>(n));
  std::vector<PointLineVocabulary<>> rows;
  for (const double weight : options.line_weights) rows.emplace_back(points, lines, weight);
  rows.emplace_back(points, lines, 1.0);
  std::vector<RecallMeter> meters(rows.size(), RecallMeter(counts));
  std::vector<double> scores(database.size());
  std::vector<PlaceRelation> relations(database.size());
  PointLineBag bag;
  for (std::size_t i = 0; i < asked.size(); ++i) {
    both.transform(asked.points[i], asked.lines[i], bag, buffers);
    for (std::size_t j = 0; j < database.size(); ++j)
      relations[j] = relation(database, j, asked, i, same, options);
    for (std::size_t r = 0; r < rows.size(); ++r) {
      for (std::size_t j = 0; j < database.size(); ++j) scores[j] = rows[r].score(bag, stored[j]);
      meters[r].add(scores, relations);
    }
  }

  const Recall first = meters[0].result();
  const auto images = static_cast<double>(std::max<std::size_t>(1, database.size()));
  fmt::print("database     {} images, {:.0f} points and {:.0f} lines each\n", database.size(),
             static_cast<double>(point_count) / images, static_cast<double>(line_count) / images);
  fmt::print("queries      {} images with a true neighbour, {} without (not counted)\n", first.images,
             first.without);
  fmt::print("words        {} of points, {} of lines\n", points.word_count(), lines.word_count());
  fmt::print("recall       right ones among the N most alike / min(N, true neighbours) [%]\n");
  fmt::print("{:<13}", "");
  for (const int n : counts) fmt::print("{:>10}", fmt::format("N = {}", n));
  fmt::print("\n");
  for (std::size_t r = 0; r < rows.size(); ++r) {
    const double weight = rows[r].line_weight();
    fmt::print("{:<13}", weight == 0   ? std::string("points")
                         : weight == 1 ? std::string("lines")
                                       : fmt::format("lines {:g}", weight));
    for (const double value : meters[r].result().values) fmt::print("{:>10.4f}", 100 * value);
    fmt::print("\n");
  }
  fmt::print("{:<13}", "fewer than N");
  for (const std::size_t n : first.short_of) fmt::print("{:>10}", n);
  fmt::print("\n");
  return first.images > 0 ? 0 : 1;
}

}  // namespace
}  // namespace sweepkit

int main(int argc, char** argv) {
  using namespace sweepkit;
  RecallRunOptions options;
  Files files;
  const ProgramInfo info{
      "recall",
      "Prints how often the most similar images show the same place, by words of points and of lines.",
      {"recall --database first_drive --queries second_drive",
       "recall --database first_drive --queries second_drive --vocabulary orb.swv --line-vocabulary lbd.swv",
       "recall --database place_7scenes --train other_place --set counts=[1,5,10,20]"},
      {},
      {{"--database", "FOLDER", "recording with truth, or images with poses.csv and perhaps overlap.csv",
        &files.database, true},
       {"--queries", "FOLDER", "what is looked for in it; without it the database's own images",
        &files.queries},
       {"--train", "FOLDERS",
        "what vocabularies are trained on, several joined by colons; without it the database", &files.train},
       {"--vocabulary", "FILE", "vocabulary of ORB, of any format; without it one is trained", &files.points},
       {"--line-vocabulary", "FILE", "vocabulary of LBD; without it one is trained", &files.lines},
       {"--save-vocabulary", "FILE", "where to write the one of points", &files.save_points},
       {"--save-line-vocabulary", "FILE", "where to write the one of lines", &files.save_lines}}};
  return run_program(argc, argv, info, list_options(options), [&] { return run(options, files); });
}
