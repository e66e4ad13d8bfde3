# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
"""clang-tidy on what changed.

    tidy.py BUILD_DIR [BASE]

Looks at the sources that differ from BASE: by default where this branch left origin/main, else ten commits ago. All
changed headers are looked at in one file, since parsing Eigen is most of the time; sources one by one, those that
changed last first, as many as MOST allows (it says how many were left). What was found clean is remembered in the
build folder by its content.
"""

import concurrent.futures
import hashlib
import json
import os
import pathlib
import shutil
import subprocess
import sys

import tree

MOST = 4  # sources; a few seconds each


def git(*arguments):
    done = subprocess.run(["git", *arguments], cwd=tree.ROOT, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    return done.stdout.split() if done.returncode == 0 else None


def base_commit():
    """Where to compare with, or None where all there is is new."""
    head = git("rev-parse", "HEAD")
    fork = git("merge-base", "HEAD", "origin/main")
    if fork and fork != head:
        return fork[0]
    ten = git("rev-parse", "--verify", "--quiet", "HEAD~10")
    return ten[0] if ten else None


def changed(base):
    names = git("diff", "--name-only", "--diff-filter=d", base) if base else git("ls-files")
    names = set(names or []) | set(git("ls-files", "--others", "--exclude-standard") or [])
    # The newest commit first: what somebody works on is looked at whatever MOST is.
    order = git("log", "--format=", "--name-only", "-n", "30") or []
    rank = {name: i for i, name in reversed(list(enumerate(order)))}
    return [pathlib.PurePath(n) for n in sorted(names, key=lambda n: (rank.get(n, -1), n)) if (tree.ROOT / n).is_file()]


def main():
    build = pathlib.Path(sys.argv[1]).resolve()
    tool = shutil.which("clang-tidy-14") or shutil.which("clang-tidy")
    if git("rev-parse", "HEAD") is None or not tool:
        print("SKIPPED: no git history or no clang-tidy")
        sys.exit(77)
    names = changed(sys.argv[2] if len(sys.argv) > 2 else base_commit())
    known = {}
    for entry in json.loads((build / "compile_commands.json").read_text()):
        known[entry["file"]] = entry
    headers = [p for p in names if p.suffix == ".hpp" and p.parts[0] == "include"]
    sources = [p for p in names if p.suffix == ".cpp" and str(tree.ROOT / p) in known and p.parts[0] != "cpp_tests"]
    work = build / "tidy"
    work.mkdir(exist_ok=True)
    rules = tree.text(".clang-tidy")

    def clean_mark(paths):
        content = rules + "".join(str(p) + tree.text(p) for p in paths)
        return work / (hashlib.sha256(content.encode()).hexdigest() + ".ok")

    jobs = []
    if headers:
        together = work / "headers.cpp"
        together.write_text("".join(f'#include "{p.relative_to("include")}"\n' for p in sorted(headers)))
        flags = ["-std=c++20", f"-I{tree.ROOT}/include", "-isystem", "/usr/include/eigen3"]
        jobs.append((clean_mark(sorted(headers)), [tool, "--quiet", f"--config-file={tree.ROOT}/.clang-tidy",
                                                   str(together), "--", *flags]))
    waiting = [p for p in sources if not clean_mark([p]).exists()]
    for path in waiting[:MOST]:
        jobs.append((clean_mark([path]), [tool, "--quiet", "-p", str(build), "--extra-arg=-Wno-unknown-warning-option",
                                          "--extra-arg=-Wno-ignored-optimization-argument", str(tree.ROOT / path)]))

    def look(job):
        mark, command = job
        if mark.exists():
            return []
        done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        lines = [line for line in done.stdout.splitlines() if ": warning: " in line or ": error: " in line]
        # clang 14 lacks a part of C++20 that is used here: lambdas that capture structured bindings.
        found = [line for line in lines if "reference to local binding" not in line]
        if not found and (done.returncode == 0 or lines):
            mark.touch()
        elif not found:
            found = [f"{' '.join(command)}: {done.stderr.strip()}"]
        return found

    with concurrent.futures.ThreadPoolExecutor(os.cpu_count()) as pool:
        results = sorted({line for found in pool.map(look, jobs) for line in found})
    print(f"{len(headers)} headers, {len(sources)} sources changed; {min(len(waiting), MOST)} sources looked at, "
          f"{len(sources) - len(waiting)} known to be clean, {max(0, len(waiting) - MOST)} left for later")
    tree.tell(results, "tidy")


main()
