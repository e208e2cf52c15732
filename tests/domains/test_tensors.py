"""The ids of values. The oracle's agreement shows that ids mean the same as texts."""

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
    Goal,
    fold,
    tensorize,
)


def test_reserved_ids_come_first():
    assert (NONE, DONT_CARE, NO_MATCH, AVAILABLE, FIRST_VALUE) == (0, 1, 2, 3, 4)
    assert [*RESERVED_TEXT] == [DONT_CARE, NO_MATCH, AVAILABLE]


@pytest.mark.parametrize("name", ["movie", "restaurant", "miulab"])
def test_a_slots_ids_are_the_reserved_ones_and_all_its_values_once(name, request):
    domain = request.getfixturevalue(name)
    tensors = tensorize(domain)
    for index, slot in enumerate(domain.slots):
        reserved, texts = tensors.vocabulary[index][:FIRST_VALUE], tensors.vocabulary[index][4:]
        assert reserved == ("", *RESERVED_TEXT.values())
        texts = [fold(text) for text in texts]
        known = {fold(text) for text in domain.error_values.get(slot, ())}
        known |= {fold(record[slot]) for record in domain.records if slot in record}
        known |= {fold(g.constraints[slot]) for g in domain.goals if slot in g.constraints}
        assert sorted(texts) == sorted(known - {fold(RESERVED_TEXT[DONT_CARE])})
        assert int(tensors.n_values[index]) == FIRST_VALUE + len(texts)


def test_spellings_that_differ_in_case_are_one_value_shown_as_first_met(restaurant):
    domain = replace(
        restaurant,
        error_values={"area": ("North",)},
        records=({"area": "NORTH"}, {"area": "south"}),
        goals=(Goal({"area": "SOUTH"}), Goal({"area": "i DO not care"})),
    )
    tensors = tensorize(domain)
    area = tensors.slot["area"]
    assert tensors.vocabulary[area][FIRST_VALUE:] == ("North", "south")
    assert tensors.records[:, area].tolist() == [FIRST_VALUE, FIRST_VALUE + 1]
    assert tensors.goal_constraints[:, area].tolist() == [FIRST_VALUE + 1, DONT_CARE]


def test_a_value_listed_twice_is_drawn_twice_as_often(restaurant):
    tensors = tensorize(replace(restaurant, error_values={"area": ("north", "south", "North")}))
    area = tensors.slot["area"]
    assert tensors.error_values[area].tolist() == [FIRST_VALUE, FIRST_VALUE + 1, FIRST_VALUE]


def test_a_domain_without_error_values_has_counts_of_zero(restaurant):
    tensors = tensorize(replace(restaurant, error_values={}))
    assert tensors.error_count.sum() == 0
    assert tensors.error_values.shape == (len(restaurant.slots), 1)


def test_moving_to_a_device_moves_every_tensor_and_nothing_else(restaurant):
    tensors = tensorize(restaurant)
    moved = tensors.to("meta")
    for field in fields(tensors):
        before, after = getattr(tensors, field.name), getattr(moved, field.name)
        if isinstance(before, torch.Tensor):
            assert (after.device.type, after.shape) == ("meta", before.shape)
        else:
            assert after is before
