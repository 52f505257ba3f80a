"""The only YAML reader: plain values, within bounds, whatever the file says.

YAML lets a node be named and repeated, so that a few hundred bytes stand for billions of values;
no file of ours needs that, so anchors and aliases are refused, with nesting, nodes and scalars
beyond what settings have. Tags beyond JSON's own values are refused too.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from gn0.errors import FormatError, brief
from gn0.storage import read_bytes

LIMIT = 2**18  # bytes of a file
DEPTH, NODES, SCALAR = 16, 20_000, 4096  # levels, values, characters of one
_TAG = "tag:yaml.org,2002:"
_PLAIN = ("null", "bool", "int", "float", "str", "seq", "map")


class _Refused(yaml.YAMLError):
    """What the rules above do not allow."""

    def __init__(self, what: str, mark: yaml.Mark | None) -> None:
        super().__init__(what)
        self.problem, self.problem_mark = what, mark


class _PlainLoader(yaml.SafeLoader):
    """Composes plain nodes and counts them."""

    depth = nodes = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        event = self.peek_event()
        mark = event.start_mark
        if isinstance(event, yaml.AliasEvent) or getattr(event, "anchor", None) is not None:
            raise _Refused("anchors and aliases are not supported here: write the value out", mark)
        self.nodes += 1
        self.depth += 1
        if self.depth > DEPTH:
            raise _Refused(f"nested more than {DEPTH} levels deep", mark)
        if self.nodes > NODES:
            raise _Refused(f"more than {NODES} values", mark)
        if isinstance(event, yaml.ScalarEvent) and len(event.value) > SCALAR:
            raise _Refused(f"a value of more than {SCALAR} characters", mark)
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        """A map whose keys are scalars, each given once; `<<` is a key like any other."""
        found: dict[Any, Any] = {}
        for name, value in node.value:
            key = self.construct_object(name, deep=True)
            if isinstance(key, list | dict):
                raise _Refused("a key is not a plain value", name.start_mark)
            if key in found:
                raise _Refused(f"key {brief(key)} is given twice", name.start_mark)
            found[key] = self.construct_object(value, deep=True)
        return found


def _construct_map(loader: _PlainLoader, node: Any) -> dict[Any, Any]:
    if not isinstance(node, yaml.MappingNode):
        raise _Refused("a map was expected", node.start_mark)
    return loader.construct_mapping(node)


def _construct_list(loader: _PlainLoader, node: Any) -> list[Any]:
    if not isinstance(node, yaml.SequenceNode):
        raise _Refused("a list was expected", node.start_mark)
    return [loader.construct_object(value, deep=True) for value in node.value]


def _refuse_tag(loader: _PlainLoader, node: Any) -> Any:
    raise _Refused(f"tag {brief(node.tag)} is not of a plain value", node.start_mark)


_PlainLoader.yaml_constructors = {
    **{_TAG + name: yaml.SafeLoader.yaml_constructors[_TAG + name] for name in _PLAIN[:5]},
    _TAG + "seq": _construct_list,
    _TAG + "map": _construct_map,
    None: _refuse_tag,
}
# a date stays the text that it was written as, `<<` and `=` are words
_PlainLoader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in known if tag.removeprefix(_TAG) in _PLAIN]
    for first, known in yaml.SafeLoader.yaml_implicit_resolvers.items()
}


def decode_yaml(data: bytes, *, file: str | Path = "", remedy: str = "correct the file") -> Any:
    """The plain value of one YAML document; JSON is YAML.

    Raises:
        FormatError: not YAML, or more than the module allows; names line and column.
    """
    if len(data) > LIMIT:
        raise FormatError(
            f"{len(data)} bytes, more than the {LIMIT} that YAML may have here", file=file,
            remedy=remedy,
        )  # fmt: skip
    loader = None
    try:
        loader = _PlainLoader(data.decode("utf-8"))
        return loader.get_single_data()
    except yaml.YAMLError as error:
        what = getattr(error, "problem", None) or getattr(error, "reason", None) or "not valid YAML"
        mark = getattr(error, "problem_mark", None)
        place = f" at line {mark.line + 1}, column {mark.column + 1}" if mark is not None else ""
        text = " ".join(str(what).split())
        raise FormatError(f"not valid YAML{place}: {text:.200}", file=file, remedy=remedy) from None
    except (ValueError, LookupError, OverflowError, RecursionError) as error:
        text = " ".join(str(error).split())
        raise FormatError(f"not valid YAML: {text:.200}", file=file, remedy=remedy) from None
    finally:
        if loader is not None:
            loader.dispose()


def load_yaml(path: Path | str, *, remedy: str = "correct the file") -> Any:
    """The plain value of a YAML file.

    Raises:
        StorageError: missing, unreadable or too large.
        FormatError: see `decode_yaml`.
    """
    return decode_yaml(read_bytes(path, LIMIT), file=path, remedy=remedy)


class _PlainDumper(yaml.SafeDumper):
    """Writes what the loader reads: a value that is met twice is written twice."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def encode_yaml(value: Any) -> str:
    """Plain values as YAML, keys in their order, without aliases."""
    return yaml.dump(value, Dumper=_PlainDumper, sort_keys=False, allow_unicode=True)
