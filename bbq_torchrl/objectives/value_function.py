"""Calls an actor's Q-network with parameters handed in, on tensors."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch.func import functional_call
from torch.nn.modules.dropout import _DropoutNd

from bbq_torchrl.modules.weight_mode import set_weight_mode

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tensordict import TensorDictParams
    from tensordict.utils import NestedKey
    from torch import Tensor
    from torchrl.modules import QValueActor

    from bbq_torchrl.modules.weight_mode import WeightMode

__all__ = ["ValueFunction"]


class ValueFunction:
    """The network of a Q-value actor as a function of its parameters and of tensors.

    TorchRL's own way (parameters swapped in by ``to_module``, then the actor called on a
    TensorDict) costs as much as the matrix products of a small network; this one calls the
    network behind the actor's TensorDict module directly where it is a plain module.

    Args:
        actor: network and choice of the action.

    Attributes:
        in_keys: what the network reads.
        action_mask_key: where the actor reads the mask of legal actions, None if it has none.
    """

    def __init__(self, actor: QValueActor) -> None:
        self._head = actor[0]
        self._value_key = actor[-1].action_value_key
        self._plain = (
            type(self._head) is TensorDictModule
            and isinstance(self._head.module, torch.nn.Module)
            and len(self._head.out_keys) == 1
        )
        self._dropouts = [m for m in actor.modules() if isinstance(m, _DropoutNd)]
        self.in_keys: list[NestedKey] = list(self._head.in_keys)
        self.action_mask_key: NestedKey | None = actor[-1].action_mask_key

    def tensors(self, params: TensorDictParams) -> dict[str, Tensor]:
        """Returns the network's parameters and buffers by name.

        Args:
            params: of the whole actor.
        """
        prefix = ("module", "0", "module") if self._plain else ("module", "0")
        network = params.get(prefix, None)
        return {} if network is None else dict(network.flatten_keys(".").items())

    def __call__(
        self, tensors: dict[str, Tensor], inputs: Sequence[Tensor], mode: WeightMode
    ) -> Tensor:
        """Returns the values [*batch, N].

        Args:
            tensors: what :meth:`tensors` returned.
            inputs: the entries named in_keys.
            mode: "draw" (dropout on) or "mean" (dropout off).
        """
        for dropout in self._dropouts:
            dropout.training = mode != "mean"
        with set_weight_mode(mode):
            if self._plain:
                return functional_call(self._head.module, tensors, tuple(inputs))
            tensordict = TensorDict(dict(zip(self.in_keys, inputs, strict=True)))
            return functional_call(self._head, tensors, (tensordict,)).get(self._value_key)
