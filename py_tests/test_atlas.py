# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from sweepkit.core import Error
from sweepkit.data import read_atlas, write_atlas
from sweepkit.geometry import SE3d, StereoRig, Camera, Distortion
from sweepkit.map import Atlas
from sweepkit.slam import MapCaps, choose_culls, count_views


def make_rig(fx=400.0):
    camera = Camera([fx, 400, 320, 200], Distortion.none, [], 640, 400)
    right = np.eye(4)
    right[0, 3] = 0.12
    return StereoRig(camera, camera, np.eye(4), right)


@pytest.fixture
def atlas():
    """Five keyframes along x, each seeing the points of the one before and some of its own."""
    random = np.random.default_rng(1)
    atlas = Atlas(make_rig())
    world = atlas.map
    number = world.add_map()
    parent, before = None, []
    for k in range(5):
        T = np.eye(4)
        T[0, 3] = -k
        measurements = np.abs(random.normal(100, 10, (20, 7))).astype(np.float32)
        measurements[:, 6] = random.integers(0, 8, 20)
        keyframe = world.add_keyframe(number, 1000 * k, SE3d(T), measurements,
                                      random.integers(0, 256, (20, 32), dtype=np.uint8), parent)
        for i, point in enumerate(before):
            assert world.add_observation(point, keyframe, i)
        before = [world.add_point(random.normal(size=3), keyframe, i) for i in range(len(before), len(before) + 6)]
        parent = keyframe
    return atlas


def test_an_atlas_comes_back(atlas, tmp_path):
    atlas.vocabulary, atlas.vocabulary_checksum = "words", 2**63 + 1
    atlas.disparity_bias = 0.125
    atlas.gravity_known = [True]
    atlas.attachments = {"scans": {0: b"abc", 3: b""}}
    write_atlas(tmp_path / "atlas.swk", atlas)
    back = read_atlas(tmp_path / "atlas.swk")
    for name in ("keyframe_ids", "keyframe_maps", "keyframe_times", "keyframe_poses", "point_ids", "points",
                 "observations", "covisibility", "parents"):
        np.testing.assert_array_equal(getattr(back.map, name), getattr(atlas.map, name), err_msg=name)
    for k in atlas.map.keyframe_ids:
        np.testing.assert_array_equal(back.map.measurements(k), atlas.map.measurements(k))
        np.testing.assert_array_equal(back.map.descriptors(k), atlas.map.descriptors(k))
    assert (back.vocabulary, back.vocabulary_checksum, back.disparity_bias) == ("words", 2**63 + 1, 0.125)
    assert back.gravity_known == [True]
    assert back.attachments == atlas.attachments == {"scans": {0: b"abc", 3: b""}}
    assert back.software and back.map.broken_invariant() is None


def test_arrays_tell_the_map(atlas):
    world = atlas.map
    assert world.keyframe_ids.tolist() == [0, 1, 2, 3, 4]
    np.testing.assert_allclose(world.keyframe_poses[:, 0, 3], [0, 1, 2, 3, 4], atol=1e-12)
    assert world.points.shape == (30, 3) and world.point_count == 30
    assert world.observations.shape == (54, 3)
    assert world.covisibility.tolist() == [[k, k + 1, 6] for k in range(4)]
    assert world.parents.tolist() == [[k + 1, k] for k in range(4)]
    edges, motions = world.odometry
    assert edges.shape == (0, 2) and motions.shape == (0, 4, 4)
    assert world.memory_bytes() > 5 * 20 * 60
    with pytest.raises(ValueError, match="measurements|shape"):
        world.add_keyframe(0, 0, SE3d(), np.zeros((3, 5), np.float32), np.zeros((3, 32), np.uint8))
    with pytest.raises(ValueError, match="one descriptor for each measurement"):
        world.add_keyframe(0, 0, SE3d(), np.zeros((3, 7), np.float32), np.zeros((2, 32), np.uint8))


def test_damage_and_other_rigs_are_named(atlas, tmp_path):
    path = tmp_path / "atlas.swk"
    write_atlas(path, atlas)
    whole = path.read_bytes()
    path.write_bytes(whole[:-1])
    with pytest.raises(Error, match="atlas.swk: is cut short"):
        read_atlas(path)
    path.write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]))
    with pytest.raises(Error, match="section points, byte .*is damaged"):
        read_atlas(path)
    with pytest.raises(Error, match="cannot be opened"):
        read_atlas(tmp_path / "none.swk")
    with pytest.raises(Error, match="cannot be written"):
        write_atlas(tmp_path / "none" / "atlas.swk", atlas)
    assert atlas.rig_difference(make_rig()) is None
    assert atlas.rig_difference(make_rig(410)) == "left fx: 400 there, 410 here (tolerance 0.001 px)"


def test_culling_keeps_views(atlas):
    caps = MapCaps(max_keyframes=3, slack=0, cell=2)
    assert count_views(atlas.map, caps) == 3
    culls = choose_culls(atlas.map, caps, keep=[4])
    assert len(culls) == 2 and not {0, 4} & set(culls.tolist())
    for k in culls:
        atlas.map.remove_keyframe(k)
    assert count_views(atlas.map, caps) == 3
    assert len(choose_culls(atlas.map, caps)) == 0
