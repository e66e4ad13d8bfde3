# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
import json

import numpy as np
import pytest

import sweepkit as sk
from sweepkit.data import StereoImage, evaluate_trajectory, open_recording, read_trajectory
from sweepkit.system import Frame, RunOptions, Sweeper, SweeperOptions


def test_options_reach_every_stage():
    options = SweeperOptions(frontend={"orb": {"count": 500}})
    assert options.frontend.orb.count == 500
    with pytest.raises(sk.core.OptionError, match="nearest"):
        RunOptions(datapath="x")


def test_run_needs_a_recording(tmp_path):
    with pytest.raises(sk.core.IoError):
        sk.run(tmp_path / "none", tmp_path / "out")


def test_run_writes_results(recordings, tmp_path):
    seen = []
    result = sk.run(recordings / "euroc_still", tmp_path / "out", progress=lambda i, n, lost: seen.append((i, n)),
                    recording={"duration": 2.0})
    assert result.initialised and result.counts.images_lost == 0 and seen[-1][0] == result.counts.images
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["frames"] == result.counts.images
    live = read_trajectory(tmp_path / "out" / "trajectory_live.tum")
    assert len(live) == result.counts.images
    truth = read_trajectory(recordings / "euroc_still")
    assert evaluate_trajectory(truth, live).ape_m["rmse"] < 0.01


def test_what_progress_raises_ends_the_run(recordings, tmp_path):
    def progress(images, total, lost):
        if images == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        sk.run(recordings / "euroc_still", tmp_path / "out", progress=progress)
    assert (tmp_path / "out" / "summary.json").exists(), "results so far are written"


def test_sweeper_fed_live(recordings):
    recording = open_recording(recordings / "euroc_still")
    robot = Sweeper(recording.stereo_rig(), SweeperOptions(realtime=False))
    assert robot.pose_at(0) is None
    last = None
    for sample in recording:
        robot.feed(sample)
        if isinstance(sample, StereoImage):
            last = sample.t
            if robot.counts().images == 10:
                break
    pose = robot.pose_at(last, Frame.map)
    assert pose.covariance.shape == (6, 6) and np.linalg.norm(pose.T_frame_body.translation()) < 0.05
    robot.feed(StereoImage(last - 1, np.zeros((480, 752), np.uint8), np.zeros((480, 752), np.uint8)))
    robot.finish()
    assert robot.counts().samples_dropped == 1
    assert "started" in [event["event"] for event in robot.take_events()] and robot.take_events() == []
    assert len(robot.images(5)) == 5


def test_sweeper_tells_what_lies_on_the_floor(recordings):
    recording = open_recording(recordings / "sweephome/dev01")
    assert recording.rig.has_stereo and recording.rig.has_imu and recording.rig.has_wheels
    options = SweeperOptions(realtime=False)
    assert Sweeper(recording.rig, options).grid() is None
    options.floor.enabled = True
    robot = Sweeper(recording.rig, options)
    images = 0
    for sample in recording:
        robot.feed(sample)
        images += isinstance(sample, StereoImage)
        if images == 40:
            break
    robot.finish()
    report, grid = robot.obstacles(), robot.grid()
    assert report.t > 0 and report.T_odom_floor.rotation().matrix()[2, 2] > 0.99
    assert report.plane.plane.down_camera[1] > 0.9, "the floor is below the camera"
    assert np.any(grid.cells == 254), "some of the floor is free"
