"""``env=chain``: a walk along a chain, with a large reward at its far end."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from bbq_torchrl.options import EnvOption, register
from bbq_torchrl.settings import COUNT, REWARD, integers, option, setting

if TYPE_CHECKING:
    from collections.abc import Sequence

    import torch
    from torchrl.envs import EnvBase

    from bbq_torchrl.domains import Domain


@register
@dataclass
class Chain(EnvOption):
    """The N-chain: a little reward near the start, a large one at the far end."""

    name: str = option("chain")
    length: int = setting(10, integers(3, 1_000), "states of the chain")
    near_reward: float = setting(0.001, REWARD, "reward of a step in the first state")
    far_reward: float = setting(1.0, REWARD, "reward of a step in the last state")
    paper_rounds: int = setting(100, COUNT, "rounds of training")

    def make(
        self,
        domain: Domain | None,
        batch_size: Sequence[int],
        *,
        seed: int = 0,
        device: torch.device | str = "cpu",
    ) -> EnvBase:
        """Makes the chain, which is deterministic: the seed has no effect."""
        from bbq_extending.chain_env import ChainEnv

        return ChainEnv(
            self.length,
            batch_size,
            near_reward=self.near_reward,
            far_reward=self.far_reward,
            device=device,
        )

    def steps(self) -> int:
        """Returns the episode length, nine more than the number of states (as in the paper)."""
        return self.length + 9
