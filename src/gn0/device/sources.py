"""All kernels of the package, to compile them ahead of time and to check them without a card.

A module that launches kernels holds their `KernelSource` in a variable, or several in a tuple
named `SOURCES`. Such modules are found by their text, which speaks of `KernelSource`.
"""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from types import ModuleType

from gn0.device.device import PRELUDE, KernelSource

_ROOT = Path(__file__).resolve().parent.parent


def kernel_files() -> list[Path]:
    """All CUDA C++ files of the package but the prelude."""
    return sorted(path for path in _ROOT.rglob("kernels/*.cu*") if path != PRELUDE)


def kernel_sources() -> list[KernelSource]:
    """Every `KernelSource` that a module of the package holds, by name; imports those modules."""
    found: dict[str, KernelSource] = {}
    for room in sorted({path.parent.parent for path in kernel_files()}):
        for path in sorted(room.glob("*.py")):
            if "KernelSource" in path.read_text("utf-8"):
                name = ".".join(path.relative_to(_ROOT.parent).with_suffix("").parts)
                for source in _held(import_module(name)):
                    found.setdefault(source.digest, source)
    return sorted(found.values(), key=lambda source: (source.name, source.digest))


def _held(module: ModuleType) -> Iterator[KernelSource]:
    for value in list(vars(module).values()):
        for item in value if isinstance(value, tuple | list) else (value,):
            if isinstance(item, KernelSource):
                yield item
