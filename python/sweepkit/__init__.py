# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
"""sweepkit: stereo SLAM for cleaning robots.

Sub-modules carry the names of the C++ folders (sweepkit.geometry, sweepkit.feature, ...), and what is in them the names
that it has in C++. Arrays go in and out as numpy arrays.
"""

import sys as _sys

try:
    from . import _core
except ImportError as error:
    raise ImportError(f"the compiled part of sweepkit cannot be loaded: {error}. It is built by CMake with "
                      "SWEEPKIT_BUILD_PYTHON=ON, into python/ of the build folder, for the Python found there") from error

for _name in _core.folders:
    _sys.modules[f"{__name__}.{_name}"] = globals()[_name] = getattr(_core, _name)

from .core import Error  # noqa: E402
from .running import run  # noqa: E402

__version__ = _core.core.version()
