"""A Q-network as a TorchRL actor."""

from __future__ import annotations

from typing import TYPE_CHECKING

from torchrl.modules import QValueActor

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tensordict.utils import NestedKey
    from torch import nn
    from torchrl.data import TensorSpec

__all__ = ["q_actor"]


def q_actor(
    network: nn.Module,
    spec: TensorSpec,
    *,
    in_keys: Sequence[NestedKey] = ("observation",),
    action_mask_key: NestedKey | None = "action_mask",
    action_key: NestedKey = "action",
    action_value_key: NestedKey = "action_value",
) -> QValueActor:
    """Returns an actor that takes the legal action of greatest value.

    Args:
        network: maps the observation [*batch, F] to values [*batch, N].
        spec: of one action, without batch dimensions (``env.action_spec_unbatched``).

    Keyword Args:
        in_keys: what the network reads. Defaults to ("observation",).
        action_mask_key: bool [*batch, N], True for actions that may be taken; None for no mask.
        action_key: where the action goes.
        action_value_key: where the values go; forbidden actions have the least float there.

    Example:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from torchrl.data import Categorical
        >>> from bbq_torchrl.bayes import BayesMLP
        >>> from bbq_torchrl.networks import q_actor
        >>> actor = q_actor(BayesMLP(3, 4), Categorical(4))
        >>> td = TensorDict(observation=torch.ones(2, 3), batch_size=[2])
        >>> td["action_mask"] = torch.tensor([[False, True, True, True]] * 2)
        >>> actor(td)["action"]
        tensor([1, 1])
    """
    return QValueActor(
        network,
        in_keys=list(in_keys),
        spec=spec,
        action_key=action_key,
        action_value_key=action_value_key,
        action_mask_key=action_mask_key,
    )
