"""The page at which a person walks the episodes of a suite, and is scored like any policy.

It shows what the suite's track allows a policy to know and nothing else: the agent's view on the
whole canvas, the words of the task, and its maps where the track has maps. No splats are sent.
"""

from __future__ import annotations

import math
import time
from functools import partial
from typing import Any

import numpy as np
from PIL import Image

from gn0.bench.company_watch import FollowReferee
from gn0.bench.follow_metrics import FollowMetrics
from gn0.bench.report_follow import tell_end
from gn0.bench.results import EpisodeResult
from gn0.bench.walk_recording import WalkRecorder
from gn0.counted import counted
from gn0.errors import EpisodeError
from gn0.geometry import U8
from gn0.missions.episode import Episode, MissionFollow
from gn0.sim.presets import find_preset
from gn0.sim.simulator import Simulator
from gn0.sim.state import Action, Observation
from gn0.viewer.live import KEY_ACTIONS, PANEL, hear
from gn0.viewer.live_eyes import LiveEyes
from gn0.viewer.live_loop import LiveLoop
from gn0.viewer.live_map import AGENT
from gn0.viewer.live_server import LiveServer
from gn0.viewer.live_stage import LiveStage
from gn0.viewer.live_text import name_line, plain
from gn0.viewer.live_walk import WORDS

MAP_HEIGHT = 340  # px at most
RULES = (
    "Walk to what the task says, then press **Stop**: that ends the walk, and it is scored. "
    "*Begin again* takes you back to the start and is counted. On the occupancy map red is you, "
    "green is the start.\n\n"
    "**I** forward · **J** left · **L** right · **V** next map · **N** next episode"
)

RULES_PEOPLE = "People move only while you act: turn to and fro to let somebody pass."
RULES_FOLLOW = (
    "Follow whom the task says. **Wait** stands still for one action; people move only while you "
    "act. The walk ends by itself, and is scored: when the person has arrived, when you touched "
    "or lost somebody, or with the last step. *Begin again* takes you back to the start and is "
    "counted.\n\n"
    "**I** forward · **J** left · **L** right · **K** wait · **V** next map · **N** next episode"
)


class RecordView:
    """Episodes walked by hand.

    Args:
        live: the server.
        loop: the thread that does the work.
        recorder: where the walks go.
        first: id of the episode to begin with; "" for the first that was not walked.
    """

    def __init__(
        self, live: LiveServer, loop: LiveLoop, *, recorder: WalkRecorder, first: str = ""
    ) -> None:
        self.server, self.loop, self.recorder = live.viser, loop, recorder
        about = recorder.suite.about
        self.stage = LiveStage(live.viser)
        self.eyes = LiveEyes(
            live.viser, self.stage, find_preset(about.camera), about.agent.camera_height, beyond=0.0
        )
        self.maps: list[str] = [m for m in ("occupancy", "bev") if m in recorder.sensors]
        self.kind: str = self.maps[0] if self.maps else ""
        self.episode = self._find(first) or self._next_left() or recorder.episodes[0]
        self.actions: list[Action] = []
        self.attempts = 0
        self.walking = False
        self._began = 0.0
        self._simulator: Simulator | None = None
        self._seen: Observation | None = None
        self._bumps = 0
        self._obstacle = ""
        self._referee: FollowReferee | None = None
        self._follows = all(isinstance(e.mission, MissionFollow) for e in recorder.episodes)
        live.asks.append(lambda name: loop.post(partial(self._open_link, name), key="link"))

    def open(self) -> None:
        """The panel; the first episode comes with the first tick."""
        self._build_panel()
        self.server.on_client_connect(lambda client: self.loop.post(partial(self._greet, client)))

    def finish(self) -> None:
        """Begin the first episode, if that has not been done."""
        if self._simulator is None:
            self._begin(self.episode)

    def tick(self, now: float) -> float | None:
        """Begin the first episode."""
        self.finish()
        return None

    @property
    def ready(self) -> bool:
        """Whether an episode is on the page."""
        return self._simulator is not None

    def _greet(self, client: Any) -> None:
        key = f"size {client.client_id}"
        client.camera.on_update(lambda _: self.loop.post(partial(self._refit, client), key=key))
        self._look()

    def _refit(self, client: Any) -> None:
        if self.eyes.is_stale(client):
            self._look()

    def _build_panel(self) -> None:
        gui: Any = self.server.gui
        gui.configure_theme(
            show_logo=False, show_share_button=False, dark_mode=True, brand_color=AGENT
        )
        gui.main_panel.dock_right()
        gui.main_panel.set_width(PANEL)
        gui.add_markdown(f"### {plain(self.recorder.suite.name, 60)}")
        self._list = gui.add_dropdown("Episode", self._retitle())
        hear(self.loop, self._list.on_update, self._choose)
        self._task = gui.add_markdown("")
        self._status = gui.add_markdown("*The scene is being loaded…*")
        moves = gui.add_button_group("Move", ("left", "forward", "right"))
        hear(self.loop, moves.on_click, self.move)
        stop = gui.add_button("Wait" if self._follows else "Stop")
        hear(self.loop, stop.on_click, lambda _: self.stop())
        again = gui.add_button("Begin again", color="gray")
        hear(self.loop, again.on_click, lambda _: self.begin_again())
        self._next = gui.add_button("Next episode", color="gray")
        hear(self.loop, self._next.on_click, lambda _: self._turn_page())
        if len(self.maps) > 1:
            kinds = gui.add_button_group("Map", tuple(self.maps))
            hear(self.loop, kinds.on_click, self._show_map)
        blank = np.full((8, 8, 3), 40, np.uint8)
        self._map = gui.add_image(blank, format="png") if self.maps else None
        told = "goal_picture" in self.recorder.sensors
        self._goal = gui.add_image(blank, format="jpeg") if told else None
        gui.add_markdown(RULES_FOLLOW if self._follows else RULES)
        if not self._follows and any(e.people for e in self.recorder.suite.episodes):
            gui.add_markdown(RULES_PEOPLE)
        for label, key, work in (
            ("Agent: forward", "I", partial(self.move, "forward")),
            ("Agent: left", "J", partial(self.move, "left")),
            ("Agent: right", "L", partial(self.move, "right")),
            *((("Agent: wait", "K", self.stop),) if self._follows else ()),
            ("Next map", "V", self._next_map),
            ("Next episode", "N", self._turn_page),
        ):
            command = gui.add_command(label, hotkey=key)
            command.on_trigger(lambda event, work=work: self.loop.post(work))

    # choosing

    def _retitle(self) -> list[str]:
        """The list's lines, each with how the walk ended; at the current place in `_list`."""
        self._titles = {self._title(episode): episode for episode in self.recorder.episodes}
        return list(self._titles)

    def _title(self, episode: Episode) -> str:
        return name_line(f"{self._mark(episode)} {episode.id} · {episode.instruction}", 90)

    def _mark(self, episode: Episode) -> str:
        result = self.recorder.results.get(episode.id)
        if result is None:
            return "•" if self.recorder.is_walked(episode) else "–"
        return "!" if result.success is None else "✓" if result.success else "✗"

    def _find(self, name: str) -> Episode | None:
        return next((e for e in self.recorder.episodes if e.id == name), None)

    def _next_left(self) -> Episode | None:
        return next((e for e in self.recorder.episodes if not self.recorder.is_walked(e)), None)

    def _open_link(self, name: str) -> None:
        episode = self._find(name)
        if episode is not None:
            self._begin(episode)

    def _choose(self, title: str) -> None:
        self._begin(self._titles[title])

    def _turn_page(self) -> None:
        episodes = list(self.recorder.episodes)
        place = episodes.index(self.episode) + 1
        order = episodes[place:] + episodes[:place]
        left = [e for e in order if not self.recorder.is_walked(e)]
        self._begin((left or order)[0])

    # walking

    def _begin(self, episode: Episode) -> None:
        """Turn to an episode; it is walked unless it has its result."""
        self.attempts = 0
        self.episode = episode
        self._list.options = self._retitle()
        self._list.value = self._title(episode)
        self._task.content = f"“{plain(episode.instruction, 600)}”"
        self._simulator = self.recorder.open(episode)
        self.begin_again()

    def begin_again(self) -> None:
        """Stand at the start; what was walked is forgotten, unless it had ended."""
        assert self._simulator is not None
        walked = self.recorder.is_walked(self.episode)
        self.actions, self._bumps = [], 0
        try:
            self._seen = self._simulator.reset(self.episode)
            self._referee = self.recorder.referee(self._simulator, self.episode)
            if self._referee is not None:
                self._referee(self._seen, None)
        except EpisodeError as error:
            if not walked:
                self.recorder.save(self.episode, (), seconds=0.0, attempts=1)
            self.walking, self._seen = False, None
            self._tell(f"**This episode cannot be walked:** {plain(error.what)}")
            return
        self.walking = not walked
        self.attempts += self.walking
        self._began = time.monotonic()
        self._refresh()

    def move(self, word: str) -> None:
        """One of left, forward and right."""
        self._act(KEY_ACTIONS[word])

    def stop(self) -> None:
        """Say that the goal is reached: the walk ends, and is scored."""
        self._act(Action.STOP)

    def _act(self, action: Action) -> None:
        if not self.walking or self._simulator is None:
            return
        result = self._simulator.step(action)
        self.actions.append(action)
        self._seen = result.observation
        self._bumps += result.collided
        over = self._referee is not None and self._referee(result.observation, result)
        if over or result.terminated or result.truncated:
            self.walking = False
            self.recorder.save(
                self.episode,
                self.actions,
                seconds=time.monotonic() - self._began,
                attempts=self.attempts,
            )
            self._list.options = self._retitle()
            self._list.value = self._title(self.episode)
        hit = result.info.get("hit_person") is not None
        self._obstacle = "A person" if hit else "An obstacle"
        self._refresh(result.collided)

    # what is shown

    def _refresh(self, bumped: bool = False) -> None:
        simulator = self._simulator
        assert simulator is not None
        if not self.walking:
            self._tell(self._score())
        else:
            word = WORDS[self.actions[-1]] if self.actions else "put at the start"
            if self._referee is not None and word == WORDS[Action.STOP]:
                word = "wait"
            lines = [f"step {len(self.actions)} of {simulator.max_steps}: {word}"]
            lines += [f"**Bump.** {self._obstacle} cut this short."] if bumped else []
            lines += self._facts()
            self._tell("\n\n".join([*lines, f"bumps so far: {self._bumps}"]))
        self.loop.post(self._draw, key="draw")

    def _facts(self) -> list[str]:
        """What the track lets a policy know beside pictures, in words."""
        seen, facts = self._seen, []
        if seen is not None and seen.pose is not None:
            x, y, yaw = seen.pose
            facts.append(f"x {x:.2f} m   y {y:.2f} m   yaw {math.degrees(yaw):.0f}°")
        if seen is not None and seen.goal_vector is not None:
            ahead, left = seen.goal_vector
            facts.append(f"the goal: {ahead:.2f} m ahead, {left:.2f} m to the left")
        return facts

    def _score(self) -> str:
        result = self.recorder.results.get(self.episode.id)
        walked = sum(map(self.recorder.is_walked, self.recorder.episodes))
        count = f"{walked} of {len(self.recorder.episodes)} episodes are walked."
        return f"{tell_result(result)}\n\n{count}"

    def _tell(self, text: str) -> None:
        self._status.content = text

    def _show_map(self, kind: str) -> None:
        self.kind = kind
        self.loop.post(self._draw, key="draw")

    def _next_map(self) -> None:
        if self.maps:
            self._show_map(self.maps[(self.maps.index(self.kind) + 1) % len(self.maps)])

    def _draw(self) -> None:
        seen = self._seen
        if seen is None:
            return
        if self._map is not None:
            picture = seen.bev if self.kind == "bev" else seen.occupancy
            assert picture is not None
            self._map.image = _fit(picture)
        if self._goal is not None and seen.goal_picture is not None:
            self._goal.image = seen.goal_picture
        self._look()

    def _look(self) -> None:
        """The agent's view on every visitor's canvas."""
        simulator = self._simulator
        if simulator is not None and self._seen is not None:
            renderer = simulator.suite.renderer
            assert renderer is not None
            show = partial(simulator.show_people, simulator.pose)
            self.eyes.show(renderer, simulator.pose, show=show)


def tell_result(result: EpisodeResult | None) -> str:
    """How a walk ended, in words."""
    if result is None:
        return "**This episode has its result already.**"
    if isinstance(result.follow, FollowMetrics):
        f = result.follow
        return (
            f"**{'Success' if f.success else 'No success'}:** {tell_end(f.end, f.success)} · "
            f"{100 * f.following_rate:.0f} % followed · {f.distance_error:.2f} m off the distance "
            f"to keep · {counted(f.steps, 'step')}, {counted(f.losses, 'loss', 'losses')}"
        )
    if result.metrics is None:
        return f"**No score:** {plain(result.reason)}"
    m = result.metrics
    if m.success:
        head = "**Success.**"
    elif result.stopped:
        head = "**Stopped too far away.**"
    else:
        head = "**Ran out of steps.**"
    return (
        f"{head} SPL {100 * m.spl:.0f} % · {m.navigation_error_geodesic:.2f} m from the goal · "
        f"{m.trajectory_length:.2f} m walked, {m.shortest_length:.2f} m the shortest way · "
        f"{counted(m.steps, 'step')}, {m.collisions} cut short"
    )


def _fit(picture: U8) -> U8:
    """A map reduced or enlarged to the panel."""
    height, width = picture.shape[:2]
    scale = min(PANEL / width, MAP_HEIGHT / height)
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    way = Image.Resampling.BOX if scale < 1 else Image.Resampling.NEAREST
    return np.asarray(Image.fromarray(picture).resize(size, way), np.uint8)
