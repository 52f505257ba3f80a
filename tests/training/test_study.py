"""Studies of synthetic walks whose truth is known: intervals cover it, verdicts follow them."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import time
import zipfile
from dataclasses import asdict, replace
from fnmatch import fnmatch
from pathlib import Path

import msgspec
import numpy as np
import pytest
from scipy import stats

import gn0
from gn0.bench.runner import run_suite
from gn0.cli.main import main
from gn0.errors import ConfigError, FormatError, TrainingError
from gn0.scenes.corpus import load_spec
from gn0.training.exams.walks import Walk
from gn0.training.exams.walks_folder import WalksAbout
from gn0.training.runs.run_folder import RunRecord, RunSession
from gn0.training.study.claims import find_difference, find_mean, judge_claim
from gn0.training.study.crossed_intervals import (
    Estimate,
    estimate_mean,
    estimate_seeds,
    smallest_effect,
)
from gn0.training.study.outcomes import Found
from gn0.training.study.study_file import Claim, Difference, Study, load_study
from gn0.training.study.study_page import _tell_basis, write_study

ROOT = Path(__file__).resolve().parent.parent.parent
STUDY = """
title: A study
sentence: Made up for a test.
exams:
  - {name: unseen, title: Held-out scenes, scenes: 10, episodes: 100}
  - {name: known, title: Known phrasings}
tables:
  - {name: maps, title: Maps}
figures:
  - {title: entropy, key: entropy}
  - {title: GPU minutes, key: card_seconds, factor: 0.016666667}
paper:
  - name: SFT
    line: 1062
    seen: [4.1, 6.5, 28.9, 26.1, 24.8]
    unseen: [4.1, 6.4, 32.9, 29.4, 28.1]
arms:
  - {name: sft, title: SFT, table: maps, seeds: [0, 1, 2], exams: [unseen, known],
     run: "runs/{arm}-{seed}", paper: SFT}
  - {name: dagger, title: SFT + DAgger, table: maps, seeds: [0, 1, 2], run: "runs/{arm}-{seed}"}
  - {name: straight, title: straight on, table: maps, trained: false}
  - {name: rl, title: RL, table: maps, seeds: [0, 1], command: gn0 train rl}
differences:
  - {a: dagger, b: sft}
  - {a: dagger, b: sft, missions: visible}
  - {a: dagger, b: straight}
  - {a: rl, b: dagger}
claims:
  - {text: DAgger helps, source: l. 1041, a: dagger, b: sft, above: 0}
  - {text: it helps by 60 points, a: dagger, b: sft, above: 60}
  - {text: RL helps, a: rl, b: dagger, above: 0}
  - {text: words that are known do not help, a: sft, b: sft, exam: known, exam_b: unseen, below: 5}
  - {text: DAgger raises entropy, a: dagger, b: sft, metric: entropy, above: 0}
"""  # fmt: skip


def _walk(scene: int, number: int, success: bool, exam: str = "unseen") -> Walk:
    kind = ("goal", "instruction/detailed")[number % 2]
    return Walk(
        episode=f"{exam}-{scene}-{number}",
        scene=f"s{scene}",
        path=f"path-{scene}-{number}",
        kind=kind,
        tier="visible from above" if number % 4 == 0 else "",
        steps=20,
        stopped=success,
        length=5.0,
        shortest=4.0,
        left=1.5 if success else 6.0,
        left_straight=1.2 if success else 5.0,
        least=1.5,
        success=success,
        success_straight=success,
        success_near=False,
        spl=0.8 * success,
        spl_straight=0.8 * success,
        spl_near=0.0,
        oracle=True,
        forwards=10,
        cut_short=1,
        decisions=7,
        seconds=0.1,
    )


def _save(folder: Path, walks: list[Walk], suite: str = "abc") -> None:
    folder.mkdir(parents=True)
    data = b"".join(msgspec.json.encode(walk) + b"\n" for walk in walks)
    (folder / "walks.jsonl").write_bytes(data)
    about = WalksAbout(
        suite="synthetic", suite_hash=suite, splits=(), episodes=len(walks), episodes_hash="",
        left_out=0, checkpoint="", weights="", control="none", executed=3, confirm_stop=False,
        agents=1, dtype="float32", device="cpu", version="0", finished=True,
        digest=hashlib.sha256(data).hexdigest(),
    )  # fmt: skip
    (folder / "walks.json").write_text(json.dumps(msgspec.to_builtins(about)))


def _report(folder: Path, entropy: float) -> None:
    folder.mkdir(parents=True)
    lines = [{"step": 1, "loss": 2.0}, {"step": 2, "entropy": entropy, "seconds": 60.0}]
    (folder / "metrics.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    session = RunSession(began="", command=[], device="card", versions={}, step=0, processes=4)
    record = RunRecord(stage="sft", recipe={}, hashes={}, sessions=[session])
    (folder / "run.json").write_text(json.dumps(msgspec.to_builtins(record)))


@pytest.fixture
def study(tmp_path: Path) -> Path:
    """Three seeds of SFT (right 40 % of the time) and DAgger (80 %), in ten scenes of ten."""
    rng = np.random.default_rng(0)
    cells = [(scene, number) for scene in range(10) for number in range(10)]
    for seed in range(3):
        for arm, rate, entropy in (("sft", 0.4, 0.1), ("dagger", 0.8, 0.3)):
            walks = [_walk(s, n, bool(rng.random() < rate)) for s, n in cells]
            _save(tmp_path / f"walks/{arm}-{seed}/unseen", walks)
            _report(tmp_path / f"runs/{arm}-{seed}", entropy + 0.01 * seed)
            if arm == "sft":
                known = [
                    _walk(s, n, w.success, "known") for (s, n), w in zip(cells, walks, strict=True)
                ]
                _save(tmp_path / f"walks/{arm}-{seed}/known", known, suite="def")
    _save(tmp_path / "walks/straight-0/unseen", [_walk(s, n, False) for s, n in cells])
    (tmp_path / "study.yaml").write_text(STUDY)
    return tmp_path


def _find(study: Path) -> Found:
    return Found(load_study(study / "study.yaml"), study, print)


def test_means_and_differences_are_those_of_the_walks(study: Path) -> None:
    found = _find(study)
    sft, dagger = found.study.arm("sft"), found.study.arm("dagger")

    def table(arm: str) -> np.ndarray:
        paths = [study / f"walks/{arm}-{seed}/unseen/walks.jsonl" for seed in range(3)]
        rows = [[json.loads(line) for line in path.read_text().splitlines()] for path in paths]
        return np.array([[one["success"] for one in row] for row in rows], float)

    mean = find_mean(found, sft, "unseen")
    assert mean is not None and mean.value == pytest.approx(100 * table("sft").mean())
    assert (mean.seeds, mean.scenes, mean.episodes, mean.unit) == (3, 10, 100, "scene")
    spl = find_mean(found, dagger, "unseen", "all", "SPL")
    assert spl is not None and spl.value == pytest.approx(80 * table("dagger").mean())
    goals = find_mean(found, dagger, "unseen", "goal")
    assert goals is not None and goals.value == pytest.approx(100 * table("dagger")[:, ::2].mean())
    routes = find_mean(found, dagger, "unseen", "instruction")
    assert routes is not None and routes.episodes == 50
    visible = find_difference(found, Difference(a="dagger", b="sft", missions="visible"))
    own = 100 * (table("dagger") - table("sft")).reshape(3, 10, 10)[:, :, ::4].mean()
    assert visible is not None and visible.value == pytest.approx(own)
    # what is not trained stands against every seed
    gain = find_difference(found, Difference(a="dagger", b="straight"))
    assert gain is not None and gain.seeds == 3
    assert gain.value == pytest.approx(100 * table("dagger").mean())


def test_no_share_is_told_to_be_more_than_all(study: Path) -> None:
    """One failure in a hundred walks: by its standard error the interval would reach past 100."""
    for seed in range(3):
        folder = study / f"walks/sft-{seed}/unseen"
        shutil.rmtree(folder)
        _save(folder, [_walk(s, n, (s, n) != (3, seed)) for s in range(10) for n in range(10)])
    found = _find(study)
    mean = find_mean(found, found.study.arm("sft"), "unseen")
    assert mean is not None and mean.value == pytest.approx(99)
    assert mean.low < 99 and mean.high == 100


def test_intervals_alone_decide_claims(study: Path, capsys: pytest.CaptureFixture[str]) -> None:
    verdicts = [judge_claim(_find(study), claim).verdict for claim in _find(study).study.claims]
    assert verdicts == ["held", "did not hold", "not run", "held", "held"]
    out = study / "page.md"
    assert main(["policy", "study", str(study / "study.yaml"), str(study), "--out", str(out)]) == 0
    assert "3 held, 1 did not hold, 1 not run" in capsys.readouterr().out
    page = out.read_text()
    assert page.startswith("# A study\n\n**Made up for a test.**\n")
    assert "*not run yet: `gn0 train rl`*" in page
    paper = next(line for line in page.splitlines() if "the paper: SFT (l. 1062)" in line)
    assert [cell.strip() for cell in paper.split("|") if "*" in cell][1:] == [
        "*32.9*", "*4.1*", "*6.4*", "*29.4*", "*28.1*"
    ]  # fmt: skip
    assert "* Held: DAgger helps; words that are known do not help; DAgger raises entropy." in page
    assert "Not run yet: `rl` − `dagger`." in page
    stages = page[page.index("## Stages of training") :]
    row = next(line for line in stages.splitlines() if "`sft`" in line)
    assert [cell.strip() for cell in row.split("|")][2:4] == ["0.11", "4"]  # a minute of four cards
    again = study / "again.md"
    write_study(study / "study.yaml", study, again)
    assert again.read_text() == page


def test_what_a_page_told_of_walks_that_are_gone_it_tells_again(study: Path) -> None:
    page, told = study / "page.md", list[str]()
    write_study(study / "study.yaml", study, page)
    whole = page.read_text()
    for gone in ("walks/dagger-0", "walks/dagger-1", "walks/sft-2", "runs/dagger-0"):
        shutil.rmtree(study / gone)
    judged = write_study(study / "study.yaml", study, page, onto=page, say=told.append)
    assert [one.verdict for one in judged][:3] == ["held", "did not hold", "not run"]
    # of runs' figures a row is of what is here, of one seed or more
    head, stages = whole.split("## Stages of training")
    assert page.read_text().startswith(head)
    assert f"of {page}, of more seeds than what is here" in told[0]
    for gone in ("walks", "runs"):
        shutil.rmtree(study / gone)
    page.write_text(whole)
    write_study(study / "study.yaml", study, page, onto=page, say=told.append)
    assert page.read_text() == head + "## Stages of training" + stages


def test_walks_of_as_many_seeds_stand_instead_of_what_a_page_told(study: Path) -> None:
    page = study / "page.md"
    write_study(study / "study.yaml", study, page)
    whole = page.read_text()
    was = next(line for line in whole.splitlines() if line.startswith("| SFT (`sft`) | 3 of 3"))
    page.write_text(whole.replace(was, re.sub(r"\d", "9", was).replace("9 of 9", "3 of 3")))
    assert page.read_text() != whole
    write_study(study / "study.yaml", study, page, onto=page)
    assert page.read_text() == whole
    about = study / "walks/sft-0/unseen/walks.json"
    finished = about.read_text()
    about.write_text(json.dumps(json.loads(finished) | {"finished": False}))
    write_study(study / "study.yaml", study, page, onto=page)  # of walks under way, none is kept
    assert "| SFT (`sft`) | 2 of 3" in page.read_text() and "| SFT (`sft`) | 3 of 3" in whole
    about.write_text(finished)
    page.write_text(whole.replace("**held**", "**nearly**", 1))
    shutil.rmtree(study / "walks/dagger-0")
    with pytest.raises(FormatError, match=r"no verdict: '\*\*nearly\*\*'"):
        write_study(study / "study.yaml", study, page, onto=page)


def test_a_claim_on_the_edge_is_too_close_to_tell(study: Path) -> None:
    found = _find(study)
    gain = find_difference(found, Difference(a="dagger", b="sft"))
    assert gain is not None
    for bound, above, below in (
        (gain.low - 0.1, "held", "did not hold"),
        (gain.low + 0.1, "too close to tell", "too close to tell"),
        (gain.high + 0.1, "did not hold", "held"),
    ):
        more = Claim(text="", a="dagger", b="sft", above=bound)
        assert judge_claim(found, more).verdict == above
        less = Claim(text="", a="dagger", b="sft", below=bound)
        assert judge_claim(found, less).verdict == below


def test_one_seed_says_nothing_of_entropy(study: Path) -> None:
    for arm in ("sft", "dagger"):
        for seed in (1, 2):
            (study / f"runs/{arm}-{seed}/metrics.jsonl").unlink()
    claim = _find(study).study.claims[-1]
    assert judge_claim(_find(study), claim).verdict == "too close to tell"
    assert estimate_seeds([1.0, 2.0, 4.0]).error == pytest.approx(stats.sem([1.0, 2.0, 4.0]))
    known = stats.t.interval(0.95, 2, loc=7 / 3, scale=stats.sem([1.0, 2.0, 4.0]))
    told = estimate_seeds([1.0, 2.0, 4.0])
    assert (told.low, told.high) == pytest.approx(known)


def test_runs_of_the_benchmark_stand_beside_walks(
    flats_suite, tmp_path: Path, worker_here: None
) -> None:
    """Kinds and tiers of their episodes are those that walks of the same exam know."""

    run_suite(flats_suite, "straight", tmp_path / "walks/straight-0/unseen")
    own = Found(load_study(_write(tmp_path)), tmp_path, print)
    walks = own.outcomes(own.study.arm("straight"), "unseen")[0].walks
    assert all(walk.forwards >= walk.cut_short for walk in walks.values())
    known = [replace(w, kind="goal", tier="visible from above", least=0.0, seconds=0.0)
             for w in walks.values()]  # fmt: skip
    _save(tmp_path / "walks/sft-0/unseen", known, suite=flats_suite.hash)
    found = Found(load_study(_write(tmp_path)), tmp_path, print)
    gain = find_difference(found, Difference(a="sft", b="straight", missions="visible"))
    assert gain is not None and (gain.value, gain.episodes) == (0.0, 12)
    assert gain.unit == "episode"  # of two scenes, episodes speak
    (tmp_path / "walks/straight-0/unseen/trajectories.jsonl").unlink()  # as `pack` leaves it behind
    write_study(tmp_path / "study.yaml", tmp_path, tmp_path / "page.md")
    row = next(
        line for line in (tmp_path / "page.md").read_text().splitlines() if "`straight`" in line
    )
    assert row.endswith("| – |")  # FORWARDs that nobody counted are not a share


def _write(folder: Path) -> Path:
    (folder / "study.yaml").write_text(STUDY)
    return folder / "study.yaml"


def test_walks_of_another_suite_and_unfinished_ones_are_told(study: Path) -> None:
    told: list[str] = []
    about = study / "walks/sft-2/unseen/walks.json"
    plain = json.loads(about.read_text())
    about.write_text(json.dumps(plain | {"finished": False}))
    found = Found(load_study(study / "study.yaml"), study, told.append)
    assert list(found.outcomes(found.study.arm("sft"), "unseen")) == [0, 1]
    assert len(told) == 1 and "not finished" in told[0]
    about.write_text(json.dumps(plain | {"suite_hash": "other"}))
    with pytest.raises(ConfigError, match="another suite"):
        write_study(study / "study.yaml", study, study / "page.md")
    about.write_text(json.dumps(plain | {"digest": "0" * 64}))
    with pytest.raises(TrainingError, match="not what the examination wrote"):
        write_study(study / "study.yaml", study, study / "page.md")
    assert not (study / "page.md").exists()


@pytest.mark.parametrize(
    "old, new, says",
    [
        ("title: A study", "titel: A study", "titel"),
        ("a: rl, b: dagger, above: 0", "a: rl, b: nobody, above: 0", "no arm 'nobody'"),
        ("above: 60", "above: 60, below: 3", "either `above` or `below`"),
        ("metric: entropy", "metric: mood", "no metric 'mood'"),
        ("name: rl, ", "name: sft, ", "two arms 'sft'"),
        ("exam_b: unseen", "exam_b: nowhere", "no exam 'nowhere'"),
        ("table: maps, trained", "table: views, trained", "no table 'views'"),
    ],
)
def test_a_study_that_makes_no_sense_is_refused(
    old: str, new: str, says: str, tmp_path: Path
) -> None:
    assert STUDY.count(old)
    (tmp_path / "study.yaml").write_text(STUDY.replace(old, new))
    with pytest.raises((ConfigError, FormatError), match=says):
        load_study(tmp_path / "study.yaml")


def test_flat_intervals_are_those_of_scipy() -> None:
    """One seed and scenes of one episode: the plain bootstrap, but for Student's t."""
    rng = np.random.default_rng(4)
    values = rng.gamma(0.5, 1.0, 400)  # skewed
    own = estimate_mean(values[None], [f"s{k:03}" for k in range(400)], resamples=20_000)
    theirs = stats.bootstrap(
        (values,), np.mean, n_resamples=20_000, method="percentile", rng=np.random.default_rng(1)
    ).confidence_interval
    assert own.value == pytest.approx(values.mean())
    assert own.error == pytest.approx(stats.sem(values))
    assert (own.low, own.high) == pytest.approx((theirs.low, theirs.high), abs=0.004)
    assert own.high - own.value > own.value - own.low  # skewed as the values are


def test_the_error_is_that_of_the_crossed_design() -> None:
    """Equal scenes: against a two-way analysis of variance, written out."""
    rng = np.random.default_rng(7)
    cells = rng.normal(0, 1, (4, 1, 1)) + rng.normal(0, 2, (1, 9, 1)) + rng.normal(0, 1, (4, 9, 5))
    scenes = [f"s{c}" for c in range(9) for _ in range(5)]
    own = estimate_mean(cells.reshape(4, -1), scenes)
    table = cells.mean(2)
    rows, columns, mean = table.mean(1), table.mean(0), table.mean()
    of_seeds = 9 * ((rows - mean) ** 2).sum() / 3
    of_scenes = 4 * ((columns - mean) ** 2).sum() / 8
    rest = ((table - rows[:, None] - columns + mean) ** 2).sum() / 24
    assert own.error == pytest.approx(np.sqrt((of_seeds + of_scenes - rest) / 36))
    # scenes of different sizes count by their episodes
    values, few = np.array([[1.0, 1, 1, 0, 0, 0, 0, 0]]), [*"aaabcdef"]
    assert estimate_mean(values, few).value == pytest.approx(3 / 8)


def test_the_same_values_have_the_same_interval_and_equal_policies_none() -> None:
    rng = np.random.default_rng(1)
    values, scenes = rng.random((3, 80)), [f"s{k // 8}" for k in range(80)]
    assert estimate_mean(values, scenes, name="x") == estimate_mean(values, scenes, name="x")
    nothing = estimate_mean(np.zeros((3, 80)), scenes)
    assert asdict(nothing) == asdict(
        Estimate(0.0, 0.0, 0.0, 0.0, seeds=3, scenes=10, episodes=80, unit="scene")
    )
    with pytest.raises(ConfigError, match="no mean"):
        estimate_mean(np.array([[np.nan, 1.0]]), ["a", "b"])


def test_a_basis_of_one_is_told_as_one() -> None:
    one = Estimate(0.0, 0.0, 0.0, 0.0, seeds=1, scenes=1, episodes=1, unit="scene")
    assert _tell_basis(one) == "1 seed, 1 scene, 1 episode"
    many = replace(one, seeds=3, scenes=10, episodes=2000, unit="episode")
    assert _tell_basis(many) == "3 seeds, 10 scenes, 2,000 episodes, these very scenes"


def test_the_smallest_effect_is_the_textbooks() -> None:
    # 2.8 standard errors of √(q (1 + (m − 1) ρ) / (C m))
    assert smallest_effect(100, 2000) == pytest.approx(
        2.8016 * (0.3 * 1.38 / 2000) ** 0.5, abs=1e-5
    )
    assert smallest_effect(2000, 2000) == pytest.approx(2.8016 * (0.3 / 2000) ** 0.5, abs=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize(
    "seeds, scenes, of_seeds, of_scenes",
    [(3, 40, 0.02, 0.1), (3, 40, 0.06, 0.1), (3, 100, 0.0, 0.0), (5, 40, 0.05, 0.05),
     (1, 40, 0.0, 0.1)],
)  # fmt: skip
def test_intervals_cover_the_truth(
    seeds: int, scenes: int, of_seeds: float, of_scenes: float
) -> None:
    """Of 400 studies of policies that succeed half of the time, some 95 % find so."""
    rng = np.random.default_rng(5)
    names = [f"s{c}" for c in range(scenes) for _ in range(20)]
    found = 0
    for study in range(400):
        rate = 0.5 + rng.normal(0, of_seeds, (seeds, 1, 1)) + rng.normal(0, of_scenes, (scenes, 1))
        walks = (rng.random((seeds, scenes, 20)) < rate).astype(float)
        own = estimate_mean(walks.reshape(seeds, -1), names, seed=study, resamples=1000)
        found += own.low <= 0.5 <= own.high
    # three standard errors below 95 %, less what Satterthwaite's t is short of
    assert 0.91 <= found / 400 <= 0.995


def test_the_study_of_the_repository_is_one() -> None:
    study = load_study(ROOT / "runs/ablation/study.yaml")
    assert isinstance(study, Study)
    assert all(arm.command for arm in study.arms)


def _pretend_python(folder: Path) -> Path:
    """FOLDER/python, which makes empty suites and nothing else; the file of what it was told."""
    told = folder / "told"
    (folder / "python").write_text(f"""#!/bin/bash
echo "$*" >> {told}
case "$3 $4" in missions*) mkdir -p "${{@: -1}}" && echo {{}} > "${{@: -1}}/manifest.json" ;; esac
""")
    (folder / "python").chmod(0o755)
    return told


def _plan(out: Path, **more: str) -> dict[str, str]:
    """Jobs of runs/ablation.sh by name, with the number of their cards."""
    told = subprocess.run(
        ["bash", str(ROOT / "runs/ablation.sh"), str(out), "full", "plan"],
        env={**os.environ, "GPUS": "0,1", **more}, capture_output=True, text=True, check=True,
    )  # fmt: skip
    lines = (line[10:].split() for line in told.stdout.splitlines()[1:])
    return {name: cards for name, cards, *_ in lines}


@pytest.mark.skipif(os.name != "posix", reason="needs bash")
def test_every_row_of_the_study_has_its_jobs(tmp_path: Path) -> None:
    """Commands name jobs that there are, and folders are those that the jobs write."""
    jobs = {seeds: _plan(tmp_path / "out", SEEDS=seeds) for seeds in ("0 1 2", "3")}
    study = load_study(ROOT / "runs/ablation/study.yaml")
    for arm in study.arms:
        pattern = arm.command.split("'")[1]
        named = jobs["3" if arm.command.startswith("SEEDS=3 ") else "0 1 2"]
        assert any(fnmatch(name, pattern) for name in named), arm.name
        for seed in arm.seeds:
            run = arm.folder(arm.run, seed).removeprefix("runs/")
            there = run in named or run in ("", "shipped")  # the last leg, whichever it is
            assert there, f"{arm.name}: no job makes {run}"


@pytest.mark.skipif(os.name != "posix", reason="needs bash")
def test_rounds_of_dagger_and_their_control_may_share_cards(tmp_path: Path) -> None:
    """As many for both, so that they are compared alike; other arms have one card as ever."""
    jobs = _plan(tmp_path / "out", ROUND_CARDS="2")
    for arm, cards in (("longer", "2"), ("dagger", "2"), ("dapo", "1"), ("live", "1")):
        assert jobs[f"all-{arm}-0"] == cards
    assert _plan(tmp_path / "out")["all-dagger-0"] == "1"


@pytest.mark.skipif(os.name != "posix", reason="needs bash")
def test_legs_of_the_chain_may_have_a_lot_and_a_length_of_their_own(tmp_path: Path) -> None:
    """The study's arms learn from lots a, b and c whatever a leg is given beside them."""
    out, told = tmp_path / "out", _pretend_python(tmp_path)

    def call(job: str, **more: str) -> str:
        """The command line of its training, done before or not."""
        told.write_text("")
        (out / "jobs" / f"{job}.done").unlink(missing_ok=True)
        subprocess.run(
            ["bash", str(ROOT / "runs/ablation.sh"), str(out), "full", job], capture_output=True,
            env={**os.environ, "PYTHON": str(tmp_path / "python"), "GPUS": "0", "LEG": "3",
                 "LEGS": "3", "FROM": "there", "LOT_D": "0 6 6", "LEG_MINUTES": "18",
                 "UNTIL": str(int(time.time()) + 600), **more}, check=True,
        )  # fmt: skip
        return next(line for line in told.read_text().splitlines() if " train " in line)

    leg, trunk = call("shipped-3"), call("maps-sft-0")
    suites = [f"{out}/suites/{lot}" for lot in "abcd"]
    assert " ".join(suites) in leg and "--joins 0,500000,3000000,3000000" in leg
    assert " ".join([*suites[:3], "--exam"]) in trunk and "--joins 0,500000,3000000 " in trunk
    assert 8 < float(leg.split("--minutes")[-1].split()[0]) <= 10
    assert trunk.split("--minutes")[-1].split()[0] == "9"
    assert (out / "runs/shipped").readlink() == Path("shipped-3")
    assert "--joins" not in call("shipped-3", JOINS="none")
    assert "--join-late" in call("shipped-3", JOIN_LATE="1") and "--join-late" not in leg
    assert "--join-late" not in call("maps-sft-0", JOIN_LATE="1")  # arms are the same anywhere
    assert "--join-late" not in call("shipped-3", JOIN_LATE="1", JOINS="none")
    assert "--join-late" not in call("shipped-3", JOIN_LATE="1", LEG_LOTS="a")
    assert "--inside 0.5" in call("shipped-3", INSIDE="0.5") and "--inside" not in leg
    assert "--joins 0,500000,3000000 " in call("maps-sft-0", JOINS="none")
    leg = call("shipped-3", LOT_D="", LOT_E="6 4 2 2 1 1 1 3 2", LEG_LOTS="a b e")
    assert " ".join(f"{out}/suites/{lot}" for lot in "abe") + " --live" in leg
    assert "--joins 0,500000,3000000 " in leg
    made = [line for line in told.read_text().splitlines() if " scene corpus " in line]
    assert ["--skip-failed" in line for line in made] == [True]  # of lot e; the others are there
    spec = (out / "specs/e.yaml").read_text()
    counts = re.findall(r"kind: (\w+), size: (\w+), count: (\d+)", spec)
    assert counts == [
        ("apartment", "small", "6"), ("apartment", "medium", "4"), ("residence", "small", "2"),
        ("apartment", "large", "2"), ("residence", "medium", "1"), ("office", "small", "1"),
        ("corridor", "small", "1"),
    ]  # fmt: skip
    opened = re.findall(r"kind: (\w+), size: (\w+), open_plan: true, count: (\d+)", spec)
    assert opened == [("apartment", "medium", "3"), ("residence", "small", "2")]
    assert sum(part.count for part in load_spec(out / "specs/e.yaml").parts) == 22
    for lot in "ae":
        shutil.rmtree(out / "suites" / lot)
    call("shipped-3", LOT_E="2 1 1", LEG_LOTS="a e", LOT_MARK="7")
    named = {
        lot: {part.name for part in load_spec(out / f"specs/{lot}.yaml").parts} for lot in "ae"
    }
    assert named["e"] == {"e7-flat", "e7-home", "e7-house"}  # other homes than those of "e-flat"
    assert named["a"] == {"a-flat", "a-home", "a-house"}


@pytest.mark.skipif(os.name != "posix", reason="needs bash")
def test_jobs_are_begun_in_the_order_that_they_are_named_in(tmp_path: Path) -> None:
    """Each behind what it is made from; under one pattern as the table has them."""
    out = tmp_path / "out"
    _pretend_python(tmp_path)
    _have_homes(out, "a", "b", "c", "exam")
    done = subprocess.run(
        ["bash", str(ROOT / "runs/ablation.sh"), str(out), "full", "maps-live-0.walks",
         "maps-dapo-0", "maps-[sl]*-0.drawn"],
        env={**os.environ, "PYTHON": str(tmp_path / "python"), "GPUS": "0"},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    began = re.findall(r"begin (maps-\S+)", done.stdout)
    assert began == [
        "maps-sft-0", "maps-live-0", "maps-live-0.walks", "maps-dapo-0", "maps-sft-0.drawn",
        "maps-longer-0", "maps-longer-0.drawn", "maps-live-0.drawn",
    ]  # fmt: skip


@pytest.mark.skipif(os.name != "posix", reason="needs bash")
@pytest.mark.parametrize(("mix", "asked"), [("maps:1", False), ("all:0.5,maps:0.5", True)])
def test_a_leg_of_one_input_is_asked_in_no_other_way(tmp_path: Path, mix, asked) -> None:
    out, told = tmp_path / "out", _pretend_python(tmp_path)
    _have_homes(out, "a", "b", "c", "exam")
    (out / "jobs" / "shipped-3.done").write_text("elsewhere")
    subprocess.run(
        ["bash", str(ROOT / "runs/ablation.sh"), str(out), "full", "shipped-maps.walks",
         "shipped-maps.controls"],
        env={**os.environ, "PYTHON": str(tmp_path / "python"), "GPUS": "0", "LEGS": "3",
             "MIX": mix}, capture_output=True, check=True,
    )  # fmt: skip
    walked = told.read_text().splitlines()
    assert len(walked) == 4 and all(("--inputs maps" in line) == asked for line in walked)
    controls = [line.split("--control")[1].split()[0] for line in walked[2:]]
    assert controls == ["no_words", "shuffled"]
    assert all(f"walks/shipped-maps-{one}/unseen" in line
               for one, line in zip(controls, walked[2:], strict=True))  # fmt: skip


@pytest.mark.skipif(os.name != "posix", reason="needs bash")
def test_a_baseline_reads_all_words_and_is_walked_as_any_policy(tmp_path: Path) -> None:
    """By the clock, as all jobs, and on the card."""
    out, told = tmp_path / "out", _pretend_python(tmp_path)
    _have_homes(out, "a", "b", "c", "exam")
    subprocess.run(
        ["bash", str(ROOT / "runs/ablation.sh"), str(out), "full", "cma_maps-0.walks"],
        env={**os.environ, "PYTHON": str(tmp_path / "python"), "GPUS": "0", "EPISODES": "64"},
        capture_output=True, check=True,
    )  # fmt: skip
    trained, walked = told.read_text().splitlines()
    assert "train baseline" in trained and "--pictures rgb,depth,near" in trained
    assert "--minutes 9 --agents 256 --steps 16" in trained and "--text-length" not in trained
    assert f"policy examine {out}/runs/cma_maps-0/policy {out}/suites/exam" in walked
    assert f"--out {out}/walks/cma_maps-0/unseen --episodes 64" in walked


@pytest.mark.skipif(os.name != "posix", reason="needs bash")
def test_a_leg_waits_for_the_first_lot_alone_wherever_the_leg_before_was_made(
    tmp_path: Path,
) -> None:
    """All other homes join while it learns; two jobs may have a card each."""
    told = subprocess.run(
        ["bash", str(ROOT / "runs/ablation.sh"), str(tmp_path / "out"), "full", "plan"],
        env={**os.environ, "GPUS": "0,1", "EACH": "1", "LEG": "2", "LEGS": "3", "FROM": "there"},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    rows = {line[10:].split()[0]: line[10:].split()[1:] for line in told.stdout.splitlines()[1:]}
    assert rows["shipped-2"] == ["1", "homes-a", "homes-exam"] and "shipped-1" not in rows
    assert rows["shipped-3"][:2] == ["1", "shipped-2"]
    assert rows["maps-sft-0"] == ["1", "homes-a"]


@pytest.mark.skipif(os.name != "posix", reason="needs bash")
def test_what_a_machine_lacks_comes_from_a_folder_of_wheels(tmp_path: Path) -> None:
    (tmp_path / "wheels").mkdir()
    with zipfile.ZipFile(tmp_path / "wheels/lacked-1-py3-none-any.whl", "w") as wheel:
        wheel.writestr("lacked.py", "")
    bare = tmp_path / "python"  # knows nothing that is installed, and finds what PYTHONPATH names
    bare.write_text(f'#!/bin/bash\nexec {sys.executable} -S "$@"\n')
    bare.chmod(0o755)
    script = f"""set -e
        OUT={tmp_path}/out PYTHON={bare} WHEELS={tmp_path}/wheels
        . {ROOT}/runs/offline.sh
        open_offline $OUT/site
        $PYTHON -c 'import lacked; from importlib.metadata import version; print(version("gn0"))'"""
    for _ in range(2):  # and again, with all of it there
        done = subprocess.run(["bash", "-c", script], capture_output=True, text=True)
        assert done.stdout.strip() == gn0.__version__, done.stderr


@pytest.mark.skipif(os.name != "posix", reason="needs bash")
def test_a_call_of_the_ablation_can_be_watched_and_has_its_folder_alone(tmp_path: Path) -> None:
    (tmp_path / "python").write_text('#!/bin/bash\necho "how far $3 is"\nexec sleep 60\n')
    (tmp_path / "python").chmod(0o755)
    command = ["bash", str(ROOT / "runs/ablation.sh"), str(tmp_path / "out"), "tiny"]
    env = {**os.environ, "PYTHON": str(tmp_path / "python"), "WALL": "0.02"}
    pipe = subprocess.PIPE
    with subprocess.Popen([*command, "homes-a"], env={**env, "WALL": "9"}, stdout=pipe) as works:
        assert works.stdout is not None
        assert b"begin homes-a" in works.stdout.readline()
        second = subprocess.run([*command, "homes-b"], env=env, capture_output=True, text=True)
        assert second.returncode == 2
        assert f"process {works.pid} works on these jobs" in second.stderr
        log = tmp_path / "out/log/homes-a"
        for _ in range(300):
            if log.is_file() and "how far" in log.read_text():
                break
            time.sleep(0.1)
        seen = subprocess.run([*command, "watch"], env=env, capture_output=True, text=True)
        assert re.search(r"^\S+ homes-a: how far scene is$", seen.stdout, re.MULTILINE)
        works.terminate()
        assert works.wait(30) == 130
    gone = subprocess.run([*command, "watch"], env=env, capture_output=True, text=True)
    assert gone.stdout.endswith("begin homes-a\n")


STAND_IN = """#!/bin/bash
[ "$1 $2" = "-m gn0" ] || exec {python} "$@"
echo "${{*:3}}" >> {folder}/log
for ((k = 3; k < $#; k++)); do [ "${{!k}}" != --out ] || next=$((k + 1)); done
out=${{!next}}
case "$3 $4" in
  "figures "*) mkdir -p "$out" && cp {folder}/figures.json "$out" ;;
  "missions generate") mkdir -p "$out" && echo "{{}}" > "$out/manifest.json" ;;
  "train dagger") mkdir -p "$out/policy" ;;
esac
"""  # for gn0: notes how it was called, and leaves what comes next looks for


@pytest.mark.skipif(os.name != "posix", reason="needs bash")
def test_a_leg_is_trained_at_the_quickest_speed_and_packed(tmp_path: Path) -> None:
    rates = {"blocks": 8300.0, "whole,narrow": 9100.0, "tuned,joined": 9900.0}
    rows = [{"detail": f"512 samples; --speed {name}", "value": r} for name, r in rates.items()]
    (tmp_path / "figures.json").write_text(json.dumps([{"rows": [{"detail": "", "value": 1}]},
                                                       {"rows": rows}]))  # fmt: skip
    python = tmp_path / "python"
    python.write_text(STAND_IN.format(python=sys.executable, folder=tmp_path))
    python.chmod(0o755)
    done = subprocess.run(
        ["bash", str(ROOT / "runs/leg.sh"), str(tmp_path / "out")], capture_output=True, text=True,
        env={**os.environ, "PYTHON": str(python), "SIZE": "tiny", "MIX": "maps:1",
             "BESIDE": "train.dapo train.rl"},
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    called = (tmp_path / "log").read_text().splitlines()
    trained = next(line for line in called if line.startswith("train dagger"))
    assert "--speed whole,narrow" in trained and "--inputs maps:1" in trained
    assert "--draw-after 6" in trained
    shown = [line.split()[1] for line in called if line.startswith("figures ")]
    assert shown == ["train.speed", "train.dapo", "train.rl"]
    made = [line for line in called if line.startswith("missions generate")]
    lots = [line.split()[2].rpartition("/")[2] for line in made]
    assert sorted(lots) == ["a", "b", "exam"]
    before = [line for line, lot in zip(made, lots, strict=True) if lot != "b"]  # it joins later
    assert called.index(trained) > max(map(called.index, before))
    pack = tmp_path / "out" / "pack"
    assert (pack / "policy").is_dir() and (pack / "figures/train.speed/figures.json").is_file()


@pytest.mark.skipif(os.name != "posix", reason="needs bash")
def test_a_leg_of_its_own_homes_begins_with_the_first_and_is_examined_at_its_end(
    tmp_path: Path,
) -> None:
    """Nothing waits for an exam; what is packed before it has the policy, and after it walks."""
    python, out = tmp_path / "python", tmp_path / "out"
    walked = """case "$3 $4" in "policy examine")
  [ -d {out}/pack/policy ] && mkdir -p "$out" && echo walk > "$out/walks.jsonl" ;;
"policy study") ls {out}/pack > {out}/packed_before 2> /dev/null ;;
esac
"""
    python.write_text(STAND_IN.format(python=sys.executable, folder=tmp_path)
                      + walked.format(out=out))  # fmt: skip
    python.chmod(0o755)
    env = {**os.environ, "PYTHON": str(python), "SIZE": "tiny", "FIGURE": "", "LEG": "2",
           "FROM": "there", "LOT_D": "2 0 0", "LOT_E": "1 1 0", "LEG_LOTS": "d e",
           "EXAMINED": "0", "IMPORTED": "house"}  # fmt: skip
    command = ["bash", str(ROOT / "runs/leg.sh"), str(out)]

    def call(**more: str) -> list[str]:
        (tmp_path / "log").write_text("")
        done = subprocess.run(command, env={**env, **more}, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr
        return (tmp_path / "log").read_text().splitlines()

    called = call()
    train = next(n for n, line in enumerate(called) if line.startswith("train dagger"))
    assert f"{out}/suites/d {out}/suites/e --live --start there --held-out  --text" in called[train]
    assert "--exam " not in called[train]
    made = [re.search(r"--out \S+/suites/(\w+)", line) for line in called]
    lots = {found[1]: n for n, found in enumerate(made) if found}
    assert lots.keys() == {"d", "e"} and lots["d"] < train
    assert not any(line.startswith(("figures", "policy examine")) for line in called)

    called = call(EXAMS_UNTIL=str(int(time.time()) + 600))  # the leg is there, and not run again
    assert not any(line.startswith("train") for line in called)
    asked = [line for line in called if line.startswith("policy examine")]
    ways = {(one.split("/walks/")[1].split()[0], "--control" in one) for one in asked}
    exams = {(f"shipped-{way}/{exam}", False) for way in ("all", "maps", "views")
             for exam in ("unseen", "seen", "known", "imported")}  # fmt: skip
    controls = {(f"shipped-{way}-{control}/unseen", True) for way in ("all", "maps", "views")
                for control in ("no_words", "shuffled")}  # fmt: skip
    assert ways == exams | controls
    assert "policy" in (out / "packed_before").read_text().split()  # while all is packed anew
    with tarfile.open(out / "pack/tables.tar.gz.aa") as tables:
        assert "./walks/shipped-maps/known/walks.jsonl" in tables.getnames()
    assert not any(line.startswith("policy examine")
                   for line in call(EXAMS_UNTIL=str(int(time.time()) - 1)))  # fmt: skip

    shutil.rmtree(out / "suites/imported")  # a house that could not be brought in stops no other
    for name in ("imported.done", *(f"shipped-{way}.walks.done" for way in ("all", "views"))):
        (out / "jobs" / name).unlink()
    python.write_text(
        python.read_text().replace("case", 'case "$3" in scene) exit 1 ;; esac\ncase', 1)
    )
    called = call(EXAMS_UNTIL=str(int(time.time()) + 600))
    asked = [line.split("/walks/")[1].split()[0] for line in called if "policy examine" in line]
    assert asked == [f"shipped-{way}/{exam}" for way in ("all", "views")
                     for exam in ("unseen", "seen")]  # fmt: skip


def _have_homes(out: Path, *lots: str) -> None:
    """Lots that were made before, and are there."""
    (out / "jobs").mkdir(parents=True)
    for lot in lots:
        (out / "jobs" / f"homes-{lot}.done").write_text("before")
        (out / "suites" / lot).mkdir(parents=True)
        (out / "suites" / lot / "manifest.json").write_text("{}")


@pytest.mark.skipif(os.name != "posix", reason="needs bash")
def test_jobs_of_the_ablation_are_done_once_and_fail_by_name(tmp_path: Path) -> None:
    """With a stand-in for gn0 that knows `policy study` as little as any other verb."""
    out = tmp_path / "out"
    (tmp_path / "python").write_text('#!/bin/bash\necho "gn0: no verb $3 $4" >&2\nexit 2\n')
    (tmp_path / "python").chmod(0o755)
    command = ["bash", str(ROOT / "runs/ablation.sh"), str(out), "tiny"]
    env = {**os.environ, "PYTHON": str(tmp_path / "python")}

    def call(*words: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run([*command, *words], env=env, capture_output=True, text=True)

    _have_homes(out, "a", "b", "exam")
    done = call("maps-dagger-0")
    assert done.returncode == 1
    assert "failed maps-sft-0: status 2" in done.stdout and "no verb train sft" in done.stdout
    assert "not begun maps-dagger-0" in done.stdout and "begin homes" not in done.stdout
    (out / "jobs" / "maps-sft-0.done").write_text("elsewhere")
    again = call("maps-dagger-0")
    assert "begin maps-sft-0" not in again.stdout and "no verb train dagger" in again.stdout
    plan = call("plan").stdout
    assert re.search(r"^done +maps-sft-0 ", plan, re.M)
    assert re.search(r"^failed +maps-dagger-0 ", plan, re.M)
    assert call("no-such-job").returncode == 2


@pytest.mark.skipif(os.name != "posix", reason="needs bash")
def test_a_job_that_is_killed_without_a_word_ends_no_other(tmp_path: Path) -> None:
    out = tmp_path / "out"
    (tmp_path / "python").write_text("""#!/bin/bash
case "$*" in *longer*) kill -9 $$ ;; *) sleep 2 ;; esac
""")
    (tmp_path / "python").chmod(0o755)
    _have_homes(out, "a", "b", "c", "exam")
    (out / "jobs" / "maps-sft-0.done").write_text("elsewhere")
    done = subprocess.run(
        ["bash", str(ROOT / "runs/ablation.sh"), str(out), "full", "maps-longer-0", "maps-dapo-0"],
        env={**os.environ, "PYTHON": str(tmp_path / "python"), "GPUS": "0,1"},
        capture_output=True, text=True,
    )  # fmt: skip
    assert "failed maps-longer-0: status 137" in done.stdout
    assert "done maps-dapo-0" in done.stdout and done.returncode == 1


def _is_alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


@pytest.mark.skipif(os.name != "posix", reason="needs bash")
def test_a_leg_that_is_ended_leaves_nothing_behind(tmp_path: Path) -> None:
    """Neither its figure nor a job of its chain, whose stand-ins would go on for a minute."""
    (tmp_path / "python").write_text(f"""#!/bin/bash
case "$*" in *metadata*) exit ;; -c*) echo 0 && exit ;; esac
echo $$ "$3" >> {tmp_path}/begun && exec sleep 60
""")
    (tmp_path / "python").chmod(0o755)
    leg = subprocess.Popen(
        ["bash", str(ROOT / "runs/leg.sh"), str(tmp_path / "out")],
        env={**os.environ, "PYTHON": str(tmp_path / "python"), "SIZE": "tiny"},
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True,
    )  # fmt: skip
    begun, until = tmp_path / "begun", time.monotonic() + 30
    while time.monotonic() < until and (
        not begun.exists() or len(begun.read_text().splitlines()) < 2
    ):
        time.sleep(0.05)
    lines = [line.split() for line in begun.read_text().splitlines()]
    assert {verb for _, verb in lines} == {"figures", "scene"}
    leg.terminate()
    assert leg.wait(timeout=30) == 130
    left, until = {int(process) for process, _ in lines}, time.monotonic() + 15
    while left and time.monotonic() < until:
        time.sleep(0.1)
        left = {process for process in left if _is_alive(process)}
    assert not left


@pytest.mark.skipif(os.name != "posix", reason="needs bash")
def test_a_job_alone_has_all_homes_that_join_and_nothing_that_is_done(tmp_path: Path) -> None:
    """A trunk waits for later lots; a leg that is there does not want those before it."""
    out, told = tmp_path / "out", _pretend_python(tmp_path)

    def call(job: str) -> list[str]:
        told.write_text("")
        subprocess.run(
            ["bash", str(ROOT / "runs/ablation.sh"), str(out), "tiny", job],
            env={**os.environ, "PYTHON": str(tmp_path / "python")}, capture_output=True, check=True,
        )  # fmt: skip
        return told.read_text().splitlines()

    called = call("maps-sft-0")
    made = [line.split()[-1].rpartition("/")[2] for line in called if "missions generate" in line]
    assert sorted(made) == ["a", "b", "exam"]
    assert sum("train sft" in line for line in called) == 1
    (out / "jobs" / "shipped-2.done").write_text("elsewhere")
    called = call("legs2.walks")
    assert [line.split()[2:4] for line in called] == [["policy", "examine"]] * 4


@pytest.mark.skipif(os.name != "posix", reason="needs bash")
def test_a_job_on_two_cards_is_started_once_by_torchrun(tmp_path: Path) -> None:
    """Behind `--`, so that no flag of ours is taken for one of torchrun's."""
    out, told = tmp_path / "out", tmp_path / "told"
    (tmp_path / "python").write_text(f'#!/bin/bash\necho "$CUDA_VISIBLE_DEVICES: $*" >> {told}\n')
    (tmp_path / "python").chmod(0o755)
    _have_homes(out, "a", "b", "c", "exam")
    subprocess.run(
        ["bash", str(ROOT / "runs/ablation.sh"), str(out), "full", "all-sft-0"],
        env={**os.environ, "PYTHON": str(tmp_path / "python"), "GPUS": "0,1"},
        capture_output=True, check=True,
    )  # fmt: skip
    (line,) = told.read_text().splitlines()
    assert line.startswith(
        "0,1: -m torch.distributed.run --standalone --nproc-per-node 2 -m -- gn0 "
    )
    assert f"train sft {out}/suites/a " in line


def test_the_page_says_what_was_not_run(tmp_path: Path) -> None:
    """While nothing has been run, the page is what the command makes of nothing."""
    page = (ROOT / "docs/ablation.md").read_text()
    write_study(ROOT / "runs/ablation/study.yaml", tmp_path, tmp_path / "page.md")
    if "none was run" in page:
        assert page == (tmp_path / "page.md").read_text()
    assert "17 M weights) from random weights on generated scenes" in page.split("\n")[2]


def test_the_page_is_what_the_command_makes_of_it(tmp_path: Path) -> None:
    """No row was changed, moved or left out by hand."""
    page = ROOT / "docs/ablation.md"
    write_study(ROOT / "runs/ablation/study.yaml", tmp_path, tmp_path / "page.md", onto=page)
    assert (tmp_path / "page.md").read_text() == page.read_text()


def _findings() -> tuple[str, str]:
    """What the page says so far, and all that stands below."""
    page = (ROOT / "docs/ablation.md").read_text()
    head, below = page.split("\n## How it is read\n")
    return head[head.index("### What it says so far") : head.index("In miniature, models")], below


def test_intervals_that_the_page_speaks_of_stand_in_its_rows() -> None:
    said, below = _findings()
    assert said in (ROOT / "runs/ablation/preface.md").read_text()
    number = r"([+−-]?\d+\.\d+)"
    wanted = re.findall(rf"{number}(?: %| points)? \({number} to {number}", said)
    assert len(wanted) >= 12
    for middle, low, high in wanted:
        a, b, c = (float(one.replace("−", "-")) for one in (middle, low, high))
        rows = (f"{a:.1f} [{b:.1f}, {c:.1f}]", f"{a:+.1f} [{b:+.1f}, {c:+.1f}]",
                f"{-a:+.1f} [{-c:+.1f}, {-b:+.1f}]")  # fmt: skip
        assert any(row in below for row in rows), (middle, low, high)


@pytest.mark.skipif(os.name != "posix", reason="needs bash")
def test_a_study_in_miniature_does_not_say_what_the_full_one_found(tmp_path: Path) -> None:
    done = subprocess.run(
        ["bash", str(ROOT / "runs/ablation.sh"), str(tmp_path / "out"), "tiny", "study"],
        env={**os.environ, "PYTHON": sys.executable}, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode in (0, 1), done.stderr
    page = (tmp_path / "out/ablation.md").read_text()
    assert "**In miniature: models of 2 M weights" in page
    assert "What it says so far" not in page and "Shortfalls" not in page
    assert "**One rule of evaluation**" in page and "\nIn miniature, models" in page
