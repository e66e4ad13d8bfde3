#!/usr/bin/python3
# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
"""Dead reckoning on recordings with wheels: each integrator, with nominal wheels and calibrated on the fly.

    SWEEPKIT_DATA=... PYTHONPATH=build/release/python tools/bench/dead_reckoning.py

Errors are root mean squares of the position [m] after the best rigid alignment in the plane. Wheels are calibrated while
driving, each motion integrated with what was known before it; vision is stood in for by true motions over half a second,
with errors of 2 mm and 0.1 degrees added. On sweephome slip that is noticed is then not believed. `ratio` is the closed form's error over the best one's. Ends with exit code 1
if a bound is missed: the closed form within 0.5 % of the best on real wheels, on arcs strictly the best; on sweephome calibration helps,
radii end within 0.3 % and the track within 1 % of truth. 77 without recordings.

Wifibot's speeds and turn rates do not have one clock: in runs 2 and 3 alike the heading fits best if the turn rates are taken
50 ms later than they say. Euler's heading, half a step old, happens to make up for a part of that; so these runs are shown as
logged, and with that offset taken out, which is what the bound looks at.
"""

import os
import pathlib
import re
import sys

import numpy as np
import yaml
from sweepkit import motion
from sweepkit.geometry import SE3d

INTEGRATORS = ("euler", "midpoint", "closed_form")
NS = 10**9


def table(file):
    return np.genfromtxt(file, delimiter=",")


def stamps_of(seconds):
    return np.round(seconds * 1e9).astype(np.int64)


def align(estimate, truth):
    """Errors of the points after the best rigid motion of the plane."""
    a, b = estimate - estimate.mean(0), truth - truth.mean(0)
    c = (a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1]).sum()
    s = (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum()
    angle = np.arctan2(s, c)
    R = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return a @ R.T - b


def rms(estimate, truth):
    return np.sqrt((align(estimate, truth) ** 2).sum(1).mean())


def planar_poses(x, y, yaw):
    zero = np.zeros_like(x)
    return np.stack([x, y, zero, zero, zero, np.sin(yaw / 2), np.cos(yaw / 2)], 1)


def seen(poses, at, seed=1, metres=0.002, degrees=0.1):
    """Poses whose motions from one to the next have errors of that size: what vision would give."""
    random = np.random.default_rng(seed)
    mats = [SE3d.exp(np.zeros(6))]
    for a, b in zip(poses[:-1], poses[1:]):
        step = pose(a).inverse() * pose(b)
        noise = np.concatenate([random.normal(0, metres, 3), random.normal(0, np.radians(degrees), 3)])
        mats.append(mats[-1] * step * SE3d.exp(noise))
    return np.array([np.concatenate([T.translation(), T.rotation().log()]) for T in mats]), mats


def pose(row):
    from sweepkit.geometry import SO3d
    return SE3d(SO3d.from_quaternion(row[3:]), row[:3])


def rows(motions):
    return np.array([np.concatenate([T.translation(), T.rotation().quaternion()]) for T in motions])


def speeds(name, folder, file, v, w, x, y, yaw, held=False, turn_lag=0.0):
    """A log of speed and turn rate, carried as two wheels 1 m apart."""
    data = table(folder / file)
    t = data[:, 0]
    if turn_lag:
        heading = np.concatenate([[0], np.cumsum(data[1:, w] * np.diff(t))])
        data[1:, w] = np.diff(np.interp(t - turn_lag, t, heading)) / np.diff(t)
    wheels = np.stack([data[:, v] - data[:, w] / 2, data[:, v] + data[:, w] / 2], 1)
    if held:  # a command holds until the next
        t, wheels = t[1:], wheels[:-1]
    truth = data if x is not None else table(folder / "groundtruth.csv")
    columns = (x, y, yaw) if x is not None else (1, 2, 3)
    return dict(name=name, geometry=motion.WheelGeometry(1, 1 / (2 * np.pi), 1.0), reading="speeds", wheel_t=stamps_of(t),
                wheels=wheels, truth_t=stamps_of(truth[:, 0]),
                truth=planar_poses(*(truth[:, columns[0]], truth[:, columns[1]], np.unwrap(truth[:, columns[2]]))),
                options=dict(difference_sigma=0.0, scale_sigma=0.05, track_sigma=0.2, wheel_noise=0.01))


def real_recordings(data):
    for run in ("2", "3", "4"):
        columns = (1, 3, 4, 5, 6)
        yield dict(speeds(f"wifibot {run} as logged", data / "wifibot", f"wifibot{run}.csv", *columns), as_logged=True)
        yield speeds(f"wifibot {run}", data / "wifibot", f"wifibot{run}.csv", *columns, turn_lag=0.05)
    wheels, truth = (table(data / "tuc_labyrinth" / f) for f in ("wheels.csv", "groundtruth.csv"))
    yield dict(name="TUC labyrinth", geometry=motion.WheelGeometry(1, 1 / (2 * np.pi), 0.157), reading="speeds",
               wheel_t=stamps_of(wheels[:, 0]), wheels=wheels[:, 1:3], truth_t=stamps_of(truth[:, 0]),
               truth=planar_poses(truth[:, 1], truth[:, 2], np.zeros(len(truth))), heading=False)
    for run in ("20", "21"):
        folder = data / "ucsd_encoders_imu" / run
        ticks, imu = table(folder / "encoders.csv"), table(folder / "imu.csv")
        reading = np.cumsum(np.stack([ticks[:, [2, 4]].mean(1), ticks[:, [1, 3]].mean(1)], 1), 0)
        one = dict(name=f"UCSD {run}", geometry=motion.WheelGeometry(1, 0.0022 / (2 * np.pi), 0.8), reading="ticks",
                   wheel_t=stamps_of(ticks[:, 0]), wheels=reading, imu_t=stamps_of(imu[:, 0]), gyro=imu[:, 1:4], rest=9.0,
                   heading=False)
        if (folder / "lidar_slam_reference.csv").exists():
            truth = table(folder / "lidar_slam_reference.csv")
            one.update(truth_t=stamps_of(truth[:, 0]), truth=planar_poses(truth[:, 1], truth[:, 2], truth[:, 3]))
        yield one
    yield speeds("MRCLAM 7, robot 1", data / "mrclam/d7_robot1", "odometry.csv", 1, 2, None, None, None, held=True)


def sensor(file):
    text = file.read_text()
    return np.array(re.search(r"data: \[([^\]]*)\]", text).group(1).replace("\n", " ").split(","), float).reshape(4, 4)


def sweephome(data):
    for folder in sorted((data / "sweephome").glob("dev*")):
        truth_file = yaml.safe_load((folder / "truth.yaml").read_text())
        imu, odom, truth = (table(folder / "mav0" / f / "data.csv")
                            for f in ("imu0", "odom0", "state_groundtruth_estimate0"))
        start = truth_file["start_time_ns"]
        relative = lambda rows: np.round(rows[:, 0] - start).astype(np.int64) // 1000 * 1000
        w = truth_file["wheels"]
        until = len(truth)
        for event in truth_file["events"]:
            if event["kind"] == "lifted":
                until = min(until, int(event["t_start"] * 200))
        yield dict(name=f"sweephome {folder.name}" + (" until lifted" if until < len(truth) else ""),
                   geometry=motion.WheelGeometry(w["ticks_per_revolution"], w["nominal_radius_m"], w["nominal_track_width_m"]),
                   reading="ticks", wheel_t=relative(odom), wheels=odom[:, 1:3], imu_t=relative(imu), gyro=imu[:, 1:4],
                   rest=1.9, T_body_base=SE3d(sensor(folder / "mav0/odom0/sensor.yaml")), truth_t=relative(truth)[:until],
                   truth=truth[:until][:, [1, 2, 3, 5, 6, 7, 4]],
                   true_wheels=[w["true_radius_left_m"] / w["nominal_radius_m"], w["true_radius_right_m"] / w["nominal_radius_m"],
                                w["true_track_width_m"]])


def reckon(r, at, integrator, gyro, parameters=None, distrusted=None):
    """Positions in the plane at the given times."""
    imu = {}
    if gyro:
        rest = r["imu_t"] < r["imu_t"][0] + r["rest"] * NS
        imu = dict(imu_t=r["imu_t"], gyro=r["gyro"], gyro_bias=r["gyro"][rest].mean(0)[None])
    result = motion.odometry(at, r["wheel_t"], r["wheels"], r["geometry"], r["reading"], parameters=parameters,
                             T_body_base=r.get("T_body_base", SE3d()), integrator=integrator, distrusted=distrusted,
                             options=motion.OdometryOptions(decoder={"max_gap": 1.0}), **imu)
    base = r.get("T_body_base", SE3d())
    # Of the base: in the plane that it starts on.
    return np.array([(base.inverse() * pose(p) * base).translation()[:2] for p in result["poses"]])


def base_truth(r, k):
    """True positions of the base in the plane of the world."""
    base = r.get("T_body_base", SE3d())
    return np.array([(pose(p) * base).translation()[:2] for p in r["truth"][k]])


def compare(r):
    """A row for wheels, and one for wheels and gyro: errors of the integrators, and calibrated."""
    if "truth" not in r:
        return [(r["name"] + ", no truth", None)]
    inside = (r["truth_t"] >= r["wheel_t"][0]) & (r["truth_t"] <= r["wheel_t"][-1])
    index = np.flatnonzero(inside)
    every = max(1, int(round(0.5e9 / np.median(np.diff(r["truth_t"])))))
    k = index[::every]
    at = r["truth_t"][k]
    truth = base_truth(r, k)
    rows_out = []
    for gyro in (False, True) if "gyro" in r else (False,):
        errors = [rms(reckon(r, at, i, gyro), truth) for i in INTEGRATORS]
        calibrated = end = None
        if r.get("heading", True):
            _, motions = seen(r["truth"][k], at)
            imu = {}
            if gyro:
                rest = r["imu_t"] < r["imu_t"][0] + r["rest"] * NS
                imu = dict(imu_t=r["imu_t"], gyro=r["gyro"], gyro_bias=r["gyro"][rest].mean(0)[None])
            options = motion.WheelCalibrationOptions(decoder={"max_gap": 1.0}, **r.get("options", {}))
            done = motion.calibrate_wheels(r["wheel_t"], r["wheels"], r["geometry"], at, rows(motions), 0.002, np.radians(0.1),
                                           T_body_base=r.get("T_body_base", SE3d()), reading=r["reading"], options=options, **imu)
            p = done["parameters"]
            known = np.vstack([[1, 1, r["geometry"].track_width], p[:, :3]])
            spans = None
            if "T_body_base" in r:
                bias = imu["gyro_bias"][0] if gyro else np.zeros(3)
                found = motion.detect_slip(r["wheel_t"], r["wheels"], r["geometry"], at, rows(motions), 0.002, np.radians(0.1),
                                           imu.get("imu_t"), imu.get("gyro"), bias, T_body_base=r["T_body_base"])
                spans = np.array([[e["begin"], e["end"]] for e in found], np.int64).reshape(-1, 2)
            calibrated = rms(reckon(r, at, "closed_form", gyro, known, spans), truth)
            end = p[-1, :3]
        rows_out.append((r["name"] + (", wheels + gyro" if gyro else ", wheels"), dict(
            as_logged=r.get("as_logged"), length=np.linalg.norm(np.diff(truth, axis=0), axis=1).sum(), errors=errors, calibrated=calibrated, end=end,
            true_wheels=r.get("true_wheels"))))
    return rows_out


def arcs():
    """Random arcs, each of constant twist over half a second: errors of the integrators."""
    random = np.random.default_rng(4)
    n = 60
    rates = np.zeros((n, 6))
    rates[:, 0] = random.uniform(0.1, 0.35, n)
    rates[:, 5] = random.normal(0, 1.0, n)
    rates[:, 4] = random.normal(0, 0.02, n)
    fine = motion.integrate_path(np.linspace(0, 30, 1000 * n + 1), np.repeat(rates, 1000, 0), "midpoint")[::1000]
    return [rms(motion.integrate_path(np.linspace(0, 30, n + 1), rates, i)[:, :2], fine[:, :2]) for i in INTEGRATORS]


def main():
    folder = os.environ.get("SWEEPKIT_DATA")
    if not folder:
        print("SWEEPKIT_DATA is unset")
        return 77
    misses = []
    print(f"{'recording':38s} {'path m':>7s} {'Euler':>9s} {'midpoint':>9s} {'closed':>9s} {'ratio':>7s} {'calibrated':>10s}  wheels at the end")
    data = pathlib.Path(folder)
    for r in [*real_recordings(data), *sweephome(data)]:
        for name, row in compare(r):
            if row is None:
                print(f"{name:38s}")
                continue
            ratio = row["errors"][2] / min(row["errors"])
            line = f"{name:38s} {row['length']:7.2f} " + " ".join(f"{e:9.5f}" for e in row["errors"]) + f" {ratio:7.4f} "
            line += f"{row['calibrated']:10.5f}" if row["calibrated"] is not None else f"{'':10s}"
            if row["end"] is not None:
                line += "  " + " ".join(f"{x:.4f}" for x in row["end"])
            if row["true_wheels"]:
                off = 100 * (row["end"] / row["true_wheels"] - 1)
                line += "  off by " + " ".join(f"{x:+.2f}" for x in off) + " %"
                if "gyro" in name and not (abs(off[0]) <= 0.3 and abs(off[1]) <= 0.3 and abs(off[2]) <= 1):
                    misses.append(f"{name}: wheels off by {off} %")
                if row["calibrated"] >= row["errors"][2]:
                    misses.append(f"{name}: calibration does not help")
            print(line)
            if ratio > 1.005 and not row["true_wheels"] and not row["as_logged"]:
                misses.append(f"{name}: the closed form is {100 * (ratio - 1):.2f} % worse than the best")
    errors = arcs()
    print(f"{'arcs of half a second':38s} {'':7s} " + " ".join(f"{e:9.2e}" for e in errors))
    if not errors[2] < min(errors[:2]):
        misses.append("arcs: the closed form is not the best")
    for miss in misses:
        print("MISSED", miss)
    return 1 if misses else 0


if __name__ == "__main__":
    sys.exit(main())
