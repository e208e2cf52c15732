"""What every agent's updates have in common: they wait for no device, targets hold for a freeze."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
import torch
from host_waits import NeverWaits, draw_as_on_a_device
from tiny import TINY

from bbq_torchrl.cli.store import compose
from bbq_torchrl.cli.training import build_trainer
from bbq_torchrl.options import Task

if TYPE_CHECKING:
    from pathlib import Path

    from tensordict import TensorDictBase

    from bbq_torchrl.options import Config
    from bbq_torchrl.trainers import RoundTrainer

SHRUNKEN = (
    *TINY,
    "protocol.batch_size=6",
    "protocol.epochs=1",
    "protocol.eval_every=0",
    "spike.policy=random",
    "env.max_turn=16",
    "replicas=3",
)
# Every loss, and both weights of VIME's dynamics; how an agent explores is no part of an update.
AGENTS = {
    **{
        name: (f"+experiment=agents/{name}",)
        for name in ("bbqn_map", "bbqn_mc", "bbqn_vime_mc", "dqn", "dqn_bootstrap", "dqn_vime_map")
    },
    "noisy_dqn": ("+experiment=baselines/noisy_dqn",),
    "double_dqn": ("+experiment=baselines/double_dqn",),
    "shared target noise": ("agent=bbqn", "agent.target=mc", "agent.target_noise=shared"),
    "sampled KL": ("agent=bbqn", "agent.kl=sampled"),
    "separate heads with priors": (
        "agent=bootstrap",
        "agent.trunk_layers=0",
        "agent.prior_scale=3",
        "agent.double=true",
    ),
    "dynamics now and then": ("agent=bbqn", "intrinsic=vime", "intrinsic.dynamics_every=3"),
}


def config_of(agent: str, domain: Path, *further: str) -> Config:
    return compose([*AGENTS[agent], *SHRUNKEN, *further, "domain=folder", f"domain.path={domain}"])


def make_trainer(config: Config, folder: Path) -> RoundTrainer:
    trainer, _ = build_trainer(config, folder)
    trainer.progress = False
    return trainer


@pytest.mark.parametrize("agent", AGENTS)
def test_a_rounds_updates_never_wait_and_find_all_on_their_device(
    agent, restaurant_folder, tmp_path, monkeypatch
):
    draw_as_on_a_device(monkeypatch)
    config = config_of(agent, restaurant_folder)
    trainer = make_trainer(config, tmp_path)
    trainer.begin()
    trainer.train_round()
    with NeverWaits():
        trainer.learner.update_all(1)

    trainer.learner.compute_targets()
    batch = trainer.replay.epoch(8)[0].transitions.to("meta")
    # Tensors on the device "meta" have no numbers: whatever asks for one, or mixes them with
    # tensors of the CPU, fails.
    env = trainer.env
    spec, device = env.action_spec_unbatched, torch.device("meta")
    task = Task(env.layout.size, spec, replicas=3, rounds=2, device=device)
    q_loss = config.agent.make_loss(config.agent.make_actor(task), task)
    loss, _ = config.intrinsic.make(q_loss, task)
    loss._has_update_associated.update(dict.fromkeys(loss._has_update_associated, True))
    if hasattr(loss, "set_num_data"):
        loss.set_num_data(10)
    with NeverWaits():
        loss(batch)["loss"].backward()
    gradients = [p.grad for p in loss.parameters() if p.requires_grad]
    assert {gradient.device for gradient in gradients} == {device}


def test_targets_computed_once_a_freeze_are_those_of_every_batch(
    restaurant_folder, tmp_path, monkeypatch
):
    config = config_of("dqn", restaurant_folder, "protocol.rounds=1")
    once, every = (make_trainer(config, tmp_path / name) for name in ("once", "every"))
    read: list[bool] = []
    forward = once.loss.forward

    def watched(batch: TensorDictBase) -> TensorDictBase:
        read.append(("next", "next_state_value") in batch.keys(include_nested=True))
        return forward(batch)

    monkeypatch.setattr(once.loss, "forward", watched)
    monkeypatch.setattr(every.learner, "compute_targets", lambda: None)

    rows, expected = once.train(), every.train()

    assert read
    assert all(read)
    pairs = zip(once.optimizer.parameters, every.optimizer.parameters, strict=True)
    for ours, theirs in pairs:
        torch.testing.assert_close(ours, theirs, rtol=1e-3, atol=1e-4)
    for ours, theirs in zip(rows, expected, strict=True):
        assert ours["loss"] == pytest.approx(theirs["loss"], rel=1e-3)
        assert ours["loss"] > 0
