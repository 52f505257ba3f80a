"""Map files: what is read, what is refused, and that a round trip loses nothing."""

from __future__ import annotations

import itertools
import json

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from PIL import Image

from gn0.errors import FormatError, Gn0Error, StorageError
from gn0.maps.grid import OccupancyGrid
from gn0.maps.interiorgs_map import load_occupancy, save_occupancy
from gn0.maps.movingai import load_movingai_map, load_movingai_scenario
from gn0.maps.ros import load_ros_map
from gn0.seeds import random_stream

SHARED_TMP = settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
# rows from top to bottom; the picture's left is the larger x
PICTURE = np.array([[255, 255, 0], [127, 255, 255]], np.uint8)


def write_interiorgs(folder, picture=PICTURE, **frame):
    folder.mkdir(parents=True, exist_ok=True)
    Image.fromarray(picture).save(folder / "occupancy.png")
    (folder / "occupancy.json").write_text(json.dumps(frame))
    return folder


# InteriorGS ------------------------------------------------------------------------------------


@SHARED_TMP
@given(
    hnp.arrays(
        np.uint8, st.tuples(st.integers(1, 9), st.integers(1, 9)), elements=st.integers(0, 2)
    ),
    st.floats(0.005, 3.0),
    st.floats(-500, 500),
    st.floats(-500, 500),
)
def test_interiorgs_round_trip_is_exact(tmp_path, cells, resolution, x, y):
    grid = OccupancyGrid(cells, resolution, (x, y))
    save_occupancy(grid, tmp_path, {"generator": "test", "scale": "ours wins"})
    again = load_occupancy(tmp_path)
    np.testing.assert_array_equal(again.cells, grid.cells)
    assert (again.resolution, again.origin) == (grid.resolution, grid.origin)
    assert json.loads((tmp_path / "occupancy.json").read_text())["generator"] == "test"


def test_interiorgs_columns_run_against_x(tmp_path):
    frame = {"scale": 0.5, "lower": [1.0, 10.0, 0], "upper": [2.5, 11.0, 0]}
    grid = load_occupancy(write_interiorgs(tmp_path, **frame))
    assert grid.origin == (1.0, 10.0) and grid.resolution == 0.5
    for py in range(2):
        for px in range(3):
            x, y = 2.5 - (px + 0.5) * 0.5, 10.0 + (py + 0.5) * 0.5
            row, col = grid.cell_of(x, y)
            assert grid.cells[row, col] == {255: 0, 0: 1, 127: 2}[int(PICTURE[py, px])]


@pytest.mark.parametrize("flip_x", [False, True])
@pytest.mark.parametrize("flip_y", [False, True])
def test_interiorgs_negative_spans_run_the_other_way(tmp_path, flip_x, flip_y):
    lower, upper = [1.0, 10.0, 0], [2.5, 11.0, 0]
    if flip_x:
        lower[0], upper[0] = upper[0], lower[0]
    if flip_y:
        lower[1], upper[1] = upper[1], lower[1]
    grid = load_occupancy(write_interiorgs(tmp_path, scale=0.5, lower=lower, upper=upper))
    assert grid.origin == (1.0, 10.0)
    sx, sy = (upper[0] - lower[0]) / 3, (upper[1] - lower[1]) / 2
    for py in range(2):
        for px in range(3):
            cell = grid.cell_of(upper[0] - (px + 0.5) * sx, lower[1] + (py + 0.5) * sy)
            assert grid.cells[cell] == {255: 0, 0: 1, 127: 2}[int(PICTURE[py, px])]


def test_interiorgs_min_and_max_stand_in_for_lower_and_upper(tmp_path):
    a = load_occupancy(
        write_interiorgs(tmp_path / "a", scale=0.5, min=[1, 10, 0], max=[2.5, 11, 0])
    )
    b = load_occupancy(
        write_interiorgs(
            *(tmp_path / "b",),
            **{"scale": 0.5, "min": [0, 0, 0], "max": [0, 0, 0]},
            **{"lower": [1, 10, 0], "upper": [2.5, 11, 0]},
        )
    )
    assert a.content_hash == b.content_hash


def test_interiorgs_free_threshold_is_a_choice(tmp_path):
    greys = np.array([[255, 200, 199, 127, 64, 63, 0]], np.uint8)
    folder = write_interiorgs(tmp_path, greys, scale=1.0, lower=[0, 0, 0], upper=[7, 1, 0])
    assert load_occupancy(folder).cells[0, ::-1].tolist() == [0, 0, 2, 2, 2, 1, 1]
    strict = load_occupancy(folder, free_threshold=255)
    assert strict.cells[0, ::-1].tolist() == [0, 2, 2, 2, 2, 1, 1]


@pytest.mark.parametrize(
    ("frame", "message"),
    [
        ({"scale": 0.5}, "'lower' nor 'min'"),
        ({"scale": 0.5, "lower": [1, 2], "upper": "x"}, "'upper' nor 'max'"),
        ({"scale": 0, "lower": [0, 0], "upper": [1.5, 1]}, "scale is 0"),
        ({"scale": "1", "lower": [0, 0], "upper": [1.5, 1]}, "not a number"),
        ({"scale": 0.5, "lower": [0, None], "upper": [1.5, 1]}, "not a number"),
        ({"scale": 50, "lower": [0, 0], "upper": [1.5, 1]}, "do not span"),
        ({"scale": 0.5, "lower": [0, 0], "upper": [1e999, 1]}, "JSON|finite"),
    ],
)
def test_interiorgs_frames_that_cannot_be_right_are_refused(tmp_path, frame, message):
    folder = write_interiorgs(tmp_path, **frame)
    with pytest.raises(FormatError, match=message) as caught:
        load_occupancy(folder)
    assert "occupancy.json" in str(caught.value)


def test_interiorgs_files_that_are_missing_or_broken(tmp_path):
    with pytest.raises(StorageError):
        load_occupancy(tmp_path)
    folder = write_interiorgs(tmp_path, scale=0.5, lower=[0, 0, 0], upper=[1.5, 1, 0])
    good = (folder / "occupancy.png").read_bytes()
    for damage in (b"", b"\x89PNG\r\n", good[:40], good[:50], b"P5 9999999 9999999 255\n"):
        (folder / "occupancy.png").write_bytes(damage)
        with pytest.raises(FormatError, match=r"occupancy\.png"):
            load_occupancy(folder)
    (folder / "occupancy.json").write_text("[" * 100_000)
    with pytest.raises(FormatError, match="JSON"):
        load_occupancy(folder)


@pytest.mark.parametrize("mode", ["RGB", "RGBA", "P", "LA", "I;16", "1"])
def test_pictures_of_any_mode_read_alike(tmp_path, mode):
    black_white = np.array([[255, 0, 255], [0, 255, 255]], np.uint8)
    frame = {"scale": 0.5, "lower": [0, 0, 0], "upper": [1.5, 1, 0]}
    plain = load_occupancy(write_interiorgs(tmp_path / "L", black_white, **frame))
    folder = write_interiorgs(tmp_path / "other", black_white, **frame)
    if mode == "I;16":
        picture = Image.fromarray(black_white.astype(np.uint16) * 257)
    else:
        picture = Image.fromarray(black_white).convert(mode)
    picture.save(folder / "occupancy.png")
    assert load_occupancy(folder).content_hash == plain.content_hash


# ROS -------------------------------------------------------------------------------------------


def write_ros(folder, greys, yaml="", name="map.pgm"):
    picture = np.asarray(greys, np.uint8)
    if name.endswith(".pgm"):
        body = b"P5\n# made by a test\n%d %d\n255\n" % picture.shape[::-1] + picture.tobytes()
        (folder / name).write_bytes(body)
    else:
        Image.fromarray(picture).save(folder / name)
    text = (
        "resolution: 0.1\norigin: [1.0, 2.0, 0.0]\nnegate: 0\noccupied_thresh: 0.65\n"
        "free_thresh: 0.196\n"
    )
    lines = dict(line.split(": ", 1) for line in (f"image: {name}\n" + text + yaml).splitlines())
    (folder / "map.yaml").write_text("".join(f"{k}: {v}\n" for k, v in lines.items() if v != "-"))
    return folder / "map.yaml"


@pytest.mark.parametrize("name", ["map.pgm", "map.png"])
def test_ros_rows_run_down_and_thresholds_decide(tmp_path, name):
    grid = load_ros_map(write_ros(tmp_path, [[254, 205, 0], [206, 100, 80]], name=name))
    assert grid.cells.tolist() == [[0, 2, 1], [0, 2, 1]]
    assert grid.resolution == 0.1 and grid.origin == (1.0, 2.0)


def test_ros_grey_205_follows_the_threshold(tmp_path):
    assert load_ros_map(write_ros(tmp_path, [[205]])).cells[0, 0] == 2
    assert load_ros_map(write_ros(tmp_path, [[205]], "free_thresh: 0.25\n")).cells[0, 0] == 0


def test_ros_negate_turns_black_to_white(tmp_path):
    path = write_ros(tmp_path, [[255, 0]], "negate: 1\n")
    assert load_ros_map(path).cells.tolist() == [[1, 0]]


def test_ros_ascii_pgm(tmp_path):
    path = write_ros(tmp_path, [[0, 0]])
    (tmp_path / "map.pgm").write_bytes(b"P2 # plain\n2 2\n255\n254 0\n0 254\n")
    assert load_ros_map(path).cells.tolist() == [[1, 0], [0, 1]]


def test_ros_scale_and_raw_modes_carry_per_cents(tmp_path):
    scale = "mode: scale\noccupied_thresh: 1.0\nfree_thresh: 0.0\n"
    path = write_ros(tmp_path, [[255, 200, 128, 80, 0]], scale)
    assert load_ros_map(path).cells.tolist() == [[0, 0, 2, 1, 1]]
    raw = "mode: raw\noccupied_thresh: -\nfree_thresh: -\n"
    path = write_ros(tmp_path, [[0, 24, 50, 65, 100, 101, 255]], raw)
    assert load_ros_map(path).cells.tolist() == [[0, 0, 2, 1, 1, 2, 2]]


def test_ros_transparent_pixels_of_a_scale_map_are_unknown(tmp_path):
    path = write_ros(tmp_path, [[255, 255]], "mode: scale\n", name="map.png")
    Image.fromarray(np.array([[[255, 255], [255, 0]]], np.uint8), "LA").save(tmp_path / "map.png")
    assert load_ros_map(path).cells.tolist() == [[0, 2]]


@pytest.mark.parametrize(
    ("yaml", "error", "message"),
    [
        ("resolution: 0\n", FormatError, "resolution"),
        ("resolution: .nan\n", FormatError, "finite"),
        ("resolution: -\n", FormatError, "missing"),
        ("origin: [0, 0, 0.3]\n", FormatError, "rotated by 0.3 rad"),
        ("origin: [0]\n", FormatError, "origin"),
        ("mode: colour\n", FormatError, "mode"),
        ("negate: 7\n", FormatError, "negate"),
        ("free_thresh: 0.9\n", FormatError, "thresholds"),
        ("image: ../map.pgm\n", StorageError, "climbs out"),
        ("image: /etc/passwd\n", StorageError, "climbs out"),
        ("image: [1, 2]\n", FormatError, "picture"),
        ("image: other.pgm\n", StorageError, "other.pgm"),
        ("negate: !!python/object/apply:os.system [ls]\n", FormatError, "YAML"),
        ("negate: [[[\n", FormatError, "YAML"),
    ],
)
def test_ros_maps_that_cannot_be_right_are_refused(tmp_path, yaml, error, message):
    with pytest.raises(error, match=message):
        load_ros_map(write_ros(tmp_path, [[255]], yaml))


def test_ros_a_truncated_picture_is_refused(tmp_path):
    path = write_ros(tmp_path, np.full((40, 40), 255))
    data = (tmp_path / "map.pgm").read_bytes()
    (tmp_path / "map.pgm").write_bytes(data[:-100])
    with pytest.raises(FormatError, match=r"map\.pgm"):
        load_ros_map(path)
    (tmp_path / "map.pgm").write_bytes(b"P5 8000 8000 255\n" + bytes(50))
    with pytest.raises(FormatError, match=r"map\.pgm"):
        load_ros_map(path)


def test_ros_maps_of_real_robots(shared_data):
    house = load_ros_map(shared_data / "worlds/small_house/maps/turtlebot3_waffle_pi/map.yaml")
    assert house.shape == (500, 500) and house.origin == (-12.5, -12.5)
    assert house.free_area == pytest.approx(157.6, abs=0.1)
    warehouse = load_ros_map(shared_data / "worlds/small_warehouse/maps/005/map.yaml")
    assert warehouse.shape == (423, 286)
    for path in sorted((shared_data / "maps").rglob("*.yaml")):
        grid = load_ros_map(path)
        assert 0 < grid.free_area < 2000
    depot = load_ros_map(shared_data / "maps/nav2/depot.yaml")
    assert depot.shape == (307, 604)


# MovingAI --------------------------------------------------------------------------------------

MAP = b"type octile\nheight 2\nwidth 3\nmap\n.GS\n@TW\n"


def test_movingai_tiles(tmp_path):
    path = tmp_path / "a.map"
    for data in (MAP, MAP.replace(b"\n", b"\r\n"), MAP + b"\n"):
        path.write_bytes(data)
        assert load_movingai_map(path).cells.tolist() == [[0, 0, 0], [1, 1, 1]]


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"map\n...",
        b"type octile\nheight 2\nwidth 3\nmap\n...\n",
        b"type octile\nheight 2\nwidth 3\nmap\n...\n..\n",
        b"type octile\nheight -2\nwidth 3\nmap\n...\n",
        b"type octile\nheight 99999999\nwidth 99999999\nmap\n...\n",
        b"\x00" * 100,
    ],
)
def test_movingai_maps_that_are_not_are_refused(tmp_path, data):
    path = tmp_path / "a.map"
    path.write_bytes(data)
    with pytest.raises(FormatError, match=r"a\.map"):
        load_movingai_map(path)


def test_movingai_scenarios(tmp_path):
    path = tmp_path / "a.scen"
    path.write_text("version 1\n0\tmaps/a b.map\t49\t49\t1\t11\t2\t12\t1.41421\n\n")
    (query,) = load_movingai_scenario(path)
    assert (query.start, query.goal, query.optimum) == ((11, 1), (12, 2), 1.41421)
    assert query.map_name == "maps/a b.map" and query.bucket == 0
    for text in ("", "nope\n", "version 1\n1 2 3\n", "version 1\n0\ta\t9\t9\t1\t1\t-1\t2\t3\n"):
        path.write_text(text)
        with pytest.raises(FormatError, match=r"a\.scen"):
            load_movingai_scenario(path)


# mutants ---------------------------------------------------------------------------------------


def test_no_mutant_of_a_map_raises_anything_foreign(tmp_path):
    rng = random_stream(0, "mutants")
    ros = write_ros(tmp_path, rng.integers(0, 256, (12, 12)), name="map.png")
    gs = write_interiorgs(tmp_path / "gs", scale=0.5, lower=[0, 0, 0], upper=[1.5, 1, 0])
    moving = tmp_path / "a.map"
    moving.write_bytes(MAP)
    scen = tmp_path / "a.scen"
    scen.write_text("version 1\n0\ta.map\t3\t2\t0\t0\t2\t0\t2\n")
    targets = [
        (ros, lambda: load_ros_map(ros)),
        (tmp_path / "map.png", lambda: load_ros_map(ros)),
        (gs / "occupancy.json", lambda: load_occupancy(gs)),
        (gs / "occupancy.png", lambda: load_occupancy(gs)),
        (moving, lambda: load_movingai_map(moving)),
        (scen, lambda: load_movingai_scenario(scen)),
    ]
    for path, load in targets:
        good = path.read_bytes()
        load()
        for _ in range(150):
            data = bytearray(good)
            for _ in range(rng.integers(1, 4)):
                kind, at = rng.integers(4), int(rng.integers(len(data) + 1))
                if kind == 0:
                    del data[at:]
                elif kind == 1:
                    data[at:at] = rng.bytes(int(rng.integers(1, 5)))
                elif kind == 2 and at < len(data):
                    data[at] = rng.integers(256)
                elif kind == 3:
                    del data[at : at + int(rng.integers(1, 9))]
            path.write_bytes(bytes(data))
            try:
                load()
            except Gn0Error as error:
                assert str(error)
        path.write_bytes(good)


def test_interiorgs_negative_spans_that_were_rounded_keep_each_cell_in_its_place(tmp_path):
    """Cell by cell: a mirrored or shifted map has the right size and the right share of free."""
    for flip_x, flip_y in itertools.product((False, True), repeat=2):
        lower, upper = [1.0, 10.0, 0], [2.49, 10.99, 0]  # a centimetre less than the cells span
        anchor = [upper[0], lower[1]]  # of the first pixel, with both spans positive
        if flip_x:
            lower[0], upper[0] = upper[0], lower[0]
            anchor[0] = upper[0]
        if flip_y:
            lower[1], upper[1] = upper[1], lower[1]
            anchor[1] = lower[1]
        grid = load_occupancy(write_interiorgs(tmp_path, scale=0.5, lower=lower, upper=upper))
        for py, px in itertools.product(range(2), range(3)):
            x = anchor[0] + (px + 0.5) * (0.5 if flip_x else -0.5)
            y = anchor[1] + (py + 0.5) * (-0.5 if flip_y else 0.5)
            wanted = {255: 0, 0: 1, 127: 2}[int(PICTURE[py, px])]
            assert grid.cells[grid.cell_of(x, y)] == wanted, (flip_x, flip_y, px, py)
