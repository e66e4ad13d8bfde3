# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from sweepkit.geometry import Camera, Side, StereoRig
from sweepkit.image import (DenseMatcher, DisparityOptions, DisparityRamp, ImagePyramid, StereoDisparity, StereoRectifier)


def test_levels_are_views():
    image = np.full((120, 160), 77, np.uint8)
    pyramid = ImagePyramid(image, levels=4, factor=1.5)
    level = pyramid.level(2)
    assert level.shape == (round(120 / 1.5**2), round(160 / 1.5**2)) and (level == 77).all()
    assert not level.flags.writeable and level.base is not None
    del pyramid
    assert (level == 77).all(), "a view keeps its pyramid alive"


def test_padded_and_turned_rows_are_taken_as_they_are():
    base = np.random.default_rng(0).integers(0, 255, (50, 90), np.uint8)
    for image in (base[:, 5:70], base[::-1], base[:, ::2]):
        np.testing.assert_array_equal(ImagePyramid(image, levels=1).level(0), image)


def test_wrong_images_are_named():
    for wrong, told in ((np.zeros((4, 5)), r"float64 of shape \(4, 5\)"), (np.zeros((4, 5, 3), np.uint8), r"\(4, 5, 3\)"),
                        (np.zeros((4, 5), np.uint16), "uint16"), ("picture", "str")):
        with pytest.raises(ValueError, match=told):
            ImagePyramid(wrong)
    with pytest.raises(ValueError):
        ImagePyramid(np.zeros((0, 5), np.uint8))
    with pytest.raises(ValueError, match="got 9"):
        ImagePyramid(np.zeros((40, 50), np.uint8), levels=2).level(9)


def shifted_pair(disparity, height=96, width=192):
    texture = np.random.default_rng(3).integers(0, 255, (height, width + 64), np.uint8)
    return np.ascontiguousarray(texture[:, 32 - disparity:32 - disparity + width]), np.ascontiguousarray(texture[:, 32:32 + width])


def test_dense_disparity_of_a_rectified_pair():
    left, right = shifted_pair(20)
    matcher = DenseMatcher(DisparityOptions(disparities=32))
    disparity = matcher.match(left, right)
    assert disparity.dtype == np.int16 and disparity.shape == left.shape and not disparity.flags.writeable
    inner = disparity[8:-8, 40:-8]
    assert (abs(inner / 16 - 20) < 0.5).mean() > 0.95
    np.testing.assert_array_equal(matcher.match(left, right, DisparityRamp()), disparity)
    assert not DenseMatcher().match(np.zeros_like(left), np.zeros_like(left)).any()
    with pytest.raises(ValueError, match="192x96 and 191x96"):
        matcher.match(left, right[:, :-1])
    with pytest.raises(ValueError, match="multiple of 16"):
        DenseMatcher(DisparityOptions(disparities=33))


def test_dense_disparity_of_a_raw_pair():
    camera = Camera([150, 150, 95, 47], "none", [], 192, 96)
    rig = StereoRig(camera, camera, np.eye(4), np.array([[1, 0, 0, 0.06], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]]))
    left, right = shifted_pair(12)
    source = StereoDisparity(rig, DisparityOptions(disparities=32))
    disparity = source.match(left, right)
    assert np.median(disparity[8:-8, 40:-8]) == pytest.approx(12 * 16, abs=4)
    assert source.camera.baseline == pytest.approx(0.06)
    rectifier = StereoRectifier(rig)
    rectifier.rectify(left, right)
    np.testing.assert_array_equal(rectifier.image(Side.right), right)
    assert (rectifier.seen(Side.left) == 255).all()
    with pytest.raises(ValueError, match="192x96"):
        source.match(left[:-1], right)
