"""Domain extension: which slots there are in which round of training."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from bbq_torchrl.domains import Domain

__all__ = ["ExtensionSchedule"]


@dataclass(frozen=True)
class ExtensionSchedule:
    """Starts with a domain's essential slots and adds others, one at a time.

    Lipton et al. (2018) train 40 rounds on the essential slots and add a slot every 10 rounds from
    then on; which slot comes when is the domain's ``extension_order``.

    Args:
        slots: the slots to add, first to last; ``None`` for the domain's ``extension_order``.
        start: the round, counted from 0, that adds the first slot.
        every: rounds from one addition to the next.

    Raises:
        ValueError: if ``start`` is below 0, ``every`` below 1, or a slot is listed twice.

    Example:
        >>> from bbq_torchrl.domains import movie_domain
        >>> schedule = ExtensionSchedule(start=40, every=10)
        >>> len(schedule.active(movie_domain(), 39))
        8
        >>> "genre" in schedule.active(movie_domain(), 40)
        True
    """

    slots: tuple[str, ...] | None = None
    start: int = 40
    every: int = 10

    def __post_init__(self) -> None:
        if self.start < 0:
            raise ValueError(f"start must be a round, 0 or later, got {self.start}")
        if self.every < 1:
            raise ValueError(f"every must be at least 1 round, got {self.every}")
        if self.slots is not None:
            object.__setattr__(self, "slots", tuple(self.slots))
            if len(set(self.slots)) < len(self.slots):
                raise ValueError(f"slots must be different from each other, got {self.slots}")

    def n_added(self, round: int) -> int:
        """Returns how many slots have been added by the given round."""
        return max(0, (round - self.start) // self.every + 1)

    def active(self, domain: Domain, round: int) -> tuple[str, ...]:
        """Returns the slots active in a round, in the order of the domain's slots.

        Args:
            domain: whose essential slots to start with.
            round: the round, counted from 0.

        Raises:
            ValueError: if the round is below 0, or a slot to add is none of the domain's.
        """
        if round < 0:
            raise ValueError(f"round must be 0 or later, got {round}")
        order = self._order(domain)
        unknown = [slot for slot in order if slot not in domain.slots]
        if unknown:
            raise ValueError(
                f"the schedule adds {', '.join(unknown)}, but domain {domain.name!r} has only "
                f"{', '.join(domain.slots)}"
            )
        active = {*domain.essential, *order[: self.n_added(round)]}
        return tuple(slot for slot in domain.slots if slot in active)

    def never_active(self, domain: Domain) -> tuple[str, ...]:
        """Returns the slots that are active in no round: goals are restricted to the others.

        Raises:
            ValueError: if the agent has actions for one of them that could never be played, and
                the domain's own order is followed (a schedule with slots of its own may leave out
                what it likes).
        """
        active = {*domain.essential, *self._order(domain)}
        never = tuple(slot for slot in domain.slots if slot not in active)
        dead = [slot for slot in never if any(action.slot == slot for action in domain.actions)]
        if dead and self.slots is None:
            raise ValueError(
                f"domain extension would never activate {', '.join(dead)}, which actions of the "
                f"agent are about: domain {domain.name!r} must have them in essential or in "
                "extension_order"
            )
        return never

    def additions(self, domain: Domain) -> dict[int, str]:
        """Returns the slot that each round adds.

        Args:
            domain: whose ``extension_order`` is used where the schedule lists no slots.
        """
        return {
            self.start + index * self.every: slot for index, slot in enumerate(self._order(domain))
        }

    def _order(self, domain: Domain) -> tuple[str, ...]:
        return domain.extension_order if self.slots is None else self.slots
