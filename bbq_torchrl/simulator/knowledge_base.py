"""The records on the shelf: which of them match, and what value they mostly have."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch

from bbq_torchrl.domains.tensors import Movable
from bbq_torchrl.domains.values import DONT_CARE, FIRST_VALUE, NO_MATCH, NONE
from bbq_torchrl.simulator.choices import WORD_BITS, byte_counts, pack, popcount, rows

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bbq_torchrl.domains import DomainTensors

_BYTE_BITS = 8
_WORD_BYTES = WORD_BITS // _BYTE_BITS
# Dialogues to fill at a time: the temporaries hold a long for every value of a slot, and above
# 32 MB the allocator maps fresh pages at every call, which then cost more than the work.
_FILL_BLOCK = 4096
# Flags (a byte each) to order and pack at a time while a knowledge base is made: with all records
# at once, what a hundred thousand of them need for a moment is a gigabyte.
_BUILD_BLOCK = 2**22


class KnowledgeBase(Movable):
    """The knowledge base of a domain as bit-packed sets of records.

    For every value of every slot there is the set of the records that a held value allows: all of
    them for nothing and for "I do not care", none for "no match", those with the value otherwise (a
    record without the slot is not among them). Records match the held values where they are in all
    of the sets: a handful of ANDs on 64 records at a time.

    To count how often each value of a slot occurs among the matching records, the same sets are
    kept once more for each slot the agent can inform or offer, with the records ordered by that
    slot's value and every value starting a new byte. The counts are then differences of one
    running sum over bytes. Only values that a record has are counted: what a turn costs depends on
    the records, however long the lists of values. Memory: a bit for each value and record, and as
    much again for each slot the agent can inform or offer; there the records of one value fill
    whole bytes, so that where no two records share a value it is a byte for each value and record.

    Args:
        domain: the domain's tensors, on the CPU: it is built from many small pieces, which an
            accelerator would be slow at.
    """

    def __init__(self, domain: DomainTensors) -> None:
        records = domain.records
        told = domain.action_slot[domain.action_act != domain.act["request"]].unique().tolist()
        listed = [slot for slot in told if slot not in (-1, domain.ticket, domain.complete)]
        # A slot that only ever holds nothing or "I do not care" allows every record.
        decides = domain.constrains & (domain.n_values > FIRST_VALUE)
        decides[listed] = domain.constrains[listed]
        self.slots = decides.nonzero().squeeze(-1)
        allowed = _allowed_records(domain, self.slots.tolist())
        sizes = domain.n_values[self.slots]
        self.first_set = sizes.cumsum(0) - sizes
        self.sets = pack(allowed)

        # The ordered sets: values that no record has share one empty set.
        self.ordered_set, distinct = _distinct_rows(allowed)
        self.order_of_slot = torch.zeros(domain.n_slots, dtype=torch.long)
        columns = [records[:, slot] for slot in listed] or [torch.zeros_like(records[:, 0])]
        orders = [_order_by_value(column) for column in columns]
        for position, slot in enumerate(listed):
            self.order_of_slot[slot] = position
        n_bytes = max(place.numel() for place, _ in orders) // _BYTE_BITS
        n_bytes += -n_bytes % _WORD_BYTES
        n_bounds = max(bounds.numel() for _, bounds in orders)
        self.max_counts = max(1, n_bounds - 1)
        self.ordered_sets = _pack_in_orders(
            distinct, [place for place, _ in orders], n_bytes * _BYTE_BITS
        )
        self.sets_per_order = distinct.shape[0]
        # A bound beyond a slot's last value repeats the last one: no record lies between.
        self.bounds = torch.stack([_extend(bounds, self.max_counts + 1) for _, bounds in orders])
        self.counted = torch.stack(
            [_extend(_occurring(column), self.max_counts) for column in columns]
        )

        self.first_count = domain.n_values.cumsum(0) - domain.n_values
        self.counts = torch.cat(
            [
                _literal_counts(records[:, slot], int(size)) * int(domain.constrains[slot])
                for slot, size in enumerate(domain.n_values)
            ]
        )

    def _chosen(self, held: torch.Tensor) -> torch.Tensor:
        """Returns the set that each slot's held value stands for, long ``[*B, K]``."""
        return held.index_select(-1, self.slots) + self.first_set

    def matching(self, held: torch.Tensor) -> torch.Tensor:
        """Finds the records that match every held value. Returns packed sets, int64 ``[*B, W]``.

        Args:
            held: long ``[*B, S]``, value ids.
        """
        return _intersect(self.sets, self._chosen(held))

    def matching_counts(self, held: torch.Tensor) -> torch.Tensor:
        """Counts the records that match every held value. Returns long ``[*B]``."""
        return popcount(self.matching(held))

    def value_counts(self, held: torch.Tensor) -> torch.Tensor:
        """Counts, for each slot, the records that have its held value. Returns long ``[*B, S]``.

        Reserved values, nothing held, and slots that never constrain the records count 0.
        """
        return self.counts.take(held + self.first_count)

    def counts_by_value(
        self, held: torch.Tensor, slot: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Counts the matching records by their value of one slot.

        Args:
            held: long ``[*B, S]``, value ids.
            slot: long ``[*B]``, a slot that the agent can inform or offer; any other slot gets
                meaningless counts and the right total.

        Returns:
            Long ``[*B, C]``: how many matching records have each value that some record has of
            the slot, in the order of their ids (:meth:`counted_values`); and long ``[*B]``: how
            many match, those without the slot included.
        """
        order = self.order_of_slot.take(slot)
        sets = self.ordered_set.take(self._chosen(held))
        words = _intersect(self.ordered_sets, sets + (order * self.sets_per_order)[..., None])
        running = byte_counts(words).cumsum(-1, dtype=torch.int32)
        below = running.gather(-1, rows(self.bounds, order))
        return below.diff(dim=-1), running[..., -1]

    def counted_values(self, slot: torch.Tensor) -> torch.Tensor:
        """Returns the value ids, long ``[*B, C]``, that :meth:`counts_by_value` counts.

        Args:
            slot: long ``[*B]``, as there.
        """
        return rows(self.counted, self.order_of_slot.take(slot))

    def fill(self, held: torch.Tensor, slot: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Finds the value that a slot mostly has among the records that match every held value.

        Ties go to the lowest value id.

        Args:
            held: long ``[*B, S]``, value ids; the slot's own held value counts too.
            slot: long ``[*B]``, as in :meth:`counts_by_value`.

        Returns:
            The value ids, long ``[*B]``, "no match" where no matching record has the slot; and
            whether any record matches, bool ``[*B]``.
        """
        blocks = zip(
            held.reshape(-1, held.shape[-1]).split(_FILL_BLOCK),
            slot.reshape(-1).split(_FILL_BLOCK),
            strict=True,
        )
        values, has_match = [], []
        for block, slots in blocks:
            counts, total = self.counts_by_value(block, slots)
            values.append(self.most_frequent(counts, slots))
            has_match.append(total > 0)
        return torch.cat(values).view(slot.shape), torch.cat(has_match).view(slot.shape)

    def most_frequent(self, counts: torch.Tensor, slot: torch.Tensor) -> torch.Tensor:
        """Returns the value ids, long ``[*B]``, of the largest of :meth:`counts_by_value`.

        Args:
            counts: long ``[*B, C]``, its first result; where all are 0 there is "no match".
            slot: long ``[*B]``, as there.
        """
        # argmax gives the first of equal counts, and values are in the order of their ids.
        best = counts.argmax(-1, keepdim=True)
        is_found = counts.gather(-1, best).squeeze(-1) > 0
        place = self.order_of_slot.take(slot) * self.max_counts + best.squeeze(-1)
        return torch.where(is_found, self.counted.take(place), NO_MATCH)


def _allowed_records(domain: DomainTensors, slots: Sequence[int]) -> torch.Tensor:
    """Returns the records that each value of each slot allows: bool ``[values, rows]``."""
    allowed = []
    for slot in slots:
        values = torch.arange(int(domain.n_values[slot]))
        with_value = domain.records[:, slot] == values[:, None]
        with_value[:FIRST_VALUE] = False
        with_value[[NONE, DONT_CARE]] = True
        allowed.append(with_value)
    return torch.cat(allowed)


def _distinct_rows(allowed: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Returns each row's index among the distinct rows, and these; all and none come first."""
    everything, nothing = torch.ones_like(allowed[:1]), torch.zeros_like(allowed[:1])
    is_empty, is_full = ~allowed.any(-1), allowed.all(-1)
    is_own = ~is_empty & ~is_full
    index = torch.where(is_own, is_own.cumsum(0) + 1, is_empty.long())
    return index, torch.cat([everything, nothing, allowed[is_own]])


def _occurring(values: torch.Tensor) -> torch.Tensor:
    """Returns the value ids that some record has, in order: long ``[values]``."""
    return values[values >= FIRST_VALUE].unique()


def _order_by_value(values: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Orders the records by one slot's value, every value from a new byte on.

    Args:
        values: long ``[rows]``, each record's value of the slot.

    Returns:
        For each place the record in it, or -1: long ``[places]``, a multiple of 8 long; and for
        each value that some record has the last byte before it, then the last byte of the last:
        long ``[values + 1]``. The first byte is empty, so that there is one before the first
        value. Records without a value come last.
    """
    places = [torch.full((_BYTE_BITS,), -1)]
    bounds = [0]
    for value in (*_occurring(values).tolist(), NONE):
        rows = (values == value).nonzero().squeeze(-1)
        places.append(torch.nn.functional.pad(rows, (0, -rows.numel() % _BYTE_BITS), value=-1))
        bounds.append(bounds[-1] + places[-1].numel() // _BYTE_BITS)
    return torch.cat(places), torch.tensor(bounds[:-1])


def _pack_in_orders(
    members: torch.Tensor, orders: Sequence[torch.Tensor], n_places: int
) -> torch.Tensor:
    """Returns the sets once for each order of the records: int64 ``[orders * sets, words]``.

    Args:
        members: bool ``[sets, rows]``.
        orders: for each place the record in it, or -1: long ``[places]``.
        n_places: how many places a packed set has, a multiple of the bits of a word.
    """
    n_sets = members.shape[0]
    packed = torch.empty((len(orders) * n_sets, n_places // WORD_BITS), dtype=torch.long)
    block = max(1, _BUILD_BLOCK // n_places)
    for number, place in enumerate(orders):
        for first in range(0, n_sets, block):
            part = pack(_placed(members[first : first + block], place, n_places))
            packed[number * n_sets + first :][: part.shape[0]] = part
    return packed


def _placed(members: torch.Tensor, place: torch.Tensor, n_places: int) -> torch.Tensor:
    """Returns bool ``[sets, n_places]``: whether the record at each place is a member."""
    in_place = members.index_select(1, place.clamp(min=0)) & (place >= 0)
    return torch.nn.functional.pad(in_place, (0, n_places - place.numel()))


def _extend(entries: torch.Tensor, length: int) -> torch.Tensor:
    """Returns ``entries`` with the last one repeated up to ``length``; "no match" for none."""
    last = entries[-1] if entries.numel() else torch.tensor(NO_MATCH)
    return torch.cat([entries, last.expand(length - entries.numel())])


def _literal_counts(values: torch.Tensor, n_values: int) -> torch.Tensor:
    """Returns long ``[n_values]``: how many records have each value id, 0 for reserved ids."""
    counts = torch.bincount(values, minlength=n_values)
    counts[:FIRST_VALUE] = 0
    return counts


def _intersect(sets: torch.Tensor, chosen: torch.Tensor) -> torch.Tensor:
    """Returns the intersection of ``sets[chosen[..., k]]`` over k: int64 ``[*B, W]``."""
    by_slot = chosen.reshape(-1, chosen.shape[-1]).t().contiguous().unbind()
    words = sets.index_select(0, by_slot[0])
    for column in by_slot[1:]:
        words &= sets.index_select(0, column)
    return words.view(*chosen.shape[:-1], sets.shape[-1])
