# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
"""Every source file starts with the two SPDX lines (after the line that names its interpreter, if it has one)."""

import tree

LINES = ["SPDX-FileCopyrightText: The sweepkit authors", "SPDX-License-Identifier: Apache-2.0"]
SUFFIXES = {".hpp": "// ", ".cpp": "// ", ".py": "# ", ".pyi": "# ", ".sh": "# ", ".cmake": "# ", ".in": "# ",
            ".yaml": "# ", ".yml": "# ", ".toml": "# "}


def findings():
    for path in tree.files():
        comment = SUFFIXES.get(path.suffix, "# " if path.name == "CMakeLists.txt" else None)
        if comment is None and path.suffix == "" and (tree.ROOT / path).read_bytes().startswith(b"#!"):
            comment = "# "
        if comment is None:
            continue
        lines = tree.text(path).splitlines()
        if lines and lines[0].startswith("#!"):
            lines = lines[1:]
        if lines[:2] != [comment + line for line in LINES]:
            yield f"{path}: does not start with the two SPDX lines"


tree.tell(list(findings()), "licence")
