# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from sweepkit.direction import (MainDirectionEstimator, MainDirectionOptions, ManhattanEstimator, first_main_direction,
                                frame_direction_dtype, vanishing_points, window_directions)
from sweepkit.direction_study import study, wrap_quarter_turn
from sweepkit.geometry import Camera, StereoRig

LEVEL = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])  # camera axes in a world with z up, looking along x


def camera():
    return Camera([400, 400, 320, 200], "none", [], 640, 400)


def turn(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def segments(directions, count, seed=1):
    """Views of edges along the columns of `directions`, camera frame: float32 of shape (n, 4)."""
    random = np.random.default_rng(seed)
    rows = []
    while len(rows) < count:
        half = directions[:, len(rows) % directions.shape[1]] * random.uniform(0.1, 0.8)
        middle = random.uniform([-3, -2, 1], [3, 2, 6])
        ends = np.stack([middle - half, middle + half])
        if ends[:, 2].min() < 0.5:
            continue
        pixels = ends[:, :2] / ends[:, 2:] * 400 + [320, 200]
        if (pixels < 0).any() or (pixels > [639, 399]).any() or np.linalg.norm(pixels[1] - pixels[0]) < 18:
            continue
        rows.append((pixels + random.normal(0, 0.3, (2, 2))).ravel())
    return np.asarray(rows, np.float32)


def frames(count, angle=0.2, wrong=0):
    rows = np.zeros(count, frame_direction_dtype)
    rows["t"] = np.arange(count) * 100_000_000
    for side in ("left", "right"):
        rows[side + "_angle"] = angle
        rows[side + "_sigma"] = 0.003
        rows[side + "_confidence"] = 0.99
        rows[side + "_found"] = 1
    if wrong:
        rows["left_angle"][:wrong] = rows["right_angle"][:wrong] = np.random.default_rng(1).uniform(-0.7, 0.7, wrong)
    return rows


def test_manhattan_frame_is_found():
    R = LEVEL.T @ turn(0.3)  # columns: the room's axes in the camera
    rows = segments(R, 60)
    estimator = ManhattanEstimator()
    for up in (None, R[:, 2]):
        frame = estimator.estimate(camera(), rows, up)
        cosines = np.abs(frame.R_camera_manhattan.T @ R).max(0)
        assert np.degrees(np.arccos(np.clip(cosines, -1, 1))).max() < 0.7
        assert 0.9 < frame.confidence <= 1 and frame.segments > 20
        assert frame.covariance.shape == (3, 3)
        assert estimator.labels.shape == (60,) and (estimator.labels >= 0).mean() > 0.9
    assert estimator.estimate(camera(), rows[:1]) is None
    with pytest.raises(ValueError, match="float32"):
        estimator.estimate(camera(), rows[:, :3])
    with pytest.raises(ValueError):
        estimator.estimate(camera(), rows, [0, 0, 0])


def test_vanishing_points_of_three_directions():
    R = LEVEL.T @ turn(0.4)
    directions, support, labels = vanishing_points(camera(), segments(R, 90))
    assert directions.shape[1] == 3 and len(directions) == len(support) >= 3 and labels.shape == (90,)
    assert (np.abs(directions[:3] @ R).max(1) > np.cos(np.radians(1.5))).all()
    directions, support, labels = vanishing_points(camera(), np.zeros((0, 4), np.float32))
    assert directions.shape == (0, 3) and len(labels) == 0


def test_a_window_of_stereo_frames_gives_the_direction(stereo_rig):
    estimator = MainDirectionEstimator(stereo_rig, MainDirectionOptions(window=5))
    answer = None
    for k in range(5):
        R_world_camera = turn(0.1 * k) @ LEVEL
        rows = segments(R_world_camera.T @ turn(0.25), 60, seed=k)
        assert answer is None
        answer = estimator.add(k * 100_000_000, rows, rows, R_world_camera)
    assert abs(np.degrees(answer.angle - 0.25)) < 0.5 and answer.confidence == 1
    assert answer.frames == 5 and answer.window_end == 400_000_000


@pytest.fixture
def stereo_rig():
    T_right = np.eye(4)
    T_right[0, 3] = 0.06
    return StereoRig(camera(), camera(), np.eye(4), T_right)


def test_cached_frames_are_replayed():
    options = MainDirectionOptions(window=10)
    answer = first_main_direction(frames(40, wrong=10), options)
    assert answer.window_begin == 1_000_000_000 and answer.angle == pytest.approx(0.2)
    assert first_main_direction(frames(9), options) is None
    assert first_main_direction(frames(40), options, start=7).run_begin == 700_000_000
    assert len(window_directions(frames(40), options)) == 4
    with pytest.raises((ValueError, TypeError)):
        first_main_direction(np.zeros((3, 3)), options)


def test_study_of_threshold_and_window():
    rows = study([frames(60), frames(60, wrong=60)], [lambda t: 0.2, None], thresholds=(0.0, 0.5, 1.0), windows=(10, 20),
                 starts=30)
    assert len(rows) == 6
    by = {(r["threshold"], r["window"]): r for r in rows}
    assert by[0.0, 10]["answered"] >= by[0.5, 10]["answered"]
    assert by[0.5, 20]["right"] == 1 and by[0.5, 20]["error_deg"] < 1e-6
    assert wrap_quarter_turn(np.pi / 2) == pytest.approx(0)
