# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
"""Writes the stubs (.pyi) of the compiled sub-modules into a built package, from the signatures in their docstrings.

    make_stubs.py PACKAGE_DIR
"""

import ast
import inspect
import pathlib
import re
import sys

HEADER = """# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
# Made by bindings/python/make_stubs.py.
"""
SIGNATURE = re.compile(r"^(?:\d+\. )?(?P<name>\w+)\((?P<parameters>.*)\)(?: -> (?P<result>.+))?$")


def split(text):
    """The parts between commas that stand in no brackets and no quotes."""
    parts, depth, start, quote = [], 0, 0, ""
    for i, c in enumerate(text):
        if quote:
            quote = "" if c == quote else quote
        elif c in "'\"":
            quote = c
        elif c in "([{<":
            depth += 1
        elif c in ")]}" or c == ">" and text[i - 1] != "-":
            depth -= 1
        elif c == "," and depth == 0:
            parts.append(text[start:i].strip())
            start = i + 1
    return [p for p in [*parts, text[start:].strip()] if p]


def has_options(cls):
    """A class of options describes them without an instance; other classes may describe other things."""
    return isinstance(getattr(cls, "__dict__", {}).get("describe"), staticmethod)


class Module:
    def __init__(self, module):
        self.module, self.name = module, module.__name__
        self.imports, self.lines = set(), []

    def type(self, text):
        """A type as pybind11 writes it, as type checkers read it."""
        text = text.strip()
        text = re.sub(r"numpy\.ndarray\[(?:dtype=|\{)?numpy\.(\w+?)\b.*", r"numpy.typing.NDArray[numpy.\1]", text) \
            if text.startswith("numpy.ndarray[numpy.") else text
        text = re.sub(r"numpy\.ndarray\[.*", "numpy.typing.NDArray[typing.Any]", text) if text.startswith(
            "numpy.ndarray[") else text
        for name, good in (("List", "list"), ("Dict", "dict"), ("Tuple", "tuple"), ("Set", "set")):
            text = re.sub(rf"\b{name}\b(?=\[)", good, text)
        text = re.sub(r"\[([\w.]+)\[\d+\]\]", r"[\1]", text)  # a std::array, whose length types cannot tell
        for name in ("Optional", "Union", "Callable", "Iterator", "Iterable"):
            text = re.sub(rf"(?<![\w.]){name}\b", f"typing.{name}", text)
        if "numpy.ndarray[" in text:  # within another type
            text = re.sub(r"numpy\.ndarray\[numpy\.(\w+)(?:\[[^\]]*\])?(?:, flags[.\w, ]*)?\]",
                          r"numpy.typing.NDArray[numpy.\1]", text)
            text = text.replace("numpy.ndarray[bool]", "numpy.typing.NDArray[numpy.bool_]")
        text = re.sub(r"\b(list|tuple|dict)\b(?!\[)", lambda m: {"list": "list[typing.Any]", "dict":
                      "dict[str, typing.Any]", "tuple": "tuple[typing.Any, ...]"}[m[1]], text)
        text = re.sub(r"\bcapsule\b|\bhandle\b", "object", text)
        text = text.replace("os.PathLike", "os.PathLike[str]") if "os.PathLike[" not in text else text
        text = re.sub(r"\bnumpy\.ndarray\b(?!\[)", "numpy.typing.NDArray[typing.Any]", text)
        text = text.replace(self.name + ".", "")
        for used in re.findall(r"\b(numpy\.typing|numpy|typing|os|pathlib|sweepkit\.\w+)\.", text):
            self.imports.add(used)
        return text

    def parameter(self, text):
        if text in ("self", "*", "/") or text.startswith("*"):
            return text + ": typing.Any" if text.startswith("*") and text != "*" else text
        name, _, rest = text.partition(":")
        kind, equals, default = rest.partition(" = ")
        kind = self.type(kind)
        if kind == "os.PathLike[str]":
            kind = "typing.Union[str, os.PathLike[str]]"
        if kind in ("float", "int") or not kind:
            kind = kind or "typing.Any"
        default = default.strip()
        if equals and not re.fullmatch(r"-?\d+(\.\d+)?(e-?\d+)?|True|False|None|'[^']*'", default):
            default = "..."
        if default == "None" and "Optional" not in kind:
            kind = f"typing.Optional[{kind}]"
        self.imports.add("typing")
        return f"{name}: {kind}" + (f" = {default}" if equals else "")

    def signatures(self, doc, name):
        """[(parameters, result, text)] of the overloads that a docstring lists."""
        found, text = [], []
        for line in (doc or "").splitlines():
            match = SIGNATURE.match(line.strip())
            if match and match["name"] == name and "*args, **kwargs" != match["parameters"]:
                found.append(([p for p in split(match["parameters"])], match["result"] or "None", []))
            elif line.strip() and line.strip() != "Overloaded function." and found:
                found[-1][2].append(line.strip())
        return [(p, r, " ".join(t)) for p, r, t in found]

    def docstring(self, text, indent):
        if text:
            escaped = text.replace("\\", "\\\\").replace('"""', "'''")
            self.lines.append(f'{indent}"""{escaped}"""')

    def function(self, name, function, indent="", static=False, owner=None):
        overloads = self.signatures(function.__doc__, name)
        for parameters, result, text in overloads:
            if owner is not None and not static:
                parameters = ["self", *parameters[1:]]
            if name == "__init__" and has_options(owner):
                parameters = ["self", *(["*", *self.fields(owner)] if self.fields(owner) else [])]
            if name in ("update", "replace") and has_options(owner):
                fields = [re.sub(r"= \.\.\.$|= .*$", "= ...", f) for f in self.fields(owner)]
                parameters = ["self", *(["*", *fields] if fields else [])]
            if name == "__eq__":
                parameters, result = ["self", "other: object"], "bool"
            if name == "__next__":
                result = "typing.Any"
            if name == "__iter__":
                result = owner.__name__
            if name in ("to_dict", "__getstate__"):
                result = "dict[str, typing.Any]" if name == "to_dict" else "typing.Any"
            if name == "__setstate__":
                parameters = ["self", "state: typing.Any"]
            given = ", ".join(self.parameter(p) for p in parameters)
            if len(overloads) > 1:
                self.imports.add("typing")
                self.lines.append(f"{indent}@typing.overload")
            if static:
                self.lines.append(f"{indent}@staticmethod")
            self.imports.add("typing")
            self.lines.append(f"{indent}def {name}({given}) -> {self.type(result)}:" + ("" if text else " ..."))
            if text:
                self.docstring(text, indent + "    ")
                self.lines.append(f"{indent}    ...")

    def fields(self, owner):
        """Keyword parameters of a class of options."""
        result = []
        groups = set()
        for field in owner.describe():
            head, dot, _ = field["path"].partition(".")
            if not dot:
                result.append(f"{head}: {field['type']} = {field['default']!r}")
            elif head not in groups:
                groups.add(head)
                kind = self.property_type(getattr(owner, head))
                result.append(f"{head}: typing.Union[{kind}, dict[str, typing.Any]] = ...")
        return result

    def property_type(self, prop):
        match = re.match(r"^\(.*\) -> (.+)$", (prop.fget.__doc__ or "").strip().splitlines()[0])
        return self.type(match[1]) if match else "typing.Any"

    def cls(self, cls):
        bases = [b.__name__ for b in cls.__bases__ if b.__name__ not in ("pybind11_object", "object")]
        self.lines.append(f"\nclass {cls.__name__}" + (f"({', '.join(bases)})" if bases else "") + ":")
        self.docstring(" ".join((cls.__doc__ or "").split("\n\nMembers:")[0].split()), "    ")
        members = getattr(cls, "__members__", None)
        described = {f["path"]: f["type"] for f in cls.describe()} if has_options(cls) else {}
        start = len(self.lines)
        if issubclass(cls, Exception):
            self.lines += [f"    {name}: str" for name in ("kind", "place", "value")] if cls.__name__ == "Error" else []
        for name in members or {}:
            self.imports.add("typing")
            self.lines.append(f"    {name}: typing.ClassVar[{cls.__qualname__}]")
        for name, member in cls.__dict__.items():
            if members and (name in members or name in ("name", "value", "__members__")) or name in ("__module__", "__doc__", "__entries", "__weakref__", "__dict__"):
                continue
            if inspect.isclass(member):
                outer, self.lines = self.lines, []
                self.cls(member)
                self.lines = outer + ["    " + line for line in "\n".join(self.lines).strip().split("\n")]
            elif isinstance(member, property):
                kind = described.get(name) or ("dict[str, typing.Any]" if name == "__members__" else self.property_type(member))
                text = " ".join((member.__doc__ or "").split())
                self.lines += ["    @property", f"    def {name}(self) -> {kind}:" + ("" if text else " ...")]
                if text:
                    self.docstring(text, "        ")
                    self.lines.append("        ...")
                if member.fset is not None:
                    self.lines += [f"    @{name}.setter", f"    def {name}(self, value: {kind}) -> None: ..."]
            elif isinstance(member, staticmethod):
                self.function(name, member.__func__, "    ", static=True, owner=cls)
            elif callable(member) and (not name.startswith("__") or name in (
                    "__init__", "__mul__", "__len__", "__getitem__", "__iter__", "__next__", "__eq__", "__call__",
                    "__copy__", "__deepcopy__")):
                if members and name not in ("__init__",):
                    continue
                self.function(name, member, "    ", owner=cls)
        if members:
            self.lines += ["    @property", "    def name(self) -> str: ...", "    @property", "    def value(self) -> int: ..."]
        if len(self.lines) == start:
            self.lines.append("    ...")

    def text(self):
        for name, value in vars(self.module).items():
            if name.startswith("_"):
                continue
            if inspect.isclass(value):
                self.cls(value)
            elif inspect.isbuiltin(value):
                self.lines.append("")
                self.function(name, value)
            elif not inspect.ismodule(value):
                self.imports.add("typing")
                self.imports.add("numpy")
                kind = "numpy.dtype[typing.Any]" if type(value).__module__.startswith("numpy") else type(value).__name__
                self.lines.append(f"{name}: {kind}")
        # Imports that our own lines use beyond what types() saw.
        body = "\n".join(self.lines)
        for used in ("numpy.typing", "numpy", "typing", "os"):
            if re.search(rf"(?<![\w.]){re.escape(used)}\.", body):
                self.imports.add(used)
        imports = "".join(f"import {name}\n" for name in sorted(self.imports - {self.name}))
        return HEADER + f'"""{self.module.__doc__}"""\n\n' + imports + "\n" + body.lstrip("\n") + "\n"


def main():
    package = pathlib.Path(sys.argv[1])
    import sweepkit
    core = sweepkit._core
    for folder in core.folders:
        path = package / f"{folder}.pyi"
        text = Module(getattr(core, folder)).text()
        # A C++ type that nobody bound, or a parameter named as a keyword, ends the build and not a reader's day.
        try:
            ast.parse(text, str(path))
        except SyntaxError as error:
            sys.exit(f"{path}:{error.lineno}: no Python: {error.text.strip()}")
        path.write_text(text)
    imports = "".join(f"from . import {name} as {name}\n" for name in core.folders)
    (package / "_core.pyi").write_text(f"{HEADER}{imports}\n\nfolders: tuple[str, ...]\n")


main()
