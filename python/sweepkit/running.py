# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
"""The whole system on a recording, in one call."""

import os
import typing

from .system import RunOptions, RunResult, run_recording


def run(data: typing.Union[str, "os.PathLike[str]"], out: typing.Union[str, "os.PathLike[str]"],
        progress: typing.Optional[typing.Callable[[int, int, bool], typing.Any]] = None,
        **options: typing.Any) -> RunResult:
    """Runs sweeper_robot's system on the recording in `data` and writes the result files into `out`.

    Options are those of RunOptions, groups as dicts: run(data, out, frontend={"orb": {"count": 800}}). `progress` is
    called with (images, total, lost) after each image.
    """
    return run_recording(RunOptions(data_path=os.fspath(data), save_path=os.fspath(out), **options), progress)
