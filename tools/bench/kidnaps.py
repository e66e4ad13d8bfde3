#!/usr/bin/python3
# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
"""Kidnaps a robot to random places of mapped flats: does it know where it is within 3 s?

    kidnaps.py [--bin DIR] [--simulated DIR] [--out DIR] [--kidnaps N] [--seed N] [--only FLAT ...] [--make] [--pictures DIR] [PART...]
               [-- OPTION...]

Each flat is mapped by a robot that sweeps all of it in lanes. A second recording puts the robot down N times at a random spot where it
fits and could have driven to, with a random heading; there it turns on the spot, as robots do that are lost. Both are simulated where
they are not there yet, at some six images a second: an hour on two cores. A place counts where 30 % of the first view was seen before
from within 2 m and 30 degrees. Right is within 10 cm and 5 degrees.

block    `kidnap` asks PlaceRecognizer::locate in a map at true poses; OPTIONs go to it (--no-odometry, --set verifier.min_inliers=40 ...);
         pictures show the way that mapped each flat, and where the robot was put down
system   sweeper_robot maps the flat, and begins anew at each place with --atlas and --localize, without the fear that a room
         which is not mapped has a mapped twin (places.recognizer.twins=false)
careful  the same with that fear, as by default
foreign  the places of one flat in the atlas of another, where all that is named is wrong; with frames pooled and without
"""

import argparse
import json
import pathlib
import re
import subprocess
import sys

import numpy as np
import yaml

from place_accuracy import alignment, pairs
from twin_flats import Truth, angle_deg, matrices

ROOT = pathlib.Path(__file__).resolve().parents[2]
# Scene, and how many kidnaps.
FLATS = {
    "living_bedroom": (ROOT / "tools/initial/scenes/living_bedroom.yaml", 45),
    "kitchen_sill": (ROOT / "tools/initial/scenes/kitchen_sill.yaml", 45),
    "four_rooms": (ROOT / "tools/bench/scenes/four_rooms.yaml", 60),
}
FOREIGN = (("living_bedroom", "four_rooms"), ("four_rooms", "living_bedroom"))  # kitchen_sill has another rig
SECONDS = 3
CARRY = 0.6  # [s]
TURN = 225   # [deg], a little more than 3 s at the robot's 75 degrees a second


def run(*command):
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True, cwd=ROOT)
    if done.returncode != 0:
        sys.exit(f"{' '.join(str(part) for part in command)}\n{done.stderr[-2000:]}")
    return done.stdout


def simulate(given, scene, target, *options):
    if (target / "truth.yaml").exists():
        return
    print(f"simulating {target.name} ...", file=sys.stderr)
    run(given.bin / "simulate", "--scene", scene, "--out", target, "--set", "depth_every=0", *options)


def make(given, name, target, steps, seed):
    """A recording of other steps in a flat."""
    scene = yaml.safe_load(FLATS[name][0].read_text())
    scene["drive"] = {"steps": steps}
    scene["events"] = []
    given.simulated.mkdir(parents=True, exist_ok=True)
    file = given.simulated / f"{target}.yaml"
    file.write_text(yaml.safe_dump(scene, sort_keys=False))
    simulate(given, file, given.simulated / target, "--seed", seed)
    return given.simulated / target


def mapped(given, name):
    if name == "four_rooms":  # swept twice by its own drive
        simulate(given, FLATS[name][0], given.simulated / name)
        return given.simulated / name
    return make(given, name, f"{name}_swept", [{"stand": 2}, {"cover": {"spacing": 0.4}}, "home"], 1)


def kidnapped(given, name):
    kidnaps = given.kidnaps or FLATS[name][1]
    places = kidnaps * [{"carry": {"to": "anywhere", "seconds": CARRY}}, {"turn": TURN}]
    return make(given, name, f"{name}_kidnaps_{kidnaps}_{given.seed}", [{"stand": 0.5}] + places, given.seed)


PUT_DOWN = re.compile(r"^ +\d+ frame +(\d+): (\w+)", re.MULTILINE)


def stamps_of(recording):
    return 1e-9 * np.loadtxt(recording / "mav0/cam0/data.csv", delimiter=",", comments="#", usecols=0, dtype=np.int64)


def draw(file, name, sweep, kidnaps, outcomes):
    """The way that mapped a flat in grey, an arrow for each place where the robot was put down."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    way, truth, stamps = Truth(sweep), Truth(kidnaps), stamps_of(kidnaps)
    figure, axes = plt.subplots(figsize=(9, 6))
    axes.plot(way.T[:, 0, 3], way.T[:, 1, 3], color="0.75", linewidth=0.8, label="mapped on this way")
    for outcome, colour in (("right", "tab:green"), ("unknown", "tab:orange"), ("WRONG", "tab:red")):
        T = np.array([truth.at(stamps[int(frame)]) for frame, what in outcomes if what == outcome]).reshape(-1, 4, 4)
        axes.plot(T[:, 0, 3], T[:, 1, 3], ".", color=colour, markersize=3)
        axes.quiver(T[:, 0, 3], T[:, 1, 3], T[:, 0, 0], T[:, 1, 0], color=colour, width=0.004, scale=30, label=f"{outcome.lower()}: {len(T)}")
    axes.set(aspect="equal", xlabel="x [m]", ylabel="y [m]", title=f"{name}: put down, and asked where it is within {SECONDS} s")
    axes.legend(loc="upper left", bbox_to_anchor=(1, 1), frameon=False)
    figure.savefig(file, dpi=110, bbox_inches="tight")
    plt.close(figure)


def total(rows):
    right, wrong, unknown = (sum(column) for column in zip(*rows))
    asked = max(1, right + wrong + unknown)
    print(f"{'together':<28}{right:>6}{wrong:>7}{unknown:>9}   {100 * right / asked:.0f} % of {asked} right")
    return wrong


def block(given, recordings):
    print(f"\nblock: `kidnap`, within {SECONDS} s\n{'':<28}{'right':>6}{'wrong':>7}{'unknown':>9}{'median s':>10}{'95 % s':>8}{'median mm':>11}")
    rows = []
    for name, (sweep, kidnaps) in recordings.items():
        text = run(given.bin / "kidnap", "--put-down", "--kidnaps", 0, "--seconds", SECONDS, "--verbose", *given.options, sweep, kidnaps)
        if given.pictures:
            given.pictures.mkdir(parents=True, exist_ok=True)
            draw(given.pictures / f"{name}.png", name, sweep, kidnaps, PUT_DOWN.findall(text))
        row = re.search(r"^\S+, \S+ +(\d+) +(\d+) +(\d+) +(\S+) +(\S+) +(\S+)", text, re.MULTILINE).groups()
        rows.append([int(n) for n in row[:3]])
        print(f"{name:<28}{row[0]:>6}{row[1]:>7}{row[2]:>9}{row[3]:>10}{row[4]:>8}{row[5]:>11}", flush=True)
    return total(rows)


def mapped_places(given, sweep, kidnaps):
    """The instants at which the robot is put down where it was mapped [s], without regard to what is known there."""
    text = run(given.bin / "kidnap", "--put-down", "--kidnaps", 0, "--seconds", 0, "--verbose", sweep, kidnaps)
    stamps = stamps_of(kidnaps)
    return [stamps[int(frame)] for frame, _ in PUT_DOWN.findall(text)]


def swept_atlas(given, name, sweep):
    out = given.out / name
    atlas = out / "home.swk"
    if not atlas.exists():
        run(given.bin / "sweeper_robot", "--data", sweep, "--out", out / "mapped", "--atlas", atlas, "--set", "realtime=false")
    return atlas


def begin_anew(given, kidnaps, atlas, out, seconds, *options):
    """Puts the robot down in an atlas, so many seconds into a recording: when it was relocalized, within SECONDS, or None."""
    truth = Truth(kidnaps)
    run(given.bin / "sweeper_robot", "--data", kidnaps, "--out", out, "--atlas", atlas, "--localize", "--start", seconds,
        "--duration", SECONDS + 0.3, "--set", "realtime=false", *options)
    events = [json.loads(line) for line in (out / "events.jsonl").read_text().splitlines()]
    found = [event["t"] for event in events if event["event"] == "relocalized" and event["t"] <= truth.t[0] + seconds + SECONDS + 0.02]
    return found[0] if found else None


def foreign(given, recordings):
    """Put down in a flat that the atlas does not hold, everything that is named is wrong."""
    print(f"\nforeign: sweeper_robot in the atlas of another flat, within {SECONDS} s\n{'':<44}{'wrong':>7}{'unknown':>9}   with pool=false")
    wrong = 0
    for name, other in FOREIGN:
        if not {name, other} <= set(recordings):
            continue
        (_, kidnaps), atlas = recordings[name], swept_atlas(given, other, recordings[other][0])
        counts = []
        for pool in ("true", "false"):
            found = [begin_anew(given, kidnaps, atlas, given.out / name / "foreign", end, "--set", "places.recognizer.twins=false",
                                "--set", f"places.recognizer.pool={pool}") for _, end in Truth(kidnaps).lifted]
            counts += [sum(f is not None for f in found), sum(f is None for f in found)]
        wrong += counts[0]
        print(f"{name + ' in the atlas of ' + other:<44}{counts[0]:>7}{counts[1]:>9}{counts[2]:>8}{counts[3]:>9}", flush=True)
    return wrong


def system(given, recordings, careful):
    print(f"\n{'careful' if careful else 'system'}: sweeper_robot, within {SECONDS} s\n"
          f"{'':<28}{'right':>6}{'wrong':>7}{'unknown':>9}{'median s':>10}{'95 % s':>8}{'median mm':>11}")
    rows = []
    for name, (sweep, kidnaps) in recordings.items():
        out, atlas = given.out / name, swept_atlas(given, name, sweep)
        _, estimate, true = pairs(sweep, out / "mapped/trajectory_optimized.tum")
        R, t = alignment(estimate, true)  # world to map
        truth = Truth(kidnaps)
        row, seconds, errors = [0, 0, 0], [], []
        for begin in mapped_places(given, sweep, kidnaps):
            found = begin_anew(given, kidnaps, atlas, out / "kidnapped", begin - truth.t[0] - 0.02, "--set",
                               f"places.recognizer.twins={'true' if careful else 'false'}")
            if found is None:
                row[2] += 1
                continue
            # One image later the live pose is in the atlas.
            live = np.loadtxt(out / "kidnapped/trajectory_live.tum")
            i = min(np.searchsorted(live[:, 0], found + 1e-3), len(live) - 1)
            T_world, T_map = truth.at(live[i, 0]), matrices(live[i : i + 1])[0]
            metres = np.linalg.norm(T_map[:3, 3] - R @ T_world[:3, 3] - t)
            is_right = metres < 0.1 and angle_deg(T_map[:3, :3].T @ R @ T_world[:3, :3]) < 5
            row[0 if is_right else 1] += 1
            seconds.append(found - begin)
            errors.append(1e3 * metres)
        rows.append(row)
        print(f"{name:<28}{row[0]:>6}{row[1]:>7}{row[2]:>9}{np.median(seconds or [0]):>10.2f}{np.quantile(seconds or [0], 0.95):>8.2f}"
              f"{np.median(errors or [0]):>11.1f}", flush=True)
    return total(rows)


PARTS = {"block": block, "system": lambda *_: system(*_, careful=False), "careful": lambda *_: system(*_, careful=True),
         "foreign": foreign}


def main():
    arguments = sys.argv[1:]
    options = arguments[arguments.index("--") + 1 :] if "--" in arguments else []
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bin", type=pathlib.Path, default=ROOT / "build/release/bin", help="where the programs are")
    parser.add_argument("--simulated", type=pathlib.Path, default=ROOT / "build/simulated",
                        help="simulated recordings, made if they are not there")
    parser.add_argument("--out", type=pathlib.Path, help="atlases and runs; below the simulated recordings if not given")
    parser.add_argument("--kidnaps", type=int, help="places in each flat; 45, in four rooms 60")
    parser.add_argument("--seed", type=int, default=2, help="of the places")
    parser.add_argument("--only", action="append", choices=FLATS, help="this flat alone; may be given again")
    parser.add_argument("--pictures", type=pathlib.Path, help="draw each flat into this folder")
    parser.add_argument("--make", action="store_true", help="simulate, and end")
    parser.add_argument("parts", nargs="*", metavar="PART", help=", ".join(PARTS))
    given = parser.parse_args(arguments[: arguments.index("--")] if "--" in arguments else arguments)
    if unknown := [part for part in given.parts if part not in PARTS]:
        parser.error(f"no part {unknown[0]}: there are {', '.join(PARTS)}")
    given.bin, given.simulated, given.options = given.bin.resolve(), given.simulated.resolve(), options
    given.out = (given.out or given.simulated / "kidnapped").resolve()
    recordings = {}
    for name in given.only or FLATS:
        recordings[name] = mapped(given, name), kidnapped(given, name)
    if given.make:
        return
    wrong = sum(PARTS[part](given, recordings) for part in given.parts or PARTS)
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
