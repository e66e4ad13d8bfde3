# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
"""Motions, sensor streams and recordings that are simulated."""

import pathlib

import numpy as np
import pytest

import sweepkit as sk
from sweepkit.data import (ImuSimulationOptions, PoseSpline, SimulationOptions, WheelEpisode, WheelSimulationOptions,
                           imu_stream, plan_drive, simulate, wheel_stream)

SCENES = pathlib.Path(__file__).resolve().parents[1] / "tools/initial/scenes"
ROOM = """
name: box
rooms:
  - {name: room, rect: [0, 0, 4, 3], floor: oak, walls: wallpaper}
lights:
  - {at: [2, 1.5, 2.3], power: 4}
sensors:
  cameras: {width: 64, height: 48, left: {intrinsics: [40, 40, 31, 24]}, right: {intrinsics: [40, 40, 32, 23]}}
drive:
  start: [1, 1, 10]
  steps:
    - stand: 0.5
    - drive: [[2.2, 1.1]]
"""


def circle(seconds=12.0, rate=100):
    """A robot on a circle of 1 m radius, at even speed but for the start: rows t x y z qx qy qz qw."""
    t = np.arange(int(seconds * rate) + 1) / rate
    angle = 0.3 * (t - np.sin(np.clip(t, 0, np.pi)) * (t < np.pi))
    yaw = angle + np.pi / 2
    zero = np.zeros_like(t)
    return np.column_stack([t, np.cos(angle), np.sin(angle), zero, zero, zero, np.sin(yaw / 2), np.cos(yaw / 2)])


def test_a_motion_from_an_array_goes_through_its_rows():
    rows = circle()
    motion = PoseSpline.through(rows)
    assert motion.duration == pytest.approx(12.0)
    for i in (0, 333, 700, 1200):
        np.testing.assert_allclose(motion.pose(rows[i, 0]).translation(), rows[i, 1:4], atol=1e-6)
    state = motion.at(8.0)
    np.testing.assert_allclose(state.angular_rate, [0, 0, 0.3], atol=1e-3)
    assert np.linalg.norm(state.acceleration) == pytest.approx(0.09, abs=1e-3)


def test_an_inertial_unit_feels_the_circle():
    options = ImuSimulationOptions(rate_hz=100, position=[0, 0, 0], rotation_deg=[0, 0, 0]).ideal()
    stream = imu_stream(circle(), options, begin=5)
    assert stream["t"][0] == 5 and stream["t"][1] == 10_000_005
    late = stream["t"] > 6_000_000_000
    late[-30:] = False
    np.testing.assert_allclose(stream["gyro"][late], np.tile([0, 0, 0.3], (late.sum(), 1)), atol=2e-3)
    # The centre is to the left.
    np.testing.assert_allclose(stream["accel"][late], np.tile([0, 0.09, 9.81], (late.sum(), 1)), atol=2e-3)
    noisy = imu_stream(circle(), seed=4)
    np.testing.assert_array_equal(noisy["gyro"], imu_stream(circle(), seed=4)["gyro"])
    assert not np.array_equal(noisy["gyro"], imu_stream(circle(), seed=5)["gyro"])


def test_wheels_count_the_circle():
    options = WheelSimulationOptions(track_width=0.2, radius_error_left=0, radius_error_right=0, track_error=0).ideal()
    stream = wheel_stream(circle(), options)
    per_tick = 2 * np.pi * options.wheel_radius / options.ticks_per_revolution
    angle = 0.3 * 12.0
    assert (stream["left"][-1] - stream["left"][0]) * per_tick == pytest.approx(0.9 * angle, abs=2e-3)
    assert (stream["right"][-1] - stream["right"][0]) * per_tick == pytest.approx(1.1 * angle, abs=2e-3)
    free = WheelEpisode()
    free.kind, free.begin, free.end, free.speed_left = WheelEpisode.Kind.free, 2.0, 4.0, 1.0
    spun = wheel_stream(PoseSpline.through(circle()), options, [free])
    assert (spun["left"][200] - spun["left"][100]) * per_tick == pytest.approx(1.9, abs=0.1)


def test_wrong_arrays_are_refused():
    for rows in (circle()[:, :7], circle()[:3], "rows"):
        with pytest.raises((ValueError, TypeError)):
            imu_stream(rows)
    bent = circle()
    bent[5, 7] = np.nan
    with pytest.raises(ValueError, match="finite"):
        wheel_stream(bent)
    with pytest.raises(ValueError, match="rise"):
        imu_stream(circle()[::-1])


def test_a_recording_from_a_scene(tmp_path):
    scene = tmp_path / "box.yaml"
    scene.write_text(ROOM)
    result = simulate(scene, tmp_path / "made", duration=0.5, depth_every=2,
                      renderer={"light_rays": 8, "light_texel": 0.1}, sensors={"imu": {"rate_hz": 400}})
    assert result["frames"] == 5
    recording = sk.data.open_recording(tmp_path / "made")
    assert recording.info.images == 5
    assert len((tmp_path / "made/mav0/imu0/data.csv").read_text().splitlines()) == 202
    with pytest.raises(ValueError):
        simulate(scene, tmp_path / "other", duration=-1)
    with pytest.raises(ValueError, match="nearest|duration"):
        simulate(scene, tmp_path / "other", duratoin=1)
    with pytest.raises(sk.Error, match="no_such"):
        simulate(tmp_path / "no_such.yaml", tmp_path / "other")


@pytest.mark.parametrize("scene", sorted(SCENES.glob("*.yaml")), ids=lambda path: path.stem)
def test_shipped_scenes_can_be_driven(scene):
    base, episodes, events = plan_drive(scene)
    assert 15 < base.duration < 200
    assert any(event["kind"] == "standstill" for event in events)
    assert all(episode.end > episode.begin for episode in episodes)


def test_options_are_like_a_dataclass():
    options = SimulationOptions(seed=3, sensors={"cameras": {"width": 320}})
    assert options.sensors.cameras.width == 320 and options.sensors.cameras.height == 400
    assert options.sensors.stereo_rig().baseline == pytest.approx(0.06, abs=1e-3)
