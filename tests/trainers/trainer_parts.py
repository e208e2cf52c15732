"""A batched environment and a stacked Q-network of a few lines: the trainer needs no dialogue."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.data import Binary, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase
from torchrl.objectives import HardUpdate, LossModule

from bbq_torchrl.data import ReplicaReplay
from bbq_torchrl.trainers import (
    BestWeights,
    ReplicaAdam,
    RoundSettings,
    RoundTrainer,
    SpikeSettings,
)

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from torchrl.record.loggers import Logger

    from bbq_torchrl.trainers import Policy, RoundCallback

FEATURES, ACTIONS = 6, 4


class GuessEnv(EnvBase):
    """The last action of `ACTIONS` is masked, action 0 ends an episode, the hint tells if well.

    An episode also ends after `limit` turns, so episodes have different lengths. Success: action 0
    where the hint (feature 0) is 1. The hint is redrawn every turn.
    """

    def __init__(self, replicas: int, places: int, limit: int = 7, seed: int = 0) -> None:
        super().__init__(batch_size=[replicas, places])
        shape = torch.Size([replicas, places])
        self.limit = limit
        self.observation_spec = Composite(
            observation=Unbounded((*shape, FEATURES)),
            action_mask=Binary(ACTIONS, shape=(*shape, ACTIONS), dtype=torch.bool),
            success=Binary(1, shape=(*shape, 1), dtype=torch.bool),
            shape=shape,
        )
        self.action_spec = Categorical(ACTIONS, shape=shape)
        self.reward_spec = Unbounded((*shape, 1))
        self.generator = torch.Generator()
        self.rounds_seen: list[int] = []
        self.set_seed(seed)

    def _set_seed(self, seed: int | None) -> None:
        assert seed is not None
        self.generator.manual_seed(seed)

    def set_round(self, round_number: int) -> None:
        self.rounds_seen.append(round_number)

    def _observe(self) -> TensorDict:
        noise = torch.rand(*self.batch_size, FEATURES, generator=self.generator)
        noise[..., 0] = (noise[..., 0] < 0.5).float()
        self.hint = noise[..., :1] > 0
        mask = torch.ones(*self.batch_size, ACTIONS, dtype=torch.bool)
        mask[..., -1] = False
        return TensorDict({"observation": noise, "action_mask": mask}, self.batch_size)

    def _reset(self, tensordict: TensorDictBase | None) -> TensorDictBase:
        self.count = torch.zeros(*self.batch_size, 1, dtype=torch.long)
        false = torch.zeros(*self.batch_size, 1, dtype=torch.bool)
        state = self._observe()
        return state.update({"success": false, "done": false, "terminated": false.clone()})

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        guessed = tensordict["action"].unsqueeze(-1) == 0
        success = guessed & self.hint
        self.count = self.count + 1
        done = guessed | (self.count >= self.limit)
        reward = torch.where(success, 4.0, torch.where(done, -1.0, -0.1))
        values = {"success": success, "done": done, "terminated": done.clone(), "reward": reward}
        return self._observe().update(values)


class ReplicaLinearQ(nn.Module):
    """Q-values of R linear networks, and a bit of noise that comes from the global generator."""

    def __init__(self, replicas: int) -> None:
        super().__init__()
        generator = torch.Generator().manual_seed(1)
        start = torch.randn(replicas, FEATURES, ACTIONS, generator=generator)
        self.weight = nn.Parameter(0.1 * start)

    def forward(self, observation: Tensor) -> Tensor:
        noise = 1 + 0.1 * torch.randn_like(self.weight)
        return observation @ (self.weight * noise)


class GreedyWithEpsilon(nn.Module):
    """Acts at random with a probability that halves at every step of its schedule."""

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("epsilon", torch.tensor(0.8))
        self.resampled = 0

    def step(self, rounds: int) -> None:
        self.epsilon *= 0.5**rounds

    def resample(self) -> None:
        self.resampled += 1

    def forward(self, value: Tensor, mask: Tensor) -> Tensor:
        noise = (
            torch.rand(value.shape) * 1e3 * (torch.rand(value.shape[:-1]) < self.epsilon)[..., None]
        )
        return (value + noise).masked_fill(~mask, -torch.inf).argmax(-1)


class QPolicy(nn.Module):
    def __init__(self, network: TensorDictModule) -> None:
        super().__init__()
        self.network = network
        self.explore = GreedyWithEpsilon()

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        value = self.network(tensordict)["action_value"]
        return tensordict.set("action", self.explore(value, tensordict["action_mask"]))


class ReplicaQLoss(LossModule):
    """Squared TD error, a mean over each replica's valid rows, summed over the replicas."""

    value_network: TensorDictModule
    value_network_params: TensorDictBase
    target_value_network_params: TensorDictBase

    def __init__(self, network: TensorDictModule) -> None:
        super().__init__()
        self.convert_to_functional(network, "value_network", create_target_params=True)
        self.num_data: list[list[int]] = []

    def set_num_data(self, rows: Tensor) -> None:
        self.num_data.append(rows.tolist())

    def forward(self, batch: TensorDictBase) -> TensorDictBase:
        with self.value_network_params.to_module(self.value_network):
            value = self.value_network(batch.select("observation"))["action_value"]
        chosen = value.gather(-1, batch["action"].unsqueeze(-1)).squeeze(-1)
        after = batch["next"]
        with torch.no_grad(), self.target_value_network_params.to_module(self.value_network):
            best = self.value_network(after.select("observation"))["action_value"]
            best = best.masked_fill(~after["action_mask"], -torch.inf).amax(-1)
        going = ~after["terminated"].squeeze(-1)
        target = after["reward"].squeeze(-1) + 0.9 * torch.where(going, best, 0.0)
        valid = batch["valid"]
        squared = torch.where(valid, (chosen - target) ** 2, 0.0).sum(-1)
        loss_value = squared / valid.sum(-1)
        q_value = torch.where(valid, chosen, 0.0).sum(-1) / valid.sum(-1)
        return TensorDict(
            {
                "loss": loss_value.sum(),
                "loss_value": loss_value.detach(),
                "q_value": q_value.detach(),
            }
        )


class GivenRates:
    """An evaluator that finds the given success rates, round by round, and disturbs what it may."""

    def __init__(self, network: nn.Module, rates: Sequence[Sequence[float]]) -> None:
        self.rates = rates
        self.best = BestWeights(network, len(rates[0]))

    def __call__(self, round_number: int) -> dict[str, Tensor]:
        torch.randn(round_number + 7)  # the global generator is not the training's
        rates = torch.tensor(self.rates[round_number], dtype=torch.float64)
        self.best.update(round_number, rates)
        return {"eval_success_rate": rates}


def random_policy(tensordict: TensorDictBase) -> TensorDictBase:
    """Guesses at once half of the time: the spike policy of these tests."""
    action = (torch.rand(tensordict.batch_size) < 0.5).long()
    return tensordict.set("action", action)


def never_guess(tensordict: TensorDictBase) -> TensorDictBase:
    """Waits for ever, so that no dialogue is a success."""
    return tensordict.set("action", torch.ones(tensordict.batch_size, dtype=torch.long))


def make_trainer(
    folder: Path,
    *,
    replicas: int = 3,
    places: int = 8,
    capacity: int = 120,
    env: EnvBase | None = None,
    spike: SpikeSettings | None = None,
    spike_policy: Policy | None = random_policy,
    rates: Sequence[Sequence[float]] | None = None,
    loggers: Sequence[Logger] = (),
    callbacks: Sequence[RoundCallback] = (),
    **settings: float,
) -> RoundTrainer:
    """Returns a trainer of tiny parts that learns for a few rounds."""
    network = TensorDictModule(
        ReplicaLinearQ(replicas), in_keys=["observation"], out_keys=["action_value"]
    )
    policy = QPolicy(network)
    loss = ReplicaQLoss(network)
    own = {"rounds": 6, "dialogues": places, "batch_size": 16, "checkpoint_every": 2}
    return RoundTrainer(
        GuessEnv(replicas, places) if env is None else env,
        policy,
        loss,
        ReplicaReplay(capacity, replicas=replicas),
        ReplicaAdam(loss.parameters(), replicas, lr=1e-2),
        HardUpdate(loss, value_network_update_interval=0),
        RoundSettings(**{**own, **settings}),
        folder,
        spike_policy=spike_policy,
        spike=spike if spike is not None else SpikeSettings(dialogues=5),
        round_metrics={"epsilon": lambda: float(policy.explore.epsilon)},
        progress=False,
        evaluator=None if rates is None else GivenRates(network, rates),
        loggers=loggers,
        callbacks=callbacks,
    )
