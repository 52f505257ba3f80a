"""Scripts under runs/ beside stand-ins for what they call: order, cards, clocks, packs."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import time
import zipfile
from fnmatch import fnmatch
from pathlib import Path

import pytest

import gn0
from gn0.scenes.corpus import load_spec
from gn0.training.study.study_file import load_study

ROOT = Path(__file__).resolve().parent.parent.parent
pytestmark = pytest.mark.skipif(os.name != "posix", reason="needs bash")


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


def test_rounds_of_dagger_and_their_control_may_share_cards(tmp_path: Path) -> None:
    """As many for both, so that they are compared alike; other arms have one card as ever."""
    jobs = _plan(tmp_path / "out", ROUND_CARDS="2")
    for arm, cards in (("longer", "2"), ("dagger", "2"), ("dapo", "1"), ("live", "1")):
        assert jobs[f"all-{arm}-0"] == cards
    assert _plan(tmp_path / "out")["all-dagger-0"] == "1"


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


CELL = """
[ -z "${{CUDA_VISIBLE_DEVICES:-}}" ] || echo "$CUDA_VISIBLE_DEVICES $*" >> {folder}/cards
case "$*" in
  *" train "*) mkdir -p "${{@: -1}}/policy" ;;
  "-m gn0 policy examine"*) mkdir -p "$out" && echo walk > "$out/walks.jsonl" ;;
  "-m gn0 policy study"*) find {folder}/out/walks -name walks.jsonl >> {folder}/packed ;;
esac
"""


def test_a_cell_is_trained_by_the_clock_and_packed_whenever_a_job_ends(tmp_path: Path) -> None:
    """Trunk and DAgger have both cards, arms and walks one each; two jobs share a card."""
    python, out, bin_ = tmp_path / "python", tmp_path / "out", tmp_path / "bin"
    text = STAND_IN.replace('|| exec {python} "$@"', "|| :") + CELL
    python.write_text(text.format(python=sys.executable, folder=tmp_path))
    python.chmod(0o755)
    bin_.mkdir()
    (bin_ / "nvidia-smi").write_text("#!/bin/bash\nprintf '0\\n1\\n'\n")
    (bin_ / "nvidia-smi").chmod(0o755)
    now = int(time.time())
    done = subprocess.run(
        ["bash", str(ROOT / "runs/cell.sh"), str(out)], capture_output=True, text=True,
        env={**os.environ, "PYTHON": str(python), "PATH": f"{bin_}:{os.environ['PATH']}",
             "INPUT": "views", "SEED": "7", "ARMS": "longer dapo dagger", "MORE": "untrained",
             "PACK_EVERY": "0.1", "OPENING": "60", "TRUNK_UNTIL": str(now + 960),
             "ARMS_UNTIL": str(now + 1560), "EXAMS_UNTIL": str(now + 1800)},
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    called = [line.split() for line in (tmp_path / "cards").read_text().splitlines()]
    jobs = {line[-1].rpartition("/")[2]: line for line in called if "train" in line}
    assert list(jobs) == [f"views-{arm}-7" for arm in ("sft", "dagger", "longer", "dapo")]
    assert [jobs[name][0] for name in jobs] == ["0,1", "0,1", "0,1", "0"]

    def minutes(name: str) -> float:
        return float(jobs[name][jobs[name].index("--minutes") + 1])

    assert 14 < minutes("views-sft-7") <= 15 and 24 < minutes("views-dapo-7") <= 25
    assert "--minutes" not in jobs["views-dagger-7"]  # its epochs have every state once
    walked = sorted(
        str(file.parent.relative_to(out / "walks")) for file in out.rglob("walks.jsonl")
    )
    assert walked == [f"views-{arm}-7/{exam}" for arm in ("dagger", "dapo", "longer", "sft")
                      for exam in ("drawn", "seen", "unseen")]  # fmt: skip
    assert {line[0] for line in called if "examine" in line} == {"0", "1"}
    assert (out / "jobs/untrained.done").is_file() and (out / "pack/tables.tar.gz.aa").is_file()
    seen = (tmp_path / "packed").read_text().splitlines()
    assert len(seen) > len(set(seen)) == 12  # some were packed before the last
    assert not list((out / "jobs").glob("*.failed"))


def _rehearse_cell(folder: Path, after: str = "", **more: str) -> tuple[int, str]:
    """Code and words of a cell in miniature, whose stand-in for gn0 ends with `after`."""
    python = folder / "python"
    text = (STAND_IN.replace('|| exec {python} "$@"', "|| :") + CELL).format(
        python=sys.executable, folder=folder
    )
    python.write_text(text + after)
    python.chmod(0o755)
    done = subprocess.run(
        ["bash", str(ROOT / "runs/cell.sh"), str(folder / "out")], capture_output=True, text=True,
        env={**os.environ, "PYTHON": str(python), "SIZE": "tiny", "PACK_EVERY": "0.1", "GPUS": "",
             **more},
    )  # fmt: skip
    return done.returncode, done.stdout + done.stderr


def test_a_cell_without_a_clock_is_rehearsed_on_a_cpu(tmp_path: Path) -> None:
    code, said = _rehearse_cell(tmp_path)
    assert code == 0, said
    assert {one.name for one in (tmp_path / "out/walks").iterdir()} == {
        f"all-{arm}-0" for arm in ("sft", "dagger", "dapo", "dagger_dapo")
    }


def test_an_arm_that_fails_takes_no_other_with_it(tmp_path: Path) -> None:
    code, said = _rehearse_cell(tmp_path, '[ "$3 $4" != "train dapo" ] || exit 9\n')
    assert code == 1 and "failed all-dapo-0: status 9" in said
    assert (tmp_path / "out/pack/tables.tar.gz.aa").is_file()  # what there is
    assert (tmp_path / "out/jobs/all-dagger-0.walks.done").is_file()


@pytest.mark.parametrize(("does", "ends"), [("exit 9", "failed"), ("exec sleep 60", "cut")])
def test_a_cell_ends_with_its_trunk_where_that_is_not_done(tmp_path: Path, does, ends) -> None:
    """Arms would begin it again, with no clock; what there is is packed all the same."""
    _have_homes(tmp_path / "out", "a", "b", "exam")
    until = {"EXAMS_UNTIL": str(int(time.time()) + 3)} if ends == "cut" else {}
    code, said = _rehearse_cell(tmp_path, f'[ "$3 $4" != "train sft" ] || {does}\n', **until)
    assert code == (3 if ends == "cut" else 1) and f"{ends} all-sft-0" in said
    assert said.count("begin ") == 1
    assert (tmp_path / "out/pack/tables.tar.gz.aa").is_file()


def _have_homes(out: Path, *lots: str) -> None:
    """Lots that were made before, and are there."""
    (out / "jobs").mkdir(parents=True)
    for lot in lots:
        (out / "jobs" / f"homes-{lot}.done").write_text("before")
        (out / "suites" / lot).mkdir(parents=True)
        (out / "suites" / lot / "manifest.json").write_text("{}")


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


@pytest.mark.parametrize(
    ("script", "verbs"), [("leg.sh", {"figures", "scene"}), ("cell.sh", {"scene"})]
)
def test_a_script_that_is_ended_leaves_nothing_behind(tmp_path: Path, script, verbs) -> None:
    """Neither its figure nor a job of its chain, whose stand-ins would go on for a minute."""
    (tmp_path / "python").write_text(f"""#!/bin/bash
case "$*" in *metadata*) exit ;; -c*) echo 0 && exit ;; esac
echo $$ "$3" >> {tmp_path}/begun && exec sleep 60
""")
    (tmp_path / "python").chmod(0o755)
    leg = subprocess.Popen(
        ["bash", str(ROOT / "runs" / script), str(tmp_path / "out")],
        env={**os.environ, "PYTHON": str(tmp_path / "python"), "SIZE": "tiny"},
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True,
    )  # fmt: skip
    begun, until = tmp_path / "begun", time.monotonic() + 30
    while time.monotonic() < until and (
        not begun.exists() or len(begun.read_text().splitlines()) < len(verbs)
    ):
        time.sleep(0.05)
    lines = [line.split() for line in begun.read_text().splitlines()]
    assert {verb for _, verb in lines} == verbs
    leg.terminate()
    assert leg.wait(timeout=30) == 130
    left, until = {int(process) for process, _ in lines}, time.monotonic() + 15
    while left and time.monotonic() < until:
        time.sleep(0.1)
        left = {process for process in left if _is_alive(process)}
    assert not left


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


def test_trunks_pass_one_another_on_a_card_and_walks_go_on_beside_them(tmp_path: Path) -> None:
    """Of three places on a card a trunk has two, and yet is one process on one card."""
    out, told = tmp_path / "out", tmp_path / "told"
    (tmp_path / "python").write_text(f"""#!/bin/bash
name="$3 $4 $(basename "${{@: -1}}")"
echo "$CUDA_VISIBLE_DEVICES+ $name" >> {told}
heard() {{ for ((k = 0; k < 100; k++)); do grep -q "$1" {told} && return; sleep 0.1; done; }}
case "$name" in
  *" sft scenes_50-0") sleep 0.5 ;;
  *" sft unchanged-0") heard "0- policy examine" ;;  # who stands beside the other waits for it
  "policy examine "*) heard "0+ train sft unchanged" ;;
esac
echo "$CUDA_VISIBLE_DEVICES- $name" >> {told}
""")
    (tmp_path / "python").chmod(0o755)
    _have_homes(out, "a", "b", "c", "exam")
    jobs = [f"{name}-0{end}" for name in ("scenes_50", "unchanged") for end in ("", ".walks")]
    subprocess.run(
        ["bash", str(ROOT / "runs/ablation.sh"), str(out), "full", *jobs],
        env={**os.environ, "PYTHON": str(tmp_path / "python"), "GPUS": "0,0,0", "EACH": "2"},
        capture_output=True, check=True,
    )  # fmt: skip
    lines = told.read_text().splitlines()
    assert {line[:3] for line in lines} == {"0+ ", "0- "}
    trunks = [line for line in lines if "train sft" in line]
    assert trunks == [f"0{on} train sft {name}-0" for name in ("scenes_50", "unchanged")
                      for on in "+-"]  # fmt: skip
    walked = next(k for k, line in enumerate(lines) if line.startswith("0- policy examine"))
    assert lines.index(trunks[2]) < walked < lines.index(trunks[3])


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
