"""Draw faults from the syntax tree, by a seed that was written down before the first run.

    python tests/faults/draw_faults.py              # prints what the seed draws from this tree
    python tests/faults/draw_faults.py --write      # makes drawn.toml of it: done once
    python tests/faults/draw_faults.py --again NAME # one more draw, for a fault whose code is gone

A draw takes a room (each equally often), a file of it (by its number of lines), a kind of change,
and a place, in this order, so that neither the longest files nor the commonest operator rule.
"""

from __future__ import annotations

import argparse
import ast
import random
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

from fault_list import HERE, ROOT, Fault, StaleFaultError, functions_of

SEED = 20261122  # written down, and committed, before any fault was run
COUNT = 108

# what this measures: code that runs without torch and without a GPU. What tests itself (testing) or
# drives a card is left out
ROOMS: dict[str, tuple[str, ...]] = {
    "core": ("storage.py", "geometry.py", "config.py", "seeds.py", "locked_folder.py",
             "plugins.py"),
    **{name: (name,) for name in ("gaussians", "maps", "jobs", "scenes", "render", "missions",
                                  "sim", "suites", "bench", "data", "policies", "export",
                                  "viewer", "cli")},
}  # fmt: skip
LEFT_OUT = ("render/cuda", "render/gsplat", "render/share", "sim/device_", "sim/kernels",
            "viewer/live", "cli/doctor_gpu", "cli/figures", "data/cache_")  # fmt: skip

_SWAP = {
    ast.Lt: "<=", ast.LtE: "<", ast.Gt: ">=", ast.GtE: ">", ast.Eq: "!=", ast.NotEq: "==",
    ast.Is: "is not", ast.IsNot: "is", ast.In: "not in", ast.NotIn: "in",
}  # fmt: skip
_SIGN = {
    ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!=",
    ast.Is: "is", ast.IsNot: "is not", ast.In: "in", ast.NotIn: "not in",
    ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.FloorDiv: "//",
}  # fmt: skip
_OTHER = {ast.Add: "-", ast.Sub: "+", ast.Mult: "/", ast.Div: "*", ast.FloorDiv: "/"}
_TWINS = {
    "min": "max", "max": "min", "any": "all", "all": "any", "floor": "ceil", "ceil": "floor",
    "cos": "sin", "sin": "cos", "minimum": "maximum", "maximum": "minimum",
    "argmin": "argmax", "argmax": "argmin",
}  # fmt: skip
KINDS = ("comparison", "constant", "arithmetic", "condition", "logic", "removed", "swapped",
         "twin")  # fmt: skip


def edits_of(function: ast.AST, source: Source) -> Iterator[tuple[str, ast.AST, int, int, str]]:
    """(kind, node, first and last character, text instead) of each change inside a function."""
    for node in _code_of(function):
        if isinstance(node, ast.Compare) and len(node.ops) == 1:
            old, new = _SIGN[type(node.ops[0])], _SWAP[type(node.ops[0])]
            at = source.between(node.left, node.comparators[0], old)
            if at is not None:
                yield "comparison", node, at, at + len(old), new
        elif isinstance(node, ast.BinOp) and type(node.op) in _OTHER:
            old = _SIGN[type(node.op)]
            at = source.between(node.left, node.right, old)
            texts = any(isinstance(n, ast.Constant | ast.JoinedStr | ast.List)
                        and not isinstance(getattr(n, "value", None), int | float)
                        for n in (node.left, node.right))  # fmt: skip
            if at is not None and not texts:
                yield "arithmetic", node, at, at + len(old), _OTHER[type(node.op)]
        elif isinstance(node, ast.Constant):
            value = node.value
            if isinstance(value, bool):
                yield "constant", node, *source.span(node), str(not value)
            elif isinstance(value, int):
                yield "constant", node, *source.span(node), str(value + 1)
            elif isinstance(value, float):
                yield "constant", node, *source.span(node), repr(value * 1.5 if value else 1.0)
        elif isinstance(node, ast.If | ast.While | ast.IfExp):
            begin, end = source.span(node.test)
            if not isinstance(node.test, ast.Compare | ast.BoolOp | ast.Constant):
                yield "condition", node, begin, end, f"not ({source.text[begin:end]})"
        elif isinstance(node, ast.BoolOp):
            old = "and" if isinstance(node.op, ast.And) else "or"
            at = source.between(node.values[0], node.values[1], old)
            if at is not None and len(node.values) == 2:
                yield "logic", node, at, at + len(old), "or" if old == "and" else "and"
        elif isinstance(node, ast.Expr | ast.AugAssign | ast.Raise | ast.Continue):
            silent = isinstance(node, ast.Expr) and not isinstance(node.value, ast.Call)
            if not silent:
                yield "removed", node, *source.span(node), "pass"
        elif isinstance(node, ast.Call):
            if _may_swap(node, source):
                (a0, a1), (b0, b1) = source.span(node.args[0]), source.span(node.args[1])
                text = source.text
                yield "swapped", node, a0, b1, text[b0:b1] + text[a1:b0] + text[a0:a1]
            called = node.func
            name = called.attr if isinstance(called, ast.Attribute) else getattr(called, "id", "")
            if name in _TWINS:
                _, end = source.span(node.func)
                yield "twin", node, end - len(name), end, _TWINS[name]


def _may_swap(call: ast.Call, source: Source) -> bool:
    """Whether its first two arguments are of one kind, so that no type check refuses the other."""
    if len(call.args) < 2:
        return False
    one, two = call.args[:2]
    texts = [source.text[slice(*source.span(a))] for a in (one, two)]
    return (
        type(one) is type(two)
        and not isinstance(one, ast.Starred | ast.Constant)
        and texts[0] != texts[1]
        and not any(text.startswith(("np.", "pa.")) for text in texts)
    )


def _code_of(function: ast.AST) -> Iterator[ast.AST]:
    """Nodes that run: no docstrings, annotations, defaults' types, messages or inner functions."""
    for node in ast.iter_child_nodes(function):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef | ast.arg):
            continue
        if node in getattr(function, "decorator_list", ()):
            continue
        if node is getattr(function, "returns", 0):
            continue
        if isinstance(node, ast.AnnAssign) and node.value is None:
            continue
        if isinstance(node, ast.Raise | ast.Assert | ast.JoinedStr):
            if isinstance(node, ast.Raise):
                yield node
            continue
        if node is getattr(function, "annotation", 0):
            continue
        yield node
        yield from _code_of(node)


class Source:
    """A file's text, and where its nodes are in it."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.text = path.read_text()
        self.tree = ast.parse(self.text)
        self._lines = [0]
        for line in self.text.splitlines(keepends=True):
            self._lines.append(self._lines[-1] + len(line))
        self._raw = [line.encode() for line in self.text.splitlines(keepends=True)]

    def place(self, line: int, column: int) -> int:
        """Character of a line and UTF-8 column."""
        return self._lines[line - 1] + len(self._raw[line - 1][:column].decode())

    def span(self, node: ast.AST) -> tuple[int, int]:
        """First and past-the-last character of a node."""
        return (
            self.place(node.lineno, node.col_offset),  # type: ignore[attr-defined]
            self.place(node.end_lineno, node.end_col_offset),  # type: ignore[attr-defined]
        )

    def between(self, left: ast.AST, right: ast.AST, sign: str) -> int | None:
        """Where an operator stands between its operands; None if a comment is in the way."""
        begin, end = self.span(left)[1], self.span(right)[0]
        gap = self.text[begin:end]
        return begin + gap.index(sign) if gap.count(sign) == 1 and "#" not in gap else None

    def fault(self, where: str, function: ast.AST, begin: int, end: int, new: str) -> Fault | None:
        """The change as a fault whose text occurs once: whole lines, as many as that needs."""
        first = self.text.rfind("\n", 0, begin) + 1
        last = self.text.find("\n", end)
        last = len(self.text) if last < 0 else last
        top = self.span(function)[0]
        while True:
            find = self.text[first:last]
            put = self.text[first:begin] + new + self.text[end:last]
            try:
                found = Fault("", str(self.path.relative_to(ROOT)), where, find, put)
                return found if compile(found.changed(self.text), "", "exec") else None
            except StaleFaultError:
                if first <= top:
                    return None
                first = self.text.rfind("\n", 0, first - 1) + 1
            except (SyntaxError, ValueError):
                return None


def files_of(room: str) -> list[Path]:
    """Files of a room that count."""
    folder, found = ROOT / "src/gn0", []
    for name in ROOMS[room]:
        path = folder / name
        found += [path] if path.is_file() else sorted(path.rglob("*.py"))
    return [p for p in found if not str(p.relative_to(folder)).startswith(LEFT_OUT)]


def draw(seed: int) -> Iterator[Fault]:
    """Faults without end."""
    rng = random.Random(seed)
    names = sorted(ROOMS)
    sources: dict[Path, Source] = {}
    taken: set[tuple[str, str, str]] = set()
    number = 0
    while True:
        room = names[number % len(names)]
        number += 1
        paths = files_of(room)
        for _ in range(20):
            path = rng.choices(paths, [p.read_text().count("\n") + 1 for p in paths])[0]
            source = sources.setdefault(path, Source(path))
            kind = rng.choice(KINDS)
            places = [
                (where, node, edit)
                for where, node in functions_of(source.tree)
                if not isinstance(node, ast.ClassDef)
                for edit in edits_of(node, source)
                if edit[0] == kind
            ]
            if not places:
                continue
            where, node, (_, _, begin, end, new) = rng.choice(places)
            fault = source.fault(where, node, begin, end, new)
            if fault is None or (fault.file, where, fault.put) in taken:
                continue
            taken.add((fault.file, where, fault.put))
            old = " ".join(source.text[begin:end].split())
            tells = f"{kind}: {old[:60]} -> {' '.join(new.split())[:60]}"
            name = f"{room}-{path.stem}-{where.split('.')[-1].strip('_')}-{kind}".replace("_", "-")
            yield Fault(name, fault.file, where, fault.find, fault.put, tells, origin="drawn")
            break


def numbered(seed: int) -> Iterator[Fault]:
    """Drawn faults, with a number at the end of their names."""
    for number, fault in enumerate(draw(seed), 1):
        yield Fault(**{**vars(fault), "name": f"{number:03d}-{fault.name}"})


def encode(fault: Fault) -> str:
    """A fault as TOML."""
    lines = ["[[fault]]"]
    for key in ("name", "file", "where", "tells", "equivalent"):
        value = getattr(fault, key)
        if value or key == "where":
            lines.append(f"{key} = {_quoted(value)}")
    lines += [f"{key} = '''\n{getattr(fault, key)}'''" for key in ("find", "put")]
    return "\n".join(lines) + "\n"


def _quoted(text: str) -> str:
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'


def main() -> int:
    """Print, write, or draw again."""
    parser = argparse.ArgumentParser(description="draw faults by the seed")
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--again", metavar="NAME")
    asked = parser.parse_args()
    path = HERE / "drawn.toml"
    if asked.again:
        faults = [Fault(**row, origin="drawn") for row in tomllib.loads(path.read_text())["fault"]]
        if asked.again not in {fault.name for fault in faults}:
            print(f"no drawn fault {asked.again!r}", file=sys.stderr)
            return 2
        used = {(f.file, f.where, f.put) for f in faults}
        file = next(f.file for f in faults if f.name == asked.again)
        for fault in numbered(SEED + 1):
            if fault.file == file and (fault.file, fault.where, fault.put) not in used:
                print(encode(Fault(**{**vars(fault), "name": asked.again + "-again"})))
                return 0
    stream = numbered(SEED)
    rows = [encode(next(stream)) for _ in range(COUNT)]
    head = (
        f"# Drawn by draw_faults.py from the syntax tree, seed {SEED}, before any fault was run.\n"
    )
    text = head + "\n" + "\n".join(rows)
    if asked.write:
        path.write_text(text)
    else:
        print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
