"""What `gn0 doctor` reports about graphics cards: card, driver, compiler, compiled kernels."""

from __future__ import annotations

import time
from typing import Any

from gn0.errors import ConfigError, DeviceError

Row = tuple[str, str, str]  # name, finding, mark


def examine_gpu(*, compile_all: bool = False, architecture: str = "") -> tuple[list[Row], bool]:
    """Lines about the card, and whether all that was tried went well.

    Args:
        compile_all: compile the kernels that are not in the cache yet.
        architecture: compile for this one, such as "sm_90"; the card's own when "".

    Raises:
        ConfigError: no such architecture.
    """
    from gn0.device.libcuda import say_driver, say_version
    from gn0.device.open import find_device

    device: Any
    device, reason = find_device()
    card = device if device is not None and device.kind == "cuda" else None
    if card is not None:
        free, total = card.memory()
        size = f"{free / 2**30:.1f} of {total / 2**30:.1f} GiB free"
        number = ".".join(map(str, card.capability))
        text = f"{card.name}, {size}, {card.multiprocessors} multiprocessors, capability {number}"
        speaks = f"{say_driver()}speaks CUDA {say_version(card.driver.version)}"
        rows = [("gpu", text, "✓"), ("driver", speaks, "✓")]
    else:
        rows = [("gpu", reason, "·")]
    rows.append(_compiler(card))
    tried = card is None or rows[-1][2] != "✓" or _try(card, rows)
    target = _target(card, architecture)
    if not target:
        if compile_all:
            rows.append(("kernels", "no card to compile for: try --architecture sm_90", "·"))
        return rows, tried
    kernels, well = _kernels(card, target, compile_all)
    return [*rows, kernels], tried and well


def _try(card: Any, rows: list[Row]) -> bool:
    """Try the card, and add what came of it."""
    from gn0.device.trial import try_card

    begun = time.perf_counter()
    wrong = try_card(card)
    took = time.perf_counter() - begun
    rows += [("trial", text, "✗") for text in wrong]
    if not wrong:
        rows.append(("trial", f"copies, kernels and recordings work; {took:.1f} s", "✓"))
    return not wrong


def _compiler(card: Any) -> Row:
    from gn0.device.nvrtc import INSTALL, Nvrtc, find_nvrtc

    file = find_nvrtc(card and card.driver.version // 1000)
    if file is None:
        return "nvrtc", f"none; to draw on an NVIDIA card: {INSTALL}", "·"
    try:
        version = Nvrtc(file).version
    except DeviceError as error:
        return "nvrtc", f"{error.what}: {file.path}", "✗"
    return "nvrtc", f"{version[0]}.{version[1]} at {file.path}", "✓"


def _target(card: Any, architecture: str) -> tuple[int, int] | None:
    """Compute capability to look at and compile for."""
    if architecture:
        digits = architecture.removeprefix("sm_")
        if not digits.isdecimal() or len(digits) < 2:
            raise ConfigError(
                f"no architecture {architecture!r}", where="--architecture", remedy="such as sm_90"
            )
        return int(digits[:-1]), int(digits[-1])
    return card.capability if card is not None else None


def _kernels(card: Any, target: tuple[int, int], compile_all: bool) -> tuple[Row, bool]:
    from gn0.device.compile import cache_path, load_image, read_image
    from gn0.device.nvrtc import open_nvrtc
    from gn0.device.sources import kernel_sources

    try:
        compiler = open_nvrtc(card and card.driver.version // 1000)
        arch, _ = compiler.target(target)
        sources = kernel_sources()
        cached = [s for s in sources if read_image(cache_path(s, arch, compiler)) is not None]
        text = f"{len(cached)} of {len(sources)} modules are compiled for {arch}"
        if not compile_all:
            more = "" if len(cached) == len(sources) else "; the others at first use"
            return ("kernels", text + more, "✓"), True
        begun = time.perf_counter()
        for source in sources:
            load_image(source, target, compiler)
            if card is not None and card.capability == target:
                card.load(source)
        took = time.perf_counter() - begun
        made = len(sources) - len(cached)
        text = f"all {len(sources)} modules are compiled for {arch}: {made} now, in {took:.1f} s"
        return ("kernels", text, "✓"), True
    except DeviceError as error:
        return ("kernels", str(error), "✗"), False
