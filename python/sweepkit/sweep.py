# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
"""Parameter sweeps: python -m sweepkit.sweep STUDY --out DIR [options]; --help of a study tells what it measures.

Exit codes: 0 done; 1 some points failed, named in the table; 2 wrong usage or options; 3 unreadable or wrong data; 77
skipped, for there are no recordings; 130 stopped by Ctrl-C, results so far written: the same command goes on from there.
"""

import argparse
import os
import pathlib
import sys
import typing

from .core import Error
from .sweep_studies import (BIAS_METRICS, BLENDS, DIRECTION_METRICS, BiasStudy, DirectionStudy, SystemStudy,
                            cache_directions, dark_spells, evaluation_figures, read_grid, read_inertial)
from .sweeping import Measure, ProgressLine, Sweep, SweepError, Value, dask, draw, local, text_table

Grid = typing.Dict[str, typing.List[Value]]
Study = typing.Tuple[Measure, Grid, typing.Sequence[str], typing.Dict[str, typing.Any]]

BETA = {"tracker.blind_keyframe.distance": ["0.03", "0.1", "0.3", "1"], "tracker.blind_keyframe.angle": ["3", "10", "30"]}
BIAS = {"window_length": ["3.5", "5", "10", "20"], "time_constant": ["0", "2", "5", "20"]}
DIRECTION = {"threshold": [f"{k / 10}" for k in range(11)], "window": ["20", "50", "100"]}


class NoRecordings(Exception):
    """Neither --data nor SWEEPKIT_DATA."""


def recordings(given: typing.Sequence[str], defaults: typing.Sequence[str]) -> typing.List[str]:
    """Folders from the command line, else default ones below that which SWEEPKIT_DATA names."""
    root = os.environ.get("SWEEPKIT_DATA")
    if not given and not root:
        raise NoRecordings("skipped: SWEEPKIT_DATA is unset and no --data is given")
    folders = list(given) or [os.path.join(str(root), name) for name in defaults]
    for folder in folders:
        if not os.path.isdir(folder):
            raise SweepError(f"{folder}: there is no such folder")
    return [os.path.abspath(folder) for folder in folders]


def recording_with_truth(args: argparse.Namespace, default: str) -> str:
    """The one recording of a study of the whole system."""
    from .data import read_trajectory

    data, = recordings(args.data[-1:], [default])
    read_trajectory(data)  # or nothing could be measured
    return data


def system_grid(given: typing.Sequence[str], defaults: typing.Mapping[str, typing.Sequence[str]]) -> Grid:
    """Options of sweepkit.run by path."""
    from .system import RunOptions

    grid = read_grid(RunOptions.describe(), given, defaults)
    for path in ("data_path", "save_path"):
        if path in grid:
            raise SweepError(f"{path}: a sweep sets this itself")
    return grid


def beta(args: argparse.Namespace) -> Study:
    """The rule that makes keyframes of a robot that sees nothing, beta = distance / a + angle / b > 1: error of the whole
    optimized trajectory, and at the end of the dark spells."""
    data = recording_with_truth(args, "sweephome/dev02")
    metrics = ("ape_rmse_m", "dark_end_m", "dark_end_optimized_m", "keyframes")
    grid = system_grid(args.set, BETA)
    study = SystemStudy(data, metrics, spells=dark_spells(data, args.dark), jitter=args.jitter)
    return study, grid, metrics, {"data": data, "spells": study.spells, "jitter": args.jitter}


def options(args: argparse.Namespace) -> Study:
    """Any options of sweepkit.run by path (--set, several times), errors from the evaluation against truth."""
    if not args.set:
        raise SweepError("set: needs at least one PATH=VALUE,VALUE,...")
    grid = system_grid(args.set, {})
    metrics, known = args.metrics.split(","), evaluation_figures()
    for name in metrics:
        if name not in known:
            raise SweepError(f"metrics: there is no {name}; there are {', '.join(known)}")
    data = recording_with_truth(args, "sweephome/dev01")
    study = SystemStudy(data, tuple(metrics), args.trajectory, jitter=args.jitter)
    return study, grid, metrics, {"data": data, "trajectory": args.trajectory, "jitter": args.jitter}


def bias_filter(args: argparse.Namespace) -> Study:
    """The gyro's bias by window, low pass, standstill and their blend, on a recording whose truth holds it."""
    from .motion import GyroBiasOptions

    choice = {"path": "blend", "type": "str", "choices": list(BLENDS)}
    grid = read_grid([*GyroBiasOptions.describe(), choice], args.set, {**BIAS, "blend": ["vision", "both"]})
    data, = recordings(args.data[-1:], ["sweephome/dev01"])
    read_inertial(data)
    study = BiasStudy(data, args.every, args.vision_sigma)
    return study, grid, BIAS_METRICS, {"data": data, "every": args.every, "vision_sigma": args.vision_sigma}


def main_direction(args: argparse.Namespace) -> Study:
    """The main direction by threshold and window length: share answered, share of the answers within 2 degrees, mean
    error, time until the answer. What the frames say is kept in DIR/frames and not computed again."""
    from .direction import MainDirectionOptions

    described = [field for field in MainDirectionOptions.describe() if field["path"] in DIRECTION]
    grid = read_grid(described, args.set, DIRECTION)
    without = recordings(args.without_direction, []) if args.without_direction else []
    folders = [*recordings(args.data, [f"sweephome/dev0{k}" for k in (1, 2, 3)]), *without]
    caches = []
    for number, folder in enumerate(folders):
        cache = args.out.resolve() / "frames" / f"{number}_{os.path.basename(folder)}.npz"
        if not cache.exists():
            print(f"frames of {folder} ...", file=sys.stderr)
        cache_directions(folder, cache, folder not in without)
        caches.append(str(cache))
    fixed = {"data": folders, "without_direction": without, "starts": args.starts}
    return DirectionStudy(tuple(caches), args.starts), grid, DIRECTION_METRICS, fixed


def parser() -> argparse.ArgumentParser:
    """The command line."""
    result = argparse.ArgumentParser("python -m sweepkit.sweep", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    studies = result.add_subparsers(metavar="STUDY", required=True)
    for make in (beta, bias_filter, main_direction, options):
        text = " ".join((make.__doc__ or "").split())
        one = studies.add_parser(make.__name__, help=text, description=text,
                                 formatter_class=argparse.ArgumentDefaultsHelpFormatter)
        one.set_defaults(make=make)
        one.add_argument("--data", action="append", default=[], metavar="DIR",
                         help="recording with truth; by default one of those that SWEEPKIT_DATA names")
        one.add_argument("--out", type=pathlib.Path, required=True, help="for the results; a sweep found there goes on")
        one.add_argument("--set", action="append", default=[], metavar="PATH=VALUE,...",
                         help="values of a parameter, in place of the study's own or besides; the first is drawn across")
        one.add_argument("--seeds", type=int, default=3, help="runs of each point")
        one.add_argument("--jobs", type=int, default=len(os.sched_getaffinity(0)), help="processes at a time here")
        one.add_argument("--scheduler", metavar="ADDRESS", help="run on the Dask cluster of that scheduler instead")
        if make in (beta, options):
            one.add_argument("--jitter", type=float, default=0.5, help="seeds but the first begin up to so much later [s]")
        if make is beta:
            one.add_argument("--dark", action="append", default=[], metavar="BEGIN,END",
                             help="dark spell [s from the first true pose]; by default those of truth.yaml")
        if make is options:
            one.add_argument("--metrics", default="ape_rmse_m,translation_error_percent_end,images_lost",
                             help="figures of evaluation.json, images_lost, keyframes, points, seconds")
            one.add_argument("--trajectory", choices=["live", "odom", "optimized"], default="optimized")
        if make is bias_filter:
            one.add_argument("--every", type=float, default=0.25, help="time from attitude to attitude [s]")
            one.add_argument("--vision-sigma", type=float, default=0.05, help="error of an attitude, each axis [deg]")
        if make is main_direction:
            one.add_argument("--without-direction", action="append", default=[], metavar="DIR",
                             help="recording of a room that has none: any answer is wrong")
            one.add_argument("--starts", type=int, default=100, help="random starts for each seed")
    return result


def main(arguments: typing.Optional[typing.Sequence[str]] = None) -> int:
    """Runs a study from its command line and gives the exit code."""
    args = parser().parse_args(arguments)
    try:
        for name in ("seeds", "jobs"):
            if getattr(args, name) < 1:
                raise SweepError(f"{name}: must be at least 1 (got {getattr(args, name)})")
        measure, grid, metrics, fixed = args.make(args)
        # What is asked for first is drawn across.
        first = [text.partition("=")[0] for text in args.set]
        grid = {path: grid[path] for path in [*first, *(path for path in grid if path not in first)]}
        fixed["study"] = args.make.__name__
        sweep = Sweep(measure, grid, metrics, args.out, range(1, args.seeds + 1), fixed)
        sweep.run(dask(args.scheduler) if args.scheduler else local(args.jobs), ProgressLine())
        draw(sweep, sweep.out / "sweep.png", f"{args.make.__name__}: median of {args.seeds} seeds, lowest to highest")
    except NoRecordings as none:
        print(none, file=sys.stderr)
        return 77
    except KeyboardInterrupt:
        print("\nstopped; the same command goes on from here", file=sys.stderr)
        return 130
    except SweepError as error:
        print(error, file=sys.stderr)
        return 2
    except (OSError, Error) as error:
        print(error, file=sys.stderr)
        return 2 if isinstance(error, ValueError) else 3
    print(text_table(sweep))
    print(", ".join(str(sweep.out / name) for name in ("sweep.csv", "summary.csv", "sweep.png")))
    for task, why in sweep.failures():
        named = " ".join(f"{name}={value}" for name, value in task.parameters.items())
        print(f"failed: {named} seed {task.seed}: {why}", file=sys.stderr)
    return 1 if sweep.failures() else 0


if __name__ == "__main__":
    sys.exit(main())
