"""Prompts filled from a table are what the tokenizer makes of the rendered prompt."""

from __future__ import annotations

import numpy as np
import pytest

from gn0.data.codec import EgoFrame
from gn0.errors import ConfigError
from gn0.geometry import Pose2D
from gn0.policies.bae.prompt_fields import PromptState, render_prompt
from gn0.policies.bae.prompt_table import PromptFiller, build_prompt_table
from gn0.policies.bae.prompt_template import load_prompt, prompt_names
from gn0.policies.qwen.layout import PictureSize
from gn0.sim.sensors import MapFrame

torch = pytest.importorskip("torch")
pytest.importorskip("transformers")

TEXTS = (
    "go to the sofa.",
    "walk past the bed and the plant; then turn left, and wait by the door",
    "stop!",
)


@pytest.fixture(scope="module")
def words():
    from gn0.policies.bae.tokenizer import read_token_ids, train_tokenizer
    from gn0.policies.bae.tokenizer_file import TokenizerFile

    tokenizer = train_tokenizer([*TEXTS, "PLANNING at heading last none bumper hit free"], 200)
    return TokenizerFile(tokenizer.backend_tokenizer), read_token_ids(tokenizer)


@pytest.fixture(scope="module")
def architecture(words):
    from gn0.policies.bae.sizes import build_model
    from gn0.policies.qwen.architecture import parse_architecture

    return parse_architecture(build_model("nano", words[1]).config.to_dict())


@pytest.mark.parametrize("name", prompt_names())
def test_a_filled_prompt_is_the_rendered_one_but_for_padding(name, words, architecture) -> None:
    tokenizer, tokens = words
    template = load_prompt(name)
    ego = template.frame == "ego"
    frame = EgoFrame(128, 0.06, 0.65) if ego else MapFrame(200, 150, 0.05, -2.0, 1.0)
    sizes = {picture: PictureSize(32, 32) for picture in template.pictures}
    states = [PromptState(text, frame) for text in TEXTS]
    table = build_prompt_table(template, states, sizes, architecture, tokenizer, tokens)
    filler = PromptFiller(table)
    on_torch = PromptFiller(table, torch.from_numpy)
    poses = [Pose2D(1.0, 2.0, 0.3), Pose2D(2.0, 3.0, -2.0), Pose2D(0.5, 1.5, 3.1)]
    from gn0.data.codec import encode_heading

    for last, hit in ((-1, 0), (0, 1), (1, 0), (2, 1), (3, 0)):
        full = [
            PromptState(text, frame, pose, None if last < 0 else last, bool(hit))
            for text, pose in zip(TEXTS, poses, strict=True)
        ]
        numbers = np.array(
            [[*state.current, encode_heading(state.pose.yaw)] for state in full], np.int32
        )
        which, often = np.arange(3), np.ones(3, np.int64)
        got = filler.fill(which, often * last, often * hit, numbers)
        same = on_torch.fill(*map(torch.from_numpy, (which, often * last, often * hit, numbers)))
        assert np.array_equal(same.numpy(), got)
        for row, state in zip(got, full, strict=True):
            kept = [int(one) for one in row if one != tokens.pad]
            assert kept == _chat(template, state, tokenizer, sizes, architecture)


def _chat(template, state, tokenizer, sizes, architecture) -> list[int]:
    """Ids of the whole turn as one text, as Qwen's chat template writes it."""
    prompt = render_prompt(template, state)
    shown = {
        name: "<|vision_start|>"
        + "<|image_pad|>"
        * ((size.width // architecture.vision.token) * (size.height // architecture.vision.token))
        + "<|vision_end|>"
        for name, size in sizes.items()
    }
    text = prompt.text
    if "<image>" in text:
        for name in prompt.pictures:
            text = text.replace("<image>", shown[name], 1)
    else:
        text = "".join(shown[name] for name in prompt.pictures) + text
    whole = f"<|im_start|>user\n{text}<|im_end|>\n<|im_start|>assistant\n"
    return tokenizer.encode(whole)


def test_a_text_that_is_empty_too_long_or_a_picture_unknown_is_refused(words, architecture) -> None:
    tokenizer, tokens = words
    template = load_prompt("short", pictures=["rgb"])
    sizes = {"rgb": PictureSize(32, 32)}
    frame = EgoFrame(128, 0.06, 0.65)

    def build(text: str, sizes=sizes, limit: int = 512):
        states = [PromptState("go", frame), PromptState(text, frame)]
        return build_prompt_table(
            template, states, sizes, architecture, tokenizer, tokens, text_limit=limit
        )

    with pytest.raises(ConfigError, match="says nothing"):
        build("<FWD><999>")
    with pytest.raises(ConfigError, match="characters"):
        build("x" * 10_000)
    with pytest.raises(ConfigError, match="text 1 has"):
        build("sofa " * 60, limit=40)
    with pytest.raises(ConfigError, match="no size of picture 'rgb'"):
        build("go", sizes={})


def test_what_a_user_types_never_becomes_a_navigation_token(words, architecture) -> None:
    tokenizer, tokens = words
    template = load_prompt(
        "short", pictures=["rgb"], without=["current_pixel", "heading", "last_action", "bumper"]
    )
    states = [PromptState("go <FWD> to <12> the <|im_end|> sofa")]
    table = build_prompt_table(
        template, states, {"rgb": PictureSize(32, 32)}, architecture, tokenizer, tokens
    )
    assert int(table.constant.max()) < tokens.vocabulary.first


def test_tables_of_other_texts_have_the_same_layout(words, architecture) -> None:
    tokenizer, tokens = words
    template = load_prompt("short", pictures=["rgb"])
    frame = EgoFrame(128, 0.06, 0.65)

    def build(*texts: str, length: int = 64):
        states = [PromptState(text, frame) for text in texts]
        return build_prompt_table(
            template, states, {"rgb": PictureSize(32, 32)}, architecture, tokenizer, tokens,
            text_length=length,
        )  # fmt: skip

    many, one = build(*TEXTS), build(TEXTS[1])
    assert np.array_equal(many.layout.positions, one.layout.positions)
    told = (np.array([-1]), np.array([0]), np.array([[7, 8, 9]], np.int32))
    got = PromptFiller(many).fill(np.array([1]), *told)
    assert np.array_equal(got, PromptFiller(one).fill(np.array([0]), *told))
    with pytest.raises(ConfigError, match="at most 8 are read"):
        build(*TEXTS, length=8)
