# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
import json

import numpy as np
import pytest

import sweepkit as sk
from sweepkit.data import (EvaluationOptions, StereoImage, Trajectory, evaluate_trajectory, open_recording, read_gray,
                           read_trajectory, read_tum, write_png, write_tum)
from sweepkit.geometry import SE3d, SO3d


def circle(count=50):
    t = np.arange(count) * 100_000_000
    poses = [SE3d(SO3d.exp([0, 0, a]), [np.cos(a), np.sin(a), 0]) for a in np.linspace(0, 5, count)]
    return Trajectory(t, poses)


def test_trajectories_in_and_out(tmp_path):
    trajectory = circle()
    write_tum(tmp_path / "circle.tum", trajectory)
    again = read_tum(tmp_path / "circle.tum")
    np.testing.assert_array_equal(again.t, trajectory.t)
    np.testing.assert_allclose(again.positions, trajectory.positions, atol=1e-9)
    assert len(read_trajectory(tmp_path / "circle.tum")) == 50
    t, pose = trajectory[-1]
    assert t == trajectory.t[-1] and pose.translation().shape == (3,)
    assert trajectory.interpolate(-1) is None
    assert trajectory.interpolate(50_000_000) is not None
    with pytest.raises(ValueError, match="rise"):
        Trajectory([2, 1], [SE3d(), SE3d()])


def test_evaluation():
    truth = circle()
    moved = SE3d.exp([1, 2, 3, 0.1, 0.2, 0.3])
    estimate = Trajectory(truth.t, [moved * truth[i][1] for i in range(len(truth))])
    result = evaluate_trajectory(truth, estimate, EvaluationOptions(align="se3"))
    assert result.ape_m["rmse"] < 1e-9 and result.pairs == 50
    assert json.loads(result.to_json())["ape_rmse_m"] < 1e-9
    assert evaluate_trajectory(truth, estimate, EvaluationOptions(align="none")).ape_m["rmse"] > 1
    with pytest.raises(ValueError, match="se3"):
        EvaluationOptions(align="se4")


def test_images(tmp_path):
    image = np.random.default_rng(0).integers(0, 255, (30, 41), np.uint8)
    write_png(tmp_path / "a.png", image)
    np.testing.assert_array_equal(read_gray(tmp_path / "a.png"), image)
    with pytest.raises(sk.Error) as caught:
        read_gray(tmp_path / "b.png")
    assert caught.value.kind == "io" and "b.png" in str(caught.value)


def test_a_sample_looks_at_the_array():
    image = np.zeros((4, 6), np.uint8)
    sample = StereoImage(5, image, None)
    image[2, 3] = 9
    assert sample.left[2, 3] == 9 and sample.right is None and sample.t == 5
    left = sample.left
    del image, sample
    assert left[2, 3] == 9


def test_a_folder_without_a_recording(tmp_path):
    with pytest.raises(sk.core.IoError):
        open_recording(tmp_path)


def test_recording(recordings):
    recording = open_recording(recordings / "euroc_still")
    kinds = {}
    for sample in recording:
        kinds.setdefault(type(sample).__name__, []).append(sample)
    assert len(kinds["StereoImage"]) == recording.info.images == 48
    assert kinds["StereoImage"][0].left.shape == (480, 752)
    assert len(kinds["ImuSample"]) > 800 and recording.stereo_rig().baseline == pytest.approx(0.11, abs=0.001)
