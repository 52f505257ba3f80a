"""A corpus is its spec: the same scenes, splits and bytes, however it was made."""

from __future__ import annotations

import os
from collections import Counter
from dataclasses import replace
from pathlib import Path

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gn0.errors import ConfigError, FormatError, SceneError, StorageError
from gn0.scenes import corpus_build
from gn0.scenes.corpus import CorpusPart, CorpusSpec, load_corpus, load_spec, plan_corpus
from gn0.scenes.corpus_build import JOURNAL_FILE, generate_corpus
from gn0.scenes.folder import load_scene, save_scene
from gn0.scenes.procedural.forms import list_forms
from gn0.scenes.procedural.generate import GenerateSettings
from gn0.scenes.scene import Scene
from gn0.testing.scenes import build_room_scene


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("source") / "room"
    save_scene(build_room_scene(), folder)
    return folder


def spec_of(source: Path, count: int = 3) -> CorpusSpec:
    """`count` copies of one small scene: what is tested here is the corpus, not its scenes."""
    parts = tuple(CorpusPart(path=str(source), name=f"room-{i}") for i in range(count))
    return CorpusSpec(parts=parts, name="rooms", splits={"train": 0.6, "test": 0.4})


def contents(folder: Path) -> dict[str, bytes]:
    files = (p for p in sorted(folder.rglob("*")) if p.is_file() and p.name != JOURNAL_FILE)
    return {str(p.relative_to(folder)): p.read_bytes() for p in files}


@pytest.fixture(scope="module")
def whole(source: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("whole") / "corpus"
    generate_corpus(spec_of(source), out)
    return out


def test_scenes_lie_where_the_corpus_says(whole: Path) -> None:
    corpus = load_corpus(whole)
    assert [s.id for s in corpus.scenes] == ["room-0", "room-1", "room-2"]
    assert Counter(s.split for s in corpus.scenes) == {"train": 2, "test": 1}
    for about in corpus.scenes:
        scene = load_scene(whole / about.folder)
        assert (scene.id, scene.content_hash) == (about.id, about.hash)
        assert about.gaussians == len(scene.gaussians) and about.area > 1


def test_two_workers_and_a_second_start_write_the_same_bytes(source: Path, whole: Path) -> None:
    out = whole.parent / "stopped"
    part = CorpusSpec(parts=spec_of(source).parts, name="rooms", splits={"train": 0.6, "test": 0.4})
    generate_corpus(part, out, workers=2)
    assert contents(out) == contents(whole)
    # as if killed while the second scene was being written
    lines = (out / JOURNAL_FILE).read_bytes().splitlines(keepends=True)
    (out / JOURNAL_FILE).write_bytes(b"".join(lines[:2]) + lines[2][:9])
    (out / "corpus.json").unlink()
    kept = out / "scenes" / lines[1].decode().split('"scene": "')[1].split('"')[0]
    before = os.stat(kept / "scene.json").st_mtime_ns
    generate_corpus(part, out)
    assert contents(out) == contents(whole)
    assert os.stat(kept / "scene.json").st_mtime_ns == before  # not made again


def test_a_kill_after_any_write_loses_nothing(source: Path, cut_after_writes) -> None:
    def make(out: Path) -> None:
        generate_corpus(spec_of(source, 2), out)

    whole, cuts = cut_after_writes(make)
    assert len(cuts) > 10
    for left in cuts:
        make(left)
        assert contents(left) == contents(whole), left


def test_another_corpus_or_something_else_is_not_written_into(source: Path, whole: Path) -> None:
    with pytest.raises(ConfigError, match="holds another corpus"):
        generate_corpus(spec_of(source, 2), whole)
    other = whole.parent / "other"
    other.mkdir()
    (other / "thesis.tex").write_text("")
    with pytest.raises(StorageError, match="holds something else"):
        generate_corpus(spec_of(source), other)


def test_a_scene_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    spec = CorpusSpec(parts=(CorpusPart(path=str(tmp_path / "nowhere.ply")),))
    with pytest.raises((StorageError, SceneError), match=r"nowhere\.ply"):
        generate_corpus(spec, tmp_path / "out")
    assert not (tmp_path / "out" / "corpus.json").exists()


@pytest.mark.parametrize("workers", [1, 2])
def test_all_scenes_are_made_but_those_that_cannot_be(
    source: Path, whole: Path, tmp_path: Path, workers: int
) -> None:
    broken = [tmp_path / "one.ply", tmp_path / "two.ply"]
    for path in broken:
        path.write_bytes(b"ply\nformat ascii 1.0\n")
    bad = tuple(CorpusPart(path=str(path), name=path.stem) for path in broken)
    good = spec_of(source)
    spec = msgspec.structs.replace(good, parts=(bad[0], *good.parts, bad[1]))
    out = tmp_path / "out"
    with pytest.raises(FormatError, match="2 of 5 scenes cannot be made: one, two") as error:
        generate_corpus(spec, out, workers=workers)
    assert "all others are made" in error.value.remedy
    assert error.value.remedy.endswith("; fetch the file again")
    assert not (out / "corpus.json").exists()
    about = generate_corpus(spec, out, workers=workers, skip_failed=True)
    assert about.left_out == ("one", "two") and load_corpus(out) == about
    assert [scene.id for scene in about.scenes] == ["room-0", "room-1", "room-2"]
    assert contents(out / "scenes") == contents(whole / "scenes")


def test_nothing_but_failures_is_no_corpus(tmp_path: Path) -> None:
    (tmp_path / "one.ply").write_bytes(b"ply\n")
    spec = CorpusSpec(parts=(CorpusPart(path=str(tmp_path / "one.ply")),))
    with pytest.raises(FormatError) as error:
        generate_corpus(spec, tmp_path / "out", skip_failed=True)
    assert "others" not in error.value.remedy and not (tmp_path / "out" / "corpus.json").exists()


@given(st.lists(st.integers(1, 12), min_size=1, max_size=4), st.integers(0, 10**6))
@settings(deadline=None, max_examples=40)
def test_splits_are_dealt_by_their_shares_and_kinds(counts: list[int], seed: int) -> None:
    parts = tuple(CorpusPart(kind="apartment", count=n, name=f"k{i}") for i, n in enumerate(counts))
    spec = CorpusSpec(parts=parts, seed=seed)
    plan = plan_corpus(spec)
    total = sum(counts)
    found = Counter(scene.split for scene, _, _ in plan)
    assert sum(found.values()) == total == len({scene.id for scene, _, _ in plan})
    for name, share in spec.splits.items():
        assert abs(found[name] - share * total) < 1
    assert all(scene.split == "train" for scene, _, _ in plan if scene.val_seen)
    assert plan == plan_corpus(spec)
    assert len({seed for _, _, seed in plan}) == total


def test_a_fixed_split_is_kept() -> None:
    parts = (
        CorpusPart(kind="apartment", count=4),
        CorpusPart(kind="apartment", count=2, name="held", split="test"),
    )
    plan = plan_corpus(CorpusSpec(parts=parts, splits={"train": 1.0}))
    assert {s.id for s, _, _ in plan if s.split == "test"} == {"held-001", "held-002"}


@pytest.mark.parametrize(
    ("text", "error", "said"),
    [
        ("parts: [", FormatError, "not valid YAML"),
        ("parts: []", FormatError, "length >= 1"),
        ("{parts: [{kind: castle}]}", ConfigError, "no kind of building 'castle'"),
        ("{parts: [{kind: apartment, path: x}]}", ConfigError, "part 1.*not both"),
        ("{parts: [{path: x, count: 2}]}", ConfigError, "an import is one scene"),
        ("{parts: [{kind: apartment, colour: red}]}", FormatError, "colour"),
        ("{parts: [{kind: apartment}], splits: {train: 0.5}}", ConfigError, "sum to 0.5"),
        ("!!python/object/apply:os.system ['true']", FormatError, "not of a plain value"),
    ],
)
def test_a_bad_spec_is_told(tmp_path: Path, text: str, error: type[Exception], said: str) -> None:
    (tmp_path / "spec.yaml").write_text(text)
    with pytest.raises(error, match=said):
        load_spec(tmp_path / "spec.yaml")


def test_two_imports_of_one_name_are_told() -> None:
    parts = (CorpusPart(path="a/house"), CorpusPart(path="b/house"))
    with pytest.raises(ConfigError, match="two scenes are called 'house'"):
        plan_corpus(CorpusSpec(parts=parts))


@pytest.mark.slow
@pytest.mark.timeout(120)  # it took hours
def test_a_hundred_thousand_scenes_are_planned_while_one_waits() -> None:
    parts = tuple(CorpusPart(kind=kind, count=50_000) for kind in ("apartment", "office"))
    plan = plan_corpus(CorpusSpec(parts=parts, splits={"train": 0.7, "test": 0.3}))
    assert Counter(scene.split for scene, _, _ in plan) == {"train": 70_000, "test": 30_000}


def test_kinds_with_most_scenes_give_first_and_of_equals_the_first_by_name() -> None:
    """As the largest kind, looked for anew for each scene, would be dealt."""
    imports = tuple(CorpusPart(path=f"im-{n}.ply") for n in range(30))
    parts = (CorpusPart(kind="office", count=9), CorpusPart(kind="apartment", count=7), *imports)
    plan = plan_corpus(CorpusSpec(parts=parts, splits={"train": 0.75, "test": 0.25}))
    dealt = Counter(scene.source for scene, _, _ in plan if scene.split == "test")
    assert dealt == {"office": 7, "apartment": 5}


HELD_OUT = """
parts:
  - {kind: apartment, count: 30, size: small}
  - {kind: residence, count: 10, size: small, split: val_unseen}
splits: {train: 0.8, val_unseen: 0.2}
held_out: {styles: [classic, dark modern], variants: 0.25}
"""


def test_held_out_styles_are_those_of_unseen_scenes_and_of_no_others(tmp_path: Path) -> None:
    (tmp_path / "spec.yaml").write_text(HELD_OUT)
    spec = load_spec(tmp_path / "spec.yaml")
    styles: dict[str, Counter[str]] = {"train": Counter(), "val_unseen": Counter()}
    for scene, _, _ in plan_corpus(spec):
        styles[scene.split][scene.style] += 1
    assert set(styles["train"]) == {"scandinavian", "warm wood", "colourful"}
    assert set(styles["val_unseen"]) == {"classic", "dark modern"}
    assert plan_corpus(spec) == plan_corpus(spec)
    free = plan_corpus(CorpusSpec(parts=spec.parts, splits=spec.splits))
    assert {scene.style for scene, _, _ in free} == {""}, "a scene's own seed decides"
    assert [s for _, _, s in free] == [s for _, _, s in plan_corpus(spec)], "the same buildings"


def test_only_scenes_for_training_go_without_variants(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: dict[str, GenerateSettings] = {}
    room = build_room_scene()

    def note(settings: GenerateSettings, folder: Path, **_: object) -> Scene:
        asked[folder.name] = settings
        return save_scene(replace(room, id=folder.name), folder)

    monkeypatch.setattr(corpus_build, "generate_scene", note)
    (tmp_path / "spec.yaml").write_text(HELD_OUT.replace("30", "3").replace("10", "1"))
    corpus = generate_corpus(load_spec(tmp_path / "spec.yaml"), tmp_path / "corpus")
    assert len(corpus.without) >= 0.25 * len(list_forms())
    for scene in load_corpus(tmp_path / "corpus").scenes:
        settings = asked[scene.id]
        assert settings.style == scene.style
        assert settings.without == (corpus.without if scene.split == "train" else ())


@pytest.mark.parametrize(
    ("held_out", "said"),
    [
        ("{styles: [classic], variants: 0.9}", "variants"),
        ("{styles: [rococo]}", "rococo"),
        ("{styles: [warm wood]}", "is held out"),
        (
            "{styles: [scandinavian, warm wood, dark modern, colourful, classic]}",
            "is held out",
        ),
    ],
)
def test_what_cannot_be_held_out_is_told(tmp_path: Path, held_out: str, said: str) -> None:
    path = tmp_path / "spec.yaml"
    path.write_text(f"parts: [{{kind: apartment, style: warm wood}}]\nheld_out: {held_out}")
    with pytest.raises((ConfigError, FormatError), match=said):
        load_spec(path)
    path.write_text(path.read_text().replace(", style: warm wood", ""))
    if "scandinavian" in held_out:
        with pytest.raises(ConfigError, match="all styles are held out"):
            load_spec(path)
