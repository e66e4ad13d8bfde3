# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
"""The Python examples of the pages run as they stand."""

import pathlib
import re
import shutil

import numpy as np
import pytest
import sweepkit as sk

ROOT = pathlib.Path(__file__).resolve().parents[1]
PAGES = sorted((ROOT / "include/sweepkit").glob("*/README.md"))
EXAMPLES = [(page, code) for page in PAGES for code in re.findall(r"```python\n(.*?)```", page.read_text(), re.DOTALL)]


def names_given(images):
    """What the pages take as given: a rig, and the features and pyramids of a pair of images."""
    left, right = images
    camera = sk.geometry.Camera([200.0, 200.0, 160.0, 120.0], sk.geometry.Distortion.none, [], 320, 240)
    apart = sk.geometry.SE3d(sk.geometry.SO3d(), np.array([0.1, 0.0, 0.0]))
    orb = sk.feature.OrbExtractor()
    return {
        "sk": sk, "np": np, "rig": sk.geometry.StereoRig(camera, camera, sk.geometry.SE3d(), apart),
        "left": orb.extract(left), "left_pyramid": sk.image.ImagePyramid(left, levels=8, factor=1.2),
        "right": orb.extract(right), "right_pyramid": sk.image.ImagePyramid(right, levels=8, factor=1.2),
    }


def test_there_are_examples():
    assert len(EXAMPLES) >= 6


@pytest.mark.parametrize("page, code", EXAMPLES, ids=[page.parent.name for page, _ in EXAMPLES])
def test_example(page, code, recordings, textured, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("recording", "dev01"):
        (tmp_path / name).symlink_to(recordings / "euroc_still")
    if "live.tum" in code:
        sk.run("recording", "results")
        shutil.copy("results/trajectory_live.tum", "live.tum")
    exec(compile(code, str(page), "exec"), names_given(textured))
