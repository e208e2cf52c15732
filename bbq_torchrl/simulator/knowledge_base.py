"""The knowledge base: matching records as sets of bits, and their most frequent values."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from bbq_torchrl.domains import DomainTensors
from bbq_torchrl.domains.tensors import Movable, rows
from bbq_torchrl.domains.values import DONT_CARE, FIRST_VALUE, NO_MATCH, NONE

WORD_BITS = 64
_BYTE_BITS = 8
_WORD_BYTES = WORD_BITS // _BYTE_BITS
_TOP_BYTE = WORD_BITS - _BYTE_BITS
_PAIRS = 0x5555555555555555
_QUADS = 0x3333333333333333
_BYTES = 0x0F0F0F0F0F0F0F0F
_ONES = 0x0101010101010101


class KnowledgeBase(Movable):
    """The knowledge base of a domain as bit-packed sets of records.

    For each value of each slot it stores the set of records that match it: all records for no value
    and for "I do not care", an empty set for "no match", otherwise those with the value (records
    without the slot do not match). The records that match all values the tracker holds are the
    intersection: a few ANDs on 64 records at a time.

    To count each value of a slot among the matching records, it stores the same sets again for each
    slot that the agent can inform or offer, with the records ordered by that slot's value and each
    value starting a new byte. The counts are then differences of a running sum over bytes. Only
    values that occur in records are counted, so the cost of a turn depends on the records, not on
    the lists of values. Memory: a bit per value and record, and as much again for each slot that
    the agent can inform or offer. There the records of a value fill whole bytes, so it is a byte
    per value and record if no two records share a value.

    Args:
        domain: the domain's tensors, on the CPU: construction consists of many small steps, which
            would be slow on an accelerator.
    """

    def __init__(self, domain: DomainTensors) -> None:
        records = domain.records
        informed = domain.action_slot[domain.action_act != domain.act["request"]].unique().tolist()
        listed = [slot for slot in informed if slot not in (-1, domain.ticket, domain.complete)]
        # A slot that can only have no value or "I do not care" matches every record.
        decides = domain.constrains & (domain.n_values > FIRST_VALUE)
        decides[listed] = domain.constrains[listed]
        self.slots = decides.nonzero().squeeze(-1)
        allowed = _allowed_records(domain, self.slots.tolist())
        sizes = domain.n_values[self.slots]
        self.first_set = sizes.cumsum(0) - sizes
        self.sets = pack(allowed)

        # The ordered sets. All values that no record has share an empty set.
        self.ordered_set, distinct = _distinct_rows(allowed)
        self.order_of_slot = torch.zeros(domain.n_slots, dtype=torch.long)
        columns = [records[:, slot] for slot in listed] or [torch.zeros_like(records[:, 0])]
        orders = [_order_by_value(column) for column in columns]
        for position, slot in enumerate(listed):
            self.order_of_slot[slot] = position
        n_bytes = max(order.numel() for order, _ in orders) // _BYTE_BITS
        n_bytes += -n_bytes % _WORD_BYTES
        n_bounds = max(bounds.numel() for _, bounds in orders)
        self.max_counts = max(1, n_bounds - 1)
        self.ordered_sets = _pack_in_orders(
            distinct, [order for order, _ in orders], n_bytes * _BYTE_BITS
        )
        self.sets_per_order = distinct.shape[0]
        # Bounds beyond a slot's last value repeat the last one, so they count no records.
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

    def _chosen(self, held: Tensor) -> Tensor:
        """Returns the index of the set of each slot's value, long ``[*B, K]``."""
        return held.index_select(-1, self.slots) + self.first_set

    def matching(self, held: Tensor) -> Tensor:
        """Returns the records that match all values held, as packed sets, int64 ``[*B, W]``.

        Args:
            held: long ``[*B, S]``, value ids.
        """
        return _intersect(self.sets, self._chosen(held))

    def matching_counts(self, held: Tensor) -> Tensor:
        """Counts the records that match all values held. Returns long ``[*B]``."""
        return popcount(self.matching(held))

    def value_counts(self, held: Tensor) -> Tensor:
        """Counts, for each slot, the records that have the value held. Returns long ``[*B, S]``.

        The count is 0 without a value, for reserved values, and for slots that never constrain the
        records.
        """
        return self.counts.take(held + self.first_count)

    def counts_by_value(self, held: Tensor, slot: Tensor) -> tuple[Tensor, Tensor]:
        """Counts the matching records by their value of one slot.

        Args:
            held: long ``[*B, S]``, value ids.
            slot: long ``[*B]``, a slot that the agent can inform or offer; the counts of any other
                slot are meaningless, but its total is right.

        Returns:
            Long ``[*B, C]``, the number of matching records for each value that occurs in records,
            in the order of :meth:`counted_values`; and long ``[*B]``, the number of matching
            records, including those without the slot.
        """
        order = self.order_of_slot.take(slot)
        sets = self.ordered_set.take(self._chosen(held))
        words = _intersect(self.ordered_sets, sets + (order * self.sets_per_order)[..., None])
        running = byte_counts(words).cumsum(-1, dtype=torch.int32)
        below = running.gather(-1, rows(self.bounds, order))
        return below.diff(dim=-1), running[..., -1]

    def counted_values(self, slot: Tensor) -> Tensor:
        """Returns the value ids, long ``[*B, C]``, that :meth:`counts_by_value` counts.

        Args:
            slot: long ``[*B]``, the same as there.
        """
        return rows(self.counted, self.order_of_slot.take(slot))

    def most_frequent(self, counts: Tensor, slot: Tensor) -> Tensor:
        """Returns the ids of the most frequent values, long ``[*B]``; ties go to the lowest id.

        Args:
            counts: long ``[*B, C]``, of :meth:`counts_by_value`; if all are 0, the value is
                "no match".
            slot: long ``[*B]``, the same as there.
        """
        # argmax returns the first of equal counts, and values are in the order of their ids.
        best = counts.argmax(-1, keepdim=True)
        is_found = counts.gather(-1, best).squeeze(-1) > 0
        index = self.order_of_slot.take(slot) * self.max_counts + best.squeeze(-1)
        return torch.where(is_found, self.counted.take(index), NO_MATCH)


def _allowed_records(domain: DomainTensors, slots: Sequence[int]) -> Tensor:
    """Returns the records that match each value of each slot, bool ``[values, rows]``."""
    allowed = []
    for slot in slots:
        values = torch.arange(int(domain.n_values[slot]))
        with_value = domain.records[:, slot] == values[:, None]
        with_value[:FIRST_VALUE] = False
        with_value[[NONE, DONT_CARE]] = True
        allowed.append(with_value)
    return torch.cat(allowed)


def _distinct_rows(allowed: Tensor) -> tuple[Tensor, Tensor]:
    """Returns the index of each row's set, and the sets: the full, the empty, then the others."""
    everything, nothing = torch.ones_like(allowed[:1]), torch.zeros_like(allowed[:1])
    is_empty, is_full = ~allowed.any(-1), allowed.all(-1)
    is_partial = ~is_empty & ~is_full
    index = torch.where(is_partial, is_partial.cumsum(0) + 1, is_empty.long())
    return index, torch.cat([everything, nothing, allowed[is_partial]])


def _occurring(values: Tensor) -> Tensor:
    """Returns the value ids that occur in records, sorted, long ``[values]``."""
    return values[values >= FIRST_VALUE].unique()


def _order_by_value(values: Tensor) -> tuple[Tensor, Tensor]:
    """Orders the records by their value of a slot; each value starts a new byte.

    Args:
        values: long ``[rows]``, each record's value of the slot.

    Returns:
        The record at each position, or -1, long ``[positions]``, a multiple of 8; and for each
        value that occurs the last byte before it, then the last byte of the last value, long
        ``[values + 1]``. The first byte is empty, so that a byte precedes the first value. Records
        without a value come last.
    """
    positions = [torch.full((_BYTE_BITS,), -1)]
    bounds = [0]
    for value in (*_occurring(values).tolist(), NONE):
        rows = (values == value).nonzero().squeeze(-1)
        positions.append(torch.nn.functional.pad(rows, (0, -rows.numel() % _BYTE_BITS), value=-1))
        bounds.append(bounds[-1] + positions[-1].numel() // _BYTE_BITS)
    return torch.cat(positions), torch.tensor(bounds[:-1])


def _pack_in_orders(members: Tensor, orders: Sequence[Tensor], n_positions: int) -> Tensor:
    """Packs the sets in each order of the records. Returns int64 ``[orders * sets, words]``.

    Args:
        members: bool ``[sets, rows]``.
        orders: long ``[positions]`` each: the record at each position, or -1.
        n_positions: number of positions of a packed set, a multiple of the bits of a word.
    """
    by_row = members.t().contiguous()
    return torch.cat([pack(_ordered(by_row, order, n_positions).t()) for order in orders])


def _ordered(by_row: Tensor, order: Tensor, n_positions: int) -> Tensor:
    """Returns bool ``[n_positions, sets]``: whether the record at each position is a member."""
    is_member = by_row.index_select(0, order.clamp(min=0)) & (order >= 0)[:, None]
    return torch.nn.functional.pad(is_member, (0, 0, 0, n_positions - order.numel()))


def _extend(entries: Tensor, length: int) -> Tensor:
    """Pads ``entries`` to ``length`` with the last one; "no match" if empty."""
    last = entries[-1] if entries.numel() else torch.tensor(NO_MATCH)
    return torch.cat([entries, last.expand(length - entries.numel())])


def _literal_counts(values: Tensor, n_values: int) -> Tensor:
    """Counts the records of each value id, long ``[n_values]``; 0 for reserved ids."""
    counts = torch.bincount(values, minlength=n_values)
    counts[:FIRST_VALUE] = 0
    return counts


def _intersect(sets: Tensor, chosen: Tensor) -> Tensor:
    """Returns the intersection of ``sets[chosen[..., k]]`` over k: int64 ``[*B, W]``."""
    by_slot = chosen.reshape(-1, chosen.shape[-1]).t().contiguous().unbind()
    words = sets.index_select(0, by_slot[0])
    for column in by_slot[1:]:
        words &= sets.index_select(0, column)
    return words.view(*chosen.shape[:-1], sets.shape[-1])


# -- sets of records as bits ------------------------------------------------------------------


def pack(members: Tensor) -> Tensor:
    """Packs membership flags into words. Returns int64 ``[*batch, ceil(rows / 64)]``.

    Args:
        members: bool ``[*batch, rows]``. Row ``r`` becomes bit ``r % 8`` of byte ``r // 8`` of the
            words' memory.

    Examples:
        >>> pack(torch.tensor([True, False, True]))
        tensor([5])
    """
    if missing := -members.shape[-1] % WORD_BITS:
        members = torch.nn.functional.pad(members, (0, missing))
    packed, *rest = members.to(torch.uint8).unflatten(-1, (-1, _BYTE_BITS)).unbind(-1)
    for bit, flags in enumerate(rest, start=1):
        packed = packed | flags << bit
    return packed.contiguous().view(torch.int64)


def _counts_in_bytes(words: Tensor) -> Tensor:
    """Returns words in which each byte is the number of bits set in that byte of ``words``."""
    # Bits are added in pairs, in fours, then in bytes. The masks also remove the sign bits that >>
    # shifts in.
    words = words - ((words >> 1) & _PAIRS)
    words = (words & _QUADS) + ((words >> 2) & _QUADS)
    return (words + (words >> 4)) & _BYTES


def popcount(words: Tensor) -> Tensor:
    """Counts the members of each packed set. Returns long ``[*batch]``.

    Args:
        words: int64 ``[*batch, W]``.

    Examples:
        >>> popcount(torch.tensor([[5, -1]]))
        tensor([66])
    """
    return ((_counts_in_bytes(words) * _ONES) >> _TOP_BYTE).sum(-1)


def byte_counts(words: Tensor) -> Tensor:
    """Counts the members in each byte of each packed set. Returns uint8 ``[*batch, 8 * W]``.

    Args:
        words: int64 ``[*batch, W]``.

    Examples:
        >>> byte_counts(torch.tensor([0x0301]))
        tensor([1, 2, 0, 0, 0, 0, 0, 0], dtype=torch.uint8)
    """
    return _counts_in_bytes(words).view(torch.uint8)
