# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

import sweepkit as sk
from sweepkit.data import FlatOptions, FloorPlan, Renderer, RendererOptions, Scene, to_gray, walking_person
from sweepkit.feature import OrbExtractor
from sweepkit.geometry import Camera, SE3d, SO3d


def look(x, y, z, yaw, pitch=0.05):
    """A camera there, looking along yaw, pitched down."""
    forward = np.array([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), -np.sin(pitch)])
    right = np.array([np.sin(yaw), -np.cos(yaw), 0])
    T = np.eye(4)
    T[:3, 0], T[:3, 1], T[:3, 2], T[:3, 3] = right, np.cross(forward, right), forward, (x, y, z)
    return SE3d(T)


@pytest.fixture(scope="module")
def flat():
    return Scene.generate(FlatOptions(seed=3, rooms=1))


@pytest.fixture(scope="module")
def view(flat):
    """A free place that looks into the room, and what a camera sees there."""
    plan = FloorPlan(flat)
    rng = np.random.default_rng(1)
    low, high = plan.low, plan.high
    while True:
        p = low + (high - low) * rng.uniform(size=2)
        yaw = rng.uniform(-np.pi, np.pi)
        ahead = np.array([p + d * np.array([np.cos(yaw), np.sin(yaw)]) for d in (0.0, 0.5, 1.0, 1.5)])
        if plan.clearance(ahead).min() > 0.2:
            break
    renderer = Renderer(flat, RendererOptions(light_texel=0.04, light_rays=16))
    camera = Camera([322, 322, 319, 199], sk.geometry.Distortion.radial_tangential, [-0.05, 0.01, 0, 0], 640, 400)
    T = look(p[0], p[1], 0.08 + plan.height([p])[0], yaw)
    return renderer, camera, T, renderer.render(camera, T)


def test_scenes_in_and_out(flat, tmp_path):
    flat.write(tmp_path / "scene.yaml")
    again = Scene.read(tmp_path / "scene.yaml")
    assert again.to_yaml() == flat.to_yaml()
    assert Scene.generate(FlatOptions(seed=3, rooms=1)).to_yaml() == flat.to_yaml()
    assert len(flat.rooms) == 1 and flat.rooms[0]["corners"].shape == (4, 2)
    assert {"class", "name", "label", "centre", "size", "yaw"} == set(flat.objects[0])
    with pytest.raises(sk.Error, match="scene:1: roomz: there is no such key; the nearest is rooms"):
        Scene.parse("roomz: []")
    assert "</svg>" in flat.to_svg([np.array([[0.0, 0.0], [1.0, 1.0]])])


def test_floor(flat, view):
    plan = FloorPlan(flat)
    x, y, _ = view[2].translation()
    assert plan.room_at([[x, y], [99, 99]]).tolist() == [0, -1]
    assert plan.clearance([[99.0, 99.0]])[0] < 0
    grid = flat.occupancy([x, y])
    assert set(np.unique(grid["cells"])) == {0, 205, 254}
    with pytest.raises(ValueError, match=r"float64 of shape \(n, 2\)"):
        plan.height([1.0, 2.0])


def test_views(view):
    renderer, camera, T, seen = view
    assert seen["radiance"].shape == seen["depth"].shape == seen["label"].shape == (400, 640)
    assert seen["radiance"].dtype == np.float32 and seen["label"].dtype == np.uint8
    assert (seen["label"] == 1).mean() > 0.1
    image = to_gray(seen["radiance"])
    assert image.dtype == np.uint8 and 60 < image.mean() < 130
    # Enough to hold on to, as in images of real rooms.
    assert len(OrbExtractor().extract(image)) > 400
    np.testing.assert_array_equal(renderer.render(camera, T)["radiance"], seen["radiance"])
    assert renderer.render(camera, T, lamps=0, daylight=0)["radiance"].max() == 0


def test_people(view):
    renderer, camera, T, _ = view
    x, y, _ = T.translation()
    ahead = T * np.array([0, 0, 1.0])
    person = walking_person(SE3d(SO3d(), [ahead[0], ahead[1], 0]), 0.2)
    assert (renderer.render(camera, T, moving=[person])["label"] == 20).mean() > 0.01
