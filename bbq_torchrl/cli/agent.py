"""An agent: network, loss, exploration and, if asked for, a reward of its own."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import torch
from torchrl.envs import Compose

from bbq_torchrl.options import Task
from bbq_torchrl.options.task import action_mask_key
from bbq_torchrl.trainers import derive_seed

if TYPE_CHECKING:
    from collections.abc import Callable

    from tensordict.nn import TensorDictModuleBase
    from torch import Tensor
    from torchrl.envs import EnvBase, Transform
    from torchrl.modules import QValueActor
    from torchrl.objectives import LossModule

    from bbq_torchrl.domains import Domain
    from bbq_torchrl.options import Config, EvaluateConfig
    from bbq_torchrl.trainers import ReplicaOptimizer

__all__ = ["Agent", "make_agent", "make_domain", "task_of"]


@dataclass
class Agent:
    """What learns and acts.

    Attributes:
        actor: the Q-network and its choice of an action.
        loss: what is learned.
        optimizer: moves the loss's parameters.
        policy: acts with exploration.
        metrics: what of the exploration is worth a column of the metrics; one number, or
            [replicas].
        transform: what the replay buffer does to transitions, if anything.
    """

    actor: QValueActor
    loss: LossModule
    optimizer: ReplicaOptimizer
    policy: TensorDictModuleBase
    metrics: dict[str, Callable[[], float | Tensor]] = field(default_factory=dict)
    transform: Transform | None = None


def make_domain(config: Config | EvaluateConfig) -> Domain | None:
    """Loads the domain of a configuration; None where its environment has none.

    Raises:
        ValueError or OSError: the corpus is damaged or not there.
    """
    return config.domain.make() if config.env.has_domain else None


def task_of(config: Config, env: EnvBase) -> Task:
    """Returns what the agent has to fit."""
    inputs, actions = config.env.inactive(env) or (None, None)
    return Task(
        inputs=env.observation_spec["observation"].shape[-1],
        action_spec=env.action_spec_unbatched,
        replicas=config.replicas,
        rounds=config.protocol.rounds,
        device=env.device,
        action_mask_key=action_mask_key(env),
        inactive_inputs=inputs,
        inactive_actions=actions,
    )


def make_agent(config: Config, env: EnvBase) -> Agent:
    """Makes networks, loss and exploration; the weights start from the run's seed."""
    torch.manual_seed(derive_seed(config.seed, "init"))
    task = task_of(config, env)
    actor = config.agent.make_actor(task)
    loss = config.agent.make_loss(actor, task)
    policy, metrics = config.explore.make(actor, config.agent.make_greedy(actor), task)
    loss, transforms = config.intrinsic.make(loss, task)
    transforms = [*config.agent.make_transforms(task), *transforms]
    loss = loss.to(env.device)
    return Agent(
        actor,
        loss,
        config.agent.make_optimizer(actor, loss.parameters(), task),
        policy.to(env.device),
        metrics,
        Compose(*transforms).to(env.device) if transforms else None,
    )
