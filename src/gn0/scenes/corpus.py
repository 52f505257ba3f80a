"""A corpus: many scenes from one description, each in one split.

    corpus.json       what is in it: scenes, splits, hashes
    scenes/<id>/      scene folders
    corpus.journal    which scenes are whole, for a run that goes on after a stop

Whole scenes are held out, as unseen buildings must be; `val_seen` marks scenes of the training
split of which missions hold out paths instead.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from heapq import heapify, heapreplace
from pathlib import Path
from typing import Annotated, Literal, get_args

import msgspec

from gn0.config import Config, load_json
from gn0.errors import ConfigError, FormatError, StorageError
from gn0.scenes.folder import check_scene_id
from gn0.scenes.procedural.forms import MOST, hold_out_forms
from gn0.scenes.procedural.kinds import KINDS, OPEN_KINDS, SizeName, StyleName
from gn0.scenes.scene_sources import scene_id_from
from gn0.seeds import random_stream
from gn0.storage import plain_path, safe_join
from gn0.yaml_file import load_yaml

CORPUS_FILE, SCENE_FOLDER = "corpus.json", "scenes"
LAYOUT = 1
SplitName = Literal["train", "val_unseen", "test"]


class CorpusPart(Config, frozen=True):
    """Some scenes of one make.

    Attributes:
        kind: kind of generated building; see `gn0 scene generate --help`.
        path: files to import instead: a scene folder, InteriorGS folder, world or splat file;
            relative to the spec, `$NAME` is taken from the environment.
        count: how many generated scenes.
        size, style, density, light, refine, packed, open_plan: see `GenerateSettings`.
        height_band: of an import [m]; see `ImportSettings`.
        split: split of all its scenes; dealt by the spec's shares when None.
        name: beginning of the ids; the kind, or the name of the path.
    """

    kind: str = ""
    path: str = ""
    count: Annotated[int, msgspec.Meta(ge=1, le=100_000)] = 1
    size: SizeName = "medium"
    style: StyleName | None = None
    density: Annotated[float, msgspec.Meta(ge=1000, le=40000)] | None = None
    light: Literal["normal", "draft"] = "normal"
    refine: bool = False
    packed: bool = False
    height_band: tuple[float, float] | None = None
    split: SplitName | None = None
    name: str = ""
    open_plan: bool | msgspec.UnsetType = msgspec.UNSET  # unset: digests are what they were

    def __post_init__(self) -> None:
        if self.open_plan is False:  # one way to say it
            msgspec.structs.force_setattr(self, "open_plan", msgspec.UNSET)


class CorpusHeldOut(Config, frozen=True):
    """What scenes of the training split never show.

    Attributes:
        styles: generated scenes for training have none of these styles, all others only these.
        variants: share of the forms of furniture that training scenes go without; the others
            have all. See `gn0.scenes.procedural.forms`.
    """

    styles: tuple[StyleName, ...] = ()
    variants: Annotated[float, msgspec.Meta(ge=0, le=MOST)] = 0.0


class CorpusSpec(Config, frozen=True):
    """What a corpus holds.

    Attributes:
        parts: what its scenes are.
        name: what people call it.
        seed: seed of everything drawn by chance: buildings and splits.
        splits: share of the scenes in each split.
        val_seen: share of the training scenes of which missions hold out paths.
        held_out: styles and forms of furniture that training never sees.
    """

    parts: Annotated[tuple[CorpusPart, ...], msgspec.Meta(min_length=1)]
    name: str = "corpus"
    seed: Annotated[int, msgspec.Meta(ge=0, le=2**62)] = 0
    splits: dict[SplitName, Annotated[float, msgspec.Meta(ge=0, le=1)]] = msgspec.field(
        default_factory=lambda: {"train": 0.8, "val_unseen": 0.1, "test": 0.1}
    )
    val_seen: Annotated[float, msgspec.Meta(ge=0, le=1)] = 0.25
    held_out: CorpusHeldOut | msgspec.UnsetType = msgspec.UNSET  # unset: digests are what they were


class CorpusScene(Config, frozen=True):
    """A scene of a corpus: where it lies, what it is for, and what is in it.

    Attributes:
        id: id of the scene.
        folder: relative to the corpus.
        split: train, val_unseen or test.
        source: kind of building, or "import".
        val_seen: missions hold out paths of it (train only).
        style: of its furnishing, where the corpus chose it.
        hash: content hash of the scene.
        area: walkable ground before inflation [m²].
        gaussians, objects, rooms: how many.
    """

    id: str
    folder: str
    split: SplitName
    source: str
    val_seen: bool = False
    style: str = ""
    hash: str = ""
    area: float = 0.0
    gaussians: int = 0
    objects: int = 0
    rooms: int = 0


class CorpusFile(Config, frozen=True):
    """The content of `corpus.json`.

    `without` are the forms of furniture that the scenes for training go without; `left_out` the
    scenes that could not be made.
    """

    layout: int
    name: str
    seed: int
    spec: str  # digest of the spec
    scenes: tuple[CorpusScene, ...]
    software: str = ""
    without: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()


def load_spec(path: Path | str) -> CorpusSpec:
    """Read a spec, YAML or JSON.

    Raises:
        StorageError: missing, unreadable or too large.
        FormatError: not YAML, or a field is missing, unknown or of the wrong type.
        ConfigError: it contradicts itself.
    """
    path = plain_path(path)
    try:
        spec = msgspec.convert(load_yaml(path, remedy="see docs: corpus"), CorpusSpec)
    except msgspec.ValidationError as error:
        text = " ".join(str(error).split())
        raise FormatError(
            f"not a corpus spec: {text:.200}", file=path, remedy="see docs: corpus"
        ) from None
    return check_spec(spec, path)


def check_spec(spec: CorpusSpec, path: Path | str = "") -> CorpusSpec:
    """The spec itself, if it does not contradict itself.

    Raises:
        ConfigError: a part with no or two makes, an unknown kind, shares that do not sum to 1; all
            styles held out, or one that a part for training asks for.
    """
    for number, part in enumerate(spec.parts, 1):
        where = f"{path}, part {number}".lstrip(", ")
        if bool(part.kind) == bool(part.path):
            raise ConfigError("give a kind or a path, not both or neither", where=where)
        try:
            plain_path(part.path)
        except StorageError as error:
            raise ConfigError(error.what, where=where, remedy=error.remedy) from None
        if part.kind and part.kind not in KINDS:
            raise ConfigError(
                f"no kind of building {part.kind!r}",
                where=where,
                remedy=f"known: {', '.join(KINDS)}",
            )
        if part.open_plan and part.kind not in OPEN_KINDS:
            raise ConfigError(
                f"no open plan for {part.kind or 'an import'}",
                where=where,
                remedy=f"leave out open_plan, or give one of {', '.join(OPEN_KINDS)}",
            )
        if part.path and part.count != 1:
            raise ConfigError(
                f"an import is one scene, count is {part.count}", where=where, remedy="leave it out"
            )
        if part.style in held_out_styles(spec) and part.split in (None, "train"):
            raise ConfigError(
                f"the style {part.style!r} is held out, and asked for where scenes may be trained "
                "on",
                where=where,
                remedy="give the part another style, or `split: val_unseen`",
            )
    if len(held_out_styles(spec)) == len(get_args(StyleName)):
        raise ConfigError("all styles are held out", where=path, remedy="leave one to train on")
    if abs(sum(spec.splits.values()) - 1.0) > 1e-6:
        raise ConfigError(
            f"the shares of the splits sum to {sum(spec.splits.values()):g}",
            where=path,
            remedy="make them sum to 1",
        )
    return spec


def held_out_styles(spec: CorpusSpec) -> frozenset[str]:
    """The styles that scenes for training never have."""
    return frozenset(spec.held_out.styles if spec.held_out else ())


def held_out_forms(spec: CorpusSpec) -> tuple[str, ...]:
    """The forms of furniture that scenes for training go without."""
    return hold_out_forms(spec.seed, spec.held_out.variants) if spec.held_out else ()


def _choose_style(spec: CorpusSpec, id: str, part: CorpusPart, split: SplitName) -> str:
    """The style of a scene; "" where its own seed decides."""
    apart = held_out_styles(spec)
    if part.style or not apart or part.path:
        return part.style or ""
    usable = [s for s in get_args(StyleName) if (s in apart) == (split != "train")]
    rng = random_stream(spec.seed, "corpus", "style", id)
    return usable[int(rng.integers(len(usable)))]


def plan_corpus(spec: CorpusSpec) -> list[tuple[CorpusScene, CorpusPart, int]]:
    """Every scene to come, with the part that it is of and its own seed; in order of ids.

    Scenes are dealt to splits by their shares, largest remainder; the kinds with most scenes give
    first, so a kind with one scene is trained on, not tested.

    Raises:
        ConfigError: two imports of one name.
    """
    check_spec(spec)
    counts: dict[str, int] = {}
    items: list[tuple[str, CorpusPart, int]] = []
    for part in spec.parts:
        name = part.name or part.kind or scene_id_from(Path(part.path).name)
        for _ in range(part.count):
            k = counts[name] = counts.get(name, 0) + 1
            seed = int(random_stream(spec.seed, "corpus", name, k).integers(2**31))
            items.append((name if part.path else f"{name}-{k:03d}", part, seed))
    ids = [id for id, _, _ in items]
    times = Counter(ids)
    for id in ids:
        check_scene_id(id)
        if times[id] > 1:
            raise ConfigError(f"two scenes are called {id!r}", remedy="give one part a name")
    splits = _deal(spec, items)
    rng = random_stream(spec.seed, "corpus", "val_seen")
    train = [id for id in sorted(ids) if splits[id] == "train"]
    seen = set(rng.permutation(train)[: round(spec.val_seen * len(train))].tolist())
    return sorted(
        (
            (
                CorpusScene(
                    id=id,
                    folder=f"{SCENE_FOLDER}/{id}",
                    split=splits[id],
                    source=part.kind or "import",
                    val_seen=id in seen,
                    style=_choose_style(spec, id, part, splits[id]),
                ),
                part,
                seed,
            )
            for id, part, seed in items
        ),
        key=lambda item: item[0].id,
    )


def _deal(spec: CorpusSpec, items: Sequence[tuple[str, CorpusPart, int]]) -> dict[str, SplitName]:
    """The split of every scene."""
    splits: dict[str, SplitName] = {id: part.split for id, part, _ in items if part.split}
    free: dict[str, list[str]] = {}
    for id, part, _ in items:
        if not part.split:
            free.setdefault(part.kind or id, []).append(id)
    rng = random_stream(spec.seed, "corpus", "splits")
    free = {kind: rng.permutation(sorted(ids)).tolist() for kind, ids in sorted(free.items())}
    total = sum(map(len, free.values()))
    exact = {name: share * total for name, share in spec.splits.items()}
    wanted = {name: int(value) for name, value in exact.items()}
    rest = sorted(exact, key=lambda name: (wanted[name] - exact[name], name))
    for name in rest[: total - sum(wanted.values())]:
        wanted[name] += 1
    largest = [(-len(ids), place, ids) for place, ids in enumerate(free.values())]
    heapify(largest)  # of kinds with equally many scenes the first by name
    for name in sorted(wanted, key=lambda n: (wanted[n], n)):  # the smallest split chooses first
        for _ in range(wanted[name]):
            left, place, ids = largest[0]
            splits[ids.pop()] = name
            heapreplace(largest, (left + 1, place, ids))
    return splits


def load_corpus(path: Path | str) -> CorpusFile:
    """Read `corpus.json` of a corpus folder, strictly.

    Raises:
        StorageError: it is missing (a run that has not ended has none), or a folder leaves it.
        FormatError: damaged, or of another layout.
    """
    folder = plain_path(path)
    about = load_json(folder / CORPUS_FILE, CorpusFile)
    if about.layout != LAYOUT:
        raise FormatError(
            f"layout {about.layout}, this version reads {LAYOUT}",
            file=folder / CORPUS_FILE,
            remedy="make the corpus again",
        )
    for scene in about.scenes:
        safe_join(folder, scene.folder)
    return about
