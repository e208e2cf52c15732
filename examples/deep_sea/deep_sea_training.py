"""Training on DeepSea, until each replica has solved the sea."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from deep_sea_agents import Agent, Settings, default_settings, make_agent
from deep_sea_env import DeepSeaEnv
from deep_sea_results import Line
from tensordict import TensorDict, TensorDictBase
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.objectives import HardUpdate

from bbq_torchrl.objectives import BBQNLoss, GPLoss
from bbq_torchrl.trainers.learn import keep_freed_memory
from bbq_torchrl.utils.seeds import derive_seed

if TYPE_CHECKING:
    from tensordict import NestedKey
    from torch import Tensor

SOLVED_SHARE = 0.1
"""The share of all episodes so far that must have found the treasure."""


class DiveMemory:
    """The latest transitions of each replica, in one memory because all dives have N steps.

    Args:
        capacity: capacity in transitions of each replica.

    Examples:
        >>> memory = DiveMemory(6)
        >>> memory.extend(TensorDict({"observation": torch.eye(4).expand(2, 4, 4)}, [2, 4]))
        >>> memory.extend(TensorDict({"observation": torch.eye(4).expand(2, 4, 4)}, [2, 4]))
        >>> len(memory), memory.sample(32)["observation"].shape
        (6, torch.Size([2, 32, 4]))
    """

    def __init__(self, capacity: int) -> None:
        self.capacity = capacity
        self._rows: TensorDictBase | None = None
        self._written = 0

    def __len__(self) -> int:
        return min(self._written, self.capacity)

    def extend(self, rows: TensorDictBase) -> None:
        """Stores transitions [replicas, steps], replacing the oldest ones."""
        replicas, steps = rows.shape
        rows = rows.named_apply(_pack, nested_keys=True)
        if self._rows is None:
            self._rows = rows[:, :1].expand(replicas, self.capacity).clone()
        place = torch.arange(self._written, self._written + steps) % self.capacity
        self._rows[:, place] = rows
        self._written += steps

    def shuffled(self) -> TensorDictBase:
        """Returns all transitions [replicas, stored], in one random order."""
        assert self._rows is not None
        return self._rows[:, torch.randperm(len(self))].named_apply(_unpack, nested_keys=True)

    def sample(self, batch_size: int) -> TensorDictBase:
        """Returns transitions [replicas, batch_size], each replica's drawn with replacement."""
        assert self._rows is not None
        replica = torch.arange(self._rows.shape[0])[:, None]
        index = torch.randint(len(self), (self._rows.shape[0], batch_size))
        return self._rows[replica, index].named_apply(_unpack, nested_keys=True)


def _pack(name: NestedKey, value: Tensor) -> Tensor:
    # A one-hot row takes one byte per cell instead of four.
    return value.to(torch.uint8) if name in OBSERVATIONS else value


def _unpack(name: NestedKey, value: Tensor) -> Tensor:
    return value.float() if name in OBSERVATIONS else value


KEYS = (
    "observation",
    "action",
    ("next", "observation"),
    ("next", "reward"),
    ("next", "done"),
    ("next", "terminated"),
)
"""The entries stored of a transition."""

OBSERVATIONS = ("observation", ("next", "observation"))


@torch.no_grad()
def reaches_treasure(agent: Agent, env: DeepSeaEnv) -> Tensor:
    """Returns whether each replica's greedy policy finds the treasure, bool, shape [replicas].

    The only way to the treasure goes right in every cell of the diagonal, so the policy's actions
    in these N cells replace a dive.

    Args:
        agent: an agent of R replicas.
        env: an environment of batch size [R, 1].
    """
    size = env.size
    diagonal = torch.eye(size**2)[:: size + 1].expand(env.batch_size[0], size, -1)
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        td = agent.greedy(TensorDict({"observation": diagonal}, diagonal.shape[:-1]))
    best = env.right_action[:, 0].diagonal(dim1=-2, dim2=-1)
    return (td["action"] == best).all(-1)


def train(
    name: str,
    size: int,
    *,
    replicas: int,
    episodes: int,
    seed: int = 0,
    settings: Settings | None = None,
) -> list[Line]:
    """Trains replicas in parallel until all have solved the sea. Returns the results.

    A replica has solved the sea in the first episode after which (1) its greedy policy reaches
    the treasure and (2) at least a tenth of all its episodes so far have found it.

    Args:
        name: the agent's name.
        size: N.
        replicas: number of replicas. Replica r has the seed ``seed + r`` for its mapping of
            actions; all share the generator of learning.
        episodes: limit of episodes of each replica.
        seed: seed of the first replica.
        settings: settings of agent and training. Defaults to the agent's ``default_settings``.
    """
    settings = settings or default_settings(name)
    keep_freed_memory()
    # Two starts of one agent draw from the same seed.
    torch.manual_seed(derive_seed(seed, name.removesuffix("_zero"), size))
    env = DeepSeaEnv(size, (replicas, 1), mapping_seed=range(seed, seed + replicas))
    agent = make_agent(name, size, replicas, settings)
    optimizer = agent.make_optimizer(agent.loss.parameters(), replicas, lr=settings.lr)
    freeze = HardUpdate(agent.loss, value_network_update_interval=0)
    memory = DiveMemory(settings.capacity)
    treasures = torch.zeros(replicas, dtype=torch.int64)
    solved = torch.zeros(replicas, dtype=torch.int64)
    episode, updates, due = 0, 0, 0.0
    while episode < episodes and not bool(solved.all()):
        episode += 1
        agent.begin_dive()
        dive = _dive(env, agent)
        kept = dive.select(*KEYS)
        memory.extend(kept if agent.when_stored is None else agent.when_stored.inv(kept))
        treasures += dive["next", "treasure"].any(1).squeeze(-1)
        if isinstance(agent.loss, BBQNLoss):
            agent.loss.set_num_data(len(memory))
        if isinstance(agent.loss, GPLoss):
            agent.loss.fit(memory.shuffled())
        else:
            due += settings.updates_per_step * size
        while updates < due:
            optimizer.zero_grad()
            agent.loss(memory.sample(settings.batch_size))["loss"].backward()
            optimizer.step()
            updates += 1
            if updates % settings.freeze_every == 0:
                freeze.step()
        is_solved = reaches_treasure(agent, env) & (treasures >= SOLVED_SHARE * episode)
        solved[is_solved & (solved == 0)] = episode
    return [
        Line(name, size, seed + r, first or None, episode, count)
        for r, (first, count) in enumerate(zip(solved.tolist(), treasures.tolist(), strict=True))
    ]


@torch.no_grad()
def _dive(env: DeepSeaEnv, agent: Agent) -> TensorDictBase:
    """Returns one dive of each replica, batch size [replicas, N]."""
    with set_exploration_type(ExplorationType.RANDOM):
        rollout = env.rollout(env.size, agent.explore, trust_policy=True)
    return rollout.squeeze(1)
