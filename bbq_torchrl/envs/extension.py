"""Domain extension: the schedule on which slots become active."""

from __future__ import annotations

from dataclasses import dataclass

from bbq_torchrl.domains import Domain


@dataclass(frozen=True)
class ExtensionSchedule:
    """A schedule that starts with a domain's essential slots and adds others one at a time.

    Lipton et al. (2018) train 40 rounds on the essential slots and then add a slot every 10 rounds.
    The domain's ``extension_order`` has the order.

    Args:
        start: the round, counted from 0, that adds the first slot.
        every: rounds from one addition to the next.

    Raises:
        ValueError: if ``start`` is below 0 or ``every`` below 1.

    Examples:
        >>> from bbq_torchrl.domains import movie_domain
        >>> schedule = ExtensionSchedule(start=40, every=10)
        >>> len(schedule.active(movie_domain(), 39))
        8
        >>> "genre" in schedule.active(movie_domain(), 40)
        True
    """

    start: int = 40
    every: int = 10

    def __post_init__(self) -> None:
        if self.start < 0:
            raise ValueError(f"start must be a round from 0 on, got {self.start}")
        if self.every < 1:
            raise ValueError(f"every must be at least 1 round, got {self.every}")

    def active(self, domain: Domain, round: int) -> tuple[str, ...]:
        """Returns the slots active in a round, in the order of the domain's slots.

        Args:
            domain: the domain.
            round: the round, counted from 0.
        """
        added = {slot for start, slot in self.additions(domain).items() if start <= round}
        return tuple(slot for slot in domain.slots if slot in added or slot in domain.essential)

    def never_active(self, domain: Domain) -> tuple[str, ...]:
        """Returns the slots that no round activates; goals are restricted to the others.

        Raises:
            ValueError: if the agent has actions for one of them, which could never be played.
        """
        active = {*domain.essential, *domain.extension_order}
        never = tuple(slot for slot in domain.slots if slot not in active)
        dead = [slot for slot in never if any(action.slot == slot for action in domain.actions)]
        if dead:
            raise ValueError(
                f"domain extension would never activate {', '.join(dead)}, for which the agent has "
                f"actions: domain {domain.name!r} must have them in essential or in extension_order"
            )
        return never

    def additions(self, domain: Domain) -> dict[int, str]:
        """Returns the added slot by round."""
        order = enumerate(domain.extension_order)
        return {self.start + index * self.every: slot for index, slot in order}
