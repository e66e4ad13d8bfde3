# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
"""clang-format 14 has nothing to change, headers are guarded, text files end in one newline and hold no tabs."""

import re
import shutil
import subprocess

import tree


def findings():
    tool = shutil.which("clang-format-14") or shutil.which("clang-format")
    version = subprocess.run([tool, "--version"], stdout=subprocess.PIPE, text=True).stdout if tool else ""
    if "version 14." not in version:
        yield f"clang-format 14 is needed, found: {version.strip() or 'none'}"
        return
    sources = tree.files("*.hpp", "*.cpp")
    done = subprocess.run([tool, "--dry-run", *map(str, sources)], cwd=tree.ROOT, stderr=subprocess.PIPE, text=True)
    seen = set()
    for line in done.stderr.splitlines():
        match = re.match(r"(\S+?):(\d+):\d+: warning: code should be clang-formatted", line)
        if match and match[1] not in seen:
            seen.add(match[1])
            yield f"{match[1]}:{match[2]}: not formatted (clang-format-14 -i {match[1]})"
    for path in sources:
        if path.suffix == ".hpp" and "#pragma once" not in tree.text(path).splitlines()[2:4]:
            yield f"{path}: #pragma once is not the third line"
    for path in tree.files("*.hpp", "*.cpp", "*.py", "*.md", "*.txt", "*.yaml", "*.json"):
        content = tree.text(path)
        if content and (not content.endswith("\n") or content.endswith("\n\n")):
            yield f"{path}: does not end in one newline"
        if "\t" in content and path.suffix in (".hpp", ".cpp", ".py"):
            yield f"{path}: holds a tab"


tree.tell(list(findings()), "style")
