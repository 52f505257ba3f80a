"""The floors of the house: a room imports only from lower floors, torch only where allowed."""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

SRC = Path(__file__).resolve().parent.parent / "src" / "gn0"

FLOORS = {
    "__init__": 0, "__main__": 8,
    "errors": 0, "paper": 0, "geometry": 0, "config": 0, "storage": 0, "seeds": 0,
    "locked_folder": 0, "plugins": 0, "progress": 0, "jit": 0, "kernels": 0, "cache": 0,
    "yaml_file": 0, "leftovers": 0, "version": 0, "loopback": 0, "namespace": 0,
    "remote": 0, "counted": 0,
    "gaussians": 1, "maps": 1, "jobs": 1, "device": 1,
    "scenes": 2, "render": 2,
    "avatars": 2.5,  # people are made from surfaces, as scenes are; no renderer is known to them
    "people": 2.75,  # how they walk: missions plan with it what the simulator plays
    "missions": 3, "sim": 3.5,  # half a floor up: sim knows missions, never the other way
    "suites": 4,
    "bench": 5, "data": 5,  # neither knows the other
    "policies": 6,
    "training": 7, "serving": 7, "export": 7,
    "viewer": 8, "testing": 8, "cli": 8,
}  # fmt: skip
TORCH_ROOMS = (
    "render/gsplat", "scenes/grow", "scenes/capture", "policies/bae", "policies/expert",
    "policies/cma", "training",
)  # fmt: skip
FILES = sorted(SRC.rglob("*.py"))
# of this checkout, and no part of the package
BESIDE = [
    path
    for folder in ("benchmarks", "tests/trials")
    for path in sorted(SRC.parents[1].glob(f"{folder}/gn0_*/*.py"))
]


@cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text())


@pytest.fixture(scope="module", autouse=True)
def forget_trees() -> Iterator[None]:
    """Two million objects would have to be looked through whenever garbage is collected later."""
    yield
    tree_of.cache_clear()


@cache
def imports_of(path: Path) -> list[str]:
    names = []
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            names.append(node.module or "")
            names += [f"{node.module}.{alias.name}" for alias in node.names]
    return names


def room_of(path: Path) -> str:
    first = path.relative_to(SRC).parts[0]
    return first.removesuffix(".py")


def imports_go_down(path: Path) -> None:
    """No room imports a room of its own floor (other than itself) or of a higher one."""
    room = room_of(path)
    for name in imports_of(path):
        parts = name.split(".")
        if parts[0] != "gn0" or len(parts) < 2:
            continue
        other = parts[1]
        if other == room or other not in FLOORS:
            continue
        allowed = FLOORS[other] < FLOORS[room] or FLOORS[other] == FLOORS[room] == 0
        allowed = allowed or FLOORS[other] == FLOORS[room] == 8
        assert allowed, f"{path}: floor {FLOORS[room]} imports {name} of floor {FLOORS[other]}"


def circles() -> list[set[str]]:
    """Files that import each other in a circle; imports inside functions and for types count."""
    names = [".".join(path.relative_to(SRC).with_suffix("").parts) for path in FILES]
    number = {f"gn0.{name}": k for k, name in enumerate(names)}
    edges = {
        (k, number[name])
        for k, path in enumerate(FILES)
        for name in imports_of(path)
        if name in number
    }
    ways = coo_array((np.ones(len(edges)), np.array(sorted(edges)).T), (len(FILES), len(FILES)))
    _, group = connected_components(ways, connection="strong")
    grouped = [{names[k] for k in np.flatnonzero(group == g)} for g in np.unique(group)]
    return [circle for circle in grouped if len(circle) > 1]


def test_files_in_a_circle_are_one_idea() -> None:
    """At most two circles, both of the device and its driver."""
    found = circles()
    assert len(found) <= 2, found
    for circle in found:
        assert {name.split(".")[0] for name in circle} == {"device"}, circle


def torch_stays_in_its_rooms(path: Path) -> None:
    relative = str(path.relative_to(SRC))
    if not relative.startswith(TORCH_ROOMS):
        for name in imports_of(path):
            assert name.split(".")[0] not in ("torch", "torchvision"), f"{path} imports {name}"


# where one import name is not that of its distribution, or comes with another that is declared
PROVIDED = {"PIL": "pillow", "collada": "pycollada", "yaml": "pyyaml", "markupsafe": "jinja2"}
PROJECT = tomllib.loads((SRC.parents[1] / "pyproject.toml").read_text())["project"]


def names_of(dependencies: list[str]) -> set[str]:
    return {re.split("[<>=!~;[ ]", line, maxsplit=1)[0].lower() for line in dependencies}


CORE = names_of(PROJECT["dependencies"])
TRAIN = names_of(PROJECT["optional-dependencies"]["train"])
TRAIN_ROOMS = ("policies/bae", "policies/cma", "training")  # of no use without that extra


def top_imports(node: ast.AST) -> Iterator[str]:
    """Packages that loading a module brings with it; what is asked for inside functions is not."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.Import):
            yield from (alias.name.split(".")[0] for alias in child.names)
        elif isinstance(child, ast.ImportFrom):
            yield (child.module or "").split(".")[0]
        elif not isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef) and not (
            isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test)
        ):
            yield from top_imports(child)


def core_asks_for_nothing_that_it_does_not_install(path: Path) -> None:
    if room_of(path) == "testing":  # judges of the tests, which have the extras of developers
        return
    brought = CORE | (TRAIN if str(path.relative_to(SRC)).startswith(TRAIN_ROOMS) else set())
    for name in set(top_imports(tree_of(path))) - sys.stdlib_module_names - {"gn0"}:
        wanted = PROVIDED.get(name, name)
        assert wanted in brought, f"{path}: `pip install -e .` brings no {name}"


def test_simulator_never_imports_a_renderer() -> None:
    """The simulator is handed its renderer: only the protocol and the camera are known to it."""
    for path in (SRC / "sim").rglob("*.py"):
        used = {n for n in imports_of(path) if n.startswith("gn0.render.")}
        known = tuple(
            f"gn0.render.{m}" for m in ("renderer", "open", "instance", "camera", "bev", "light")
        )
        assert all(name.startswith(known) for name in used), f"{path}: {used}"


def modules_stay_small_and_named(path: Path) -> None:
    assert len(path.read_text().splitlines()) <= 700, f"{path} is over 700 lines"
    assert path.stem not in {"utils", "util", "helpers", "helper", "misc", "common", "base"}, path
    assert "manager" not in path.stem, path


def nothing_unsafe_is_called(path: Path) -> None:
    """No pickle, eval, exec, torch.load or yaml.load anywhere in the source."""
    for name in imports_of(path):
        assert name != "yaml" or path.name == "yaml_file.py", "read YAML by gn0.yaml_file alone"
        assert name.split(".")[0] not in {"pickle", "cloudpickle", "dill", "shelve", "marshal"}, (
            path
        )
    for node in ast.walk(tree_of(path)):
        if not isinstance(node, ast.Call) or not (
            isinstance(node.func, ast.Name) or getattr(node.func, "attr", "") == "load"
        ):
            continue
        text = ast.unparse(node.func)
        assert text not in {"eval", "exec", "torch.load", "yaml.load", "np.load"} or (
            text == "np.load"
            and any(
                k.arg == "allow_pickle" and ast.unparse(k.value) == "False" for k in node.keywords
            )
        ), f"{path}:{node.lineno}: {text}"


@pytest.mark.parametrize("path", BESIDE, ids=lambda p: f"{p.parent.name}/{p.name}")
def test_what_lies_beside_the_package_keeps_them_too(path: Path) -> None:
    """Benchmarks and trials may import whatever they like, but are of a size and safe."""
    modules_stay_small_and_named(path)
    nothing_unsafe_is_called(path)


def test_the_package_asks_for_nothing_that_it_does_not_hold() -> None:
    beside = {path.parent.name for path in BESIDE}
    assert beside
    for path in FILES:
        assert not beside & {name.split(".")[0] for name in imports_of(path)}, path


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(SRC)))
def test_a_file_keeps_the_rules_of_the_house(path: Path) -> None:
    """All rules in one test a file: what fails says which."""
    for rule in (
        imports_go_down,
        torch_stays_in_its_rooms,
        core_asks_for_nothing_that_it_does_not_install,
        modules_stay_small_and_named,
        nothing_unsafe_is_called,
    ):
        rule(path)
