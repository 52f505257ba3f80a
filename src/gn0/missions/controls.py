"""Controls: what is taken away from a policy to see what it goes by, its words or its pictures.

The benchmark and examinations in training share these. A text is chosen by seed, scene and episode
alone, so agents, workers and order change nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, cast, get_args

import msgspec
import numpy as np
from numpy.typing import NDArray

from gn0.errors import ConfigError
from gn0.missions.episode import Episode
from gn0.seeds import random_stream

Control = Literal["none", "no_words", "shuffled", "no_pictures"]
CONTROLS: tuple[Control, ...] = get_args(Control)
CONTROL_TEXT = "go"  # what the control without words is told
CONTROL_WORDS: dict[Control, str] = {
    "none": "nothing is taken away",
    "no_words": f"no words: every text is “{CONTROL_TEXT}”",
    "shuffled": "shuffled: every text is another episode's of the same scene, with other words and "
    "another goal where there is such a one (seed 0)",
    "no_pictures": "no pictures: whatever is a picture is black, depth and goal picture included; "
    "ranges, pose and bumper are as ever",
}


def check_control(name: str) -> Control:
    """The control of that name.

    Raises:
        ConfigError: there is none.
    """
    if name not in CONTROLS:
        raise ConfigError(
            f"no control {name!r}", where="control", remedy=f"known: {', '.join(CONTROLS)}"
        )
    return cast(Control, name)


def choose_texts(episodes: Sequence[Episode], control: Control, seed: int = 0) -> NDArray[np.int64]:
    """Which text each episode is told, int64 [E]; E itself stands for `CONTROL_TEXT`.

    Shuffled, each text is another episode's of the same scene: with other words and another goal
    where there is one, else with other words. Where all words of a scene are alike they stay.
    """
    own = np.arange(len(episodes))
    if control == "no_words":
        return np.full(len(episodes), len(episodes))
    if control != "shuffled":
        return own
    by_scene: dict[str, list[int]] = {}
    for number, episode in enumerate(episodes):
        by_scene.setdefault(episode.scene_id, []).append(number)
    for scene, numbers in by_scene.items():
        for number in numbers:
            here = episodes[number]
            unlike = [n for n in numbers if episodes[n].instruction != here.instruction]
            apart = [n for n in unlike if not _share_goal(here, episodes[n])] or unlike
            if apart:
                stream = random_stream(seed, "shuffled texts", scene, here.id)
                own[number] = apart[int(stream.integers(len(apart)))]
    return own


def replace_texts(
    episodes: Sequence[Episode], control: Control, seed: int = 0
) -> tuple[Episode, ...]:
    """The episodes with the texts that a control tells; starts, goals and seeds stay."""
    texts = [*(episode.instruction for episode in episodes), CONTROL_TEXT]
    chosen = choose_texts(episodes, control, seed).tolist()
    return tuple(
        msgspec.structs.replace(
            episode, mission=msgspec.structs.replace(episode.mission, instruction=texts[number])
        )
        for episode, number in zip(episodes, chosen, strict=True)
    )


def _share_goal(a: Episode, b: Episode) -> bool:
    """Whether a place that counts for one counts for the other."""
    same_set = a.goal_set is not None and a.goal_set == b.goal_set
    return same_set or not set(a.goals).isdisjoint(b.goals)
