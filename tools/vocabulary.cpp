// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include <fmt/format.h>

#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <string>
#include <vector>

#include "command_line.hpp"
#include "sweepkit/bow/vocabulary.hpp"
#include "sweepkit/bow/vocabulary_file.hpp"
#include "sweepkit/bow/vocabulary_training.hpp"
#include "sweepkit/core/progress.hpp"
#include "sweepkit/data/image_file.hpp"
#include "sweepkit/feature/orb.hpp"

namespace sweepkit {
namespace {

struct TrainOptions {
  int every = 1;
  VocabularyTrainingOptions training;
  OrbOptions orb;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(every, "every", "", range(1, 1000000), "take one of so many images");
    v.group(training, "training", "how descriptors are clustered");
    v.group(orb, "orb", "which features the images are described by");
  }
};

struct TransformOptions {
  int every = 1;
  OrbOptions orb;

  template <class Visitor>
  void visit_options(Visitor& v) {
    v(every, "every", "", range(1, 1000000), "take one of so many images");
    v.group(orb, "orb", "which features the images are described by");
  }
};

/// Thrown to leave a long job after Ctrl-C.
struct Interrupted {};

/// One image, or all in a folder and the folders in it, sorted by name.
std::vector<std::filesystem::path> image_files(const std::string& path, int every) {
  namespace fs = std::filesystem;
  std::error_code error;
  if (fs::is_regular_file(path, error)) return {path};
  if (!fs::is_directory(path, error)) throw Error(ErrorKind::io, path, "is neither an image nor a folder");
  std::vector<fs::path> files;
  for (const auto& entry :
       fs::recursive_directory_iterator(path, fs::directory_options::skip_permission_denied)) {
    std::string suffix = entry.path().extension().string();
    std::transform(suffix.begin(), suffix.end(), suffix.begin(),
                   [](unsigned char c) { return std::tolower(c); });
    for (const char* known : {".jpg", ".jpeg", ".png", ".pgm", ".bmp", ".tif", ".tiff", ".ppm"})
      if (suffix == known && entry.is_regular_file()) files.push_back(entry.path());
  }
  if (files.empty()) throw Error(ErrorKind::data, path, "holds no images");
  std::sort(files.begin(), files.end());
  std::vector<fs::path> taken;
  for (std::size_t i = 0; i < files.size(); i += static_cast<std::size_t>(every)) taken.push_back(files[i]);
  return taken;
}

/// Calls body(file, features) for each image, with progress on stderr.
template <class Body>
void for_each_image(const std::vector<std::filesystem::path>& files, const OrbOptions& options, Body&& body) {
  Progress progress(stderr, "images", static_cast<std::int64_t>(files.size()), "images");
  OrbExtractor extractor(options);
  Features<256> features;
  for (std::size_t i = 0; i < files.size(); ++i) {
    if (interrupted()) throw Interrupted{};
    const SharedGray image = read_gray(files[i]);
    extractor.extract(image.view, features);
    body(files[i], features);
    progress.update(static_cast<std::int64_t>(i + 1));
  }
  progress.finish();
}

VocabularyFormat output_format(const std::string& name, const std::string& path) {
  return name.empty() ? vocabulary_format_of_name(path) : vocabulary_format(name);
}

std::string choice_name(const VocabularyTrainingOptions& options, const char* path) {
  VocabularyTrainingOptions copy = options;
  return std::get<std::string>(list_options(copy).find(path)->value());
}

void print_info(const VocabularyInfo& info) {
  VocabularyTrainingOptions names;
  names.weighting = info.weighting;
  names.score = info.score;
  fmt::print(
      "bits: {}\nbranching: {}\ndepth: {}\nnodes: {}\nleaves: {}\nwords: {}\nweighting: {}\nscore: {}\n",
      info.bits, info.branching, info.depth, info.node_count, info.leaf_count, info.word_count,
      choice_name(names, "weighting"), choice_name(names, "score"));
}

const std::vector<Shortcut> kTrainShortcuts = {
    {"--branching", "training.branching"}, {"--depth", "training.depth"}, {"--seed", "training.seed"},
    {"--threads", "training.threads"},     {"--every", "every"},          {"--features", "orb.count"}};

int train(int argc, char** argv) {
  TrainOptions options;
  std::string images, out, format;
  const ProgramInfo info{
      "vocabulary train",
      "Trains a vocabulary from the ORB features of images.",
      {"vocabulary train --images photos --out flat.swv --branching 10 --depth 4",
       "vocabulary train --images mav0/cam0/data --every 5 --out flat.yml.gz"},
      kTrainShortcuts,
      {{"--images", "PATH", "an image, or a folder of images", &images, true},
       {"--out", "FILE", "the vocabulary", &out, true},
       {"--format", "NAME", "format of the file; without it, what the name tells", &format}}};
  return run_program(argc, argv, info, list_options(options), [&] {
    const VocabularyFormat file_format = output_format(format, out);
    try {
      std::vector<std::vector<OrbDescriptor>> descriptors;
      for_each_image(image_files(images, options.every), options.orb,
                     [&](const auto&, const Features<256>& f) { descriptors.push_back(f.descriptors); });
      Progress progress(stderr, "training", 100, "%");
      const VocabularyTree tree = train_vocabulary<256>(descriptors, options.training, [&](double done) {
        if (interrupted()) throw Interrupted{};
        progress.update(static_cast<std::int64_t>(100 * done));
      });
      progress.finish();
      write_vocabulary(out, tree, file_format);
      print_info(VocabularyImage(tree).info());
    } catch (const Interrupted&) {
    }
    return 0;
  });
}

int tell(int argc, char** argv) {
  std::string file;
  bool verify = false;
  const ProgramInfo info{
      "vocabulary info",
      "Tells what a vocabulary is.",
      {"vocabulary info flat.swv", "vocabulary info flat.swv --verify"},
      {},
      {{"FILE", "PATH", "the vocabulary, of any format", &file, true}},
      {{"--verify", "read and check all of it: checksum, links, words, weights", &verify}}};
  return run_program(argc, argv, info, {}, [&] {
    const VocabularyFormat format = detect_vocabulary_format(file);
    VocabularyInfo about;
    if (format == VocabularyFormat::sweepkit) {
      const VocabularyImage image = VocabularyImage::open(file);
      if (verify) image.verify();
      about = image.info();
    } else {
      about = VocabularyImage(read_vocabulary(file)).info();
    }
    fmt::print("format: {}\n", to_string(format));
    print_info(about);
    if (verify) fmt::print("verified: true\n");
    return 0;
  });
}

int convert(int argc, char** argv) {
  std::string in, out, format;
  bool renumber = false;
  const ProgramInfo info{
      "vocabulary convert",
      "Converts a vocabulary into another format; words and weights stay.",
      {"vocabulary convert ORBvoc.txt ORBvoc.swv",
       "vocabulary convert flat.swv flat.yml.gz --format dbow3_yaml"},
      {},
      {{"IN", "PATH", "the vocabulary, of any format", &in, true},
       {"OUT", "PATH", "the new file", &out, true},
       {"--format", "NAME",
        "sweepkit, dbow2_yaml, orbslam_text, dbow3_yaml, dbow3_binary, dbow3_compressed or fbow; without it, "
        "what the name of OUT tells",
        &format}},
      {{"--renumber", "number the words anew, without gaps", &renumber}}};
  return run_program(argc, argv, info, {}, [&] {
    const VocabularyFormat file_format = output_format(format, out);
    const VocabularyTree tree = read_vocabulary(in);
    write_vocabulary(out, renumber ? renumbered(tree) : tree, file_format);
    return 0;
  });
}

int transform(int argc, char** argv) {
  TransformOptions options;
  std::string vocabulary_file, images;
  const ProgramInfo info{"vocabulary transform",
                         "Prints the bag of words of images, one JSON object a line.",
                         {"vocabulary transform --vocabulary flat.swv --images photos"},
                         {{"--every", "every"}, {"--features", "orb.count"}},
                         {{"--vocabulary", "FILE", "the vocabulary, of any format", &vocabulary_file, true},
                          {"--images", "PATH", "an image, or a folder of images", &images, true}}};
  return run_program(argc, argv, info, list_options(options), [&] {
    const auto vocabulary = load_vocabulary<256>(vocabulary_file);
    Bag bag;
    TransformBuffers buffers;
    try {
      for_each_image(
          image_files(images, options.every), options.orb, [&](const auto& file, const auto& features) {
            vocabulary.transform(features.descriptors, bag, buffers);
            std::string name;
            for (const char c : file.string()) {
              if (c == '"' || c == '\\') name += '\\';
              if (static_cast<unsigned char>(c) >= 32) name += c;
            }
            fmt::print("{{\"image\": \"{}\", \"features\": {}, \"words\": [{}], \"weights\": [{}]}}\n", name,
                       features.size(), fmt::join(bag.words(), ", "), fmt::join(bag.weights(), ", "));
          });
    } catch (const Interrupted&) {
    }
    return 0;
  });
}

}  // namespace
}  // namespace sweepkit

int main(int argc, char** argv) {
  using namespace sweepkit;
  const std::string job = argc > 1 ? argv[1] : "";
  if (job == "train") return train(argc - 1, argv + 1);
  if (job == "info") return tell(argc - 1, argv + 1);
  if (job == "convert") return convert(argc - 1, argv + 1);
  if (job == "transform") return transform(argc - 1, argv + 1);
  const ProgramInfo info{
      "vocabulary",
      "Trains, shows, converts and applies vocabularies of binary features. Jobs: train, info, "
      "convert, transform; each has --help.",
      {"vocabulary train --images photos --out flat.swv", "vocabulary info flat.swv --verify",
       "vocabulary convert ORBvoc.txt ORBvoc.swv",
       "vocabulary transform --vocabulary flat.swv --images photos"},
      {}};
  return run_program(argc, argv, info, {}, [] {
    fmt::print(stderr, "vocabulary: a job is needed: train, info, convert or transform; see --help\n");
    return 2;
  });
}
