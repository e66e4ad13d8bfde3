# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
import threading

import numpy as np
import pytest

from sweepkit.feature import Features, OrbExtractor, OrbOptions, hamming_distance, keypoint_dtype


def test_features_are_arrays(textured):
    left, _ = textured
    features = OrbExtractor(OrbOptions(count=300)).extract(left)
    assert 200 < len(features) <= 300
    assert features.keypoints.dtype == keypoint_dtype and features.descriptors.shape == (len(features), 32)
    assert features.keypoints["x"].max() < 320 and features.keypoints["octave"].min() == 0
    again = Features(features.keypoints, features.descriptors)
    np.testing.assert_array_equal(again.descriptors, features.descriptors)
    np.testing.assert_array_equal(again.keypoints, features.keypoints)
    points = features.keypoints
    del features, again
    assert np.isfinite(points["angle"]).all(), "a view keeps its features alive"


def test_hamming_distance():
    a = np.zeros(32, np.uint8)
    b = a.copy()
    b[3] = 0b101
    assert hamming_distance(a, b) == 2
    with pytest.raises(ValueError, match=r"uint8 of shape \(32,\)"):
        hamming_distance(a, b[:31])


def test_features_must_agree():
    points = np.zeros(3, keypoint_dtype)
    with pytest.raises(ValueError, match="got 2"):
        Features(points, np.zeros((2, 32), np.uint8))
    with pytest.raises(ValueError, match="key points"):
        Features(np.zeros((3, 2)), np.zeros((3, 32), np.uint8))


def test_extraction_lets_other_threads_run(textured):
    left, _ = textured
    results = [None] * 4

    def work(i):
        extractor = OrbExtractor(OrbOptions(count=200))
        for _ in range(10):
            results[i] = extractor.extract(left).descriptors

    threads = [threading.Thread(target=work, args=(i,)) for i in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for result in results[1:]:
        np.testing.assert_array_equal(result, results[0])
