# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
"""Runs the tests of a build and counts them.

    run_tests.py BUILD_DIR [PART_OF_A_NAME...]

What CTest knows is run one after the other, so that nothing disturbs what measures time: of a Catch2 binary each test
case counts, any other test counts once (exit code 77: skipped). Where the build has the Python package, pytest
follows. The last line is "N passed, N failed", with ", N skipped" where something was skipped.
"""

import json
import os
import pathlib
import re
import subprocess
import sys
import tempfile
import time
import xml.etree.ElementTree

ROOT = pathlib.Path(__file__).resolve().parents[1]


class Count:
    def __init__(self, passed=0, failed=0, skipped=0):
        self.passed, self.failed, self.skipped = passed, failed, skipped

    def __str__(self):
        return f"{self.passed} passed, {self.failed} failed" + (f", {self.skipped} skipped" if self.skipped else "")

    def __iadd__(self, other):
        self.passed += other.passed
        self.failed += other.failed
        self.skipped += other.skipped
        return self


def run(command, limit, cwd=None, env=None):
    """The exit code and what was printed; -1 where the time limit was reached."""
    try:
        done = subprocess.run(command, cwd=cwd, env=env, timeout=limit, stdout=subprocess.PIPE,
                              stderr=subprocess.STDOUT, text=True, errors="replace")
        return done.returncode, done.stdout
    except subprocess.TimeoutExpired as late:
        return -1, (late.stdout or b"").decode(errors="replace") + f"\nstopped after {limit:g} s"


def run_catch(command, limit, report):
    code, output = run([*command, "--reporter", "xml", "--out", report], limit)
    count, told = Count(), []
    try:
        tree = xml.etree.ElementTree.parse(report).getroot()
    except (OSError, xml.etree.ElementTree.ParseError):
        return Count(failed=1), f"{output}\nno report: exit code {code}"
    for case in tree.iter("TestCase"):
        result = case.find("OverallResult")
        skips = [w.text.strip() for w in case.iter("Warning") if w.text and "skip" in w.text.lower()]
        if result is None or result.get("success") != "true":
            count.failed += 1
            told.append(f"FAILED: {case.get('name')} ({case.get('filename')}:{case.get('line')})")
            for bad in case.iter("Expression"):
                if bad.get("success") != "true":
                    told.append(f"  {bad.get('filename')}:{bad.get('line')}: {bad.findtext('Original', '').strip()}"
                                f"  with expansion  {bad.findtext('Expanded', '').strip()}")
            for kind in ("Failure", "Exception", "FatalErrorCondition"):
                told += [f"  {kind}: {(e.text or '').strip()}" for e in case.iter(kind)]
        elif skips:
            count.skipped += 1
            told.append(f"SKIPPED: {case.get('name')}: {skips[0]}")
        else:
            count.passed += 1
    if code != 0 and count.failed == 0:
        count.failed += 1
        told.append(f"exit code {code}")
    # A sanitizer reports past the reporter.
    if count.failed and output.strip():
        told.append(output.strip())
    return count, "\n".join(told)


def run_plain(command, limit):
    code, output = run(command, limit)
    if code == 77:
        return Count(skipped=1), output
    return (Count(passed=1) if code == 0 else Count(failed=1)), output


def run_pytest(build, parts):
    env = dict(os.environ, PYTHONPATH=str(build / "python"), PYTHONDONTWRITEBYTECODE="1", SWEEPKIT_BUILD=str(build))
    with tempfile.TemporaryDirectory() as folder:
        report = pathlib.Path(folder) / "report.xml"
        chosen = ["-k", " or ".join(parts)] if parts else []
        code, output = run([sys.executable, "-m", "pytest", "-q", "-rs", "-p", "no:cacheprovider", f"--junitxml={report}",
                            *chosen, str(ROOT / "py_tests")], 900, cwd=ROOT, env=env)
        if parts and code == 5:  # none of that name
            return Count(), ""
        try:
            suite = next(xml.etree.ElementTree.parse(report).getroot().iter("testsuite"))
        except (OSError, StopIteration, xml.etree.ElementTree.ParseError):
            return Count(failed=1), output
    number = {name: int(suite.get(name, 0)) for name in ("tests", "failures", "errors", "skipped")}
    failed = number["failures"] + number["errors"]
    count = Count(number["tests"] - failed - number["skipped"], failed, number["skipped"])
    if code != 0 and failed == 0:
        count.failed = 1
    return count, output if count.failed else "\n".join(re.findall(r"^SKIPPED.*$", output, re.MULTILINE))


def main():
    build, parts = pathlib.Path(sys.argv[1]).resolve(), sys.argv[2:]
    listing = subprocess.run(["ctest", "--test-dir", str(build), "--show-only=json-v1"], stdout=subprocess.PIPE, check=True)
    total = Count()

    def tell(name, start, result):
        count, output = result
        print(f"{name:<28} {count}  ({time.monotonic() - start:.1f} s)")
        if output.strip():
            print("    " + output.strip().replace("\n", "\n    "))
        sys.stdout.flush()
        nonlocal total
        total += count

    with tempfile.TemporaryDirectory() as folder:
        for test in json.loads(listing.stdout)["tests"]:
            name = test["name"]
            if parts and not any(part in name for part in parts):
                continue
            properties = {p["name"]: p["value"] for p in test.get("properties", [])}
            limit = float(properties.get("TIMEOUT", 300))
            start = time.monotonic()
            if "command" not in test:
                result = Count(failed=1), "not built"
            elif "catch2" in properties.get("LABELS", []):
                result = run_catch(test["command"], limit, str(pathlib.Path(folder) / f"{name}.xml"))
            else:
                result = run_plain(test["command"], limit)
            tell(name, start, result)
    if (build / "python" / "sweepkit").is_dir():
        start = time.monotonic()
        tell("python", start, run_pytest(build, parts))
    print(total)
    sys.exit(1 if total.failed or not total.passed else 0)


main()
