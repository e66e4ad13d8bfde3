# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
import time

import numpy as np
import pytest
from sweepkit.geometry import SE3d, SO3d
from sweepkit.motion import (GyroBiasOptions, ImuNoise, OdometryOptions, SlipOptions, WheelCalibrationOptions, WheelGeometry,
                             WheelParameters, calibrate_wheels, detect_slip, detect_standstill, follow_gyro_bias,
                             integrate_covariance, integrate_path, interpolate, odometry, preintegrate, solve_gyro_bias,
                             standstill_bias, wheel_steps)

NS = 10**9
GEOMETRY = WheelGeometry(1560, 0.035, 0.235)


def drive(seconds=60.0, scale_left=1.01, scale_right=0.985, track=0.2325, slip=None):
    """A planar drive: stamps and readings of gyro (200 Hz) and wheels (50 Hz), poses at the gyro's stamps."""
    n = int(seconds * 200)
    t = np.arange(n + 1) / 200
    v = 0.3 * np.clip(np.sin(0.4 * t) + 0.3, 0, 1)
    w = 0.6 * np.sin(0.7 * t) * (t > 1)
    v[t < 1.5] = 0
    w[t < 1.5] = 0
    rates = np.zeros((n, 6))
    rates[:, 0] = (v[1:] + v[:-1]) / 2
    rates[:, 5] = (w[1:] + w[:-1]) / 2
    poses = integrate_path(t, rates)
    extra = np.zeros(n) if slip is None else np.where((t[1:] > slip[0]) & (t[1:] < slip[1]), 0.3, 0.0)
    step = GEOMETRY.metres_per_tick()
    left = np.concatenate([[0], np.cumsum((rates[:, 0] + extra - track / 2 * rates[:, 5]) / 200)]) / (scale_left * step)
    right = np.concatenate([[0], np.cumsum((rates[:, 0] + extra + track / 2 * rates[:, 5]) / 200)]) / (scale_right * step)
    gyro = np.zeros((n + 1, 3))
    gyro[:, 2] = w
    stamps = (np.arange(n + 1) * 5_000_000).astype(np.int64)
    return stamps, gyro, poses, stamps[::4], np.floor(np.stack([left, right], 1)[::4])


def test_paths_of_constant_twist():
    rates = np.tile([0.3, 0, 0, 0, 0, 1.0], (4, 1))
    times = np.linspace(0, 2 * np.pi, 5)
    closed = integrate_path(times, rates)
    assert closed.shape == (5, 7)
    assert np.allclose(closed[-1, :3], 0, atol=1e-14)
    assert np.allclose(closed[2, :3], [0, 0.6, 0], atol=1e-14)
    assert np.allclose(integrate_path(times, rates, "euler")[1, :3], [0.3 * np.pi / 2, 0, 0])
    from_there = integrate_path(times, rates, start=SE3d(SO3d(), np.array([1.0, 2.0, 3.0])))
    assert np.allclose(from_there[:, :3], closed[:, :3] + [1, 2, 3])
    with pytest.raises(ValueError, match="integrator"):
        integrate_path(times, rates, "heun")
    with pytest.raises(ValueError, match="rates"):
        integrate_path(times[:-1], rates)
    with pytest.raises(ValueError, match="shape"):
        integrate_path(times, rates[:, :5])
    with pytest.raises(ValueError, match="decrease"):
        integrate_path(times[::-1].copy(), rates)


def test_covariances_grow():
    steps = np.tile([0.01, 0, 0, 0, 0, 0.02], (100, 1))
    noise = np.tile(np.diag([1e-6, 1e-7, 1e-7, 1e-8, 1e-8, 1e-6]), (100, 1, 1))
    P = integrate_covariance(steps, noise)
    assert P.shape == (100, 6, 6)
    assert np.allclose(P, P.transpose(0, 2, 1))
    assert np.all(np.diff(P[:, 5, 5]) > 0)
    with pytest.raises(ValueError, match="noise"):
        integrate_covariance(steps, noise[:-1])


def test_a_million_samples_a_call():
    n = 1_000_000
    random = np.random.default_rng(1)
    t = (np.arange(n) * 5_000_000).astype(np.int64)
    gyro = random.normal(0, 0.1, (n, 3))
    accel = random.normal(0, 1, (n, 3)) + [0, 0, 9.81]
    begin = t[:-200:100]
    start = time.perf_counter()
    deltas = preintegrate(t, gyro, accel, begin, begin + NS // 2)
    assert len(deltas["v"]) == len(begin) and np.isfinite(deltas["covariance"]).all()
    rates = np.concatenate([accel, gyro], 1)[1:]
    assert integrate_path(t * 1e-9, rates).shape == (n, 7)
    assert interpolate(t, gyro, t + 1).shape == (n, 3)
    standing = detect_standstill(t, gyro, accel)
    assert standing.shape == (n,) and not standing.any()
    assert time.perf_counter() - start < 60


def test_preintegration_by_hand():
    t = (np.arange(101) * 5_000_000).astype(np.int64)
    gyro = np.tile([0, 0, np.pi / 100], (101, 1))
    accel = np.tile([0.1, 0, 0], (101, 1))
    a, w, dt = 0.1, np.pi / 100, 0.5
    for rule in ("midpoint", "closed_form", "cubic"):
        d = preintegrate(t, gyro, accel, t[:1], t[-1:], rule=rule)
        assert np.allclose(d["v"][0], [a / w * np.sin(w * dt), a / w * (1 - np.cos(w * dt)), 0], atol=1e-9)
        assert np.allclose(d["R"][0], [0, 0, np.sin(w * dt / 2), np.cos(w * dt / 2)])
        assert d["uncovered_saturated"][0, 0] == 0
    with pytest.raises(ValueError, match="rule"):
        preintegrate(t, gyro, accel, t[:1], t[-1:], rule="best")
    with pytest.raises(ValueError, match="end"):
        preintegrate(t, gyro, accel, t[:1], t[:1])
    with pytest.raises(ValueError, match="gyro"):
        preintegrate(t, gyro[:-1], accel, t[:1], t[-1:])


def test_interpolation_with_offset_and_holes():
    t = np.array([0, 100, 200, 900], np.int64) * 1_000_000
    values = np.stack([t * 1e-9] * 3, 1)
    at = np.array([60, 155, 550, 2000], np.int64) * 1_000_000
    result = interpolate(t, values, at, offset=5_000_000, max_gap=0.5)
    assert np.allclose(result[:2, 0], [0.055, 0.150])
    assert np.isnan(result[2:]).all()


def test_wheels_wrap_and_reset():
    t = (np.arange(5) * 20_000_000).astype(np.int64)
    steps = wheel_steps(t, [[65500, 1000], [65530, 1030], [24, 1060], [54, 3], [84, 33]], GEOMETRY)
    assert steps["wraps"] == 1 and steps["resets"] == 1
    assert steps["measured"].tolist() == [True, True, False, True]
    assert np.allclose(steps["rolled"][[0, 1, 3]], 30 * GEOMETRY.metres_per_tick())
    with pytest.raises(ValueError, match="reading"):
        wheel_steps(t, np.zeros((5, 2)), GEOMETRY, "angles")


def test_odometry_calibration_and_slip():
    imu_t, gyro, poses, wheel_t, ticks = drive(slip=(40.0, 42.0))
    at = imu_t[::100]
    truth = poses[::100]
    vision = dict(vision_t=at, poses=truth, sigma_m=0.001, sigma_rad=0.001)
    calibrated = calibrate_wheels(wheel_t, ticks, GEOMETRY, imu_t=imu_t, gyro=gyro, **vision)
    assert np.allclose(calibrated["parameters"][-1, :3], [1.01, 0.985, 0.2325], rtol=0.003)
    assert calibrated["observed"][-1].tolist() == [True, True, True, False]
    assert calibrated["rejected"] >= 3
    moved = calibrate_wheels(wheel_t - 40_000_000, ticks, GEOMETRY, imu_t=imu_t, gyro=gyro,
                             options=WheelCalibrationOptions(offset_sigma=0.03, gate=8), **vision)
    assert abs(moved["parameters"][-1, 3] - 0.04) < 0.004

    p = calibrated["parameters"][-1]
    episodes = detect_slip(wheel_t, ticks, GEOMETRY, imu_t=imu_t, gyro=gyro, parameters=WheelParameters(*p[:3]), **vision)
    assert len(episodes) == 1 and episodes[0]["kind"] in ("slip", "free_spin")
    assert abs(episodes[0]["begin"] * 1e-9 - 40) < 0.6 and abs(episodes[0]["end"] * 1e-9 - 42) < 0.6
    assert not detect_slip(wheel_t, ticks, GEOMETRY, imu_t=imu_t, gyro=gyro, options=SlipOptions(enter=1e6))

    before = imu_t[:7901:100]  # up to the slip
    for integrator in ("euler", "midpoint", "closed_form"):
        plain = odometry(before, wheel_t, ticks, GEOMETRY, imu_t=imu_t, gyro=gyro, integrator=integrator)
        better = odometry(before, wheel_t, ticks, GEOMETRY, imu_t=imu_t, gyro=gyro, integrator=integrator, parameters=p[None, :3])
        error = [np.linalg.norm(o["poses"][:, :2] - poses[:7901:100, :2], axis=1).max() for o in (plain, better)]
        assert error[1] < 0.5 * error[0] and error[1] < 0.02
    assert better["covariance"].shape == (len(before) - 1, 6, 6)
    assert better["without_gyro_wheels"].sum() < 0.05
    blind = odometry(before, options=OdometryOptions(unknown_speed=0.1))
    assert np.allclose(blind["poses"][:, :3], 0)


def test_standstill_is_told():
    imu_t, gyro, poses, wheel_t, ticks = drive(20.0)
    random = np.random.default_rng(2)
    noise = ImuNoise(2e-4, 2e-5, 2e-3, 3e-3)
    gyro = gyro + random.normal(0, 2e-4 * np.sqrt(200), gyro.shape)
    accel = random.normal(0, 2e-3 * np.sqrt(200), gyro.shape) + [0, 0, 9.81]
    standing = detect_standstill(imu_t, gyro, accel, wheel_t, ticks, GEOMETRY, noise=noise)
    assert standing[80:290].all() and not standing[320:1000].any()
    by_wheels = detect_standstill(wheel_t=wheel_t, wheels=ticks, geometry=GEOMETRY)
    assert by_wheels[20:70].all() and not by_wheels[90:250].any()


def test_gyro_bias_from_vision_and_at_rest():
    imu_t, gyro, poses, _, _ = drive(30.0)
    bias = np.array([0.004, -0.02, 0.075])
    noise = ImuNoise(2e-4, 2e-5)
    biased = gyro + bias + np.random.default_rng(3).normal(0, 2e-4 * np.sqrt(200), gyro.shape)
    found, covariance = solve_gyro_bias(imu_t, biased, imu_t[::100], poses[::100, 3:], noise=noise)
    assert np.allclose(found, bias, atol=3e-4) and covariance.shape == (3, 3)
    assert solve_gyro_bias(imu_t, biased, imu_t[:1], poses[:1, 3:]) is None
    followed = follow_gyro_bias(imu_t, biased, imu_t[::50], poses[::50, 3:], noise=noise,
                                options=GyroBiasOptions(time_constant=2.0))
    assert np.isnan(followed["target"][0]).all()
    assert np.allclose(followed["bias"][-60:], bias, atol=5e-4)
    standing = np.arange(len(imu_t)) < 200
    rested = follow_gyro_bias(imu_t, biased, imu_t[::50], poses[::50, 3:], standing.astype(int), noise=noise,
                              options=GyroBiasOptions(use_vision=False))
    assert np.allclose(rested["bias"][-1], bias, atol=1e-3)
    mean, sigma = standstill_bias(imu_t[:200], biased[:200], noise)
    assert np.allclose(mean, bias, atol=1e-3) and np.allclose(sigma, 2e-4, rtol=0.05)


def read_inertial(folder):
    imu = np.genfromtxt(folder / "mav0/imu0/data.csv", delimiter=",", dtype=None, encoding=None)
    truth = np.genfromtxt(folder / "mav0/state_groundtruth_estimate0/data.csv", delimiter=",", dtype=None, encoding=None)
    table = lambda rows, a, b: np.array([[row[i] for i in range(a, b)] for row in rows.tolist()], float)
    stamps = lambda rows: np.array([row[0] for row in rows.tolist()], np.int64)
    return stamps(imu), table(imu, 1, 4), stamps(truth), table(truth, 4, 8)[:, [1, 2, 3, 0]], table(truth, 11, 14)


@pytest.mark.parametrize("flight", ["V1_01_easy", "V1_02_medium"])
def test_gyro_bias_of_real_flights(recordings, flight):
    """Against true attitudes: a window of 10 s within 0.04 degrees/s, the mean after filtering within 0.006."""
    imu_t, gyro, truth_t, attitudes, bias = read_inertial(recordings / "euroc_inertial" / flight)
    every = int(round(0.25e9 / np.median(np.diff(truth_t))))
    followed = follow_gyro_bias(imu_t, gyro, truth_t[::every], attitudes[::every], noise=ImuNoise(1.7e-4, 2e-5))
    full = (truth_t[::every] - truth_t[0]) >= 10 * NS
    error = np.degrees(followed["target"] - bias[::every])[full]
    assert (np.median(np.abs(error), axis=0) < 0.04).all()
    known = np.isfinite(followed["target"][:, 0])
    assert np.linalg.norm(np.degrees(followed["bias"] - bias[::every])[known].mean(0)) < 0.006
