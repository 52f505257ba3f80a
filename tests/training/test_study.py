"""Studies of synthetic walks whose truth is known: intervals cover it, verdicts follow them."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
from dataclasses import asdict, replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from scipy import stats

from gn0.bench.runner import run_suite
from gn0.cli.main import main
from gn0.errors import ConfigError, FormatError, TrainingError
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
