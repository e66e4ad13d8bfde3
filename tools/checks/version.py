# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
"""The version number stands in CMakeLists.txt and nowhere else; the change log knows it or is ahead of it."""

import re

import tree


def findings():
    found = re.search(r"^project\(sweepkit VERSION (\d+\.\d+\.\d+) ", tree.text("CMakeLists.txt"), re.MULTILINE)
    if not found:
        yield "CMakeLists.txt: project(sweepkit VERSION x.y.z ...) not found"
        return
    version = found[1]
    headings = re.findall(r"^## \[?([^\]\s]+)", tree.text("CHANGELOG.md"), re.MULTILINE)
    if not headings or headings[0] not in ("Unreleased", version):
        yield f"CHANGELOG.md: begins neither with Unreleased nor with {version}"
    literal = re.compile(r"(?<![\d.])" + re.escape(version) + r"(?![\d.])")
    for path in tree.files("*.hpp", "*.cpp", "*.py", "*.pyi", "*.toml", "*.txt", "*.in"):
        for number, line in enumerate(tree.text(path).splitlines(), 1):
            if re.search("version", line, re.IGNORECASE) and literal.search(line) and \
                    (str(path), line) != ("CMakeLists.txt", tree.text("CMakeLists.txt").splitlines()[number - 1]):
                yield f"{path}:{number}: repeats the version number"


tree.tell(list(findings()), "version")
