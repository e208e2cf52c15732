"""A batched environment and a stacked Q-network of a few lines: the trainer needs no dialogue."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import Tensor, nn
from torchrl.data import Binary, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase
from torchrl.objectives import HardUpdate

from bbq_torchrl.data import ReplicaReplay
from bbq_torchrl.networks import q_actor
from bbq_torchrl.objectives import DropoutDQNLoss
from bbq_torchrl.trainers import ReplicaAdam, RoundTrainer, Spike

if TYPE_CHECKING:
    from pathlib import Path

    from torchrl.modules import QValueActor

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
        self.replicas = torch.Size([replicas])
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


class CountingLoss(DropoutDQNLoss):
    """Remembers the numbers of data that it is told; the targets of its network are random."""

    has_fixed_targets = False

    def __init__(self, network: QValueActor) -> None:
        super().__init__(network, gamma=0.9)
        self.num_data: list[list[int]] = []

    def set_num_data(self, rows: Tensor) -> None:
        self.num_data.append(rows.tolist())


def random_policy(tensordict: TensorDictBase) -> TensorDictBase:
    """Guesses at once half of the time: the spike policy of these tests."""
    action = (torch.rand(tensordict.batch_size) < 0.5).long()
    return tensordict.set("action", action)


def never_guess(tensordict: TensorDictBase) -> TensorDictBase:
    """Waits for ever, so that no dialogue is a success."""
    return tensordict.set("action", torch.ones(tensordict.batch_size, dtype=torch.long))


SPIKE = Spike(random_policy, 5)


def make_trainer(
    folder: Path,
    *,
    replicas: int = 3,
    places: int = 8,
    capacity: int = 120,
    env: EnvBase | None = None,
    **given: Any,
) -> RoundTrainer:
    """Returns a trainer of tiny parts that learns for a few rounds."""
    env = GuessEnv(replicas, places) if env is None else env
    actor = q_actor(ReplicaLinearQ(replicas), env.action_spec_unbatched)
    explore = GreedyWithEpsilon()
    acts = TensorDictModule(explore, ["action_value", "action_mask"], ["action"])
    loss = CountingLoss(actor)
    own = {"rounds": 6, "dialogues": places, "batch_size": 16, "freezes": 2, "epochs": 2}
    own |= {"checkpoint_every": 2, "keep_checkpoints": 2, "spike": SPIKE}
    return RoundTrainer(
        env,
        TensorDictSequential(actor, acts),
        loss,
        ReplicaReplay(capacity, replicas=replicas),
        given.pop("optimizer", None) or ReplicaAdam(loss.parameters(), replicas, lr=1e-2),
        HardUpdate(loss, value_network_update_interval=0),
        folder,
        **{**own, **given},
        round_metrics={"epsilon": lambda: float(explore.epsilon)},
        progress=False,
    )
