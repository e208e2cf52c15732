"""A finished run is loaded as environment, policy and configuration."""

from __future__ import annotations

import pytest
import torch
from tiny import TINY

from bbq_torchrl import load_run
from bbq_torchrl.cli.store import compose
from bbq_torchrl.evaluation.play import evaluate
from bbq_torchrl.evaluation.results import read_result
from bbq_torchrl.run import run

SMALL = (
    *TINY,
    "protocol.eval_dialogues=30",
    "protocol.eval_batch=60",
    "spike.policy=random",
    "env.max_turn=12",
    "replicas=2",
    "domain=folder",
)


@pytest.fixture(scope="module")
def folder(without_curves, restaurant_folder, tmp_path_factory):
    folder = tmp_path_factory.mktemp("loading") / "run"
    folder.mkdir()
    command = [*SMALL, "env=domain_ext", "env.start=1", f"domain.path={restaurant_folder}"]
    run(compose(command), folder)
    return folder


def test_it_plays_as_it_was_reported(folder):
    env, policy, config, mode = load_run(folder, dialogues=30)
    assert mode == "mean"
    played = evaluate(env, policy, 30, seed=config.seed)
    reported = [item.success_rate for item in read_result(folder).per_replica]
    assert played.success.double().mean(-1).tolist() == pytest.approx(reported)
    assert env.round == 1


def test_it_is_a_policy_for_the_environment(folder):
    loaded = load_run(folder, dialogues=3, mode="thompson", weights="best")
    rollout = loaded.env.rollout(4, loaded.policy, break_when_any_done=False)
    assert rollout.batch_size == torch.Size([2, 3, 4])
    assert loaded.mode == "thompson"


def test_what_is_no_run_is_refused(folder, tmp_path):
    with pytest.raises(ValueError, match="is not a run folder: there is no such folder"):
        load_run(tmp_path / "nowhere")
    with pytest.raises(ValueError, match=r"is not a run folder: it has no config\.yaml"):
        load_run(tmp_path)
    (tmp_path / "config.yaml").write_text((folder / "config.yaml").read_text())
    with pytest.raises(ValueError, match="has no checkpoint yet"):
        load_run(tmp_path)
