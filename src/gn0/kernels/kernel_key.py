"""What a compiled kernel depends on, as a key: its code, that of the kernels it calls, constants.

Numba keeps compiled code as long as the file of its source stays untouched, whatever it calls. By
this key it is kept as long as nothing that it is made of changes: another comment or a fresh
checkout compiles nothing, another constant compiles what uses it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np

_PLAIN = (bool, int, float, complex, str, bytes, type(None))


def kernel_key(kernel: Any) -> str:
    """Key of a kernel: equal keys compile to equal code, for one Numba and one processor.

    Args:
        kernel: what `njit` returned; its globals must be complete, as they are by its first call.
    """
    digest = hashlib.blake2b(digest_size=12)
    for part in _describe(kernel, set()):
        digest.update(part.encode("utf-8", "surrogatepass") + b"\0")
    return digest.hexdigest()


def _describe(value: Any, known: set[int]) -> Iterator[str]:
    """What Numba freezes of a value that a kernel names."""
    function = getattr(value, "py_func", value)
    if isinstance(function, FunctionType):
        yield f"function {function.__module__}.{function.__qualname__}"
        if id(function) in known:  # said already, or being said: kernels may call each other
            return
        known.add(id(function))
        options = getattr(value, "targetoptions", {})
        yield repr(sorted((name, repr(option)) for name, option in options.items()))
        yield repr(function.__defaults__)
        yield from _describe_code(function.__code__, function.__globals__, known)
        for cell in function.__closure__ or ():
            yield from _describe(cell.cell_contents, known)
    elif isinstance(value, _PLAIN):
        yield f"{type(value).__name__} {value!r}"
    elif isinstance(value, tuple | list | frozenset):
        yield f"{type(value).__qualname__} of {len(value)}"
        for item in sorted(value, key=repr) if isinstance(value, frozenset) else value:
            yield from _describe(item, known)
    elif isinstance(value, np.ndarray | np.generic):
        array = np.ascontiguousarray(value)
        yield f"{array.dtype.str} {array.shape} {hashlib.blake2b(array.tobytes()).hexdigest()}"
    elif isinstance(value, ModuleType):
        yield f"module {value.__name__}"
    elif isinstance(value, type):
        yield f"type {value.__module__}.{value.__qualname__} {getattr(value, '_fields', ())}"
    else:
        yield f"a {type(value).__module__}.{type(value).__qualname__}"


def _describe_code(code: CodeType, scope: dict[str, Any], known: set[int]) -> Iterator[str]:
    """Instructions without their lines, constants, and the globals that are named."""
    yield code.co_code.hex()
    yield repr((code.co_varnames, code.co_freevars, code.co_cellvars, code.co_argcount))
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _describe_code(constant, scope, known)
        else:
            yield from _describe(constant, known)
    for name in code.co_names:
        yield name
        if name in scope:
            yield from _describe(scope[name], known)
            continue
        for module in _our_modules(code, scope):  # a constant of a module that is named whole
            if hasattr(module, name):
                yield from _describe(getattr(module, name), known)


def _our_modules(code: CodeType, scope: dict[str, Any]) -> list[ModuleType]:
    named = (scope.get(name) for name in code.co_names)
    return [v for v in named if isinstance(v, ModuleType) and v.__name__.startswith("gn0.")]
