"""Measured errors: their frequencies are those counted."""

import pytest
import torch

from bbq_torchrl.domains import tensorize
from bbq_torchrl.domains.frames import Coding
from bbq_torchrl.simulator import MeasuredErrors, Simulator, Utterance
from bbq_torchrl.simulator.measured_errors import CONTEXTS

DRAWS = 20_000

NOTHING = {
    "acts": {},
    "values": {context: {} for context in CONTEXTS},
    "inserted": {},
    "requests": {},
}
CITY = {"city=seattle": 500, "city=portland": 300, "": 100, "state=wa": 100}
SOME = {
    "acts": {"opening request asking": {"request": 3, "inform": 1}},
    "values": {
        **NOTHING["values"],
        "opening": {"city": {"seattle": CITY}},
        "asked": {"city": {"seattle": {"city=seattle": 1_000}}},
    },
    "inserted": {"opening": {"turns": 1_000, "genre=comedy": 200}},
    "requests": {"1 said opening": {"theater": [900, 1_000]}, "1 unsaid opening": {"date": [1, 4]}},
}


class Opening:
    """An opening, heard many times: informs Seattle and requests the theater."""

    def __init__(self, domain, counts):
        tensors = tensorize(domain)
        self.coding, errors = Coding(tensors), MeasuredErrors(tensors, counts)
        self.said = Utterance(
            torch.full((DRAWS,), tensors.act["request"]),
            torch.tensor(self.coding.ids({"city": "seattle"})).repeat(DRAWS, 1),
            torch.tensor(self.coding.flags(["theater"])).repeat(DRAWS, 1),
        )
        draws = Simulator(tensors, errors=errors).draw_reset((DRAWS,))
        silent, active = torch.zeros(DRAWS).bool(), torch.ones(tensors.n_slots).bool()
        self.heard = errors.transmit(self.said, None, self.said.act, silent, draws, active)

    def shares(self):
        """Returns the frequency of each combination of values heard."""
        rows, counts = self.heard.informs.unique(dim=0, return_counts=True)
        values = [self.coding.values(row) for row in rows.tolist()]
        texts = [" ".join(f"{slot}={value}" for slot, value in one.items()) for one in values]
        return dict(zip(texts, (counts / DRAWS).tolist(), strict=True))

    def asked(self, slot):
        """Returns the frequency at which the slot is heard as requested."""
        return self.heard.requests[:, self.coding.slots.index(slot)].double().mean().item()


@pytest.mark.parametrize("inserted", [{}, {"opening": {"turns": 10, "city=portland": 10}}])
def test_what_was_never_misheard_is_heard_and_gives_way_to_nothing_new(movie, inserted):
    opening = Opening(movie, {**NOTHING, "inserted": inserted})
    for part in ("act", "informs", "requests"):
        assert torch.equal(getattr(opening.heard, part), getattr(opening.said, part))


def test_values_are_kept_changed_dropped_and_moved_as_they_were(movie):
    expected = {
        "city=seattle": 0.4,
        "city=seattle genre=comedy": 0.1,
        "city=portland": 0.24,
        "city=portland genre=comedy": 0.06,
        "": 0.08,
        "genre=comedy": 0.02,
        "state=wa": 0.08,
        "genre=comedy state=wa": 0.02,
    }
    assert Opening(movie, SOME).shares() == pytest.approx(expected, abs=0.02)


def test_requests_and_acts_are_heard_as_they_were(movie):
    opening = Opening(movie, SOME)
    assert opening.asked("theater") == pytest.approx(0.9, abs=0.02)
    assert opening.asked("date") == pytest.approx(0.25, abs=0.02)
    asks = opening.heard.requests.any(-1)
    informs = opening.heard.act == opening.coding.acts.index("inform")
    assert informs[asks].double().mean() == pytest.approx(0.25, abs=0.02)
    assert not informs[~asks].any()


@pytest.mark.parametrize(
    "counts",
    [
        {"values": {**NOTHING["values"], "told": {"city": {"atlantis": {"": 1}}}}},
        {"inserted": {"offer": {"turns": 2, "planet=mars": 1}}},
        {"acts": {"opening request asking": {"sing": 1}}},
    ],
)
def test_counts_of_another_domain_are_refused(movie, counts):
    with pytest.raises(KeyError):
        MeasuredErrors(tensorize(movie), {**NOTHING, **counts})
