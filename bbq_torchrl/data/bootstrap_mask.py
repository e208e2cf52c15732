"""The mask of heads that learn from a transition, drawn when it is stored."""

from __future__ import annotations

from math import prod
from typing import TYPE_CHECKING

import torch
from torch import Tensor
from torchrl.envs.transforms import Transform

from bbq_torchrl.bayes.replicas import replica_shape
from bbq_torchrl.checks import ABOVE_ZERO_TO_ONE, at_least, check
from bbq_torchrl.utils.seeds import checked_seed, own_seed

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tensordict import TensorDictBase
    from tensordict.utils import NestedKey


class BootstrapMask(Transform):
    """Marks the heads that learn from each transition, as it is stored (Osband et al. 2016).

    A transform for a replay buffer: storing writes the entry ``bootstrap_mask``, bool
    [*replicas, *rows, heads] with independent Bernoulli(prob) numbers, where the transitions have
    none yet; sampling changes nothing.

    Each replica has a separate stream of random numbers. The n-th transition that
    it stores gets the n-th numbers of the stream, however the transitions are cut into calls,
    whatever the other replicas store, and on every device.

    Args:
        heads: number of heads K.
        prob: probability with which a head learns from a transition; 1 is no bootstrap, only an
            ensemble. Defaults to 0.5.

    Keyword Args:
        replicas: leading shape of the transitions that is not rows. Defaults to ().
        mask_key: where the masks go. Defaults to "bootstrap_mask".
        valid_key: bool [*replicas, *rows], True for the rows that count; optional in what is
            stored. The others get an empty mask and use up no random numbers. Defaults to "valid".

    Attributes:
        generator_state: uint8 buffer [*replicas, bytes], where each replica's stream is: in the
            state dict. At first drawn from torch's global generator.

    Raises:
        ValueError: if ``heads`` is not positive or ``prob`` not in (0, 1].

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
        >>> from bbq_torchrl.data import BootstrapMask
        >>> buffer = TensorDictReplayBuffer(
        ...     storage=LazyTensorStorage(100), transform=BootstrapMask(10), batch_size=4
        ... )
        >>> _ = buffer.extend(TensorDict(observation=torch.ones(8, 3), batch_size=[8]))
        >>> buffer.sample()["bootstrap_mask"].shape
        torch.Size([4, 10])
    """

    generator_state: Tensor

    def __init__(
        self,
        heads: int,
        prob: float = 0.5,
        *,
        replicas: int | Sequence[int] = (),
        mask_key: NestedKey = "bootstrap_mask",
        valid_key: NestedKey = "valid",
    ) -> None:
        check("heads", heads, at_least(1))
        check("prob", prob, ABOVE_ZERO_TO_ONE)
        super().__init__(in_keys=[], out_keys=[], in_keys_inv=[], out_keys_inv=[mask_key])
        self.heads = heads
        self.prob = prob
        self.replicas = replica_shape(replicas)
        self.valid_key = valid_key
        # A buffer and no generator: it is saved, copied and pickled with everything else.
        size = torch.Generator().get_state().shape
        self.register_buffer(
            "generator_state", torch.empty(*self.replicas, *size, dtype=torch.uint8)
        )
        drawn = torch.randint(2**63 - 1, (prod(self.replicas),)).tolist()
        self.set_seeds([own_seed(seed) for seed in drawn])

    @property
    def mask_key(self) -> NestedKey:
        """The key of the masks."""
        key: NestedKey = self.out_keys_inv[0]
        return key

    def set_seeds(self, seeds: Sequence[int]) -> None:
        """Restarts each replica's random numbers from a separate seed.

        Args:
            seeds: one for each replica, in order; one if there are none.

        Raises:
            ValueError: for another number of seeds.
        """
        if len(seeds) != prod(self.replicas):
            raise ValueError(
                f"seeds must be {prod(self.replicas)}, one for each replica "
                f"{list(self.replicas)}, got {len(seeds)}"
            )
        generator = torch.Generator()
        for state, seed in zip(self._states(), seeds, strict=True):
            state.copy_(generator.manual_seed(checked_seed(seed)).get_state())

    def _states(self) -> Tensor:
        return self.generator_state.view(prod(self.replicas), -1)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Returns what is sampled as it is."""
        return tensordict

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the masks of transitions that have none."""
        if tensordict.get(self.mask_key, None) is not None:
            return tensordict
        shape, dims = tensordict.batch_size, len(self.replicas)
        if shape[:dims] != self.replicas:
            raise ValueError(
                f"transitions must have the batch size [{', '.join(map(str, self.replicas))}, "
                f"*rows], got {list(shape)}"
            )
        valid = tensordict.get(self.valid_key, None)
        count, rows = prod(self.replicas), prod(shape[dims:])
        counts = [rows] * count
        if valid is not None:
            valid = valid.reshape(count, rows)
            counts = valid.sum(-1).tolist()
        mask = self._draw(counts, rows).to(tensordict.device or self.generator_state.device)
        if valid is not None:
            # the j-th row that counts gets the j-th draw
            draw = (valid.cumsum(-1) - 1).clamp_min_(0).unsqueeze(-1).expand_as(mask)
            mask = mask.to(valid.device).gather(1, draw) & valid.unsqueeze(-1)
        return tensordict.set(self.mask_key, mask.reshape(*shape, self.heads))

    def _draw(self, counts: Sequence[int], rows: int) -> Tensor:
        """Returns a draw for each of the first ``counts`` rows, bool [count, rows, heads]."""
        mask = torch.zeros(len(counts), rows, self.heads, dtype=torch.bool)
        # on the CPU for every device: there a longer draw begins like a shorter one
        generator = torch.Generator()
        for state, count, out in zip(self._states(), counts, mask, strict=True):
            # torch crashes on a state that is a part of a larger tensor, hence a copy
            generator.set_state(state.to("cpu", copy=True))
            draws = torch.rand(count, self.heads, generator=generator, dtype=torch.float64)
            torch.lt(draws, self.prob, out=out[:count])
            state.copy_(generator.get_state())
        return mask
