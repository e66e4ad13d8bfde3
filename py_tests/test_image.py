# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from sweepkit.image import ImagePyramid


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
