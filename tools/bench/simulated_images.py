#!/usr/bin/python3
# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
"""How simulated images compare with real ones: a table, a row for each recording.

    PYTHONPATH=build/release/python SWEEPKIT_DATA=... tools/bench/simulated_images.py [SIMULATED_RECORDING ...]

grey, clipped   mean of the pixels, and the share of them that are 0 or 255
points          key points found in an image (1000 are asked for)
spread          share of the cells of a grid of 8 x 5 that have a key point
octaves         share of the key points on levels 0, 1-2, 3-4, 5-7
stereo          share of the left key points with a match in the right image
track           images in a row in which a key point is found again, each from the one before: by the nearest descriptor of
                those within 48 px whose distance is below 50 bits and 0.8 of the next one's; mean over the key points of
                every tenth image, followed for at most 10. A recording with gaps between its images has none.
"""

import os
import pathlib
import sys

import numpy as np

import sweepkit as sk

GRID = (8, 5)
BITS = np.array([bin(i).count("1") for i in range(256)], np.uint8)


def followed(before, after):
    """Index in `after` of each key point of `before`, or -1."""
    found = np.full(len(before), -1)
    if len(after) == 0:
        return found
    xy_before = np.column_stack([before.keypoints["x"], before.keypoints["y"]])
    xy_after = np.column_stack([after.keypoints["x"], after.keypoints["y"]])
    for i, descriptor in enumerate(before.descriptors):
        near = np.flatnonzero(np.abs(xy_after - xy_before[i]).max(axis=1) < 48)
        if len(near) == 0:
            continue
        bits = BITS[after.descriptors[near] ^ descriptor].sum(axis=1)
        order = np.argsort(bits, kind="stable")
        if bits[order[0]] < 50 and (len(near) == 1 or bits[order[0]] < 0.8 * bits[order[1]]):
            found[i] = near[order[0]]
    return found


class Figures:
    """What is counted over the images of one recording."""

    def __init__(self, rig=None):
        self.options = sk.feature.OrbOptions()
        self.extractor = sk.feature.OrbExtractor(self.options)
        self.matcher = sk.match.StereoMatcher(rig) if rig else None
        self.grey, self.clipped, self.points, self.spread, self.stereo = [], [], [], [], []
        self.octaves = np.zeros(8)
        self.tracks = []

    def add(self, left, right=None):
        features = self.extractor.extract(left)
        self.grey.append(left.mean())
        self.clipped.append(np.mean((left == 0) | (left == 255)))
        self.points.append(len(features))
        if len(features) == 0:
            return features
        keypoints = features.keypoints
        column = (keypoints["x"] * GRID[0] / left.shape[1]).astype(int)
        row = (keypoints["y"] * GRID[1] / left.shape[0]).astype(int)
        self.spread.append(len(set(zip(column, row))) / (GRID[0] * GRID[1]))
        self.octaves += np.bincount(np.minimum(keypoints["octave"], 7), minlength=8)
        if self.matcher and right is not None:
            size = {"levels": self.options.levels, "factor": self.options.scale_factor}
            matches = self.matcher.match(features, sk.image.ImagePyramid(left, **size), self.extractor.extract(right),
                                         sk.image.ImagePyramid(right, **size))
            self.stereo.append(np.mean(matches["right"] >= 0))
        return features

    def follow(self, frames):
        alive, length = np.arange(len(frames[0])), np.zeros(len(frames[0]))
        for before, after in zip(frames, frames[1:]):
            found = followed(before, after)
            alive = np.where(alive >= 0, found[np.maximum(alive, 0)] if len(found) else -1, -1)
            length += alive >= 0
        if len(length):
            self.tracks.append(length.mean())

    def row(self, name):
        share = self.octaves / max(self.octaves.sum(), 1)
        levels = " ".join(f"{share[a:b].sum():.2f}" for a, b in ((0, 1), (1, 3), (3, 5), (5, 8)))
        text = [f"{np.mean(self.grey):5.0f}", f"{100 * np.mean(self.clipped):5.1f} %", f"{np.mean(self.points):6.0f}",
                f"{np.mean(self.spread):6.2f}", levels,
                f"{np.mean(self.stereo):6.2f}" if self.stereo else "     -",
                f"{np.mean(self.tracks):5.2f}" if self.tracks else "    -"]
        return f"{name:28}" + "  ".join(text)


def of_recording(folder, continuous=True):
    recording = sk.data.open_recording(folder)
    figures = Figures(recording.stereo_rig())
    every = max(1, recording.info.images // 80) * 10
    group, index = [], 0
    for sample in recording:
        if not isinstance(sample, sk.data.StereoImage):
            continue
        if sample.left is not None and sample.right is not None:
            start = index % every == 0
            if start:
                if len(group) > 1 and continuous:
                    figures.follow(group)
                group = []
            if start:
                group = [figures.add(sample.left, sample.right)]
            elif len(group) < 11 and continuous:
                group.append(figures.extractor.extract(sample.left))
        index += 1
    if len(group) > 1 and continuous:
        figures.follow(group)
    return figures


def of_images(files):
    figures = Figures()
    for file in files:
        figures.add(np.array(sk.data.read_gray(file)))
    return figures


def main():
    data = os.environ.get("SWEEPKIT_DATA")
    if not data and len(sys.argv) < 2:
        print("SWEEPKIT_DATA is unset and no recording is named", file=sys.stderr)
        return 77
    print(f"{'':28}{'grey':>5}  {'clipped':>7}  {'points':>6}  {'spread':>6}  {'octaves 0 1-2 3-4 5-7':19}  {'stereo':>6}  track")
    if data:
        data = pathlib.Path(data)
        for name, folder, continuous in (("EuRoC V1_01, at rest", "euroc_still", True),
                                         ("EuRoC V1_01, four places", "euroc_loop_pairs", False),
                                         ("KITTI 06", "kitti/06_first51", True), ("sweephome dev01", "sweephome/dev01", True),
                                         ("sweephome dev02", "sweephome/dev02", True),
                                         ("sweephome dev03", "sweephome/dev03", True)):
            if (data / folder).is_dir():
                try:
                    print(of_recording(data / folder, continuous).row(name), flush=True)
                except sk.Error as error:
                    print(f"{name:28}{error}", file=sys.stderr)
        images = sorted((data / "york_urban" / "images").glob("*.*"))
        if images:
            print(of_images(images[::3]).row("York Urban"), flush=True)
    for folder in sys.argv[1:]:
        print(of_recording(folder).row("simulated " + pathlib.Path(folder).name), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
