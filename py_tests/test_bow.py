# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from sweepkit.bow import (Bag, BagQueryOptions, BagScore, InvertedFile, OrbVocabulary, VocabularyTrainingOptions,
                          bag_score, detect_vocabulary_format, group_matches, load_vocabulary, read_vocabulary,
                          renumbered, sorted_by_level, train_vocabulary, write_vocabulary)


@pytest.fixture(scope="module")
def images():
    """Descriptors of a few images, about the same hidden words."""
    random = np.random.default_rng(1)
    centres = random.integers(0, 256, (60, 32), dtype=np.uint8)
    noise = lambda n: np.packbits(random.random((n, 256)) < 0.05, axis=1)  # noqa: E731
    return [centres[random.integers(0, 60, 200)] ^ noise(200) for _ in range(8)]


@pytest.fixture(scope="module")
def vocabulary(images):
    return OrbVocabulary(train_vocabulary(images, VocabularyTrainingOptions(branching=5, depth=3)))


def plain_word(tree, descriptor):
    node = 0
    while True:
        children = [c for c in np.flatnonzero(tree.parent == node) if c != 0]
        if not children:
            return tree.word[node]
        distances = [np.unpackbits(tree.descriptors[c] ^ descriptor).sum() for c in children]
        node = children[int(np.argmin(distances))]


def test_words_are_those_of_a_plain_walk(images, vocabulary):
    words, weights, nodes = vocabulary.find_words(images[0], level=1)
    tree = vocabulary.tree()
    assert [plain_word(tree, d) for d in images[0][:50]] == words[:50].tolist()
    assert (nodes >= 1).all() and (nodes <= 5).all() and (weights >= 0).all()


def test_training_does_not_depend_on_threads_and_tells_progress(images):
    told = []
    one = train_vocabulary(images, VocabularyTrainingOptions(branching=5, threads=1), told.append)
    assert told == sorted(told) and told[-1] == 1.0
    assert one == train_vocabulary(images, VocabularyTrainingOptions(branching=5, threads=3))

    def stop(done):
        raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        train_vocabulary(images, progress=stop)


def test_bags(images, vocabulary):
    a, b = vocabulary.transform(images[0]), vocabulary.transform(images[1])
    assert abs(a.weights.sum() - 1) < 1e-12 and (np.diff(a.words.astype(int)) > 0).all()
    assert vocabulary.score(a, a) == pytest.approx(1)
    dense = np.zeros((2, vocabulary.word_count))
    dense[0, a.words], dense[1, b.words] = a.weights, b.weights
    assert vocabulary.score(a, b) == pytest.approx(1 - 0.5 * np.abs(dense[0] - dense[1]).sum())
    assert bag_score(a, b, BagScore.dot) == pytest.approx((dense[0] * dense[1]).sum())
    bag, index = vocabulary.transform(images[0], 1)
    assert bag == a and bag == Bag(a.words, a.weights, vocabulary.word_count)
    assert sorted(i for k in range(len(index)) for i in index.features_of(k)) == sorted(
        np.flatnonzero(vocabulary.find_words(images[0])[1] > 0))
    with pytest.raises(IndexError):
        index.features_of(len(index))


@pytest.mark.parametrize("name, format", [
    ("v.swv", "sweepkit"), ("v.yml", "dbow2_yaml"), ("v.yml.gz", "dbow2_yaml"), ("v.txt", "orbslam_text"),
    ("w.yml", "dbow3_yaml"), ("v.dbow3", "dbow3_binary"), ("w.dbow3", "dbow3_compressed"), ("v.fbow", "fbow")])
def test_every_format_keeps_the_words(images, vocabulary, tmp_path, name, format):
    path = str(tmp_path / name)
    write_vocabulary(path, vocabulary.tree(), format)
    assert detect_vocabulary_format(path) == format
    back = load_vocabulary(path)
    assert (back.find_words(images[2])[0] == vocabulary.find_words(images[2])[0]).all()
    if format != "fbow":
        assert sorted_by_level(read_vocabulary(path)) == vocabulary.tree()
        assert back.transform(images[2]) == vocabulary.transform(images[2])


def test_our_own_file(vocabulary, tmp_path):
    path = str(tmp_path / "v.swv")
    vocabulary.save(path)
    opened = OrbVocabulary.open(path)
    opened.verify()
    assert opened.tree() == vocabulary.tree() == renumbered(vocabulary.tree())
    content = bytearray((tmp_path / "v.swv").read_bytes())
    content[5000] ^= 1
    (tmp_path / "bad.swv").write_bytes(content)
    with pytest.raises(Exception, match="checksum"):
        OrbVocabulary.open(str(tmp_path / "bad.swv")).verify()


def test_inverted_file(images, vocabulary, tmp_path):
    file = InvertedFile()
    bags = [vocabulary.transform(image) for image in images]
    for i, bag in enumerate(bags):
        file.insert(10 * i, bag)
    matches = file.query(bags[3])
    assert matches["id"][0] == 30 and matches["score"][0] == pytest.approx(1)
    assert {int(m["id"]): pytest.approx(m["score"]) for m in matches} == {
        10 * i: vocabulary.score(bags[3], bag) for i, bag in enumerate(bags)}
    few = file.query(bags[3], BagQueryOptions(max_results=2), np.array([30], np.uint32))
    assert len(few) == 2 and few["id"].tolist() == matches["id"][1:3].tolist()
    groups = group_matches(matches, lambda id: [id - 10, id + 10], 0.0)
    assert groups[0].best == 30 and groups[0].members == sorted(
        groups[0].members, key=matches["id"].tolist().index)
    file.save(str(tmp_path / "bags"))
    assert InvertedFile.load(str(tmp_path / "bags")) == file
    assert file.remove(30) and not file.remove(30) and 30 not in file and len(file) == 7
    with pytest.raises(ValueError):
        file.insert(10, bags[0])


def test_wrong_arrays_are_named(vocabulary):
    with pytest.raises(ValueError, match="uint8"):
        vocabulary.transform(np.zeros((3, 16), np.uint8))
    with pytest.raises(ValueError, match="word"):
        Bag(np.array([1, 1], np.uint32), np.array([1.0, 1.0]), 5)
    with pytest.raises(ValueError):
        VocabularyTrainingOptions(branching=1)
    with pytest.raises(ValueError):
        train_vocabulary([])
