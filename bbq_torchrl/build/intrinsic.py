"""A reward of the agent's own: the loss and the replay transform for each ``intrinsic=``."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch

from bbq_torchrl.build.values import over_replicas
from bbq_torchrl.config.intrinsic import IntrinsicConfig, VIMEConfig
from bbq_torchrl.data import VIMEReward
from bbq_torchrl.modules import DynamicsModel, reset_inactive_
from bbq_torchrl.objectives import DynamicsLoss, VIMELoss

if TYPE_CHECKING:
    from torchrl.envs import Transform
    from torchrl.objectives import LossModule

    from bbq_torchrl.build.parts import Surroundings

__all__ = ["with_intrinsic_reward"]


def with_intrinsic_reward(
    config: IntrinsicConfig, loss: LossModule, around: Surroundings
) -> tuple[LossModule, list[Transform]]:
    """Returns the loss that is learned, and what the replay buffer has to do for it.

    Args:
        config: an option of ``intrinsic``.
        loss: the agent's.
        around: what the dynamics model has to fit.
    """
    if not isinstance(config, VIMEConfig):
        return loss, []
    dynamics = DynamicsModel(
        around.inputs,
        around.spec.n,
        config.hidden,
        stack=around.stack,
        prior_std=config.prior_std,
        noise_std=config.noise_std,
        std_floor=config.std_floor,
        device=around.device,
    )
    if around.inactive_inputs is not None and around.inactive_actions is not None:
        # Of the outputs none: that a feature stays as it is can be learned before it appears.
        inactive = torch.cat([around.inactive_inputs, around.inactive_actions])
        reset_inactive_(dynamics.network, inputs=inactive)
    reward = VIMEReward(
        dynamics,
        eta=over_replicas(config.eta, around.replicas),
        weights=config.weights,  # type: ignore[arg-type]
        step_size=config.step_size,
        median_window=config.median_window,
        clip=config.clip,
    )
    joint = VIMELoss(loss, DynamicsLoss(dynamics), dynamics_every=config.dynamics_every)
    return joint, [reward]
