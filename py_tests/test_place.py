# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

import sweepkit as sk
from sweepkit.slam import PlaceRecognizer, PlaceRecognizerOptions

FOCAL, CX, CY, BASELINE = 350.0, 320.0, 200.0, 0.1


def rig():
    camera = sk.geometry.Camera([FOCAL, FOCAL, CX, CY], "none", [], 640, 400)
    T_right = np.eye(4)
    T_right[0, 3] = BASELINE
    return sk.geometry.StereoRig(camera, camera, np.eye(4), T_right)


class Room:
    """Points in front of the camera, each with a descriptor of its own, and a map of one keyframe of them."""

    def __init__(self):
        self.random = np.random.default_rng(1)
        low, high = [-3, -2, 1.5], [3, 2, 5]
        self.points = self.random.uniform(low, high, (1500, 3))
        self.descriptors = self.random.integers(0, 256, (1500, 32), dtype=np.uint8)
        options = sk.bow.VocabularyTrainingOptions(depth=2, weighting="tf", threads=1)
        self.vocabulary = sk.bow.OrbVocabulary(sk.bow.train_vocabulary([self.descriptors], options))
        self.atlas = sk.map.Atlas(rig())
        self.map = self.atlas.map
        measurements, descriptors, shows = self.see(np.eye(4))
        self.keyframe = self.map.add_keyframe(self.map.add_map(), 0, sk.geometry.SE3d(np.eye(4)), measurements,
                                              descriptors)
        for i, k in enumerate(shows):
            self.map.add_point(self.points[k], self.keyframe, i)

    def see(self, T_camera_world):
        p = self.points @ T_camera_world[:3, :3].T + T_camera_world[:3, 3]
        z = p[:, 2]
        u, v = CX + FOCAL * p[:, 0] / z, CY + FOCAL * p[:, 1] / z
        shows = np.flatnonzero((z > 0.5) & (u > 0) & (u < 639) & (v > 0) & (v < 399))
        noise = self.random.normal(0, 0.3, (len(shows), 2))
        u, v, z = u[shows] + noise[:, 0], v[shows] + noise[:, 1], z[shows]
        n = len(shows)
        rows = np.column_stack([u, v, u - FOCAL * BASELINE / z, np.full(n, 0.3), np.full(n, 0.1), np.zeros(n),
                                np.zeros(n)])
        return rows.astype(np.float32), self.descriptors[shows], shows


def test_a_frame_is_located_and_a_strange_one_is_not():
    room = Room()
    recognizer = PlaceRecognizer(rig(), room.vocabulary,
                                 PlaceRecognizerOptions(database={"index_level": 1}))
    recognizer.follow(room.map)
    assert len(recognizer) == 1 and recognizer.memory_bytes > 0
    angle = 0.1
    T = np.eye(4)
    T[:3, :3] = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    T[:3, 3] = [0.1, -0.05, -0.2]
    measurements, descriptors, shows = room.see(T)
    groups = recognizer.candidates(room.map, measurements, descriptors)
    assert [group.best for group in groups] == [room.keyframe]
    down = np.array([0.0, 1.0, 0.0])
    for gravity in ({}, {"gravity_camera": T[:3, :3] @ down, "gravity_world": down}):
        recognizer.forget()
        place = recognizer.locate(room.map, 10**9, measurements, descriptors, **gravity)
        assert place is not None, recognizer.last_rejection
        assert np.abs(place.T_camera_world.matrix() - T).max() < 0.01
        assert place.candidate == room.keyframe and place.query is None
        assert place.pairs.shape[1] == 2 and len(place.pairs) > 80
        assert place.covariance.shape == (6, 6)
    recognizer.forget()
    strange = room.random.integers(0, 256, descriptors.shape, dtype=np.uint8)
    assert recognizer.locate(room.map, 2 * 10**9, measurements, strange) is None
    counts = recognizer.counts
    assert counts["queries"] == 3 and counts["accepted"] == 2
    assert set(counts) > {"few_matches", "no_pose", "flat", "ambiguous", "unconfirmed"}


def test_wrong_arguments_are_refused():
    room = Room()
    recognizer = PlaceRecognizer(rig(), room.vocabulary,
                                 PlaceRecognizerOptions(database={"index_level": 1}))
    measurements, descriptors, _ = room.see(np.eye(4))
    with pytest.raises(ValueError, match="shape"):
        recognizer.locate(room.map, 0, measurements[:, :5], descriptors)
    with pytest.raises(ValueError):
        recognizer.locate(room.map, 0, measurements, descriptors[:-1])
    with pytest.raises(ValueError, match="depth"):
        PlaceRecognizer(rig(), room.vocabulary, PlaceRecognizerOptions(database={"index_level": 9}))
