"""Records of people: what is refused, and how files hold them."""

from __future__ import annotations

import msgspec
import numpy as np
import pyarrow.parquet as pq
import pytest

from gn0.avatars.motion import standing
from gn0.avatars.motion.library import STAYING
from gn0.errors import ConfigError, EpisodeError, FormatError
from gn0.missions.episode import Episode, MissionGoal, check_episode
from gn0.missions.episode_files import episodes_digest_bytes, load_episodes, save_episodes
from gn0.missions.people import check_people_walls
from gn0.people.person import SEATS, EpisodePerson, PersonStop, check_people
from gn0.people.planning import blocked_at
from gn0.people.settings import PeopleSettings
from gn0.testing.scenes import build_room_scene

WAY = ((1.0, 1.0), (3.0, 1.0))


def person(**more: object) -> EpisodePerson:
    return EpisodePerson(**{"number": 1, "identity": "p0001", "path": WAY, **more})  # type: ignore[arg-type]


def episode(*people: EpisodePerson) -> Episode:
    goal = MissionGoal(goal=(2.0, 2.0), object_id="", category="chair", instruction="Go.")
    return Episode(
        id="e", scene_id="room", mission=goal, start=(5.0, 5.0, 0.0),
        path=((5.0, 5.0), (2.0, 2.0)), people=people,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("bad", "field"),
    [
        ({"number": 0}, "number"),
        ({"number": 17}, "number"),
        ({"identity": ""}, "identity"),
        ({"identity": "drawn:me"}, "identity"),
        ({"identity": "drawn:0:1:nose:3"}, "identity"),
        ({"clips": "ballet"}, "clips"),
        ({"behaviour": "dance"}, "behaviour"),
        ({"after": "fly"}, "after"),
        ({"speed": 0.2}, "speed"),
        ({"speed": float("nan")}, "speed"),
        ({"path": WAY[:1]}, "path"),
        ({"path": ((0.0, 0.0), (float("nan"), 1.0))}, "path"),
        ({"path": ((0.0, 0.0), (1e300, 1.0))}, "path"),
        ({"path": ((0.0, 0.0), (0.01, 0.0))}, "path"),
        ({"behaviour": "stand"}, "path"),
        ({"after": "loop"}, "path"),
        ({"stops": (PersonStop(at=1.0, seconds=-1.0),)}, "stop 1"),
        ({"stops": (PersonStop(at=1.0, seconds=1), PersonStop(at=0.5, seconds=1))}, "stop 2"),
        ({"stops": (PersonStop(at=9.0, seconds=1.0),)}, "stop 1"),
        ({"o_space": (0.0, 0.0, -1.0)}, "o_space"),
        ({"yaw": float("inf")}, "yaw"),
        ({"seat": 0.75}, "seat"),
        ({"seat": 0.25}, "seat"),
        ({"behaviour": "stand", "path": WAY[:1], "clip": "fly"}, "clip"),
        ({"behaviour": "stand", "path": WAY[:1], "clip": "run"}, "clip"),
        ({"behaviour": "sit", "path": WAY[:1], "clip": "wave"}, "clip"),
        ({"clip": "wave"}, "clip"),
    ],
)
def test_a_record_without_meaning_is_named_by_its_field(bad: dict, field: str) -> None:
    with pytest.raises(EpisodeError) as caught:
        person(**bad)
    assert field in caught.value.where and caught.value.remedy.startswith("give ")
    assert not caught.value.remedy.startswith(("give time", "give begin"))  # it is a sentence


def test_seats_and_clips_are_those_that_pictures_have() -> None:
    assert (min(SEATS), max(SEATS)) == standing.SEATS
    for clip in STAYING:
        assert person(behaviour="stand", path=WAY[:1], clip=clip).clip == clip
    assert person(behaviour="sit", path=WAY[:1], clip="sit", seat=SEATS[1]).seat == 0.65


@pytest.mark.parametrize(
    ("bad", "where"),
    [
        ({"count": 17}, "people.count"),
        ({"groups": 2.0}, "people.groups"),
        ({"seated": -0.1}, "people.seated"),
        ({"from_start": 0.2}, "people.from_start"),
        ({"speeds": (0.1, 1.0)}, "people.speeds"),
        ({"stops": 9}, "people.stops"),
        ({"bank": ("../../etc/x",)}, "people.bank"),
        ({"bank": ("",)}, "people.bank"),
        ({"bank": ("p0001", "p0000", "p0001")}, "people.bank"),
        ({"bank": ("p0001",), "bank_hash": "zz"}, "people.bank_hash"),
        ({"bank_hash": "0123456789abcdef" * 2}, "people.bank_hash"),
    ],
)
def test_settings_without_meaning_are_named_by_their_field(bad: dict, where: str) -> None:
    with pytest.raises(ConfigError) as caught:
        PeopleSettings(**bad)
    assert caught.value.where == where and caught.value.remedy


def test_people_of_a_bank_are_named_with_its_hash_or_without() -> None:
    names = ("p0000", "my-robot_2", "drawn:0:7")
    assert PeopleSettings(bank=names).bank == names
    assert PeopleSettings(bank=names, bank_hash="0123456789abcdef" * 2).bank_hash


def test_people_who_cannot_be_together() -> None:
    seventeen = [person(number=1 + k % 16, path=((k, 0), (k, 1))) for k in range(17)]
    with pytest.raises(EpisodeError, match="17 people"):
        check_people(seventeen)
    with pytest.raises(EpisodeError, match="number is that of two"):
        check_people([person(), person(path=((5, 5), (6, 6)))])
    with pytest.raises(EpisodeError, match="begins inside person 1"):
        check_people([person(), person(number=2, path=((1.2, 1.0), (6, 6)))])
    with pytest.raises(EpisodeError, match="on the agent's start") as caught:
        check_episode(episode(person(path=((5.1, 5.0), (6, 6)))))
    assert "episode 'e', person 1" in caught.value.where


def test_a_path_through_a_wall_is_told_with_the_place() -> None:
    scene = build_room_scene()
    x0, y0, x1, y1 = scene.grid.bounds
    through = person(path=((x0 - 1, y0 - 1), (x1 + 1, y1 + 1)))
    with pytest.raises(EpisodeError, match="to a wall"):
        check_people_walls([through], scene.grid, "episode 'e'")
    check_people_walls([person(path=((x0, y0),), behaviour="sit")], scene.grid)


def test_every_cell_that_a_path_touches_is_looked_at() -> None:
    scene = build_room_scene()
    stream = np.random.default_rng(0)
    x0, y0, x1, y1 = scene.grid.bounds
    from gn0.maps.navigation import NavigationMap

    near = NavigationMap(scene.grid, 0.30)
    for _ in range(60):
        a, b = stream.uniform((x0, y0), (x1, y1), (2, 2))
        dense = a + np.linspace(0, 1, 4001)[:, None] * (b - a)
        free = all(near.is_free(*place) for place in dense)
        if blocked_at(scene.grid, (tuple(a), tuple(b))) is None:
            assert free  # the rule may be stricter than the samples, never laxer


def test_files_hold_people_and_those_without_stay_as_they_were(tmp_path) -> None:
    grids = {"room": build_room_scene().grid}
    crowd = episode(
        person(stops=(PersonStop(at=1.0, seconds=2.5, look=30.0),), speed=0.7),
        person(number=2, identity="drawn:3:1", path=((2.0, 3.0),), behaviour="stand", yaw=1.0,
               o_space=(2.5, 3.0, 0.5)),
    )  # fmt: skip
    save_episodes(tmp_path / "crowd.parquet", [crowd], grids)
    assert load_episodes(tmp_path / "crowd.parquet") == [crowd]
    save_episodes(tmp_path / "alone.parquet", [episode()], grids)
    assert "people" not in pq.read_table(tmp_path / "alone.parquet").column_names
    alone = msgspec.json.decode(episodes_digest_bytes([episode()]))
    assert "people" not in alone[0]
    assert episodes_digest_bytes([crowd]) != episodes_digest_bytes([episode()])


@pytest.mark.parametrize(
    "text",
    ["nobody", "[1]", '[{"number": 1}]', '[{"number": 1, "identity": "p", "path": [], "age": 3}]'],
)
def test_a_column_that_is_no_list_of_people_names_file_and_row(tmp_path, text: str) -> None:
    grids = {"room": build_room_scene().grid}
    path = tmp_path / "bad.parquet"
    save_episodes(path, [episode(person())], grids)
    table = pq.read_table(path)
    column = table.schema.get_field_index("people")
    pq.write_table(table.set_column(column, table.schema.field(column), [[text]]), path)
    with pytest.raises((EpisodeError, FormatError)) as caught:
        load_episodes(path)
    assert "bad.parquet, row 1" in caught.value.where and "people" in caught.value.where
