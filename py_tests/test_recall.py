# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

import sweepkit as sk


def test_recall_is_the_share_of_right_ones_among_the_most_similar():
    rng = np.random.default_rng(3)
    meter = sk.bow.RecallMeter([1, 3, 10])
    expected = np.zeros(3)
    images = 0
    for _ in range(30):
        scores, relations = rng.random(20), rng.integers(0, 3, 20).astype(np.uint8)
        meter.add(scores, relations)
        order = [i for i in np.argsort(-scores, kind="stable") if relations[i] != 0]
        right = sum(relations == 2)
        if right == 0:
            continue
        images += 1
        for k, n in enumerate((1, 3, 10)):
            expected[k] += sum(relations[i] == 2 for i in order[:n]) / min(n, right)
    recall = meter.result()
    assert recall.images == images and recall.without == 30 - images and recall.counts == [1, 3, 10]
    np.testing.assert_allclose(recall.values, expected / images)
    with pytest.raises(ValueError, match="PlaceRelation"):
        meter.add([0.5], [3])
    with pytest.raises(ValueError, match="as many as scores"):
        meter.add([0.5, 0.6], [1])
