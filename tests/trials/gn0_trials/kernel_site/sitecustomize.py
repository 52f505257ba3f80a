"""Loaded by each Python that finds this folder first: writes down which kernels Python calls.

A line per kernel and types of arguments, in their order, into the file `$GN0_KERNEL_CALLS`, to
which all processes of a job append.
"""

from __future__ import annotations

import importlib.abc
import importlib.util
import os
import sys
from typing import Any


class _Finder(importlib.abc.MetaPathFinder):
    """Waits for Numba's dispatchers: importing Numba here would cost each process half a second."""

    def find_spec(self, name: str, path: Any, target: Any = None) -> Any:
        if name != "numba.core.dispatcher":
            return None
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(name)
        assert spec is not None and spec.loader is not None
        run: Any = spec.loader.exec_module

        def run_and_watch(module: Any) -> None:
            run(module)
            watch(module)

        spec.loader.exec_module = run_and_watch  # type: ignore[method-assign]
        return spec


def watch(module: Any) -> None:
    """Note each call that no compiled code of this process was there for."""
    base = module._DispatcherBase
    compile_for = base._compile_for_args
    known: set[str] = set()

    def compile_and_note(self: Any, *args: Any, **kwargs: Any) -> Any:
        before = set(self.overloads)
        try:
            return compile_for(self, *args, **kwargs)
        finally:
            name = f"{self.py_func.__module__}.{self.py_func.__qualname__}"
            for kinds in [k for k in self.overloads if k not in before]:
                if not name.startswith("gn0."):
                    continue
                from gn0.kernels.kernel_types import call_text

                line = call_text(name.removeprefix("gn0."), kinds) or f"? {name} {kinds}"
                if line not in known:
                    known.add(line)
                    with open(os.environ["GN0_KERNEL_CALLS"], "a") as stream:
                        stream.write(line + "\n")

    base._compile_for_args = compile_and_note


if os.environ.get("GN0_KERNEL_CALLS"):
    sys.meta_path.insert(0, _Finder())
