"""Proof by pictures that words fit exactly one of the people in sight.

Colours are read as one would with a grey card: the median of a garment's pixels, divided by what a
card that stands in the person's place and faces the camera shows in the same picture's light. What
is no colour is taken from the record, and only where the part of the body that it is about shows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gn0.avatars.avatar import colour_sh
from gn0.avatars.colour_names import NEIGHBOURS, lab_of, name_colour
from gn0.avatars.layer import PARTS
from gn0.avatars.likeness import Record, Sight, words_apart
from gn0.gaussians.cloud import GaussianCloud
from gn0.gaussians.film import decode_srgb
from gn0.geometry import F64
from gn0.render.camera import Camera
from gn0.render.cpu import RendererCpu
from gn0.render.instance import Instance

Verdict = Literal["fits", "does not", "cannot tell"]
CARD = "grey card"  # the name by which a renderer knows it
CARD_GREY = 0.18  # albedo, as of a photographer's
DARK = 10.0  # lightness L* of the card below which colours are not read
READABLE = 40  # px of a part from which on it is seen
IN_SIGHT = 80  # px of a person from which on he is taken for one who is there
_CARD_HEIGHT, _CARD_SIZE, _CARD_STEP = 1.2, 0.36, 0.02  # m
_PART_OF = {
    "top_colour": "top", "bottom_colour": "bottom", "shoes_colour": "shoes",
    "extra_colour": "scarf", "top": "top", "top_pattern": "top", "bottom": "bottom",
    "bottom_pattern": "bottom", "shoes": "shoes", "extra": "scarf", "hair": "hair",
    "hair_colour": "hair", "hat": "hat",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class PlacedPerson:
    """Somebody in a picture.

    Attributes:
        instance: how the renderer draws him; it knows the cloud's name.
        cloud: that cloud, posed, with the numbers of parts as labels, as `Avatar.pose` gives it.
        record: his record of words.
    """

    instance: Instance
    cloud: GaussianCloud
    record: Record


@dataclass(frozen=True, eq=False)
class Moment:
    """What the agent sees at a moment: world-to-camera [4, 4], and all people where they are."""

    view: F64
    people: Sequence[PlacedPerson]


@dataclass(frozen=True)
class PartReading:
    """What is read of a part of somebody: its pixels, and the name of its colour or why none."""

    pixels: int
    colour: str
    doubt: str = ""


@dataclass(frozen=True)
class PersonVerdict:
    """Whether the words fit somebody: `pixels` of him are seen at best; `reason` in words."""

    verdict: Verdict | Literal["unseen"]
    reason: str
    pixels: int


@dataclass(frozen=True)
class WordsVerdict:
    """Whether words fit exactly the one who is meant, why, and what was found of everybody."""

    verdict: Verdict
    reason: str
    people: tuple[PersonVerdict, ...]


@dataclass(frozen=True, eq=False)
class _Seen:
    """What the moments show of somebody at best: pixels in all, and of each part.

    `aside` is how far the middle of him is from that of the picture at first, in its widths.
    """

    pixels: int
    parts: dict[str, PartReading]
    aside: float = 1.0


def judge_words(
    renderer: RendererCpu,
    camera: Camera,
    moments: Sequence[Moment],
    said: Mapping[str, str],
    who: int,
    sight: Sight | None = None,
    *,
    ahead: bool = False,
) -> WordsVerdict:
    """Whether what is said of a person fits him and nobody else who is in sight.

    Args:
        renderer: of the scene; it knows the people's clouds by name.
        camera: the agent's.
        moments: the first second in which the agent sees the person.
        said: what the words say, as `FollowText.said` has it.
        who: number of the person who is meant, from 0, the same at each moment.
        sight: how people are seen.
        ahead: whether the words say that the person is ahead of the agent; then nobody fits who
            is less near to the middle of the first picture, and smaller in it.

    Raises:
        RenderError: the renderer does not know a cloud, or a view is wrong.
    """
    sight = sight or Sight()
    first = best = read_people(renderer, camera, moments[0])
    for moment in moments[1:]:
        seen = read_people(renderer, camera, moment)
        best = [_better(a, b) for a, b in zip(best, seen, strict=True)]
    records = [person.record for person in moments[0].people]
    found = []
    for k, seen_one in enumerate(best):
        apart = frozenset() if k == who else words_apart(records[who], records[k], sight)
        one = _judge_person(seen_one, said, apart, meant=k == who)
        behind = first[k].pixels < first[who].pixels and first[k].aside > first[who].aside
        if ahead and behind and one.verdict in ("fits", "cannot tell"):
            one = PersonVerdict("does not", "is not the one ahead", one.pixels)
        found.append(one)
    mine = found[who]
    if mine.verdict == "unseen":
        return WordsVerdict("cannot tell", "the person is not in sight", tuple(found))
    if mine.verdict != "fits":
        return WordsVerdict(mine.verdict, f"the person meant: {mine.reason}", tuple(found))
    for verdict in ("fits", "cannot tell"):
        for k, other in enumerate(found):
            if k != who and other.verdict == verdict:
                outcome: Verdict = "does not" if verdict == "fits" else "cannot tell"
                return WordsVerdict(outcome, f"person {k}: {other.reason}", tuple(found))
    others = sum(p.verdict != "unseen" for p in found) - 1
    return WordsVerdict("fits", f"{mine.reason}; {others} others do not fit", tuple(found))


def read_people(renderer: RendererCpu, camera: Camera, moment: Moment) -> list[_Seen]:
    """What one picture shows of everybody: pixels of each part, names of colours."""
    parts = [person.instance for person in moment.people]
    view = moment.view[None]
    rgb = renderer.render(camera, view, parts=parts, outputs=("rgb",)).rgb
    assert rgb is not None
    linear = decode_srgb(rgb[0] / np.float32(255.0)).astype(np.float64)
    numbers = renderer.render_who(camera, view, parts=parts).numbers[0]
    light = _read_cards(renderer, camera, moment)
    out = []
    for k, person in enumerate(moment.people):
        here = numbers == k + 1
        readings: dict[str, PartReading] = {}
        if here.sum() >= IN_SIGHT:
            shown = _draw_parts(person, camera, moment.view)
            for name in ("top", "bottom", "shoes", "scarf", "hair", "hat"):
                mask = here & (shown == PARTS.index(name) + 1)
                readings[name] = _read_part(linear, mask, light[k])
        columns = np.nonzero(here)[1]
        middle = float(columns.mean()) / camera.width if len(columns) else 2.0
        out.append(_Seen(len(columns), readings, abs(middle - 0.5)))
    return out


def _draw_parts(person: PlacedPerson, camera: Camera, view: F64) -> NDArray[np.uint32]:
    """Number of the part, plus 1, that each pixel shows of somebody alone."""
    alone = RendererCpu(person.cloud)
    drawn = alone.render(camera, (view @ person.instance.pose)[None], outputs=("instance",))
    assert drawn.instance is not None
    return drawn.instance[0]


def _read_part(linear: F64, mask: NDArray[np.bool_], light: F64 | None) -> PartReading:
    pixels = int(mask.sum())
    if pixels < READABLE:
        return PartReading(pixels, "", f"{pixels} px of it are seen")
    if light is None:
        return PartReading(pixels, "", "no grey card shows in its place")
    if lab_of(light * CARD_GREY)[0] < DARK:
        return PartReading(pixels, "", "it is too dark")
    return PartReading(pixels, name_colour(np.median(linear[mask], axis=0) / light))


def _read_cards(renderer: RendererCpu, camera: Camera, moment: Moment) -> list[F64 | None]:
    """The light [3] on a card in each person's place, the people away; None where none shows."""
    renderer.name_cloud(CARD, build_card())
    eye = -moment.view[:3, :3].T @ moment.view[:3, 3]
    cards = []
    for person in moment.people:
        pose = np.eye(4)
        place = person.instance.pose[:2, 3]
        ahead = (eye[:2] - place) / max(float(np.linalg.norm(eye[:2] - place)), 1e-9)
        pose[:2, 0], pose[:2, 1], pose[:2, 3] = ahead, (-ahead[1], ahead[0]), place
        pose[2, 3] = _CARD_HEIGHT
        cards.append(Instance(CARD, pose, person.instance.gain, person.instance.nearer))
    found: list[F64 | None] = []
    for card in cards:  # one by one: a nearer one would hide another
        drawn = renderer.render(camera, moment.view[None], parts=[card], outputs=("rgb",)).rgb
        mask = renderer.render_who(camera, moment.view[None], parts=[card]).numbers[0] == 1
        assert drawn is not None
        if mask.sum() < 9:
            found.append(None)
            continue
        shown = np.median(decode_srgb(drawn[0][mask] / np.float32(255.0)), axis=0)
        found.append(np.maximum(shown.astype(np.float64) / CARD_GREY, 1e-6))
    return found


@cache
def build_card() -> GaussianCloud:
    """A square grey card upright in its own frame, facing +x."""
    step = np.arange(-_CARD_SIZE / 2, _CARD_SIZE / 2 + 1e-9, _CARD_STEP)
    y, z = (a.ravel() for a in np.meshgrid(step, step))
    count = len(y)
    albedo = np.full((count, 3), CARD_GREY, np.float32)
    return GaussianCloud(
        means=np.column_stack([np.zeros(count), y, z]).astype(np.float32),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
        scales=np.tile(np.array([0.001, _CARD_STEP, _CARD_STEP], np.float32), (count, 1)),
        opacities=np.full(count, 0.99, np.float32),
        sh=colour_sh(albedo),
        albedo=albedo,
        normal=np.tile(np.array([1, 0, 0], np.float32), (count, 1)),
    )


def _better(one: _Seen, other: _Seen) -> _Seen:
    """Each part as the moment shows it that shows most of it."""
    parts = dict(one.parts)
    for name, reading in other.parts.items():
        if name not in parts or (bool(reading.colour), reading.pixels) > (
            bool(parts[name].colour), parts[name].pixels
        ):  # fmt: skip
            parts[name] = reading
    return _Seen(max(one.pixels, other.pixels), parts, one.aside)


def _judge_person(
    seen: _Seen, said: Mapping[str, str], apart: frozenset[str], *, meant: bool
) -> PersonVerdict:
    """Whether words fit somebody; `apart`: keys that his record answers otherwise."""
    if seen.pixels < IN_SIGHT:
        return PersonVerdict("unseen", "not in sight", seen.pixels)
    doubt, wrong, right = "", "", []
    for key, word in said.items():
        part = _PART_OF.get(key)
        if part is None:  # sex, age, build: nothing that a pixel shows
            if key in apart and word != "person":
                wrong = wrong or f"no {word}, by the record"
            continue
        reading = seen.parts.get(part, PartReading(0, "", "it is not seen"))
        if key in ("hat", "extra") and key in apart:  # nothing there where the meant one has it
            wrong = wrong or f"has no {word}"
            continue
        if reading.pixels < READABLE and not (key == "hat" and reading.pixels):
            doubt = doubt or f"its {part}: {reading.doubt or 'it is hardly seen'}"
        elif key.endswith("_colour") and key != "hair_colour":
            if not reading.colour:
                doubt = doubt or f"its {part}: {reading.doubt}"
            elif reading.colour == word or {reading.colour, word} in [set(p) for p in NEIGHBOURS]:
                right.append(f"{part} looks {reading.colour}")
            else:
                wrong = f"its {part} looks {reading.colour}, not {word}"
        elif key in apart:
            wrong = wrong or f"its {part} is not {word}, by the record"
        elif meant:
            right.append(f"{part} shows")
    if wrong:
        return PersonVerdict("does not", wrong, seen.pixels)
    if doubt:
        return PersonVerdict("cannot tell", doubt, seen.pixels)
    return PersonVerdict(
        "fits", ", ".join(dict.fromkeys(right)) or "nothing said speaks against it", seen.pixels
    )
