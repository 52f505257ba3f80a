"""URLs among a verb's arguments: inputs are fetched first, what is made is published last."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec

from gn0.errors import StorageError
from gn0.remote import is_url, local_path, publish, work_path

OUTPUT = "out"
_LEAVE = {"copy": ("target",)}  # verbs that see to a URL themselves
# verbs that write into the folder they are given
IN_PLACE = {"data balance", "data render", "data repair", "scene visible"}


def bring_here(verb: str, args: Any) -> tuple[Any, str]:
    """Arguments whose URLs are local paths now, and the URL of what will be made; "" for none.

    Raises:
        StorageError, FormatError: an input is not there or cannot be had.
    """
    from gn0.cli.console import draw_progress

    changed: dict[str, Any] = {}
    target = ""
    for name in args.__struct_fields__:
        value = getattr(args, name)
        texts = value if isinstance(value, tuple) else (value,)
        if not any(map(is_url, texts)) or name in _LEAVE.get(verb, ()):
            continue
        if name == OUTPUT:
            target, changed[name] = value, str(work_path(value))
            continue
        if verb in IN_PLACE:
            raise StorageError(
                f"`gn0 {verb}` writes into that folder, which must be on this machine",
                where=next(filter(is_url, texts)),
                remedy="fetch it with `gn0 copy URL DIR`, and copy it back when it is done",
            )
        with draw_progress() as progress:
            here = tuple(
                str(local_path(text, progress=progress)) if is_url(text) else text for text in texts
            )
        changed[name] = here if isinstance(value, tuple) else here[0]
    return (msgspec.structs.replace(args, **changed) if changed else args), target


def publish_made(args: Any, url: str) -> None:
    """Put what a verb made into its store, and say so.

    Raises:
        StorageError: the store cannot be reached or refuses; the same command goes on.
    """
    from gn0.cli.console import draw_progress

    made = Path(args.out)
    if not made.exists():
        return
    with draw_progress() as progress:
        publish(made, url, progress=progress)
    print(f"published: {url}")
