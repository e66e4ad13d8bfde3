# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
import copy
import importlib.metadata
import pickle

import pytest

import sweepkit as sk
from sweepkit.feature import OrbOptions
from sweepkit.geometry import PnpOptions


def test_version_is_one():
    assert sk.__version__ == sk.core.version() == importlib.metadata.version("sweepkit")


def test_modules_are_named_as_the_folders():
    import sweepkit.geometry
    assert sweepkit.geometry is sk.geometry
    assert sk.geometry.SE3d.__module__ == "sweepkit.geometry"


def test_random_repeats():
    a, b = sk.core.Random(7), sk.core.Random(7)
    assert [a.uniform() for _ in range(5)] == [b.uniform() for _ in range(5)]
    assert 0 <= a.index(3) < 3


def test_errors_carry_value_and_place():
    with pytest.raises(sk.core.ArgumentError) as caught:
        sk.core.Random().index(0)
    assert isinstance(caught.value, (sk.Error, ValueError)) and isinstance(caught.value, RuntimeError)
    assert caught.value.kind == "argument" and caught.value.value == "0" and "index" in caught.value.place


def test_options_have_defaults_and_documentation():
    options = OrbOptions()
    assert options.count == 1000 and options.scale_factor == 1.2
    assert "key points" in OrbOptions.count.__doc__
    assert {"path", "default", "unit", "min", "max", "doc"} <= set(OrbOptions.describe()[0])


def test_options_refuse_what_is_wrong():
    with pytest.raises(sk.core.OptionError, match="nearest is count"):
        OrbOptions(cuont=3)
    with pytest.raises(sk.core.OptionError, match=r"\[1, 20000\].*got 0"):
        OrbOptions(count=0)
    with pytest.raises(sk.core.OptionError, match="float"):
        OrbOptions(scale_factor="wide")
    with pytest.raises(sk.core.OptionError, match="finite"):
        OrbOptions(scale_factor=float("nan"))
    for wrong in (True, 2.5, 10**12):
        with pytest.raises(sk.core.OptionError):
            OrbOptions(count=wrong)
    options = OrbOptions(count=500)
    with pytest.raises(ValueError):
        options.count = -1
    assert options.count == 500, "a refused value changes nothing"


def test_options_behave_like_dataclasses():
    options = PnpOptions(threshold=3, ransac={"seed": 5})
    assert options.ransac.seed == 5 and options.threshold == 3.0
    assert options == PnpOptions(threshold=3.0, ransac=options.ransac) != PnpOptions()
    assert options != "something else"
    for other in (copy.copy(options), copy.deepcopy(options), pickle.loads(pickle.dumps(options))):
        assert other == options and other is not options
    assert PnpOptions(**options.to_dict()) == options
    changed = options.replace(min_inliers=20)
    assert changed.min_inliers == 20 and options.min_inliers == 10
    assert "threshold=3.0" in repr(options) and repr(options).startswith("PnpOptions(")
    options.ransac.seed = 6
    assert options.ransac.seed == 6, "groups are looked at in place"


def test_options_as_yaml(tmp_path):
    options = PnpOptions(threshold=3.5, ransac={"seed": 9})
    (tmp_path / "pnp.yaml").write_text(options.to_yaml())
    assert PnpOptions.from_yaml(str(tmp_path / "pnp.yaml")) == options
    with pytest.raises(sk.core.IoError) as caught:
        PnpOptions.from_yaml(str(tmp_path / "none.yaml"))
    assert "none.yaml" in str(caught.value)
