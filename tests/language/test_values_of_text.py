from __future__ import annotations

import forked
import pytest

from bbq_torchrl.extras import needed
from bbq_torchrl.language.quantities import READERS
from bbq_torchrl.language.words import tokenize

KEYS = {
    "time": {
        "7:30pm": "at 19:30",
        "19.30": "at 19:30",
        "half past seven": "at 19:30?",
        "quarter to 9": "at 20:45?",
        "noon": "at 12:00",
        "12:15 am": "at 00:15",
        "six o'clock": "at 18:00?",
        "before 9": "before 21:00?",
        "not before the 21:00": "after 21:00",
        "quarter to one": "at 12:45?",
        "7:30ish": "around 19:30?",
        "b4 7": "before 19:00?",
        "the 7 and half": "at 19:30?",
        "seven thirty five": "at 19:35?",
        "nine oh five pm": "at 21:05",
        "from about 6pm": "after 18:00",
        "25:99": None,
        "20 to 45": None,
        "barbie": None,
        "13 am": None,
        "": None,
        "7" * 400: None,
    },
    "date": {
        "this Friday night": "friday night",
        "fri": "friday",
        "next sat": "next saturday",
        "fridays": "friday",
        "tues": "tuesday",
        "later today": "later today",
        "this wknd": "weekend",
        "the 9th": "day 9",
        "the ninth": "day 9",
        "twenty-first": "day 21",
        "15 of march": "3/15",
        "3/15": "3/15",
        "march the fifteenth": "3/15",
        "tonight": "today night",
        "today in the night": "today night",
        "day after tomorrow": "after tomorrow",
        "february 30": None,
        "2/30": None,
        "13/13": None,
        "the 32nd": None,
        "wonka": None,
    },
    "count": {
        "two": "2",
        "2 adults": "2",
        "just me": "1",
        "a couple": "2",
        "me and my wife": "2",
        "three of my buddies and me": "4",
        "a dozen": "12",
        "half a dozen": "6",
        "two dozen of us": "24",
        "40 dozen": None,
        "me n my bf": "2",
        "me and my parents": "3",
        "my wife and me and two kids": "4",
        "3 + me": "4",
        "x2": "2",
        "-3 people": None,
        "0": None,
        "9" * 400: None,
        "two or three": None,
        "wonka": None,
    },
    "price": {
        "20 dollars": "$20",
        "not more than $20": "under $20",
        "20": None,
    },
}


@pytest.mark.parametrize(
    ("kind", "text", "key"),
    [(kind, text, key) for kind, keys in KEYS.items() for text, key in keys.items()],
)
def test_a_quantity_has_one_key(kind, text, key):
    assert READERS[kind](text) == key


@pytest.mark.parametrize(
    ("slot", "text", "values"),
    [
        ("moviename", "top gun", ("top gun: maverick",)),
        ("moviename", "openheimer", ("oppenheimer",)),
        ("moviename", "creed 3", ("creed iii",)),
        ("moviename", "casablanca", ()),
        ("city", "springfield", ()),
        ("state", "tx", ("tx",)),
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


def test_every_value_means_itself(lexicon):
    for slot in lexicon.slots:
        for value in lexicon.values(slot)[::7]:
            assert lexicon.link(slot, value).values == (value,)


def test_a_missing_library_names_the_command():
    with pytest.raises(ModuleNotFoundError, match=r"pip install .*\[language\]'"):
        needed("no-such", "no_such_library_at_all")


def test_the_package_and_its_language_import_without_the_extra(tmp_path):
    code = (
        "import sys; sys.modules.update(dict.fromkeys(('pycrfsuite', 'rapidfuzz', 'httpx')))\n"
        "import bbq_torchrl, bbq_torchrl.language"
    )
    forked.python("-c", code, cwd=tmp_path)


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
