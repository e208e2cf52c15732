"""The weights that each replica had when it did best."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

if TYPE_CHECKING:
    from collections.abc import Mapping

    from torch import nn


class BestWeights:
    """Keeps a copy of a policy's weights, for each replica as they were at its best.

    It is part of a checkpoint (``state_dict``), so that a resumed training knows the best of the
    rounds before.

    Args:
        policy: its parameters are [replicas, *]; its buffers do not change.
        replicas: the number of replicas.

    Attributes:
        round: of each replica's best, int64 [replicas]; -1 before the first.
        success_rate: what it was, float64 [replicas].

    Examples:
        >>> import torch
        >>> policy = torch.nn.Module()
        >>> policy.weight = torch.nn.Parameter(torch.tensor([[1.0], [1.0]]))
        >>> best = BestWeights(policy, replicas=2)
        >>> best.update(0, torch.tensor([0.3, 0.5]))
        >>> _ = torch.nn.init.constant_(policy.weight, 2.0)
        >>> best.update(1, torch.tensor([0.4, 0.2]))
        >>> best.put_back()
        >>> policy.weight.tolist(), best.round.tolist()
        ([[2.0], [1.0]], [1, 0])
    """

    def __init__(self, policy: nn.Module, replicas: int) -> None:
        self.round = torch.full((replicas,), -1)
        self.success_rate = torch.zeros(replicas, dtype=torch.float64)
        self._policy = policy
        self._weights: dict[str, Tensor] = _weights(policy)

    def update(self, round_number: int, success_rate: Tensor, *, since: int = 0) -> None:
        """Copies the weights of the replicas that never did better.

        Args:
            round_number: the round that the policy is of.
            success_rate: how each replica did, [replicas].
            since: a best from before this round does not count any more.
        """
        rate = success_rate.double().cpu()
        better = (rate > self.success_rate) | (self.round < since)
        self.round = torch.where(better, round_number, self.round)
        self.success_rate = torch.where(better, rate, self.success_rate)
        for name, now in _weights(self._policy).items():
            kept = self._weights[name]
            kept[better.to(kept.device)] = now[better.to(now.device)]

    def put_back(self) -> None:
        """Gives the policy its best weights.

        Raises:
            ValueError: if there are none yet.
        """
        if bool((self.round < 0).any()):
            raise ValueError("there are no best weights before the first evaluation while training")
        self._policy.load_state_dict(self._weights, strict=False)

    def state_dict(self) -> dict[str, Any]:
        """Returns rounds, success rates and weights."""
        return {
            "round": self.round,
            "success_rate": self.success_rate,
            "weights": dict(self._weights),
        }

    def load_state_dict(self, state_dict: Mapping[str, Any]) -> None:
        """Restores what :meth:`state_dict` returned."""
        self.round = state_dict["round"].clone()
        self.success_rate = state_dict["success_rate"].clone()
        saved = state_dict["weights"]
        # Saved before a policy had its actor's names: then they were below "actor".
        saved = {name.removeprefix("actor."): weight for name, weight in saved.items()} | saved
        for name, kept in self._weights.items():
            kept.copy_(saved[name])


def _weights(policy: nn.Module) -> dict[str, Tensor]:
    """Returns copies of a policy's parameters by name."""
    return {name: weight.detach().clone() for name, weight in policy.named_parameters()}
