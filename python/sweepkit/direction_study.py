# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
"""How the share of right answers and of answers at all hangs on the threshold and on the length of the window."""

import typing

import numpy as np
import numpy.typing

from .direction import MainDirectionOptions, window_directions


def wrap_quarter_turn(angle: numpy.typing.ArrayLike) -> typing.Any:
    """Angles modulo 90 degrees in [-45, 45) degrees [rad]."""
    quarter = np.pi / 2
    return (np.asarray(angle) + quarter / 2) % quarter - quarter / 2


def study(frames: typing.Sequence[numpy.typing.NDArray[typing.Any]],
          truth: typing.Sequence[typing.Optional[typing.Callable[[int], float]]],
          thresholds: typing.Sequence[float] = tuple(np.arange(0.0, 1.01, 0.1)),
          windows: typing.Sequence[int] = (20, 50, 100), starts: int = 100, right: float = 2.0, seed: int = 1,
          options: typing.Optional[MainDirectionOptions] = None) -> typing.List[typing.Dict[str, float]]:
    """Replays recordings from random frames for each threshold and window length.

    `frames` are arrays of recording_directions, one a recording; `truth` gives for each the true angle [rad] at a stamp [ns],
    or is None for a room without a main direction, where every answer is wrong. `starts` are drawn over all recordings.
    Each row: threshold, window, runs, answered and right (shares of the runs and of the answers; right is within `right`
    degrees, nan without an answer), error_deg (mean of the answers), seconds (mean until the answer).
    """
    options = options or MainDirectionOptions()
    random = np.random.default_rng(seed)
    which = random.integers(0, len(frames), starts)
    begin = [int(random.integers(0, max(1, len(frames[k]) // 2))) for k in which]
    rows = []
    for window in windows:
        # One pass serves every threshold: windows do not depend on it.
        collected = options.replace(window=int(window), threshold=0.0)
        runs = [window_directions(frames[k], collected, start, max(thresholds)) for k, start in zip(which, begin)]
        for threshold in thresholds:
            errors, seconds = [], []
            for k, found in zip(which, runs):
                answer = next((w for w in found if w.confidence >= threshold), None)
                if answer is None:
                    continue
                seconds.append((answer.window_end - answer.run_begin) * 1e-9)
                angle = truth[k]
                errors.append(90.0 if angle is None else
                              abs(float(np.degrees(wrap_quarter_turn(answer.angle - angle(answer.window_begin))))))
            rows.append({
                "threshold": float(threshold), "window": int(window), "runs": starts, "answered": len(errors) / starts,
                "right": float(np.mean(np.asarray(errors) <= right)) if len(errors) else float("nan"),
                "error_deg": float(np.mean(errors)) if len(errors) else float("nan"),
                "seconds": float(np.mean(seconds)) if seconds else float("nan"),
            })
    return rows
