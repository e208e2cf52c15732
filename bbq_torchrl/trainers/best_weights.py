"""The weights of each replica at its best evaluation."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

if TYPE_CHECKING:
    from collections.abc import Mapping

    from torch import nn


class BestWeights:
    """Stores a copy of a policy's weights for each replica at its best evaluation.

    Checkpoints include it (``state_dict``), so a resumed training run knows the best of earlier
    rounds.

    Args:
        policy: a policy with parameters [replicas, *] and constant buffers.
        replicas: the number of replicas.

    Attributes:
        round: the round of each replica's best evaluation, int64 [replicas]; -1 before the first.
        success_rate: the success rate in that round, float64 [replicas].

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
        """Copies the weights of replicas with a new best success rate.

        Args:
            round_number: the policy's round.
            success_rate: the success rate of each replica, [replicas].
            since: the first round that counts; an earlier best is replaced.
        """
        rate = success_rate.double().cpu()
        better = (rate > self.success_rate) | (self.round < since)
        self.round = torch.where(better, round_number, self.round)
        self.success_rate = torch.where(better, rate, self.success_rate)
        for name, now in _weights(self._policy).items():
            best = self._weights[name]
            best[better.to(best.device)] = now[better.to(now.device)]

    def put_back(self) -> None:
        """Loads the best weights into the policy.

        Raises:
            ValueError: before the first evaluation.
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
        """Restores the state from :meth:`state_dict`."""
        self.round = state_dict["round"].clone()
        self.success_rate = state_dict["success_rate"].clone()
        saved = state_dict["weights"]
        # Older checkpoints have the prefix "actor".
        saved = {name.removeprefix("actor."): weight for name, weight in saved.items()} | saved
        for name, best in self._weights.items():
            best.copy_(saved[name])


def _weights(policy: nn.Module) -> dict[str, Tensor]:
    """Returns copies of a policy's parameters by name."""
    return {name: weight.detach().clone() for name, weight in policy.named_parameters()}
