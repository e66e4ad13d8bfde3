# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
import csv
import json
import math
import os
import pathlib
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

import sweepkit as sk
from sweepkit.sweep import main
from sweepkit.sweep_studies import nested
from sweepkit.sweeping import Sweep, SweepError, dask, draw, local, text_table
from sweepkit.system import RunOptions

HERE = pathlib.Path(__file__).resolve().parent
PACKAGE = pathlib.Path(sk.__file__).parent
GRID = {"a": [1, 2, 3], "b": [0.1, 10.0], "kind": ["plain", "other"]}
METRICS = ["sum", "product"]


def cheap(parameters, seed):
    a, b = parameters["a"], parameters["b"]
    return {"sum": a + b + seed / 3, "product": a * b * seed}


def slow(parameters, seed):
    time.sleep(0.25)
    return cheap(parameters, seed)


def bad(parameters, seed):
    if parameters["a"] == 2 and seed == 1:
        raise ValueError("two\nis wrong")
    if parameters["a"] == 3 and seed == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    return {"sum": 1.0} if parameters["a"] == 1 and seed == 2 else cheap(parameters, seed)


def rows_of(file):
    with open(file, newline="") as text:
        return list(csv.DictReader(text))


def expected_rows():
    return [{"a": str(a), "b": repr(b), "kind": kind, "seed": str(seed), "error": "",
             **{name: repr(float(v)) for name, v in cheap({"a": a, "b": b}, seed).items()}}
            for a in GRID["a"] for b in GRID["b"] for kind in GRID["kind"] for seed in (1, 2)]


def test_local_run_equals_direct_evaluation(tmp_path):
    sweep = Sweep(cheap, GRID, METRICS, tmp_path, seeds=(1, 2), fixed={"about": "sums"})
    told = []
    sweep.run(local(2), lambda *state: told.append(state))
    assert rows_of(sweep.table) == expected_rows() and not sweep.failures()
    assert told[0] == (0, 24, 0) and told[-1] == (24, 24, 0)
    point = sweep.points()[-1]
    assert point.parameters == {"a": 3, "b": 10.0, "kind": "other"}
    assert point.median("product") == 45 and point.spread("product") == (30, 60)
    summary = rows_of(tmp_path / "summary.csv")
    assert len(summary) == 12 and summary[-1]["product_median"] == "45.0" and summary[-1]["seeds"] == "2"
    assert "[30, 60]" in text_table(sweep)
    draw(sweep, tmp_path / "sweep.png", "a title")
    assert (tmp_path / "sweep.png").read_bytes()[:4] == b"\x89PNG"


def test_interrupted_and_resumed_runs_give_the_same_table(tmp_path):
    whole = Sweep(cheap, GRID, METRICS, tmp_path / "whole", seeds=(1, 2))
    whole.run(local(2))
    parts = tmp_path / "parts"

    def stop(done, total, failed):
        if done >= begun + 7:
            raise KeyboardInterrupt

    begun = 0
    for _ in range(2):
        sweep = Sweep(cheap, GRID, METRICS, parts, seeds=(1, 2))
        with pytest.raises(KeyboardInterrupt):
            sweep.run(local(3), stop)
        begun += 7
        assert len(rows_of(sweep.table)) == begun
    # As if the machine had gone down while a line was written.
    with open(parts / "sweep.csv", "a") as file:
        file.write("3,10.0,oth")
    calls = []
    last = Sweep(cheap, GRID, METRICS, parts, seeds=(1, 2))
    last.run(lambda measure, tasks: (calls.extend(tasks), (yield from local(2)(measure, tasks)))[0])
    assert len(calls) == 24 - begun
    for name in ("sweep.csv", "summary.csv"):
        assert (parts / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
    again = Sweep(cheap, GRID, METRICS, parts, seeds=(1, 2))
    again.run(lambda measure, tasks: pytest.fail("nothing is left to do"))


def test_a_grid_may_grow_but_not_become_another(tmp_path):
    Sweep(cheap, {"a": [1], "b": [0.1]}, METRICS, tmp_path, fixed={"data": "x"}).run(local(1))
    more = Sweep(cheap, {"a": [1, 2], "b": [0.1]}, METRICS, tmp_path, fixed={"data": "x"})
    told = []
    more.run(local(1), lambda *state: told.append(state))
    assert told[0] == (1, 2, 0) and len(rows_of(more.table)) == 2
    with pytest.raises(SweepError, match="data x, not y"):
        Sweep(cheap, {"a": [1], "b": [0.1]}, METRICS, tmp_path, fixed={"data": "y"}).run(local(1))
    with pytest.raises(SweepError, match="columns"):
        Sweep(cheap, {"a": [1]}, METRICS, tmp_path, fixed={"data": "x"}).run(local(1))
    for wrong, match in (({"a": []}, "a: no value"), ({"a": [1, 1]}, "a: 1 is given twice"), ({"seed": [1]}, "seed")):
        with pytest.raises(SweepError, match=match):
            Sweep(cheap, wrong, METRICS, tmp_path)


def test_points_that_fail_are_recorded_and_tried_again(tmp_path):
    grid = {"a": [1, 2, 3], "b": [1.0]}
    sweep = Sweep(bad, grid, METRICS, tmp_path, seeds=(1, 2))
    sweep.run(local(2))
    errors = {(row["a"], row["seed"]): row["error"] for row in rows_of(sweep.table)}
    assert errors == {("1", "1"): "", ("1", "2"): "gave no product", ("2", "1"): "ValueError: two is wrong", ("2", "2"): "",
                      ("3", "1"): "", ("3", "2"): "its process ended with exit code -9"}
    assert len(sweep.failures()) == 3 and [point.failed for point in sweep.points()] == [1, 1, 1]
    assert sweep.points()[1].figures["sum"] == [cheap({"a": 2, "b": 1.0}, 2)["sum"]]
    draw(sweep, tmp_path / "sweep.png")
    mended = Sweep(cheap, grid, METRICS, tmp_path, seeds=(1, 2))
    mended.run(local(2))
    assert not mended.failures() and all(row["error"] == "" for row in rows_of(mended.table))


def test_figures_may_be_missing_numbers(tmp_path):
    sweep = Sweep(lambda p, s: {}, {"a": [1]}, ["m"], tmp_path, seeds=(1, 2))

    def execute(measure, tasks):
        from sweepkit.sweeping import Outcome
        yield 0, Outcome({"m": math.nan})
        yield 1, Outcome({"m": 2.0})

    sweep.run(execute)
    assert sweep.points()[0].median("m") == 2 and rows_of(sweep.table)[0]["m"] == "nan"


@pytest.fixture
def cluster(tmp_path):
    """A scheduler and two workers on loopback: its address and the workers."""
    if not shutil.which("dask-scheduler") or not shutil.which("dask-worker"):
        pytest.skip("python3-distributed is not installed")
    told = tmp_path / "scheduler.json"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(PACKAGE.parent), str(HERE)])}
    started = []

    def start(*command):
        started.append(subprocess.Popen(command, env=environment, cwd=tmp_path, stdout=subprocess.DEVNULL,
                                        stderr=subprocess.DEVNULL))
        return started[-1]

    def wait(ready):
        limit = time.monotonic() + 90
        while not ready():
            assert time.monotonic() < limit and all(process.poll() is None for process in started), "Dask does not start"
            time.sleep(0.2)

    try:
        start("dask-scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", told)
        wait(lambda: told.exists() and told.read_text().endswith("}"))
        address = json.loads(told.read_text())["address"]
        workers = [start("dask-worker", address, "--host", "127.0.0.1", "--nthreads", "1", "--no-nanny", "--no-dashboard",
                         "--local-directory", tmp_path) for _ in range(2)]
        import distributed
        with distributed.Client(address, timeout=60, set_as_default=False) as client:
            wait(lambda: len(client.scheduler_info()["workers"]) == 2)
        yield address, workers
    finally:
        for process in started:
            process.kill()
            process.wait()


def test_a_cluster_that_loses_a_worker_gives_every_result(cluster, tmp_path):
    address, workers = cluster
    sweep = Sweep(slow, GRID, METRICS, tmp_path / "out", seeds=(1, 2))
    killed = []

    def progress(done, total, failed):
        if done >= 5 and not killed:
            workers[0].send_signal(signal.SIGKILL)
            workers[0].wait()
            killed.append(done)

    sweep.run(dask(address), progress)
    assert killed and killed[0] < 20
    assert rows_of(sweep.table) == expected_rows()


def test_no_scheduler_is_told(tmp_path):
    pytest.importorskip("distributed")
    sweep = Sweep(cheap, {"a": [1], "b": [1.0]}, METRICS, tmp_path)
    with pytest.raises(SweepError, match="no Dask scheduler answers at nowhere:1"):
        sweep.run(dask("nowhere:1", timeout=1))


@pytest.mark.parametrize("arguments, told", [
    (["--set", "tracker.min_pts=8"], "tracker.min_pts: there is no such option; the nearest is tracker.min_points"),
    (["--set", "tracker.min_points=8,x"], "tracker.min_points: takes a value of type int (got x)"),
    (["--set", "tracker.min_points=8,2"], "tracker.min_points: must be in [4, 1000] (got 2)"),
    (["--set", "tracker.pose.loss=huber,hubert"], "tracker.pose.loss: must be one of quadratic, huber,"),
    (["--set", "realtime=1"], "realtime: takes a value of type bool (got 1)"),
    (["--set", "save_path=x"], "save_path: a sweep sets this itself"),
    (["--set", "tracker.min_points"], "tracker.min_points: must be PATH=VALUE"),
    (["--set", "tracker.min_points=8,8"], "tracker.min_points: 8 is given twice"),
    (["--set", "tracker.min_points=8", "--metrics", "ape"], "metrics: there is no ape; there are"),
    (["--set", "tracker.min_points=8", "--seeds", "0"], "seeds: must be at least 1"),
    (["--set", "tracker.min_points=8", "--data", "nowhere"], "nowhere: there is no such folder"),
    ([], "set: needs at least one"),
])
def test_wrong_options_are_named(arguments, told, tmp_path, capsys):
    (tmp_path / "mav0/state_groundtruth_estimate0").mkdir(parents=True)
    (tmp_path / "mav0/state_groundtruth_estimate0/data.csv").write_text("#t\n1,0,0,0,1,0,0,0\n2,0,0,0,1,0,0,0\n")
    assert main(["options", "--data", str(tmp_path), "--out", str(tmp_path / "out"), *arguments]) == 2
    assert told in capsys.readouterr().err
    assert not (tmp_path / "out" / "sweep.csv").exists()


def test_every_option_of_the_system_can_be_swept():
    for field in RunOptions.describe():
        made = RunOptions(**nested({field["path"]: field["default"]}))
        for name in field["path"].split("."):
            made = getattr(made, name)
        assert made == field["default"], field["path"]


def test_without_recordings_a_study_is_skipped(tmp_path, monkeypatch, capsys):
    monkeypatch.delenv("SWEEPKIT_DATA", raising=False)
    for study in ("beta", "bias_filter", "main_direction", "options"):
        given = ["--set", "tracker.min_points=8"] if study == "options" else []
        assert main([study, "--out", str(tmp_path / study), *given]) == 77
        assert "SWEEPKIT_DATA is unset" in capsys.readouterr().err


def test_options_of_the_system(recordings, tmp_path):
    arguments = ["options", "--data", str(recordings / "euroc_still"), "--set", "frontend.orb.count=300,800", "--set",
                 "recording.duration=1.0", "--seeds", "2", "--metrics", "ape_rmse_m,images_lost", "--out", str(tmp_path)]
    command = [sys.executable, "-m", "sweepkit.sweep", *arguments]
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                          env={**os.environ, "PYTHONPATH": str(PACKAGE.parent)})
    assert done.returncode == 0, done.stderr
    assert "4/4 points" in done.stderr and "frontend.orb.count" in done.stdout
    rows = rows_of(tmp_path / "sweep.csv")
    assert [row["frontend.orb.count"] for row in rows] == ["300", "300", "800", "800"]
    assert all(float(row["ape_rmse_m"]) < 0.01 and row["images_lost"] == "0.0" for row in rows)
    sk.run(recordings / "euroc_still", tmp_path / "one", recording={"duration": 1.0}, frontend={"orb": {"count": 300}})
    truth = sk.data.read_trajectory(recordings / "euroc_still")
    way = sk.data.read_trajectory(tmp_path / "one/trajectory_optimized.tum")
    assert float(rows[0]["ape_rmse_m"]) == sk.data.evaluate_trajectory(truth, way).ape_m["rmse"]
    # A point that fails does not stop the other: at that time the recording is over.
    assert main([*arguments[:-2], "--out", str(tmp_path / "late"), "--set", "recording.start=0,1e6", "--seeds", "1"]) == 1
    rows = rows_of(tmp_path / "late" / "sweep.csv")
    assert len(rows) == 4 and all((row["error"] == "") == (row["recording.start"] == "0.0") for row in rows)


def test_study_of_beta(recordings, tmp_path):
    code = main(["beta", "--out", str(tmp_path), "--seeds", "1", "--set", "tracker.blind_keyframe.distance=0.1,1", "--set",
                 "tracker.blind_keyframe.angle=10", "--set", "recording.duration=26"])
    assert code == 0
    rows = rows_of(tmp_path / "sweep.csv")
    assert len(rows) == 2 and all(float(row["dark_end_m"]) < 0.3 and float(row["ape_rmse_m"]) < 0.1 for row in rows)
    assert float(rows[0]["keyframes"]) > float(rows[1]["keyframes"]), "a shorter way makes more keyframes"


def test_study_of_the_bias_filter(recordings, tmp_path):
    code = main(["bias_filter", "--out", str(tmp_path), "--seeds", "2", "--set", "window_length=5,20", "--set",
                 "time_constant=0,10", "--set", "blend=vision"])
    assert code == 0
    points = {(row["window_length"], row["time_constant"]): row for row in rows_of(tmp_path / "summary.csv")}
    for row in points.values():
        assert float(row["known_median"]) > 0.9 and float(row["mean_deg_s_median"]) < 0.02
    longer, shorter = (float(points[k, "0.0"]["window_deg_s_median"]) for k in ("20.0", "5.0"))
    assert longer < shorter
    assert main(["bias_filter", "--out", str(tmp_path), "--set", "blend=wheels"]) == 2


def test_study_of_the_main_direction(tmp_path, monkeypatch):
    from sweepkit.direction import frame_direction_dtype

    frames = np.zeros(120, frame_direction_dtype)
    frames["t"] = np.arange(120) * 100_000_000
    for side in ("left", "right"):
        frames[side + "_angle"] = np.where(np.arange(120) % 2, 0.2, np.random.default_rng(1).uniform(-0.7, 0.7, 120))
        frames[side + "_sigma"], frames[side + "_confidence"], frames[side + "_found"] = 0.003, 0.99, 1
    folder = tmp_path / "sweephome"
    for k in (1, 2, 3):
        (folder / f"dev0{k}").mkdir(parents=True)
        (tmp_path / "out/frames").mkdir(parents=True, exist_ok=True)
        np.savez(tmp_path / f"out/frames/{k - 1}_dev0{k}.npz", frames=frames, truth=np.full(120, 0.2))
    monkeypatch.setenv("SWEEPKIT_DATA", str(tmp_path))
    code = main(["main_direction", "--out", str(tmp_path / "out"), "--set", "threshold=0,0.4,1", "--set", "window=20",
                 "--starts", "10", "--seeds", "2"])
    assert code == 0
    summary = rows_of(tmp_path / "out" / "summary.csv")
    assert [float(row["answered_median"]) for row in summary] == [1, 1, 0]
    assert float(summary[1]["right_median"]) == 1 and float(summary[1]["error_deg_median"]) < 0.2
    assert math.isnan(float(summary[2]["right_median"]))


@pytest.mark.skipif(not shutil.which("mypy"), reason="mypy is not installed")
def test_types_hold(tmp_path):
    command = [shutil.which("mypy"), "--strict", "--no-error-summary", "--cache-dir", str(tmp_path), "-m", "sweepkit.sweep"]
    done = subprocess.run(command, cwd=tmp_path, stdout=subprocess.PIPE, text=True,
                          env={"MYPYPATH": str(PACKAGE.parent), "PATH": "/usr/bin:/bin"})
    assert done.returncode == 0, done.stdout
