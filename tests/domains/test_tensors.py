"""A domain as ids says the same as the domain as text."""

from __future__ import annotations

from dataclasses import fields, replace

import pytest
import torch

from bbq_torchrl.domains import (
    AVAILABLE,
    DONT_CARE,
    FIRST_VALUE,
    NO_MATCH,
    NONE,
    RESERVED_TEXT,
    Domain,
    DomainTensors,
    Goal,
    fold,
    tensorize,
)


@pytest.fixture(params=["movie", "restaurant", "miulab"])
def domain(request: pytest.FixtureRequest) -> Domain:
    return request.getfixturevalue(request.param)


def decode(domain: Domain, tensors: DomainTensors, row: torch.Tensor) -> dict[str, str]:
    """Slot to folded text of a row of value ids."""
    return {
        slot: fold(tensors.vocabulary[index][value])
        for index, (slot, value) in enumerate(zip(domain.slots, row.tolist(), strict=True))
        if value != NONE
    }


def folded(values) -> dict[str, str]:
    return {slot: fold(text) for slot, text in values.items()}


def test_reserved_ids_come_first_in_every_slot(domain: Domain):
    assert (NONE, DONT_CARE, NO_MATCH, AVAILABLE, FIRST_VALUE) == (0, 1, 2, 3, 4)
    reserved = ("", *RESERVED_TEXT.values())
    for texts in tensorize(domain).vocabulary:
        assert texts[:FIRST_VALUE] == reserved


def test_records_and_goals_read_back_as_they_were(domain: Domain):
    tensors = tensorize(domain)
    for record, row in zip(domain.records, tensors.records, strict=True):
        assert decode(domain, tensors, row) == folded(record)
    for index, goal in enumerate(domain.goals):
        row, requested = tensors.goal_constraints[index], tensors.goal_requests[index]
        assert decode(domain, tensors, row) == folded(goal.constraints)
        slots = {domain.slots[slot] for slot in requested.nonzero().flatten().tolist()}
        assert slots == {*goal.requests, domain.ticket_slot}


def test_error_values_read_back_as_they_were(domain: Domain):
    tensors = tensorize(domain)
    for index, slot in enumerate(domain.slots):
        count = int(tensors.error_count[index])
        ids, padding = tensors.error_values[index, :count], tensors.error_values[index, count:]
        texts = [fold(tensors.vocabulary[index][value]) for value in ids.tolist()]
        assert texts == [fold(text) for text in domain.error_values.get(slot, ())]
        assert (ids >= FIRST_VALUE).all()
        assert (padding == NONE).all()


def test_a_slots_ids_are_all_its_values_once(domain: Domain):
    tensors = tensorize(domain)
    for index, slot in enumerate(domain.slots):
        texts = [fold(text) for text in tensors.vocabulary[index][FIRST_VALUE:]]
        known = {fold(text) for text in domain.error_values.get(slot, ())}
        known |= {fold(record[slot]) for record in domain.records if slot in record}
        known |= {fold(g.constraints[slot]) for g in domain.goals if slot in g.constraints}
        assert sorted(texts) == sorted(known - {fold(RESERVED_TEXT[DONT_CARE])})
        assert int(tensors.n_values[index]) == FIRST_VALUE + len(texts)


def test_actions_read_back_as_they_were(domain: Domain):
    tensors = tensorize(domain)
    assert tensors.n_actions == len(domain.actions)
    for index, action in enumerate(domain.actions):
        assert domain.acts[tensors.action_act[index]] == action.act
        slot = int(tensors.action_slot[index])
        assert (None if slot < 0 else domain.slots[slot]) == action.slot
    assert tensors.has_choices == (domain.name == "restaurant")


def test_special_and_free_slots_are_ids_of_the_domains_slots(domain: Domain):
    tensors = tensorize(domain)
    assert domain.slots[tensors.ticket] == domain.ticket_slot
    assert domain.slots[tensors.complete] == domain.complete_slot
    free = [s for s, binds in zip(domain.slots, tensors.constrains, strict=True) if not binds]
    assert set(free) == set(domain.free_slots)
    assert [*tensors.act] == list(domain.acts)
    assert [*tensors.slot] == list(domain.slots)


@pytest.mark.parametrize("opening", ["moviename", ("city", "moviename"), (), None])
def test_the_opening_slots_are_flags(movie: Domain, opening):
    domain = replace(movie, opening_slot=opening)
    flags = tensorize(domain).opening.tolist()
    named = {opening} if isinstance(opening, str) else set(opening or ())
    assert {slot for slot, flag in zip(movie.slots, flags, strict=True) if flag} == named


def test_spellings_that_differ_in_case_are_one_value_shown_as_first_met(restaurant: Domain):
    domain = replace(
        restaurant,
        error_values={"area": ("North",)},
        records=({"area": "NORTH"}, {"area": "south"}),
        goals=(Goal({"area": "north"}), Goal({"area": "i DO not care"})),
    )
    tensors = tensorize(domain)
    area = tensors.slot["area"]
    assert tensors.vocabulary[area][FIRST_VALUE:] == ("North", "south")
    assert tensors.records[:, area].tolist() == [FIRST_VALUE, FIRST_VALUE + 1]
    assert tensors.goal_constraints[:, area].tolist() == [FIRST_VALUE, DONT_CARE]


def test_a_value_listed_twice_is_drawn_twice_as_often(restaurant: Domain):
    tensors = tensorize(replace(restaurant, error_values={"area": ("north", "south", "North")}))
    area = tensors.slot["area"]
    assert tensors.error_values[area].tolist() == [FIRST_VALUE, FIRST_VALUE + 1, FIRST_VALUE]


def test_a_domain_without_error_values_has_counts_of_zero(restaurant: Domain):
    tensors = tensorize(replace(restaurant, error_values={}))
    assert tensors.error_count.sum() == 0
    assert tensors.error_values.shape == (len(restaurant.slots), 1)


def test_moving_to_a_device_moves_every_tensor_and_nothing_else(restaurant: Domain):
    tensors = tensorize(restaurant)
    moved = tensors.to("meta")
    for field in fields(tensors):
        before, after = getattr(tensors, field.name), getattr(moved, field.name)
        if isinstance(before, torch.Tensor):
            assert (after.device.type, after.shape) == ("meta", before.shape)
        else:
            assert after is before
