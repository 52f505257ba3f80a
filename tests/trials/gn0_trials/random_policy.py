"""A policy of random weights with a tokenizer, written by the core install alone."""

from __future__ import annotations

import json
from pathlib import Path

from gn0.data.answer_form import AnswerForm
from gn0.data.codec import NAVIGATION_TOKENS
from gn0.policies.bae.policy_settings import PolicySettings, save_policy_settings
from gn0.policies.bae.tokens import PAD_ROWS, SPECIALS
from gn0.policies.qwen.byte_pairs import PATTERN, list_byte_letters
from gn0.sim.ego_map import EgoSquare, MapView
from gn0_trials.random_qwen import build_random_checkpoint, list_config

MERGES = "t h,th e,Ġ the,g o,s o,so f,sof a,Ġ sofa,' s,Ġ Ġ,Ã ©,c a,ca f,h e,1 2,d o,' d"
SETTINGS = PolicySettings(
    prompt="short",
    pictures=("near", "far"),
    form=AnswerForm(layout="compact"),
    view=MapView(squares=(EgoSquare(32, 0.24), EgoSquare(32, 0.6))),
    text_length=64,
)


def write_tokenizer(folder: Path) -> int:
    """Write a tokenizer.json of Qwen's kind with few merges; returns how many tokens it has."""
    merges = [pair.split(" ") for pair in MERGES.split(",")]
    vocabulary = {letter: k for k, letter in enumerate(sorted(list_byte_letters()))}
    for pair in merges:
        vocabulary.setdefault("".join(pair), len(vocabulary))
    added = [
        {
            "id": len(vocabulary) + k, "content": name, "single_word": False, "lstrip": False,
            "rstrip": False, "normalized": False, "special": name in SPECIALS,
        }
        for k, name in enumerate([*SPECIALS, *NAVIGATION_TOKENS])
    ]  # fmt: skip
    split = {
        "type": "Split", "pattern": {"Regex": PATTERN}, "behavior": "Isolated", "invert": False,
    }  # fmt: skip
    letters = {
        "type": "ByteLevel", "add_prefix_space": False, "trim_offsets": True, "use_regex": False,
    }  # fmt: skip
    table = {
        "version": "1.0", "truncation": None, "padding": None, "added_tokens": added,
        "normalizer": {"type": "NFC"},
        "pre_tokenizer": {"type": "Sequence", "pretokenizers": [split, letters]},
        "post_processor": None, "decoder": letters,
        "model": {
            "type": "BPE", "dropout": None, "unk_token": None, "continuing_subword_prefix": "",
            "end_of_word_suffix": "", "fuse_unk": False, "byte_fallback": False,
            "ignore_merges": False, "vocab": vocabulary, "merges": merges,
        },
    }  # fmt: skip
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "tokenizer.json").write_text(json.dumps(table), "utf-8")
    return len(vocabulary) + len(added)


def write_random_policy(folder: Path, seed: int = 0) -> Path:
    """Write weights, tokenizer and policy.json; returns the folder."""
    count = write_tokenizer(folder)
    first = count - len(NAVIGATION_TOKENS) - len(SPECIALS)
    ids = {name: first + k for k, name in enumerate(SPECIALS)}
    text = list_config()["text_config"] | {"vocab_size": -(-count // PAD_ROWS) * PAD_ROWS}
    build_random_checkpoint(
        folder,
        seed,
        text_config=text,
        image_token_id=ids["<|image_pad|>"],
        video_token_id=ids["<|video_pad|>"],
        vision_start_token_id=ids["<|vision_start|>"],
        vision_end_token_id=ids["<|vision_end|>"],
    )
    save_policy_settings(folder, SETTINGS)
    return folder
