"""What a checkpoint was shown and asked at one state, and what it said, for people to look at.

policy = PolicyBae("out/sft/policy")
for decision in walk_asked(policy, simulator, episode): ...
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

from gn0.data.answer_slots import ACTION
from gn0.data.codec import decode_waypoints
from gn0.data.expert_labels import LabelSettings, label_states
from gn0.errors import FormatError, PlanError, PolicyError
from gn0.geometry import F32, U8, Pose2D
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import Episode
from gn0.policies.bae.policy_bae import PolicyBae
from gn0.policies.bae.questions import Questions, find_place
from gn0.policies.bae.tokens import SPECIALS
from gn0.sim.policy import PolicyOfBatch
from gn0.sim.rollout import begin_episode
from gn0.sim.simulator import Simulator
from gn0.sim.state import Action, Observation

EXPERT = LabelSettings(variant="field", stop_distance=1.0)  # as on the card, where policies learn


@dataclass(frozen=True)
class Confidence:
    """How sure a checkpoint was of an answer, at temperature 1 among what makes a readable one.

    Attributes:
        first: probabilities of the first action, by code: STOP, FORWARD, LEFT, RIGHT.
        first_entropy: of them [nat].
        entropy: mean over all slots that are chosen [nat].
    """

    first: tuple[float, float, float, float]
    first_entropy: float
    entropy: float


@dataclass(frozen=True, eq=False)
class Decision:
    """A question and its answer.

    Attributes:
        step: steps of the episode before it.
        pose: where the agent stood.
        pictures: of the prompt, in its order: name and uint8 [H, W, 3].
        prompt: its text; pictures and special tokens by name.
        answer: what was said, likewise.
        actions: codes of all actions of the answer; None where it is unreadable.
        executed: how many of them are carried out before the next question.
        waypoints: float32 [K, 2] m in the agent's frame, its own place first; None where the
            answer has none, or is unreadable.
        confidence: None where nobody asked for it.
    """

    step: int
    pose: Pose2D
    pictures: tuple[tuple[str, U8], ...]
    prompt: str
    answer: str
    actions: tuple[int, ...] | None
    executed: int
    waypoints: F32 | None
    confidence: Confidence | None


@dataclass(frozen=True, eq=False)
class ExpertSaid:
    """What the expert would do at a state.

    Attributes:
        actions: its next ones, codes.
        waypoints: float32 [13, 2] m in the agent's frame, the agent's own place first.
        distance: to the goal on foot [m].
    """

    actions: tuple[int, ...]
    waypoints: F32
    distance: float


@dataclass(frozen=True, eq=False)
class StepAsked:
    """A step of a walk.

    Attributes:
        decision: the question that it was taken from, asked at this step or before.
        asked: whether it was asked at this step.
        before: what the agent saw.
        pose: where it stood.
        action: what it did.
        after: where that led.
        collided: whether an obstacle cut it short.
        over: whether the episode ended with it.
    """

    decision: Decision
    asked: bool
    before: Observation
    pose: Pose2D
    action: int
    after: Pose2D
    collided: bool
    over: bool


def walk_asked(
    policy: PolicyBae,
    simulator: Simulator,
    episode: Episode,
    *,
    weighed: bool = True,
    dark: bool = False,
) -> Iterator[StepAsked]:
    """Walk an episode as the benchmark does, telling what was asked at each step.

    Args:
        policy: who is asked, in its slot 0.
        simulator: carries the policy's sensors and its ego map.
        episode: the task.
        weighed: tell how sure it was, which costs a second decision.
        dark: show it black pictures: a control.

    Raises:
        PolicyError, EpisodeError: see `gn0.sim.rollout.run_episode`.
        ConfigError: the instruction is empty, or too long for the checkpoint.
    """
    alone = PolicyOfBatch(policy)
    seen = begin_episode(simulator, alone, episode)
    last = decision = None
    while True:
        shown = seen.darken() if dark else seen
        pose = simulator.pose
        action = Action(cast("Action", alone.act(shown)))  # it never moves otherwise
        said = policy.last_said(alone.slot)
        asked = said is not last
        if asked or decision is None:
            last = said
            decision = read_decision(policy, shown, pose, weighed=weighed, slot=alone.slot)
        result = simulator.step(action)
        over = result.terminated or result.truncated
        yield StepAsked(
            decision,
            asked,
            shown,
            pose,
            int(action),
            simulator.pose,
            result.collided,
            over,
        )
        if over:
            return
        seen = result.observation


def ask_at(
    policy: PolicyBae, simulator: Simulator, episode: Episode, pose: Pose2D, *, weighed: bool = True
) -> Decision:
    """Ask about a pose that nobody walked to: there is no past, so a mosaic is black.

    Raises:
        PolicyError: an obstacle is there.
        EpisodeError, ConfigError: see `walk_asked`.
    """
    navigation = simulator.navigation
    if not navigation.is_free(pose.x, pose.y):
        near = navigation.nearest_free(pose.x, pose.y)
        raise PolicyError(
            f"the agent cannot stand at ({pose.x:g}, {pose.y:g}) m",
            where=f"scene {simulator.scene.id!r}",
            remedy="choose another pose" if near is None else
            f"the nearest free place is {near[0]:.2f},{near[1]:.2f}",
        )  # fmt: skip
    alone = PolicyOfBatch(policy)
    begin_episode(simulator, alone, episode)
    seen = simulator.observe_at(pose)
    alone.act(seen)
    return read_decision(policy, seen, pose, weighed=weighed, slot=alone.slot)


def ask_expert(
    navigation: NavigationMap, episode: Episode, pose: Pose2D, settings: LabelSettings = EXPERT
) -> ExpertSaid | None:
    """What the expert would do at a pose; None where no way leads to the goal.

    Args:
        navigation: of the episode's scene and body.
        episode: whose goal it is.
        pose: where the agent stands.
        settings: which expert.
    """
    try:
        labels = label_states(navigation, episode, np.array([pose]), settings)
    except PlanError:
        return None
    field = navigation.geodesic(episode.destination)
    return ExpertSaid(
        tuple(int(code) for code in labels.actions6[0]),
        labels.waypoints[0],
        float(field.distance_at(pose.x, pose.y)),
    )


def read_decision(
    policy: PolicyBae, seen: Observation, pose: Pose2D, *, weighed: bool = True, slot: int = 0
) -> Decision:
    """The last question of a slot's episode, which was asked about `seen`.

    Raises:
        PolicyError: nothing was asked yet.
    """
    said, questions = policy.last_said(slot), policy.questions
    if said is None:
        raise PolicyError("nothing was asked yet", remedy="act first")
    pictures = questions.show(seen)
    actions = waypoints = None
    try:
        frame = questions.find_frame(seen)
        place = np.array([find_place(frame, pose)])
        codes, tokens = questions.slots.decode(said.answer[None], place)
    except FormatError:
        pass  # and what was said is told
    else:
        actions = tuple(int(code) for code in codes[0])
        if tokens is not None:
            waypoints = decode_waypoints(frame, tokens, np.array([pose], np.float64))[0]
    confidence = None
    if weighed:
        confidence = _weigh(policy, pictures, said.prompt, said.answer)
    return Decision(
        step=seen.step,
        pose=pose,
        pictures=tuple(zip(questions.settings.pictures, pictures, strict=True)),
        prompt=spell_tokens(questions, said.prompt),
        answer=spell_tokens(questions, said.answer),
        actions=actions,
        executed=policy.executed,
        waypoints=waypoints,
        confidence=confidence,
    )


def _weigh(
    policy: PolicyBae, pictures: list[NDArray[np.uint8]], prompt: NDArray[np.int64],
    answer: NDArray[np.int64],
) -> Confidence:  # fmt: skip
    weights = policy.weigh(pictures, prompt, answer)
    slots = policy.questions.slots
    at = int(np.flatnonzero(slots.kinds == ACTION)[0])
    order = slots.allowed(at).tolist()
    first = [float(weights[at][order.index(own)]) for own in slots.vocabulary.actions]
    entropies = {k: _entropy(one) for k, one in weights.items()}
    mean = float(np.mean(list(entropies.values())))
    stop, forward, left, right = first
    return Confidence((stop, forward, left, right), entropies[at], mean)


def _entropy(shares: NDArray[np.float64]) -> float:
    some = shares[shares > 0]
    return float(-(some * np.log(some)).sum())


def spell_tokens(questions: Questions, ids: NDArray[np.int64]) -> str:
    """Ids as text: special tokens by name, a picture's as one mark, and padding left out."""
    tokenizer, own = questions.tokenizer, questions.ids
    names = {tokenizer.find_id(name): name for name in SPECIALS}
    waiting = list(zip(questions.settings.pictures, questions.layout.sizes, strict=True))
    parts: list[str] = []
    plain: list[int] = []
    pictured = 0  # tokens of the picture that is being read
    for token in [*ids.tolist(), None]:
        if plain and (token is None or token in names):
            parts.append(tokenizer.decode(plain))
            plain = []
        if pictured and token != own.image:
            name, size = waiting.pop(0)
            parts.append(f"[{name}: {size.width} x {size.height} px, {pictured} tokens]")
            pictured = 0
        if token == own.image:
            pictured += 1
        elif token is not None and token != own.pad:
            if token in names:
                parts.append(names[token])
            else:
                plain.append(token)
    return "".join(parts)
