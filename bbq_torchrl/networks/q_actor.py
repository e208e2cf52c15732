"""A Q-network as a TorchRL actor, and an actor's network as a function of parameters and inputs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, TypeAlias

import torch
import torch.nn.functional as F
from tensordict import TensorDictBase, TensorDictParams
from tensordict.nn import TensorDictModule, TensorDictModuleBase, TensorDictSequential
from tensordict.utils import NestedKey, unravel_key
from torch import Tensor, nn
from torch.nn.modules.dropout import _DropoutNd
from torchrl.data import Categorical, TensorSpec
from torchrl.modules import QValueActor

from bbq_torchrl.bayes.posterior import GaussianPosterior
from bbq_torchrl.bayes.scope import WeightMode, weight_scope


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


Inputs: TypeAlias = Sequence[Tensor] | TensorDictBase
"""Entries, or a TensorDict."""

_WITH_DROPOUT = (_DropoutNd, nn.RNNBase, nn.MultiheadAttention)  # by their training flags


class ValueFunction:
    """The network of a Q-value actor as a function of parameters and input tensors.

    TorchRL swaps parameters in with ``to_module`` and calls the actor on a TensorDict, which costs
    as much as the matrix products of a small network. This class swaps tensors in the modules that
    own them. It calls a network of a single module on tensors, and any other (several modules or
    outputs, a recurrent state) on a TensorDict.

    Args:
        actor: network and choice of the action, see
            :func:`~bbq_torchrl.networks.q_actor.split_actor`.
        params: the actor's parameters, as ``LossModule.convert_to_functional`` makes them; their
            keys name the parameters and buffers that :meth:`__call__` expects.
        value_key: the key of the values, if no module of the actor chooses by them.

    Attributes:
        in_keys: the entries that the network reads.
        action_mask_key: the key of the mask of legal actions, or None.
    """

    def __init__(
        self,
        actor: TensorDictModuleBase,
        params: TensorDictParams,
        value_key: NestedKey = "action_value",
    ) -> None:
        self._network, choice = split_actor(actor)
        self._value_key = value_key if choice is None else choice.action_value_key
        self._is_plain = (
            type(self._network) is TensorDictModule
            and isinstance(self._network.module, nn.Module)
            and len(self._network.out_keys) == 1
        )
        self._dropouts = [m for m in actor.modules() if isinstance(m, _WITH_DROPOUT)]
        self._posteriors = [m for m in actor.modules() if isinstance(m, GaussianPosterior)]
        self.in_keys: list[NestedKey] = list(self._network.in_keys)
        self.action_mask_key: NestedKey | None = getattr(choice, "action_mask_key", None)
        self._keys: list[tuple[str, ...]] = []
        self._slots: list[tuple[dict[str, Tensor | None], str]] = []
        for key in params.keys(True, True):
            path = (key,) if isinstance(key, str) else tuple(key)
            owner = actor.get_submodule(".".join(path[:-1]))
            store = owner._parameters if path[-1] in owner._parameters else owner._buffers
            self._keys.append(path)
            self._slots.append((store, path[-1]))

    def tensors(self, params: TensorDictParams) -> list[Tensor]:
        """Returns the parameters and buffers for :meth:`__call__`.

        Args:
            params: the actor's parameters.
        """
        return [params.get(key) for key in self._keys]

    def inputs(self, tensordict: TensorDictBase, ignored: Tensor | None = None) -> Inputs:
        """Returns the inputs of :meth:`__call__` from the states in a TensorDict [*batch].

        Args:
            tensordict: the states.
            ignored: bool [*batch], True for rows to replace by 0.
        """
        if self._is_plain:
            entries = [tensordict[key] for key in self.in_keys]
            return entries if ignored is None else [_zero_rows(entry, ignored) for entry in entries]
        found = tensordict.select(*self.in_keys, strict=False)
        return found if ignored is None else found.apply(lambda entry: _zero_rows(entry, ignored))

    def __call__(
        self, tensors: Sequence[Tensor], inputs: Inputs, mode: WeightMode, **scope: Any
    ) -> Tensor:
        """Returns the values [*batch, N].

        Args:
            tensors: the output of :meth:`tensors`.
            inputs: the output of :meth:`inputs`.
            mode: "draw" (dropout on) or "mean" (dropout off).
            scope: further arguments of :func:`~bbq_torchrl.bayes.weight_scope`. The KL includes
                all posteriors, even those whose layer does not draw through the scope.
        """
        training = [dropout.training for dropout in self._dropouts]
        own = [store[name] for store, name in self._slots]
        try:
            for dropout in self._dropouts:
                dropout.training = mode != "mean"
            for (store, name), tensor in zip(self._slots, tensors, strict=True):
                store[name] = tensor
            with weight_scope(mode, **scope) as active:
                if isinstance(inputs, TensorDictBase):
                    values = self._network(inputs.copy()).get(self._value_key)
                else:
                    values = self._network.module(*inputs)
                if active.kl is not None:
                    for posterior in self._posteriors:
                        posterior.add_kl(active.kl)
            return values
        finally:
            for (store, name), previous in zip(self._slots, own, strict=True):
                store[name] = previous
            for dropout, was_training in zip(self._dropouts, training, strict=True):
                dropout.training = was_training


def _zero_rows(entry: Tensor, rows: Tensor) -> Tensor:
    """Returns an entry [*batch, *features] with the rows of a bool mask [*batch] set to 0."""
    return entry.masked_fill(rows.reshape(rows.shape + (1,) * (entry.ndim - rows.ndim)), 0)
