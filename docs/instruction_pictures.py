"""Draw the ten routes of docs/instructions.md and print their texts: `instruction_pictures.py DIR`.

DIR holds the generated scenes; those that are missing are generated (some minutes each). The same
scenes give the same routes and texts.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from gn0 import build_renderer, load_scene
from gn0.maps import NavigationMap
from gn0.missions import describe_route, open_provider, sample_goal_episodes, write_texts
from gn0.scenes import GenerateSettings, generate_scene
from gn0.viewer import render_route, segment_words

PICTURES = Path(__file__).resolve().parent / "pictures"
QUICK = {"size": "small", "light": "draft", "density": 5000.0}
SCENES = {
    "flat12": {"kind": "apartment", "seed": 12, "size": "small", "density": 10_000.0},
    "flat5": {"kind": "apartment", "seed": 5, "size": "small", "density": 10_000.0},
    "office3": {"kind": "office", "seed": 3, **QUICK},
    "supermarket1": {"kind": "supermarket", "seed": 1, **QUICK},
    "courtyard0": {"kind": "courtyard", "seed": 0, **QUICK},
}
# scene and which of its goal episodes: the first ones drawn, none picked for its text
ROUTES = [(scene, number) for scene in SCENES for number in (0, 1)]
COUNT, LEAST = 30, 5.0  # episodes drawn a scene, and their shortest way [m]


def main(folder: Path) -> None:
    """Generate what is missing, then draw and print."""
    provider = open_provider("template")
    for name, settings in SCENES.items():
        if not (folder / name / "scene.json").exists():
            generate_scene(GenerateSettings(**settings), folder / name)
        scene = load_scene(folder / name)
        navigation = NavigationMap(scene.grid, 0.2)
        renderer = build_renderer(scene.gaussians)
        by_id = {thing.id: thing for thing in scene.objects}
        episodes = sample_goal_episodes(scene, navigation, COUNT, 1, minimum_length=LEAST)
        for index, (chosen, number) in enumerate(ROUTES, 1):
            if chosen != name:
                continue
            path = np.array(episodes[number].path)
            ahead = path[min(4, len(path) - 1)] - path[0]
            yaw = float(np.arctan2(ahead[1], ahead[0]))  # one starts facing the way
            target = by_id[episodes[number].mission.object_id]
            route = describe_route(scene, navigation, path, yaw, target)
            picture = render_route(scene, renderer, route, path, yaw, height=480).convert("RGB")
            out = PICTURES / f"instruction_{index}.jpg"
            picture.save(out, quality=82)
            lines = [f"## {index}: {name}, {route.length:.1f} m, {out.stat().st_size // 1000} kB"]
            lines += [f"   {i} {segment_words(s)}" for i, s in enumerate(route.segments, 1)]
            texts = write_texts(route, provider, seed=index)
            lines += [f"{style}: {text.text}" for style, text in texts.items()]
            sys.stdout.write("\n".join(lines) + "\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
