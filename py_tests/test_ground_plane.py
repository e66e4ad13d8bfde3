# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from sweepkit.floor import (GroundPlane, GroundPlaneEstimator, GroundPlaneOptions, GroundPlaneReason, GroundPlaneSeed,
                            GroundPlaneState, pitch_down, roll)
from sweepkit.geometry import RectifiedCamera

CAMERA = RectifiedCamera(focal=350, cx=320, cy=200, baseline=0.06)
SEED = GroundPlaneSeed.from_height([0, 1, 0.05], 0.08)


def disparity_of(plane):
    floor = plane.disparity(CAMERA)
    v, u = np.mgrid[:400, :640]
    d = floor.at_origin + floor.along_u * u + floor.along_v * v
    return np.where((d > 0) & (d < 128), d, -1).astype(np.float32)


@pytest.mark.parametrize("dtype", [np.float32, np.int16])
def test_finds_the_plane(dtype):
    truth = GroundPlane(np.array([0.01, 1, 0.055]) / np.linalg.norm([0.01, 1, 0.055]), 0.0805)
    disparity = (disparity_of(truth) * (16 if dtype == np.int16 else 1)).astype(dtype)
    estimator = GroundPlaneEstimator(CAMERA, SEED)
    for image in (disparity, np.asfortranarray(disparity)):
        result = estimator.estimate(image)
        assert result.measured and result.reason == GroundPlaneReason.none
        assert pitch_down(result.plane) == pytest.approx(pitch_down(truth), abs=1e-3)
        assert roll(result.plane) == pytest.approx(roll(truth), abs=1e-3)
        assert result.plane.height == pytest.approx(truth.height, abs=3e-4)
        assert result.covariance.shape == (3, 3) and result.inliers > 1000
    assert estimator.mounting().height == pytest.approx(truth.height, abs=4e-4)


def test_no_floor_is_invented():
    estimator = GroundPlaneEstimator(CAMERA, SEED, GroundPlaneOptions(min_pixels=100))
    for image in (np.full((400, 640), 70, np.float32), np.full((400, 640), np.nan, np.float32),
                  np.zeros((0, 0), np.int16)):
        result = estimator.estimate(image)
        assert result.state == GroundPlaneState.predicted
        assert result.plane.height == pytest.approx(0.08)


def test_vertical_and_wrong_arguments():
    estimator = GroundPlaneEstimator(CAMERA, SEED)
    nothing = np.zeros((400, 640), np.int16)
    result = estimator.estimate(nothing, down_camera=[0, 1, 0.06], down_sigma=1e-3)
    assert pitch_down(result.plane) > pitch_down(SEED.plane)
    with pytest.raises(ValueError, match="float64"):
        estimator.estimate(np.zeros((400, 640)))
    with pytest.raises(ValueError, match="given together"):
        estimator.estimate(nothing, covariance=np.eye(6))
    with pytest.raises(ValueError, match="step.seconds"):
        estimator.estimate(nothing, seconds=0)
