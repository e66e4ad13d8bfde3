# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
"""What sweepkit.sweep can study: functions of parameters and a seed, for sweepkit.sweeping."""

import dataclasses
import difflib
import functools
import json
import math
import pathlib
import re
import tempfile
import typing

import numpy as np
import numpy.typing

from .sweeping import Parameters, SweepError, Value, text_of

Described = typing.Sequence[typing.Mapping[str, typing.Any]]
Floats = numpy.typing.NDArray[np.float64]

SYSTEM_FIGURES = ("images_lost", "keyframes", "points", "seconds")


def read_option(described: Described, path: str, text: str) -> Value:
    """The value of an option from its text, by what describe() of its struct says. Raises SweepError with the path."""
    known = {field["path"]: field for field in described}
    if path not in known:
        near = difflib.get_close_matches(path, known, 1, 0.0)
        raise SweepError(f"{path}: there is no such option; the nearest is {near[0]}")
    field = known[path]
    kind = field["type"]
    try:
        if kind == "bool":
            value: Value = {"true": True, "false": False}[text]
        elif kind in ("int", "float"):
            value = int(text) if kind == "int" else float(text)
        elif kind == "str":
            value = text
        else:
            raise SweepError(f"{path}: takes a {kind}, which cannot be swept")
    except (KeyError, ValueError):
        raise SweepError(f"{path}: takes a value of type {kind} (got {text})") from None
    if field["choices"] and value not in field["choices"]:
        raise SweepError(f"{path}: must be one of {', '.join(field['choices'])} (got {text})")
    if not isinstance(value, (bool, str)) and not field["min"] <= value <= field["max"]:
        raise SweepError(f"{path}: must be in [{field['min']:g}, {field['max']:g}] (got {text})")
    return value


def read_grid(described: Described, given: typing.Sequence[str],
              defaults: typing.Mapping[str, typing.Sequence[str]]) -> typing.Dict[str, typing.List[Value]]:
    """Parameters from texts like tracker.min_points=8,15,30, over default ones."""
    texts = {path: list(values) for path, values in defaults.items()}
    seen = set()
    for text in given:
        path, equals, values = text.partition("=")
        if not equals:
            raise SweepError(f"{text}: must be PATH=VALUE,VALUE,...")
        if path in seen:
            raise SweepError(f"{path}: is given twice")
        seen.add(path)
        texts[path] = values.split(",")
    return {path: [read_option(described, path, value) for value in values] for path, values in texts.items()}


def nested(values: typing.Mapping[str, typing.Any]) -> typing.Dict[str, typing.Any]:
    """{"a.b": 1} as {"a": {"b": 1}}, as structs of options take it."""
    result: typing.Dict[str, typing.Any] = {}
    for path, value in values.items():
        *groups, name = path.split(".")
        inside = result
        for group in groups:
            inside = inside.setdefault(group, {})
        inside[name] = value
    return result


@dataclasses.dataclass(frozen=True)
class SystemStudy:
    """The whole system on a recording with truth; parameters are options of RunOptions.

    The first seed runs the recording as it is. Each other begins later, by at most `jitter` seconds, and sets every seed
    among the options. Figures: those of sweepkit.data.Evaluation.to_json for the trajectory after a rigid alignment,
    images_lost, keyframes, points, seconds; for each spell [ns] the error of the motion from its begin to its end, the
    mean over spells: dark_end_m as known then, dark_end_optimized_m after all corrections.
    """
    data: str
    metrics: typing.Tuple[str, ...]
    trajectory: str = "optimized"
    spells: typing.Tuple[typing.Tuple[int, int], ...] = ()
    jitter: float = 0.5

    def __call__(self, parameters: Parameters, seed: int) -> typing.Dict[str, float]:
        from .data import EvaluationOptions, evaluate_trajectory, read_trajectory
        from .running import run
        from .system import RunOptions

        options: typing.Dict[str, Value] = dict(parameters)
        if seed > 1:
            late = self.jitter * ((seed - 1) * 0.6180339887498949 % 1.0)  # spread evenly, however many there are
            options["recording.start"] = float(options.get("recording.start", 0.0)) + late
            for field in RunOptions.describe():
                if field["path"].endswith(".seed") and field["path"] not in parameters:
                    options[field["path"]] = seed
        truth = read_trajectory(self.data)
        with tempfile.TemporaryDirectory(prefix="sweepkit_sweep_") as folder:
            result = run(self.data, folder, **nested(options))
            if not result.initialised:
                raise SweepError("there never was a map")
            ways = {name: read_trajectory(pathlib.Path(folder) / f"trajectory_{name}.tum")
                    for name in {self.trajectory, *(("live", "optimized") if self.spells else ())}}
        evaluation = evaluate_trajectory(truth, ways[self.trajectory], EvaluationOptions(align="se3"))
        figures: typing.Dict[str, typing.Any] = json.loads(evaluation.to_json())
        figures.update(images_lost=result.counts.images_lost, keyframes=result.keyframes, points=result.points,
                       seconds=result.seconds)
        if self.spells:
            for name, way in (("dark_end_m", "live"), ("dark_end_optimized_m", "optimized")):
                figures[name] = float(np.mean([motion_error(truth, ways[way], *spell) for spell in self.spells]))
        return {name: math.nan if figures.get(name) is None else float(figures[name]) for name in self.metrics}


def motion_error(truth: typing.Any, estimate: typing.Any, begin: int, end: int) -> float:
    """How far the estimated motion from one instant [ns] to another leads from the true one [m]."""
    poses = [trajectory.interpolate(t) for trajectory in (truth, estimate) for t in (begin, end)]
    if any(pose is None for pose in poses):
        raise SweepError(f"no pose at the begin or the end of the spell from {begin} to {end} ns")
    steps = [(poses[k].inverse() * poses[k + 1]).translation() for k in (0, 2)]
    return float(np.linalg.norm(steps[0] - steps[1]))


def evaluation_figures() -> typing.List[str]:
    """What SystemStudy can give, but for the spells."""
    from .data import Trajectory, evaluate_trajectory
    from .geometry import SE3d

    line = Trajectory([k * 10**9 for k in range(4)], [SE3d.exp(np.array([k, 0.0, 0, 0, 0, 0.1 * k])) for k in range(4)])
    names = json.loads(evaluate_trajectory(line, line).to_json())
    return [*(name for name in names if name not in ("align", "options")), *SYSTEM_FIGURES]


def dark_spells(data: str, given: typing.Sequence[str]) -> typing.Tuple[typing.Tuple[int, int], ...]:
    """Begin and end [ns] of each: from texts like 18.7,23.7 [s from the first true pose], else from truth.yaml."""
    from .data import read_trajectory

    spells = []
    for text in given:
        match = re.fullmatch(r"([0-9.]+),([0-9.]+)", text)
        if not match or not float(match[1]) < float(match[2]):
            raise SweepError(f"dark: must be BEGIN,END in seconds (got {text})")
        first = int(read_trajectory(data)[0][0])
        spells.append((first + int(float(match[1]) * 1e9), first + int(float(match[2]) * 1e9)))
    file = pathlib.Path(data) / "truth.yaml"
    if not given and file.exists():
        for line in file.read_text(encoding="utf-8").splitlines():
            match = re.search(r"kind: dark,.* start_ns: (\d+), end_ns: (\d+)", line)
            if match:
                spells.append((int(match[1]), int(match[2])))
    if not spells:
        raise SweepError(f"{data}: its truth tells no dark spell; give --dark BEGIN,END")
    return tuple(spells)


BLENDS = {"vision": (True, False), "standstill": (False, True), "both": (True, True)}
BIAS_METRICS = ("window_deg_s", "filtered_deg_s", "mean_deg_s", "known")


@dataclasses.dataclass(frozen=True)
class BiasStudy:
    """The gyro's bias on a recording in the EuRoC layout whose truth holds it; parameters are options of GyroBiasOptions
    and `blend`: from vision, standstill or both.

    True attitudes, one in `every` seconds, stand for vision; the seed draws their errors of `vision_sigma` degrees an axis
    and where the first one is. Standstill is told by the IMU alone. Figures [deg/s], from the first estimate on:
    window_deg_s, the median size of the error before limit and low pass; filtered_deg_s, the root mean square after them;
    mean_deg_s, the size of the mean error after them. known: the share of the time with an estimate.
    """
    data: str
    every: float = 0.25
    vision_sigma: float = 0.05

    def __call__(self, parameters: Parameters, seed: int) -> typing.Dict[str, float]:
        from .motion import GyroBiasOptions, follow_gyro_bias

        values = dict(parameters)
        use_vision, use_standstill = BLENDS[str(values.pop("blend", "both"))]
        options = GyroBiasOptions(**nested({"use_vision": use_vision, "use_standstill": use_standstill, **values}))
        imu_t, gyro, standing, noise, truth_t, truth = read_inertial(self.data)
        random = np.random.default_rng(seed)
        step = max(1, round(self.every * 1e9 / float(np.median(np.diff(truth_t)))))
        chosen = slice(int(random.integers(step)), None, step)
        attitudes = truth[chosen, 3:7][:, [1, 2, 3, 0]]
        turned = np.radians(self.vision_sigma) * random.standard_normal((len(attitudes), 3)) / 2
        followed = follow_gyro_bias(imu_t, gyro, truth_t[chosen], turned_by(attitudes, turned), standing, noise, options)
        known = np.isfinite(followed["target"][:, 0])
        figures = {name: math.nan for name in BIAS_METRICS}
        figures["known"] = float(known.mean())
        if known.any():
            bias = truth[chosen, 10:13]
            window = np.degrees(followed["target"] - bias)[known]
            filtered = np.degrees(followed["bias"] - bias)[known]
            figures["window_deg_s"] = float(np.median(np.linalg.norm(window, axis=1)))
            figures["filtered_deg_s"] = float(np.sqrt((filtered**2).sum(1).mean()))
            figures["mean_deg_s"] = float(np.linalg.norm(filtered.mean(0)))
        return figures


def turned_by(q: Floats, half: Floats) -> Floats:
    """Quaternions x y z w, turned on the right by small angles of twice `half` [rad]."""
    turn = np.hstack([half, np.ones((len(half), 1))])
    w = q[:, 3:] * turn[:, 3:] - (q[:, :3] * turn[:, :3]).sum(1, keepdims=True)
    v = q[:, 3:] * turn[:, :3] + turn[:, 3:] * q[:, :3] + np.cross(q[:, :3], turn[:, :3])
    product = np.hstack([v, w])
    return np.asarray(product / np.linalg.norm(product, axis=1, keepdims=True))


def read_table(file: pathlib.Path) -> typing.Tuple[numpy.typing.NDArray[np.int64], Floats]:
    """Stamps [ns] and numbers of a table with commas."""
    rows = [line.split(",") for line in file.read_text(encoding="utf-8").splitlines() if line and line[0] != "#"]
    return np.array([int(row[0]) for row in rows], np.int64), np.array([row[1:] for row in rows], float)


@functools.lru_cache(maxsize=1)
def read_inertial(data: str) -> typing.Tuple[typing.Any, ...]:
    """Stamps and readings of the gyro, whether it stands, its noise, stamps and rows of the truth."""
    from .motion import ImuNoise, detect_standstill

    folder = pathlib.Path(data) / "mav0"
    imu_t, imu = read_table(folder / "imu0/data.csv")
    truth_t, truth = read_table(folder / "state_groundtruth_estimate0/data.csv")
    text = (folder / "imu0/sensor.yaml").read_text(encoding="utf-8")

    def density(name: str) -> float:
        match = re.search(name + r":\s*([0-9.eE+-]+)", text)
        if not match:
            raise SweepError(f"{folder / 'imu0/sensor.yaml'}: has no {name}")
        return float(match[1])

    noise = ImuNoise(*map(density, ("gyroscope_noise_density", "gyroscope_random_walk", "accelerometer_noise_density",
                                    "accelerometer_random_walk")))
    rate = 1e9 / float(np.median(np.diff(imu_t)))
    standing = detect_standstill(imu_t, imu[:, :3], imu[:, 3:6], noise=noise, imu_rate=rate)
    return imu_t, imu[:, :3], standing.astype(np.int64), noise, truth_t, truth


DIRECTION_METRICS = ("answered", "right", "error_deg", "seconds")


@dataclasses.dataclass(frozen=True)
class DirectionStudy:
    """The main direction by threshold and window length over cached results of frames, from random starts that the seed
    draws; parameters are `threshold` and `window`. Figures: those of sweepkit.direction_study.study."""
    caches: typing.Tuple[str, ...]
    starts: int = 100

    def __call__(self, parameters: Parameters, seed: int) -> typing.Dict[str, float]:
        from .direction_study import study

        frames, truth = [], []
        for cache in self.caches:
            with np.load(cache) as content:
                frames.append(content["frames"])
                truth.append(functools.partial(_angle_at, content["frames"]["t"], content["truth"])
                             if len(content["truth"]) else None)
        row = study(frames, truth, [float(parameters["threshold"])], [int(parameters["window"])], self.starts, seed=seed)[0]
        return {name: row[name] for name in DIRECTION_METRICS}


def _angle_at(stamps: numpy.typing.NDArray[np.int64], angles: Floats, t: int) -> float:
    return float(angles[int(np.searchsorted(stamps, t))])


def cache_directions(data: str, cache: pathlib.Path, has_direction: bool = True) -> None:
    """What each frame of a recording says, with the true angle there, into a file, unless that is there already."""
    from .direction import recording_directions

    if cache.exists():
        return
    frames = recording_directions(data)
    truth = true_directions(pathlib.Path(data), frames["t"]) if has_direction else np.zeros(0)
    cache.parent.mkdir(parents=True, exist_ok=True)
    new = cache.with_name("new_" + cache.name)
    np.savez_compressed(new, frames=frames, truth=truth)
    new.replace(cache)


def true_directions(data: pathlib.Path, stamps: numpy.typing.NDArray[np.int64]) -> Floats:
    """The room's direction from the left camera's forward axis at each stamp [rad], by truth.yaml and the true poses."""
    def find(file: pathlib.Path, pattern: str) -> str:
        match = re.search(pattern, file.read_text(encoding="utf-8"), re.DOTALL)
        if not match:
            raise SweepError(f"{file}: tells no main direction of a recording")
        return match[1]

    room = np.radians(float(find(data / "truth.yaml", r"yaw_world_deg:\s*([-0-9.]+)")))
    mounting = np.array(find(data / "mav0/cam0/sensor.yaml", r"T_BS:.*?data:\s*\[([^]]*)\]").split(","), float)
    forward = mounting.reshape(4, 4)[:3, 2]
    t, poses = read_table(data / "mav0/state_groundtruth_estimate0/data.csv")
    w, v = poses[:, 3:4], poses[:, 4:7]
    turned = forward + 2 * np.cross(v, np.cross(v, forward) + w * forward)
    yaw = np.unwrap(np.arctan2(turned[:, 1], turned[:, 0]))
    return np.asarray(room - np.interp((stamps - t[0]).astype(float), (t - t[0]).astype(float), yaw))
