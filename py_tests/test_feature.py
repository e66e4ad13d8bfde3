# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
import threading

import numpy as np
import pytest

from sweepkit.feature import (Features, LineExtractor, LineFeatures, LineOptions, OrbExtractor, OrbOptions, SegmentDetector,
                              SegmentOptions, hamming_distance, keypoint_dtype, segment_dtype)


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


def square(shift=0):
    """A bright square on dark ground."""
    image = np.full((200, 300), 40, np.uint8)
    image[50:150, 100 - shift:200 - shift] = 180
    return image


def test_segments_are_rows_of_four():
    detector = SegmentDetector()
    segments = detector.detect(square())
    assert segments.shape == (4, 4) and segments.dtype == np.float32
    length = np.linalg.norm(segments[:, 2:] - segments[:, :2], axis=1)
    assert (length > 85).all()
    # The dark side on the left hand: clockwise round what is bright.
    x, y = segments[:, 0::2] - 149.5, segments[:, 1::2] - 99.5
    assert (x[:, 0] * y[:, 1] - y[:, 0] * x[:, 1] > 0).all()
    for value in (0, 255):
        assert detector.detect(np.full((50, 60), value, np.uint8)).shape == (0, 4)
    assert detector.detect(np.zeros((3, 2), np.uint8)).shape == (0, 4)
    wide = np.repeat(square(), 2, axis=1)
    np.testing.assert_array_equal(detector.detect(wide[:, ::2]), segments)
    with pytest.raises(ValueError, match="uint8"):
        detector.detect(square().astype(float))
    with pytest.raises(ValueError):
        SegmentOptions(tolerance=-1.0)


def test_lines_have_descriptors(textured):
    left, _ = textured
    extractor = LineExtractor(LineOptions(octaves=2))
    lines = extractor.extract(left)
    assert len(lines) > 20 and lines.segments.shape == (len(lines), 4) and lines.descriptors.shape == (len(lines), 32)
    assert lines.records.dtype == segment_dtype and set(lines.records["octave"]) == {0, 1}
    np.testing.assert_array_equal(lines.records["x2"], lines.segments[:, 2])
    fine = lines.records["octave"] == 0
    again = extractor.describe(left, lines.segments[fine])
    assert np.unpackbits(again ^ lines.descriptors[fine], axis=1).sum(1).mean() < 1
    assert not extractor.describe(left, [[1, 1, 1, 1], [np.nan, 0, 9, 9]]).any()
    assert extractor.describe(left, np.zeros((0, 4), np.float32)).shape == (0, 32)
    same = LineFeatures(lines.segments, lines.descriptors)
    np.testing.assert_array_equal(same.segments, lines.segments)
    with pytest.raises(ValueError, match="got 1"):
        LineFeatures(lines.segments, lines.descriptors[:1])
    with pytest.raises(ValueError, match=r"\(n, 4\)"):
        LineFeatures(np.zeros((2, 3), np.float32), lines.descriptors[:2])
    assert len(extractor.extract(np.zeros((40, 50), np.uint8))) == 0
