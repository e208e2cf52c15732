"""The options of ``env=``: whom the agent acts with, or what."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from bbq_torchrl.options.base import Option
from bbq_torchrl.options.settings import COUNT, setting
from bbq_torchrl.options.task import action_mask_key

if TYPE_CHECKING:
    from collections.abc import Sequence

    import torch
    from tensordict.nn import TensorDictModuleBase
    from torch import Tensor
    from torchrl.envs import EnvBase

    from bbq_torchrl.domains import Domain

__all__ = ["EnvOption"]


@dataclass
class EnvOption(Option):
    """Whom the agent acts with, or what.

    What it makes is an ``EnvBase`` of batch size [replicas, episodes] whose specs have
    ``observation`` (one dimension of floats), a categorical or one-hot ``action``, and
    ``action_mask`` if not all actions are always legal. It writes ``("next", "success")``, bool
    [replicas, episodes, 1], which says that an episode has ended well. Where it is a
    :class:`~bbq_torchrl.trainers.RoundEnv`, it is told of every round.

    Attributes:
        has_domain: whether ``domain=`` is about it.
        extends: whether features or actions come into use only in later rounds.
    """

    group: ClassVar[str] = "env"

    paper_rounds: int = setting(400, COUNT, "rounds of training in the paper")

    has_domain: ClassVar[bool] = False
    extends: ClassVar[bool] = False

    @abstractmethod
    def make(
        self,
        domain: Domain | None,
        batch_size: Sequence[int],
        *,
        seed: int = 0,
        device: torch.device | str = "cpu",
    ) -> EnvBase:
        """Makes the environment.

        Args:
            domain: what the dialogues are about; None without :attr:`has_domain`.
            batch_size: such as [replicas, episodes].
            seed: of everything random in it.
            device: where it is.
        """

    @abstractmethod
    def steps(self) -> int:
        """Returns how many steps an episode lasts at most."""

    def policies(self, domain: Domain | None) -> tuple[str, ...]:
        """Returns the names of the scripted policies; there is also ``random``."""
        return ()

    def references(self, domain: Domain | None) -> tuple[str, ...]:
        """Returns the names of the privileged policies: they read what no agent is shown.

        They say how far an agent could get, and stand beside it in results and figures.
        """
        return ()

    def make_policy(self, name: str, env: EnvBase) -> TensorDictModuleBase:
        """Makes a scripted policy, a privileged one, or the random one."""
        from torchrl.envs.utils import RandomPolicy

        from bbq_torchrl.envs import UniformPolicy as RandomLegalPolicy

        return RandomLegalPolicy() if action_mask_key(env) else RandomPolicy(env.action_spec)

    def check_domain(self, domain: Domain | None) -> None:
        """Raises ValueError for a domain that cannot be played in."""

    def inactive(self, env: EnvBase) -> tuple[Tensor, Tensor] | None:
        """Returns which features and which actions come into use later (bool), or None."""
        return None

    def never(self, domain: Domain | None) -> set[str]:
        """Returns the slots that no round has."""
        return set()

    def additions(self, domain: Domain | None) -> dict[int, str]:
        """Returns what each round adds that there was not before."""
        return {}
