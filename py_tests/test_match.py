# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

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
