"""What a launch is given: a record of the kernel's parameters by name.

A record is a `NamedTuple` that has a field for each parameter, named and typed as the kernel's
source declares it: `DeviceArray` (or `DeviceArray | None`) for a pointer, a NumPy scalar type for
a number, `np.void` for a struct by value. A field may be a record itself, of parameters that
several kernels share. A name that Python or tuples already use ends in an underscore: `in_`,
`count_`. Record and kernel are compared when they first meet; later launches only read the fields.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from operator import attrgetter
from types import UnionType
from typing import Any, NamedTuple, get_args, get_type_hints

import numpy as np

from gn0.device.arguments import SCALARS, Parameter
from gn0.device.device import DeviceArray
from gn0.errors import DeviceError

Flatten = Callable[[Any], tuple[Any, ...]]


class Records:
    """The records that one kernel is given.

    Args:
        kernel: its name.
        parameters: as its source declares them.
    """

    def __init__(self, kernel: str, parameters: Sequence[Parameter]) -> None:
        self._kernel, self._parameters = kernel, parameters
        self._known: dict[type, Flatten | None] = {}  # None: the record is what is wanted

    def flatten(self, record: Any) -> tuple[Any, ...]:
        """The values of a record, in the order of the kernel's parameters.

        Raises:
            DeviceError: it is no record, or another than the kernel takes: a parameter is missing,
                beyond those that there are, there twice, or of another type.
        """
        kind = record.__class__
        try:
            flatten = self._known[kind]
        except KeyError:
            flatten = self._known[kind] = bind_record(self._kernel, self._parameters, kind)
        values: tuple[Any, ...] = record if flatten is None else flatten(record)
        return values


def bind_record(kernel: str, parameters: Sequence[Parameter], record: type) -> Flatten | None:
    """How to read a kernel's parameters from its record; None where they are its fields in order.

    Raises:
        DeviceError: see `Records.flatten`.
    """
    if not _is_record(record):
        raise DeviceError(
            f"a launch is given a {record.__name__}",
            where=f"kernel {kernel}",
            remedy="give a NamedTuple of the kernel's parameters, by name",
        )
    fields: dict[str, _Field] = {}
    try:
        found = list(_fields_of(record))
    except (NameError, TypeError) as error:  # of annotations that cannot be evaluated
        what = f"the types of {record.__name__} cannot be read: {error}"
        raise DeviceError(what, where=f"kernel {kernel}") from None
    for field in found:
        if field.name in fields:
            raise _wrong(kernel, field.name, record, "is there twice")
        fields[field.name] = field
    for name, kind in parameters:
        if name not in fields:
            raise _wrong(kernel, name, record, "is missing")
        if not _fits(fields[name].hint, kind):
            told = getattr(fields[name].hint, "__name__", fields[name].hint)
            raise _wrong(kernel, name, record, f"is {told}, not {_expected(kind)}")
    names = [name for name, _ in parameters]
    for name in fields:
        if name not in names:
            raise _wrong(kernel, name, record, "is not in the kernel's source")
    paths = [fields[name].path for name in names]
    if [path.removesuffix("_") for path in paths] == list(fields):
        return None
    read: Flatten = attrgetter(*paths)
    return read if len(paths) > 1 else lambda given: (read(given),)


class _Field(NamedTuple):
    """A field of a record or of one of its groups."""

    name: str
    path: str
    hint: Any


def _is_record(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, tuple) and hasattr(kind, "_fields")


def _fields_of(record: type, before: str = "") -> Iterator[_Field]:
    for name, hint in get_type_hints(record).items():
        if _is_record(hint):
            yield from _fields_of(hint, f"{before}{name}.")
        else:
            yield _Field(name.removesuffix("_"), before + name, hint)


def _fits(hint: Any, kind: str) -> bool:
    """Whether a field of a type may be a parameter of a C type."""
    if isinstance(hint, UnionType):
        hint = next((one for one in get_args(hint) if one is not type(None)), None)
        return kind.endswith("*") and hint is DeviceArray
    if kind.endswith("*"):
        return hint is DeviceArray
    wanted = np.dtype(SCALARS[kind]).type if kind in SCALARS else np.void
    return bool(hint is wanted)


def _expected(kind: str) -> str:
    if kind.endswith("*"):
        return f"DeviceArray ({kind})"
    return f"{SCALARS[kind]} ({kind})" if kind in SCALARS else f"np.void (struct {kind})"


def _wrong(kernel: str, name: str, record: type, what: str) -> DeviceError:
    return DeviceError(f"parameter {name} of {record.__name__} {what}", where=f"kernel {kernel}")
