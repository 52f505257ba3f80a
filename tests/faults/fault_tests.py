"""Which tests touch a file of the code, nearest first: read off the imports, so never out of date.

A test file is as far from a module as the shortest chain of imports between them; what is named
after the module, or names the function in question, comes before the others of its distance.
"""

from __future__ import annotations

import ast
import heapq
import re
from collections.abc import Iterable, Mapping
from functools import cached_property
from pathlib import Path

FARTHEST = 4  # imports: what is further away is hardly about the module
MOST = 40  # test files a fault


class TestMap:
    """The imports of a tree.

    Args:
        root: of the tree.
    """

    __test__ = False

    def __init__(self, root: Path) -> None:
        self.root = root
        self.modules = {
            ".".join(path.relative_to(folder).with_suffix("").parts).removesuffix(".__init__"): path
            for folder in (root / "src", root / "benchmarks", root / "tests/trials")
            for path in sorted(folder.glob("gn0*/**/*.py"))
        }

    @cached_property
    def users(self) -> dict[str, dict[str, int]]:
        """Who uses a module: module → modules, 1 by an import, 3 by a name in a text."""
        found: dict[str, dict[str, int]] = {name: {} for name in self.modules}
        for name, path in self.modules.items():
            imported, named = self._imports(path)
            for other in named:
                found[other][name] = 3
            for other in imported:
                found[other][name] = 1
        for name in self.modules:  # verbs are found by their names
            if name.startswith("gn0.cli.") and name != "gn0.cli.main":
                found[name]["gn0.cli.main"] = 1
        return found

    @cached_property
    def tests(self) -> dict[Path, set[str]]:
        """Modules that each test file imports, with those of its folder's conftest."""
        found = {}
        for path in sorted((self.root / "tests").rglob("test_*.py")):
            if path.parent.name == "faults":
                continue
            found[path] = set[str]().union(*self._imports(path))
            fixtures = path.parent / "conftest.py"
            if fixtures.exists():
                found[path] |= self._imports(fixtures)[0]
        return found

    @cached_property
    def kernels(self) -> set[str]:
        """Modules that hold compiled functions."""
        return {n for n, path in self.modules.items() if "from gn0.jit import" in path.read_text()}

    def _imports(self, path: Path) -> tuple[set[str], set[str]]:
        """Modules that a file imports, and those that it names in texts: plug-ins, workers."""
        names: set[str] = set()
        texts: set[str] = set()
        parts = path.parent.relative_to(self.root).parts
        package = ".".join(parts[1:])  # below src, benchmarks or tests
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                names |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                names |= {node.module, *(f"{node.module}.{a.name}" for a in node.names)}
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                stem, colon, _ = node.value.partition(":")
                texts.add(stem)
                if colon:  # "courtyard:draft_courtyard", told from where it stands
                    texts.add(f"{package}.{stem}")
        return names & self.modules.keys(), texts & self.modules.keys()

    def module_of(self, file: str) -> str:
        """The module's name of a file below the root; of a card's kernel, that which reads it."""
        path = self.root / file
        if path.suffix != ".py":
            path = path.parent.with_name("source.py")
        return next(n for n, p in self.modules.items() if p == path)

    def distances(self, module: str) -> dict[str, int]:
        """How far the users of a module are from it, itself included."""
        found: dict[str, int] = {}
        waiting = [(0, module)]
        while waiting:
            away, name = heapq.heappop(waiting)
            if name not in found:
                found[name] = away
                for user, step in self.users[name].items():
                    heapq.heappush(waiting, (away + step, user))
        return found

    def stale_kernels(self, file: str, where: str) -> set[str]:
        """Modules whose compiled functions may hold something of a file: their cache is dropped.

        What is inside a plain function is in no kernel; what is inside a kernel, or a constant, is
        in the kernels that import it, and in those that import them.
        """
        module = self.module_of(file)
        if where and module not in self.kernels:
            return set()
        found, waiting = {module}, [module]
        while waiting:
            for user, step in self.users[waiting.pop()].items():
                if step == 1 and user in self.kernels and user not in found:
                    found.add(user)
                    waiting.append(user)
        return found & self.kernels

    def tests_of(self, file: str, where: str, seconds: Mapping[str, float]) -> list[str]:
        """Test files for a function of a file, nearest and then fastest first.

        Args:
            file: below the root.
            where: the function's qualified name.
            seconds: how long test files took, as far as it is known.
        """
        module = self.module_of(file)
        near = self.distances(module)
        words = {part for part in where.split(".") if part and not part.startswith("__")}
        stem = Path(file).stem
        ranked = []
        for path, used in self.tests.items():
            away = min((near[name] for name in used if name in near), default=99)
            if away > FARTHEST:
                continue
            name = str(path.relative_to(self.root))
            text = path.read_text()
            rank = away + 1.0
            rank -= 1.5 * (path.stem in (f"test_{stem}", f"test_{stem}s"))
            rank -= 0.5 * (stem in path.stem)
            rank -= 0.5 * (stem.split("_")[0] in path.stem.split("_"))
            rank -= 0.5 * (path.parent.parts[-1] == Path(file).parent.parts[-1])
            rank -= 1.0 * any(word in text for word in words)
            rank -= 0.75 * (re.search(rf"\b{re.escape(stem)}\b", text) is not None)
            rank -= 1.5 * (Path(file).parts[2] in path.parts)
            rank += 2.0 * bool({"cuda", "gpu", "device"} & set(path.parts))  # slow where emulated
            ranked.append((rank, seconds.get(name, 5.0), name))
        return [name for _, _, name in sorted(ranked)][:MOST]


def batches(files: Iterable[str]) -> list[list[str]]:
    """Test files in parts: few at first, since most faults fall at once and imports take time."""
    rest, found = list(files), []
    for size in (3, 9, MOST):
        if rest:
            found.append(rest[:size])
            rest = rest[size:]
    return found
