"""From a seed to a furnished flat whose rooms can all be walked to."""

from __future__ import annotations

from gn0.scenes.procedural.building import Building, choose_palette
from gn0.scenes.procedural.draft import SceneDraft
from gn0.scenes.procedural.palette import Palette
from gn0.scenes.procedural.plan import plan_apartment
from gn0.scenes.procedural.room_contents import furnish_room

NEEDED = {
    "bedroom": {"bed"},
    "kitchen": {"kitchen counter", "fridge"},
    "bathroom": {"toilet", "washbasin"},
    "living room": {"sofa"},
    "study": {"desk"},
}


def draft_apartment(
    seed: int,
    *,
    size: str = "medium",
    style: str | Palette | None = None,
    open_plan: bool = False,
) -> SceneDraft:
    """A furnished flat: geometry, materials, objects, rooms and lamps, before light.

    Args:
        seed: of everything; the same seed gives the same flat.
        size: "small", "medium" or "large" (see `plan.SIZES`).
        style: name of one of `palette.STYLES`; drawn when None.
        open_plan: see `plan_apartment`.

    Raises:
        SceneError: an unknown style, or no walkable flat was found (not known to happen).
    """
    palette = choose_palette("apartment", seed, style)
    plan = plan_apartment(seed, size, open_plan=open_plan)
    flat = Building("apartment", seed, plan, palette, furnish_room, needed=NEEDED)
    return flat.draft()
