"""A dataset of states that a policy visits: built like any other, and summarised."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import msgspec
import numpy as np

from gn0.counted import counted
from gn0.data.build import build_dataset
from gn0.data.dagger import check_options
from gn0.data.dataset import Dataset
from gn0.data.settings import BuildSettings, DaggerSettings
from gn0.errors import ConfigError
from gn0.missions.follow_rules import FOLLOW
from gn0.paper import ACTIONS_AHEAD, SUCCESS_RADIUS
from gn0.plugins import SECRETS, get_plugin, import_plugins
from gn0.progress import Progress, no_progress
from gn0.sim.state import Action
from gn0.suites.run_files import digest_run
from gn0.suites.suite import Suite


class DaggerSummary(msgspec.Struct, frozen=True, kw_only=True):
    """What a collection holds.

    Attributes:
        episodes: that were driven.
        skipped: that could not be.
        states: visited and labelled.
        agreed: of them, where the policy said the first action of the label.
        collided: of them, where the action was cut short.
        wrong_stops: of them, where the policy said STOP and the label did not.
        missed_stops: of them, where the label said STOP and the policy did not.
        arrived: episodes whose last state is within the success distance and ended with STOP.
        demonstrated: whether the labels are what was done, not the expert's.
        following: of the states, those behind a person; STOP stands still there and ends nothing,
            so that the counts of STOP and of arrivals leave them out.
        followed: of them, those within the distance at which a step follows.
        following_episodes: of the episodes, those behind a person.
    """

    episodes: int
    skipped: int
    states: int
    agreed: int
    collided: int
    wrong_stops: int
    missed_stops: int
    arrived: int
    demonstrated: bool = False
    following: int = 0
    followed: int = 0
    following_episodes: int = 0


def build_dagger(
    suite: Suite,
    out: Path | str,
    settings: BuildSettings,
    *,
    workers: int = 1,
    executor: Literal["process", "ray"] = "process",
    ray_address: str = "",
    agents: int = 1,
    bank: Path | str | None = None,
    progress: Progress = no_progress,
) -> Dataset:
    """Collect a dataset with the policy of `settings.dagger`; see `build_dataset`.

    Episodes with people, and those to follow somebody, are driven one at a time for any `agents`.

    Raises:
        ConfigError: no policy is given, there is none of that name, or an option is a secret.
        PolicyError: the policy misbehaves.
        DataError, BenchError, StorageError: see `build_dataset`.
    """
    return build_dataset(
        suite,
        out,
        check_dagger(settings),
        workers=workers,
        executor=executor,
        ray_address=ray_address,
        agents=agents,
        bank=bank,
        progress=progress,
    )


def check_dagger(settings: BuildSettings) -> BuildSettings:
    """Settings whose policy is there, as `build_dataset` and `build_shard` take them.

    Raises:
        ConfigError: no policy is given, there is none of that name, or an option is a secret.
    """
    if settings.dagger is None:
        raise ConfigError("no policy to drive", remedy="give BuildSettings(dagger=…)")
    dagger = _pin_run(settings.dagger)
    check_options(dagger.options, SECRETS)
    import_plugins(dagger.plugins)
    get_plugin("policy", dagger.policy)
    return msgspec.structs.replace(settings, dagger=dagger)


def _pin_run(dagger: DaggerSettings) -> DaggerSettings:
    """The settings with the digest of a recorded run, so that another run is another dataset."""
    run = dagger.options.get("run")
    if dagger.policy != "recorded" or not run or "digest" in dagger.options:
        return dagger
    digest = digest_run(str(run))
    return msgspec.structs.replace(dagger, options={**dagger.options, "digest": digest})


def sum_up(dataset: Dataset) -> DaggerSummary:
    """What a collection holds, counted."""
    dagger = dataset.about.settings.dagger
    radius = dagger.success_radius if dagger is not None else SUCCESS_RADIUS
    kinds = ("states", "agreed", "collided", "wrong", "missed", "arrived", "following", "followed")
    counts = dict.fromkeys(kinds, 0)
    episodes = behind = 0
    for part in dataset.about.parts:
        for rows in dataset.part_rows(part):
            said = np.array([codes[0] for codes in rows.policy_actions], np.int8)
            label = rows.actions[:, 0]
            episodes += 1
            counts["states"] += len(rows)
            counts["agreed"] += int((said == label).sum())
            counts["collided"] += int(rows.collided.sum())
            if rows.person:
                behind += 1
                counts["following"] += len(rows)
                counts["followed"] += int((rows.distance <= FOLLOW.reach).sum())
                continue
            counts["wrong"] += int(((said == Action.STOP) & (label != Action.STOP)).sum())
            counts["missed"] += int(((said != Action.STOP) & (label == Action.STOP)).sum())
            ended = rows.executed[-1] == Action.STOP
            within = dataset.episode(rows.episode_id).success_within(radius)
            counts["arrived"] += bool(ended and rows.distance[-1] < within)
    return DaggerSummary(
        episodes=episodes,
        skipped=sum(len(part.skipped) for part in dataset.about.parts),
        states=counts["states"],
        agreed=counts["agreed"],
        collided=counts["collided"],
        wrong_stops=counts["wrong"],
        missed_stops=counts["missed"],
        arrived=counts["arrived"],
        demonstrated=bool(dagger is not None and dagger.demonstrate),
        following=counts["following"],
        followed=counts["followed"],
        following_episodes=behind,
    )


def describe_summary(summary: DaggerSummary) -> str:
    """A summary in a few lines of plain words."""
    states = max(summary.states, 1)
    to_goals = summary.episodes - summary.following_episodes
    if summary.demonstrated:
        lines = [
            f"{summary.states:,} states of {counted(summary.episodes, 'walk')}, each labelled with "
            f"the next {ACTIONS_AHEAD} actions and 3 m of the walk itself",
            f"{summary.arrived} of {to_goals} walks ended at the goal; an obstacle cut "
            f"{summary.collided / states:.1%} of the steps short",
        ]
    else:
        lines = _describe_collected(summary, states)
    if summary.following:
        lines.append(
            f"behind a person: {counted(summary.following_episodes, 'episode')}; in "
            f"{summary.followed / summary.following:.1%} of their {summary.following:,} states it "
            f"was within {FOLLOW.reach:g} m"
        )
    if summary.skipped:
        lines.append(
            f"could not be driven: {counted(summary.skipped, 'episode')}, see dataset.json"
        )
    return "\n".join(lines)


def _describe_collected(summary: DaggerSummary, states: int) -> list[str]:
    lines = [
        f"{summary.states:,} states of {counted(summary.episodes, 'episode')}, each labelled "
        f"with {ACTIONS_AHEAD} actions and the next 3 m",
        f"the policy said what the expert would do in {summary.agreed / states:.1%} of them, "
        f"was cut short by an obstacle in {summary.collided / states:.1%}",
    ]
    to_goals = summary.episodes - summary.following_episodes
    if to_goals or not summary.episodes:
        lines.append(
            f"it said STOP too early in {summary.wrong_stops} states and missed it in "
            f"{summary.missed_stops}; {summary.arrived} of {to_goals} episodes ended at the goal"
        )
    return lines
