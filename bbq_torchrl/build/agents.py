"""An agent: network, loss, exploration and, if asked for, a reward of its own."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import torch
from torchrl.envs import Compose

from bbq_torchrl.build.exploration import exploring_policy
from bbq_torchrl.build.intrinsic import with_intrinsic_reward
from bbq_torchrl.build.parts import Evaluation, Surroundings, agent_parts
from bbq_torchrl.trainers import derive_seed

if TYPE_CHECKING:
    from collections.abc import Callable

    from tensordict.nn import TensorDictModuleBase
    from torch import Tensor
    from torchrl.envs import Transform
    from torchrl.objectives import LossModule

    from bbq_torchrl.config.schema import Config
    from bbq_torchrl.envs import DialogueEnv

__all__ = ["Agent", "build_agent"]


@dataclass
class Agent:
    """What learns and acts.

    Attributes:
        policy: acts with exploration.
        loss: what is learned.
        evaluation: a mode (or None for the agent's own) to the name of the policy that is to be
            reported, and that policy.
        gauges: what of the exploration is worth a column of the metrics; one number, or
            [replicas].
        transform: what the replay buffer does to transitions, if anything.
    """

    policy: TensorDictModuleBase
    loss: LossModule
    evaluation: Callable[[str | None], Evaluation]
    gauges: dict[str, Callable[[], float | Tensor]] = field(default_factory=dict)
    transform: Transform | None = None


def build_agent(config: Config, env: DialogueEnv) -> Agent:
    """Makes networks, exploration and loss; the weights start from the run's seed."""
    torch.manual_seed(derive_seed(config.seed, "init"))
    spec = env.action_spec_unbatched
    extends = env.schedule is not None
    around = Surroundings(
        inputs=env.layout.size,
        spec=spec,
        stack=(config.replicas,),
        inactive_inputs=~env.active_features if extends else None,
        inactive_actions=~env.simulator.action_mask(env.active_slots) if extends else None,
        device=env.device,
    )
    parts = agent_parts(config.agent, around)
    policy, gauges = exploring_policy(
        config.explore, parts, spec, config.replicas, config.protocol.rounds
    )
    loss, transforms = with_intrinsic_reward(config.intrinsic, parts.loss, around)
    transforms = [*parts.transforms, *transforms]
    return Agent(
        policy.to(env.device),
        loss.to(env.device),
        parts.evaluation,
        gauges,
        Compose(*transforms).to(env.device) if transforms else None,
    )
