"""The number of data that a KL divergence is spread over."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor, nn

if TYPE_CHECKING:
    from collections.abc import Mapping


class NumData(nn.Module):
    """What losses with a KL / N share: N for each replica, a buffer.

    To be inherited from before TorchRL's ``LossModule``.
    """

    num_data: Tensor
    replicas: torch.Size

    def _register_num_data(self, num_data: int | Tensor | None, like: Tensor) -> None:
        """Makes the buffer, [*replicas], with the dtype and device of ``like``."""
        # 0 stands for "not known yet"
        self.register_buffer("num_data", like.new_zeros(self.replicas))
        self._num_data_known = False
        if num_data is not None:
            self.set_num_data(num_data)

    def set_num_data(self, num_data: int | Tensor) -> None:
        """Sets N, the number of transitions that the KL is spread over.

        Args:
            num_data: a number, or one for each replica, [*replicas]; positive (tensors
                are not checked, so that no device has to be waited for).

        Raises:
            ValueError: if a number is not positive or a tensor's shape does not fit.
        """
        if isinstance(num_data, torch.Tensor):
            if num_data.shape not in (self.replicas, torch.Size(())):
                raise ValueError(
                    f"num_data must be a number or have shape {list(self.replicas)}, got "
                    f"{list(num_data.shape)}"
                )
            self.num_data.copy_(num_data)
        else:
            if not num_data > 0:
                raise ValueError(f"num_data must be positive, got {num_data}")
            self.num_data.fill_(num_data)
        self._num_data_known = True

    def _check_num_data(self) -> None:
        """Raises RuntimeError unless N is known."""
        if not self._num_data_known:
            raise RuntimeError(
                f"num_data is not known: give it to {type(self).__name__} or call "
                "set_num_data(n) with the number of transitions in the buffer"
            )

    def _load_from_state_dict(
        self, state_dict: Mapping[str, Any], prefix: str, *args: Any, **kwargs: Any
    ) -> None:
        super()._load_from_state_dict(state_dict, prefix, *args, **kwargs)
        loaded = state_dict.get(prefix + "num_data")
        if loaded is not None:
            self._num_data_known = bool((loaded > 0).all())
