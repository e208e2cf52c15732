"""Bootstrap masks: the heads that learn from each transition, drawn when it is stored."""

from __future__ import annotations

from collections.abc import Sequence
from math import prod

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs.transforms import Transform

from bbq_torchrl.bayes.functional import replica_shape
from bbq_torchrl.settings import ABOVE_ZERO_TO_ONE, at_least, check
from bbq_torchrl.utils.seeds import checked_seed, unshared_seed

_MASK = "bootstrap_mask"


class BootstrapMask(Transform):
    """Marks the heads that learn from each transition, as it is stored (Osband et al. 2016).

    This is a replay buffer transform. Storing transitions without the entry ``bootstrap_mask``
    writes it, bool [*replicas, *rows, heads] of independent Bernoulli(prob) numbers; sampling
    changes nothing. Rows that an optional entry "valid", bool [*replicas, *rows], marks as False
    get an empty mask and draw no random numbers.

    Each replica has a separate stream of random numbers. Its n-th stored transition gets the n-th
    numbers of the stream, regardless of how calls split the transitions, of other replicas and of
    the device.

    Args:
        heads: number of heads K.
        prob: probability that a head learns from a transition; 1 means an ensemble without
            bootstrap. Defaults to 0.5.

    Keyword Args:
        replicas: replica shape, the leading dimensions of the transitions. Defaults to ().

    Attributes:
        generator_state: uint8 buffer [*replicas, bytes], the state of each replica's stream, part
            of the state dict. Initially drawn from torch's global generator.

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
    ) -> None:
        check("heads", heads, at_least(1))
        check("prob", prob, ABOVE_ZERO_TO_ONE)
        super().__init__(in_keys=[], out_keys=[], in_keys_inv=[], out_keys_inv=[_MASK])
        self.heads = heads
        self.prob = prob
        self.replicas = replica_shape(replicas)
        # A buffer, not a generator, so that it is saved, copied and pickled with the module.
        size = torch.Generator().get_state().shape
        self.register_buffer(
            "generator_state", torch.empty(*self.replicas, *size, dtype=torch.uint8)
        )
        drawn = torch.randint(2**63 - 1, (prod(self.replicas),)).tolist()
        self.set_seeds([unshared_seed(seed) for seed in drawn])

    def set_seeds(self, seeds: Sequence[int]) -> None:
        """Reseeds each replica's random numbers.

        Args:
            seeds: one for each replica, in order; a single one for replicas=().

        Raises:
            ValueError: for a wrong number of seeds.
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
        """Returns sampled transitions unchanged."""
        return tensordict

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the masks of transitions without masks."""
        if tensordict.get(_MASK, None) is not None:
            return tensordict
        shape, dims = tensordict.batch_size, len(self.replicas)
        if shape[:dims] != self.replicas:
            raise ValueError(
                f"transitions must have the batch size [{', '.join(map(str, self.replicas))}, "
                f"*rows], got {list(shape)}"
            )
        valid = tensordict.get("valid", None)
        count, rows = prod(self.replicas), prod(shape[dims:])
        counts = [rows] * count
        if valid is not None:
            valid = valid.reshape(count, rows)
            counts = valid.sum(-1).tolist()
        mask = self._draw(counts, rows).to(tensordict.device or self.generator_state.device)
        if valid is not None:
            # the j-th valid row gets the j-th draw
            draw = (valid.cumsum(-1) - 1).clamp_min_(0).unsqueeze(-1).expand_as(mask)
            mask = mask.to(valid.device).gather(1, draw) & valid.unsqueeze(-1)
        return tensordict.set(_MASK, mask.reshape(*shape, self.heads))

    def _draw(self, counts: Sequence[int], rows: int) -> Tensor:
        """Returns draws for each replica's first ``counts`` rows, bool [replicas, rows, heads]."""
        mask = torch.zeros(len(counts), rows, self.heads, dtype=torch.bool)
        # always on the CPU, where a longer draw begins like a shorter one
        generator = torch.Generator()
        for state, count, out in zip(self._states(), counts, mask, strict=True):
            # a copy, because torch crashes on a state that is part of a larger tensor
            generator.set_state(state.to("cpu", copy=True))
            draws = torch.rand(count, self.heads, generator=generator, dtype=torch.float64)
            torch.lt(draws, self.prob, out=out[:count])
            state.copy_(generator.get_state())
        return mask
