"""An actor's Q-network as a function of parameters and input tensors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

from tensordict import TensorDictBase, TensorDictParams
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from tensordict.utils import NestedKey
from torch import Tensor, nn
from torch.nn.modules.dropout import _DropoutNd

from bbq_torchrl.bayes.posterior import GaussianPosterior
from bbq_torchrl.bayes.scope import WeightMode, weight_scope
from bbq_torchrl.networks.q_actor import split_actor

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
                values = self._values(inputs)
                if active.kl is not None:
                    for posterior in self._posteriors:
                        posterior.add_kl(active.kl)
            return values
        finally:
            for (store, name), previous in zip(self._slots, own, strict=True):
                store[name] = previous
            for dropout, was_training in zip(self._dropouts, training, strict=True):
                dropout.training = was_training

    def _values(self, inputs: Inputs) -> Tensor:
        values: Tensor
        if isinstance(inputs, TensorDictBase):
            values = self._network(inputs.copy()).get(self._value_key)
        else:
            values = self._network.module(*inputs)
        return values


def _zero_rows(entry: Tensor, rows: Tensor) -> Tensor:
    """Returns an entry [*batch, *features] with the rows of a bool mask [*batch] set to 0."""
    return entry.masked_fill(rows.reshape(rows.shape + (1,) * (entry.ndim - rows.ndim)), 0)
