# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
import pickle

import numpy as np
import pytest

from sweepkit.geometry import (Camera, PnpOptions, SE3d, SO3d, Side, Sim3d, StereoRig, align_se3, align_sim3,
                               interpolate, solve_p3p, solve_pnp, triangulate_linear, triangulate_midpoint)

XI = np.array([0.3, -0.2, 0.5, 0.1, 0.7, -0.4])


def test_groups():
    T = SE3d.exp(XI)
    np.testing.assert_allclose(T.log(), XI, atol=1e-14)
    np.testing.assert_allclose((T * T.inverse()).matrix(), np.eye(4), atol=1e-15)
    points = np.arange(12.0).reshape(4, 3)
    expected = points @ T.matrix()[:3, :3].T + T.matrix()[:3, 3]
    np.testing.assert_allclose(T * points, expected, atol=1e-14)
    np.testing.assert_allclose(T * points[1], expected[1], atol=1e-14)
    np.testing.assert_allclose(T * [1, 2, 3], T * np.array([1.0, 2.0, 3.0]))
    np.testing.assert_allclose(SE3d(T.matrix()).matrix(), T.matrix(), atol=1e-15)
    np.testing.assert_allclose(interpolate(SE3d(), T, 0.5).log(), XI / 2, atol=1e-14)
    np.testing.assert_allclose(pickle.loads(pickle.dumps(T)).matrix(), T.matrix(), atol=1e-15)
    S = Sim3d(T.rotation(), T.translation(), 2.0)
    np.testing.assert_allclose(S * points[2], 2 * (T.rotation() * points[2]) + T.translation(), atol=1e-14)
    assert SO3d.exp([0, 0, np.pi / 2]).angle() == pytest.approx(np.pi / 2)


def test_wrong_arrays_are_named():
    for wrong, told in ((np.zeros(5), r"\(6,\).*float64 of shape \(5,\)"), (np.zeros((6, 1)), r"shape \(6, 1\)"),
                        (["a"] * 6, "shape"), (np.zeros(6, complex), "complex128")):
        with pytest.raises(ValueError, match=told):
            SE3d.exp(wrong)
    with pytest.raises(ValueError, match=r"shape \(n, 3\), got float64 of shape \(4, 2\)"):
        align_se3(np.zeros((4, 2)), np.zeros((4, 2)))


def camera():
    return Camera([300, 300, 320, 200], "radial-tangential", [-0.1, 0.02, 0.001, -0.001], 640, 400)


def test_camera():
    c = camera()
    points = np.random.default_rng(0).uniform([-1, -1, 2], [1, 1, 5], (50, 3))
    pixels, seen = c.project_all(points)
    assert seen.all() and pixels.shape == (50, 2)
    rays, valid = c.unproject_all(pixels)
    assert valid.all()
    np.testing.assert_allclose(rays, points / points[:, 2:], atol=1e-9)
    np.testing.assert_allclose(c.project(points[0]), pixels[0])
    assert c.project([0, 0, -1]) is None
    _, J = c.project_jacobian(points[0])
    step = 1e-6 * np.eye(3)
    numeric = np.stack([(c.project(points[0] + d) - c.project(points[0] - d)) / 2e-6 for d in step], axis=1)
    np.testing.assert_allclose(J, numeric, atol=1e-6)
    with pytest.raises(RuntimeError) as caught:
        Camera([0, 300, 320, 200], "none", [], 640, 400)
    assert caught.value.kind == "calibration"
    with pytest.raises(ValueError, match="fisheye"):
        Camera([300, 300, 320, 200], "fisheye", [], 640, 400)


def test_stereo_rig():
    T_right = np.eye(4)
    T_right[0, 3] = 0.1
    rig = StereoRig(camera(), camera(), np.eye(4), T_right)
    assert rig.baseline == pytest.approx(0.1)
    pixels = np.random.default_rng(0).uniform([60, 40], [580, 360], (100, 2))
    rectified, valid = rig.rectify(Side.left, pixels)
    back, _ = rig.unrectify(Side.left, rectified)
    assert valid.all()
    np.testing.assert_allclose(back, pixels, atol=1e-7)
    uvd = rig.project_stereo([0.1, 0.2, 3.0])
    np.testing.assert_allclose(rig.point_from_disparity(uvd), [0.1, 0.2, 3.0], atol=1e-12)
    assert rig.point_from_disparity([0, 0, 0]) is None
    with pytest.raises(RuntimeError, match="baseline"):
        StereoRig(camera(), camera(), np.eye(4), np.eye(4))


def test_alignment_and_triangulation():
    points = np.random.default_rng(1).normal(size=(20, 3))
    T = SE3d.exp(XI)
    found = align_se3(points, T * points)
    np.testing.assert_allclose(found.T_dst_src.matrix(), T.matrix(), atol=1e-12)
    assert align_sim3(points, 2.5 * points).scale == pytest.approx(2.5)
    assert align_se3(np.zeros((5, 3)), np.zeros((5, 3))) is None
    p = np.array([0.3, -0.2, 4.0])
    T_a_b = SE3d(SO3d(), [0.5, 0, 0])
    result = triangulate_midpoint(T_a_b, p, T_a_b.inverse() * p)
    np.testing.assert_allclose(result.point, p, atol=1e-9)
    assert result.in_front and result.covariance.shape == (3, 3)
    both = triangulate_linear([SE3d(), T_a_b.inverse()], [p, T_a_b.inverse() * p])
    np.testing.assert_allclose(both.point, p, atol=1e-9)


def test_pnp_among_outliers():
    random = np.random.default_rng(2)
    T = SE3d.exp(XI)  # T_world_camera
    in_camera = random.uniform([-1, -1, 2], [1, 1, 6], (100, 3))
    rays = in_camera[:, :2] / in_camera[:, 2:]
    points = T * in_camera
    rays[:30] += random.uniform(-0.3, 0.3, (30, 2))
    result = solve_pnp(points, rays, 400.0, PnpOptions(threshold=1.0))
    np.testing.assert_allclose(result.T_world_camera.matrix(), T.matrix(), atol=1e-8)
    assert set(range(30, 100)) <= set(result.inliers.tolist())
    bearings = in_camera[40:43] / np.linalg.norm(in_camera[40:43], axis=1, keepdims=True)
    best = min(np.abs(pose.matrix() - T.inverse().matrix()).max() for pose in solve_p3p(points[40:43], bearings))
    assert best < 1e-8
