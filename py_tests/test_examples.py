# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
import pathlib
import re
import subprocess
import sys

EXAMPLES = pathlib.Path(__file__).resolve().parents[1] / "tools/examples"


def test_feed_sweeper(recordings):
    done = subprocess.run([sys.executable, EXAMPLES / "feed_sweeper.py", recordings / "euroc_still", "--fast"],
                          stdout=subprocess.PIPE, text=True, check=True)
    told = re.search(r"(\d+) images: (\d+) lost, (\d+) dropped", done.stdout)
    assert told and [int(n) for n in told.groups()] == [48, 0, 0]
    assert re.search(r" at .* m, .* by (vision|guess)", done.stdout)
