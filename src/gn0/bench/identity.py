"""Who ran: what distinguishes two policies of one name.

A run is of a policy's source and of what the policy, or its server, says it is. Either one changed
means other scores, so neither may be shown as the other.
"""

from __future__ import annotations

import ast
import functools
import hashlib
import inspect
import os
import sys
import sysconfig
from collections.abc import Iterator, Mapping, Sequence
from importlib import invalidate_caches
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from gn0.errors import ConfigError, PolicyError
from gn0.plugins import get_plugin, installed_modules, is_builtin
from gn0.sim.policy import PolicyIdentified

Identity = tuple[tuple[str, str], ...]

ENTRIES_LIMIT = 32
WORDS_LIMIT = 200  # characters of an entry
_MENDED = "put the file back, or choose another --out for a run without it"


def read_identity(policy: Any) -> Identity:
    """What a policy declares itself to be, as (what, value) in the order it gave.

    Raises:
        PolicyError: its `identity()` gives no map of short plain values.
    """
    if not isinstance(policy, PolicyIdentified):
        return ()
    said = policy.identity()
    entries = list(said.items()) if isinstance(said, Mapping) else [("", None)]
    good = all(
        isinstance(name, str) and name and isinstance(value, str | int | float)
        for name, value in entries
    )
    if not good or len(entries) > ENTRIES_LIMIT:
        raise PolicyError(
            f"identity() of policy {str(policy.name)[:80]!r} is not a map of names to plain values",
            remedy='return e.g. {"checkpoint": digest, "version": "3"}',
        )
    return tuple((name[:WORDS_LIMIT], str(value)[:WORDS_LIMIT]) for name, value in entries)


def tell_identity(identity: Identity) -> str:
    """An identity in words."""
    return ", ".join(f"{name} {value}" for name, value in identity) or "none declared"


def digest_policy(name: str, modules: Sequence[str] = (), *, isolated: bool = False) -> str:
    """Digest of the source of a policy and of the modules that were named with it; "" for GN0's.

    Counted are all `*.py` below the top package of each, or beside the file of a lone module; and
    below what those files import from their own folder.

    Args:
        name: name of the policy.
        modules: as given to `--plugin`; imported already, unless it is isolated.
        isolated: import nothing of it here.

    Raises:
        ConfigError: no such policy, or a file is gone or cannot be read.
    """
    own: Sequence[str] = ()
    if not is_builtin("policy", name):
        own = installed_modules() if isolated else (_module_of(get_plugin("policy", name)),)
    return digest_modules([*modules, *own])


def digest_modules(modules: Sequence[str]) -> str:
    """Digest of the source of modules that are not GN0's; "" of none.

    Raises:
        ConfigError: one is not to be found, or a file is gone or cannot be read.
    """
    tops = sorted({name.partition(".")[0] for name in modules} - {"", "gn0"})
    files: dict[str, Path] = {}
    for top in tops:
        if top not in sys.stdlib_module_names or top == "__main__":
            files |= {f"{top}: {name}": path for name, path in _sources(top)}
    if not files:
        return ""
    digest = hashlib.blake2b(digest_size=8)
    for name, path in sorted(files.items()):
        digest.update(name.encode("utf-8", "surrogatepass") + b"\0" + _read(path) + b"\0")
    return digest.hexdigest()


def _module_of(factory: Any) -> str:
    while isinstance(factory, functools.partial):
        factory = factory.func
    if not (inspect.isclass(factory) or inspect.isroutine(factory)):
        factory = type(factory)
    return str(getattr(factory, "__module__", None) or "")


def _sources(top: str) -> Iterator[tuple[str, Path]]:
    """The files of a top-level module, each by a name that no folder above it is part of."""
    folders, own = _locate(top)
    for folder in folders:
        yield from ((path.relative_to(folder).as_posix(), path) for path in _below(folder))
    if own is None:
        return  # typed in, or a namespace
    path = own
    while not path.exists() and path != path.parent and path.suffix != ".py":
        path = path.parent  # inside an archive
    if folders and path.suffix == ".py":
        return
    yield path.name, path
    if not folders and path.suffix == ".py" and path.parent.resolve() not in _shared_folders():
        yield from _beside(path)


def _locate(top: str) -> tuple[list[Path], Path | None]:
    """Folders and file of a top-level module, which is not imported for that."""
    module = sys.modules.get(top)
    if module is not None:
        folders, own = getattr(module, "__path__", ()), getattr(module, "__file__", None)
    else:
        invalidate_caches()
        try:
            spec = find_spec(top)
        except (ImportError, ValueError):
            spec = None
        if spec is None:
            raise ConfigError(
                f"cannot find the plug-in module {top!r}",
                remedy="install it, or put its folder on PYTHONPATH",
            )
        folders, own = spec.submodule_search_locations or (), spec.origin
    return [Path(folder) for folder in folders], None if own is None else Path(own)


def _beside(path: Path) -> Iterator[tuple[str, Path]]:
    """What lies beside a lone module, and the packages there that are imported."""
    folder = path.parent
    seen: set[Path] = set()
    waiting = sorted(folder.glob("*.py"))
    while waiting:
        file = waiting.pop()
        if file in seen:
            continue
        seen.add(file)
        yield file.relative_to(folder).as_posix(), file
        for name in _imported(file):
            package = folder / name
            if package.is_dir() and package not in seen:
                seen.add(package)
                waiting += _below(package, only_packages=True)


def _imported(path: Path) -> set[str]:
    """Top names that a file imports, anywhere in it."""
    try:
        tree = ast.parse(_read(path))
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return set()
    names: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names.add(node.module.partition(".")[0])
    return names


def _below(folder: Path, *, only_packages: bool = False) -> list[Path]:
    """The `*.py` below a folder; with `only_packages` not below folders that hold none."""
    found: list[Path] = []
    for where, inner, names in os.walk(folder):
        sources = [Path(where, name) for name in names if name.endswith(".py")]
        inner[:] = sorted(n for n in inner if n != "__pycache__" and not n.startswith("."))
        if only_packages and not sources:
            inner.clear()
        found += sources
    return sorted(found)


def _shared_folders() -> set[Path]:
    """Where installed packages lie side by side, none of them another's business."""
    return {Path(sysconfig.get_path(name)).resolve() for name in ("purelib", "platlib", "stdlib")}


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise ConfigError(
            f"the source of a plug-in cannot be read: {error.strerror or error}",
            where=path,
            remedy=_MENDED,
        ) from None
