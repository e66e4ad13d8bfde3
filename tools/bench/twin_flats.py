#!/usr/bin/python3
# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
"""Flats whose two rooms have the same furniture, pictures and wallpaper, at the same places: is one ever taken for the other?

    twin_flats.py [--bin DIR] [--simulated DIR] [--out DIR] [--flats N] [--make] [--only N ...] [PART...]

Makes each flat's scene from its number and simulates a short drive through both rooms. In even flats the second room is the
first moved along the wall with the door, in odd ones turned by 180 degrees about the door, so that even the door is where it
is in the other. Of each four flats one drives through both rooms and back, one is carried into the other room before it knows
it, one is carried into the other room after it was there, one is carried and put down where it was not.

Then sweeper_robot runs on each, in three parts: all (all sensors), alone (cameras alone: what was carried knows nothing of the
way), restart (what was driven before the last third is an atlas; the rest begins anew in it, with all sensors); unafraid, if asked
for, is restart with places.recognizer.twins=false, which is not meant for such flats. Each place
known again - loop_closed, maps_joined, and with an atlas relocalized - is compared with the truth: the pose against the
keyframe that it names must not be off by more than 0.5 m or 10 degrees. Recall: of the times the robot came again to a view
that it had (within 0.5 m and 30 degrees) after it was elsewhere for 10 s or carried, in how many a place was known again.
"""

import argparse
import json
import math
import os
import pathlib
import random
import subprocess
import sys

import numpy as np
import yaml

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parents[1]
UNAFRAID = ["--set", "places.recognizer.twins=false"]
WALL = 0.12  # between the rooms [m]


def furniture(rng, w, d, h):
    """What stands in a room of w x h with a door in the wall x = w, and one at x = 0 of the twin, at y = d."""
    things, pictures = [], []

    def along_wall(length, taken, place):
        """Things with their backs to a wall; `place` takes along, depth to position and yaw."""
        at = rng.uniform(0.15, 0.4)
        while True:
            kind = rng.choice(["shelf", "cabinet", "cabinet", "plant", "lamp", "bin", "gap"])
            width = {"plant": 0.55, "lamp": 0.45, "bin": 0.35, "gap": rng.uniform(0.3, 0.7)}.get(kind, rng.uniform(0.8, 1.3))
            if at + width > length - 0.15:
                return
            if any(low < at + width and at < high for low, high in taken):
                at += 0.1
                continue
            depth = {"shelf": 0.3, "cabinet": rng.uniform(0.4, 0.48), "plant": 0.55, "lamp": 0.45, "bin": 0.35}.get(kind, 0)
            if kind != "gap":
                x, y, yaw = place(at + width / 2, depth / 2 + 0.06)
                thing = {"kind": kind, "at": [x, y], "yaw": yaw + rng.uniform(-1, 1), "seed": rng.randrange(1, 1000)}
                if kind == "shelf":
                    thing["size"] = [width, depth, rng.uniform(1.2, 1.9)]
                if kind == "cabinet":
                    thing["size"] = [width, depth, rng.uniform(0.6, 1.0)]
                    thing["material"] = rng.choice(["beech", "pine", "teak"])
                if kind == "plant":
                    thing["size"] = [0.5, 0.5, rng.uniform(0.8, 1.2)]
                things.append(thing)
            at += width + rng.uniform(0.05, 0.3)

    doors = [(d - 0.75, d + 0.75)]
    along_wall(w, [(0, 0.55), (w - 0.55, w)], lambda a, b: (a, b, 180))
    # A sofa or a bed at the wall x = 0, above or below the twin's door.
    low, high = (d + 0.7, h - 0.2) if h - d > d else (0.6, d - 0.7)
    side = []
    if high - low > 1.95 and rng.random() < 0.7:
        middle = rng.uniform(low + 0.97, high - 0.97)
        things.append({"kind": "sofa", "at": [0.5, middle], "yaw": 90 + rng.uniform(-1, 1), "seed": rng.randrange(1, 1000)})
        side = [(middle - 1.05, middle + 1.05)]
    along_wall(h, doors + side + [(0, 0.6), (h - 0.5, h)], lambda a, b: (b, a, 90))
    along_wall(h, doors + [(0, 0.6), (h - 0.5, h)], lambda a, b: (w - b, a, -90))
    window = {"wall": 2, "along": w / 2 + rng.uniform(-0.4, 0.4), "base": 0.85, "width": rng.uniform(1.0, 1.5), "height": 1.3}
    things.append({"kind": "radiator", "at": [w - window["along"], h - 0.09], "size": [1.2, 0.08, 0.6]})
    for wall, length in ((0, w), (3, h), (1, h)):
        for _ in range(rng.randrange(0, 3)):
            centre = rng.uniform(0.5, length - 0.5)
            size = rng.uniform(0.35, 0.7)
            # Wall 3 runs from y = h down.
            y = centre if wall == 1 else length - centre
            clear = wall == 0 or abs(y - d) > 0.75 + size / 2
            if clear and all(p["wall"] != wall or abs(p["along"] - centre) > 0.8 for p in pictures):
                pictures.append({"wall": wall, "along": centre, "centre": rng.uniform(1.0, 1.4), "width": size,
                                 "height": rng.uniform(0.3, 0.5), "seed": rng.randrange(1, 1000)})
    things.append({"kind": "carpet", "at": [w / 2 + rng.uniform(-0.2, 0.2), h / 2 + rng.uniform(-0.3, 0.3)],
                   "yaw": rng.uniform(-3, 3), "size": [rng.uniform(1.2, 1.7), rng.uniform(0.8, 1.1), 0.008],
                   "seed": rng.randrange(1, 1000)})
    if rng.random() < 0.5:
        things.append({"kind": "carton", "at": [w / 2, h - 0.55], "yaw": rng.uniform(-40, 40), "size": [0.4, 0.3, 0.26],
                       "seed": rng.randrange(1, 1000)})
    return things, pictures, window


def scene_of(number):
    """The scene of a flat, and when its last third begins: (scene, kind)."""
    rng = random.Random(7000 + number)
    w, h = round(rng.uniform(3.5, 4.5), 2), round(rng.uniform(3.4, 4.2), 2)
    d = round(rng.uniform(1.2, h - 1.2), 2)
    things, pictures, window = furniture(rng, w, d, h)
    turned = number % 2 == 1
    floor, walls = rng.choice(["oak", "ash", "walnut", "grey_tiles", "white_tiles"]), \
        rng.choice(["wallpaper", "wallpaper_light", "wallpaper", "plaster"])

    def second(x, y, yaw=None):
        moved = [2 * w + WALL - x, 2 * d - y] if turned else [x + w + WALL, y]
        return [round(v, 4) for v in moved] + ([] if yaw is None else [round(yaw + 180 * turned, 3)])

    def first(x, y, yaw=None):
        return [round(x, 4), round(y, 4)] + ([] if yaw is None else [round(yaw, 3)])

    corners = [second(0, 0), second(w, h)]
    rect = [min(corners[0][0], corners[1][0]), min(corners[0][1], corners[1][1]),
            max(corners[0][0], corners[1][0]), max(corners[0][1], corners[1][1])]
    scene = {"name": f"twins_{number:02}", "frame": {"yaw": rng.randrange(360), "origin": [0.3, 0.2]},
             "rooms": [{"name": "a", "rect": [0, 0, w, h], "floor": floor, "walls": walls},
                       {"name": "b", "rect": [round(v, 4) for v in rect], "floor": floor, "walls": walls}],
             "doors": [{"between": ["a", "b"], "at": [round(w + WALL / 2, 3), d], "width": 0.9}],
             "windows": [], "pictures": [], "objects": [], "lights": [],
             "daylight": {"azimuth": rng.randrange(360), "elevation": rng.randrange(20, 50), "sky": 2.2}}
    for room, place in (("a", first), ("b", second)):
        wall_of = (lambda k: (k + 2) % 4) if turned and room == "b" else (lambda k: k)
        scene["windows"].append({**window, "room": room, "wall": wall_of(window["wall"])})
        scene["pictures"] += [{**p, "room": room, "wall": wall_of(p["wall"])} for p in pictures]
        for thing in things:
            *at, yaw = place(*thing["at"], thing.get("yaw", 0))
            scene["objects"].append({**thing, "at": at, "yaw": yaw})
        scene["lights"].append({"at": place(w / 2, h / 2) + [2.3], "power": 4.5})

    # A round through the middle of a room, which another that begins elsewhere meets again.
    low, high = min(1.0, d), h - 1.15
    spots = [(1.15, max(low, 0.95)), (w - 1.15, max(low, 0.95)), (w - 1.15, high), (1.15, high)]
    k = rng.randrange(4)
    round_trip = [spots[(k + i) % 4] for i in range(4)]
    if rng.random() < 0.5:
        round_trip.reverse()
    away = rng.uniform(-180, 180)
    through = {"go": second(w - 0.6, d) if turned else second(0.6, d)}
    go = lambda place, points: [{"go": place(*p)} for p in points]
    put = lambda place, spot: {"carry": {"to": place(*spot, away), "height": 0.5, "seconds": 4}}
    kind = ("driven", "unknown", "known", "elsewhere")[number // 2 % 4]
    start = {"start": first(*round_trip[0], away)}
    last = {"driven": go(second, round_trip[:3]) + [through, {"go": first(w - 0.6, d)}] + go(first, round_trip[:2]),
            "unknown": [put(second, round_trip[0])] + go(second, round_trip[1:] + round_trip[:1]),
            "known": go(second, round_trip[:3]) + [put(first, round_trip[0])] + go(first, round_trip[1:3]),
            "elsewhere": [put(second, round_trip[2])] + go(second, [round_trip[3], round_trip[0]])}[kind]
    scene["robot"] = {"speed": 0.4, "turn_rate_deg": 60}
    scene["sensors"] = {"cameras": {"rate_hz": 5}}
    scene["drive"] = {**start, "steps": [{"stand": 1}] + go(first, round_trip[1:] + round_trip[:1]) +
                      ([{"go": first(w - 0.6, d)}, through] if kind in ("driven", "known") else []) + last + [{"stand": 0.4}]}
    return scene, kind


def make(number, programs, simulated):
    """The recording of a flat, simulated if it is not there."""
    scene, _ = scene_of(number)
    target = simulated / scene["name"]
    if not (target / "truth.yaml").exists():
        simulated.mkdir(parents=True, exist_ok=True)
        file = simulated / f"{scene['name']}.yaml"
        file.write_text(yaml.safe_dump(scene, sort_keys=False))
        print(f"simulating {scene['name']} ...", file=sys.stderr)
        done = subprocess.run([str(programs / "simulate"), "--scene", str(file), "--out", str(target), "--set", "format=jpeg",
                               "--set", "depth_every=0"], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        if done.returncode != 0:
            sys.exit(f"{scene['name']}: {done.stderr[-2000:]}")
    return target


def matrices(rows):
    """T_world_body of rows t x y z qx qy qz qw."""
    x, y, z, w = rows[:, 4:8].T / np.linalg.norm(rows[:, 4:8], axis=1)
    T = np.tile(np.eye(4), (len(rows), 1, 1))
    T[:, :3, :3] = np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                             [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                             [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]]).transpose(2, 0, 1)
    T[:, :3, 3] = rows[:, 1:4]
    return T


def angle_deg(R):
    return math.degrees(math.acos(max(-1.0, min(1.0, (np.trace(R) - 1) / 2))))


class Truth:
    def __init__(self, recording):
        rows = np.loadtxt(recording / "mav0/state_groundtruth_estimate0/data.csv", delimiter=",", comments="#")
        self.t = rows[:, 0] * 1e-9
        self.T = matrices(rows[:, [0, 1, 2, 3, 5, 6, 7, 4]])
        events = yaml.safe_load((recording / "truth.yaml").read_text()).get("events") or []
        self.lifted = [(event["t_start"], event["t_end"]) for event in events if event["kind"] == "lifted"]

    def at(self, t):
        return self.T[min(np.searchsorted(self.t, t), len(self.t) - 1)]


def again(truth, begin, end, earlier):
    """The first instant in begin .. end of a view within 0.5 m and 30 degrees of one in the spans `earlier`, or None."""
    old = [truth.at(t) for low, high in earlier for t in np.arange(low, high, 0.5)]
    if not old:
        return None
    places, ways = np.array([T[:3, 3] for T in old]), np.array([T[:3, 0] for T in old])
    for t in np.arange(begin, end, 0.2):
        T = truth.at(t)
        if ((np.linalg.norm(places - T[:3, 3], axis=1) < 0.5) & (ways @ T[:3, 0] > math.cos(math.radians(30)))).any():
            return t
    return None


class Run:
    """What sweeper_robot made of a recording, with each map's frame in the world."""

    def __init__(self, programs, recording, truth, out, arguments, frames=None):
        command = [programs / "sweeper_robot", "--data", recording, "--out", out, "--set", "realtime=false", *arguments]
        done = subprocess.run([str(part) for part in command], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        if done.returncode != 0:
            sys.exit(f"{recording.name}: exit code {done.returncode}\n{done.stderr}")
        self.live = np.loadtxt(out / "trajectory_live.tum")
        self.T = matrices(self.live)
        self.truth = truth
        self.summary = json.loads((out / "summary.json").read_text())
        self.maps = {number: (None, T_world_map) for number, T_world_map in (frames or {}).items()}
        self.right, self.wrong, self.joined, self.lines = 0, 0, {}, []
        self.loops = 0
        for line in (out / "events.jsonl").read_text().splitlines():
            event = json.loads(line)
            name, t = event["event"], event["t"]
            if name == "map_created":
                i = np.searchsorted(self.live[:, 0], t - 1e-3)
                if i < len(self.live):
                    self.maps[event["map"]] = (t, truth.at(self.live[i, 0]) @ np.linalg.inv(self.T[i]))
            if name in ("maps_joined", "loop_closed"):
                self.judge(name, t, event.get("map"), event.get("joined"), event)

    def judge(self, name, t, target, joined, event):
        """Some frames later the robot is in the frame of the map that it was found in."""
        if target is None:
            target = max((m for m, (begin, _) in self.maps.items() if begin is None or begin <= t), default=0)
            while target in self.joined:
                target = self.joined[target]
        i = min(np.searchsorted(self.live[:, 0], t) + 2, len(self.live) - 1)
        error = np.linalg.inv(self.truth.at(self.live[i, 0])) @ self.maps[target][1] @ self.T[i]
        metres, degrees = np.linalg.norm(error[:3, 3]), angle_deg(error[:3, :3])
        is_wrong = metres > 0.5 or degrees > 10
        self.wrong += is_wrong
        self.right += not is_wrong
        self.loops += name == "loop_closed"
        if joined is not None:
            self.joined[joined] = target
        self.lines.append(f"      {t - self.truth.t[0]:7.2f} s  {name}: {metres:.3f} m, {degrees:.2f} deg off, {event.get('points')} points"
                          f"{'   WRONG' if is_wrong else ''}")


def examine(part, number, programs, recording, out):
    """One run: (kind, possible, known again, wrong, loops, lines)."""
    truth = Truth(recording)
    begin, end = truth.t[0], truth.t[-1]
    carried = truth.lifted[0] if truth.lifted else None
    arguments = ["--set", "recording.use_imu=false", "--set", "recording.use_wheels=false"] if part == "alone" else []
    folder = out / part / recording.name
    folder.mkdir(parents=True, exist_ok=True)
    if part in ("restart", "unafraid"):
        split = carried or (0.66 * (end - begin), 0.66 * (end - begin) + 0.5)
        atlas = folder / "home.swk"
        atlas.unlink(missing_ok=True)
        first = Run(programs, recording, truth, folder / "first", ["--duration", split[0] - 0.1, "--atlas", atlas])
        frames = {m: T for m, (_, T) in first.maps.items()}
        second = Run(programs, recording, truth, folder / "second", ["--start", split[1] + 0.2, "--atlas", atlas, "--localize",
                                                                     *(UNAFRAID if part == "unafraid" else [])], frames)
        possible = again(truth, begin + split[1], end, [(begin, begin + split[0])])
        lines = first.lines + second.lines
        return int(possible is not None), int(possible is not None and second.right > 0), first.wrong + second.wrong, \
            first.loops + second.loops, lines
    run = Run(programs, recording, truth, folder, arguments)
    possible = found = 0
    starts = sorted((t, m) for m, (t, _) in run.maps.items())
    for k, (t, m) in enumerate(starts[1:], 1):
        stop = starts[k + 1][0] if k + 1 < len(starts) else end
        # What was mapped before: from the beginning of each map to where the next began, without what was carried.
        before = [(starts[j][0], carried[0] + begin if carried and starts[j][0] < carried[0] + begin < starts[j + 1][0] else
                   starts[j + 1][0]) for j in range(k)]
        if again(truth, t, stop, before) is not None:
            possible += 1
            found += m in run.joined
    return possible, found, run.wrong, run.loops, run.lines


def main():
    parts = ("all", "alone", "restart", "unafraid")
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bin", type=pathlib.Path, default=ROOT / "build/release/bin", help="where the programs are")
    parser.add_argument("--simulated", type=pathlib.Path, required=True, help="simulated recordings, made if they are not there")
    parser.add_argument("--out", type=pathlib.Path, help="results of the runs; below the simulated ones if not given")
    parser.add_argument("--flats", type=int, default=20, help="how many")
    parser.add_argument("--only", type=int, nargs="+", help="these alone")
    parser.add_argument("--make", action="store_true", help="simulate, and end")
    parser.add_argument("parts", nargs="*", metavar="PART", help=", ".join(parts))
    given = parser.parse_args()
    if unknown := [part for part in given.parts if part not in parts]:
        parser.error(f"no part {unknown[0]}: there are {', '.join(parts)}")
    numbers = given.only or range(given.flats)
    recordings = {n: make(n, given.bin.resolve(), given.simulated.resolve()) for n in numbers}
    if given.make:
        return
    out = (given.out or given.simulated / "results").resolve()
    all_wrong = 0
    for part in given.parts or parts[:3]:
        print(f"\n{part}\n{'flat':<12}{'kind':<12}{'could':>7}{'known':>7}{'loops':>7}{'wrong':>7}")
        totals = np.zeros(4, int)
        for n in numbers:
            could, known, wrong, loops, lines = examine(part, n, given.bin.resolve(), recordings[n], out)
            totals += (could, known, loops, wrong)
            print(f"{recordings[n].name:<12}{scene_of(n)[1]:<12}{could:>7}{known:>7}{loops:>7}{wrong:>7}")
            print(*lines, sep="\n", end="\n" if lines else "", flush=True)
        could, known, loops, wrong = totals
        print(f"{'together':<24}{could:>7}{known:>7}{loops:>7}{wrong:>7}   recall {known}/{could}")
        all_wrong += wrong
    sys.exit(1 if all_wrong else 0)


if __name__ == "__main__":
    main()
