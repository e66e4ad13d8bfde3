# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from sweepkit.feature import LineExtractor, LineFeatures, LineOptions
from sweepkit.geometry import Camera, Distortion, SE3d, SO3d, StereoRig
from sweepkit.match import LineProjectionMatcher, LineStereoMatcher, LineStereoOptions, line_stereo_match_dtype

FOCAL, BASELINE = 200.0, 0.1


@pytest.fixture
def rig():
    camera = Camera([FOCAL, FOCAL, 160.0, 120.0], Distortion.none, [], 320, 240)
    return StereoRig(camera, camera, SE3d(), SE3d(SO3d(), np.array([BASELINE, 0.0, 0.0])))


@pytest.fixture
def lines(textured):
    extractor = LineExtractor(LineOptions(octaves=1))
    return [extractor.extract(image) for image in textured]


def test_lines_are_paired_and_placed_in_space(rig, lines):
    left, right = lines
    matcher = LineStereoMatcher(rig)
    matches = matcher.match(left, right)
    assert matches.dtype == line_stereo_match_dtype and len(matches) == len(left)
    found = matches[matches["right"] >= 0]
    assert len(found) > 10
    # The scene lies 8 px apart.
    disparity = 0.5 * (found["disparity1"] + found["disparity2"])
    assert np.mean(np.abs(disparity - 8) < 0.5) > 0.9
    valid, points, covariances = matcher.triangulate(matches)
    assert points.shape == (len(left), 2, 3) and covariances.shape == (len(left), 2, 3, 3)
    np.testing.assert_array_equal(valid, matches["right"] >= 0)
    depth = points[valid].mean(1)[:, 2]
    assert np.median(depth) == pytest.approx(FOCAL * BASELINE / 8, rel=0.02)
    assert (np.linalg.eigvalsh(covariances[valid]) > -1e-12).all() and not points[~valid].any()


def test_wrong_arguments(rig, lines):
    matcher = LineStereoMatcher(rig)
    nothing = LineFeatures(np.zeros((0, 4), np.float32), np.zeros((0, 32), np.uint8))
    assert len(matcher.match(nothing, nothing)) == 0
    assert (matcher.match(lines[0], nothing)["right"] == -1).all()
    with pytest.raises(ValueError, match="line_stereo_match_dtype"):
        matcher.triangulate(np.zeros((3, 4)))
    with pytest.raises(ValueError):
        LineStereoOptions(ratio=0.0)


def test_predicted_lines_are_found(lines):
    left, right = lines
    moved = left.segments - np.array([8, 0, 8, 0], np.float32)
    matches = LineProjectionMatcher().match(moved, left.descriptors, right.segments, right.descriptors, radius=3)
    found = matches["index"] >= 0
    assert found.mean() > 0.6
    middle = moved[found].reshape(-1, 2, 2).mean(1)
    other = right.segments[matches["index"][found]].reshape(-1, 2, 2)
    d = other[:, 1] - other[:, 0]
    off = np.abs(d[:, 0] * (middle - other[:, 0])[:, 1] - d[:, 1] * (middle - other[:, 0])[:, 0]) / np.linalg.norm(d, axis=1)
    assert np.mean(off < 1) > 0.9
    with pytest.raises(ValueError, match=r"\(n, 32\)"):
        LineProjectionMatcher().match(moved, left.descriptors[:, :8], right.segments, right.descriptors)
    with pytest.raises(ValueError):
        LineProjectionMatcher().match(moved, left.descriptors[:3], right.segments, right.descriptors)
