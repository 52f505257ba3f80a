"""Whose text an episode is told when words are shuffled or taken away."""

from __future__ import annotations

import msgspec

from gn0.missions.controls import choose_texts, replace_texts
from gn0.missions.episode import Episode, MissionGoal


def episode(name: str, text: str, goal: tuple[float, float], scene: str = "a") -> Episode:
    mission = MissionGoal(goal=goal, object_id="1", category="sofa", instruction=text)
    return Episode(id=name, scene_id=scene, mission=mission, start=(0, 0, 0), path=((0, 0), goal))


def test_shuffled_texts_are_of_the_same_scene_and_lead_elsewhere() -> None:
    some = [
        episode("0", "go to the sofa", (1, 1)),
        episode("1", "walk to the couch", (1, 1)),  # the same place in other words
        episode("2", "go to the bed", (5, 1)),
        episode("3", "go to the sofa", (9, 9)),
        episode("4", "go to the bath", (2, 2), scene="b"),
        episode("5", "find the tub", (2, 2), scene="b"),  # nothing else is there
        episode("6", "go out", (2, 2), scene="c"),  # alone
    ]
    for seed in range(20):
        own = choose_texts(some, "shuffled", seed).tolist()
        assert own == choose_texts(some, "shuffled", seed).tolist()
        assert own[0] == 2 and own[1] in (2, 3) and own[2] in (0, 1, 3) and own[3] in (1, 2)
        assert own[4:] == [5, 4, 6]
    assert {choose_texts(some, "shuffled", seed)[2] for seed in range(20)} == {0, 1, 3}


def test_only_texts_change() -> None:
    some = [episode("0", "go to the sofa", (1, 1)), episode("1", "go to the bed", (5, 1))]
    assert replace_texts(some, "none") == replace_texts(some, "no_pictures") == tuple(some)
    assert [e.instruction for e in replace_texts(some, "no_words")] == ["go", "go"]
    swapped = replace_texts(some, "shuffled")
    assert [e.instruction for e in swapped] == ["go to the bed", "go to the sofa"]
    for before, after in zip(some, swapped, strict=True):
        mission = msgspec.structs.replace(after.mission, instruction=before.instruction)
        assert msgspec.structs.replace(after, mission=mission) == before


def test_shuffled_texts_of_a_suite_are_unlike(flats_suite) -> None:
    episodes = list(flats_suite.episodes)
    for number, other in enumerate(choose_texts(episodes, "shuffled")):
        assert episodes[other].scene_id == episodes[number].scene_id
        assert episodes[other].instruction != episodes[number].instruction
    assert choose_texts(episodes, "none").tolist() == list(range(12))
    assert choose_texts(episodes, "no_words").tolist() == [12] * 12
