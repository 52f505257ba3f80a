"""A recurrent baseline in the benchmark: the protocol, the bytes of results, what is refused."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="recurrent baselines need gn0[train]")
pytest.importorskip("transformers", reason="tokenizers are trained with gn0[train]")

from gn0.bench.results import load_results  # noqa: E402
from gn0.bench.runner import run_suite  # noqa: E402
from gn0.errors import CheckpointError, ConfigError, PolicyError  # noqa: E402
from gn0.plugins import build_plugin  # noqa: E402
from gn0.policies.bae.shard_file import write_shard  # noqa: E402
from gn0.policies.cma.cma_checkpoint import load_cma_checkpoint  # noqa: E402
from gn0.policies.cma.policy_cma import PolicyCma  # noqa: E402
from gn0.sim.state import Observation  # noqa: E402
from gn0.testing.policy_check import check_policy  # noqa: E402


def observe(seed: int, size: int = 128) -> Observation:
    picture = np.random.default_rng(seed).integers(0, 256, (128, 2 * size, 3), dtype=np.uint8)
    return Observation(0, 0.0, "", more={"ego_map": picture})


def begin(policy: PolicyCma, *texts: str) -> None:
    rngs = [np.random.default_rng(0)] * len(texts)
    policy.reset_batch(range(len(texts)), texts, rngs)


def act(policy: PolicyCma, text: str, seeds: range) -> list[int]:
    begin(policy, text)
    return [policy.act_batch([0], [observe(seed)])[0] for seed in seeds]


def test_it_keeps_the_protocol(near_checkpoint: Path) -> None:
    check_policy(lambda: PolicyCma(str(near_checkpoint)), max_steps=9)


@pytest.mark.slow
def test_colour_and_depth_keep_the_protocol_in_batches(write_cma, tmp_path: Path) -> None:
    folder = write_cma(tmp_path / "own", spread=2.0, pictures=("rgb", "depth", "near"))
    check_policy(lambda: PolicyCma(str(folder), batch=3), preset="tiny_128", max_steps=9)


def test_the_benchmark_runs_it_the_same_alone_and_side_by_side(
    near_checkpoint: Path, flats_suite, tmp_path: Path, worker_here: None
) -> None:
    options = {"checkpoint": str(near_checkpoint)}
    outputs = []
    for agents in (1, 7):
        out = tmp_path / str(agents)
        summary = run_suite(
            flats_suite, "cma", out, agents=agents, policy_options=options, max_episodes=8
        )
        outputs.append([(out / n).read_bytes() for n in ("results.jsonl", "trajectories.jsonl")])
    assert outputs[0] == outputs[1]
    assert len(load_results(tmp_path / "1")) == 8
    card = dict(summary.protocol)
    assert card["weights"] == "retrained, small: not the published ones"
    assert (card["graph"], card["pictures"]) == ("cma", "near")


def test_it_remembers_its_own_walk_and_no_other(near_checkpoint: Path) -> None:
    policy = PolicyCma(str(near_checkpoint))
    once = act(policy, "go to the sofa", range(12))
    assert len(set(once)) > 1
    assert act(policy, "go to the sofa", range(12)) == once
    last = act(policy, "go to the sofa", range(11, 12))[0]
    seen = [act(policy, "go to the sofa", range(k, 12))[-1] for k in range(11)]
    assert {last, *seen} != {once[-1]}  # what came before matters


def test_goal_blind_it_acts_the_same_whatever_it_is_told(write_cma, tmp_path: Path) -> None:
    folder = write_cma(tmp_path / "blind", spread=2.0, pictures=("near",), words=False)
    policy = PolicyCma(str(folder))
    assert policy.name == "cma_blind"
    assert act(policy, "go to the sofa", range(8)) == act(policy, "", range(8))


def test_a_checkpoint_that_is_none_is_refused(near_checkpoint: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no checkpoint is named"):
        build_plugin("policy", "cma", {})
    with pytest.raises(CheckpointError, match="no such checkpoint"):
        PolicyCma(str(tmp_path / "nowhere"))
    for name, value, said in (("device", "tpu", "no device"), ("batch", -1, "batches of -1")):
        with pytest.raises(ConfigError, match=said):
            PolicyCma(str(near_checkpoint), **{name: value})
    broken = tmp_path / "broken"
    for missing in ("cma.json", "tokenizer.json", "model.safetensors"):
        shutil.rmtree(broken, ignore_errors=True)
        shutil.copytree(near_checkpoint, broken)
        (broken / missing).unlink()
        with pytest.raises(CheckpointError):
            PolicyCma(str(broken))


def _alter(near_checkpoint: Path, folder: Path, **fields) -> Path:
    shutil.copytree(near_checkpoint, folder)
    file = folder / "cma.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | fields))
    return folder


def test_weights_of_another_net_are_refused(near_checkpoint: Path, tmp_path: Path) -> None:
    wider = json.loads((near_checkpoint / "cma.json").read_text())["sizes"] | {"hidden": 48}
    for number, (fields, said) in enumerate((
        ({"graph": "seq2seq"}, "does not belong to this net"),
        ({"pictures": ["near", "far"]}, "is missing"),
        ({"sizes": wider}, "cma.json describes"),
        ({"vocabulary": 9}, "tokens, the net words for 9"),
        ({"preset": "none"}, "none"),
        ({"colour": 1}, "colour"),
    )):  # fmt: skip
        with pytest.raises(CheckpointError, match=said):
            load_cma_checkpoint(_alter(near_checkpoint, tmp_path / str(number), **fields))
    changed = tmp_path / "changed"
    shutil.copytree(near_checkpoint, changed)
    weights = load_cma_checkpoint(near_checkpoint).model.state_dict()
    weights["choose.bias"] = weights["choose.bias"] + 1
    write_shard(changed / "model.safetensors", weights)
    with pytest.raises(CheckpointError, match="its hash is not"):
        load_cma_checkpoint(changed)


def test_other_pictures_and_texts_than_trained_on_are_refused(near_checkpoint: Path) -> None:
    policy = PolicyCma(str(near_checkpoint))
    begin(policy, "go to the sofa")
    with pytest.raises(PolicyError, match=r"'near' is 128×128 px|'near' is 200×128 px"):
        policy.act_batch([0], [observe(0, size=100)])
    with pytest.raises(PolicyError, match="'near' is missing"):
        policy.act_batch([0], [Observation(0, 0.0, "")])
    with pytest.raises(PolicyError, match="slot 4"):
        policy.act_batch([4], [observe(0)])
    for text, said in (("x" * 10_000, "characters"), ("<FWD><STOP>", "says nothing"),
                       ("", "says nothing"), ("far " * 200, "40 are read")):  # fmt: skip
        with pytest.raises(ConfigError, match=said):
            policy.reset_batch([0], [text], [np.random.default_rng(0)])
