# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

import sweepkit as sk

CAMERA = sk.geometry.RectifiedCamera(320.0, 319.5, 199.5, 0.06)
PLANE = sk.floor.GroundPlane([0.0, 1.0, 0.0], 0.08)


def disparities(wall=1.0):
    """A level camera before a wall across."""
    v = (np.arange(400)[:, None] - 199.5) / 320 + np.zeros((1, 640))
    floor = np.where(v > 0, 0.06 * 320 * v / 0.08, 0.0)
    return np.maximum(floor, 0.06 * 320 / wall).astype(np.float32)


def make_scan(wall=1.0, dtype=np.float32):
    d = disparities(wall)
    return sk.floor.FloorScanner().scan(d if dtype == np.float32 else np.round(16 * d).astype(np.int16), CAMERA, PLANE,
                                        [0, 0.08, -0.1])


@pytest.mark.parametrize("dtype", [np.float32, np.int16])
def test_scan_is_free_up_to_the_wall(dtype):
    scan = make_scan(dtype=dtype)
    rows = scan.stretches
    assert rows.dtype == sk.floor.floor_stretch_dtype
    hits = rows[rows["label"] == int(sk.floor.FloorLabel.obstacle)]
    bearing = scan.first_bearing + hits["bearing"] * scan.bearing_step
    np.testing.assert_allclose(hits["from"] * np.cos(bearing), 1000, rtol=0.03)
    assert scan.bytes < 8000
    with pytest.raises(ValueError):
        rows["from"][0] = 3
    with pytest.raises((ValueError, TypeError)):
        sk.floor.FloorScanner().scan(np.zeros(5, np.float32), CAMERA, PLANE, [0, 0, 0])


def test_grid_draws_and_takes_back():
    scan, pose = make_scan(), sk.floor.PlanarPose(0.5, 0.2, 0.3)
    grid = sk.floor.OccupancyGrid()
    for _ in range(4):
        grid.add(scan, pose)
    cells = grid.cells
    assert cells.dtype == np.int32 and (cells < 0).any() and (cells > 0).any()
    assert cells.base is not None and not cells.flags.writeable
    ahead = np.array([0.5, 0.2]) + 0.5 * np.array([np.cos(0.3), np.sin(0.3)])
    assert grid.log_odds(ahead) < 0
    image = grid.image()
    assert image.at(ahead) == 254
    assert set(np.unique(image.cells)) <= {0, 205, 254}
    for _ in range(4):
        grid.remove(scan, pose)
    assert not grid.cells.any()


def test_map_follows_keyframes():
    floor = sk.floor.FloorMap()
    scan = make_scan()
    T_keyframe_scan = sk.floor.camera_from_scan(PLANE)
    floor.add(3, T_keyframe_scan, scan)
    assert floor.update() == 0
    # A camera that looks along the map's x axis.
    R = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, [0, 0, 0.08]
    floor.set_pose(3, sk.geometry.SE3d(T))
    assert floor.update() == 1
    assert floor.grid.log_odds([0.5, 0.0]) < 0
    T[0, 3] = 5.0
    floor.set_pose(3, sk.geometry.SE3d(T))
    assert floor.update() == 1
    assert floor.grid.log_odds([0.5, 0.0]) == 0
    assert floor.grid.log_odds([5.5, 0.0]) < 0
    floor.set_pose(3, None)
    floor.update()
    assert floor.drawn == 0 and floor.scans == 1 and floor.bytes > 0


def test_files_and_drivable_area(tmp_path):
    cells = np.full((40, 60), 254, np.uint8)
    cells[[0, -1]] = 0
    cells[:, [0, -1]] = 0
    room = sk.floor.OccupancyImage(cells, 0.05, [-1.0, 2.0])
    sk.floor.write_grid(room, tmp_path)
    back = sk.floor.read_grid(tmp_path / "grid.yaml")
    np.testing.assert_array_equal(back.cells, cells)
    assert back.cell == 0.05 and list(back.origin) == [-1.0, 2.0]
    area = sk.floor.drivable_area(back, [0.0, 3.0], 0.2)
    assert area.found and area.centres_m2 == pytest.approx(50 * 30 * 0.0025)
    assert area.covered_m2 > area.centres_m2
    assert area.covered.shape == cells.shape
    (tmp_path / "grid.pgm").write_bytes(b"P5\n9999 9999\n255\n")
    with pytest.raises(sk.Error, match="too short"):
        sk.floor.read_grid(tmp_path / "grid.yaml")


def test_evaluation_counts_what_was_seen():
    cells = np.full((41, 41), 254, np.uint8)
    cells[[0, -1]] = cells[:, [0, -1]] = 0
    truth = sk.floor.OccupancyImage(cells, 0.05, [0, 0])
    same = sk.data.evaluate_grid(truth, truth)
    assert same.iou == same.right_wall_share == same.found_wall_share == 1 and same.visible == 39 * 39
    # From the middle to the right, up to 0.5 m: the grid knows only what was seen, and one wall too few.
    view = sk.data.FloorView(sk.floor.PlanarPose(1.0, 1.0, 0.0), right=-0.5, left=0.5)
    options = sk.data.GridEvaluationOptions(max_range=0.5)
    visible = sk.data.visible_floor(truth, [view], options)
    assert visible.shape == cells.shape and visible[20, 25] == 255 and visible[20, 15] == 0 and visible[20, 35] == 0
    grid = sk.floor.OccupancyImage(np.where(visible > 0, cells, 205).astype(np.uint8), 0.05, [0, 0])
    seen = sk.data.evaluate_grid(grid, truth, views=[view], options=options)
    assert seen.iou == 1 and seen.found == seen.visible == (visible > 0).sum()
    cells[20, 24] = 205
    cells[20, 25] = 0
    wrong = sk.data.evaluate_grid(sk.floor.OccupancyImage(cells, 0.05, [0, 0]), truth, views=[view], options=options)
    assert wrong.found == seen.visible - 2 and wrong.missed_as_wall == 1
    # The same map in a frame of its own that is moved and turned.
    turned = sk.floor.OccupancyImage(np.ascontiguousarray(np.rot90(grid.cells)), 0.05, [0, 0])
    pose = sk.floor.PlanarPose(0.0, 41 * 0.05, -np.pi / 2)
    assert sk.data.evaluate_grid(turned, truth, pose, [view], options).iou == 1
    assert "free space IoU" in str(seen) and "grid_iou" in seen.to_json()
    with pytest.raises(sk.Error):
        sk.data.evaluate_grid(grid, truth, options=sk.data.GridEvaluationOptions(max_range=-1))


def test_views_of_a_recording(recordings):
    folder = recordings / "sweephome/dev01"
    recording = sk.data.open_recording(folder)
    assert recording.rig.T_body_base is not None
    truth = sk.data.read_trajectory(folder)
    views = sk.data.floor_views(recording, truth)
    assert 500 < len(views) < 600
    assert views[0].right < 0 < views[0].left and 0.1 < views[0].near < 0.3
    room = sk.floor.read_grid(folder / "floor_occupancy.yaml")
    assert 0 < (sk.data.visible_floor(room, views) > 0).mean() < 1
