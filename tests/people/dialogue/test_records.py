"""The nearest records to a person's wishes, in domains with hardly any."""

from dataclasses import replace

import pytest
import torch

from bbq_torchrl.domains import tensorize
from bbq_torchrl.domains.frames import Coding
from bbq_torchrl.people.dialogue.records import Records

WONKA = {"moviename": "wonka", "city": "reno", "date": "saturday night", "starttime": "6:30 pm"}


@pytest.fixture
def kept(movie):
    """Returns the records of a domain that has only the given ones, and ids of values."""

    def kept(*rows):
        domain = replace(movie, records=rows)
        coding = Coding(tensorize(domain))
        return Records(tensorize(domain)), lambda **values: torch.tensor(coding.ids(values))

    return kept


def test_the_one_record_is_near_until_it_is_refused(kept, movie):
    records, ids = kept(WONKA)
    held = ids(moviename="wonka", city="newark")
    city, reno = movie.slots.index("city"), int(ids(city="reno").max())
    assert records.nearest(held) == {city: reno}
    assert records.choices(held, city) == [reno]
    assert records.conflict(held) == (city,)
    assert records.nearest(held, [[(city, reno)]]) == {}
    assert records.nearest(ids(**WONKA)) == {}


def test_lists_have_what_the_wishes_say_times_by_the_clock_and_no_absent_city(kept, movie):
    late, early = {**WONKA, "starttime": "9:15 pm"}, {**WONKA, "starttime": "11:30 am"}
    nowhere = {"moviename": "wonka", "starttime": "5 pm"}
    records, ids = kept(WONKA, late, early, late, nowhere, {**WONKA, "starttime": "after work"})
    time = movie.slots.index("starttime")
    held = ids(moviename="wonka", city="reno", genre="horror")
    values = [records.vocabulary[time][value] for value in records.choices(held, time)]
    assert values == ["11:30 am", "6:30 pm", "9:15 pm"]
    six = ids(moviename="wonka", city="reno", starttime="6:30 pm")
    later = records.choices(six, time, 1)
    assert [records.vocabulary[time][value] for value in later] == ["9:15 pm"]


def test_a_record_of_absent_values_contradicts_and_offers_nothing(kept, movie):
    records, ids = kept({"genre": "horror"})
    held = ids(moviename="wonka", city="newark")
    differs, lacks, distance = records.best(held)
    assert (int(differs.sum()), int(lacks.sum())) == (0, 2)
    assert distance > 0
    assert records.nearest(held) == {}
    assert records.choices(held, movie.slots.index("city")) == []
    assert not records.is_listed(movie.slots.index("city"))


def test_a_record_of_a_known_place_is_in_no_other_state(spelling):
    domain, rows = tensorize(spelling.domain), spelling.domain.records
    records, coding = Records(domain), Coding(domain)
    place = {"state": "ca"}
    row = next(n for n, r in enumerate(rows) if "city" in r and "state" not in r)
    for told, is_elsewhere in ((place, True), ({**place, "city": rows[row]["city"]}, False)):
        differs, _ = records.compare(torch.tensor(coding.ids(told)))
        assert bool(differs[row].any()) == is_elsewhere


def test_a_time_is_near_a_part_of_the_day(kept, movie):
    time = movie.slots.index("starttime")
    noon, other = (
        {**WONKA, "starttime": "noon"},
        {"moviename": "nope", "starttime": "in the evening"},
    )
    records, ids = kept(noon, WONKA, other)
    held = ids(moviename="wonka", city="reno", starttime="in the evening")
    assert records.vocabulary[time][records.nearest(held)[time]] == "6:30 pm"


def test_what_no_record_has_is_in_the_way_whatever_the_others(kept):
    records, ids = kept(WONKA, {**WONKA, "moviename": "barbie", "genre": "horror"})
    held = ids(moviename="nope", city="newark")
    assert len(records.conflict(held)) == 1  # no record has it, whatever the others
    assert len(records.nearest(held)) == 2
