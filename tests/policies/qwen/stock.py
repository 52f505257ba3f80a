"""What stock transformers computes for the random checkpoint: written to stock.json.

pip install torch transformers; python tests/policies/qwen/stock.py
"""

from __future__ import annotations

import json
import tempfile
from pathlib import Path

import numpy as np
import torch
import transformers
from transformers import Qwen3VLForConditionalGeneration
from transformers.models.qwen2_vl.image_processing_pil_qwen2_vl import Qwen2VLImageProcessorPil

from gn0.policies.qwen.architecture import load_architecture
from gn0.policies.qwen.layout import build_layout
from gn0_trials.random_qwen import build_random_checkpoint, draw_prompt

ANSWER = (7, 70, 33)


def main() -> None:
    """Compute, and write."""
    with tempfile.TemporaryDirectory() as name:
        folder = build_random_checkpoint(Path(name))
        model = Qwen3VLForConditionalGeneration.from_pretrained(folder, dtype=torch.float32).eval()
        architecture = load_architecture(folder)
    parts, text, pictures = draw_prompt()
    layout = build_layout(architecture, parts)
    ids = np.tile(layout.ids, (len(text), 1))
    ids[:, -6:-1] = text
    full = torch.from_numpy(np.concatenate([ids, np.tile(ANSWER, (len(text), 1))], 1))
    cut = Qwen2VLImageProcessorPil(
        patch_size=4, merge_size=2, temporal_patch_size=2, do_resize=False,
        image_mean=[0.5] * 3, image_std=[0.5] * 3,
    )  # fmt: skip
    flat = [some[row] for row in range(len(text)) for some in pictures]
    seen = cut(images=flat, return_tensors="pt")
    kinds = (full == architecture.image).int()
    with torch.no_grad():
        positions, _ = model.model.get_rope_index(
            full, kinds, image_grid_thw=seen["image_grid_thw"]
        )
        logits = model(
            input_ids=full, pixel_values=seen["pixel_values"],
            image_grid_thw=seen["image_grid_thw"], mm_token_type_ids=kinds,
            attention_mask=torch.ones_like(full),
        ).logits[:, len(layout) - 1 :]  # fmt: skip
    found = {
        "made_with": f"torch {torch.__version__}, transformers {transformers.__version__}",
        "positions": positions[:, 0].tolist(),
        "logits": [[[round(x, 7) for x in one[::9]] for one in row] for row in logits.tolist()],
        "best": logits.argmax(-1).tolist(),
    }
    Path(__file__).with_name("stock.json").write_text(json.dumps(found) + "\n", "utf-8")


if __name__ == "__main__":
    main()
