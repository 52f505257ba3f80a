"""Live DAgger plans on a device as if nobody were there: it refuses people, and says which way."""

from __future__ import annotations

import msgspec
import pytest

from gn0.errors import EpisodeError
from gn0.training.lessons_live import check_lessons
from gn0_trials.people_samples import crossed_episode, follow_episode, goal_episode


def test_episodes_with_people_are_refused_by_name() -> None:
    check_lessons([goal_episode("alone")])
    with pytest.raises(EpisodeError, match=r"1 people.*live DAgger.*data build and dagger") as one:
        check_lessons([goal_episode("alone"), crossed_episode()])
    assert one.value.where == "episode 'b-crossed'"
    untold = msgspec.structs.replace(follow_episode(), people=())
    with pytest.raises(EpisodeError, match=r"follows somebody.*gn0 data dagger"):
        check_lessons([untold])
