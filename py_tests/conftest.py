# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
"""Fixtures that several tests share. The package under test comes from PYTHONPATH (python/ of a build)."""

import os
import pathlib

import numpy as np
import pytest


@pytest.fixture
def recordings():
    """The folder of recordings; the test is skipped where SWEEPKIT_DATA is unset."""
    folder = os.environ.get("SWEEPKIT_DATA")
    if not folder:
        pytest.skip("SWEEPKIT_DATA is unset")
    return pathlib.Path(folder)


@pytest.fixture
def textured():
    """An image with corners at several scales, and the same scene moved 8 px to the left."""
    random = np.random.default_rng(1)
    wide = np.zeros((240, 328))
    for cell in (4, 8, 16, 32):
        coarse = random.random((240 // cell + 2, 328 // cell + 2))
        wide += np.kron(coarse, np.ones((cell, cell)))[:240, :328]
    wide = (wide / wide.max() * 255).astype(np.uint8)
    return np.ascontiguousarray(wide[:, :320]), np.ascontiguousarray(wide[:, 8:])
