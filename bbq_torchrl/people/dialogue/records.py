"""The records of a domain as seen by the dialogue control, and how far each is from the wishes."""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING

import torch

from bbq_torchrl.domains.values import FIRST_VALUE, NONE
from bbq_torchrl.people.dialogue.completing import dependencies
from bbq_torchrl.people.language.quantities import (
    about_minutes,
    day_of,
    is_on,
    kind_of,
    minutes_of,
    of_evening,
    span_of,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from torch import Tensor

    from bbq_torchrl.domains import DomainTensors

_SAMPLE = 100  # values that tell a slot's kind
_RARE = 1 / 8
"""A slot that goals constrain less often than this share of the most frequent one is minor."""
_COSTS = {"time": 1, "date": 2, "price": 2, "count": 2, "text": 3}
"""The cost of another value, by the kind of its slot."""
_EACH, _PLACE, _OPENING = 100, 1_000, 2_000
"""What each other value costs more, one that another value determines, as a theater its city, and
one of the opening slot, which a dialogue is about: people accept another time before another place.
"""


class Records:
    """Compares records with the values that a tracker holds.

    A record contradicts a value that it does not have, but only lacks that of a minor slot and a
    wider place not on file, as its state. It contradicts that, too, if others have it and nothing
    told implies it: a record in Reno "in California". Values of free slots, reserved values and no
    value never count.

    Args:
        domain: the domain's tensors.

    Attributes:
        vocabulary: for each slot, the text of each value id.
        has: bool ``[R, S]``, whether a record has a slot.
        minor: bool ``[S]``, whether few of the domain's goals constrain a slot.
        opening: bool ``[S]``, the opening slot.
        lasting: bool ``[S]``, the opening slot and those that another one determines, as a city.
        determines: bool ``[S, S]``, whether the value of the first slot determines the second's,
            as a city its state: in all records, and for at least eight values with several records.
    """

    def __init__(self, domain: DomainTensors) -> None:
        self._values, self.vocabulary = domain.records, domain.vocabulary
        self.has = domain.records != NONE
        self._constrains = domain.constrains
        wanted = (domain.goal_constraints != NONE).sum(0)
        self.minor = wanted < _RARE * wanted.max()
        self.determines = dependencies(domain)
        kinds = [kind_of(texts[FIRST_VALUE:][:_SAMPLE]) for texts in domain.vocabulary]
        costs = torch.tensor([_EACH + _COSTS[kind] for kind in kinds], dtype=torch.float64)
        self._is_place = self.determines.any(0) & ~self.minor
        # What a place determines and determines nothing, as a state.
        self._is_wide = self.determines[self._is_place].any(0) & ~self.determines.any(1)
        self._contradicts = (self.has | ~self._is_wide) & ~self.minor
        self._spare = (domain.constrains & self.minor & ~self.has).sum(-1)  # details not on file
        self._costs = costs + _OPENING * domain.opening
        self.opening, self.lasting = domain.opening, self._is_place | domain.opening
        self._minutes = {
            slot: torch.tensor([of_evening(minutes_of(text)) for text in domain.vocabulary[slot]])
            for slot, kind in enumerate(kinds)
            if kind == "time"
        }
        dates = {slot: domain.vocabulary[slot] for slot, kind in enumerate(kinds) if kind == "date"}
        self._is_vague = torch.zeros(len(self.has), dtype=torch.bool)
        for slot, minutes in self._minutes.items():
            self._is_vague |= minutes[self._values[:, slot]].isnan() & self.has[:, slot]
        self._days = {slot: _numbered([*map(day_of, texts)]) for slot, texts in dates.items()}
        self._is_on = {  # of its first date and its second
            slot: torch.tensor([[is_on(day, of) for of in texts] for day in texts])
            for slot, texts in dates.items()
        }

    def compare(self, held: Tensor) -> tuple[Tensor, Tensor]:
        """Returns the values held that each record contradicts, and those that it lacks.

        Args:
            held: long ``[*B, S]``, value ids.

        Returns:
            bool ``[*B, R, S]`` each.
        """
        told = (held >= FIRST_VALUE) & self._constrains
        is_implied = (told[..., None] & self.determines).any(-2)
        equal = self._values == held[..., None, :]
        is_place = self._is_place & ~is_implied & equal.any(-2)
        misses = told[..., None, :] & ~equal
        differs = misses & (self._contradicts | is_place[..., None, :])
        return differs, misses & ~differs

    def _distances(self, differs: Tensor, lacks: Tensor) -> Tensor:
        """Returns each record's distance, ``[*B, R]``: contradictions count most, details least."""
        n_slots, absent = differs.shape[-1], lacks & ~self.minor
        return (differs.sum(-1) * n_slots + absent.sum(-1)) * n_slots + (lacks & self.minor).sum(-1)

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
        distance, place = self._distances(differs, lacks).min(-1)
        index = place[..., None, None].expand(*place.shape, 1, held.shape[-1])
        differs, lacks = (part.gather(-2, index).squeeze(-2) for part in (differs, lacks))
        return differs, lacks, distance

    def parts(self, held: Tensor) -> dict[int, Tensor]:
        """Returns, for each vague time or day held, which records are in it, bool ``[R]``."""
        found = {}
        for number, minutes in self._minutes.items():
            if (span := span_of(self.vocabulary[number][held[number]])) is not None:
                times = minutes[self._values[:, number]]
                found[number] = (times >= span[0]) & (times <= span[1])
        for number, are_on in self._is_on.items():
            is_in = are_on[self._values[:, number], held[number]]
            if (is_in & (self._values[:, number] != held[number])).any():
                found[number] = is_in
        return found

    def _misses(self, held: Tensor) -> tuple[Tensor, Tensor]:
        """Compares, bool ``[R, S]`` twice; a vague time or day has what is in it."""
        differs, lacks = self.compare(held)
        for number, is_in in self.parts(held).items():
            differs[:, number] &= ~is_in
            lacks[:, number] &= ~is_in
        return differs, lacks

    def _is_elsewhere(self, lacks: Tensor) -> Tensor:
        """Returns which records are in another state, bool ``[R]``."""
        return (lacks & self._is_wide & self.has).any(-1)

    def is_met(self, held: Tensor) -> bool:
        """Returns whether a record has all values held but details, ``[S]``."""
        differs, lacks = self._misses(held)
        return bool((~(differs | (lacks & ~self.minor)).any(-1)).any())

    def nearest(
        self,
        held: Tensor,
        refused: Iterable[Sequence[tuple[int, int]]] = (),
        *,
        asked: Sequence[int] = (),
        has: Sequence[int] = (),
        slot: int | None = None,
        direction: int = 0,
        stays: Tensor | None = None,
    ) -> dict[int, int]:
        """Returns the values of the nearest record that differ from those held, by slot.

        Another part of the same day is nearest, then fewer differences, then those of slots that
        cost less, then earlier or later by less, then more details on file. What the values held
        determine, as a theater its city, is held too. A record lacks as few of the values held as
        possible.

        Args:
            held: long ``[S]``, value ids.
            refused: differences that the person refused.
            asked: slots that the record should have.
            has: slots that it must have.
            slot: a slot that must differ; ``None`` for any.
            direction: 1 for a later, -1 for an earlier time.
            stays: bool ``[S]``, slots that may not differ, but for ``slot``.

        Returns:
            Empty if no record differs in that way.
        """
        exactly, (differs, lacks) = self.compare(held)[0], self._misses(held)
        parts = self.parts(held)
        absent = (lacks & ~self.minor).sum(-1)
        others = self._misses(self._implied(held))
        far, nowhere = (part & self.lasting for part in others)
        cost = (differs * self._costs).sum(-1) + torch.where(absent > 1, 1e4, 10.0) * absent
        cost += _PLACE * self._is_elsewhere(lacks)
        cost += _EACH * self._is_vague  # "after work" only if nothing else is as near
        cost += _EACH / 4 * (self._contradicts.any(0) & ~self.has).sum(-1)  # nor a time not on file
        cost += 1e-4 * self._spare
        cost += _EACH / 2 * (lacks & self.minor).sum(-1)
        cost += _EACH / 2 * (lacks & self.minor & self.has).sum(-1)  # "in 3D" for "in 2D"
        cost += _PLACE * ((far & self._is_place).any(-1) + 1.2 * nowhere.any(-1))
        cost += _PLACE / 2 * (~self.has[:, list(asked)]).sum(-1)
        for number, days in self._days.items():
            is_near = differs[:, number] & (days[self._values[:, number]] == days[held[number]])
            cost -= is_near * _EACH
        for number, minutes in self._minutes.items():
            wish = self.vocabulary[number][held[number]]
            away = minutes[self._values[:, number]] - of_evening(about_minutes(wish))
            cost += _EACH * (differs[:, number] & (number in parts))
            cost += torch.where(exactly[:, number], (away.abs() / 1_440).nan_to_num(1.0), 0.0)
            if direction and not minutes[held[number]].isnan():
                cost += torch.where(away * direction > 0, 0.0, torch.inf)
        is_out = ~exactly.any(-1) if slot is None else ~exactly[:, slot]
        is_out |= ~self.has[:, list(has)].all(-1) | (exactly & ~self.has).any(-1)
        if stays is not None:
            stays = stays & (torch.arange(len(held)) != slot)
            is_out |= ((others[0] | others[1]) & stays).any(-1)
        cost = cost.masked_fill(is_out | self.with_any(refused), torch.inf)
        place = int(cost.argmin())
        if not torch.isfinite(cost[place]):
            return {}
        changed = exactly[place].nonzero().flatten().tolist()
        return {number: int(self._values[place, number]) for number in changed}

    def with_any(self, some: Iterable[Sequence[tuple[int, int]]]) -> Tensor:
        """Returns which records have all values of one of some lists of slot and value id."""
        found = torch.zeros(len(self._values), dtype=torch.bool)
        for values in some:
            slots, ids = (list(part) for part in zip(*values, strict=True))
            found |= (self._values[:, slots] == torch.tensor(ids)).all(-1)
        return found

    def here(self, held: Tensor, slots: Tensor | None = None) -> Tensor:
        """Returns the values of the place, or of some slots ``[S]``, that hold, long ``[S]``."""
        shown = self._is_place if slots is None else slots & self._constrains
        return torch.where(shown, self._implied(held), NONE)

    def is_same_day(self, held: Tensor, change: Mapping[int, int]) -> bool:
        """Returns whether only the part of a day changes, of what is held."""
        return all(
            slot in self._days and self._days[slot][value] == self._days[slot][held[slot]]
            for slot, value in change.items()
            if held[slot] >= FIRST_VALUE
        )

    def _implied(self, held: Tensor) -> Tensor:
        """Returns the values held with those that they determine, long ``[S]``."""
        implied = held.clone()
        for slot in (held >= FIRST_VALUE).nonzero().flatten().tolist():
            of = self._values[self._values[:, slot] == held[slot]]
            if len(of):
                is_free = self.determines[slot] & (implied == NONE)
                implied = torch.where(is_free, of.amax(0), implied)
        return implied

    def choices(
        self, held: Tensor, slot: int, direction: int = 0, asked: Sequence[int] = ()
    ) -> list[int]:
        """Returns the other values of a slot in records with everything else but details.

        Times are in their order by the clock, others begin with the commonest.

        Args:
            held: long ``[S]``, value ids.
            slot: the slot.
            direction: 1 for later values only, -1 for earlier ones; of a part of the day only its
                times.
            asked: slots that the records should have.
        """
        others = held.clone()
        others[slot] = NONE
        differs, lacks = self._misses(others)
        fits = ~(differs | (lacks & ~self.minor)).any(-1) & self.has[:, slot]
        fits &= ~self._is_elsewhere(lacks)
        if slot in self._minutes:
            fits &= self.parts(held).get(slot, True)
            is_dated = any(held[date] >= FIRST_VALUE for date in self._is_on)
            is_plain = fits & ~self._is_vague
            fits = is_plain if is_dated and is_plain.any() else fits
        has = fits & self.has[:, list(asked)].all(-1)
        if not self._minutes.keys().isdisjoint(asked):  # nor does "matinee" say when
            has &= ~self._is_vague
        fits = has if has.any() else fits
        missing = torch.where(fits, lacks.sum(-1), len(held))
        found = self._values[fits & (missing == missing.min()), slot]
        values, counts = found[found != held[slot]].unique(return_counts=True)
        ranked = values[counts.argsort(descending=True, stable=True)].tolist()
        minutes = self._minutes.get(slot)
        if minutes is not None:  # leave out "after work" if there are times
            ranked = sorted(ranked, key=lambda v: float(minutes[v].nan_to_num(torch.inf)))
            ranked = [v for v in ranked if not minutes[v].isnan()] or ranked
            if direction and held[slot] != NONE:
                ranked = [v for v in ranked if (minutes[v] - minutes[held[slot]]) * direction > 0]
        return ranked

    def row(
        self,
        held: Tensor,
        change: Mapping[int, int],
        refused: Iterable[Sequence[tuple[int, int]]] = (),
    ) -> Tensor:
        """Returns the values of the nearest record after a change, long ``[S]``.

        Of records as near it is one with the most on file.

        Args:
            held: long ``[S]``, value ids.
            change: slot to value id.
            refused: what the person refused; such a record is the last.
        """
        changed = held.clone()
        changed[[*change]] = torch.tensor([*change.values()], dtype=torch.long)
        distances = 2 * self._distances(*self._misses(changed)) + self._is_vague
        for number in self._is_on:  # "tomorrow" before "tomorrow night"
            distances += (changed[number] >= FIRST_VALUE) & (
                self._values[:, number] != changed[number]
            )
        distances += self.with_any(refused) * (distances.max() + 1)
        absent = (self._constrains & self._contradicts & ~self.has).sum(-1)  # the date not on file
        distances = distances * (len(held) + 1) + absent
        distances = distances * (len(held) + 1) + self._spare
        return self._values[int(distances.argmin())].clone()

    def is_listed(self, slot: int) -> bool:
        """Returns whether records have values of a slot that constrains them."""
        return bool(self._constrains[slot] & self.has[:, slot].any())

    def conflict(self, held: Tensor) -> tuple[int, ...]:
        """Returns the fewest slots whose values no record combines; empty if one has them all.

        Args:
            held: long ``[S]``, value ids.
        """
        differs, lacks = self._misses(held)
        misses = differs if differs.any(-1).all() else differs | (lacks & ~self.minor)
        misses = misses if misses.any(-1).all() else differs | lacks
        slots = misses.any(0).nonzero().flatten().tolist()
        for size in range(1, len(slots) + 1):
            for some in combinations(slots, size):
                if misses[:, list(some)].any(-1).all():
                    return some
        return ()


def _numbered(texts: Sequence[str]) -> Tensor:
    """Returns a number for each text, the same for equal texts."""
    numbers = {text: number for number, text in enumerate(texts)}
    return torch.tensor([numbers[text] for text in texts])
