# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
"""What the checks share: which files there are, and how findings are told."""

import pathlib
import subprocess
import sys

ROOT = pathlib.Path(__file__).resolve().parents[2]


def files(*patterns):
    """Files of the tree, tracked or new but not ignored, as paths from the root; all, or those that match a pattern
    like *.hpp. Without git (an unpacked archive) whatever lies there outside build/."""
    listing = subprocess.run(["git", "ls-files", "--cached", "--others", "--exclude-standard"], cwd=ROOT,
                             stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    if listing.returncode == 0:
        names = listing.stdout.splitlines()
    else:
        names = [str(p.relative_to(ROOT)) for p in ROOT.rglob("*") if p.is_file()]
    paths = [pathlib.PurePath(name) for name in sorted(set(names))]
    return [p for p in paths if p.parts[0] != "build" and (ROOT / p).is_file()
            and (not patterns or any(p.match(pattern) for pattern in patterns))]


def text(path):
    return (ROOT / path).read_text(encoding="utf-8")


def tell(findings, what):
    """Prints the findings, one a line, and ends the program: 0 if there are none."""
    for finding in findings:
        print(finding)
    print(f"{what}: {len(findings)} findings")
    sys.exit(1 if findings else 0)
