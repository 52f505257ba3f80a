"""The list of faults fits the code: each is where it says, changes something, and still parses."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

HERE = Path(__file__).resolve().parent


def beside(name: str) -> ModuleType:
    """A script of this folder as a module."""
    if name not in sys.modules:
        spec = importlib.util.spec_from_file_location(name, HERE / f"{name}.py")
        assert spec is not None and spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        spec.loader.exec_module(module)
    return sys.modules[name]


fault_list = beside("fault_list")
FAULTS = fault_list.load_faults()


def test_the_list_is_as_long_as_promised_and_half_of_it_is_drawn() -> None:
    names = [fault.name for fault in FAULTS]
    assert len(set(names)) == len(names)
    real = [fault for fault in FAULTS if not fault.equivalent]
    assert len(real) >= 150
    drawn = [fault for fault in FAULTS if fault.origin == "drawn"]
    assert len(drawn) >= 80 and len(drawn) >= 0.4 * len(FAULTS)


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name)
def test_every_fault_still_applies(fault) -> None:  # type: ignore[no-untyped-def]
    """When the code around it changed: the message says how to mend the list."""
    source = (fault_list.ROOT / fault.file).read_text()
    new = fault.changed(source)
    compile(new, fault.file, "exec")


def test_a_fault_whose_place_is_gone_says_so() -> None:
    fault = fault_list.Fault("gone", "a.py", "f", "return 2", "return 3")
    with pytest.raises(fault_list.StaleFaultError, match="0 times 'return 2' in f of"):
        fault.changed("def f():\n    return 1\n")
    with pytest.raises(fault_list.StaleFaultError, match="no function g"):
        fault_list.Fault("gone", "a.py", "g", "a", "b").changed("def f():\n    return 1\n")
    same = fault_list.Fault("same", "a.py", "f", "return 1", "return  1")
    with pytest.raises(fault_list.StaleFaultError, match="changes nothing"):
        same.changed("def f():\n    return 1\n")
    assert (
        fault_list.Fault("two", "a.py", "g", "1", "3")
        .changed("def f():\n    return 1\n\n\n@d\ndef g():\n    return 1\n")
        .endswith("def g():\n    return 3\n")
    )
