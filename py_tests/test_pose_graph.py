# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
import sweepkit as sk
from sweepkit.graph_plots import plot_pose_graph

solve = sk.solve


def row(T):
    return np.concatenate([T.translation(), T.rotation().quaternion()])


def rounds(nodes=60, a_round=20, loops=6, seed=1, wrong=()):
    """Rounds of a circle from a chain of measured motions, with loops, as arrays; and the truth."""
    random = np.random.default_rng(seed)
    SE3d, SO3d = sk.geometry.SE3d, sk.geometry.SO3d
    truth = []
    for k in range(nodes):
        a = 2 * np.pi * k / a_round
        truth.append(SE3d(SO3d.exp([0, 0, a]), [2 * np.cos(a), 2 * np.sin(a), 0.0]))
    sigma = np.array([0.01] * 3 + [0.005] * 3)
    pairs = [(k - 1, k) for k in range(1, nodes)] + [(k, k + a_round) for k in range(2, 2 + loops)] + list(wrong)
    measured = [truth[i].inverse() * truth[j] * SE3d.exp(random.normal(0, sigma)) for i, j in pairs]
    for k in range(len(wrong)):
        measured[-1 - k] = SE3d.exp(random.normal(0, 0.4, 6))
    start = [truth[0]]
    for k in range(nodes - 1):
        start.append(start[-1] * measured[k])
    return {
        "poses": np.array([row(T) for T in start]), "edges": np.array(pairs), "measurements": np.array([row(T) for T in measured]),
        "information": np.tile(np.diag(sigma ** -2.0), (len(pairs), 1, 1)), "fixed": np.arange(nodes) == 0,
        "robust": np.arange(len(pairs)) >= nodes - 1,
    }, np.array([row(T) for T in truth])


def test_a_graph_of_arrays_is_solved_and_wrong_loops_are_rejected():
    arrays, truth = rounds(wrong=[(5, 42), (11, 33), (57, 14)])
    graph = solve.PoseGraph(**arrays)
    assert repr(graph) == "<PoseGraph: 60 nodes, 68 edges>"
    for name, given in arrays.items():
        assert np.allclose(getattr(graph, name), given)
    result = solve.solve_pose_graph(graph, solve.PoseGraphOptions(covariances=True))
    assert result.usable and result.converged and result.components == 1
    assert list(result.rejected) == [65, 66, 67]
    assert np.all(result.weight[65:] == 0) and np.all(result.weight[:65] == 1)
    assert np.all(result.contradiction[65:] > 22.5) and np.all(result.contradiction[:59] == 0)
    before = np.linalg.norm(graph.poses[:, :3] - truth[:, :3], axis=1)
    after = np.linalg.norm(result.poses[:, :3] - truth[:, :3], axis=1)
    assert np.sqrt((after ** 2).mean()) < 0.7 * np.sqrt((before ** 2).mean())
    assert result.covariance.shape == (60, 6, 6) and not result.covariance[0].any()
    assert np.all(np.linalg.eigvalsh(result.covariance[30]) > 0)
    clean = {name: (value[:65] if len(value) == 68 else value) for name, value in arrays.items()}
    assert np.allclose(solve.solve_pose_graph(solve.PoseGraph(**clean)).poses, result.poses, atol=1e-6)


def test_poses_may_be_matrices_and_yaw_keeps_the_tilt():
    arrays, _ = rounds()
    matrices = np.array([sk.geometry.SE3d(sk.geometry.SO3d.from_quaternion(p[3:]), p[:3]).matrix() for p in arrays["poses"]])
    arrays["poses"] = matrices
    graph = solve.PoseGraph(**arrays, up_world=[0, 0, 1])
    result = solve.solve_pose_graph(graph, solve.PoseGraphOptions(freedom="yaw"))
    for before, after in zip(graph.poses, result.poses):
        up = [sk.geometry.SO3d.from_quaternion(p[3:]).inverse() * np.array([0, 0, 1.0]) for p in (before, after)]
        assert np.allclose(*up, atol=1e-12)


def test_similarities_correct_a_scale_that_drifts():
    nodes = 30
    Sim3d, SO3d = sk.geometry.Sim3d, sk.geometry.SO3d
    step = Sim3d(SO3d.exp([0, 0, 2 * np.pi / nodes]), [0.5, 0, 0], 1.0)
    drifting = Sim3d(step.rotation(), step.translation(), 1.01)
    poses = [Sim3d()]
    for _ in range(nodes - 1):
        poses.append(poses[-1] * drifting)
    pairs = [(k, k + 1) for k in range(nodes - 1)] + [(nodes - 1, 0)]
    rows = [np.append(row_of(T), T.scale()) for T in poses]
    motions = [np.append(row_of(T), T.scale()) for T in [drifting] * (nodes - 1) + [step]]
    graph = solve.SimilarityGraph(rows, pairs, motions, np.tile(100 * np.eye(7), (nodes, 1, 1)), np.arange(nodes) == 0)
    result = solve.solve_pose_graph(graph)
    assert result.usable and result.poses.shape == (nodes, 8)
    assert result.final_cost < 0.1 * result.initial_cost
    assert abs(result.poses[-1, 7] - 1) < 0.5 * abs(graph.poses[-1, 7] - 1)


def row_of(T):
    return np.concatenate([T.translation(), T.rotation().quaternion()])


def test_wrong_arrays_are_named():
    arrays, _ = rounds()
    for name, value, message in [
            ("poses", np.zeros((3, 6)), r"expected float64 of shape \(n, 7\)"), ("edges", [[0, 1]], "one entry for each edge"),
            ("edges", arrays["edges"] + 0.5, "expected int32"), ("information", np.zeros((65, 3, 3)), r"\(n, 6, 6\)"),
            ("fixed", [True], "fixed must have one entry for each pose"), ("robust", [True], "robust"),
            ("poses", np.zeros((60, 7)), "quaternion")]:
        with pytest.raises(ValueError, match=message):
            solve.PoseGraph(**{**arrays, name: value})
    broken = {**arrays, "information": arrays["information"].copy()}
    broken["information"][7] = 0
    with pytest.raises(ValueError, match="edge 7.*positive definite"):
        solve.solve_pose_graph(solve.PoseGraph(**broken))


def test_g2o_files_go_out_and_in(tmp_path):
    arrays, _ = rounds()
    graph = solve.PoseGraph(**arrays)
    sk.data.write_g2o(tmp_path / "a.g2o", graph, ids=10 * np.arange(60))
    read, ids = sk.data.read_g2o(tmp_path / "a.g2o", robust_loops=True)
    assert list(ids) == list(range(0, 600, 10))
    assert np.allclose(read.poses, graph.poses, atol=1e-15) and np.array_equal(read.information, graph.information)
    assert np.all(read.robust)  # no ids are neighbours
    in_vectors, _ = sk.data.read_g2o(tmp_path / "a.g2o", rotation="vector")
    assert np.allclose(in_vectors.information[:, 3:, 3:], 4 * graph.information[:, 3:, 3:])
    with pytest.raises(ValueError, match="euler"):
        sk.data.read_g2o(tmp_path / "a.g2o", rotation="euler")
    (tmp_path / "b.g2o").write_text("VERTEX_SE3:QUAT 0 0 0 0 0 0 0 inf\n")
    with pytest.raises(sk.Error, match="b.g2o:1.*inf"):
        sk.data.read_g2o(tmp_path / "b.g2o")


def test_a_graph_is_drawn_before_and_after(tmp_path):
    arrays, _ = rounds(wrong=[(5, 42)])
    graph = solve.PoseGraph(**arrays)
    result = solve.solve_pose_graph(graph)
    figure = plot_pose_graph(graph, result, tmp_path / "graph.png", "rounds")
    assert (tmp_path / "graph.png").stat().st_size > 5000
    assert [panel.get_title().split(":")[0] for panel in figure.axes] == ["before", "after"]
    assert len(plot_pose_graph(graph).axes) == 1
