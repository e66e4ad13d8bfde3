# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from sweepkit.floor import (FloorDisparity, FloorLabel, FloorNoise, FloorTolerance, GroundPlane, OrganisedCloud, PointList,
                            obstacle_mask)
from sweepkit.geometry import RectifiedCamera

CAMERA = RectifiedCamera(focal=320, cx=318.5, cy=200.25, baseline=0.06)
PLANE = GroundPlane([0.02, 0.998, 0.05] / np.linalg.norm([0.02, 0.998, 0.05]), 0.08)
TOLERANCE = FloorTolerance(base=1.5, slope=0.02)


def scene(dtype):
    """A floor with a box on it, a hole beside it and a part that is unknown."""
    floor = PLANE.disparity(CAMERA)
    v, u = np.mgrid[:400, :640]
    expected = floor.at_origin + floor.along_u * u + floor.along_v * v
    disparity = np.maximum(expected, 0)
    disparity[300:340, 100:200] += 20
    disparity[300:340, 300:400] -= 20
    disparity[:, 600:] = -1
    return (disparity * (16 if dtype == np.int16 else 1)).astype(dtype), floor, expected


@pytest.mark.parametrize("dtype", [np.float32, np.int16])
def test_mask_and_clouds(dtype):
    disparity, floor, expected = scene(dtype)
    mask = obstacle_mask(disparity, floor, TOLERANCE)
    assert mask.dtype == np.uint8 and mask.shape == disparity.shape
    assert (mask[300:340, 100:200] == int(FloorLabel.obstacle)).all()
    assert (mask[300:340, 300:400] == int(FloorLabel.hole)).all()
    assert (mask[300:340, 450:600] == int(FloorLabel.floor)).all()
    assert (mask[:, 600:] == int(FloorLabel.unknown)).all()

    cloud = OrganisedCloud()
    cloud.build(disparity, CAMERA, floor, TOLERANCE)
    np.testing.assert_array_equal(cloud.mask, mask)
    obstacle = mask == int(FloorLabel.obstacle)
    assert np.isnan(cloud.z[~obstacle]).all() and not np.isnan(cloud.x[obstacle]).any()
    pixels = disparity / (16 if dtype == np.int16 else 1)
    depth = CAMERA.focal * CAMERA.baseline / pixels[obstacle]
    np.testing.assert_allclose(cloud.z[obstacle], depth, rtol=1e-6)

    points = PointList()
    points.build(disparity, CAMERA, floor, TOLERANCE, hole=True)
    assert len(points) == 2 * 40 * 100 and points.points.shape == (8000, 3) and points.points.dtype == np.float32
    chosen = np.isin(mask, [int(FloorLabel.obstacle), int(FloorLabel.hole)])
    np.testing.assert_array_equal(points.pixels, np.flatnonzero(chosen))
    height = PLANE.height_of(points.points[0])
    assert height == pytest.approx(PLANE.height * (1 - expected[300, 100] / pixels[300, 100]), abs=1e-5)


def test_arrays_are_where_they_lie():
    disparity, floor, _ = scene(np.float32)
    cloud, points = OrganisedCloud(), PointList()
    cloud.build(disparity, CAMERA, floor, TOLERANCE)
    points.build(disparity, CAMERA, floor, TOLERANCE)
    for first, second in ((cloud.mask, cloud.mask), (cloud.x, cloud.x), (points.points, points.points)):
        assert np.shares_memory(first, second) and not first.flags.writeable
    z = cloud.z
    before = z.copy()
    del cloud
    np.testing.assert_array_equal(z, before)
    # Padded, turned and thinned rows give what a plain array gives.
    wide = np.zeros((400, 700), np.float32)
    wide[:, 30:670] = disparity
    expected = obstacle_mask(disparity, floor, TOLERANCE)
    np.testing.assert_array_equal(obstacle_mask(wide[:, 30:670], floor, TOLERANCE), expected)
    np.testing.assert_array_equal(obstacle_mask(np.repeat(disparity, 2, axis=1)[:, ::2], floor, TOLERANCE), expected)


def test_tolerance_and_plane():
    tolerance = FloorTolerance.of(FloorNoise(min_height=0.01), PLANE, CAMERA)
    assert tolerance.towards(100) >= 100 * 0.01 / (PLANE.height - 0.01) - 1e-9
    assert tolerance.towards(10) >= tolerance.away(10)
    floor = PLANE.disparity(CAMERA)
    back = GroundPlane.of(floor, CAMERA)
    np.testing.assert_allclose(back.down_camera, PLANE.down_camera, atol=1e-12)
    assert back.height == pytest.approx(PLANE.height)
    ramp = floor.ramp(CAMERA.cx)
    assert ramp.at_top + 300 * ramp.per_row == pytest.approx(floor(CAMERA.cx, 300))
    assert FloorDisparity(1, 2, 3)(4, 5) == 1 + 8 + 15


def test_wrong_disparities_are_named():
    floor = PLANE.disparity(CAMERA)
    for wrong, told in ((np.zeros((4, 5)), r"float64 of shape \(4, 5\)"), (np.zeros(4, np.float32), r"\(4,\)"),
                        (np.zeros((4, 5), np.uint8), "uint8")):
        with pytest.raises(ValueError, match=told):
            obstacle_mask(wrong, floor, TOLERANCE)
        with pytest.raises(ValueError, match=told):
            PointList().build(wrong, CAMERA, floor, TOLERANCE)
    with pytest.raises(ValueError, match="finite"):
        obstacle_mask(np.zeros((4, 5), np.float32), FloorDisparity(float("nan")), TOLERANCE)
