# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

import sweepkit as sk
from sweepkit.feature import OrbExtractor, OrbOptions
from sweepkit.geometry import Camera, StereoRig
from sweepkit.image import ImagePyramid
from sweepkit.match import BruteForceOptions, StereoMatcher, StereoOptions, match_brute_force


def rig():
    camera = Camera([250, 250, 160, 120], "none", [], 320, 240)
    T_right = np.eye(4)
    T_right[0, 3] = 0.1
    return StereoRig(camera, camera, np.eye(4), T_right)


def test_stereo_finds_the_shift(textured):
    options = OrbOptions(count=400, fallback_threshold=5)
    extractor = OrbExtractor(options)
    features = [extractor.extract(image) for image in textured]
    pyramids = [ImagePyramid(image, options.levels, options.scale_factor) for image in textured]
    matcher = StereoMatcher(rig(), StereoOptions(search={"left_right_check": True}))
    matches = matcher.match(features[0], pyramids[0], features[1], pyramids[1])
    found = matches[matches["right"] >= 0]
    assert len(matches) == len(features[0]) and len(found) > 100
    assert abs(np.median(found["disparity"]) - 8) < 0.2
    prior = np.full(len(matches), 8, np.float32)
    with_prior = matcher.match(features[0], pyramids[0], features[1], pyramids[1], prior)
    assert (with_prior["right"] >= 0).sum() >= 0.9 * len(found)
    with pytest.raises(ValueError):
        matcher.match(features[0], pyramids[0], features[1], pyramids[1], prior[:-1])


def test_brute_force_matches_an_image_to_itself(textured):
    features = OrbExtractor().extract(textured[0])
    matches = match_brute_force(features, features, BruteForceOptions(ratio=1.0))
    assert (matches["index"] == np.arange(len(features))).mean() > 0.95


def test_nearest_codes_agree_with_distances_of_numpy():
    rng = np.random.default_rng(5)
    rows = rng.integers(0, 256, (3000, 32), dtype=np.uint8)
    rows[1000:2000] = rows[:1000]
    rows[1000:2000, 3] ^= 5  # two bits
    codes = sk.match.NearestCodes()
    ids = codes.insert(rows)
    assert ids.tolist() == list(range(3000)) and len(codes) == 3000
    codes.remove(1500)
    assert 1500 not in codes and 1499 in codes and (codes.code(7) == rows[7]).all()
    queries = rows[[3, 500, 2500]]
    distances = np.unpackbits(queries[:, None] ^ rows[None], axis=2).sum(axis=2)
    distances[:, 1500] = 1000
    for radius in (0, 2, 110):
        matches, begins = codes.within(queries, radius)
        assert begins.tolist()[0] == 0 and begins[-1] == len(matches)
        for i, row in enumerate(distances):
            found = matches[begins[i]:begins[i + 1]]
            expected = [(d, j) for j, d in enumerate(row) if d <= radius]
            assert [(m["distance"], m["index"]) for m in found] == sorted(expected)
    matches, begins = codes.nearest(queries, 4)
    assert begins.tolist() == [0, 4, 8, 12]
    assert [m["index"] for m in matches[:2]] == [3, 1003]
    scan = sk.match.NearestCodes(sk.match.NearestCodesOptions(search="scan"))
    scan.insert(np.delete(rows, 1500, axis=0))
    assert (scan.nearest(queries, 4)[0]["distance"] == matches["distance"]).all()
    assert scan.memory < codes.memory


def test_nearest_codes_say_what_is_wrong():
    codes = sk.match.NearestCodes()
    with pytest.raises(ValueError, match=r"uint8 of shape \(n, 32\)"):
        codes.insert(np.zeros((4, 16), np.uint8))
    with pytest.raises(ValueError, match="no such code"):
        codes.remove(0)
    assert codes.nearest(np.zeros((2, 32), np.uint8))[1].tolist() == [0, 0, 0]
