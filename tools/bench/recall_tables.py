#!/usr/bin/env python3
# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
"""Prints Recall_N of points and of points with lines: on 7-Scenes' kitchen, and on two simulated drives through one
flat, with vocabularies trained on the scene itself, elsewhere, and with those that are shipped.

    SWEEPKIT_DATA=... tools/bench/recall_tables.py [--bin build/release/bin] [--work /tmp/recall_drives]

Drives are simulated once (some minutes) and kept in the folder given with --work.
"""

import argparse
import os
import pathlib
import subprocess
import sys

import yaml

ROOT = pathlib.Path(__file__).resolve().parents[2]
SCENES = ROOT / "tools/initial/scenes"
INITIAL = ROOT / "tools/initial"

# Ways through the flat of living_bedroom.yaml that meet often, but never start or turn at the same place.
DRIVES = {
    "first": {"start": [3.3, 1.9, 90], "steps": [
        {"stand": 1}, {"drive": [[3.1, 2.8]]}, {"go": [1.2, 1.2, 0]}, {"go": [3.5, 1.5]}, {"go": [5.3, 1.6]},
        {"go": [6.6, 1.5]}, "home", {"stand": 1}]},
    "second": {"start": [3.15, 1.6, 80], "steps": [
        {"stand": 1}, {"drive": [[3.0, 2.7]]}, {"go": [1.35, 1.15, 8]}, {"go": [3.4, 1.42]}, {"go": [5.2, 1.7]},
        {"go": [6.5, 1.4]}, "home", {"stand": 1}]},
}


def run(command):
    print("$", " ".join(str(word) for word in command), flush=True)
    subprocess.run([str(word) for word in command], check=True)


def simulate(bin_folder, work, name, drive, seed):
    folder = work / name
    if folder.exists():
        return folder
    scene = yaml.safe_load((SCENES / "living_bedroom.yaml").read_text())
    scene["drive"] = drive
    file = work / f"{name}.yaml"
    file.write_text(yaml.safe_dump(scene))
    run([bin_folder / "simulate", "--scene", file, "--out", folder, "--seed", seed, "--set", "format=jpeg",
         "--set", "depth_every=0", "--set", "sensors.cameras.rate_hz=4"])
    return folder


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bin", type=pathlib.Path, default=ROOT / "build/release/bin")
    parser.add_argument("--work", type=pathlib.Path, default=pathlib.Path("/tmp/recall_drives"))
    arguments = parser.parse_args()
    arguments.work.mkdir(parents=True, exist_ok=True)
    recall = arguments.bin / "recall"
    drives = [simulate(arguments.bin, arguments.work, name, drive, 11 + i)
              for i, (name, drive) in enumerate(DRIVES.items())]
    shipped = ["--vocabulary", INITIAL / "orb.swv", "--line-vocabulary", INITIAL / "lbd.swv"]

    print("\n# Two simulated drives: the second is looked for in the first")
    pair = ["--database", drives[0], "--queries", drives[1], "--set", "counts=[1, 5, 10, 20, 40, 60]"]
    for depth in (3, 4):
        run([recall, *pair, "--set", f"training.depth={depth}"])
    run([recall, *pair, *shipped])

    data = os.environ.get("SWEEPKIT_DATA")
    if not data:
        print("SWEEPKIT_DATA is not set: no table of real images", file=sys.stderr)
        return 77
    print("\n# 7-Scenes kitchen")
    kitchen = pathlib.Path(data) / "place_7scenes"
    counts = ["--set", "counts=[1, 5, 10, 20]"]
    for depth in (3, 4):
        run([recall, "--database", kitchen, *counts, "--set", f"training.depth={depth}"])
    run([recall, "--database", kitchen, "--train", drives[0], *counts])
    run([recall, "--database", kitchen, *shipped, *counts])
    return 0


if __name__ == "__main__":
    sys.exit(main())
