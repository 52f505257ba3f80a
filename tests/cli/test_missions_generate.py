"""`gn0 missions generate` as one types it: what is given wins, what is wrong is named."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from gn0.cli.main import main
from gn0.cli.missions_generate import Args, read_options, read_settings
from gn0.cli.missions_show import tell_legend
from gn0.errors import ConfigError
from gn0.missions.episode import Episode, MissionFollow, MissionGoal
from gn0.missions.generate.settings import MissionSettings
from gn0.people.person import EpisodePerson
from gn0.scenes.folder import save_scene
from gn0.testing.scenes import build_room_scene

pytestmark = pytest.mark.usefixtures("workers_here")


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("home") / "flat"
    save_scene(build_room_scene(), folder)
    return folder


def args(**given) -> Args:
    return Args(scenes=("x",), out="y", **given)


def test_nothing_given_means_the_defaults() -> None:
    assert read_settings(args()) == MissionSettings()


def test_what_is_given_wins_over_the_spec(tmp_path: Path) -> None:
    spec = tmp_path / "measures.yaml"
    spec.write_text("per_scene: 9\nlights: 4\nsimilarity: {frechet: 0.4, goal_radius: 0.5}\n")
    read = read_settings(
        args(spec=str(spec), per_scene=3, frechet=0.2, missions="goal", styles="benchmark")
    )
    assert (read.per_scene, read.lights, read.missions) == (3, 4, ("goal",))
    assert (read.similarity.frechet, read.similarity.goal_radius) == (0.2, 0.5)
    assert read.styles == ("benchmark",)


@pytest.mark.parametrize(
    ("given", "flag"),
    [
        ({"per_scene": 0}, "--per-scene"),
        ({"minimum_length": -1.0}, "--minimum-length"),
        ({"missions": "goal,fly"}, "--types, --missions"),
        ({"missions": "follow", "people": 2}, "--people"),  # they would be in no mission
        ({"missions": "goal", "people_seed": 2}, "--people-seed"),
        ({"val_seen": 2.0}, "--val-seen"),
        ({"levels": "single"}, "--levels"),  # nobody is followed
        ({"judge": "pictures", "missions": "goal"}, "--judge"),
        ({"levels": "alone", "missions": "follow"}, "--levels"),
        ({"styles": "rhymed"}, "--styles"),
    ],
)
def test_a_value_out_of_range_is_named_by_its_flag(given: dict, flag: str) -> None:
    with pytest.raises(ConfigError) as caught:
        read_settings(args(**given))
    assert caught.value.where == flag
    choices = {"--types, --missions": "goal", "--styles": "benchmark"}
    assert choices.get(flag, "") in caught.value.remedy
    if given.get("levels") == "alone":
        assert caught.value.remedy == "choose of single, distractors, ambiguous"


def test_people_of_a_spec_who_would_be_in_no_mission_are_refused(tmp_path: Path) -> None:
    spec = tmp_path / "spec.yaml"
    spec.write_text("missions: [follow]\npeople: {count: 3}\n")
    with pytest.raises(ConfigError, match="bring their own people") as caught:
        read_settings(args(spec=str(spec)))
    assert caught.value.where == "people of the settings"
    spec.write_text("missions: [goal, follow]\npeople: {count: 3}\n")
    assert read_settings(args(spec=str(spec), people_seed=4)).people.seed == 4
    assert read_settings(args(missions="follow", people=0)).missions == ("follow",)


@pytest.mark.parametrize(
    ("people", "where"),
    [
        ("{bank: []}", "people.bank"),
        ("{bank: ['../../etc/x']}", "people.bank"),
        ("{bank: [p0001, p0001]}", "people.bank"),
        ("{bank_hash: zz}", "people.bank_hash"),
    ],
)
def test_a_bank_of_a_spec_that_names_nobody_is_refused(
    tmp_path: Path, people: str, where: str
) -> None:
    spec = tmp_path / "spec.yaml"
    spec.write_text(f"people: {people}\n")
    with pytest.raises(ConfigError) as caught:
        read_settings(args(spec=str(spec)))
    assert caught.value.where == where and caught.value.remedy


def test_settings_of_a_manifest_with_drawn_people_are_a_spec(tmp_path: Path) -> None:
    spec = tmp_path / "spec.yaml"
    spec.write_text("people: {count: 3}\n")
    settings = read_settings(args(spec=str(spec)))
    spec.write_bytes(msgspec.json.encode(settings))  # as request.settings stand there
    assert read_settings(args(spec=str(spec))) == settings


@pytest.mark.parametrize("more", [[], ["--overwrite"]])
def test_an_output_folder_that_is_a_file_is_named(home: Path, tmp_path: Path, capsys, more) -> None:
    out = tmp_path / "note.txt"
    out.write_text("mine")
    assert main(["missions", "generate", str(home), *more, "--out", str(out)]) == 2
    assert "is a file, not a folder" in capsys.readouterr().err and out.read_text() == "mine"


def test_options_are_numbers_where_they_are() -> None:
    assert read_options(["model=m-7", "retries=2", "temperature=0.5", "base_url=http://x/v1"]) == {
        "model": "m-7", "retries": 2, "temperature": 0.5, "base_url": "http://x/v1",
    }  # fmt: skip
    for wrong in ("model", "=x"):
        with pytest.raises(ConfigError, match="is not NAME=VALUE"):
            read_options([wrong])


def test_generate_show_and_compare(
    home: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "missions"
    command = ["missions", "generate", str(home), "--per-scene", "4", "--minimum-length", "2.5"]
    assert main([*command, "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert "4 of 4 paths in 1 scene, 12 episodes" in said and "candidates:" in said
    assert main([*command, "--seed", "1", "--out", str(out)]) == 2
    assert "differs in seed" in capsys.readouterr().err
    run = tmp_path / "run"
    play = ["bench", "run", str(out), "--policy", "oracle", "--no-report", "--out", str(run)]
    assert main(play) == 0
    capsys.readouterr()
    missions = ["--mission-a", "goal", "--mission-b", "instruction"]
    assert main(["bench", "compare", str(run), "--paired-by", "path", *missions]) == 0
    said = capsys.readouterr().out
    assert "4 pairs of paths" in said and "goal missions" in said
    assert main(["bench", "compare", str(run)]) == 2
    assert "--paired-by path" in capsys.readouterr().err
    picture = tmp_path / "coverage.png"
    assert main(["missions", "show", str(out), "--coverage", "--out", str(picture)]) == 0
    assert picture.stat().st_size > 1000
    capsys.readouterr()
    moving = tmp_path / "paths.gif"
    assert main(["missions", "show", str(out), "--out", str(moving)]) == 2
    assert "end it with .png or .jpg" in capsys.readouterr().err and not moving.exists()
    assert main(["missions", "show", str(out), "--out", str(tmp_path / "paths.jpg")]) == 0
    assert (tmp_path / "paths.jpg").read_bytes()[:2] == b"\xff\xd8"


def test_errors_name_what_to_do(home: Path, tmp_path: Path, capsys) -> None:
    for more, words in (
        (["--language", "parrot"], "no language provider 'parrot'"),
        (["--minimum-length", "90"], "not a single path was accepted"),
        (["--missions", "dance"], "--missions"),
        (["--types", "dance"], "choose of goal, instruction, follow"),
    ):
        out = str(tmp_path / "out")
        assert main(["missions", "generate", str(home), *more, "--out", out]) == 2
        error = capsys.readouterr().err
        assert words in error and "→" in error
    assert main(["missions", "generate", "--out", str(tmp_path / "out")]) == 2
    assert "no scene given" in capsys.readouterr().err


def test_a_legend_names_what_is_drawn() -> None:
    goal = Episode(
        id="a",
        scene_id="room",
        mission=MissionGoal(goal=(3.0, 0.0), object_id="", category="bed", instruction="Go."),
        start=(0.0, 0.0, 0.0),
        path=((0.0, 0.0), (3.0, 0.0)),
    )
    who = EpisodePerson(number=1, identity="drawn:0:3", path=((1.0, 0.0), (4.0, 0.0)))
    to_follow = MissionFollow(goal=(4.0, 0.0), instruction="Go.", human="drawn:0:3", person=1)
    crowd = msgspec.structs.replace(goal, people=(who,))
    follow = msgspec.structs.replace(crowd, mission=to_follow)
    more = msgspec.structs.replace(follow, people=(who, msgspec.structs.replace(who, number=2)))
    plain = "green: start, star: goal, red: not on free cells"
    assert tell_legend([goal]) == tell_legend([]) == plain
    assert tell_legend([crowd, goal]) == f"{plain}   ·   grey: people"
    assert tell_legend([follow]).endswith(
        "ends, red: not on free cells   ·   purple: the person to follow"
    )
    assert tell_legend([follow]).startswith("green: start, star: where the person")
    assert tell_legend([more, goal]) == (
        "green: start, star: goal, or where the person to follow ends, red: not on free cells"
        "   ·   purple: the person to follow, grey: other people"
    )
