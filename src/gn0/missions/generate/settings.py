"""Which missions are generated, and with which numbers."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal

import msgspec

from gn0.config import Config
from gn0.errors import ConfigError, FormatError
from gn0.missions.generate.follow_settings import FollowSettings
from gn0.missions.similarity import SimilaritySettings
from gn0.people.settings import PeopleSettings
from gn0.yaml_file import load_yaml

Positive = Annotated[float, msgspec.Meta(gt=0, le=10_000)]
NotNegative = Annotated[float, msgspec.Meta(ge=0, le=10_000)]
Count = Annotated[int, msgspec.Meta(ge=1, le=1_000_000)]

GoalKinds = Literal["objects", "rooms", "both", "categories"]
StartMode = Literal["auto", "zones", "far", "uniform"]
Planner = Literal["any-angle", "astar"]
PictureKind = Literal["mixed", "view", "crop"]
MissionKind = Literal["goal", "instruction", "follow"]
RouteStyle = Literal["detailed", "benchmark"]
Phrasings = Literal["by_split", "known", "held_out"]


class MissionSettings(Config, frozen=True):
    """Counts and measures of one generation (paper, Alg. 1 to 3).

    Attributes:
        per_scene: paths to accept per scene.
        missions: what is made of each path.
        styles: in which styles a path is told as a route instruction, an episode each.
        goals: what one is sent to: objects, rooms, both; or categories, of which any object will do
            (object search). In a scene with none of these, unnamed places.
        categories: those that are searched for; all of each scene when empty.
        reach: an object's standing cell lies this near its footprint [m].
        safety_margin: obstacles grow by this beyond the agent's radius [m].
        smallest_component: connected regions of less safe ground hold no goal [m²].
        starts: how starts are drawn: against the density of earlier paths over square zones, far
            from earlier starts, evenly, or (auto) the first of these that has something to go by.
        zone: side of a zone [m].
        planner: exact any-angle paths, or A* over cells made straight by lines of sight.
        minimum_length: refuse shorter paths [m].
        maximum_length: refuse longer paths [m].
        minimum_displacement: refuse paths that end nearer to where they began [m].
        similarity: when two paths are the same task.
        keypoint_tolerance: largest distance of the path from its keypoints' polyline [m].
        keypoint_spacing: longest gap between keypoints [m].
        attempts: candidates tried for each path asked for, before a scene counts as used up.
        goal_picture: what the pictures of goals show: the view on arrival, the target cut out, or
            the one or the other.
        lights: conditions of light drawn for each scene, of which each path gets one; 0 leaves
            scenes as they were made.
        val_seen: share of the paths held out as split val_seen, in training scenes that a corpus
            has chosen for it, and in all training scenes outside a corpus.
        language: who writes the texts.
        phrasings: turns of phrase of the grammar: those kept for unseen splits in these and the
            others elsewhere, or the same everywhere. Paths are the same with any.
        people: who else is in the episodes; the missions of one path share them. Nobody when unset.
        follow: which people are followed, and how; as by default when not there.
    """

    per_scene: Count = 50
    missions: tuple[MissionKind, ...] = ("goal", "instruction")
    styles: tuple[RouteStyle, ...] = ("detailed", "benchmark")
    goals: GoalKinds = "both"
    categories: tuple[str, ...] | msgspec.UnsetType = msgspec.UNSET
    reach: Positive = 1.5
    safety_margin: NotNegative = 0.05
    smallest_component: NotNegative = 1.0
    starts: StartMode = "zones"
    zone: Positive = 1.0
    planner: Planner = "any-angle"
    minimum_length: NotNegative = 3.0
    maximum_length: Positive = 200.0
    minimum_displacement: NotNegative = 1.0
    similarity: SimilaritySettings = SimilaritySettings()
    keypoint_tolerance: Positive = 0.10
    keypoint_spacing: Positive = 2.0
    attempts: Count = 40
    goal_picture: PictureKind = "mixed"
    lights: Annotated[int, msgspec.Meta(ge=0, le=10_000)] = 0
    val_seen: Annotated[float, msgspec.Meta(ge=0, le=1)] = 0.1
    language: str = "template"
    phrasings: Phrasings = "by_split"
    people: PeopleSettings | msgspec.UnsetType = msgspec.UNSET
    follow: FollowSettings | msgspec.UnsetType = msgspec.UNSET

    @property
    def following(self) -> FollowSettings:
        """Numbers of follow missions."""
        return self.follow or FollowSettings()

    def __post_init__(self) -> None:
        if not self.missions or len(set(self.missions)) != len(self.missions):
            raise ConfigError("no missions, or one named twice", remedy="goal, instruction, follow")
        if "instruction" in self.missions and not self.styles:
            raise ConfigError("instruction missions without a style", remedy="detailed, benchmark")
        if self.goals == "categories" and "instruction" in self.missions:
            raise ConfigError(
                "a route leads to one object, and a search to any of a category",
                where="--goals categories",
                remedy="--missions goal",
            )
        if self.categories and self.goals != "categories":
            raise ConfigError(
                "categories are named, but not searched for",
                where="--categories",
                remedy="--goals categories",
            )
        if len(set(self.styles)) != len(self.styles):
            raise ConfigError("a style is named twice", remedy="name each once")
        if self.minimum_length > self.maximum_length:
            raise ConfigError(
                f"minimum length {self.minimum_length:g} m is more than maximum length "
                f"{self.maximum_length:g} m",
                remedy="give a minimum below the maximum",
            )
        s = self.similarity
        if not all(0 <= v < math.inf for v in (s.start_radius, s.goal_radius, s.frechet)):
            raise ConfigError(
                f"start radius {s.start_radius}, goal radius {s.goal_radius}, "
                f"Fréchet distance {s.frechet} m",
                remedy="give lengths of 0 m or more",
            )
        if not 2 <= self.similarity.samples <= 1000:
            raise ConfigError(
                f"paths of {self.similarity.samples} points", remedy="compare 2 to 1000 points"
            )


def load_settings(path: Path | str) -> MissionSettings:
    """Read settings, YAML or JSON; what is not given has its default.

    Raises:
        StorageError: missing, unreadable or too large.
        FormatError: not YAML, or a field is unknown or of the wrong type.
        ConfigError: the settings contradict themselves.
    """
    plain = load_yaml(path, remedy="see docs: missions")
    crowd = plain.get("people") if isinstance(plain, dict) else None
    # settings of a manifest say of drawn people that bank and bank_hash are empty
    if isinstance(crowd, dict) and crowd.get("bank") == [] and "bank_hash" not in crowd:
        raise ConfigError(
            "names nobody", where="people.bank",
            remedy="name people of a bank, or leave it out to have people drawn",
        )  # fmt: skip
    try:
        return msgspec.convert({} if plain is None else plain, MissionSettings)
    except msgspec.ValidationError as error:
        text = " ".join(str(error).split())
        raise FormatError(
            f"not settings of missions: {text:.200}", file=path, remedy="see docs: missions"
        ) from None
