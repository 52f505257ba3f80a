"""Write the API reference, docs/api/*.md, from the docstrings of what is public.

python docs/draw_api.py
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from enum import Enum
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, ForwardRef

ROOT = Path(__file__).resolve().parent.parent
HEADINGS = ("Args", "Attributes", "Returns", "Yields", "Raises")
INDEX = [
    "# API reference",
    "",
    "What your code may import from GN0. Every name is typed, and imported from where it is",
    "listed; anything deeper in the package is private and may move between releases.",
    "",
    "This reference is generated from the docstrings by `python docs/draw_api.py`.",
    "",
    "| import from | what | names |",
    "| --- | --- | --- |",
]
WIDTH = 96  # of a signature's line

EXTRA = {"training"}  # needs the extra of its name; docs/training.md tells of it


def namespaces() -> list[str]:
    """The root, then the namespaces below it that the core installs."""
    stubs = (ROOT / "src/gn0").glob("*/__init__.pyi")
    rooms = (stub.parent.name for stub in stubs)
    return ["gn0", *sorted(f"gn0.{room}" for room in rooms if room not in EXTRA)]


def tell_annotation(annotation: Any) -> str:
    """A type as a reader would write it."""
    if isinstance(annotation, ForwardRef):
        annotation = annotation.__forward_arg__
    if inspect.isclass(annotation) and not hasattr(annotation, "__args__"):
        annotation = annotation.__qualname__
    return re.sub(
        r"\b(?:typing|numpy|datetime|pathlib|collections\.abc|gn0(?:\.\w+)*)\.", "", str(annotation)
    )


class Told:
    """A default or a type that prints as text, and never as a place in memory."""

    def __init__(self, text: str) -> None:
        self.text = text

    def __repr__(self) -> str:
        return self.text


def tell_default(value: Any) -> Told:
    """A default, shortened where it would not be read."""
    text = repr(value.value if isinstance(value, Enum) else value)
    return Told("..." if len(text) > 40 or " at 0x" in text or text[:1] == "<" else text)


def tell_signature(name: str, thing: Any, *, method: bool = False) -> str:
    """How a thing is called, one argument a line where it is long."""
    signature = inspect.signature(thing)
    given = list(signature.parameters.values())
    if method and given and given[0].name in ("self", "cls"):
        given = given[1:]
    told = []
    for p in given:
        if p.annotation is not p.empty:
            p = p.replace(annotation=Told(tell_annotation(p.annotation)))
        told.append(p if p.default is p.empty else p.replace(default=tell_default(p.default)))
    gives = signature.return_annotation
    after = ""
    if not inspect.isclass(thing) and gives is not signature.empty:
        after = f" -> {tell_annotation(gives)}"
    bare = inspect.Signature(told)
    if method or len(f"{name}{bare}{after}") <= WIDTH:
        return f"{name}{bare}{after}"
    lines, starred = [], False
    for p in told:
        if p.kind is p.KEYWORD_ONLY and not starred:
            lines.append("    *,")
        starred = starred or p.kind in (p.KEYWORD_ONLY, p.VAR_POSITIONAL)
        lines.append(f"    {p},")
    return "\n".join([f"{name}(", *lines, f"){after}"])


def tell_docstring(thing: Any) -> Iterator[str]:
    """A docstring as Markdown: its words, then a list a section."""
    text = inspect.getdoc(thing) or ""
    heading = ""
    for line in text.splitlines():
        if line.rstrip(":") in HEADINGS and line.endswith(":"):
            heading = line.rstrip(":")
            yield f"**{heading}**"
            yield ""
        elif not heading or not line.startswith("    "):
            heading = heading if not line else ""
            yield line
        elif line.startswith("        ") or heading in ("Returns", "Yields"):
            yield "  " + line.strip() if line.startswith("        ") else line.strip()
        else:
            yield re.sub(r"^([\w*., ]+?)( \(.*?\))?: ", r"- `\1`: ", line.strip())
    yield ""


def tell_class(name: str, kind: type) -> Iterator[str]:
    """A class: how it is built, what it is, what it does."""
    if issubclass(kind, Enum):
        told = ", ".join(f"{member.name} = {member.value!r}" for member in kind)
    elif issubclass(kind, Exception) or getattr(kind, "_is_protocol", False):
        told = ""
    else:
        told = tell_signature(f"class {name}", kind)
    if told:
        yield f"```python\n{told}\n```"
    yield ""
    yield from tell_docstring(kind)
    members = []
    for key, member in sorted(vars(kind).items()):
        if key.startswith("_"):
            continue
        member = member.__func__ if isinstance(member, classmethod | staticmethod) else member
        if inspect.isfunction(member):
            told = tell_signature(key, member, method=True)
        elif isinstance(member, property) or type(member).__name__ == "cached_property":
            told = key
        else:
            continue
        first = (inspect.getdoc(member) or "").split("\n\n")[0].replace("\n", " ")
        members.append(f"- `{told}`: {first}" if first else f"- `{told}`")
    if members:
        yield from ["**Members**", "", *members, ""]


def tell_namespace(name: str) -> str:
    """One page."""
    module: ModuleType = import_module(name)
    lines = [f"# {name}", "", (inspect.getdoc(module) or "").strip(), ""]
    public = [key for key in module.__all__ if not inspect.ismodule(getattr(module, key))]
    lines += [" · ".join(f"[{key}](#{key.lower()})" for key in public), ""]
    for key in public:
        thing = getattr(module, key)
        lines += [f"## {key}", ""]
        elsewhere = first_home(key, thing)
        if elsewhere != name:
            lines += [f"The same as [`{elsewhere}.{key}`]({elsewhere}.md#{key.lower()}).", ""]
        elif inspect.isclass(thing):
            lines += tell_class(key, thing)
        elif callable(thing):
            lines += [f"```python\n{tell_signature(key, thing)}\n```", "", *tell_docstring(thing)]
        else:
            lines += [f"A value: `{tell_default(thing)}`.", ""]
    return re.sub(r"\n{3,}", "\n\n", "\n".join(lines)).rstrip() + "\n"


def first_home(key: str, thing: Any) -> str:
    """The namespace that tells of a thing: its own room's, else the first that has it."""
    holders = [n for n in namespaces() if getattr(import_module(n), key, None) is thing]
    own = ".".join(getattr(thing, "__module__", "").split(".")[:2])
    return own if own in holders else holders[0]


def pages() -> dict[str, str]:
    """File name and text of every page."""
    told = {f"{name}.md": tell_namespace(name) for name in namespaces()}
    rows = []
    for name in namespaces():
        module = import_module(name)
        first = (inspect.getdoc(module) or "").split("\n")[0]
        count = sum(not inspect.ismodule(getattr(module, key)) for key in module.__all__)
        rows.append(f"| [`{name}`]({name}.md) | {first} | {count} |")
    return {"README.md": "\n".join([*INDEX, *rows, ""]), **told}


def main() -> None:
    """Write them."""
    folder = ROOT / "docs/api"
    folder.mkdir(exist_ok=True)
    for old in folder.glob("*.md"):
        old.unlink()
    for name, text in pages().items():
        (folder / name).write_text(text)


if __name__ == "__main__":
    main()
