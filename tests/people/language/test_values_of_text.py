from pathlib import Path

import pytest

from bbq_torchrl.people.language.quantities import READERS
from bbq_torchrl.people.language.words import tokenize

TABLE = Path(__file__).with_name("quantities.txt").read_text()
ROWS = [line for line in TABLE.splitlines() if line and line[0] != "#"]


@pytest.mark.parametrize("row", ROWS)
def test_a_quantity_has_one_key(row):
    kind, text, key = (part.strip() for part in row.split("|"))
    assert READERS[kind](text) == (key or None)


@pytest.mark.parametrize("text", ["", "7" * 400], ids=["empty", "long"])
def test_nothing_and_a_number_without_end_are_no_quantity(text):
    assert {read(text) for read in READERS.values()} == {None}


@pytest.mark.parametrize(
    ("slot", "text", "values"),
    [
        ("moviename", "top gun", ("top gun: maverick",)),
        ("moviename", "openheimer", ("oppenheimer",)),
        ("moviename", "creed 3", ("creed iii",)),
        ("moviename", "casablanca", ()),
        ("city", "springfield", ()),
        ("state", "tx", ("tx",)),
        ("theater_chain", "regals", ("regal",)),
        ("genre", "thrillers", ("thriller",)),
        ("starttime", "1930", ("7:30 pm",)),
        ("starttime", "10:30", ("10:30am",)),
        ("starttime", "the matinee", ("matinee",)),
        ("starttime", "25:99", ()),
        ("date", "february 30", ()),
        ("numberofpeople", "-3", ()),
    ],
)
def test_a_name_is_linked_to_the_value_it_means(lexicon, slot, text, values):
    assert lexicon.link(slot, text).values == values


def test_every_value_means_itself_in_the_most_frequent_spelling(lexicon):
    for slot in lexicon.slots:
        for value in lexicon.values(slot)[::7]:
            assert lexicon.link(slot, value).values == (lexicon.respell(slot, value),)
    assert lexicon.link("numberofpeople", "two").values == ("2",)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("elvis x9?", ["elvis", "x", "9", "?"]),
        ("X-Men x12", ["x", "-", "men", "x", "12"]),
        ("x2y max 2x", ["x2y", "max", "2x"]),
    ],
)
def test_a_count_after_x_is_a_word_of_its_own(text, words):
    assert tokenize(text) == words
