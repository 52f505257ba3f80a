"""Walk through a scene in the browser, replay runs, walk episodes by hand, or look at a splat file.

The agent moves by the simulator's own actions and collides as a policy's would; its pictures are
drawn from all splats, while the browser gets a thinned set. Only this machine can reach the page,
and only with the secret in its address. Ctrl-C ends it.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import msgspec
import tyro

from gn0.config import Config

if TYPE_CHECKING:
    from gn0.viewer.live_loop import LiveLoop
    from gn0.viewer.live_server import LiveServer

EXAMPLES = """  gn0 view out/flat
  gn0 view out/flat --splats 300000 --camera n1
  gn0 view out/demo/runs/oracle out/demo/runs/random
  gn0 view out/demo/runs/oracle --episode apartment_0003
  gn0 view out/demo/apartment --results out/demo/runs/oracle
  gn0 view out/crowd --episode flat_0001
  gn0 view out/flat --people 4
  gn0 view out/suite --record out/by_hand --name Ada
  gn0 view capture.ply --up=-y"""


class Args(Config, frozen=True):
    """What to show, and where to serve it.

    Attributes:
        paths: a scene folder, a splat file, a suite, or run folders as `gn0 bench run` writes them.
        results: run folders whose episodes are replayed in that scene.
        episode: id of the episode to begin with, as results and reports say it; of a suite, the
            one whose scene and people you walk among.
        people: put so many people into a scene to walk among.
        people_seed: who they are and where they go.
        bank: of the people of a suite's episode who have names in one.
        record: walk the episodes of a suite yourself: the folder of the run that is written, scored
            like any policy's. It goes on where an earlier recording there stopped.
        name: what tables and reports call a recorded run.
        limit: record only the first so many episodes, by id; 0 for all.
        fresh: forget an earlier recording.
        splats: how many splats the browser gets; 60,000 still move without a GPU.
        camera: a camera preset by name: the agent's camera and body.
        up: which axis of a splat file points up; auto proposes one.
        level: level of detail of a streamed SOG, 0 the finest.
        host: address to listen on.
        port: port to listen on; the next free one if it is taken, 0 for any.
        allow_remote: allow a --host that other machines can reach.
        no_browser: do not open a browser.
        check: stop with code 0 as soon as everything is on the page; for scripts.
    """

    paths: Annotated[
        tuple[str, ...],
        tyro.conf.Positional,
        tyro.conf.arg(metavar="SCENE_OR_RUN [SCENE_OR_RUN ...]", help_behavior_hint="(required)"),
    ]
    results: tuple[str, ...] = ()
    episode: str = ""
    people: Annotated[int, msgspec.Meta(ge=0, le=16)] = 0
    people_seed: Annotated[int, msgspec.Meta(ge=0, le=2**62)] = 0
    bank: str = ""
    record: str = ""
    name: str = ""
    limit: Annotated[int, msgspec.Meta(ge=0)] = 0
    fresh: Annotated[bool, tyro.conf.arg(aliases=("--overwrite",))] = False
    splats: Annotated[int, msgspec.Meta(ge=100, le=5_000_000)] = 60_000
    camera: str = "gn_bench"
    up: Literal["auto", "+z", "-z", "+y", "-y", "+x", "-x"] = "auto"
    level: int | None = None
    host: str = "127.0.0.1"
    port: Annotated[int, msgspec.Meta(ge=0, le=65535)] = 8080
    allow_remote: bool = False
    no_browser: bool = False
    check: bool = False


def run(args: Args) -> int:
    """Serve the page until Ctrl-C."""
    from gn0.errors import ConfigError
    from gn0.viewer.live_server import need_viser

    need_viser()
    if args.record:
        return _record(args)
    if args.name or args.limit or args.fresh:
        raise ConfigError(
            "--name, --limit and --fresh belong to a recording",
            remedy="gn0 view SUITE --record OUT",
        )
    from gn0.cli.console import draw_progress

    with draw_progress("reading what is shown"):
        build = find_view(args)
    return _serve(args, build)


def _record(args: Args) -> int:
    """Let a person walk the episodes of a suite, and say how they went."""
    from functools import partial

    from gn0.bench.walk_recording import open_recorder
    from gn0.cli.result_tables import print_summaries
    from gn0.errors import ConfigError
    from gn0.suites.named_suites import open_named
    from gn0.viewer.live_record import RecordView

    if len(args.paths) != 1 or args.results:
        raise ConfigError(
            "one suite is walked at a time", where="--record", remedy="gn0 view SUITE --record OUT"
        )
    suite = open_named(args.paths[0], beside=args.record)
    known = [episode.id for episode in suite.episodes]
    if args.episode and args.episode not in known:
        raise ConfigError(
            f"the suite has no episode {args.episode[:80]!r}",
            where="--episode",
            remedy=f"its first is {known[0]}" if known else "choose another suite",
        )
    with open_recorder(
        suite,
        args.record,
        name=args.name,
        max_episodes=args.limit or None,
        resume=not args.fresh,
    ) as recorder:
        code = _serve(args, partial(RecordView, recorder=recorder, first=args.episode))
        summary = recorder.write()
    print_summaries([summary])
    if summary.valid:
        print(f"next: gn0 bench report {args.record}    or gn0 view {args.record}")
    return code


def _serve(args: Args, build: Any) -> int:
    """Serve a view until Ctrl-C."""
    from gn0.cli.console import draw_progress
    from gn0.viewer.live_loop import LiveLoop
    from gn0.viewer.live_server import open_server

    loop = LiveLoop()
    with open_server(args.host, args.port, allow_remote=args.allow_remote) as live:
        announce(args, live)
        with draw_progress("opening the view"):
            view = build(live, loop)
            view.open()
        if args.check:
            return _check(view, live, loop)
        try:
            loop.run(view.tick)
        except KeyboardInterrupt:
            print("\nclosed")
    return 0


def find_view(args: Args) -> Any:
    """What the paths mean: a function of server and loop that makes the view.

    Everything that can be wrong with the paths is found out here, before a server starts.

    Raises:
        ConfigError, StorageError, FormatError, BenchError, SceneError: see the message.
    """
    from functools import partial

    from gn0.errors import ConfigError, StorageError
    from gn0.sim.presets import find_preset

    if not args.paths:
        raise ConfigError("nothing to show", remedy="gn0 view SCENE, or gn0 view RUN, or FILE.ply")
    paths = [Path(path) for path in args.paths]
    for path in paths:
        if not path.exists():
            raise StorageError("no such file or folder", where=path, remedy="check the path")
    first = paths[0]
    if args.people and not (first / "scene.json").is_file():
        raise ConfigError(
            "people are put into a scene", where="--people", remedy="gn0 view SCENE --people 3"
        )
    if args.people_seed and not args.people:
        raise ConfigError(
            "says who people are, and none are asked for",
            where="--people-seed",
            remedy="gn0 view SCENE --people 3 --people-seed 1",
        )
    if args.bank and (first / "scene.json").is_file() and not args.results:
        raise ConfigError(
            "is of the people of a suite's episode, and people of a scene are drawn from a seed",
            where="--bank",
            remedy="gn0 view SUITE --bank DIR",
        )
    if args.results or (first / "summary.json").is_file():
        from gn0.viewer.recorded_runs import load_replay
        from gn0.viewer.replay_live import ReplayView

        runs = [Path(r) for r in args.results] if args.results else paths
        replay = load_replay(runs, first if args.results else None)
        if args.episode:
            replay.find(args.episode)
        return partial(ReplayView, replay=replay, splats=args.splats, first=args.episode)
    if first.is_dir() and (first / "suite.json").is_file() and len(paths) == 1:
        return _find_walk(first, args)
    if args.episode:
        raise ConfigError(
            "only a run or a suite has episodes to show",
            where="--episode",
            remedy="gn0 view RUN --episode ID",
        )
    if len(paths) > 1:
        raise ConfigError(
            "several paths, and not all of them are runs",
            remedy="one scene or file, or several run folders",
        )
    if first.is_dir() and (first / "scene.json").is_file():
        from gn0.scenes.folder import load_scene
        from gn0.viewer.live import SceneView

        preset = find_preset(args.camera)
        scene = load_scene(first)
        episode = _populate(scene, args, preset) if args.people else None
        return partial(_scene_view, SceneView, scene, args.splats, preset, episode)
    from gn0.gaussians.splat_files import load_cloud
    from gn0.viewer.live_file import FileView

    file = load_cloud(first, level=args.level)
    up = find_up(file.cloud) if args.up == "auto" else args.up
    return partial(_file_view, FileView, first, file, args.splats, up)


def find_up(cloud: Any) -> str:
    """The axis of a bare cloud nearest to the proposed up, and say how sure that is."""
    from gn0.errors import SceneError
    from gn0.scenes.capture.gravity import propose_up, sample_surface

    try:
        best = propose_up(sample_surface(cloud))[0]
    except SceneError:
        return "+z"
    axis = max(range(3), key=lambda k: abs(best.up[k]))
    up = ("-" if best.up[axis] < 0 else "+") + "xyz"[axis]
    print(f"up is assumed to be {up} ({best.share:.0%} sure); --up says otherwise", flush=True)
    return up


def _scene_view(
    kind: Any,
    scene: Any,
    splats: int,
    preset: Any,
    episode: Any,
    live: LiveServer,
    loop: LiveLoop,
) -> Any:
    body = None if episode is None else episode.agent
    return kind(live, scene, loop, splats=splats, preset=preset, episode=episode, body=body)


def _find_walk(folder: Path, args: Args) -> Any:
    """The scene of a suite's episode, with its people, to walk in without a score."""
    import difflib
    from functools import partial

    from gn0.errors import ConfigError
    from gn0.people.cast import Cast
    from gn0.suites.suite import load_suite, load_suite_scene
    from gn0.viewer.live import SceneView

    suite = load_suite(folder)
    known = {episode.id: episode for episode in suite.episodes}
    if args.episode and args.episode not in known:
        near = difflib.get_close_matches(args.episode, known, 1) or list(known)[:1]
        raise ConfigError(
            f"the suite has no episode {args.episode[:80]!r}",
            where="--episode",
            remedy=f"did you mean {near[0]!r}?" if near else "choose another suite",
        )
    episode = known[args.episode] if args.episode else suite.episodes[0]
    bank = args.bank or None
    Cast(bank).check(episode.people, f"episode {episode.id!r}")
    name = episode.scene_id
    scene = load_suite_scene(suite.scene_folder(name), name, suite.scene_hash(name))
    kind = partial(SceneView, bank=bank)
    return partial(_scene_view, kind, scene, args.splats, suite.about.camera, episode)


def _populate(scene: Any, args: Args, preset: Any) -> Any:
    """An episode without a task, with people in it, that begins where one sees most.

    Raises:
        ConfigError: the scene has no room for anybody.
    """
    import msgspec

    from gn0.errors import ConfigError
    from gn0.missions.episode import Episode, MissionGoal
    from gn0.people.plan import plan_people
    from gn0.people.settings import PeopleSettings
    from gn0.viewer.viewpoints import choose_viewpoints

    poses = choose_viewpoints(scene, 1, max(0.25, preset.agent.radius + 0.05))
    if not poses:
        raise ConfigError(
            "nobody finds room in this scene", where="--people", remedy="gn0 scene check SCENE"
        )
    x, y, yaw = poses[0]
    episode = Episode(
        id="walk",
        scene_id=scene.id,
        mission=MissionGoal(goal=(x, y), object_id="", category="", instruction="Look around."),
        start=(x, y, yaw),
        path=((x, y), (x, y)),
        agent=preset.agent,
    )
    settings = PeopleSettings(count=args.people, seed=args.people_seed)
    people = plan_people(scene, episode, settings, radius=preset.agent.radius)
    return msgspec.structs.replace(episode, people=people)


def _file_view(
    kind: Any, path: Path, file: Any, splats: int, up: str, live: LiveServer, loop: LiveLoop
) -> Any:
    return kind(live, path, file, loop, splats=splats, up=up)


def announce(args: Args, live: LiveServer) -> None:
    """Say where the page is, and open it."""
    if args.port and live.port != args.port:
        print(f"port {args.port} is taken; using {live.port}")
    print(f"open {live.url}", flush=True)
    if not args.check:
        print("Ctrl-C ends it", flush=True)
    if args.allow_remote:
        print("anyone who has this address can use the page; it is not encrypted", flush=True)
    if not (args.no_browser or args.check):
        import threading
        import webbrowser

        threading.Thread(target=webbrowser.open, args=(live.url,), daemon=True).start()


def _check(view: Any, live: LiveServer, loop: LiveLoop) -> int:
    from gn0.viewer.live_server import fetch_page

    view.finish()
    loop.post(loop.stop)
    loop.run()  # what is waiting comes first
    fetch_page(live)
    print("the page is ready" if view.ready else "the page is ready; no agent can stand here")
    return 0
