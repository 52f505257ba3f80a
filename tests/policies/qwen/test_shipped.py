"""`--policy bae` alone loads the policy in the box, wherever GN0 was installed from."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from gn0.errors import CheckpointError
from gn0.plugins import build_plugin
from gn0.policies.bae.policy_bae import PolicyBae
from gn0.policies.bae.shipped import SHIPPED, find_checkpoint
from gn0_trials.random_policy import write_random_policy


@pytest.fixture(scope="module")
def policy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_random_policy(tmp_path_factory.mktemp("policy"))


@pytest.fixture(autouse=True)
def nothing_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("GN0_POLICY", raising=False)


def test_a_checkout_has_it_beside_the_source_and_a_wheel_inside(
    policy: Path, tmp_path: Path
) -> None:
    package = tmp_path / "src" / "gn0"
    beside = shutil.copytree(policy, tmp_path / "release" / SHIPPED)
    assert find_checkpoint(package=package) == find_checkpoint("bae", package=package) == beside
    inside = shutil.copytree(policy, package / "release" / SHIPPED)
    assert find_checkpoint(package=package) == inside


def test_the_environment_and_a_path_come_first(
    policy: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GN0_POLICY", str(policy))
    assert find_checkpoint() == policy
    found = build_plugin("policy", "bae", {"backend": "numpy"})
    assert isinstance(found, PolicyBae)
    named = PolicyBae(str(policy), backend="numpy")
    assert found.identity() == named.identity()
    assert find_checkpoint(str(policy.parent)) == policy.parent


@pytest.mark.parametrize("named", ["", "elsewhere"])
def test_without_weights_it_says_where_to_get_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, named: str
) -> None:
    if named:
        monkeypatch.setenv("GN0_POLICY", str(tmp_path / named))
    with pytest.raises(CheckpointError) as caught:
        find_checkpoint(package=tmp_path / "src" / "gn0")
    assert caught.value.code == "CHECKPOINT"
    assert f"release/{SHIPPED}" in caught.value.remedy and "GN0_POLICY" in caught.value.remedy


def test_a_shard_that_changed_is_refused(policy: Path, tmp_path: Path) -> None:
    it = shutil.copytree(policy, tmp_path / "it")
    (it / "shards.json").write_text('{"model.safetensors": "0"}', "utf-8")
    with pytest.raises(CheckpointError, match="its hash"):
        PolicyBae(str(it), backend="numpy")
