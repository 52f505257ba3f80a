"""Homes whose day rooms have next to no walls between them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest

from gn0.cli.main import main
from gn0.errors import ConfigError, SceneError
from gn0.scenes.corpus import CorpusPart, CorpusSpec, check_spec, load_spec
from gn0.scenes.folder import load_scene
from gn0.scenes.procedural import generate
from gn0.scenes.procedural.building import check_reach, choose_palette
from gn0.scenes.procedural.generate import GenerateSettings
from gn0.scenes.procedural.kinds import KINDS, KindName
from gn0.scenes.procedural.layout import RoomLayout
from gn0.scenes.procedural.plan import FloorPlan, Wall, clear_span, plan_apartment
from gn0.scenes.procedural.residence import plan_residence

DAY = {
    "apartment": ({"kitchen", "living room"}, {"living room", "hallway"}),
    "residence": (
        {"kitchen", "living room"}, {"living room", "hallway"}, {"living room", "dining room"},
        {"dining room", "hallway"}, {"kitchen", "hallway"}, {"kitchen", "dining room"},
    ),
}  # fmt: skip
PLANS: dict[str, Callable[..., FloorPlan]] = {
    "apartment": plan_apartment,
    "residence": plan_residence,
}


def types_of(plan: FloorPlan, wall: Wall) -> set[str]:
    return {plan.room(id).type for id in wall.rooms if id is not None}


def share_gone(plan: FloorPlan, wall: Wall) -> float:
    """How much of the wall, between the corners of its rooms, is an opening to the floor."""
    low, high = clear_span(plan, wall)
    gone = sum(
        min(o.high, high) - max(o.low, low)
        for o in plan.openings
        if o.axis == wall.axis and o.rooms == wall.rooms and o.bottom == 0
    )
    return gone / (high - low)


@pytest.mark.parametrize("size", ["small", "medium", "large"])
@pytest.mark.parametrize("kind", PLANS)
def test_day_rooms_are_one_and_all_others_have_doors(kind: str, size: str) -> None:
    for seed in range(8):
        plan = PLANS[kind](seed, size, open_plan=True)
        usual = PLANS[kind](seed, size)
        assert all(o.kind != "open" for o in usual.openings)
        shares: dict[frozenset[str | None], float] = {}
        for wall in plan.walls:
            low, high = clear_span(plan, wall)
            if None in wall.rooms or high - low < 1.3:
                continue
            if types_of(plan, wall) in DAY[kind]:  # joined once, along their longest wall
                pair = frozenset(wall.rooms)
                shares[pair] = max(shares.get(pair, 0.0), share_gone(plan, wall))
            else:
                assert share_gone(plan, wall) < 0.85
        assert shares and min(shares.values()) > 0.85, seed  # 0.2 m stay of a narrow hall
        assert kind == "apartment" or len(shares) > 2
        for o in plan.openings:
            if o.kind == "open":
                assert o.top == pytest.approx(plan.ceiling - 0.05, abs=1e-3) and o.leaf is None


@pytest.mark.parametrize(("kind", "seed"), [("apartment", 3), ("residence", 1)])
def test_what_makes_a_room_finds_its_place_without_walls(kind: KindName, seed: int) -> None:
    """Among them a wall for the television, and everybody can walk everywhere."""
    draft = KINDS[kind].draft(seed, size="small", open_plan=True)
    there = {thing.category for thing in draft.objects}
    assert there >= {"sofa", "tv", "kitchen counter", "fridge", "bed", "toilet"}
    assert kind == "apartment" or "dining table" in there
    assert not check_reach(draft, PLANS[kind](seed, "small", open_plan=True)).cut_off
    wide = [o for o in draft.openings if o.kind == "DOOR" and width(o.polygon) > 2]
    assert wide


def test_furniture_may_stand_in_an_open_wall_but_for_a_lane() -> None:
    plan = plan_residence(1, "small", open_plan=True)
    room = next(room for room in plan.rooms if room.type == "living room")
    layout = RoomLayout(plan, room, np.random.default_rng(0), choose_palette("residence", 1, None))
    openings = [o for side in layout.sides.values() for o in side.openings if o[2] <= 0]
    assert len(openings) == len(layout.keep) > 1
    for (low, high, _, _, opening), (x0, y0, x1, y1) in zip(openings, layout.keep, strict=True):
        kept = x1 - x0 if opening.axis == "x" else y1 - y0
        wide = high - low + 0.1
        assert kept == pytest.approx(min(wide, 1.6) if opening.kind == "open" else wide)
    assert any(o[4].kind == "open" and o[1] - o[0] > 2 for o in openings)


def width(polygon: tuple[tuple[float, float, float], ...]) -> float:
    (ax, ay, _), (bx, by, _) = polygon[:2]
    return abs(ax - bx) + abs(ay - by)


def test_only_homes_have_one() -> None:
    for kind in KINDS:
        if kind in PLANS:
            assert GenerateSettings(kind=kind, open_plan=True).open_plan
            continue
        with pytest.raises(ConfigError, match=f"no {kind} is of another plan") as told:
            GenerateSettings(kind=kind, open_plan=True)
        assert told.value.remedy is not None and "apartment, residence" in told.value.remedy
    with pytest.raises(ConfigError):
        GenerateSettings(kind="ship", open_plan=True)  # type: ignore[arg-type]


@pytest.mark.slow
def test_a_scene_says_that_it_is_open(tmp_path: Path) -> None:
    flags = ["--size", "small", "--light", "draft", "--density", "5000", "--seed", "3"]
    assert main(["scene", "generate", *flags, "--open-plan", "--out", str(tmp_path / "flat")]) == 0
    assert load_scene(tmp_path / "flat").source.settings["open_plan"] is True


def test_who_furnishes_is_told(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """From the command line, and where nothing is said, nothing is."""
    told: list[dict[str, object]] = []

    def draft(seed: int, **more: object) -> None:
        told.append(more)
        raise SceneError("asked")

    kind = SimpleNamespace(draft=draft, density=1.0, version=1, opens=True, areas=())
    monkeypatch.setattr(generate, "KINDS", {"apartment": kind})
    out = str(tmp_path / "flat")
    assert main(["scene", "generate", "--open-plan", "--out", out]) == 2
    assert main(["scene", "generate", "--out", out]) == 2
    assert told[0]["open_plan"] is True and "open_plan" not in told[1]


def test_a_part_of_a_corpus_is_open_and_others_keep_their_digest(tmp_path: Path) -> None:
    (tmp_path / "spec.yaml").write_text(
        "parts:\n  - {kind: apartment, open_plan: true}\n  - {kind: residence, open_plan: false}\n"
    )
    first, second = load_spec(tmp_path / "spec.yaml").parts
    assert first.open_plan is True
    assert msgspec.json.encode(second) == msgspec.json.encode(CorpusPart(kind="residence"))
    assert b"open_plan" not in msgspec.json.encode(second)
    for part in (CorpusPart(kind="office", open_plan=True), CorpusPart(path="x", open_plan=True)):
        with pytest.raises(ConfigError, match="no open plan for"):
            check_spec(CorpusSpec(parts=(part,)))
