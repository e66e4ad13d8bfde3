# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
import os
import pathlib

import numpy as np
import pytest
import sweepkit as sk


def floor_with_box():
    camera = sk.geometry.RectifiedCamera(focal=320, cx=320, cy=200, baseline=0.06)
    plane = sk.floor.GroundPlane([0, 1, 0], height=0.08)
    v, u = np.mgrid[0:400, 0:640]
    disparity = np.maximum((v - 200) * 0.06 / 0.08, 0).astype(np.float32)
    # A front 5 cm high and 10 cm wide, 50 cm ahead.
    d = 320 * 0.06 / 0.5
    front = (abs(u - 320) < 0.05 * 320 / 0.5) & (v > 200 + (0.08 - 0.05) * 320 / 0.5) & (v < 200 + 0.08 * 320 / 0.5)
    disparity[front] = d
    return camera, plane, disparity


@pytest.mark.parametrize("kind", [np.float32, np.int16])
def test_a_box_is_found(kind):
    camera, plane, disparity = floor_with_box()
    if kind is np.int16:
        disparity = np.round(16 * disparity).astype(np.int16)
    points = sk.floor.PointList()
    points.build(disparity, camera, plane.disparity(camera), sk.floor.FloorTolerance.of(sk.floor.FloorNoise(), plane, camera))
    finder = sk.floor.ObstacleFinder()
    found = finder.find(disparity, points.mask, camera, plane)
    assert len(found) == 1
    box = found[0]
    assert box.kind == sk.floor.ObstacleKind.obstacle
    assert abs(box.distance - 0.5) < 0.01
    assert abs(box.box.top - 0.05) < 0.004
    assert abs(box.box.length - 0.1) < 0.01
    assert box.p_camera.shape == (3,) and box.covariance.shape == (3, 3)
    assert (finder.regions > 0).sum() == box.pixels
    assert "obstacle" in repr(box)


def test_a_hole_in_a_plane_that_is_contradicted_is_not_clear():
    camera, plane, disparity = floor_with_box()
    floor = (np.mgrid[0:400, 0:640][0] - 200) * 0.75
    disparity = np.maximum(floor, 0).astype(np.float32)
    disparity[260:300, 250:390] *= 0.5
    points = sk.floor.PointList()
    points.build(disparity, camera, plane.disparity(camera), sk.floor.FloorTolerance.of(sk.floor.FloorNoise(), plane, camera))
    finder = sk.floor.ObstacleFinder()
    for contradicted in (False, True):
        found = finder.find(disparity, points.mask, camera, plane, contradicted=contradicted)
        assert [o.kind for o in found] == [sk.floor.ObstacleKind.hole]
        assert found[0].clear != contradicted


def test_wrong_arrays_are_named():
    camera, plane, disparity = floor_with_box()
    finder = sk.floor.ObstacleFinder()
    with pytest.raises(ValueError, match="float64 of shape"):
        finder.find(disparity.astype(float), np.zeros((400, 640), np.uint8), camera, plane)
    with pytest.raises(ValueError, match="mask"):
        finder.find(disparity, np.zeros((4, 6), np.uint8), camera, plane)
    with pytest.raises(ValueError, match="min_height"):
        sk.floor.ObstacleFinder(sk.floor.ObstacleOptions(min_height=-1))


@pytest.mark.skipif("SWEEPKIT_DATA" not in os.environ, reason="SWEEPKIT_DATA is unset")
def test_obstacles_of_a_recording(tmp_path):
    data = pathlib.Path(os.environ["SWEEPKIT_DATA"]) / "sweephome/dev01"
    counts = sk.floor.detect_obstacles(str(data), str(tmp_path / "out"), start=4, duration=0.3)
    assert counts["frames"] == 4
    assert counts["obstacles"] > 0
    assert (tmp_path / "out/obstacles.jsonl").exists()
