"""How often errors are, and what they leave alone; what they do is spelled on the oracle."""

from __future__ import annotations

import pytest
import torch
from oracle.small import SLOTS, small_domain
from tensordict import TensorDict

from bbq_torchrl.domains import Goal, tensorize
from bbq_torchrl.simulator import ErrorModel


def test_slots_are_hit_as_often_as_the_probability_says():
    domain = tensorize(small_domain(Goal({"city": "boston"})))
    count, prob = 200_000, 0.3
    model = ErrorModel(domain, prob, "delete")
    generator = torch.Generator().manual_seed(1)
    draws = TensorDict(
        {"error": torch.rand(count, len(SLOTS), generator=generator)}, batch_size=[count]
    )
    sent = model.distort(
        torch.ones(count, len(SLOTS), dtype=torch.long), draws, torch.ones(len(SLOTS)).bool()
    )
    share = (sent == 0).double().mean(0)
    assert (share - prob).abs().max() < 5 * (prob * (1 - prob) / count) ** 0.5


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"slot_error_prob": 1.5}, "slot_error_prob must be a probability .* got 1.5"),
        ({"intent_error_prob": -0.1}, "intent_error_prob must be a probability .* got -0.1"),
        ({"slot_error_prob": float("nan")}, "slot_error_prob must be a probability .* got nan"),
        ({"slot_error_mode": "typo"}, "slot_error_mode must be one of value, slot.* got 'typo'"),
    ],
)
def test_settings_out_of_range_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        ErrorModel(tensorize(small_domain(Goal({}))), **settings)
