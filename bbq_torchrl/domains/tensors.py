"""A domain as tensors of ids, for the batched simulator, and choices by index.

Nothing here draws. The uniform numbers come from the environment's generator, so equal numbers give
equal choices.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from bbq_torchrl.domains.values import FIRST_VALUE, NONE, RESERVED_TEXT, fold, value_ids

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from typing_extensions import Self

    from bbq_torchrl.domains.domain import Domain


class Movable:
    """An object whose tensors are its attributes, or attributes of movable ones."""

    def to(self, device: torch.device | str) -> Self:
        """Returns a copy with every tensor on ``device``."""
        moved = copy(self)
        for name, value in vars(self).items():
            if hasattr(value, "to"):
                vars(moved)[name] = value.to(device)
        return moved


@dataclass(frozen=True)
class DomainTensors(Movable):
    """A :class:`~bbq_torchrl.domains.Domain` as ids.

    Sizes: ``N`` actions, ``S`` slots, ``G`` goals, ``E`` the longest list of error values. Value
    ids are per slot; :mod:`bbq_torchrl.domains.values` names the reserved ones.

    Args:
        n_acts: number of dialogue acts.
        n_slots: number of slots, ``S``.
        n_actions: number of agent actions, ``N``.
        turn_width: length of the one-hot turn feature.
        act: act name to id.
        slot: slot name to id.
        ticket: id of the ticket slot.
        complete: id of the complete slot.
        opening: bool ``[S]``, informed in every first turn if the goal constrains them.
        action_act: long ``[N]``, the act of each action.
        action_slot: long ``[N]``, the slot that each action requests, informs or offers, or -1.
        has_choices: whether any action is a multiple choice.
        records: long ``[rows, S]``, value ids, 0 for absent values.
        goal_constraints: long ``[G, S]``, value ids, 0 for slots without a constraint.
        goal_requests: bool ``[G, S]``, the ticket slot included.
        n_values: long ``[S]``, number of value ids of each slot, reserved ones included.
        constrains: bool ``[S]``, whether the slot's tracked value constrains the records.
        error_values: long ``[S, E]``, the values that an error can substitute, padded with 0.
        error_count: long ``[S]``, the number of ``error_values`` without the padding.
        vocabulary: per slot, id to text; id 0 is the empty text.
    """

    n_acts: int
    n_slots: int
    n_actions: int
    turn_width: int
    act: Mapping[str, int]
    slot: Mapping[str, int]
    ticket: int
    complete: int
    opening: Tensor
    action_act: Tensor
    action_slot: Tensor
    has_choices: bool
    records: Tensor
    goal_constraints: Tensor
    goal_requests: Tensor
    n_values: Tensor
    constrains: Tensor
    error_values: Tensor
    error_count: Tensor
    vocabulary: tuple[tuple[str, ...], ...]


def build_vocabulary(domain: Domain) -> tuple[tuple[str, ...], ...]:
    """Returns, per slot, the text of each value id.

    A slot has the error values first, then the other values of records, then those of goals.
    Spellings that differ only in case are one value, with the first spelling as its text.
    """
    texts: list[dict[str, str]] = [{} for _ in domain.slots]
    position = {slot: index for index, slot in enumerate(domain.slots)}
    reserved = {fold(text) for text in RESERVED_TEXT.values()}

    def add(slot: str, values: Iterable[str]) -> None:
        known = texts[position[slot]]
        for value in values:
            if fold(value) not in reserved:
                known.setdefault(fold(value), value)

    for slot, values in domain.error_values.items():
        add(slot, values)
    for holder in (*domain.records, *(goal.constraints for goal in domain.goals)):
        for slot, value in holder.items():
            add(slot, [value])
    head = ("", *(RESERVED_TEXT[key] for key in range(1, FIRST_VALUE)))
    return tuple((*head, *known.values()) for known in texts)


def tensorize(domain: Domain) -> DomainTensors:
    """Returns ``domain`` as tensors of ids, on the CPU.

    Examples:
        >>> from bbq_torchrl.domains import movie_domain
        >>> tensors = tensorize(movie_domain())
        >>> tensors.n_acts, tensors.n_slots, tensors.n_actions
        (11, 29, 39)
    """
    act = {name: index for index, name in enumerate(domain.acts)}
    slot = {name: index for index, name in enumerate(domain.slots)}
    vocabulary = build_vocabulary(domain)
    ids = value_ids(vocabulary)

    def mask(names: Iterable[str]) -> Tensor:
        chosen = set(names)
        return torch.tensor([name in chosen for name in domain.slots])

    def encode(rows: Sequence[Mapping[str, str]]) -> Tensor:
        encoded = [[NONE] * len(slot) for _ in rows]
        for row, values in zip(encoded, rows, strict=True):
            for name, value in values.items():
                row[slot[name]] = ids[slot[name]][fold(value)]
        return torch.tensor(encoded, dtype=torch.long).view(len(rows), len(slot))

    error_count = torch.tensor([len(domain.error_values.get(name, ())) for name in domain.slots])
    error_values = torch.full((len(slot), max(1, int(error_count.max()))), NONE)
    for name, values in domain.error_values.items():
        index = slot[name]
        error_values[index, : len(values)] = torch.tensor([ids[index][fold(v)] for v in values])

    return DomainTensors(
        n_acts=len(act),
        n_slots=len(slot),
        n_actions=len(domain.actions),
        turn_width=domain.turn_width,
        act=act,
        slot=slot,
        ticket=slot[domain.ticket_slot],
        complete=slot[domain.complete_slot],
        opening=mask(domain.opening_slots),
        action_act=torch.tensor([act[action.act] for action in domain.actions]),
        action_slot=torch.tensor([slot.get(action.slot or "", -1) for action in domain.actions]),
        has_choices=any(action.kind == "multiple_choice" for action in domain.actions),
        records=encode(domain.records),
        goal_constraints=encode([goal.constraints for goal in domain.goals]),
        goal_requests=torch.stack(
            [mask((*goal.requests, domain.ticket_slot)) for goal in domain.goals]
        ),
        n_values=torch.tensor([len(texts) for texts in vocabulary]),
        constrains=~mask(domain.free_slots),
        error_values=error_values,
        error_count=error_count,
        vocabulary=vocabulary,
    )


# -- choices by index, and rows of tables ------------------------------------------------------


def index_below(uniform: Tensor, count: Tensor | int) -> Tensor:
    """Chooses an index below ``count``, ``floor(uniform * count)``. Returns long, same shape.

    Args:
        uniform: float32 in [0, 1).
        count: the number of choices, at least 0; 0 gives 0.

    Examples:
        >>> index_below(torch.tensor([0.0, 0.49, 0.99]), 2)
        tensor([0, 0, 1])
    """
    # In float32 the product can round up to count itself.
    return (uniform.double() * count).long()


def pick_slot(pool: Tensor, uniform: Tensor) -> Tensor:
    """Chooses a slot of each set with equal probability. Returns one-hot flags, bool ``[*B, S]``.

    The slot with the largest number wins; ties go to the lowest slot. An empty set has no flag.

    Args:
        pool: bool ``[*B, S]``, the slots to choose from.
        uniform: float32 ``[*B, S]`` in [0, 1).

    Examples:
        >>> pick_slot(torch.tensor([True, False, True]), torch.tensor([0.2, 0.9, 0.3]))
        tensor([False, False,  True])
    """
    return one_hot(torch.where(pool, uniform, -1.0).argmax(-1), pool.shape[-1]) & pool


def one_hot(index: Tensor, count: int) -> Tensor:
    """Returns one-hot flags of an index, bool ``[*B, count]``; a negative index has no flag.

    Examples:
        >>> one_hot(torch.tensor([1, -1]), 3)
        tensor([[False,  True, False],
                [False, False, False]])
    """
    return index[..., None] == torch.arange(count, device=index.device)


def rows(table: Tensor, index: Tensor) -> Tensor:
    """Returns ``table[index]``, shape ``[*B, *row]``.

    On the CPU this copies whole rows, about five times as fast as advanced indexing.

    Args:
        table: ``[n, *row]``.
        index: long ``[*B]``, in [0, n).

    Examples:
        >>> rows(torch.tensor([[1, 2], [3, 4]]), torch.tensor([1, 0, 1]))
        tensor([[3, 4],
                [1, 2],
                [3, 4]])
    """
    return table.index_select(0, index.reshape(-1)).view(*index.shape, *table.shape[1:])
