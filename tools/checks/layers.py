# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
"""A header includes only its own folder and lower layers, and no library that the umbrella must not pull in."""

import re

import tree

LAYER = {
    "core": 0,
    "geometry": 1,
    "image": 2,
    "feature": 3, "motion": 3,
    "match": 4, "bow": 4, "direction": 4, "floor": 4, "object": 4,
    "map": 5,
    "solve": 6,
    "slam": 7, "data": 7,
    "system": 8,
}

# Includes that the table forbids and that are allowed all the same: (file, included folder or library), and why.
EXCEPTIONS = {}

HEAVY = re.compile(r"(opencv2|ceres|yaml-cpp|fmt|nlohmann|CLI|pybind11|tbb)/")
INCLUDE = re.compile(r'^\s*#\s*include\s*([<"])([^>"]+)[>"]', re.MULTILINE)


def findings():
    for path in tree.files("include/**/*.hpp", "include/sweepkit/*.hpp", "bindings/runtime/**/*.*pp"):
        public = path.parts[0] == "include"
        folder = path.parts[2] if len(path.parts) > 3 else None
        if folder is not None and folder not in LAYER:
            yield f"{path}: the folder {folder} is in no layer"
            continue
        for bracket, name in INCLUDE.findall(tree.text(path)):
            if public and HEAVY.match(name) and (str(path), name.split("/")[0]) not in EXCEPTIONS:
                yield f"{path}: a public header includes {name}"
            if not name.startswith("sweepkit/"):
                if public and bracket == '"':
                    yield f'{path}: "{name}" is not named from sweepkit/ on'
                continue
            if bracket == "<":
                yield f"{path}: <{name}> is our own and takes quotes"
            if folder is None:
                continue
            other = name.split("/")[1]
            if other not in LAYER:
                yield f"{path}: includes {name}, which is in no layer"
            elif other != folder and LAYER[other] >= LAYER[folder] and (str(path), other) not in EXCEPTIONS:
                yield f"{path}: {folder} (layer {LAYER[folder]}) includes {name} (layer {LAYER[other]})"


tree.tell(list(findings()), "layers")
