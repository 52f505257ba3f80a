"""Every thing of the catalogue by itself: closed, within its box, standing, facing, in reach."""

from __future__ import annotations

import math
import pkgutil
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

import gn0.scenes.procedural.catalogue as package
from gn0.cli.main import main
from gn0.errors import ConfigError
from gn0.scenes.procedural.assembly import WHOLE_PICTURE, Assembly, Item, Placed
from gn0.scenes.procedural.catalogue.table import GIVEN, HANGS, KINDS, find_things, list_things
from gn0.scenes.procedural.catalogue.tables.joinery import build_fronts
from gn0.scenes.procedural.palette import STEEL, WHITE
from gn0.scenes.procedural.shapes import LEAST_AREA, Shape
from gn0.viewer.furniture_sheet import draw_item

THINGS = list_things()
SEEDS = 3
# things with a sheet among their pieces: prints, cloth, leaves, water, vessels that are seen into,
# and undersides that nobody can see
SHEETS = {
    "bath/shower", "bath/towel_rail", "bath/washing_machine", "clutter/bottle",
    "clutter/clock_radio", "clutter/laptop", "clutter/magazines", "clutter/monitor",
    "clutter/speaker", "decor/curtains", "decor/photo", "decor/picture", "decor/plant",
    "decor/vase", "depot/barrel", "depot/carton", "depot/dock", "depot/high_bay", "depot/rack",
    "depot/safety_sign", "fixtures/cooler", "fixtures/exit_sign", "fixtures/poster",
    "fixtures/sign", "fixtures/sprinkler", "garden/bird_bath", "garden/bollard",
    "garden/clothesline", "garden/deck_chair", "garden/fountain", "garden/hydrant",
    "garden/litter_bin", "garden/parasol", "garden/pergola", "garden/ping_pong", "garden/sandbox",
    "garden/sundial", "home/stacking_rings", "kitchen/fridge", "kitchen/pot", "kitchen/stove",
    "light/desk_lamp", "light/pendant", "light/table_lamp", "office/binder", "office/copier",
    "office/flip_chart", "office/meeting_table", "office/phone", "office/reception_desk",
    "office/whiteboard", "office/work_desk", "public/blackboard", "public/pupil_desk",
    "shop/checkout", "shop/cooler", "shop/flat_goods", "shop/freezer_chest", "shop/poster",
    "shop/produce_crate", "shop/produce_stand", "shop/promotion", "shop/shelf_run", "shop/sign",
    "storage/bed", "storage/wardrobe", "tables/rug", "tables/tv",
}  # fmt: skip
# m above the floor: where one sits, works, and can still reach to
SEATS = {"seats/bench": (0.4, 0.55), "seats/sofa": (0.35, 0.5), "seats/stool": (0.35, 0.8)}
WORKTOPS = {
    "kitchen/counter": (0.85, 0.95), "office/work_desk": (0.68, 0.8), "tables/desk": (0.68, 0.8),
    "tables/dining_table": (0.7, 0.8), "public/pupil_desk": (0.6, 0.8),
    "office/meeting_table": (0.7, 0.8), "tables/coffee_table": (0.3, 0.55),
    "tables/side_table": (0.4, 0.65), "tables/nightstand": (0.4, 0.7),
}  # fmt: skip
HIGHEST_SHELF = 2.25


def every_shape(item: Item) -> list[Shape]:
    return [*item.shapes, *(s for part in item.parts for s in every_shape(part.item))]


def is_closed(shape: Shape) -> bool:
    """Whether each edge is gone along once either way, vertices in one place being one."""
    places, index = np.unique(np.round(shape.vertices, 5), axis=0, return_inverse=True)
    faces = index.reshape(-1)[shape.faces]
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    edges = edges[edges[:, 0] != edges[:, 1]]
    there = np.sort(edges[:, 0] * len(places) + edges[:, 1])
    back = np.sort(edges[:, 1] * len(places) + edges[:, 0])
    return bool(np.array_equal(there, back))


def volume(shape: Shape) -> float:
    p = shape.vertices[shape.faces].astype(np.float64)
    p = p - p.reshape(-1, 3).mean(axis=0)
    return float((np.cross(p[:, 0], p[:, 1]) * p[:, 2]).sum() / 6)


def facing(shape: Shape) -> NDArray[np.float64]:
    """The direction that a shape's faces look to, on the whole."""
    p = shape.vertices[shape.faces].astype(np.float64)
    way = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]).sum(axis=0)
    return np.asarray(way / max(float(np.linalg.norm(way)), 1e-12))


def test_no_kind_is_forgotten() -> None:
    there = {module.name for module in pkgutil.iter_modules(package.__path__)}
    assert there - {"table"} == set(KINDS)
    assert set(GIVEN) | set(HANGS) | SHEETS | set(SEATS) | set(WORKTOPS) <= set(THINGS)
    assert len(THINGS) >= 226


@pytest.mark.parametrize("name", sorted(THINGS))
def test_a_thing_is_whole_closed_stands_faces_and_is_in_reach(name: str) -> None:
    thing, opened = THINGS[name], False
    for seed in range(SEEDS):
        item, prints = thing.build(seed), list[float]()
        assert item.category == item.category.lower() and item.category.strip()
        low, high = item.full_extent()
        assert (high - low > 1e-3).all() and (high - low < 8.0).all()
        for shape in every_shape(item):
            assert np.isfinite(shape.vertices).all() and np.isfinite(shape.uv).all()
            assert shape.faces.min() >= 0 and shape.faces.max() < len(shape.vertices)
            p = shape.vertices[shape.faces]
            area = np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1) / 2
            assert (area > LEAST_AREA * 0.99).all(), "a face without area"
        for shape in item.shapes:
            closed = is_closed(shape)
            opened |= not closed
            assert closed or name in SHEETS, "a piece has a hole"
            assert not closed or volume(shape) >= -1e-9, "a piece is inside out"
            if shape.material.pattern in WHOLE_PICTURE and not closed:
                prints.append(max(-facing(shape)[1], facing(shape)[2]))
        if prints and name != "depot/rack":  # whose signs look along the aisle
            assert max(prints) > 0.5, "its prints look away"
        check_mounting(thing.mounting, low, high)
        check_reach(name, item)
    assert opened or name not in SHEETS, "no longer has a sheet: take it off the list"


def check_mounting(mounting: str, low: NDArray[np.float64], high: NDArray[np.float64]) -> None:
    if mounting == "base":
        assert abs(low[2]) <= 0.035, "floats, or sinks into what it stands on"
        assert abs(low[0] + high[0]) < 1.6, "its base is not at the origin"
    elif mounting == "wall":
        assert -0.05 <= high[1] <= 0.035, "is not at the wall, or inside it"
        assert low[1] > -0.35, "stands out into the room"
    elif mounting == "ceiling":
        assert -0.02 <= high[2] <= 0.02, "does not hang from the ceiling"


def check_reach(name: str, item: Item) -> None:
    low, high = item.full_extent()
    for support in item.supports:
        assert support.x0 < support.x1 and support.y0 < support.y1 and support.head > 0
        assert low[0] - 0.01 <= support.x0 and support.x1 <= high[0] + 0.01, "beside the thing"
        assert low[1] - 0.01 <= support.y0 and support.y1 <= high[1] + 0.01, "beside the thing"
        assert support.z <= HIGHEST_SHELF, "nobody reaches that high"
    for heights in (SEATS, WORKTOPS):
        if name in heights:
            least, most = heights[name]
            tops = [support.z for support in item.supports]
            assert tops and least <= max(tops) <= most


def surfaces(item: Item, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> NDArray[np.float64]:
    """Middles of the faces that look up, of a thing and its parts (their yaw left out)."""
    found = []
    for shape in item.shapes:
        p = shape.vertices[shape.faces]
        n = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
        found.append(
            p[n[:, 2] > 0.5 * np.linalg.norm(n, axis=1)].mean(axis=1) + np.array([x, y, z])
        )
    found += [surfaces(p.item, x + p.x, y + p.y, z + p.z) for p in item.parts]
    return np.concatenate(found)


@pytest.mark.parametrize("name", sorted(THINGS))
def test_what_is_put_on_it_stands_on_a_surface(name: str) -> None:
    """At the height of each support, and on top of what the thing has there."""
    for seed in range(SEEDS):
        item = THINGS[name].build(seed)
        own = surfaces(Item(item.category, item.shapes))
        heights = surfaces(item)[:, 2] if item.supports else own[:, 2]
        for support in item.supports:
            assert np.abs(heights - support.z).min() < 0.012, f"nothing is at {support.z}"
            within = (own[:, :2] > (support.x0, support.y0)).all(axis=1)
            within &= (own[:, :2] < (support.x1, support.y1)).all(axis=1)
            above = own[within, 2] - support.z
            assert not ((above > 0.012) & (above < 0.1)).any(), f"it is above {support.z}"


@pytest.mark.parametrize("name", sorted(THINGS))
def test_its_box_holds_it(name: str) -> None:
    """The object's box, as the scene's labels have it, turned as the thing is."""
    assembly = Assembly()
    assembly.add_item(Placed(THINGS[name].build(1), 2.0, 1.0, 0.5, 0.7), "room_1")
    mesh, materials = assembly.finish()
    assert mesh.material.max() == len(materials) - 1
    assert len({thing.id for thing in assembly.objects}) == len(assembly.objects)
    for number, thing in enumerate(assembly.objects):
        points = mesh.vertices[np.unique(mesh.faces[mesh.instance == number])] - thing.box.centre
        c, s = math.cos(thing.box.yaw), math.sin(thing.box.yaw)
        local = np.abs(points @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]))
        assert (local <= np.array(thing.box.size) / 2 + 1e-4).all(), thing.id
        assert (local.max(axis=0) >= np.array(thing.box.size) / 2 - 1e-3).all(), "box too large"


@pytest.mark.parametrize("name", ["seats/chair", "seats/office_chair", "seats/sofa",
                                  "garden/garden_bench", "public/wheelchair"])  # fmt: skip
def test_who_sits_looks_to_the_front(name: str) -> None:
    """What is higher than the seat is the back, behind the middle: the front is −y."""
    for seed in range(SEEDS):
        item = THINGS[name].build(seed)
        points = np.concatenate([shape.vertices for shape in item.shapes])
        top = points[points[:, 2] > 0.85 * item.extent()[1][2]]
        assert top[:, 1].mean() > 0.08


@pytest.mark.parametrize("way", [{}, {"knob": True}, {"vertical": True}])
def test_handles_are_in_front_of_their_fronts(way: dict[str, bool]) -> None:
    shapes = build_fronts(1.2, 0.8, 2, 2, -0.25, 0.1, WHITE, STEEL, **way)
    fronts = [s for s in shapes if s.material == WHITE]
    handles = [s for s in shapes if s.material == STEEL]
    assert len(fronts) == len(handles) == 4
    face = min(s.vertices[:, 1].min() for s in fronts)
    assert face == pytest.approx(-0.268)
    for handle in handles:
        assert (
            handle.vertices[:, 1].min() < face - 0.02 and handle.vertices[:, 1].max() < face + 0.01
        )


def test_the_same_seed_builds_the_same_thing_and_others_differ() -> None:
    def sizes(name: str, *seeds: int) -> list[tuple[float, ...]]:
        return [tuple(np.round(THINGS[name].build(seed).size, 3)) for seed in seeds]

    for name in ("seats/chair", "light/floor_lamp", "storage/bookshelf", "tables/desk"):
        assert sizes(name, 4) == sizes(name, 4)
        assert len(set(sizes(name, *range(8)))) >= 4


def test_the_feet_of_a_drip_stand_stand_around_it_evenly() -> None:
    low, high = THINGS["public/drip_stand"].build().extent()
    # five feet on a circle of 0.26 m: their corners reach 0.26 m ahead and 0.26 cos 36° behind
    assert low[2] == pytest.approx(0.0, abs=1e-6)
    assert high[0] == pytest.approx(0.26 + 0.028, abs=0.005)
    assert low[0] == pytest.approx(-0.26 * np.cos(np.pi / 5) - 0.028, abs=0.005)
    assert high[1] == pytest.approx(-low[1], abs=0.005)


def test_things_are_found_by_kind_name_and_pattern() -> None:
    assert [thing.name for thing in find_things(["seats/sofa"])] == ["seats/sofa"]
    assert len(find_things(["kitchen"])) == sum(n.startswith("kitchen/") for n in THINGS)
    assert {t.name for t in find_things(["*/*lamp", "seats/sofa"])} >= {
        "light/table_lamp", "public/wall_lamp", "seats/sofa",
    }  # fmt: skip
    assert len(find_things()) == len(THINGS)
    with pytest.raises(ConfigError, match=r"'seats/sofas'.*did you mean seats/sofa"):
        find_things(["seats/sofas"])


def test_a_thing_is_drawn_from_its_front_and_fills_its_picture() -> None:
    """A fire extinguisher is red; a door of a fridge has the light, its side has not."""
    picture = draw_item(THINGS["fixtures/extinguisher"].build(), 64).astype(int)
    shown = (picture < 235).any(axis=2)
    assert shown.any(axis=1).mean() > 0.85
    red = picture[shown].mean(axis=0)
    assert red[0] > 2 * red[1] and red[0] > 2 * red[2]
    fridge = draw_item(THINGS["kitchen/fridge"].build(), 64).astype(int)
    assert fridge[40, 26].mean() > fridge[40, 40].mean() + 8


def test_the_sheet_is_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "sheet.png"
    assert main(["scene", "furniture", "seats", "kitchen/fridge", "--out", str(out)]) == 0
    count = len(find_things(["seats", "kitchen/fridge"]))
    assert f"{count} things, written to {out}" in capsys.readouterr().out
    with Image.open(out) as sheet:
        assert sheet.size == (168 * min(count, 8), 204 * -(-count // 8))
    assert main(["scene", "furniture", "bath", "--list"]) == 0
    assert "bath/toilet\n" in capsys.readouterr().out
    assert main(["scene", "furniture", "nonsense"]) == 2
