"""A count-based intrinsic reward in a replay buffer (#Exploration, Tang et al. 2017)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor
from torchrl.envs import Transform

if TYPE_CHECKING:
    from tensordict import TensorDictBase


class VisitReward(Transform):
    """Adds eta / √n to the reward of a transition to a state that was stored n times.

    A transform of replay buffers, on transitions [replicas, rows]. Storing counts the new states of
    each replica, by the signs of random projections of their features (SimHash), and keeps their
    hash under ``("next", "state_hash")``. Reading adds the bonus, by the counts of then.

    Args:
        features: of an observation.

    Keyword Args:
        replicas: each has counters and projections of its own.
        eta: a number, or a tensor [replicas].
        bits: of the hash.

    Examples:
        >>> from tensordict import TensorDict
        >>> states = torch.eye(2)[torch.tensor([[0, 0, 1, 0]])]
        >>> rows = TensorDict({"next": {"observation": states}}, [1, 4])
        >>> rows["next", "reward"] = torch.zeros(1, 4, 1)
        >>> transform = VisitReward(2, eta=1.0)
        >>> transform(transform.inv(rows))["next", "reward"].flatten()
        tensor([0.5774, 0.5774, 1.0000, 0.5774])
    """

    counts: Tensor
    projections: Tensor
    eta: Tensor

    def __init__(
        self, features: int, *, replicas: int = 1, eta: float | Tensor = 0.1, bits: int = 16
    ) -> None:
        super().__init__(
            in_keys=[("next", "reward"), ("next", "state_hash")],
            out_keys=[("next", "reward")],
            in_keys_inv=[("next", "observation")],
            out_keys_inv=[("next", "state_hash")],
        )
        self.register_buffer("projections", torch.randn(replicas, features, bits))
        self.register_buffer("counts", torch.zeros(replicas, 2**bits, dtype=torch.int64))
        values = torch.as_tensor(eta, dtype=torch.get_default_dtype())
        self.register_buffer("eta", values.expand(replicas)[:, None, None], persistent=False)

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Counts the next states of the transitions and writes their hash."""
        state = tensordict.get(("next", "observation"))
        signs = (state @ self.projections > 0).long()
        powers = 2 ** torch.arange(signs.shape[-1], device=signs.device)
        hashes = (signs * powers).sum(-1)
        valid = tensordict.get("valid", None)
        seen = torch.ones_like(hashes) if valid is None else valid.long()
        self.counts.scatter_add_(1, hashes, seen)
        return tensordict.set(("next", "state_hash"), hashes.unsqueeze(-1))

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Returns a shallow copy with the bonus in its reward."""
        hashes = tensordict.get(("next", "state_hash")).squeeze(-1)
        bonus = self.eta / self.counts.gather(1, hashes).unsqueeze(-1).sqrt()
        reward = tensordict.get(("next", "reward"))
        out = tensordict.clone(recurse=False)
        return out.set(("next", "reward"), reward + bonus)

    def pop_metrics(self) -> dict[str, Tensor]:
        """Returns how many states each replica has seen, a column of the metrics."""
        return {"states_seen": (self.counts > 0).sum(-1).double()}
