"""Calls an actor's Q-network with parameters handed in, on tensors."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch.nn.modules.dropout import _DropoutNd

from bbq_torchrl.bayes.weight_mode import set_weight_mode

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tensordict import TensorDictParams
    from tensordict.utils import NestedKey
    from torch import Tensor
    from torchrl.modules import QValueActor

    from bbq_torchrl.bayes.weight_mode import WeightMode

__all__ = ["ValueFunction"]


class ValueFunction:
    """The network of a Q-value actor as a function of its parameters and of tensors.

    TorchRL's own way (parameters swapped in by ``to_module``, then the actor called on a
    TensorDict) costs as much as the matrix products of a small network. This one swaps tensors
    in the modules that own them and calls the network behind the actor's TensorDict module.

    Args:
        actor: network and choice of the action.
        params: of the actor, as ``LossModule.convert_to_functional`` makes them; names the
            parameters and buffers that :meth:`__call__` expects.

    Attributes:
        in_keys: what the network reads.
        action_mask_key: where the actor reads the mask of legal actions, None if it has none.
    """

    def __init__(self, actor: QValueActor, params: TensorDictParams) -> None:
        self._head = actor[0]
        self._value_key = actor[-1].action_value_key
        self._is_plain = (
            type(self._head) is TensorDictModule
            and isinstance(self._head.module, torch.nn.Module)
            and len(self._head.out_keys) == 1
        )
        self._dropouts = [m for m in actor.modules() if isinstance(m, _DropoutNd)]
        self.in_keys: list[NestedKey] = list(self._head.in_keys)
        self.action_mask_key: NestedKey | None = actor[-1].action_mask_key
        self._keys: list[tuple[str, ...]] = []
        self._slots: list[tuple[dict[str, Tensor | None], str]] = []
        for key in params.keys(True, True):
            path = (key,) if isinstance(key, str) else tuple(key)
            owner = actor.get_submodule(".".join(path[:-1]))
            store = owner._parameters if path[-1] in owner._parameters else owner._buffers
            self._keys.append(path)
            self._slots.append((store, path[-1]))

    def tensors(self, params: TensorDictParams) -> list[Tensor]:
        """Returns the parameters and buffers that :meth:`__call__` takes.

        Args:
            params: of the actor.
        """
        return [params.get(key) for key in self._keys]

    def __call__(
        self, tensors: Sequence[Tensor], inputs: Sequence[Tensor], mode: WeightMode
    ) -> Tensor:
        """Returns the values [*batch, N].

        Args:
            tensors: what :meth:`tensors` returned.
            inputs: the entries named in_keys.
            mode: "draw" (dropout on) or "mean" (dropout off).
        """
        training = [dropout.training for dropout in self._dropouts]
        own = [store[name] for store, name in self._slots]
        try:
            for dropout in self._dropouts:
                dropout.training = mode != "mean"
            for (store, name), tensor in zip(self._slots, tensors, strict=True):
                store[name] = tensor
            with set_weight_mode(mode):
                if self._is_plain:
                    return self._head.module(*inputs)
                tensordict = TensorDict(dict(zip(self.in_keys, inputs, strict=True)))
                return self._head(tensordict).get(self._value_key)
        finally:
            for (store, name), previous in zip(self._slots, own, strict=True):
                store[name] = previous
            for dropout, was_training in zip(self._dropouts, training, strict=True):
                dropout.training = was_training
