"""Print what a model is asked at a sample of a dataset, and what it should answer.

Prompts are text files with fields, GN0's own or yours; docs/prompts.md says how they are written.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
import tyro

from gn0.config import Config

EXAMPLES = """  gn0 data prompt out/data --prompt paper_planning
  gn0 data prompt out/data --prompt short --pictures bev occupancy --points 13 --step 4
  gn0 data prompt out/data --prompt short --without heading bumper current_pixel
  gn0 data prompt out/data --prompt prompts/mine.txt --answer-order paper"""


class Args(Config, frozen=True):
    """Which prompt, and which sample.

    Attributes:
        dataset: the dataset folder.
        prompt: a name of `gn0 list prompts`, or the path of a .txt file of yours.
        episode: id of an episode; by default the first one.
        step: number of its step.
        pictures: names of the pictures before the text, where the prompt leaves them open.
        points: waypoints to ask for, where the prompt leaves it open.
        layout: JSON or the tokens alone, where the prompt leaves it open.
        without: parts of the prompt to switch off.
        answer_order: what comes first in the answer, waypoints (paper) or actions; by default as
            the dataset says.
    """

    dataset: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="DATASET")]
    prompt: str
    episode: str = ""
    step: Annotated[int, msgspec.Meta(ge=0)] = 0
    pictures: tuple[str, ...] = ()
    points: Annotated[int, msgspec.Meta(ge=0, le=64)] | None = None
    layout: Literal["compact", "json"] | None = None
    without: tuple[str, ...] = ()
    answer_order: Literal["paper", "actions_first"] | None = None


def run(args: Args) -> int:
    """Print pictures, prompt and answer."""
    from gn0.data.dataset import open_dataset
    from gn0.errors import DataError
    from gn0.policies.bae.prompt_fields import render_prompt, sample_answer, sample_state
    from gn0.policies.bae.prompt_template import load_prompt

    template = load_prompt(
        args.prompt,
        pictures=args.pictures or None,
        points=args.points,
        layout=args.layout,
        without=args.without,
    )
    dataset = open_dataset(args.dataset)
    if not dataset.sampled:
        raise DataError(
            "the dataset has no samples", where=args.dataset, remedy="see skipped in dataset.json"
        )
    episode = args.episode or dataset.sampled[0]
    prompt = render_prompt(template, sample_state(dataset, episode, args.step))
    form = template.form(args.answer_order or dataset.about.settings.tokens.answer_order)
    answer = sample_answer(dataset, episode, args.step, form)
    print(f"{episode}, step {args.step}; pictures: {', '.join(prompt.pictures)}")
    print(f"--- prompt\n{prompt.text}\n--- answer\n{form.write(answer)}")
    return 0
