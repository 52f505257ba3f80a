"""Launches are given records by name: a record that does not fit its kernel is told of at once."""

from __future__ import annotations

import ast
import inspect
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple, get_type_hints

import numpy as np
import pytest

from gn0.device import trial
from gn0.device.arguments import parse_prototypes
from gn0.device.device import DeviceArray, KernelSource
from gn0.device.host import DeviceHost
from gn0.device.records import Records, bind_record
from gn0.device.sources import kernel_sources
from gn0.errors import DeviceError
from gn0.render.cuda import depth
from gn0.render.cuda import records as drawing
from gn0.render.share import digest, jpeg, maps
from gn0.sim import device_records

ROOT = Path(__file__).resolve().parents[2]
TEXT = """
struct Plan { int steps; };
KERNEL(move)(const float *in, u32 count, Plan plan, float by, bool wide, u8 *out) {
  if (threadIdx.x < count) out[threadIdx.x] = (u8)(in[threadIdx.x] * by + plan.steps);
}
"""
PARAMETERS = parse_prototypes(TEXT)["move"]
HOLDERS = (trial, depth, drawing, digest, jpeg, maps, device_records)


class Move(NamedTuple):
    in_: DeviceArray
    count_: np.uint32
    plan: np.void
    by: np.float32
    wide: np.bool_
    out: DeviceArray | None


class Where(NamedTuple):
    out: DeviceArray
    in_: DeviceArray


class How(NamedTuple):
    where: Where
    plan: np.void


class Grouped(NamedTuple):
    """In another order, and in groups of groups."""

    by: np.float32
    how: How
    wide: np.bool_
    count_: np.uint32


class Short(NamedTuple):
    in_: DeviceArray
    count_: np.uint32


class Twice(NamedTuple):
    where: Where
    out: DeviceArray


class Long(NamedTuple):
    in_: DeviceArray
    count_: np.uint32
    plan: np.void
    by: np.float32
    wide: np.bool_
    out: DeviceArray
    more: np.uint32


class Number(NamedTuple):
    in_: DeviceArray
    count_: np.int32


class Optional(NamedTuple):
    in_: DeviceArray
    count_: np.uint32 | None


class Pointer(NamedTuple):
    in_: DeviceArray
    count_: DeviceArray


class Plain(NamedTuple):
    in_: DeviceArray
    count_: int


class Unknown(NamedTuple):
    in_: Nowhere  # type: ignore[name-defined] # noqa: F821


@pytest.mark.parametrize(
    ("record", "said"),
    [
        (Short, "parameter plan of Short is missing"),
        (Twice, "parameter out of Twice is there twice"),
        (Long, "parameter more of Long is not in the kernel's source"),
        (Number, r"parameter count of Number is int32, not uint32 \(u32\)"),
        (Optional, r"parameter count of Optional is .*, not uint32 \(u32\)"),
        (Pointer, r"parameter count of Pointer is DeviceArray, not uint32 \(u32\)"),
        (Plain, r"parameter count of Plain is int, not uint32 \(u32\)"),
        (Unknown, "the types of Unknown cannot be read: name 'Nowhere'"),
        (tuple, r"a launch is given a tuple.*NamedTuple of the kernel's parameters"),
        (DeviceArray, "a launch is given a DeviceArray"),
    ],
)
def test_a_record_of_another_kernel_is_refused(record: type, said: str) -> None:
    with pytest.raises(DeviceError, match=f"kernel move: {said}"):
        bind_record("move", PARAMETERS, record)


def test_parameters_are_found_by_name() -> None:
    records, a, b, plan = Records("move", PARAMETERS), object(), object(), np.zeros(1, "i4,i4")[0]
    count, by, wide = np.uint32(3), np.float32(2), np.bool_(True)
    flat = Move(a, count, plan, by, wide, b)  # type: ignore[arg-type]
    assert records.flatten(flat) is flat
    where = Where(out=b, in_=a)  # type: ignore[arg-type]
    grouped = Grouped(by=by, how=How(where, plan), wide=wide, count_=count)
    assert records.flatten(grouped) == tuple(flat)
    one = Records("one", PARAMETERS[:1])

    class Inner(NamedTuple):
        in_: DeviceArray

    given = NamedTuple("Outer", [("inner", Inner)])(Inner(a))  # type: ignore[arg-type,misc]
    assert one.flatten(given) == (a,)


def test_a_record_and_a_kernel_are_compared_once(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[type] = []
    monkeypatch.setattr(
        "gn0.device.records.bind_record",
        lambda kernel, parameters, record: (
            seen.append(record) or bind_record(kernel, parameters, record)
        ),
    )
    records = Records("move", PARAMETERS)
    given = Move(*[None] * 6)  # type: ignore[arg-type]
    for _ in range(3):
        records.flatten(given)
    assert seen == [Move]


@pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")
def test_a_kernel_gets_its_record(tmp_path: Path) -> None:
    (tmp_path / "move.cu").write_text(TEXT)
    device = DeviceHost()
    kernel = device.load(KernelSource("move", (tmp_path / "move.cu",)))["move"]
    out = device.zeros(4, np.uint8)
    plan = np.array([(5,)], [("steps", "i4")])[0]
    where = Where(out=out, in_=device.upload(np.arange(4, dtype=np.float32)))
    kernel.launch(1, 4, Grouped(np.float32(2), How(where, plan), np.bool_(False), np.uint32(3)))
    assert out.numpy().tolist() == [5, 7, 9, 0]
    with pytest.raises(DeviceError, match="kernel move: a launch is given a tuple"):
        kernel.launch(1, 4, (out, np.uint32(3)))  # type: ignore[arg-type]


def records_of(module: Any) -> list[type]:
    return [
        kind
        for _, kind in inspect.getmembers(module, inspect.isclass)
        if issubclass(kind, tuple) and kind.__module__ == module.__name__
    ]


def test_every_kernel_has_a_record() -> None:
    """And every record a kernel, or a record that it is a group of."""
    records = {record for module in HOLDERS for record in records_of(module)}
    used = {hint for record in records for hint in get_type_hints(record).values()} & records
    for source in kernel_sources():
        for name, parameters in parse_prototypes(source.text).items():
            fits = set()
            for record in records:
                try:
                    bind_record(name, parameters, record)
                except DeviceError:
                    continue
                fits.add(record)
            assert fits, f"{name} of {source.name}"
            used |= fits
    assert used == records


def launches(path: Path) -> Iterator[ast.Call]:
    """Calls of `launch` with a grid, a block and what the kernel is given."""
    text = path.read_text("utf-8")
    for node in ast.walk(ast.parse(text)) if ".launch(" in text else ():
        if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)):
            continue
        if node.func.attr == "launch" and node.args:  # a graph's takes nothing
            yield node


def test_launches_are_given_one_record() -> None:
    """No positions: two numbers of one type that change places are nobody's error."""
    found = 0
    files = [path for room in ("src", "benchmarks") for path in (ROOT / room).rglob("*.py")]
    for path in sorted(files):
        for call in launches(path):
            found += 1
            place = f"{path.relative_to(ROOT)}:{call.lineno}"
            assert len(call.args) == 3, place
            assert not any(isinstance(arg, ast.Starred) for arg in call.args), place
    assert found > 40
