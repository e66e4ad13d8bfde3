# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
"""Parameter sweeps: any function over a grid of values and several seeds, in processes or on a Dask cluster.

A sweep leaves `sweep.csv` (a row for each point and seed), `summary.csv` (median, lowest and highest over the seeds),
`sweep.png` and `sweep.json` (what was swept) in its folder. It may be stopped at any time: what is in sweep.csv is not
done again, and the finished table does not tell how often it was stopped.
"""

import contextlib
import csv
import dataclasses
import importlib
import io
import itertools
import json
import math
import multiprocessing
import multiprocessing.connection
import os
import pathlib
import queue
import signal
import statistics
import sys
import time
import typing

Value = typing.Union[bool, int, float, str]
Parameters = typing.Mapping[str, Value]
Measure = typing.Callable[[Parameters, int], typing.Mapping[str, float]]
"""What is swept: parameters of a point and a seed to named figures. It goes to other processes, so it must pickle."""


class SweepError(Exception):
    """A sweep that cannot be done as it was asked for."""


@dataclasses.dataclass(frozen=True)
class Task:
    """A point of the grid with one seed."""
    parameters: Parameters
    seed: int

    @property
    def key(self) -> typing.Tuple[str, ...]:
        """What tells it from others, as in the table."""
        return tuple(text_of(value) for value in self.parameters.values()) + (str(self.seed),)


@dataclasses.dataclass(frozen=True)
class Outcome:
    """What became of a task: figures, or why there are none."""
    figures: typing.Mapping[str, float]
    error: str = ""


Results = typing.Generator[typing.Optional[typing.Tuple[int, Outcome]], None, None]
Executor = typing.Callable[[Measure, typing.Sequence[Task]], Results]
"""Does all tasks and gives their numbers and outcomes in any order, and None now and then while it waits."""


def text_of(value: Value) -> str:
    """A value as it stands in tables; reading it gives the same value again."""
    if isinstance(value, bool):
        return "true" if value else "false"
    return repr(value) if isinstance(value, float) else str(value)


def attempt(measure: Measure, task: Task) -> Outcome:
    """Does a task; what it raises becomes its error."""
    try:
        return Outcome({name: float(value) for name, value in measure(task.parameters, task.seed).items()})
    except Exception as error:  # whatever it is, the other points go on
        return Outcome({}, " ".join(f"{type(error).__name__}: {error}".split()))


def _attempt_in_process(connection: "multiprocessing.connection.Connection", measure: Measure, task: Task) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent, which ends us
    connection.send(attempt(measure, task))


def local(jobs: int) -> Executor:
    """On this machine, each task in a process of its own, `jobs` at a time: one that crashes takes no other with it."""

    def execute(measure: Measure, tasks: typing.Sequence[Task]) -> Results:
        # Fresh processes: a fork of this one would inherit its threads' locks.
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload([__name__])
        waiting = list(enumerate(tasks))[::-1]
        running: typing.Dict[typing.Any, typing.Tuple[int, typing.Any]] = {}
        try:
            while waiting or running:
                while waiting and len(running) < jobs:
                    number, task = waiting.pop()
                    receiver, sender = context.Pipe(duplex=False)
                    process = context.Process(target=_attempt_in_process, args=(sender, measure, task))
                    process.start()
                    sender.close()
                    running[receiver] = number, process
                ready = multiprocessing.connection.wait(list(running), timeout=1)
                for readable in ready:
                    ours = typing.cast(typing.Any, readable)
                    number, process = running.pop(ours)
                    try:
                        outcome = ours.recv()
                    except EOFError:
                        process.join()
                        outcome = Outcome({}, f"its process ended with exit code {process.exitcode}")
                    process.join()
                    yield number, outcome
                if not ready:
                    yield None
        finally:
            for _, process in running.values():
                process.terminate()
            for _, process in running.values():
                process.join()

    return execute


def dask(address: str, timeout: float = 10) -> Executor:
    """On the Dask cluster whose scheduler answers at that address within `timeout` seconds. Workers need this package and
    the same files; what a worker that dies was doing is done by others."""

    def execute(measure: Measure, tasks: typing.Sequence[Task]) -> Results:
        try:
            distributed: typing.Any = importlib.import_module("distributed")
        except ImportError as error:
            raise SweepError(f"a Dask cluster needs the Python package distributed: {error}") from error
        try:
            client = distributed.Client(address, timeout=timeout, set_as_default=False)
        except (OSError, ValueError) as error:
            raise SweepError(f"no Dask scheduler answers at {address}: {error}") from error
        with client:
            finished: "queue.Queue[typing.Any]" = queue.Queue()
            futures = [client.submit(attempt, measure, task, pure=False) for task in tasks]
            numbers = {future.key: number for number, future in enumerate(futures)}
            for future in futures:
                future.add_done_callback(finished.put)
            left = len(futures)
            while left:
                try:
                    future = finished.get(timeout=1)
                except queue.Empty:
                    if client.status != "running":
                        raise SweepError(f"the Dask scheduler at {address} is gone") from None
                    yield None
                    continue
                try:
                    outcome = future.result()
                except Exception as error:  # workers that died too often, or that lack the package
                    outcome = Outcome({}, " ".join(f"{type(error).__name__}: {error}".split()))
                if future.status == "cancelled":
                    raise SweepError(f"the Dask scheduler at {address} is gone")
                left -= 1
                yield numbers[future.key], outcome

    return execute


@dataclasses.dataclass(frozen=True)
class Point:
    """A point of the grid over its seeds."""
    parameters: Parameters
    figures: typing.Mapping[str, typing.Sequence[float]]  # finite ones, for each metric
    failed: int

    def median(self, metric: str) -> float:
        """Not-a-number without a figure."""
        return statistics.median(self.figures[metric]) if self.figures[metric] else math.nan

    def spread(self, metric: str) -> typing.Tuple[float, float]:
        """The lowest and the highest."""
        values = self.figures[metric] or (math.nan,)
        return min(values), max(values)


class Sweep:
    """A function over a grid of parameters and seeds, with its results in a folder.

    `parameters` are names with their values, the first varying slowest; `metrics` the figures that the function gives,
    `fixed` whatever else the results depend on: a folder that holds results of other settings is refused.
    """

    def __init__(self, measure: Measure, parameters: typing.Mapping[str, typing.Sequence[Value]],
                 metrics: typing.Sequence[str], out: typing.Union[str, "os.PathLike[str]"],
                 seeds: typing.Sequence[int] = (1,), fixed: typing.Optional[typing.Mapping[str, typing.Any]] = None):
        columns = [*parameters, "seed", *metrics, "error"]
        for name in columns:
            if columns.count(name) > 1:
                raise SweepError(f"{name}: this name is needed for one column only")
        for name, values in [*parameters.items(), ("seed", seeds)]:
            texts = [text_of(value) for value in values]
            if not texts:
                raise SweepError(f"{name}: no value is given")
            for text in texts:
                if texts.count(text) > 1:
                    raise SweepError(f"{name}: {text} is given twice")
        self.measure, self.metrics, self.out = measure, list(metrics), pathlib.Path(out)
        self.parameters = {name: list(values) for name, values in parameters.items()}
        self.seeds = list(seeds)
        self.fixed = json.loads(json.dumps(dict(fixed or {})))
        self.header = columns
        self.tasks = [Task(dict(zip(self.parameters, values)), seed)
                      for values in itertools.product(*self.parameters.values()) for seed in self.seeds]
        self.done: typing.Dict[typing.Tuple[str, ...], Outcome] = {}

    @property
    def table(self) -> pathlib.Path:
        """A row for each point and seed."""
        return self.out / "sweep.csv"

    def run(self, execute: Executor, progress: typing.Callable[[int, int, int], typing.Any] = lambda *_: None) -> None:
        """Does what is not done yet, points that failed before included; progress(done, total, failed) is called after
        each and about every second. Raises SweepError where the folder holds another sweep."""
        self.load()
        todo = [task for task in self.tasks if task.key not in self.done]
        count, failed = len(self.tasks) - len(todo), 0
        progress(count, len(self.tasks), failed)
        with open(self.table, "a", newline="", encoding="utf-8") as file:
            if file.tell() == 0:
                file.write(self._lines([self.header]))
            try:
                if todo:
                    with contextlib.closing(execute(self.measure, todo)) as results:
                        for result in results:
                            if result is not None:
                                number, outcome = result
                                outcome = self._complete(outcome)
                                self.done[todo[number].key] = outcome
                                file.write(self._lines([self._row(todo[number].key, outcome)]))
                                file.flush()
                                count, failed = count + 1, failed + bool(outcome.error)
                            progress(count, len(self.tasks), failed)
            finally:
                self._save()

    def failures(self) -> typing.List[typing.Tuple[Task, str]]:
        """Tasks that failed, and why."""
        return [(task, self.done[task.key].error) for task in self.tasks
                if task.key in self.done and self.done[task.key].error]

    def points(self) -> typing.List[Point]:
        """The grid, in its order, over the seeds that are done."""
        result = []
        for first in range(0, len(self.tasks), len(self.seeds)):
            tasks = self.tasks[first:first + len(self.seeds)]
            outcomes = [self.done[task.key] for task in tasks if task.key in self.done]
            figures = {name: [o.figures[name] for o in outcomes if not o.error and math.isfinite(o.figures[name])]
                       for name in self.metrics}
            result.append(Point(tasks[0].parameters, figures, sum(bool(o.error) for o in outcomes)))
        return result

    def load(self) -> None:
        """Reads what earlier runs left. A line that was cut off is left out, and so are points that failed."""
        self.out.mkdir(parents=True, exist_ok=True)
        about = self.out / "sweep.json"
        if about.exists():
            before = json.loads(about.read_text(encoding="utf-8"))
            for name in sorted({*before, *self.fixed}):
                if before.get(name) != self.fixed.get(name):
                    raise SweepError(f"{about}: holds a sweep with {name} {before.get(name)}, not {self.fixed.get(name)}; "
                                     "take another folder")
        self.done = {}
        if self.table.exists():
            whole = self.table.read_text(encoding="utf-8").rpartition("\n")
            rows = list(csv.reader(io.StringIO(whole[0])))
            if rows and rows[0] != self.header:
                raise SweepError(f"{self.table}: has the columns {', '.join(rows[0])}, not {', '.join(self.header)}; "
                                 "take another folder")
            named = len(self.parameters) + 1
            for row in rows[1:]:
                key = tuple(row[:named])
                if len(row) == len(self.header) and not row[-1]:
                    self.done[key] = Outcome(dict(zip(self.metrics, map(float, row[named:-1]))))
            if whole[2]:
                self._replace(self.table, whole[0] + whole[1])
        self._replace(about, json.dumps(self.fixed, indent=2) + "\n")

    def _complete(self, outcome: Outcome) -> Outcome:
        missing = [name for name in self.metrics if name not in outcome.figures]
        return Outcome({}, f"gave no {missing[0]}") if missing and not outcome.error else outcome

    def _row(self, key: typing.Tuple[str, ...], outcome: Outcome) -> typing.List[str]:
        figures = ["" if outcome.error else text_of(outcome.figures[name]) for name in self.metrics]
        return [*key, *figures, outcome.error]

    @staticmethod
    def _lines(rows: typing.Iterable[typing.Sequence[str]]) -> str:
        file = io.StringIO()
        csv.writer(file, lineterminator="\n").writerows(rows)
        return file.getvalue()

    @staticmethod
    def _replace(path: pathlib.Path, content: str) -> None:
        new = path.with_name(path.name + ".new")
        new.write_text(content, encoding="utf-8")
        os.replace(new, path)

    def _save(self) -> None:
        """The table in the grid's order, rows of other values of the parameters last; and its summary."""
        keys = [task.key for task in self.tasks if task.key in self.done]
        keys += sorted(set(self.done) - set(keys))
        self._replace(self.table, self._lines([self.header, *(self._row(key, self.done[key]) for key in keys)]))
        head = [*self.parameters, "seeds", "failed"]
        head += [f"{name}_{what}" for name in self.metrics for what in ("median", "low", "high")]
        rows = []
        for point in self.points():
            count = max((len(values) for values in point.figures.values()), default=0)
            row = [*map(text_of, point.parameters.values()), str(count), str(point.failed)]
            for name in self.metrics:
                row += [text_of(float(x)) for x in (point.median(name), *point.spread(name))]
            rows.append(row)
        self._replace(self.out / "summary.csv", self._lines([head, *rows]))


class ProgressLine:
    """Progress on stderr: a line that is rewritten on a terminal, else a line every 10 s and at the end."""

    def __init__(self, file: typing.Optional[typing.TextIO] = None):
        self.file = file or sys.stderr
        self.begin = self.told = time.monotonic()
        self.first: typing.Optional[int] = None

    def __call__(self, done: int, total: int, failed: int) -> None:
        """Tells it, if it is time to."""
        now = time.monotonic()
        if self.first is None:
            self.first = done
        terminal = self.file.isatty()
        if not terminal and now - self.told < 10 and done < total:
            return
        self.told = now
        line = f"{done}/{total} points" + (f", {failed} failed" if failed else "")
        fresh, seconds = done - self.first, now - self.begin
        if 0 < fresh and done < total:
            line += f"  {fresh / max(seconds, 1e-9):.2f}/s  left {seconds / fresh * (total - done):.0f} s"
        self.file.write(f"\r{line:<70}" + ("\n" if done == total else "") if terminal else line + "\n")
        self.file.flush()


def text_table(sweep: Sweep) -> str:
    """Medians with lowest and highest, for reading."""
    head = [*sweep.parameters, "failed", *sweep.metrics]
    rows = [head]
    for point in sweep.points():
        row = [*map(text_of, point.parameters.values()), str(point.failed)]
        for name in sweep.metrics:
            low, high = point.spread(name)
            row.append(f"{point.median(name):.4g}" + (f" [{low:.4g}, {high:.4g}]" if len(sweep.seeds) > 1 else ""))
        rows.append(row)
    widths = [max(len(row[k]) for row in rows) for k in range(len(head))]
    return "\n".join("  ".join(cell.rjust(width) for cell, width in zip(row, widths)) for row in rows)


def draw(sweep: Sweep, file: typing.Union[str, "os.PathLike[str]"], title: str = "") -> None:
    """Draws a panel for each metric: median over the seeds against the first parameter that varies, a line for each choice
    of the others (colour for the second, dashes for the rest), with a band from the lowest to the highest."""
    matplotlib: typing.Any = importlib.import_module("matplotlib")
    canvas: typing.Any = importlib.import_module("matplotlib.figure")

    varying = [name for name, values in sweep.parameters.items() if len(values) > 1] or list(sweep.parameters)[:1]
    across = varying[0]
    values = sweep.parameters[across]
    numeric = all(isinstance(v, (int, float)) and not isinstance(v, bool) for v in values)
    places = [float(v) for v in values] if numeric else [float(k) for k in range(len(values))]
    lines: typing.Dict[typing.Tuple[str, ...], typing.List[typing.Tuple[float, Point]]] = {}
    for point in sweep.points():
        others = tuple(f"{name} = {text_of(point.parameters[name])}" for name in varying[1:])
        lines.setdefault(others, []).append((places[values.index(point.parameters[across])], point))
    colours = list(dict.fromkeys(others[:1] for others in lines))
    styles = list(dict.fromkeys(others[1:] for others in lines))
    columns = min(2, len(sweep.metrics))
    height = math.ceil(len(sweep.metrics) / columns)
    figure = canvas.Figure(figsize=(5.2 * columns, 3.4 * height), layout="constrained")
    panels = figure.subplots(height, columns, squeeze=False).flatten()
    for panel, metric in zip(panels, sweep.metrics):
        for others, row in lines.items():
            colour = matplotlib.colormaps["viridis"](0.9 * colours.index(others[:1]) / max(1, len(colours) - 1))
            style = ("-", "--", ":", "-.")[styles.index(others[1:]) % 4]
            row = sorted(row, key=lambda pair: pair[0])
            x = [at for at, _ in row]
            spread = [point.spread(metric) for _, point in row]
            panel.plot(x, [point.median(metric) for _, point in row], "o", linestyle=style, markersize=3.5,
                       linewidth=1.3, color=colour, label=", ".join(others))
            if len(sweep.seeds) > 1:
                panel.fill_between(x, [low for low, _ in spread], [high for _, high in spread], color=colour, alpha=0.15,
                                   linewidth=0)
        panel.set(xlabel=across, ylabel=metric)
        figures = [value for point in sweep.points() for value in point.figures[metric]]
        if not figures:
            panel.text(0.5, 0.5, "no figures", transform=panel.transAxes, ha="center")
        elif min(figures) >= 0:
            panel.set_ylim(0, 1.08 * max(figures) or 1)
        if not numeric:
            panel.set_xticks(places, [text_of(v) for v in values])
        elif min(places) > 0 and max(places) >= 20 * min(places):
            panel.set_xscale("log")
        panel.grid(color="0.9")
    for panel in panels[len(sweep.metrics):]:
        panel.set_visible(False)
    if len(lines) > 1:
        figure.legend(*panels[0].get_legend_handles_labels(), loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=8)
    if title:
        figure.suptitle(title, fontsize=10)
    figure.savefig(file, dpi=110, bbox_inches="tight")
