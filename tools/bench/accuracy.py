#!/usr/bin/python3
# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
"""Runs sweeper_robot on recordings and prints how well it did, against bounds.

    accuracy.py [--bin DIR] [--out DIR] [PART...]

Parts: stereo (one run for each recording by cameras alone, in line), motion (the same with IMU and wheels, and what
is known of motion at the end), gyro (a standing recording's rotation and its truth's, both against
the gyro), pairs (motion between two images alone), repeat (two runs, the same files), realtime (in line and at sensor
time on one core, side by side). All of them without any. The recordings lie
below the folder that SWEEPKIT_DATA names.
"""

import argparse
import json
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile

import numpy as np

ROOT = pathlib.Path(__file__).resolve().parents[2]

# name, folder, further arguments, bounds on figures of the table
RUNS = [
    ("KITTI 06, 51 frames", "kitti/06_first51", [], {"lost": 0, "live_mm": 50, "end_percent": 0.7}),
    ("EuRoC V1_01, still", "euroc_still", [], {"lost": 0, "live_mm": 0.7, "turn_deg": 0.1}),
    ("sweephome dev01", "sweephome/dev01", [], {"lost_percent": 3, "live_mm": 50, "memory_mb": 120}),
    ("sweephome dev02 to 18 s", "sweephome/dev02", ["--duration", "18"], {"live_mm": 15}),
    ("sweephome dev03 to 12 s", "sweephome/dev03", ["--duration", "12"], {"live_mm": 15}),
]
CAMERAS_ALONE = ["--set", "recording.use_imu=false", "--set", "recording.use_wheels=false"]
MOTION_RUNS = [
    ("sweephome dev01", "sweephome/dev01", [], {"live_mm": 8}),
    ("sweephome dev02", "sweephome/dev02", [], {"live_mm": 18}),
    ("sweephome dev03 to 39 s", "sweephome/dev03", ["--duration", "39"], {"live_mm": 7}),
    ("sweephome dev03", "sweephome/dev03", [], {"live_mm": 20}),
    ("EuRoC V1_01, still", "euroc_still", [], {"live_mm": 0.7}),
]
COLUMNS = [  # key, head, format
    ("frames", "frames", "{:.0f}"), ("lost", "lost", "{:.0f}"), ("lost_percent", "lost %", "{:.1f}"),
    ("dropped", "dropped", "{:.0f}"),
    ("live_mm", "live mm", "{:.2f}"), ("optimized_mm", "opt. mm", "{:.2f}"),
    ("turn_deg", "rot. fit", "{:.3f}"), ("turn_first_deg", "rot. first", "{:.3f}"),
    ("median_percent", "tr.med.%", "{:.3f}"), ("end_percent", "tr.end %", "{:.3f}"), ("end_se3_percent", "... se3 %", "{:.3f}"),
    ("turn_median_percent", "rot.med.%", "{:.4f}"), ("turn_end_percent", "rot.end %", "{:.4f}"),
    ("frame_ms", "frame ms", "{:.1f}"), ("memory_mb", "MB", "{:.0f}"),
]


def run(command, **more):
    done = subprocess.run([str(part) for part in command], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **more)
    if done.returncode != 0:
        sys.exit(f"{command[0]}: exit code {done.returncode}\n{done.stderr}")
    return done.stdout


def evaluate(programs, truth, estimate, out, align):
    run([programs / "evaluate", "--truth", truth, "--estimate", estimate, "--align", align, "--out", out])
    return json.loads((out / "evaluation.json").read_text())


def figures(programs, data, arguments, out, front=()):
    """Runs a recording and gives its row of the table."""
    run([*front, programs / "sweeper_robot", "--data", data, "--out", out, *arguments])
    summary = json.loads((out / "summary.json").read_text())
    live = evaluate(programs, data, out / "trajectory_live.tum", out / "live_se3", "se3")
    first = evaluate(programs, data, out / "trajectory_live.tum", out / "live_first", "first")
    optimized = evaluate(programs, data, out / "trajectory_optimized.tum", out / "optimized_se3", "se3")
    return {
        "frames": summary["frames"], "lost": summary["frames_lost"], "dropped": summary["frames_dropped"],
        "lost_percent": 100 * summary["frames_lost"] / max(1, summary["frames"]),
        "live_mm": 1e3 * live["ape_rmse_m"], "optimized_mm": 1e3 * optimized["ape_rmse_m"],
        "turn_deg": first["rotation_fitted_rmse_deg"], "turn_first_deg": first["rotation_rmse_deg"],
        "median_percent": first["translation_error_percent_median"],
        "end_percent": first["translation_error_percent_end"],
        "end_se3_percent": live["translation_error_percent_end"],
        "turn_median_percent": first["rotation_error_percent_median"],
        "turn_end_percent": first["rotation_error_percent_end"],
        "frame_ms": summary["stages"]["frame"]["median_ms"], "memory_mb": summary["peak_memory_mb"],
    }


def table(rows):
    width = max(len(name) for name, _ in rows) + 2
    print(" " * width + "".join(f"{head:>10}" for _, head, _ in COLUMNS))
    for name, row in rows:
        cells = ("-" if row[key] is None else form.format(row[key]) for key, _, form in COLUMNS)
        print(f"{name:<{width}}" + "".join(f"{cell:>10}" for cell in cells))


def runs(programs, data, out, which, front):
    rows, missed = [], []
    for name, folder, arguments, bounds in which:
        place = out / name.replace(" ", "_").replace(",", "")
        row = figures(programs, data / folder, [*front, *arguments], place)
        rows.append((name, row))
        missed += [f"{name}: {key} {row[key]:.4g}, at most {bound:g} was asked" for key, bound in bounds.items()
                   if row[key] is None or row[key] > bound]
    table(rows)
    return missed


def motion(programs, data, out):
    print("\nWith IMU and wheels, every frame in its turn; columns as for stereo alone.")
    missed = runs(programs, data, out / "motion", MOTION_RUNS, [])
    print(run([programs / "motion_accuracy", *(data / folder for folder in
                                               ("sweephome/dev01", "sweephome/dev02", "sweephome/dev03", "euroc_still"))]))
    return missed


def stereo(programs, data, out):
    print("\nStereo alone, every frame in its turn. live, opt.: ATE, rms after an SE(3) alignment;\nrot. [deg], rms: after the one rotation that fits best, and with the first pose aligned; per cent: first pose\naligned, and the end also after the SE(3) alignment.")
    return runs(programs, data, out / "stereo", RUNS, CAMERAS_ALONE)


def rotation_vectors(quaternions):
    """Rotation from the first orientation to each, small, as vectors in the first one's frame [rad]; rows are x y z w."""
    x0, y0, z0, w0 = quaternions[0]
    x, y, z, w = quaternions.T
    scalar = w0 * w + x0 * x + y0 * y + z0 * z
    vector = np.stack([w0 * x - x0 * w - y0 * z + z0 * y, w0 * y - y0 * w - z0 * x + x0 * z,
                       w0 * z - z0 * w - x0 * y + y0 * x], 1)
    return 2 * vector * np.sign(scalar)[:, None]


def gyro(programs, data, out):
    print("\nEuRoC V1_01, still: rotation against the integral of the gyro, whose constant bias is fitted, rms [deg]:")
    folder = data / "euroc_still" / "mav0"
    place = out / "gyro"
    run([programs / "sweeper_robot", "--data", data / "euroc_still", "--out", place, *CAMERAS_ALONE])
    estimate = np.loadtxt(place / "trajectory_live.tum")
    truth = np.loadtxt(folder / "state_groundtruth_estimate0" / "data.csv", delimiter=",", comments="#")
    imu = np.loadtxt(folder / "imu0" / "data.csv", delimiter=",", comments="#")
    seconds = (imu[:, 0] - imu[0, 0]) * 1e-9
    steps = 0.5 * (imu[1:, 1:4] + imu[:-1, 1:4]) * np.diff(seconds)[:, None]
    turned = np.vstack([np.zeros(3), np.cumsum(steps, 0)])
    for name, at, vectors in (("vision", estimate[:, 0] - imu[0, 0] * 1e-9, rotation_vectors(estimate[:, 4:8])),
                              ("truth", (truth[:, 0] - imu[0, 0]) * 1e-9, rotation_vectors(truth[:, [5, 6, 7, 4]]))):
        difference = np.stack([np.interp(at, seconds, turned[:, i]) for i in range(3)], 1) - vectors
        line = np.stack([at, np.ones_like(at)], 1)
        rest = difference - line @ np.linalg.lstsq(line, difference, rcond=None)[0]
        print(f"  {name:<8}{np.degrees(np.sqrt((rest**2).sum(1).mean())):.3f}")
    return []


def pairs(programs, data, _):
    print("\nMotion between two images of EuRoC V1_01 alone: the first pair 98 s apart, the last half a second.")
    text = run([programs / "relative_pose_accuracy", data / "euroc_loop_pairs"])
    print(text.rstrip())
    lines = text.splitlines()[1:]
    missed = []
    for line in (lines[0], lines[-1]):
        fields = line.split()
        if fields[-1] == "none" or float(fields[-2]) > 0.05 or float(fields[-1]) > 1.0:
            missed.append(f"relative pose: {line.strip()}")
    return missed


def repeat(programs, data, out):
    print("\nThe same run twice:")
    folders = [out / "first", out / "second"]
    for folder in folders:
        run([programs / "sweeper_robot", "--data", data / "sweephome/dev01", "--duration", "15", "--out", folder])
    differing = []
    for file in sorted(folders[0].iterdir()):
        if file.name == "summary.json":  # has times
            continue
        same = file.read_bytes() == (folders[1] / file.name).read_bytes()
        print(f"  {file.name:<28}{'identical' if same else 'DIFFERS'}")
        if not same:
            differing.append(f"two runs differ in {file.name}")
    return differing


def realtime(programs, data, out):
    print("\nsweephome dev01 on one core: every frame, and at sensor time with frames dropped.")
    one_core = ["taskset", "-c", "0"] if shutil.which("taskset") else []
    rows = []
    for name, arguments in (("every frame", []), ("real time", ["--realtime"])):
        rows.append((name, figures(programs, data / "sweephome/dev01", arguments, out / name.replace(" ", "_"), one_core)))
    table(rows)
    return []


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parts = {"stereo": stereo, "motion": motion, "gyro": gyro, "pairs": pairs, "repeat": repeat, "realtime": realtime}
    parser.add_argument("--bin", type=pathlib.Path, default=ROOT / "build/release/bin", help="where the programs are")
    parser.add_argument("--out", type=pathlib.Path, help="keep the results of the runs here")
    parser.add_argument("parts", nargs="*", metavar="PART", help=", ".join(parts))
    given = parser.parse_args()
    if unknown := [part for part in given.parts if part not in parts]:
        parser.error(f"no part {unknown[0]}: there are {', '.join(parts)}")
    if not os.environ.get("SWEEPKIT_DATA"):
        print("skipped: SWEEPKIT_DATA is not set")
        sys.exit(77)
    missed = []
    with tempfile.TemporaryDirectory() as scratch:
        out = (given.out or pathlib.Path(scratch)).resolve()
        for part in given.parts or parts:
            missed += parts[part](given.bin.resolve(), pathlib.Path(os.environ["SWEEPKIT_DATA"]), out)
    print("\n" + ("\n".join(missed) if missed else "All bounds are kept."))
    sys.exit(1 if missed else 0)


main()
