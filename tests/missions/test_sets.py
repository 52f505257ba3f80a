"""Foreign episode sets: what is read is written again, value for value, and means the same."""

from __future__ import annotations

import gzip
import json
import math
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gn0.errors import ConfigError, EpisodeError, FormatError, Gn0Error, StorageError
from gn0.maps.grid import OccupancyGrid
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import AgentSpec, Episode, MissionGoal
from gn0.missions.episode_files import GN_MATRIX_COLUMNS, load_episodes, save_episodes
from gn0.missions.sets.episode_set import (
    EpisodeSet,
    find_placement,
    get_exporter,
    load_set,
    place_task,
)
from gn0.missions.sets.frame_check import check_frame, summarise
from gn0.missions.sets.gn_matrix import ExporterGnMatrix
from gn0.missions.sets.gn_matrix_json import ExporterGnMatrixJson
from gn0.missions.sets.json_file import load_exact, same_values, save_exact
from gn0.missions.sets.vlnce import ExporterVlnce
from gn0.testing.exporter_check import check_exporter
from gn0.testing.scenes import build_floor_plan, build_map_scene, build_point_episodes

GRID = build_floor_plan(4, width=8.0, depth=6.0, clutter=4)
SCENE = build_map_scene(GRID)
ROOM_FOR_TIME = settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


def goals(count: int = 5) -> list[Episode]:
    """Goal episodes on the plan, with texts that other writers trip over."""
    episodes = build_point_episodes(SCENE, NavigationMap(GRID), count, seed=3)
    words = ["Go to „the sofa“.", "走到沙发 ", 'a\tb\\n"c"', "Zum Tisch – dann links", "x"]
    return [
        Episode(
            id=f"plan_{i:04d}", scene_id="plan", start=e.start, path=e.path, seed=i + 1,
            mission=MissionGoal(goal=e.goal, object_id=str(i), category="sofa",
                                instruction=words[i % len(words)]),
        )
        for i, e in enumerate(episodes)
    ]  # fmt: skip


def same_set(a: EpisodeSet, b: EpisodeSet) -> bool:
    """Whether two sets hold the same file."""
    if isinstance(a.native, pa.Table):
        return bool(a.native.equals(b.native, check_metadata=True)) and a.tasks == b.tasks
    kept = [(vars(n).copy() if hasattr(n, "__dict__") else n) for n in (a.native, b.native)]
    return same_values(*[json.loads(json.dumps(_plain(k))) for k in kept]) and a.tasks == b.tasks


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    return [_plain(v) for v in value] if isinstance(value, list | tuple) else value


@pytest.mark.parametrize(
    ("exporter", "suffix"),
    [(ExporterGnMatrix, ".parquet"), (ExporterGnMatrixJson, ""), (ExporterVlnce, ".json.gz"),
     (ExporterVlnce, ".json")],
)  # fmt: skip
def test_our_exporters_keep_the_protocol(exporter: Any, suffix: str) -> None:
    check_exporter(exporter, suffix=suffix, same=same_set)


# ---- VLN-CE, the whole files ----


@pytest.mark.parametrize(
    ("split", "count", "scenes"),
    [("val_seen", 778, 53), pytest.param("train", 10_819, 61, marks=pytest.mark.slow)],
)
def test_whole_vlnce_splits_come_back_value_for_value(
    split: str, count: int, scenes: int, shared_data: Path, tmp_path: Path
) -> None:
    source = shared_data / "vln" / "R2R_VLNCE_v1-2_preprocessed" / split / f"{split}.json.gz"
    read = load_set(source)
    assert read.format == "vlnce" and len(read.tasks) == count and len(read.scenes) == scenes
    out = tmp_path / f"{split}.json.gz"
    get_exporter("vlnce").save(read, out)
    original = json.loads(gzip.decompress(source.read_bytes()))
    written = json.loads(gzip.decompress(out.read_bytes()))
    assert same_values(original, written)
    truth = source.with_name(f"{split}_gt.json.gz")
    if truth.is_file():
        again = json.loads(gzip.decompress((tmp_path / truth.name).read_bytes()))
        assert same_values(json.loads(gzip.decompress(truth.read_bytes())), again)
        assert "ground truth of 778 of 778 episodes" in read.notes
    first = read.tasks[0]
    record = original["episodes"][0]
    x, _, z = record["start_position"]
    assert first.id == str(record["episode_id"]) and first.start[:2] == (x, -z)
    assert first.instruction == record["instruction"]["instruction_text"], "not even a blank less"


def test_vlnce_paths_are_as_long_as_the_file_says(shared_data: Path) -> None:
    """The turn keeps lengths; most reference paths are near the recorded geodesic distance."""
    folder = shared_data / "vln" / "R2R_VLNCE_v1-2_preprocessed" / "val_seen"
    read = load_set(folder / "val_seen.json.gz")
    told = [e["info"]["geodesic_distance"] for e in read.native.document["episodes"]]
    ratio = []
    for task, record, length in zip(
        read.tasks, read.native.document["episodes"], told, strict=True
    ):
        flat = np.array(task.path)
        raw = np.array(record["reference_path"])[:, [0, 2]]
        mine = np.hypot(*np.diff(flat, axis=0).T).sum()
        assert mine == pytest.approx(np.hypot(*np.diff(raw, axis=0).T).sum(), abs=1e-9)
        ratio.append(mine / length)
    assert 0.9 < float(np.median(ratio)) < 1.2


values = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**70), 2**70) | st.floats() | st.text(max_size=8),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3)
    ),
    max_leaves=8,
)
number = st.floats(-100, 100) | st.integers(-100, 100)
xyz = st.lists(number, min_size=3, max_size=3)


@st.composite
def vlnce_documents(draw: st.DrawFn) -> dict[str, Any]:
    extra = st.dictionaries(st.sampled_from(["language", "notes", "x"]), values, max_size=2)
    records = []
    for number_ in draw(st.lists(st.integers(0, 99), max_size=4, unique=True)):
        yaw = draw(st.floats(-3, 3))
        records.append(
            {
                "episode_id": draw(st.sampled_from([number_, str(number_)])),
                "trajectory_id": draw(st.integers()),
                "scene_id": draw(st.sampled_from(["mp3d/a/a.glb", "b.glb", "x/y-1_2/y-1_2.glb"])),
                "start_position": draw(xyz),
                "start_rotation": [0, math.sin(yaw / 2), 0, math.cos(yaw / 2)],
                "info": {"geodesic_distance": draw(st.floats())},
                "goals": [{"position": draw(xyz), "radius": 3.0}] if draw(st.booleans()) else [],
                "instruction": {
                    "instruction_text": draw(st.text(max_size=20)),
                    "instruction_tokens": draw(st.lists(st.integers(0, 9), max_size=5)),
                    **draw(extra),
                },
                "reference_path": draw(st.lists(xyz, max_size=3)),
                **draw(extra),
            }
        )
    return {"episodes": records, "instruction_vocab": draw(values), **draw(extra)}


@given(vlnce_documents())
@ROOM_FOR_TIME
def test_any_vlnce_document_comes_back(tmp_path: Path, document: dict[str, Any]) -> None:
    path, again = tmp_path / "a.json.gz", tmp_path / "b.json.gz"
    save_exact(path, document)
    read = load_set(path)
    get_exporter("vlnce").save(read, again)
    assert same_values(load_exact(again), document)
    assert [t.id for t in read.tasks] == [str(e["episode_id"]) for e in document["episodes"]]


def test_ground_truth_travels_with_its_episodes(tmp_path: Path) -> None:
    exporter = ExporterVlnce()
    built = exporter.build(goals(3), {"plan": GRID}, "val")
    truth = {
        str(i): {"locations": [[0.0, 0.0, 0.0]], "forward_steps": 1, "actions": [2, 1, 0]}
        for i in (1, 2, 3)
    }
    save_exact(tmp_path / "val.json.gz", built.native.document)
    save_exact(tmp_path / "val_gt.json.gz", truth)
    part = load_set(tmp_path / "val.json.gz").select(["1", "3"])
    exporter.save(part, tmp_path / "out" / "val.json.gz")
    assert list(load_exact(tmp_path / "out" / "val_gt.json.gz")) == ["1", "3"]
    truth["2"]["forward_steps"] = 5
    save_exact(tmp_path / "val_gt.json.gz", truth)
    with pytest.raises(FormatError, match="'2' has 1 forward actions, forward_steps says 5"):
        load_set(tmp_path / "val.json.gz")


def test_a_vlnce_file_of_ours_is_what_its_loader_expects() -> None:
    document = ExporterVlnce().build(goals(3), {"plan": GRID}, "val").native.document
    vocabulary = document["instruction_vocab"]
    assert vocabulary["word_list"][0] == "<pad>" and vocabulary["UNK_INDEX"] == 1
    for record in document["episodes"]:
        assert isinstance(record["episode_id"], int) and isinstance(record["trajectory_id"], int)
        tokens = record["instruction"]["instruction_tokens"]
        assert len(tokens) == 200 and max(tokens) < vocabulary["num_vocab"]
        assert record["scene_id"] == "gn0/plan/plan.glb" and record["goals"][0]["radius"] == 3.0
        assert all(len(p) == 3 and p[1] == 0.0 for p in record["reference_path"])
        assert np.linalg.norm(record["start_rotation"]) == pytest.approx(1.0)


# ---- GN-Matrix ----


def foreign_table(rows: int = 5, **more: pa.Array) -> pa.Table:
    """A GN-Matrix table as a stranger writes it, with types and columns of their own."""
    table = ExporterGnMatrix().build(goals(rows), {"plan": GRID}, "x").native
    table = table.set_column(
        table.column_names.index("label_ins_id"), "label_ins_id",
        pa.array([int(v) for v in table["label_ins_id"].to_pylist()], pa.int32()),
    )  # fmt: skip
    table = table.set_column(
        table.column_names.index("scene"),
        "scene",
        table["scene"].combine_chunks().dictionary_encode(),
    )
    table = table.set_column(
        table.column_names.index("start_world_x"), "start_world_x",
        table["start_world_x"].cast(pa.float32(), safe=False),
    )  # fmt: skip
    for name, column in more.items():
        table = table.append_column(name, column)
    return table.replace_schema_metadata({"pandas": "{}", "made by": "somebody"})


def test_a_strangers_table_comes_back_column_for_column(tmp_path: Path) -> None:
    extra = pa.array([{"a": 1, "b": None}] * 5, pa.struct([("a", pa.int8()), ("b", pa.string())]))
    table = foreign_table(difficulty=pa.array(["easy", None, "hard", None, ""]), more=extra)
    pq.write_table(table, tmp_path / "a.parquet")
    read = load_set(tmp_path / "a.parquet")
    assert read.format == "gn-matrix" and len(read.tasks) == 5
    get_exporter("gn-matrix").save(read, tmp_path / "b.parquet")
    again = pq.read_table(tmp_path / "b.parquet")
    assert again.equals(pq.read_table(tmp_path / "a.parquet"), check_metadata=True)
    assert again.schema.field("more").type == extra.type
    assert [t.object_id for t in read.tasks] == ["0", "1", "2", "3", "4"]


texts = st.text(st.characters(codec="utf-8"), max_size=12)


@given(st.data(), st.integers(0, 4))
@ROOM_FOR_TIME
def test_any_table_comes_back(tmp_path: Path, data: st.DataObject, rows: int) -> None:
    columns: dict[str, Any] = {}
    lengths = [data.draw(st.integers(0, 5)) for _ in range(rows)]
    for name, kind in GN_MATRIX_COLUMNS:
        wide = data.draw(st.booleans())
        if kind == pa.string():
            cells = [data.draw(texts) for _ in range(rows)]
            if name == "trajectory_id":
                cells = [f"{i}{c}" for i, c in enumerate(cells)]
            columns[name] = pa.array(cells, pa.large_string() if wide else kind)
        elif pa.types.is_list(kind):
            inner = st.floats(width=32) if kind.value_type == pa.float64() else st.integers(-9, 9)
            cells = [data.draw(st.lists(inner, min_size=n, max_size=n)) for n in lengths]
            columns[name] = pa.array(cells, pa.large_list(kind.value_type) if wide else kind)
        elif kind == pa.float64():
            cells = [data.draw(st.floats(width=32)) for _ in range(rows)]
            columns[name] = pa.array(cells, pa.float32() if wide else kind)
        else:
            cells = [data.draw(st.integers(-9, 9)) for _ in range(rows)]
            columns[name] = pa.array(cells, pa.int16() if wide else kind)
    order = data.draw(st.permutations(sorted(columns)))
    table = pa.table({name: columns[name] for name in order})
    pq.write_table(table, tmp_path / "a.parquet")
    read = load_set(tmp_path / "a.parquet")
    get_exporter("gn-matrix").save(read, tmp_path / "b.parquet")
    a, b = pq.read_table(tmp_path / "a.parquet"), pq.read_table(tmp_path / "b.parquet")
    assert a.schema.equals(b.schema, check_metadata=True)
    for name in a.column_names:  # NaN is itself here, as it must be
        assert str(a[name].to_pylist()) == str(b[name].to_pylist())


def test_the_agent_is_given_the_grounded_instruction(tmp_path: Path) -> None:
    """In GN-Matrix `instruction` is another text; the harness shows `grounded_instruction`."""
    table = foreign_table()
    other = pa.array([f"vague {i}" for i in range(5)])
    table = table.set_column(table.column_names.index("instruction"), "instruction", other)
    pq.write_table(table, tmp_path / "a.parquet")
    read = load_set(tmp_path / "a.parquet")
    placed = [place_task(t, find_placement(ExporterGnMatrix(), GRID, ""), AgentSpec())
              for t in read.tasks]  # fmt: skip
    assert [e.instruction for e in placed] == [e.instruction for e in goals()]
    assert [e.instruction for e in load_episodes(tmp_path / "a.parquet", {"plan": GRID})] == [
        e.instruction for e in goals()
    ]


def test_the_heading_is_the_column_in_degrees(tmp_path: Path) -> None:
    """The harness starts by heading_degrees; the unit vector is for pictures."""
    table = foreign_table()
    turned = pa.array([90.0, -180.0, 450.0, 0.0, 15.0])
    name = "start_facing_heading_degrees"
    table = table.set_column(table.column_names.index(name), name, turned)
    pq.write_table(table, tmp_path / "a.parquet")
    placement = find_placement(ExporterGnMatrix(), GRID, "")
    yaw = [
        place_task(t, placement, AgentSpec()).start[2]
        for t in load_set(tmp_path / "a.parquet").tasks
    ]
    assert yaw == pytest.approx([math.pi / 2, -math.pi, math.pi / 2, 0.0, math.pi / 12])


def test_the_older_folder_comes_back_and_obeys_its_list(tmp_path: Path) -> None:
    built = ExporterGnMatrixJson().build(goals(), {"plan": GRID}, "x")
    ExporterGnMatrixJson().save(built, tmp_path / "a")
    some = load_exact(tmp_path / "a" / "plan" / "0001.json")
    some["unknown"] = {"deep": [1, 1.0, None]}
    some["follow"] = [{"frame_index": 0}]
    save_exact(tmp_path / "a" / "plan" / "0001.json", some)
    headless = {**some}
    del headless["start_facing"]
    save_exact(tmp_path / "a" / "plan" / "0009.json", headless)
    (tmp_path / "a" / "plan" / "notes.json").write_text("[]")
    read = load_set(tmp_path / "a")
    assert read.format == "gn-matrix-json" and [t.id for t in read.tasks] == [
        f"plan_{i:04d}" for i in range(5)
    ]
    assert "1 files are not episodes" in read.notes[0]
    ExporterGnMatrixJson().save(read, tmp_path / "b")
    for name in ("0001", "0009"):
        a, b = (load_exact(tmp_path / f / "plan" / f"{name}.json") for f in "ab")
        assert same_values(a, b)
    listed = {"easy": {"plan": {"0003": {}}}, "medium": {}, "hard": {"plan": {"0000": {"k": 1}}}}
    save_exact(tmp_path / "a" / "split.json", listed)
    read = load_set(tmp_path / "a")
    assert [(t.id, t.split, t.number) for t in read.tasks] == [
        ("plan_0000", "hard", 1), ("plan_0003", "easy", 2)
    ]  # fmt: skip
    ExporterGnMatrixJson().save(read, tmp_path / "c")
    files = sorted(str(p.relative_to(tmp_path / "c")) for p in (tmp_path / "c").rglob("*.json"))
    assert "split.json" in files and len(files) == 7, "what is not listed is kept all the same"


def test_table_and_folder_say_the_same(tmp_path: Path) -> None:
    a = ExporterGnMatrix().build(goals(), {"plan": GRID}, "x").tasks
    b = ExporterGnMatrixJson().build(goals(), {"plan": GRID}, "x").tasks
    assert a == b


def test_columns_are_theirs_and_no_others() -> None:
    table = ExporterGnMatrix().build(goals(), {"plan": GRID}, "x").native
    assert table.column_names == [name for name, _ in GN_MATRIX_COLUMNS]


def test_our_own_file_is_a_gn_matrix_file_too(tmp_path: Path) -> None:
    save_episodes(tmp_path / "e.parquet", goals(), {"plan": GRID})
    read = load_set(tmp_path / "e.parquet")
    assert [t.id for t in read.tasks] == [e.id for e in goals()]


# ---- wrong frames, wrong files ----


def spoiled(sign: tuple[int, int]) -> EpisodeSet:
    """A GN-Matrix set whose writer mirrored or turned it."""
    table = ExporterGnMatrix().build(goals(), {"plan": GRID}, "x").native
    x0, y0, x1, y1 = GRID.bounds
    middle = (-(x0 + x1) / 2, -(y0 + y1) / 2)  # the map's centre in nav
    for axis, s, m in zip("xy", sign, middle, strict=True):
        if s > 0:
            continue
        for name in (f"start_world_{axis}", f"goal_world_{axis}"):
            new = pa.array([2 * m - v for v in table[name].to_pylist()])
            table = table.set_column(table.column_names.index(name), name, new)
        name = f"path_raster_world_{axis}"
        new = pa.array([[2 * m - v for v in row] for row in table[name].to_pylist()])
        table = table.set_column(table.column_names.index(name), name, new)
    scratch = ExporterGnMatrix()
    import io

    stream = io.BytesIO()
    pq.write_table(table, stream)
    path = Path(__import__("tempfile").mkdtemp()) / "x.parquet"
    path.write_bytes(stream.getvalue())
    try:
        return scratch.load(path)
    finally:
        shutil.rmtree(path.parent)


@pytest.mark.parametrize(
    ("sign", "name"), [((-1, 1), "mirror_x"), ((1, -1), "mirror_y"), ((-1, -1), "turned")]
)
def test_a_wrong_frame_is_named_with_what_would_mend_it(sign: tuple[int, int], name: str) -> None:
    exporter = ExporterGnMatrix()
    bad = spoiled(sign)
    check = check_frame(bad, exporter, GRID, "plan", find_placement(exporter, GRID, ""))
    assert not check.ok and check.better == name
    assert f"give --frame {name}" in str(check) and "looks wrong" in str(check)
    mended = check_frame(bad, exporter, GRID, "plan", find_placement(exporter, GRID, name))
    assert mended.free[name] == 1.0 and not mended.better


def test_a_right_frame_is_said_in_one_sentence() -> None:
    exporter = ExporterGnMatrix()
    good = exporter.build(goals(), {"plan": GRID}, "x")
    check = check_frame(good, exporter, GRID, "plan", find_placement(exporter, GRID, ""))
    assert check.ok and check.pixels == 1.0 and check.free["documented"] == 1.0
    assert str(check).startswith("plan: 100.0% of ") and "looks wrong" not in str(check)
    with pytest.raises(ConfigError, match="no frame 'upside'") as error:
        find_placement(exporter, GRID, "upside")
    assert "mirror_x" in str(error.value)


def test_statistics_need_no_scene() -> None:
    told = summarise(ExporterVlnce().build(goals(), {"plan": GRID}, "x").tasks)
    assert told.episodes == 5 and told.scenes == 1 and told.storeys == 0 and told.no_goal == 0
    assert 0 < told.path_length[0] <= told.path_length[1] <= told.path_length[2]


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda d: d["episodes"][1].pop("start_position"), "episode 2: Object missing"),
        (lambda d: d["episodes"][0].update(start_rotation=[0, 0, 0, 0]), "not a quaternion"),
        (lambda d: d["episodes"][0]["instruction"].clear(), "instruction_text"),
        (lambda d: d["episodes"][0].update(reference_path=[[1, 2]]), "reference_path"),
        (lambda d: d["episodes"].append(d["episodes"][0]), "used by row 1 and row 6"),
        (lambda d: d.pop("episodes"), "no list of 'episodes'"),
    ],
)
def test_a_damaged_split_names_episode_and_field(spoil: Any, words: str, tmp_path: Path) -> None:
    document = ExporterVlnce().build(goals(), {"plan": GRID}, "x").native.document
    document = json.loads(json.dumps(document))
    spoil(document)
    save_exact(tmp_path / "x.json.gz", document)
    with pytest.raises((FormatError, EpisodeError), match=words.replace("[", r"\[")):
        load_set(tmp_path / "x.json.gz")


def test_rows_without_a_goal_or_words_are_refused_by_name() -> None:
    tasks = ExporterVlnce().build(goals(1), {"plan": GRID}, "x").tasks
    import msgspec

    placement = ExporterVlnce().placements(GRID)[0]
    with pytest.raises(EpisodeError, match="has no goal"):
        place_task(msgspec.structs.replace(tasks[0], goal=None), placement, AgentSpec())
    with pytest.raises(EpisodeError, match="instruction is empty"):
        place_task(msgspec.structs.replace(tasks[0], instruction="  "), placement, AgentSpec())
    with pytest.raises(EpisodeError, match="NaN"):
        place_task(msgspec.structs.replace(tasks[0], goal=(math.nan, 0)), placement, AgentSpec())


def test_json_is_kept_exactly_or_refused(tmp_path: Path) -> None:
    odd = {"b": [1, 1.0, -0.0, 10**30, 1e-320, math.inf, math.nan, "\ud800", "é"], "a": {}}
    save_exact(tmp_path / "a.json", odd)
    assert same_values(load_exact(tmp_path / "a.json"), odd)
    assert not same_values({"a": 1}, {"a": 1.0}) and not same_values(
        {"a": 1, "b": 2}, {"b": 2, "a": 1}
    )
    (tmp_path / "twice.json").write_text('{"a": 1, "b": {"c": 1, "c": 2}}')
    with pytest.raises(FormatError, match="'c' appears twice"):
        load_exact(tmp_path / "twice.json")
    (tmp_path / "deep.json").write_text("[" * 100_000)
    (tmp_path / "huge.json").write_text("1" * 10_000)
    (tmp_path / "cut.json.gz").write_bytes(gzip.compress(b"{}" * 1000)[:30])
    for name in ("deep.json", "huge.json", "cut.json.gz"):
        with pytest.raises(FormatError):
            load_exact(tmp_path / name)
    (tmp_path / "bomb.json.gz").write_bytes(gzip.compress(b" " * 10_000_000))
    with pytest.raises(FormatError, match="more than 1000000 bytes"):
        load_exact(tmp_path / "bomb.json.gz", 1_000_000)
    with pytest.raises(StorageError):
        load_exact(tmp_path / "absent.json")


@given(st.binary(max_size=200), st.sampled_from(["gn-matrix", "vlnce"]))
@ROOM_FOR_TIME
def test_noise_is_refused_in_our_words(tmp_path: Path, noise: bytes, format: str) -> None:
    path = tmp_path / "noise"
    head = b"PAR1" if format == "gn-matrix" else b"\x1f\x8b\x08\x00"
    for data in (noise, head + noise, head + noise + b"PAR1"):
        path.write_bytes(data)
        with pytest.raises(Gn0Error):
            load_set(path, format)


@given(st.data())
@ROOM_FOR_TIME
def test_a_mutated_split_is_read_or_refused(tmp_path: Path, data: st.DataObject) -> None:
    document = json.loads(
        json.dumps(ExporterVlnce().build(goals(2), {"plan": GRID}, "x").native.document)
    )
    record = document["episodes"][data.draw(st.integers(0, 1))]
    record[data.draw(st.sampled_from(sorted(record)))] = data.draw(values)
    save_exact(tmp_path / "m.json", document)
    try:
        read = load_set(tmp_path / "m.json")
    except Gn0Error:
        return
    for task in read.tasks:
        try:
            place_task(task, ExporterVlnce().placements(GRID)[0], AgentSpec())
        except Gn0Error:
            continue


def test_a_wrong_format_lists_the_known_ones(tmp_path: Path) -> None:
    (tmp_path / "x.txt").write_text("hello")
    with pytest.raises(FormatError, match="no known episode format") as error:
        load_set(tmp_path / "x.txt")
    assert "gn-matrix-json" in str(error.value) and "VLN-CE" in str(error.value)
    with pytest.raises(ConfigError, match="known: gn-matrix"):
        load_set(tmp_path / "x.txt", "rxr")
    assert isinstance(GRID, OccupancyGrid)
