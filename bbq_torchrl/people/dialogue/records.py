"""The records of a domain as seen by the dialogue control, and how far each is from the wishes."""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING

import torch

from bbq_torchrl.domains import tensorize
from bbq_torchrl.domains.values import DONT_CARE, FIRST_VALUE, NONE
from bbq_torchrl.people.language.quantities import kind_of, read_time

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from torch import Tensor

    from bbq_torchrl.domains import Domain, DomainTensors

_EVIDENCE = 8  # values of a slot with several records, each with one value of the determined slot
_SAMPLE = 100  # values that tell a slot's kind
_COSTS = {"time": 1, "date": 2, "price": 2, "count": 2, "text": 3}
"""The cost of another value, by the kind of its slot: people accept another time before another
place. The opening slot, which a dialogue is about, costs twice the highest more."""


def completed(domain: Domain) -> tuple[Mapping[str, str], ...]:
    """Returns the records of a domain with what their other values determine, as a city its state.

    Args:
        domain: the domain, with one spelling for each value.
    """
    records = [dict(record) for record in domain.records]
    determines = _dependencies(tensorize(domain))
    for one, other in determines.nonzero().tolist():
        name, determined = domain.slots[one], domain.slots[other]
        known = {r[name]: r[determined] for r in records if name in r and determined in r}
        for record in records:
            if record.get(name) in known:
                record.setdefault(determined, known[record[name]])
    return tuple(records)


class Records:
    """Compares records with the values that a tracker holds.

    A record contradicts a value if it has another one; without the slot it only lacks the value.
    Values of free slots, reserved values and no value never count.

    Args:
        domain: the domain's tensors.

    Attributes:
        has: bool ``[R, S]``, whether a record has a slot.
        determines: bool ``[S, S]``, whether the value of the first slot determines the second's,
            as a city its state: in all records, and for at least eight values with several records.
    """

    def __init__(self, domain: DomainTensors) -> None:
        self._values, self._vocabulary = domain.records, domain.vocabulary
        self.has = domain.records != NONE
        self._constrains = domain.constrains
        self.determines = _dependencies(domain)
        kinds = [kind_of(texts[FIRST_VALUE:][:_SAMPLE]) for texts in domain.vocabulary]
        costs = [_COSTS[kind] for kind in kinds]
        self._costs = torch.tensor(costs, dtype=torch.float64) + 2 * max(costs) * domain.opening
        self._minutes = {
            slot: torch.tensor([_minutes(text) for text in domain.vocabulary[slot]])
            for slot, kind in enumerate(kinds)
            if kind == "time"
        }

    def compare(self, held: Tensor) -> tuple[Tensor, Tensor]:
        """Returns the values held that each record contradicts, and those that it lacks.

        Args:
            held: long ``[*B, S]``, value ids.

        Returns:
            bool ``[*B, R, S]`` each.
        """
        told = ((held >= FIRST_VALUE) & self._constrains)[..., None, :]
        return told & self.has & (self._values != held[..., None, :]), told & ~self.has

    def having(self, held: Tensor) -> Tensor:
        """Counts the records with each slot that contradict nothing. Returns long ``[*B, S]``."""
        matching = ~self.compare(held)[0].any(-1)
        return (matching.float() @ self.has.float()).long()

    def best(self, held: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Returns what the best record contradicts and lacks, and its distance.

        Args:
            held: long ``[*B, S]``, value ids.

        Returns:
            bool ``[*B, S]`` twice, and long ``[*B]``: contradictions count before absent values.
        """
        differs, lacks = self.compare(held)
        distance, place = _distances(differs, lacks).min(-1)
        index = place[..., None, None].expand(*place.shape, 1, held.shape[-1])
        differs, lacks = (part.gather(-2, index).squeeze(-2) for part in (differs, lacks))
        return differs, lacks, distance

    def nearest(
        self,
        held: Tensor,
        refused: Iterable[Sequence[tuple[int, int]]] = (),
        *,
        asked: Sequence[int] = (),
        slot: int | None = None,
        direction: int = 0,
    ) -> dict[int, int]:
        """Returns the values of the nearest record that differ from those held, by slot.

        Fewer differences are nearer, then those of slots that cost less, then earlier or later by
        less. A record lacks as few of the values held as possible.

        Args:
            held: long ``[S]``, value ids.
            refused: differences that the person refused.
            asked: slots that the record should have.
            slot: a slot that must differ; ``None`` for any.
            direction: 1 for a later, -1 for an earlier value of ``slot``.

        Returns:
            Empty if no record differs in that way.
        """
        differs, lacks = self.compare(held)
        absent = lacks.sum(-1)
        cost = (differs * (100 + self._costs)).sum(-1) + torch.where(absent > 1, 1e4, 10.0) * absent
        cost += 1_000.0 * (~self.has[:, list(asked)]).sum(-1)
        for number, minutes in self._minutes.items():
            away = minutes[self._values[:, number]] - minutes[held[number]]
            cost += torch.where(differs[:, number], (away.abs() / 1_440).nan_to_num(1.0), 0.0)
            if slot == number and direction:
                cost += torch.where(away * direction > 0, 0.0, torch.inf)
        is_out = ~differs.any(-1) if slot is None else ~differs[:, slot]
        for change in refused:
            slots, values = (list(part) for part in zip(*change, strict=True))
            is_out |= (self._values[:, slots] == torch.tensor(values)).all(-1)
        cost = cost.masked_fill(is_out, torch.inf)
        place = int(cost.argmin())
        if not torch.isfinite(cost[place]):
            return {}
        changed = differs[place].nonzero().flatten().tolist()
        return {number: int(self._values[place, number]) for number in changed}

    def choices(self, held: Tensor, slot: int, direction: int = 0) -> list[int]:
        """Returns the other values of a slot in records with everything else, the commonest first.

        Args:
            held: long ``[S]``, value ids.
            slot: the slot.
            direction: 1 for later values only, -1 for earlier ones.
        """
        others = held.clone()
        others[slot] = NONE
        differs, lacks = self.compare(others)
        fits = ~differs.any(-1) & self.has[:, slot]
        complete = fits & ~lacks.any(-1)
        found = self._values[complete if complete.any() else fits, slot]
        values, counts = found[found != held[slot]].unique(return_counts=True)
        ranked = values[counts.argsort(descending=True, stable=True)].tolist()
        if slot in self._minutes and direction:
            minutes = self._minutes[slot]
            away = (minutes - minutes[held[slot]]) * direction
            ranked = sorted((v for v in ranked if away[v] > 0), key=lambda v: float(away[v]))
        return ranked

    def row(self, held: Tensor, change: Mapping[int, int]) -> Tensor:
        """Returns the values of the nearest record after a change, long ``[S]``.

        Args:
            held: long ``[S]``, value ids.
            change: slot to value id.
        """
        changed = held.clone()
        changed[[*change]] = torch.tensor([*change.values()], dtype=torch.long)
        return self._values[int(_distances(*self.compare(changed)).argmin())].clone()

    def is_listed(self, slot: int) -> bool:
        """Returns whether records have values of a slot that constrains them."""
        return bool(self._constrains[slot] & self.has[:, slot].any())

    def freeing(self, held: Tensor) -> list[int]:
        """Returns the slots each of whose values alone keeps all records out."""
        found = []
        for slot in (held >= FIRST_VALUE).nonzero().flatten().tolist():
            without = held.clone()
            without[slot] = DONT_CARE
            if not self.best(without)[0].any():
                found.append(slot)
        return found

    def conflict(self, held: Tensor) -> tuple[int, ...]:
        """Returns the fewest slots whose values no record combines; empty if one has them all.

        Args:
            held: long ``[S]``, value ids.
        """
        differs, lacks = self.compare(held)
        misses = differs if differs.any(-1).all() else differs | lacks
        slots = misses.any(0).nonzero().flatten().tolist()
        for size in range(1, len(slots) + 1):
            for some in combinations(slots, size):
                if misses[:, list(some)].any(-1).all():
                    return some
        return ()


def _distances(differs: Tensor, lacks: Tensor) -> Tensor:
    """Returns each record's distance, ``[*B, R]``: contradictions count before absent values."""
    return differs.sum(-1) * differs.shape[-1] + lacks.sum(-1)


def _dependencies(domain: DomainTensors) -> Tensor:
    """Returns bool ``[S, S]``: whether the first slot's value determines the second's."""
    values, has = domain.records, domain.records != NONE
    found = torch.zeros(domain.n_slots, domain.n_slots, dtype=torch.bool)
    for one in (domain.constrains & has.any(0)).nonzero().flatten().tolist():
        both = has & has[:, one, None]
        of = values[:, one, None].expand_as(values)
        table = torch.zeros(int(domain.n_values[one]), domain.n_slots, dtype=torch.long)
        often = table.scatter_add(0, of, both.long()) > 1
        highest = table.scatter_reduce(0, of, torch.where(both, values, 0), "amax")
        is_only = ((values == highest.gather(0, of)) | ~both).all(0)
        found[one] = is_only & (often.sum(0) >= _EVIDENCE) & domain.constrains
    return found & ~torch.eye(domain.n_slots, dtype=torch.bool)


def _minutes(text: str) -> float:
    """Returns the minutes from midnight of a time of day; NaN of "late at night"."""
    read = (read_time(text) or "").rstrip("?")
    if not read.startswith("at "):
        return torch.nan
    hour, minute = read.removeprefix("at ").split(":")
    return 60.0 * int(hour) + int(minute)
