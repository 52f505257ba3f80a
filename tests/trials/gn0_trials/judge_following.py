"""The page on following computed again by other means: the judge of `gn0.bench.follow_metrics`.

Plain Python from `docs/following.md` alone: lists, loops and `math`, and one step at a time where
ours goes row by row. A stranger's harness can be held against it as well.
"""

from __future__ import annotations

import math
import random
from dataclasses import dataclass
from dataclasses import field as field_of

Point = tuple[float, float]


@dataclass
class JudgedWalk:
    """What the page's first table names, by names of this file; row 0 is the start."""

    agent: list[Point]
    heading: list[float]
    person: list[Point]
    others: list[list[Point]]  # one list a person
    stops: list[bool]  # of each action
    hits: list[bool]
    costs: list[int]
    delta: float
    over: float
    preferred: float
    reference: int
    picture: int = 0
    pixels: list[int] | None = None
    other_pixels: list[list[int]] = field_of(default_factory=list)
    clear: list[bool] | None = None  # nothing stands between, where there are no pictures
    other_clear: list[list[bool]] = field_of(default_factory=list)


def judge_following(walk: JudgedWalk, profile: str) -> dict[str, float | str | None]:
    """Every number of an episode, by the names of `FollowMetrics`; end "" where it goes on."""
    evt = profile == "evt"

    def off_axis(row: int, place: Point) -> float:
        dx, dy = place[0] - walk.agent[row][0], place[1] - walk.agent[row][1]
        if dx == 0 and dy == 0:
            return 0.0
        turned = math.atan2(dy, dx) - walk.heading[row]
        return abs(math.degrees(math.remainder(turned, math.tau)))

    def follows(row: int, place: Point, pixels: int | None, clear: bool) -> bool:
        if math.dist(walk.agent[row], place) > 3.0:
            return False
        if pixels is None:
            return clear and off_axis(row, place) <= 45.0
        part = pixels / walk.picture
        return part < 0.3 and (pixels > 3000 if evt else part >= 0.004)

    def held(row: int) -> bool:
        return follows(
            row, walk.person[row],
            walk.pixels[row] if walk.pixels is not None else None,
            walk.clear[row] if walk.clear is not None else True,
        )  # fmt: skip

    def held_by_another(row: int) -> bool:
        for k, track in enumerate(walk.others):
            pixels = walk.other_pixels[k][row] if walk.pixels is not None else None
            clear = walk.other_clear[k][row] if walk.clear is not None else True
            if follows(row, track[row], pixels, clear):
                return True
        return False

    steps, far, end, success, last = 0, 0, "", False, len(walk.agent) - 1
    for row in range(1, len(walk.agent)):
        before = steps
        steps += walk.costs[row - 1]
        apart = math.dist(walk.agent[row], walk.person[row])
        good = held(row)
        if good:
            far = 0
        elif apart > 4.0:
            far += walk.costs[row - 1]
        if (apart < 0.5) if evt else walk.hits[row - 1]:
            end = "touch"
        elif far > 20:
            end = "lost"
        elif steps >= 300:
            end, success = "steps", good
        elif evt and walk.stops[row - 1]:
            ripe = before * walk.delta > walk.over - 1e-9
            end, success = "stop", good and apart >= 1.0 and ripe
        elif steps * walk.delta > walk.over + 3.0 - 1e-9:
            end, success = "over", good and (apart >= 1.0 or not evt)
        if end:
            last = row
            break

    # from here on every step by itself: (row, follows)
    walked = [row for row in range(1, last + 1) for _ in range(walk.costs[row - 1])]
    kept = [held(row) for row in walked]
    stretches: list[tuple[int, int]] = []  # first step, number of steps without following
    for number, ok in enumerate(kept):
        if ok:
            continue
        if stretches and stretches[-1][0] + stretches[-1][1] == number:
            stretches[-1] = (stretches[-1][0], stretches[-1][1] + 1)
        else:
            stretches.append((number, 1))
    losses = [s for s in stretches if s[1] * walk.delta > 1.0 - 1e-9]
    recovered = [s for s in losses if s[0] + s[1] < len(kept)]
    n = len(walked)
    gaps = [math.dist(walk.agent[row], walk.person[row]) for row in walked]
    return {
        "steps": n,
        "reference_steps": walk.reference,
        "following_steps": sum(kept),
        "following_rate": sum(kept) / (n if n > walk.reference else walk.reference),
        "success": success,
        "touched": end == "touch",
        "lost": end == "lost",
        "end": end,
        "distance_error": sum(abs(d - walk.preferred) for d in gaps) / n,
        "bearing": sum(off_axis(row, walk.person[row]) for row in walked) / n,
        "visible_share": None
        if walk.pixels is None
        else sum(walk.pixels[row] / walk.picture for row in walked) / n,
        "losses": len(losses),
        "first_loss": losses[0][0] * walk.delta if losses else None,
        "recoveries": len(recovered),
        "recovery_seconds": sum(s[1] for s in recovered) * walk.delta,
        "wrong_person": len(
            [row for row, ok in zip(walked, kept, strict=True) if not ok and held_by_another(row)]
        )
        / n,
        "by_pictures": walk.pixels is not None,
    }


def random_walk(rng: random.Random) -> JudgedWalk:
    """A walk in which every rule has its turn: near and far, hidden, touched, stopped, too long."""
    calm = rng.random() < 0.1  # kept well to the last step of all
    rows = rng.choice([2, 5, 40, 120]) if rng.random() < 0.3 else rng.randint(2, 60)
    rows = 330 if calm else rows
    delta = rng.choice([0.1, 0.2, 0.5])
    people = rng.choice([1, 1, 2, 4])
    # the agent wanders about the person at a distance that drifts between a touch and a loss
    person, agent, heading = [], [], []
    x, y, away, side = 0.0, 0.0, rng.uniform(0.6, 3.5), rng.uniform(-3.1, 3.1)
    drift = rng.uniform(-0.05, 0.12) if not calm else 0.0
    for _ in range(rows):
        x, y = x + rng.uniform(-0.05, 0.25), y + rng.uniform(-0.1, 0.1)
        away = abs(away + drift + rng.uniform(-0.25, 0.25))
        away = min(max(away, 0.55), 3.6) if calm else away
        side += rng.uniform(-0.3, 0.3)
        if rng.random() < 0.02:
            drift = -drift
        person.append((x, y))
        agent.append((x + away * math.cos(side), y + away * math.sin(side)))
        heading.append(math.remainder(side + math.pi + rng.gauss(0, 0.6), math.tau))
    if rng.random() < 0.1:
        agent[rng.randrange(rows)] = person[rng.randrange(rows)]
    others = [
        [(px + rng.uniform(-2, 2), py + rng.uniform(-2, 2)) for px, py in person]
        for _ in range(people - 1)
    ]
    actions = rows - 1
    walk = JudgedWalk(
        agent=agent, heading=heading, person=person, others=others,
        stops=[rng.random() < (0.001 if calm else 0.03) for _ in range(actions)],
        hits=[rng.random() < (0.001 if calm else 0.01) for _ in range(actions)],
        costs=[rng.choice([1, 1, 1, 2, 5]) if rng.random() < 0.2 else 1 for _ in range(actions)],
        delta=delta,
        over=math.inf if calm or rng.random() < 0.3 else round(rng.uniform(0, rows), 1) * delta,
        preferred=rng.uniform(1.0, 2.0),
        reference=rng.choice([0, rng.randint(1, 300)]),
    )  # fmt: skip
    kind = rng.random()
    if kind < 0.75:
        walk.picture = rng.choice([640 * 480, 480 * 360, 100 * 100])

        def shown(place: Point, eye: Point) -> int:
            if rng.random() < 0.15:
                return rng.choice([0, 3000, 3001, walk.picture * 3 // 10, walk.picture // 250])
            part = 0.025 * (3.0 / max(math.dist(place, eye), 0.3)) ** 2
            return min(round(part * walk.picture * rng.uniform(0.3, 1.2)), walk.picture)

        walk.pixels = [shown(p, a) for p, a in zip(person, agent, strict=True)]
        walk.other_pixels = [
            [shown(p, a) if rng.random() < 0.5 else 0 for p, a in zip(track, agent, strict=True)]
            for track in others
        ]
    elif kind < 0.9:
        walk.clear = [rng.random() < 0.85 for _ in person]
        walk.other_clear = [[rng.random() < 0.5 for _ in person] for _ in others]
    return walk
