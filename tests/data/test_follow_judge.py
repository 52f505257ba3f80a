"""The judge of words by pictures, while follow missions are made."""

from __future__ import annotations

import msgspec
import pytest

from gn0.data import follow_judge
from gn0.data.follow_judge import REFUSED, SENTENCES, FollowJudge
from gn0.data.follow_missions import FollowMissions, make_follow_missions
from gn0.data.follow_reference import FollowTracker
from gn0.maps.navigation import NavigationMap
from gn0.missions.generate.follow_settings import FOLLOW_REASONS, FollowSettings
from gn0.missions.language.follow_words import FollowText
from gn0.missions.language.words_judge import Verdict, WordsVerdict
from gn0_trials.follow_hall import BODY, SETTINGS, build_hall, hall_paths

HALL = build_hall()
NAVIGATION = NavigationMap(HALL.grid, BODY.radius)
PATHS = hall_paths(HALL).records[:2]


def make(judge: str) -> FollowMissions:
    follow = FollowSettings(levels=("single",), attempts=2, judge=judge)  # type: ignore[arg-type]
    settings = msgspec.structs.replace(SETTINGS, follow=follow)
    return make_follow_missions(HALL, NAVIGATION, PATHS, settings, 0, agent=BODY)


def told(monkeypatch: pytest.MonkeyPatch, *verdicts: Verdict) -> list[str]:
    """Let a judge say these in turns, whatever the pictures; the sentences that it was shown."""
    heard: list[str] = []

    def judge(self: FollowJudge, episode: object, moments: object, text: FollowText) -> object:
        heard.append(text.text)
        return WordsVerdict(verdicts[(len(heard) - 1) % len(verdicts)], "as told", ())

    monkeypatch.setattr(FollowJudge, "moments", lambda *_: [object()])
    monkeypatch.setattr(FollowJudge, "judge", judge)
    return heard


def test_what_the_judge_refuses_is_written_anew_and_counted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    plain = make("none")
    heard = told(monkeypatch, "does not", "cannot tell", "fits")
    judged = make("pictures")
    assert not plain.refused and len(judged.missions) == len(plain.missions) > 0
    count = len(judged.missions)
    assert judged.refused == {REFUSED["does not"]: count, REFUSED["cannot tell"]: count}
    for k, (one, other) in enumerate(zip(plain.missions, judged.missions, strict=True)):
        assert one.text.text == heard[3 * k], "it begins with the words of a set without a judge"
        assert other.text.text == heard[3 * k + 2] == other.episode.instruction
        assert one.episode.people == other.episode.people and other.text.text in heard


def test_a_mission_whose_words_are_all_refused_falls(monkeypatch: pytest.MonkeyPatch) -> None:
    heard = told(monkeypatch, "cannot tell")
    judged = make("pictures")
    assert not judged.missions and judged.fell["not proven"] * SENTENCES == len(heard) > 0
    assert judged.refused == {REFUSED["cannot tell"]: len(heard)}
    assert "not proven" in FOLLOW_REASONS


@pytest.mark.slow
def test_pictures_speak_for_the_right_words_and_against_the_wrong_ones() -> None:
    mission = make("none").missions[0]
    tracker = FollowTracker(HALL, NAVIGATION, FollowSettings())
    judge = FollowJudge(HALL, NAVIGATION, tracker.sight(mission.episode))
    moments = judge.moments(mission.episode, tracker.replay(mission.episode))
    assert len(moments) == len(follow_judge._SECONDS)
    record = moments[0].people[0].record

    def say(colour: str) -> FollowText:
        return FollowText(
            text=f"Follow whoever wears {colour}.", said={"top_colour": colour}, doing="",
            decides="looks", skeleton=(),
        )  # fmt: skip

    own = record["top_colour"]
    other = next(c for c in ("green", "purple", "yellow") if c != own)
    assert judge.judge(mission.episode, moments, say(own)).verdict == "fits"
    assert judge.judge(mission.episode, moments, say(other)).verdict == "does not"
