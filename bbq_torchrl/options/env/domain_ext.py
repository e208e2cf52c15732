"""``env=domain_ext``: dialogues whose slots come one by one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from bbq_torchrl.options import register
from bbq_torchrl.options.env.full import FullDomain
from bbq_torchrl.options.settings import COUNT, NON_NEGATIVE_INTEGER, option, other_default, setting

if TYPE_CHECKING:
    from torch import Tensor
    from torchrl.envs import EnvBase

    from bbq_torchrl.domains import Domain
    from bbq_torchrl.envs import ExtensionSchedule


@register
@dataclass
class DomainExtension(FullDomain):
    """The essential slots first; then the others one by one, in the domain's order."""

    name: str = option("domain_ext")
    start: int = setting(40, NON_NEGATIVE_INTEGER, "round in which the first new slot appears")
    every: int = setting(10, COUNT, "rounds between two new slots")
    paper_rounds: int = other_default(FullDomain, "paper_rounds", 200)

    extends: ClassVar[bool] = True

    def schedule(self) -> ExtensionSchedule:
        """Says which slots there are in which round."""
        from bbq_torchrl.envs import ExtensionSchedule

        return ExtensionSchedule(start=self.start, every=self.every)

    def check_domain(self, domain: Domain | None) -> None:
        """Refuses a slot that the agent has actions for and that no round adds, too."""
        super().check_domain(domain)
        assert domain is not None
        self.schedule().never_active(domain)

    def inactive(self, env: EnvBase) -> tuple[Tensor, Tensor]:
        """Those of the slots that are not there in the first round."""
        return ~env.active_features, ~env.simulator.action_mask(env.active_slots)

    def never(self, domain: Domain | None) -> set[str]:
        """Those that are not essential and that the domain's order lacks."""
        assert domain is not None
        return set(self.schedule().never_active(domain))

    def additions(self, domain: Domain | None) -> dict[int, str]:
        """The slot that each round adds."""
        assert domain is not None
        return self.schedule().additions(domain)
