# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
"""Names and words that have no place here: catch-all file names, notes to do later, sources of chance, printing,
ends of the program from within the library, machine-specific flags, places on one machine."""

import re

import tree

VAGUE = r"(utils?|common|helpers?|managers?|misc)"
TOP = {"CMakeLists.txt", "CMakePresets.json", "README.md", "CONTRIBUTING.md", "CHANGELOG.md", "LICENSE", "include",
       "bindings", "python", "notebooks", "cpp_tests", "py_tests", "tools"}
SOURCE = {".hpp", ".cpp", ".py", ".sh", ".cmake", ".in", ".txt", ".yaml", ".toml", ".json", ".md", ".pyi", ""}
EVERYWHERE = [
    (re.compile(r"\b(TO" r"DO|FIX" r"ME|X" r"XX|HA" r"CK)\b"), "a note to do later"),
    (re.compile(r"march=" r"native"), "instructions of one machine"),
    (re.compile(r"(?<![\w.$}])/(home|root|srv|mnt|Users)/"), "a place on one machine"),
    (re.compile(r"\b(?:class|struct|enum)\s+\w*(Util|Common|Helper|Manager)s?\b"), "a type that could be anything"),
]
LIBRARY = [
    (re.compile(r"\bstd::(cout|cerr|clog)\b|\b(?:std::)?(?:f?printf|puts)\s*\("), "the library does not print"),
    (re.compile(r"\b(?:std::)?(?:abort|exit|_Exit|terminate)\s*\("), "the library does not end the program"),
    (re.compile(r"\bstd::random_device\b|\bs?rand\s*\(\s*\)"), "chance that cannot be repeated"),
    (re.compile(r"^using namespace\b"), "opens a namespace for everybody"),
]


def findings():
    for path in tree.files():
        if not path.parts[0].startswith(".") and path.parts[0] not in TOP:
            yield f"{path}: nothing else stands at the top"
        if re.fullmatch(VAGUE, path.stem, re.IGNORECASE):
            yield f"{path}: a file that could hold anything"
        if path.suffix in (".hpp", ".cpp", ".py") and not re.fullmatch(r"[a-z0-9_]+", path.stem):
            yield f"{path}: files are named in snake_case"
        if path.suffix not in SOURCE or path.name == "LICENSE" or "tools/checks" in str(path):
            continue
        library = str(path).startswith(("include/", "bindings/runtime/")) and path.suffix in (".hpp", ".cpp")
        for number, line in enumerate(tree.text(path).splitlines(), 1):
            code = line.split("//")[0] if library else line
            for pattern, why in EVERYWHERE:
                if pattern.search(line):
                    yield f"{path}:{number}: {why}: {line.strip()}"
            for pattern, why in LIBRARY if library else []:
                if pattern.search(code):
                    yield f"{path}:{number}: {why}: {line.strip()}"


tree.tell(list(findings()), "names")
