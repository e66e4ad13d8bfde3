#!/usr/bin/env python3
# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
"""Precision and recall of place recognition on 7-Scenes' kitchen, and a figure of them.

    SWEEPKIT_DATA=... PYTHONPATH=build/release/python tools/bench/place_curve.py [--figure FILE.png]

Images are single, so there is no stereo and no metric verification here: the curves are those of what comes before it.
For each image from the 25th on the most similar of those at least 25 earlier is named if its figure exceeds a threshold:
the bag's score; that of the best group of neighbours in time; or the number of mutual matches of descriptors with the best
of the five most similar. A named image is right if at least 40 % of the view is the same; recall counts among the images
that have an earlier one with 50 %.
"""

import argparse
import os
import pathlib
import sys

import numpy as np

ROOT = pathlib.Path(__file__).resolve().parents[2]
GAP = 25
NEIGHBOURS = 2  # images on either side that count as one group
FIRST = 5  # most similar images whose descriptors are compared


def curve(figures, right, possible):
    """Precision and recall for each threshold, from the highest figure down."""
    order = np.argsort(-figures, kind="stable")
    hits = np.cumsum(right[order])
    return hits / np.arange(1, len(order) + 1), hits / possible


def recall_without_error(figures, right, possible):
    precision, recall = curve(figures, right, possible)
    # Of equal figures all are named or none.
    ends = np.append(np.diff(-np.sort(-figures)) < 0, True)
    sure = recall[(precision == 1) & ends]
    return sure[-1] if len(sure) else 0.0


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--vocabulary", default=str(ROOT / "tools/initial/orb.swv"))
    parser.add_argument("--figure", type=pathlib.Path)
    arguments = parser.parse_args()
    if "SWEEPKIT_DATA" not in os.environ:
        sys.exit("place_curve: SWEEPKIT_DATA is not set")
    import matplotlib.image
    import sweepkit as sk

    folder = pathlib.Path(os.environ["SWEEPKIT_DATA"]) / "place_7scenes"
    frames = np.loadtxt(folder / "poses.csv", delimiter=",")[:, 0].astype(int)
    overlap = np.loadtxt(folder / "overlap.csv", delimiter=",")
    vocabulary = sk.bow.load_vocabulary(arguments.vocabulary)
    extractor = sk.feature.OrbExtractor(sk.feature.OrbOptions(count=1000))
    features, bags = [], []
    for frame in frames:
        image = matplotlib.image.imread(folder / "images" / f"{frame:06d}.jpg")
        features.append(extractor.extract(np.ascontiguousarray(image if image.ndim == 2 else image[..., 0])))
        bags.append(vocabulary.transform(features[-1].descriptors))

    named = {"score of the bag": [], "score of a group": [], "matches of descriptors": []}
    possible = 0
    for i in range(GAP, len(frames)):
        earlier = range(i - GAP + 1)
        possible += max(overlap[i, j] for j in earlier) >= 0.5
        scores = np.array([vocabulary.score(bags[i], bags[j]) for j in earlier])
        groups = np.array([scores[max(0, j - NEIGHBOURS):j + NEIGHBOURS + 1].sum() for j in earlier])
        best = int(np.argmax(scores))
        group = int(np.argmax(groups))
        low = max(0, group - NEIGHBOURS)
        member = low + int(np.argmax(scores[low:group + NEIGHBOURS + 1]))
        first = np.argsort(-scores, kind="stable")[:FIRST]
        counts = [int((sk.match.match_brute_force(features[i], features[j])["index"] >= 0).sum()) for j in first]
        matched = int(first[int(np.argmax(counts))])
        for name, j, figure in (("score of the bag", best, scores[best]), ("score of a group", member, groups[group]),
                                ("matches of descriptors", matched, max(counts))):
            named[name].append((figure, overlap[i, j] >= 0.4))

    print(f"{len(frames) - GAP} images asked, {possible} seen before")
    print(f"{'named by':<26}{'recall at 100 % precision':>27}{'recall, all named':>20}{'precision':>11}")
    curves = {}
    for name, entries in named.items():
        figures = np.array([figure for figure, _ in entries], float)
        right = np.array([is_right for _, is_right in entries])
        curves[name] = curve(figures, right, possible)
        precision, recall = curves[name]
        print(f"{name:<26}{100 * recall_without_error(figures, right, possible):>25.1f} %{100 * recall[-1]:>18.1f} %"
              f"{100 * precision[-1]:>9.1f} %")
    if arguments.figure:
        import matplotlib
        matplotlib.use("Agg")
        import matplotlib.pyplot as plt
        figure, axes = plt.subplots(figsize=(5, 3.6), dpi=110)
        for name, (precision, recall) in curves.items():
            axes.plot(recall, precision, label=name, linewidth=1.5)
        axes.set(xlabel="recall", ylabel="precision", xlim=(0, 1), ylim=(0.4, 1.02))
        axes.grid(alpha=0.3)
        axes.legend(loc="lower left", fontsize=8)
        figure.tight_layout()
        figure.savefig(arguments.figure)


if __name__ == "__main__":
    main()
