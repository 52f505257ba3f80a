"""Public names of a package: listed once, in its stub, and imported on first use."""

from __future__ import annotations

import sys
from collections.abc import Callable
from importlib import import_module
from os.path import dirname, join


def open_namespace(
    package: str, file: str
) -> tuple[Callable[[str], object], Callable[[], list[str]], list[str]]:
    """`__getattr__`, `__dir__` and `__all__` of a package, from the `__init__.pyi` beside it.

    A line of the stub reads `from MODULE import NAME as NAME`, which editors and type checkers
    read as well. Nothing is imported before somebody asks for it.

    Args:
        package: `__name__` of the package.
        file: `__file__` of the package.
    """
    where: dict[str, str] = {}
    with open(join(dirname(file), "__init__.pyi"), encoding="utf-8") as stub:
        for line in stub:
            words = line.split()
            if words[:1] == ["from"]:
                where[words[3]] = words[1]

    def get(name: str) -> object:
        if name not in where:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        if where[name] == package:
            return import_module(f"{package}.{name}")
        value = getattr(import_module(where[name]), name)
        setattr(sys.modules[package], name, value)
        return value

    names = sorted(where)
    return get, lambda: names, names
