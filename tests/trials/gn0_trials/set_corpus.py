"""Sound episode sets as seeds of the fuzzer, and what must hold of whatever is read."""

from __future__ import annotations

import gzip
import io
import json
from pathlib import Path

import pyarrow.parquet as pq

from gn0.errors import Gn0Error
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import AgentSpec, Episode
from gn0.missions.sets.episode_set import EpisodeSet, get_exporter, load_set, place_task
from gn0.testing.scenes import build_floor_plan, build_map_scene, build_point_episodes
from gn0_trials.fuzz import FuzzTarget

GRID = build_floor_plan(1, width=6.0, depth=4.5, clutter=4)


def _episodes() -> list[Episode]:
    scene = build_map_scene(GRID)
    return build_point_episodes(scene, NavigationMap(GRID), 2, seed=5)


def check_set(read: EpisodeSet) -> None:
    """What was read can be placed, or is refused in our own words."""
    placement = get_exporter(read.format).placements(GRID)[0]
    for task in read.tasks:
        assert task.id and isinstance(task.instruction, str)
        try:
            place_task(task, placement, AgentSpec())
        except Gn0Error:
            continue


def vlnce_target() -> FuzzTarget:
    """VLN-CE splits, plain JSON: the gzip layer is checksummed."""
    built = get_exporter("vlnce").build(_episodes(), {"plan": GRID}, "x").native.document
    for record in built["episodes"]:
        record["instruction"]["instruction_tokens"] = [1, 2, 0]
    text = json.dumps(built).encode()
    return FuzzTarget(
        "vlnce",
        lambda path: load_set(path, "vlnce"),
        {"plain": text, "gzip": gzip.compress(text, mtime=0)},
        check_set,
        tokens=(b'"episodes"', b"NaN", b"Infinity", b"null", b"[]", b"{}", b'"goals"', b"1e999"),
        suffix=".json",
    )


def gn_matrix_target() -> FuzzTarget:
    """GN-Matrix Parquet, uncompressed so that mutants reach the columns."""
    table = get_exporter("gn-matrix").build(_episodes(), {"plan": GRID}, "x").native
    corpus = {}
    for name, dictionary in (("plain", False), ("dictionary", True)):
        stream = io.BytesIO()
        pq.write_table(table, stream, compression="none", use_dictionary=dictionary)
        corpus[name] = stream.getvalue()
    return FuzzTarget(
        "gn-matrix",
        lambda path: load_set(path, "gn-matrix"),
        corpus,
        check_set,
        tokens=(b"PAR1", b"scene", b"ARROW:schema"),
        suffix=".parquet",
    )


def json_folder_target() -> FuzzTarget:
    """One trajectory of the older layout, in its folder."""
    exporter = get_exporter("gn-matrix-json")
    files = exporter.build(_episodes(), {"plan": GRID}, "x").native.files
    corpus = {name: json.dumps(content).encode() for (_, name), content in files.items()}

    def read(path: Path) -> EpisodeSet:
        home = path.with_name("tasks") / "plan"
        home.mkdir(parents=True, exist_ok=True)
        (home / "0.json").write_bytes(path.read_bytes())
        return exporter.load(home.parent)

    return FuzzTarget(
        "gn-matrix-json",
        read,
        corpus,
        check_set,
        tokens=(b'"path"', b"NaN", b"null", b"[]", b"{}", b'"heading_degrees"', b"1e999"),
        suffix=".json",
    )
