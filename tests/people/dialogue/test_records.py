"""The nearest records to a person's wishes, in domains with hardly any."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
import yaml

from bbq_torchrl.domains import tensorize
from bbq_torchrl.domains.frames import Coding
from bbq_torchrl.people.dialogue.records import Records

TABLE = yaml.safe_load(Path(__file__).with_name("records.yaml").read_text(encoding="utf-8"))


@pytest.mark.parametrize("case", TABLE, ids=lambda case: case["what"])
def test_what_is_near(movie, case):
    domain = tensorize(replace(movie, records=tuple(case["records"])))
    records, coding = Records(domain), Coding(domain)
    held = torch.tensor(coding.ids(case["held"]))
    refused = [
        (domain.slot[slot], coding.ids({slot: value})[domain.slot[slot]])
        for slot, value in case.get("refused", {}).items()
    ]
    words = records.vocabulary
    if "nearest" in case:
        near = records.nearest(held, [refused] if refused else ())
        found = {movie.slots[slot]: words[slot][value] for slot, value in near.items()}
        assert found == case["nearest"]
    for slot, values in case.get("choices", {}).items():
        ids = records.choices(held, domain.slot[slot], case.get("direction", 0))
        assert [words[domain.slot[slot]][value] for value in ids] == values
    if "conflict" in case:
        assert [movie.slots[slot] for slot in records.conflict(held)] == case["conflict"]
    if "best" in case:
        differs, lacks, distance = records.best(held)
        assert [int(differs.sum()), int(lacks.sum())] == case["best"]
        assert distance > 0
        assert not records.is_listed(domain.slot["city"])


def test_a_record_of_a_known_place_is_in_no_other_state(spelling):
    domain, rows = tensorize(spelling.domain), spelling.domain.records
    records, coding = Records(domain), Coding(domain)
    place = {"state": "ca"}
    row = next(n for n, r in enumerate(rows) if "city" in r and "state" not in r)
    for told, is_elsewhere in ((place, True), ({**place, "city": rows[row]["city"]}, False)):
        differs, _ = records.compare(torch.tensor(coding.ids(told)))
        assert bool(differs[row].any()) == is_elsewhere


def test_a_chain_that_begins_the_name_of_a_theater_is_its_chain(movie, spelling):
    chains = spelling.lexicon.values("theater_chain")  # also of chains that no record names
    begun = 0
    for own, record in zip(movie.records, spelling.domain.records, strict=True):
        fit = [one for one in chains if record.get("theater", "").startswith(f"{one} ")]
        assert "theater_chain" in own or record.get("theater_chain") in (fit or [None])
        begun += bool(fit) and "theater_chain" not in own
    assert begun
