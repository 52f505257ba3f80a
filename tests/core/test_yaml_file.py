"""YAML of strangers: plain values, or a short refusal at once."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from gn0.errors import ConfigError, FormatError, Gn0Error, brief
from gn0.maps.ros import load_ros_map
from gn0.missions.generate.settings import load_settings
from gn0.scenes.corpus import load_spec
from gn0.yaml_file import DEPTH, LIMIT, NODES, SCALAR, decode_yaml

# "billion laughs" as a map of ROS: 463 bytes that kept a processor busy for ever, in the message
_HEAD = "image: m.png\nresolution: 1\norigin: [0, 0, 0]\na0: &a0 [x, x, x, x, x, x, x]\n"
LAUGHS = (
    _HEAD
    + "".join(f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 6)}]\n" for n in range(1, 9))
    + "negate: *a8\n"
)


@pytest.mark.parametrize("read", [load_ros_map, load_spec, load_settings])
def test_a_map_of_aliases_is_refused_at_once(tmp_path: Path, read: Any) -> None:
    path = tmp_path / "map.yaml"
    path.write_text(LAUGHS)
    with pytest.raises(FormatError, match="anchors and aliases are not supported here") as caught:
        read(path)
    assert len(str(caught.value)) < 400
    assert "line 4, column 5" in str(caught.value) and caught.value.remedy


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a: &x 1\n", "anchors and aliases"),
        ("a: *x\n", "anchors and aliases"),
        ("[" * 60_000, f"nested more than {DEPTH} levels"),
        ("{a: " * 20_000, f"nested more than {DEPTH} levels"),
        ("- " * 20_000 + "x", f"nested more than {DEPTH} levels"),
        ("[" + "1," * NODES + "1]", f"more than {NODES} values"),
        ("a: " + "9" * (SCALAR + 1), f"a value of more than {SCALAR} characters"),
        ("a: " + "1:" * 2000 + "1", None),
        ("x" * (LIMIT + 1), "more than the"),
        ("a: 1\na: 2\n", "key 'a' is given twice"),
        ("? [a]\n: 1\n", "a key is not a plain value"),
        ("a: !!python/object/apply:os.system [ls]\n", "not of a plain value"),
        ("a: !!set {x, y}\n", "not of a plain value"),
        ("a: !!int x\n", "not valid YAML"),
        ("a: !!int ''\n", "not valid YAML"),
        ("a: !!bool maybe\n", "not valid YAML"),
        ("a: !" + "x" * 5000 + " 1\n", "not of a plain value"),
        ("--- 1\n--- 2\n", "another document"),
        ("a: [1, 2\n", "not valid YAML"),
        ("\x01", "special characters"),
    ],
)
def test_what_is_no_plain_value_or_too_much_is_refused(text: str, words: str | None) -> None:
    if words is None:
        decode_yaml(text.encode())
    else:
        with pytest.raises(FormatError, match=words) as caught:
            decode_yaml(text.encode(), file="f.yaml")
        assert len(str(caught.value)) < 500 and "f.yaml" in str(caught.value)
    with pytest.raises(FormatError, match="not valid YAML"):
        decode_yaml(b"\xff\xfe\x00")


def test_plain_values_are_as_they_were() -> None:
    text = (
        b"a: [1, 0x1F, 1.5, -.inf, yes, ~, 'x', \"y\"]\nb: {c: 2001-01-01, <<: d}\n? e\n: |\n  f\n"
    )
    assert decode_yaml(text) == {
        "a": [1, 31, 1.5, float("-inf"), True, None, "x", "y"],
        "b": {"c": "2001-01-01", "<<": "d"},
        "e": "f\n",
    }
    assert decode_yaml(b'{"json": [1, {"too": null}]}') == {"json": [1, {"too": None}]}
    assert decode_yaml(b"") is None


def test_a_value_in_a_message_is_short_whatever_it_is() -> None:
    bomb: Any = ["x"] * 9
    for _ in range(60):
        bomb = [bomb] * 9  # nine to the power of sixty
    loop: Any = {}
    loop["self"] = loop
    for value in (bomb, loop, "x" * 10**6, 10**9000, [{"a": bomb}], {n: n for n in range(10**5)}):
        assert len(brief(value)) <= 400
    assert brief("a\x1b[31mb") == "'a\\x1b[31mb'" and brief(0.5) == "0.5"
    error = ConfigError("head " + "x" * 10**6 + " tail", remedy="y" * 10**6)
    assert isinstance(error, Gn0Error) and len(str(error)) < 70_000
    assert error.what.startswith("head") and error.what.endswith("tail")
