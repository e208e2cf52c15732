"""The round trainer with the project's own environment, networks, exploration and losses."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
import torch
from tensordict.nn import TensorDictSequential
from torchrl.modules import EGreedyModule
from torchrl.objectives import HardUpdate

from bbq_torchrl.bayes import BayesMLP
from bbq_torchrl.data import ReplicaReplay
from bbq_torchrl.envs import DialogueEnv, ExtensionSchedule, scripted_policy
from bbq_torchrl.exploration import Boltzmann, Greedy, ThompsonSampling
from bbq_torchrl.networks import FlatMLP, q_actor
from bbq_torchrl.objectives import BBQNLoss, DropoutDQNLoss
from bbq_torchrl.trainers import ReplicaAdam, RoundSettings, RoundTrainer, SpikeSettings

if TYPE_CHECKING:
    from pathlib import Path

    from tensordict import TensorDictBase
    from torch import Tensor

    from bbq_torchrl.domains import Domain

HIDDEN = (12, 12)
AGENTS = {
    "BBQN-MAP, Thompson sampling a step": ("map", "closed", "step"),
    "BBQN-MC, Thompson sampling a dialogue": ("mc", "closed", "episode"),
    "BBQN-MAP, sampled KL, Thompson sampling a round": ("map", "sampled", "round"),
    "DQN with dropout, epsilon-greedy": ("epsilon",),
    "DQN with dropout, Boltzmann": ("boltzmann",),
}


def make_trainer(domain: Domain, agent: str, folder: Path, rounds: int = 3) -> RoundTrainer:
    torch.manual_seed(0)
    replicas = 3
    schedule = ExtensionSchedule(start=1, every=1)
    env = DialogueEnv(domain, batch_size=(replicas, 6), schedule=schedule, seed=0)
    spec = env.action_spec_unbatched
    features = env.observation_spec["observation"].shape[-1]
    kind = AGENTS[agent]
    if len(kind) == 3:
        target, kl, per = kind
        actor = q_actor(BayesMLP(features, spec.n, HIDDEN, replicas=(replicas,)), spec)
        loss = BBQNLoss(actor, target=target, kl=kl, hold=per != "step")
        policy = ThompsonSampling(actor, per=per)
    else:
        actor = q_actor(FlatMLP(features, spec.n, HIDDEN, replicas=(replicas,), dropout=0.5), spec)
        loss = DropoutDQNLoss(actor)
        explore = (
            EGreedyModule(spec, 0.5, 0.1, annealing_num_steps=4, action_mask_key="action_mask")
            if kind == ("epsilon",)
            else Boltzmann(1.0, 0.1, 4)
        )
        policy = TensorDictSequential(Greedy(actor), explore)
    return RoundTrainer(
        env,
        policy,
        loss,
        ReplicaReplay(300, replicas=replicas),
        ReplicaAdam(loss.parameters(), replicas),
        HardUpdate(loss, value_network_update_interval=0),
        RoundSettings(rounds=rounds, dialogues=6, batch_size=32, checkpoint_every=1),
        folder,
        spike_policy=scripted_policy("random", env),
        spike=SpikeSettings(dialogues=4),
        progress=False,
    )


def weights(trainer: RoundTrainer) -> list[Tensor]:
    return [parameter.detach().clone() for parameter in trainer.optimizer.parameters]


@pytest.mark.parametrize("agent", AGENTS)
def test_what_one_replica_does_leaves_the_others_bitwise_alone(restaurant, tmp_path, agent):
    plain = make_trainer(restaurant, agent, tmp_path / "plain")
    changed = make_trainer(restaurant, agent, tmp_path / "changed")
    with torch.no_grad():
        changed.optimizer.parameters[0][0] += torch.randn_like(changed.optimizer.parameters[0][0])

    plain.train()
    changed.train()

    for ours, theirs in zip(weights(plain), weights(changed), strict=True):
        assert torch.equal(ours[1:], theirs[1:])
        assert not torch.equal(ours[0], theirs[0])
    for ours, theirs in zip(plain.metrics.rows, changed.metrics.rows, strict=True):
        assert (ours["loss"] == theirs["loss"]) == (ours["replica"] > 0)


def test_the_weight_of_the_kl_follows_each_replicas_buffer(restaurant, tmp_path):
    trainer = make_trainer(restaurant, "BBQN-MAP, Thompson sampling a step", tmp_path, rounds=1)

    rows = trainer.train()

    assert trainer.loss.num_data.tolist() == [row["buffer"] for row in rows]


def test_targets_computed_once_a_freeze_are_those_of_every_batch(restaurant, tmp_path, monkeypatch):
    agent = "DQN with dropout, Boltzmann"
    once = make_trainer(restaurant, agent, tmp_path / "once", rounds=1)
    every = make_trainer(restaurant, agent, tmp_path / "every", rounds=1)
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
    for ours, theirs in zip(weights(once), weights(every), strict=True):
        torch.testing.assert_close(ours, theirs, rtol=1e-3, atol=1e-4)
    for ours, theirs in zip(rows, expected, strict=True):
        assert ours["loss"] == pytest.approx(theirs["loss"], rel=1e-3)
