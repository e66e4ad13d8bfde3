// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include <array>
#include <charconv>
#include <cmath>
#include <cstring>

#include "sweepkit/core/error.hpp"
#include "sweepkit/core/options.hpp"
#include "text_window.hpp"
#include "vocabulary_formats.hpp"

namespace sweepkit::impl {
namespace {

constexpr std::size_t kMaxBytes = 16384 / 8;

/// Numbers of a text, split by spaces.
class Numbers {
 public:
  explicit Numbers(std::string_view text) : p_(text.data()), end_(text.data() + text.size()) {}

  bool done() {
    while (p_ != end_ && (*p_ == ' ' || *p_ == '\t' || *p_ == '\n' || *p_ == '\r')) ++p_;
    return p_ == end_;
  }
  /// False if what comes is no byte.
  bool take_byte(std::uint8_t& byte) {
    if (done()) return false;
    unsigned value = 0;
    const char* begin = p_;
    while (p_ != end_ && *p_ >= '0' && *p_ <= '9' && p_ - begin < 4) value = value * 10 + (*p_++ - '0');
    if (p_ == begin || value > 255 || (p_ != end_ && *p_ > ' ')) return false;
    byte = static_cast<std::uint8_t>(value);
    return true;
  }
  template <class Number>
  bool take(Number& number) {
    if (done()) return false;
    const auto [stop, error] = std::from_chars(p_, end_, number);
    if (error != std::errc() || (stop != end_ && *stop > ' ')) return false;
    p_ = stop;
    return true;
  }
  bool take_word(std::string_view word) {
    if (done() || static_cast<std::size_t>(end_ - p_) < word.size() ||
        std::memcmp(p_, word.data(), word.size()) != 0)
      return false;
    p_ += word.size();
    return true;
  }
  std::string_view rest() const { return {p_, static_cast<std::size_t>(end_ - p_)}; }

 private:
  const char* p_;
  const char* end_;
};

/// Reads the yaml that OpenCV's FileStorage writes for DBoW2 and DBoW3, and no other yaml.
class YamlReader {
 public:
  explicit YamlReader(const std::string& path) : text_(path) {}

  ListedNodes read() {
    skip_head();
    const std::string name(text_.take_name());
    if (name != "vocabulary") text_.fail("expected the entry 'vocabulary'", name);
    text_.expect(':');
    bool has_nodes = false, has_words = false;
    while (!has_words) {
      const std::string key(text_.take_name());
      if (key.empty()) text_.fail("the vocabulary ends early: 'nodes' or 'words' are missing");
      text_.expect(':');
      if (key == "k") {
        listed_.branching = text_.take_number<int>();
      } else if (key == "L") {
        listed_.depth = text_.take_number<int>();
      } else if (key == "scoringType") {
        listed_.score = text_.take_number<int>();
      } else if (key == "weightingType") {
        listed_.weighting = text_.take_number<int>();
      } else if (key == "nodes") {
        each_entry([&] { read_node(); });
        has_nodes = true;
      } else if (key == "words") {
        if (!has_nodes) text_.fail("'words' stand before 'nodes'");
        each_entry([&] { read_word(); });
        has_words = true;
      } else {
        text_.fail("unknown entry", key);
      }
    }
    return std::move(listed_);
  }
  bool dbow3() const { return form_ != Form::bytes; }

 private:
  enum class Form { unknown, bytes, sized };

  void skip_head() {
    for (text_.skip_space(); text_.peek() == '%' || text_.peek() == '-'; text_.skip_space())
      text_.take_line();
  }

  /// "- { ... }" for each entry, or "[ { ... }, { ... } ]".
  template <class Read>
  void each_entry(Read&& read) {
    if (text_.take('[')) {
      while (!text_.take(']')) {
        text_.expect('{');
        read();
        text_.take(',');
      }
      return;
    }
    while (text_.take('-')) {
      text_.expect('{');
      read();
    }
  }

  void read_node() {
    std::uint32_t id = 0, parent = 0;
    double weight = 0;
    unsigned seen = 0;
    do {
      const std::string_view key = text_.take_name();
      if (key == "nodeId") {
        text_.expect(':');
        id = text_.take_number<std::uint32_t>();
        seen |= 1;
      } else if (key == "parentId") {
        text_.expect(':');
        parent = text_.take_number<std::uint32_t>();
        seen |= 2;
      } else if (key == "weight") {
        text_.expect(':');
        weight = text_.take_number<double>();
        seen |= 4;
      } else if (key == "descriptor") {
        text_.expect(':');
        if (seen & 8) text_.fail("a node has two descriptors");
        read_descriptor(text_.take_quoted());
        seen |= 8;
      } else {
        text_.fail("unknown entry of a node", key);
      }
    } while (text_.take(','));
    text_.expect('}');
    if (seen != 15) text_.fail("a node lacks its number, parent, weight or descriptor");
    listed_.id.push_back(id);
    listed_.parent.push_back(parent);
    listed_.weight.push_back(weight);
  }

  void read_descriptor(std::string_view text) {
    Numbers numbers(text);
    if (numbers.take_word("dbw3")) read_size(numbers);
    // Older files of DBoW3 lack the mark: there are two numbers more than the second one says.
    else if (form_ == Form::sized)
      read_size(numbers);
    std::array<std::uint8_t, kMaxBytes + 2> bytes;
    std::size_t count = 0;
    while (!numbers.done()) {
      if (count == bytes.size()) text_.fail("a descriptor is too long");
      if (!numbers.take_byte(bytes[count])) text_.fail("a descriptor must be of bytes", numbers.rest());
      ++count;
    }
    std::size_t from = 0;
    if (form_ == Form::unknown) {
      const bool sized = count >= 3 && bytes[0] == 0 && bytes[1] == count - 2;
      form_ = sized ? Form::sized : Form::bytes;
      from = sized ? 2 : 0;
      listed_.bytes = count - from;
    }
    if (count - from != listed_.bytes || listed_.bytes == 0)
      text_.fail("a descriptor has another length", std::to_string(count));
    listed_.descriptors.insert(listed_.descriptors.end(), bytes.begin() + from, bytes.begin() + count);
  }

  void read_size(Numbers& numbers) {
    int type = 0;
    std::size_t columns = 0;
    if (!numbers.take(type) || !numbers.take(columns)) text_.fail("a descriptor lacks type and length");
    if (type != 0) text_.fail("descriptors must be binary; type", std::to_string(type));
    if (form_ == Form::unknown) {
      form_ = Form::sized;
      listed_.bytes = columns;
    }
    if (columns != listed_.bytes) text_.fail("a descriptor has another length", std::to_string(columns));
  }

  void read_word() {
    std::uint32_t word = 0, node = 0;
    unsigned seen = 0;
    do {
      const std::string_view key = text_.take_name();
      if (key != "wordId" && key != "nodeId") text_.fail("unknown entry of a word", key);
      const bool is_word = key == "wordId";
      text_.expect(':');
      (is_word ? word : node) = text_.take_number<std::uint32_t>();
      seen |= is_word ? 1 : 2;
    } while (text_.take(','));
    text_.expect('}');
    if (seen != 3) text_.fail("a word lacks its number or node");
    listed_.word_id.push_back(word);
    listed_.word_node.push_back(node);
  }

  TextWindow text_;
  ListedNodes listed_;
  Form form_ = Form::unknown;
};

/// Gathers small pieces.
class Writer {
 public:
  explicit Writer(const Sink& sink) : sink_(sink) { buffer_.reserve(kFull + 65536); }
  ~Writer() = default;

  Writer& operator<<(std::string_view text) {
    buffer_ += text;
    if (buffer_.size() >= kFull) flush();
    return *this;
  }
  template <class Number>
  Writer& number(Number value) {
    char digits[32];
    const auto [stop, error] = std::to_chars(digits, digits + sizeof(digits), value);
    buffer_.append(digits, stop);
    return *this;
  }
  /// The bytes of a descriptor, a space behind each.
  Writer& bytes(std::span<const std::uint64_t> words) {
    for (const std::uint64_t word : words)
      for (int i = 0; i < 64; i += 8) number(static_cast<unsigned>(word >> i & 255)) << " ";
    return *this;
  }
  void flush() {
    sink_(buffer_);
    buffer_.clear();
  }

 private:
  static constexpr std::size_t kFull = 1u << 18;

  const Sink& sink_;
  std::string buffer_;
};

}  // namespace

VocabularyTree read_yaml(const std::string& path, bool* dbow3) {
  YamlReader reader(path);
  const ListedNodes listed = reader.read();
  *dbow3 = reader.dbow3();
  return tree_of(listed, path);
}

VocabularyTree read_orbslam_text(const std::string& path) {
  TextWindow text(path);
  ListedNodes listed;
  {
    Numbers head(text.take_line());
    if (!head.take(listed.branching) || !head.take(listed.depth) || !head.take(listed.score) ||
        !head.take(listed.weighting) || !head.done())
      text.fail("expected branching, depth, score and weighting");
  }
  std::array<std::uint8_t, kMaxBytes> bytes;
  while (!text.at_end()) {
    const std::string_view line = text.take_line();
    if (line.find_first_not_of(" \t") == std::string_view::npos) {
      text.skip_space();
      if (!text.at_end()) text.fail("an empty line among the nodes");
      break;
    }
    if (listed.bytes == 0) {
      // As many bytes as there are numbers but parent, leaf mark and weight.
      std::size_t numbers = 0;
      for (std::size_t i = 0; i < line.size(); ++i)
        numbers += line[i] > ' ' && (i == 0 || line[i - 1] <= ' ');
      if (numbers < 4 || numbers - 3 > kMaxBytes)
        text.fail("expected parent, leaf mark, descriptor and weight", line);
      listed.bytes = numbers - 3;
    }
    Numbers numbers(line);
    std::uint32_t parent = 0;
    int leaf = 0;
    double weight = 0;
    bool good = numbers.take(parent) && numbers.take(leaf);
    for (std::size_t i = 0; good && i < listed.bytes; ++i) good = numbers.take_byte(bytes[i]);
    if (!good || !numbers.take(weight) || !numbers.done())
      text.fail("a node is cut short or wrong; expected parent, leaf mark, " + std::to_string(listed.bytes) +
                    " bytes and weight",
                line);
    const auto id = static_cast<std::uint32_t>(listed.id.size() + 1);
    listed.id.push_back(id);
    listed.parent.push_back(parent);
    listed.weight.push_back(weight);
    listed.descriptors.insert(listed.descriptors.end(), bytes.begin(),
                              bytes.begin() + static_cast<std::ptrdiff_t>(listed.bytes));
    if (leaf > 0) {
      listed.word_id.push_back(static_cast<std::uint32_t>(listed.word_id.size()));
      listed.word_node.push_back(id);
    }
  }
  return tree_of(listed, path);
}

void write_yaml(const VocabularyTree& tree, bool dbow3, const Sink& sink) {
  const std::vector<std::uint32_t> leaf = leaf_of_word(tree);
  std::vector<std::uint32_t> order = order_by_word(tree);
  if (order.empty())
    for (std::uint32_t i = 0; i < tree.size(); ++i) order.push_back(i);
  std::vector<std::uint32_t> id(tree.size());
  for (std::uint32_t k = 0; k < order.size(); ++k) id[order[k]] = k;
  Writer out(sink);
  out << "%YAML:1.0\n---\nvocabulary:\n   k: ";
  out.number(tree.branching) << "\n   L: ";
  out.number(tree.depth) << "\n   scoringType: ";
  out.number(static_cast<int>(tree.score)) << "\n   weightingType: ";
  out.number(static_cast<int>(tree.weighting)) << "\n   nodes:\n";
  for (const std::uint32_t node : order) {
    if (node == 0) continue;
    out << "      - { nodeId:";
    out.number(id[node]) << ", parentId:";
    out.number(id[tree.parent[node]]) << ", weight:";
    const double weight = tree.word[node] == VocabularyTree::kNoWord ? 0.0 : tree.weight[node];
    out << number_text(weight);
    // FileStorage takes a number for a real one by its point or exponent.
    if (weight == std::floor(weight) && number_text(weight).find_first_of(".e") == std::string::npos)
      out << ".";
    out << ",\n          descriptor:\"";
    if (dbow3) {
      out << "dbw3 0 ";
      out.number(tree.bits / 8) << " ";
    }
    out.bytes(tree.descriptor(node)) << "\" }\n";
  }
  out << "   words:\n";
  for (std::size_t word = 0; word < leaf.size(); ++word) {
    out << "      - { wordId:";
    out.number(word) << ", nodeId:";
    out.number(id[leaf[word]]) << " }\n";
  }
  out.flush();
}

void write_orbslam_text(const VocabularyTree& tree, const Sink& sink) {
  leaf_of_word(tree);
  const std::vector<std::uint32_t> order = order_by_word(tree);
  require(!order.empty(), "write_vocabulary",
          "the words are in an order that this format cannot hold: renumber them",
          to_string(VocabularyFormat::orbslam_text));
  std::vector<std::uint32_t> id(tree.size());
  for (std::uint32_t k = 0; k < order.size(); ++k) id[order[k]] = k;
  Writer out(sink);
  out.number(tree.branching) << " ";
  out.number(tree.depth) << "  ";
  out.number(static_cast<int>(tree.score)) << " ";
  out.number(static_cast<int>(tree.weighting)) << "\n";
  for (const std::uint32_t node : order) {
    if (node == 0) continue;
    const bool leaf = tree.word[node] != VocabularyTree::kNoWord;
    out.number(id[tree.parent[node]]) << (leaf ? " 1 " : " 0 ");
    out.bytes(tree.descriptor(node)) << " " << number_text(leaf ? tree.weight[node] : 0.0) << "\n";
  }
  out.flush();
}

}  // namespace sweepkit::impl
