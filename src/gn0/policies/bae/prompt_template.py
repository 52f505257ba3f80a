"""Prompts as files: a short header, then the text with fields, read strictly.

    task: PLANNING
    pictures: rgb history
    points: 0
    layout: json
    ---
    TASK_TYPE: {TASK_TYPE}
    Instruction: "{INSTRUCTION_TEXT}"

`{NAME}` is a field, `{{` and `}}` are braces. What the header names `open` may be chosen when the
file is loaded. Of the lines that begin with `[part]`, those are left out whose part is switched
off; `[not part]` stands for it then. `prompt_fields.py` fills the fields.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, get_args

from gn0.data.answer_form import AnswerForm
from gn0.data.codec import AnswerLayout, AnswerOrder
from gn0.errors import ConfigError, FormatError, StorageError
from gn0.storage import content_hash, read_bytes

FOLDER = Path(__file__).parent / "prompts"
ENDING = ".txt"
LIMIT = 64 * 2**10  # bytes of a template
PAPER, PAPER_LACKS = "paper", ("heading", "last_action", "bumper")
"""What `without` may be told, and the parts that it stands for: the paper's prompts lack them."""
Task = Literal["PLANNING", "TRACKING"]
Frame = Literal["any", "global", "ego"]
CHOICES: dict[str, tuple[str, ...]] = {
    "task": get_args(Task),
    "layout": get_args(AnswerLayout),
    "frame": get_args(Frame),
}
_KEYS = ("task", "pictures", "points", "layout", "frame", "parts", "open")
_NEEDED = ("task", "pictures", "points", "layout")
_NAME = re.compile(r"[a-z][a-z0-9_]*")
_LINE = re.compile(r"\[(not )?([a-z][a-z0-9_]*)\] ?")
_PIECE = re.compile(r"\{\{|\}\}|\{([A-Z][A-Z0-9_]*)\}|[{}]")
PICTURE_TAG = "<image>"
FIELDS = {
    "INSTRUCTION_TEXT": "the instruction on one line, without control tokens",
    "TASK_TYPE": "PLANNING or TRACKING",
    "OCC_W": "width of the picture that coordinates are on [px]",
    "OCC_H": "its height [px]",
    "OCC_M_PER_PX": "metres of one of its pixels",
    "X_NORM_UNIT_M": "metres of one token in x",
    "Y_NORM_UNIT_M": "metres of one token in y",
    "CUR_XN": "token of where the agent stands, x",
    "CUR_YN": "token of where the agent stands, y",
    "HEADING": "token of the heading, north up: <0> up, <250> right, <500> down, <750> left",
    "LAST_ACTION": "token of the action before; `none` at the start",
    "BUMPER": "`hit` if the action before was cut short, else `free`",
}
"""What a template may ask for."""


@dataclass(frozen=True)
class TemplateLine:
    """A line of a template.

    Attributes:
        number: of the line in its file.
        part: the part that it belongs to; empty if it always stands.
        wanted: whether the part must be on, or off.
        pieces: texts and names of fields by turns, beginning and ending with a text.
    """

    number: int
    part: str
    wanted: bool
    pieces: tuple[str, ...]


@dataclass(frozen=True)
class PromptTemplate:
    """A prompt with fields.

    Attributes:
        name: the file's name without its ending.
        file: where it was read.
        task: PLANNING or TRACKING.
        pictures: names of the sensors whose pictures come before the text, in order.
        points: waypoints that it asks for.
        layout: layout of the answer that it asks for.
        frame: what its coordinates are on: the whole map (global), the square around the agent
            (ego), or whichever the samples have (any).
        parts: what may be switched off.
        on: which of them are on.
        lines: the text.
        digest: of the file and of what was chosen on loading.
        opened: what the file leaves open.
    """

    name: str
    file: str
    task: Task
    pictures: tuple[str, ...]
    points: int
    layout: AnswerLayout
    frame: Frame
    parts: tuple[str, ...]
    on: frozenset[str]
    lines: tuple[TemplateLine, ...]
    digest: str
    opened: frozenset[str] = frozenset()

    @property
    def shown(self) -> tuple[TemplateLine, ...]:
        """The lines that stand."""
        return tuple(
            line for line in self.lines if not line.part or (line.part in self.on) == line.wanted
        )

    @property
    def fields(self) -> frozenset[str]:
        """Names of the fields that are filled."""
        return frozenset(name for line in self.shown for name in line.pieces[1::2])

    def fill(self, values: Mapping[str, str]) -> str:
        """The text, with a value for every field.

        Raises:
            ConfigError: a field has none; names file, line and field.
        """
        texts = []
        for line in self.shown:
            words = list(line.pieces)
            for at in range(1, len(words), 2):
                if words[at] not in values:
                    raise ConfigError(
                        f"nothing is known for field {words[at]!r}",
                        where=f"{self.file}, line {line.number}",
                        remedy=f"give it, or switch part {line.part!r} off"
                        if line.part
                        else "give it, or take a prompt without it",
                    )
                words[at] = values[words[at]]
            texts.append("".join(words))
        return "\n".join(texts)

    def form(self, order: AnswerOrder = "paper", *, current_said: bool = False) -> AnswerForm:
        """The form of the answers that it asks for."""
        return AnswerForm(
            points=self.points, order=order, layout=self.layout, current_said=current_said
        )

    def card_rows(self) -> tuple[tuple[str, str], ...]:
        """(what, how) rows for the protocol card."""
        rows = [
            ("prompt", f"{self.name} ({self.digest[:12]})"),
            ("pictures", ", ".join(self.pictures)),
            ("answer", f"{self.layout}, {self.points} points"),
        ]
        if self.parts:
            told = ", ".join(part for part in self.parts if part in self.on) or "none"
            rows.append(("prompt parts", told))
        return tuple(rows)


def prompt_names(folder: Path | str | None = None) -> tuple[str, ...]:
    """Names of the templates in a folder (by default GN0's own), sorted.

    Raises:
        ConfigError: it is no folder.
    """
    place = FOLDER if folder is None else Path(folder)
    if not place.is_dir():
        raise ConfigError("no folder of prompts", where=place, remedy="give a folder of .txt files")
    return tuple(sorted(path.stem for path in place.glob(f"*{ENDING}") if path.is_file()))


def load_prompt(
    name: str,
    folder: Path | str | None = None,
    *,
    task: str | None = None,
    pictures: Iterable[str] | None = None,
    points: int | None = None,
    layout: str | None = None,
    frame: str | None = None,
    without: Iterable[str] = (),
) -> PromptTemplate:
    """A template by its name, or by the path of its file.

    Args:
        name: of GN0's own, or of one in `folder`; or a path that ends with .txt.
        folder: a folder of templates of your own.
        task: PLANNING or TRACKING, where the file leaves it open; so with the next four.
        pictures: names of the sensors whose pictures come before the text.
        points: waypoints to ask for.
        layout: of the answer: json or compact.
        frame: what coordinates are on: any, global or ego.
        without: parts to switch off; `paper` stands for those of `PAPER_LACKS` that there are.

    Raises:
        ConfigError: no such template or part, or the file does not leave open what is given.
        StorageError: it cannot be read.
        FormatError: the file is no template; names file, line and field.
    """
    if name.endswith(ENDING):
        file = Path(name) if folder is None else Path(folder) / name
    else:
        known = prompt_names(folder)
        if name not in known:
            raise ConfigError(
                f"no prompt {name!r}",
                where=folder or "",
                remedy=f"known: {', '.join(known) or 'none'}; or the path of a {ENDING} file",
            )
        file = (FOLDER if folder is None else Path(folder)) / f"{name}{ENDING}"
    if file.exists() and not file.is_file():  # a pipe would never end
        raise StorageError("not a file", where=file, remedy="give the path of a text file")
    data = read_bytes(file, LIMIT)
    chosen = {
        "task": task,
        "pictures": None if pictures is None else " ".join(pictures),
        "points": None if points is None else str(points),
        "layout": layout,
        "frame": frame,
    }
    given = {key: value for key, value in chosen.items() if value is not None}
    template = parse_template(data, file, given)
    silent = [part for part in PAPER_LACKS if part in template.parts]
    off = [part for one in without for part in (silent if one == PAPER else [one])]
    for part in off:
        if part not in template.parts:
            raise ConfigError(
                f"prompt {template.name!r} has no part {part!r}",
                where=file,
                remedy=f"it has {', '.join(template.parts) or 'none'}",
            )
    on = template.on - set(off)
    digest = content_hash(data, repr(sorted(given.items())), repr(sorted(on)))
    return replace(template, on=on, digest=digest)


def parse_template(data: bytes, file: Path | str, given: Mapping[str, str]) -> PromptTemplate:
    """A template of a file's bytes; `given` are the values of what its header leaves open.

    Raises:
        ConfigError: something is given that the header does not leave open, or has no meaning.
        FormatError: it is no template; names file, line and field.
    """
    name = Path(file).stem
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise FormatError(
            "not UTF-8", file=file, offset=error.start, remedy="save the file as UTF-8"
        ) from None
    rows = text.replace("\r\n", "\n").removesuffix("\n").split("\n")
    if "---" not in rows:
        raise _fault(file, len(rows), "---", "the header does not end", "put a line of --- below")
    end = rows.index("---")
    header = _read_header(rows[:end], file)
    opened = header["open"][1].split()
    for key, value in given.items():
        if key not in opened:
            raise ConfigError(
                f"prompt {name!r} has {key} {header[key][1]!r}, and does not leave it open",
                where=file,
                remedy=f"it leaves open {', '.join(opened) or 'nothing'}",
            )
        header[key] = (header[key][0], value)
    for key, known in CHOICES.items():
        _check_choice(file, key, header[key], known, given)
    number, points = header["points"]
    if not (points.isascii() and points.isdigit() and int(points) <= 64 and int(points) != 1):
        raise _refuse(file, number, "points", f"{points!r} waypoints", "give 0, or 2 to 64", given)
    pictures, parts = header["pictures"][1].split(), header["parts"][1].split()
    for key, names in (("pictures", pictures), ("parts", parts)):
        bad = [own for own in names if not _NAME.fullmatch(own) or names.count(own) > 1]
        if bad:
            raise _refuse(
                file, header[key][0], key, f"{bad[0]!r} is not a name, or stands twice",
                "give names of small letters, divided by blanks", given,
            )  # fmt: skip
    lines = tuple(
        _read_line(row, number, file, parts) for number, row in enumerate(rows[end + 1 :], end + 2)
    )
    _check_tags(lines, pictures, file)
    return PromptTemplate(
        name=name,
        file=str(file),
        task="TRACKING" if header["task"][1] == "TRACKING" else "PLANNING",
        pictures=tuple(pictures),
        points=int(points),
        layout="compact" if header["layout"][1] == "compact" else "json",
        frame=header["frame"][1],  # type: ignore[arg-type]  # checked above
        parts=tuple(parts),
        on=frozenset(parts),
        lines=lines,
        digest=content_hash(data),
        opened=frozenset(opened),
    )


def _read_header(rows: list[str], file: Path | str) -> dict[str, tuple[int, str]]:
    """Line and value of each key."""
    found: dict[str, tuple[int, str]] = {}
    for number, row in enumerate(rows, 1):
        key, colon, value = row.partition(":")
        if not colon or key not in _KEYS or key in found:
            what = f"unknown or repeated key {key[:40]!r}" if colon else "no `key: value`"
            raise _fault(file, number, key[:40], what, f"known: {', '.join(_KEYS)}")
        found[key] = (number, value.strip())
    for key in _NEEDED:
        if key not in found:
            raise _fault(file, len(rows) + 1, key, "key is missing", f"add a line {key}: …")
    found.setdefault("frame", (0, "any"))
    found.setdefault("parts", (0, ""))
    found.setdefault("open", (0, ""))
    number, opened = found["open"]
    for key in opened.split():
        if key not in _KEYS[:5]:
            raise _fault(file, number, "open", f"{key[:40]!r} cannot be left open", "remove it")
    return found


def _check_choice(
    file: Path | str,
    key: str,
    found: tuple[int, str],
    known: tuple[str, ...],
    given: Mapping[str, str],
) -> None:
    number, value = found
    if value not in known:
        raise _refuse(
            file, number, key, f"no {key} {value[:40]!r}", f"known: {', '.join(known)}", given
        )


def _read_line(row: str, number: int, file: Path | str, parts: list[str]) -> TemplateLine:
    part, wanted = "", True
    mark = _LINE.match(row) if parts else None
    if mark is not None:
        part, wanted = mark[2], not mark[1]
        if part not in parts:
            raise _fault(file, number, part, f"no part {part!r}", f"known: {', '.join(parts)}")
        row = row[mark.end() :]
    pieces, text, last = [], "", 0
    for found in _PIECE.finditer(row):
        text += row[last : found.start()]
        last = found.end()
        if found[0] in ("{{", "}}"):
            text += found[0][0]
        elif found[1] is None:
            raise _fault(
                file, number, row[found.start() : found.start() + 20], "a brace by itself",
                "write {{ or }} for a brace, {NAME} for a field",
            )  # fmt: skip
        else:
            _check_field(found[1], number, file)
            pieces += [text, found[1]]
            text = ""
    return TemplateLine(number, part, wanted, (*pieces, text + row[last:]))


def _check_field(name: str, number: int, file: Path | str) -> None:
    if name not in FIELDS:
        raise _fault(file, number, name, f"no field {name!r}", f"known: {', '.join(FIELDS)}")


def _check_tags(lines: tuple[TemplateLine, ...], pictures: list[str], file: Path | str) -> None:
    tags = sum(text.count(PICTURE_TAG) for line in lines for text in line.pieces[::2])
    if tags and tags != len(pictures):
        number = next(line.number for line in lines if PICTURE_TAG in "".join(line.pieces[::2]))
        raise _fault(
            file, number, PICTURE_TAG, f"{tags} picture tags for {len(pictures)} pictures",
            "write one a picture, or none",
        )  # fmt: skip


def _fault(file: Path | str, number: int, field: str, what: str, remedy: str) -> FormatError:
    return FormatError(f"line {number}: {what}", file=file, field=field, remedy=remedy)


def _refuse(
    file: Path | str, number: int, key: str, what: str, remedy: str, given: Mapping[str, str]
) -> ConfigError | FormatError:
    """The error of a value: of the one who loads, or of the file."""
    if key in given:
        return ConfigError(what, where=key, remedy=remedy)
    return _fault(file, number, key, what, remedy)
