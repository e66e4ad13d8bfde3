# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
"""The package as a whole: what ships with it, and that its stubs hold."""

import inspect
import pathlib
import shutil
import subprocess

import pytest

import sweepkit as sk

PACKAGE = pathlib.Path(sk.__file__).parent


def test_stubs_ship():
    assert (PACKAGE / "py.typed").exists()
    for folder in sk._core.folders:
        stub_text = (PACKAGE / f"{folder}.pyi").read_text()
        for name in vars(getattr(sk, folder)):
            if not name.startswith("_"):
                assert name in stub_text, f"{folder}.{name}"


def test_everything_public_is_documented():
    for folder in sk._core.folders:
        for name, value in vars(getattr(sk, folder)).items():
            if inspect.isclass(value):
                assert value.__doc__ and value.__doc__.strip(), f"{folder}.{name}"


USE = '''
import numpy as np
import sweepkit as sk
from sweepkit.feature import OrbExtractor, OrbOptions
from sweepkit.geometry import SE3d, align_se3

T: SE3d = SE3d.exp(np.zeros(6)) * SE3d()
x: float = sk.core.Random(3).uniform()
options = OrbOptions(count=500, scale_factor=1.5)
n: int = options.count
found = align_se3(np.zeros((5, 3)), np.zeros((5, 3)))
if found is not None:
    scale: float = found.scale
features = OrbExtractor(options).extract(np.zeros((9, 9), np.uint8))
'''


@pytest.mark.skipif(not shutil.which("mypy"), reason="mypy is not installed")
def test_stubs_hold(tmp_path):
    (tmp_path / "use.py").write_text(USE)
    (tmp_path / "misuse.py").write_text(USE + "OrbOptions(cuont=3)\nbad: str = options.count\n")

    def check(*names):
        command = [shutil.which("mypy"), "--strict", "--no-error-summary", "--cache-dir", str(tmp_path / "cache"), *names]
        return subprocess.run(command, cwd=tmp_path, stdout=subprocess.PIPE, text=True,
                              env={"MYPYPATH": str(PACKAGE.parent), "PATH": "/usr/bin:/bin"})

    good = check("use.py")
    assert good.returncode == 0, good.stdout
    bad = check("misuse.py")
    assert "cuont" in bad.stdout and "Incompatible types in assignment" in bad.stdout
