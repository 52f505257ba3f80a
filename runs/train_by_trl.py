"""Train a policy by TRL instead of `gn0 train`: SFT, then GRPO with GN0's rewards.

The states are those of the expert's walks through the built-in flat; the model is Qwen3-VL's
architecture with 2 M random weights, so a plain run shows that everything fits and no more. Pass a
Qwen3-VL's folder and a number of updates to train one. GRPO's objective is the paper's here
(`loss_type="grpo"`, no KL, clips 0.2 and 0.28); TRL's default is a mean over tokens. It encodes a
prompt's pictures once an answer; `gn0 train dapo` encodes them once.

Run: python runs/train_by_trl.py [checkpoint] [updates], after pip install -e '.[train]'
'trl>=1.16' 'datasets>=4.7'. TRL says which prompts it does not understand; ours it does.
"""

import sys
import tempfile
from pathlib import Path

FORM = {"points": 3, "layout": "json"}  # two waypoints and six actions keep it quick


def main() -> None:
    try:
        import numpy as np
        import torch
        from datasets import Dataset, Features, Image, List, Value
        from PIL import Image as Picture
        from trl import GRPOConfig, GRPOTrainer, SFTConfig, SFTTrainer
    except ImportError as error:
        print(f"needs TRL: pip install -e '.[train]' 'trl>=1.16' 'datasets>=4.7' ({error})")
        return

    from gn0 import DeviceError
    from gn0.data.answer_form import AnswerForm
    from gn0.device import open_device
    from gn0.geometry import Pose2D
    from gn0.policies.bae.checkpoint import load_checkpoint
    from gn0.policies.bae.policy_settings import PolicySettings
    from gn0.policies.bae.processor import build_processor
    from gn0.policies.bae.prompt_fields import PromptState, render_prompt
    from gn0.sim import VectorEnvDevice
    from gn0.training.pupil import Pupil, build_pupil, fit_texts
    from gn0.training.rewards import read_texts, score_answers
    from gn0.training.rl.visited_states import collect_states
    from gn0.training.streams.samples import decode_squares

    start = sys.argv[1] if len(sys.argv) > 1 else ""
    updates = int(sys.argv[2]) if len(sys.argv) > 2 else 2
    on_card = torch.cuda.is_available()
    try:
        device = open_device("cuda" if on_card else "host")
    except DeviceError as error:
        print(f"no device for the agents: {error}")
        return

    # states, and what the expert would do in each
    settings = PolicySettings(prompt="short", pictures=("near", "far"), form=AnswerForm(**FORM))
    env = VectorEnvDevice(
        4, device=device, sensors=("ego_map",), preset=settings.preset, map_view=settings.view
    )
    texts = [episode.instruction for episode in env.tasks.episodes]
    if start:
        base = load_checkpoint(start, grow=True)
        pupil = fit_texts(Pupil(base, settings, settings.load_template()), texts)
    else:
        pupil = build_pupil("nano", settings, texts, merges=300)
    pupil.model.to("cuda" if on_card else "cpu")
    visited = collect_states(env, pupil, 16, seed=0, walks="expert")
    states = visited.draw(np.arange(len(visited)))
    answers = visited.maker.make(states).answer
    tokenizer, form, frame = pupil.checkpoint.tokenizer, settings.form, settings.frame

    rows = []
    for k in range(len(states)):
        last = int(states.last[k])
        state = PromptState(
            env.episodes[int(states.episode[k])].instruction,
            frame,
            Pose2D(*states.pose[k].tolist()),
            None if last < 0 else last,
            bool(states.collided[k]),
        )
        asked = render_prompt(pupil.template, state).text
        said = tokenizer.decode(answers[k], skip_special_tokens=True)
        rows.append(
            {
                "images": [
                    Picture.fromarray(states.pictures[name][k].cpu().numpy())
                    for name in settings.pictures
                ],
                "prompt": [{"role": "user", "content": asked}],
                "completion": [{"role": "assistant", "content": said}],
                "row": k,
            }
        )
    turn = List({"role": Value("string"), "content": Value("string")})
    features = {"images": List(Image()), "prompt": turn, "completion": turn, "row": Value("int64")}
    samples = Dataset.from_list(rows, features=Features(features))

    def reward(completions, row, **_):
        """R of each answer: -2 where it cannot be read, else by where its plan leads."""
        actions, tokens, readable = (
            one.to(states.pose.device)
            for one in read_texts(form, [said[0]["content"] for said in completions])
        )
        at = torch.tensor(row, device=actions.device)
        found = score_answers(
            visited.walker.walk(at, actions),
            visited.wanted.pick(at),
            actions,
            visited.actions[at],
            readable,
            waypoints=decode_squares(frame, tokens[:, 1:]),  # point 0 is where the agent stands
            wanted_waypoints=states.waypoints[at, 1 : form.points],
        )
        return found.total.tolist()

    right = reward([row["completion"] for row in rows], [row["row"] for row in rows])
    print(f"the expert's own answers score {sum(right) / len(right):.3f}")

    patch = pupil.model.config.vision_config.patch_size
    processor = build_processor(tokenizer, patch)
    common = {
        "max_steps": updates, "per_device_train_batch_size": 4, "logging_steps": 1, "seed": 0,
        "report_to": "none", "save_strategy": "no", "use_cpu": not on_card, "bf16": on_card,
        "gradient_checkpointing": False, "disable_tqdm": True,
    }  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        sft = SFTTrainer(
            pupil.model,
            args=SFTConfig(
                str(Path(folder) / "sft"), completion_only_loss=True, max_length=None,
                learning_rate=1e-3, **common,
            ),
            train_dataset=samples.remove_columns("row"),
            processing_class=processor,
        )  # fmt: skip
        sft.train()
        losses = [entry["loss"] for entry in sft.state.log_history if "loss" in entry]

        for name, weight in pupil.model.named_parameters():  # the tower stands still, see l. 843
            projector = "visual.merger" in name or "visual.deepstack_merger_list" in name
            weight.requires_grad_(projector or "visual." not in name)
        tokens = pupil.checkpoint.ids
        never = [tokens.image, *range(tokens.vocabulary.size, tokens.vocabulary.rows)]
        grpo = GRPOTrainer(
            pupil.model,
            reward_funcs=reward,
            args=GRPOConfig(
                str(Path(folder) / "grpo"), loss_type="grpo", beta=0.0, epsilon=0.2,
                epsilon_high=0.28, scale_rewards="group", num_generations=4,
                steps_per_generation=2, max_completion_length=len(pupil.slots) + 8,
                temperature=1.0, learning_rate=2e-5,
                generation_kwargs={"suppress_tokens": never}, **common,
            ),
            train_dataset=samples.remove_columns("completion"),
            processing_class=processor,
        )  # fmt: skip
        grpo.train()
        scores = [entry["reward"] for entry in grpo.state.log_history if "reward" in entry]
    print(f"SFT: loss {losses[0]:.3f} to {losses[-1]:.3f} in {len(losses)} updates")
    print(f"GRPO: rewards {', '.join(f'{score:.3f}' for score in scores)}")


if __name__ == "__main__":
    main()
