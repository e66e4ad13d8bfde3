# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
"""Pictures of pose graphs: before, after, and which edges were rejected."""

import importlib
import os
import typing

import numpy as np

from .solve import PoseGraph, PoseGraphResult

_PATH, _LOOP, _WRONG = "#2a78b5", "#3a9a5b", "#d1432f"


def _positions_in_plane(positions: typing.Any, up: typing.Any) -> typing.Any:
    """Coordinates across the vertical: x and y where it is z."""
    up = np.asarray(up) / np.linalg.norm(up)
    x = np.array([1.0, 0.0, 0.0]) - up[0] * up
    if np.linalg.norm(x) < 1e-3:
        x = np.array([0.0, 1.0, 0.0]) - up[1] * up
    x /= np.linalg.norm(x)
    return np.stack([positions @ x, positions @ np.cross(up, x)], 1)


def _draw_graph(panel: typing.Any, graph: PoseGraph, positions: typing.Any, rejected: typing.Set[int]) -> None:
    collections: typing.Any = importlib.import_module("matplotlib.collections")
    ends = positions[graph.edges]
    loops = graph.robust
    kinds = ((~loops, _PATH, 0.8, 0.9, "path"), (loops, _LOOP, 0.8, 0.8, "loops"), (loops, _WRONG, 1.6, 1.0, "rejected"))
    wrong = np.isin(np.arange(len(loops)), list(rejected))
    for (mask, colour, width, alpha, label), of_kind in zip(kinds, (True, ~wrong, wrong)):
        chosen = mask & of_kind
        if chosen.any():
            panel.add_collection(collections.LineCollection(ends[chosen], colors=colour, linewidths=width, alpha=alpha,
                                                            label=f"{label} ({int(chosen.sum())})"))
    fixed = positions[graph.fixed]
    panel.plot(fixed[:, 0], fixed[:, 1], "s", color="black", markersize=4)
    panel.autoscale_view()
    panel.set_aspect("equal", adjustable="datalim")
    panel.set(xlabel="x [m]", ylabel="y [m]")


def plot_pose_graph(graph: PoseGraph, result: typing.Optional[PoseGraphResult] = None,
                    file: typing.Union[None, str, "os.PathLike[str]"] = None, title: str = "") -> typing.Any:
    """Draws a graph from above, beside it what solve_pose_graph made of it: the path blue, loops green, rejected ones red,
    fixed nodes black. Returns the matplotlib figure; also writes it if a file is named."""
    canvas: typing.Any = importlib.import_module("matplotlib.figure")
    columns = 1 if result is None else 2
    figure = canvas.Figure(figsize=(5.0 * columns, 4.6), layout="constrained")
    panels = figure.subplots(1, columns, squeeze=False)[0]
    rejected: typing.Set[int] = set() if result is None else {int(edge) for edge in result.rejected}
    _draw_graph(panels[0], graph, _positions_in_plane(graph.poses[:, :3], graph.up_world), rejected)
    if result is not None:
        panels[0].set_title(f"before: cost {result.initial_cost:.4g}")
        _draw_graph(panels[1], graph, _positions_in_plane(result.poses[:, :3], graph.up_world), rejected)
        panels[1].set_title(f"after: cost {result.final_cost:.4g}")
    panels[-1].legend(loc="best", fontsize=8)
    if title:
        figure.suptitle(title)
    if file is not None:
        figure.savefig(file, dpi=110)
    return figure
