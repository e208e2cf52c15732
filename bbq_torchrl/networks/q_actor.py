"""A Q-network as a TorchRL actor."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import torch
import torch.nn.functional as F
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase, TensorDictSequential
from tensordict.utils import NestedKey, unravel_key
from torch import Tensor, nn
from torchrl.data import Categorical, TensorSpec
from torchrl.modules import QValueActor


def q_actor(
    network: nn.Module,
    spec: TensorSpec,
    *,
    in_keys: Sequence[NestedKey] = ("observation",),
    action_mask_key: NestedKey | None = "action_mask",
    action_key: NestedKey = "action",
    action_value_key: NestedKey = "action_value",
) -> QValueActor:
    """Returns an actor that takes the legal action with the highest value.

    Args:
        network: maps the observation [*batch, F] to values [*batch, N].
        spec: the spec of one action, without batch dimensions (``env.action_spec_unbatched``).

    Keyword Args:
        in_keys: the entries that the network reads. Defaults to ("observation",).
        action_mask_key: bool [*batch, N], True for legal actions; None for no mask.
        action_key: the action's key, "action" or a nested key that ends in it.
        action_value_key: the values' key; illegal actions get the lowest finite float.

    Raises:
        ValueError: for any other action_key, with which TorchRL would not find the spec, or a spec
            with batch dimensions.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from torchrl.data import Categorical
        >>> from bbq_torchrl.bayes import BayesMLP
        >>> from bbq_torchrl.networks import q_actor
        >>> actor = q_actor(BayesMLP(3, 4, mean_init="zero"), Categorical(4))
        >>> td = TensorDict(observation=torch.ones(2, 3), batch_size=[2])
        >>> td["action_mask"] = torch.tensor([[False, True, True, True]] * 2)
        >>> actor(td)["action"]
        tensor([1, 1])
    """
    if unravel_key(("", action_key))[-1] != "action":
        raise ValueError(f"action_key must be 'action' or end in it, got {action_key!r}")
    check_spec_of_one_action(spec)
    actor = QValueActor(
        network,
        in_keys=list(in_keys),
        spec=spec,
        action_key=action_key,
        action_value_key=action_value_key,
        action_mask_key=action_mask_key,
    )
    # TorchRL's function marks every action of the highest value: several, if all values are 0.
    actor[-1].action_func_mapping["one_hot"] = _one_hot
    return actor


def check_spec_of_one_action(spec: TensorSpec) -> None:
    """Raises ValueError for a spec of a batch of action indices."""
    if isinstance(spec, Categorical) and spec.shape not in ((), (1,)):
        raise ValueError(
            "spec must be that of one action, env.action_spec_unbatched, got shape "
            f"{list(spec.shape)}"
        )


def _one_hot(values: Tensor) -> Tensor:
    return F.one_hot(values.argmax(-1), values.shape[-1])


def legal_actions(tensordict: TensorDictBase, key: NestedKey | None) -> Tensor | None:
    """Returns the mask of legal actions, bool [*batch, N]; None without a key.

    Raises:
        KeyError: if the mask is missing.
    """
    if key is None:
        return None
    mask: Tensor | None = tensordict.get(key, None)
    if mask is None:
        raise KeyError(
            f"{key!r} is missing, the mask of legal actions; if every action is always legal, make "
            "actor and exploration with action_mask_key=None"
        )
    return mask


def masked(values: Tensor, mask: Tensor | None) -> Tensor:
    """Returns values [*batch, N] with the lowest float at illegal actions, as TorchRL does.

    Args:
        values: the values of all actions, [*batch, N].
        mask: bool [*batch, N], True for legal actions; None if all are.
    """
    if mask is None:
        return values
    return torch.where(mask, values, torch.finfo(values.dtype).min)


def split_actor(
    actor: TensorDictModuleBase,
) -> tuple[TensorDictModuleBase, TensorDictModuleBase | None]:
    """Splits an actor into the network that writes values and the module that chooses an action.

    Args:
        actor: a ``QValueActor``, or any ``TensorDictSequential`` of modules (convolutional,
            recurrent, nested) that includes a ``QValueModule`` or
            :class:`~bbq_torchrl.networks.bootstrap.VoteModule`; modules after that are left out.

    Returns:
        the network and the choosing module, not copies; the whole actor and None if no module
        chooses.

    Examples:
        >>> from tensordict.nn import TensorDictModule, TensorDictSequential
        >>> from torch import nn
        >>> from torchrl.modules import QValueModule
        >>> from bbq_torchrl.networks.q_actor import split_actor
        >>> trunk = TensorDictModule(nn.Linear(3, 8), ["observation"], ["hidden"])
        >>> head = TensorDictModule(nn.Linear(8, 4), ["hidden"], ["action_value"])
        >>> choice = QValueModule(action_space="categorical")
        >>> network, chooses = split_actor(TensorDictSequential(trunk, head, choice))
        >>> network.in_keys, chooses is choice
        (['observation'], True)
    """
    modules = list(_parts(actor))
    for number, module in enumerate(modules):
        if hasattr(module, "action_value_key") and hasattr(module, "action_mask_key"):
            network = modules[:number]
            return network[0] if number == 1 else TensorDictSequential(*network), module
    return actor, None


def _parts(module: TensorDictModuleBase) -> Iterator[TensorDictModuleBase]:
    """Yields the modules of a sequence in order, including nested ones."""
    if isinstance(module, TensorDictSequential):
        for part in module.module:
            yield from _parts(part)
    else:
        yield module
