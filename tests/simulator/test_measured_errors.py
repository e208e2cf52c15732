"""Errors that were counted are drawn as often as they were counted."""

from __future__ import annotations

import pytest
import torch

from bbq_torchrl.domains import tensorize
from bbq_torchrl.domains.values import NONE
from bbq_torchrl.simulator import MeasuredErrors, Simulator, Utterance

DRAWS = 20_000

NOTHING = {
    "acts": {},
    "values": {"opening": {}, "asked": {}, "beside": {}, "corrected": {}, "told": {}},
    "inserted": {},
    "requests": {},
}
SOME = {
    "acts": {"opening request asking": {"request": 3, "inform": 1}},
    "values": {
        "opening": {
            "city": {
                "seattle": {"city=seattle": 500, "city=portland": 300, "": 100, "state=wa": 100}
            }
        },
        "asked": {"city": {"seattle": {"city=seattle": 1_000}}},
        "beside": {},
        "corrected": {},
        "told": {},
    },
    "inserted": {"opening": {"turns": 1_000, "genre=comedy": 200}},
    "requests": {"1 said opening": {"theater": [900, 1_000]}, "1 unsaid opening": {"date": [1, 4]}},
}


class Opening:
    """One opening said many times: a movie in Seattle, and which theater it is in."""

    def __init__(self, domain, counts):
        self.tensors = tensorize(domain)
        self.slots = domain.slots
        self.errors = MeasuredErrors(self.tensors, counts)
        self.simulator = Simulator(self.tensors, errors=self.errors)
        self.active = torch.ones(self.tensors.n_slots, dtype=torch.bool)
        no_value = torch.zeros(DRAWS, self.tensors.n_slots, dtype=torch.long)
        informs, requests = no_value.clone(), no_value.bool()
        informs[:, self.place("city")] = self.value("city", "seattle")
        requests[:, self.place("theater")] = True
        act = torch.full((DRAWS,), self.tensors.act["request"])
        self.said = Utterance(act, informs, requests)

    def place(self, slot):
        return self.slots.index(slot)

    def value(self, slot, text):
        return self.tensors.vocabulary[self.place(slot)].index(text)

    def heard(self):
        draws = self.simulator.draw_reset((DRAWS,), torch.Generator().manual_seed(0))
        silent = torch.zeros(DRAWS, dtype=torch.bool)
        return self.errors.transmit(self.said, None, self.said.act, silent, draws, self.active)


def near(share, expected):
    return abs(float(share.double().mean()) - expected) < 0.02


def test_what_was_never_said_when_it_was_counted_is_heard_as_it_is(movie):
    opening = Opening(movie, NOTHING)
    heard = opening.heard()
    assert torch.equal(heard.act, opening.said.act)
    assert torch.equal(heard.informs, opening.said.informs)
    assert torch.equal(heard.requests, opening.said.requests)


def test_values_are_kept_changed_dropped_and_moved_as_they_were(movie):
    opening = Opening(movie, SOME)
    informs = opening.heard().informs
    city, state = informs[:, opening.place("city")], informs[:, opening.place("state")]
    assert near(city == opening.value("city", "seattle"), 0.5)
    assert near(city == opening.value("city", "portland"), 0.3)
    assert near(city == NONE, 0.2)
    assert near(state == opening.value("state", "wa"), 0.1)
    assert torch.equal(city[state != NONE] == NONE, torch.ones(int((state != NONE).sum())).bool())
    assert near(informs[:, opening.place("genre")] == opening.value("genre", "comedy"), 0.2)
    named = [opening.place(slot) for slot in ("city", "state", "genre")]
    assert int((informs != NONE).sum()) == int((informs[:, named] != NONE).sum())


def test_a_value_that_nobody_said_takes_no_other_ones_place(movie):
    always = {"opening": {"turns": 10, "city=portland": 10}}
    opening = Opening(movie, NOTHING | {"inserted": always})
    assert torch.equal(opening.heard().informs, opening.said.informs)


def test_requests_and_acts_are_heard_as_they_were(movie):
    opening = Opening(movie, SOME)
    heard = opening.heard()
    assert near(heard.requests[:, opening.place("theater")], 0.9)
    assert near(heard.requests[:, opening.place("date")], 0.25)
    asking = heard.requests.any(-1)
    informs = heard.act == opening.tensors.act["inform"]
    assert near(informs[asking], 0.25)
    assert not informs[~asking].any()


@pytest.mark.parametrize(
    "counts",
    [
        {**NOTHING, "values": {**NOTHING["values"], "told": {"city": {"atlantis": {"": 1}}}}},
        {**NOTHING, "inserted": {"offer": {"turns": 2, "planet=mars": 1}}},
        {**NOTHING, "acts": {"opening request asking": {"sing": 1}}},
    ],
)
def test_counts_of_another_domain_are_refused(movie, counts):
    with pytest.raises(KeyError):
        MeasuredErrors(tensorize(movie), counts)
