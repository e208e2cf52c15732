"""The reader of the public corpus, on a corpus of two records: its format, and refusals."""

from __future__ import annotations

import collections
import datetime
import pickle
import re
from pathlib import Path

import pytest

from bbq_torchrl.domains import Goal, load_miulab
from bbq_torchrl.domains.miulab import read_plain_pickle

FILES = {"goals": "goals.p", "kb": "kb.p", "values": "values.p"}
GOAL = {
    "diaact": "request",
    "inform_slots": {"city": "seattle", "numberofpeople": "2"},
    "request_slots": {"theater": "UNK", "ticket": "UNK"},
}
CORPUS = {
    "goals": [GOAL],
    "kb": {1: {"city": "portland"}, 0: {"city": "Seattle", "theater": "", "date": "today"}},
    "values": {"city": ["seattle", "", "seattle", "boston"]},
}


@pytest.fixture
def load(tmp_path):
    """Loads the small corpus, with other contents of some files."""

    def load(contents=(), **options):
        for name, content in (CORPUS | dict(contents)).items():
            is_raw = isinstance(content, bytes)
            raw = content if is_raw else pickle.dumps(content, protocol=0)
            (tmp_path / FILES[name]).write_bytes(raw)
        return load_miulab(tmp_path, **FILES, **options)

    return load


def test_a_corpus_is_read_in_order_without_blanks(load):
    domain = load()
    assert domain.records == ({"city": "Seattle", "date": "today"}, {"city": "portland"})
    assert domain.goals == (Goal({"city": "seattle", "numberofpeople": "2"}, ("theater",)),)
    assert domain.error_values == {"city": ("seattle", "seattle", "boston")}


@pytest.mark.parametrize("name", FILES)
def test_a_missing_file_is_named(load, tmp_path, name):
    load()
    (tmp_path / FILES[name]).unlink()
    with pytest.raises(FileNotFoundError, match=FILES[name]):
        load_miulab(tmp_path, **FILES)


class Trap:
    """Runs code when an ordinary unpickler loads it."""

    def __init__(self, victim: Path) -> None:
        self.victim = victim

    def __reduce__(self):
        return (Path.write_text, (self.victim, "gotcha"))


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("protocol", range(6))
def test_a_pickle_that_calls_something_is_refused_and_calls_nothing(load, tmp_path, name, protocol):
    trap = pickle.dumps([Trap(tmp_path / "victim")], protocol)
    with pytest.raises(ValueError, match=rf"{FILES[name]} is not a pickle of plain data.*refers"):
        load({name: trap})
    assert not (tmp_path / "victim").exists()


WINDOWS = {
    "unicode": pickle.dumps(CORPUS["goals"], 0),
    "bytes of Python 2": b"(lp1\n(dp2\nS'city'\np3\nS'o\\'fallon\\r\\n'\np4\nsI7\nL8L\nsa.",
    "a line end at the end": b"(dp0\nS'city'\nS'reno'\ns.\n",
}


@pytest.mark.parametrize("content", WINDOWS.values(), ids=WINDOWS)
def test_a_text_pickle_with_the_line_ends_of_windows_holds_what_it_held(tmp_path, content):
    unix, windows = tmp_path / "unix.p", tmp_path / "windows.p"
    unix.write_bytes(content.rstrip(b"\n"))
    windows.write_bytes(content.replace(b"\n", b"\r\n"))
    assert read_plain_pickle(windows) == read_plain_pickle(unix)


@pytest.mark.parametrize("protocol", range(1, 6))
def test_the_bytes_of_a_binary_pickle_are_left_alone(tmp_path, protocol):
    content = {"a\r\nb": 13 + 256 * 10, "x" * 13: ["y" * 10, "\r\n"]}
    (tmp_path / "x.p").write_bytes(pickle.dumps(content, protocol))
    assert read_plain_pickle(tmp_path / "x.p") == content


@pytest.mark.parametrize("name", FILES)
def test_a_trap_with_the_line_ends_of_windows_calls_nothing(load, tmp_path, name):
    trap = pickle.dumps([Trap(tmp_path / "victim")], 0).replace(b"\n", b"\r\n")
    with pytest.raises(ValueError, match=rf"{FILES[name]} is not a pickle of plain data.*refers"):
        load({name: trap})
    assert not (tmp_path / "victim").exists()


def test_the_public_corpus_with_the_line_ends_of_windows_is_the_same(miulab, tcbot, tmp_path):
    """DDQ and D3Q publish it like this."""
    for file in tcbot.glob("*.p"):
        (tmp_path / file.name).write_bytes(file.read_bytes().replace(b"\n", b"\r\n"))
    assert load_miulab(tmp_path) == miulab


def pickled(content):
    return pickle.dumps({"a": content}, 0)


DAMAGED = {
    "a date": (pickled(datetime.date(2018, 2, 2)), "refers to .*only plain data is allowed"),
    "a class of dicts": (pickled(collections.OrderedDict()), "refers to .*only plain data"),
    "a set": (pickled({1, 2}), "refers to .*only plain data"),
    "a function": (pickled(len), "refers to .*only plain data"),
    "a class of ours": (pickled(Goal), "refers to .*only plain data"),
    "an outside object": (b"Psecret\n.", "refers to the outside object 'secret'"),
    "nothing": (b"", ""),
    "a text": (b"moviename,city\n", ""),
    "a part": (pickle.dumps([GOAL], 0)[:-9], ""),
    "something after it": (pickle.dumps([GOAL], 0) + b"x", "1 bytes follow its end"),
    "an empty stack": (b".", ""),
    "no UTF-8": (b"S'\\xff'\n.", ""),
    "a huge text": (
        b"\x80\x04\x8e" + b"\xff" * 7 + b"\x0f",
        "it asks for more memory than the machine has",
    ),
    "a huge frame": (b"\x80\x04\x95\xff\xff\xff\xff\xff\xff\xff\x7f.", ""),
}


@pytest.mark.parametrize(("content", "why"), DAMAGED.values(), ids=DAMAGED)
def test_a_pickle_that_is_damaged_or_holds_more_than_plain_data_is_refused(tmp_path, content, why):
    (tmp_path / "x.p").write_bytes(content)
    with pytest.raises(ValueError, match=rf"x\.p is not a pickle of plain data: .*{why}"):
        read_plain_pickle(tmp_path / "x.p")


WRONG = {
    "goals a dict": ("goals", {}, "must hold a list, got dict"),
    "goal a list": ("goals", [[]], "goal 0 must hold a dict"),
    "goal key more": ("goals", [GOAL | {"mood": "good"}], "goal 0 must have the keys.*mood"),
    "unknown act": ("goals", [GOAL | {"diaact": "shrug"}], "unknown act 'shrug'.*confirm_question"),
    "other act": ("goals", [GOAL | {"diaact": "inform"}], "must open with the act request"),
    "request answered": ("goals", [GOAL | {"request_slots": {"city": "x"}}], "'UNK', got.*city"),
    "value a number": ("goals", [GOAL | {"inform_slots": {"city": 3}}], "must be text, got 3"),
    "slot a number": ("goals", [GOAL | {"inform_slots": {3: "x"}}], "must have str keys, got 3"),
    "kb a list": ("kb", [{}], r"kb\.p must hold a dict, got list"),
    "kb by name": ("kb", {"0": {}}, "must have int keys, got '0'"),
    "kb by truth": ("kb", {True: {}}, "must have int keys, got True"),
    "row value": ("kb", {0: {"city": ["x"]}}, "row 0, city must be text"),
    "values a list": ("values", [], r"values\.p must hold a dict, got list"),
    "values a text": ("values", {"city": "x"}, "city must hold a list, got str"),
    "no values": ("values", {}, r"values\.p must list the values of at least one slot"),
}


@pytest.mark.parametrize(("name", "content", "message"), WRONG.values(), ids=WRONG)
def test_a_file_of_another_form_is_refused(load, tmp_path, name, content, message):
    with pytest.raises(ValueError, match=message) as caught:
        load({name: content})
    assert str(tmp_path) in str(caught.value)


UNUSABLE = {
    "a goal": (
        {"goals": [GOAL, GOAL | {"request_slots": {"city": "UNK"}}]},
        "goals.p, goal 1: it must not constrain and request the same slots ['city']",
        "goals.p: 1 of 2 goals are left out",
    ),
    "a list of an unknown slot": (
        {"values": {"area": ["x"], "city": ["seattle"]}},
        "values.p: it names the unknown slot 'area'",
        "values.p: 1 of 2 slots",
    ),
    "a value": (
        {"values": {"city": ["seattle", "no match"]}},
        "values.p: city must not be the reserved value 'no match'",
        "values.p: 1 of 1 slots",
    ),
    "a list of blanks": (
        {"values": {"date": [""], "city": ["seattle"]}},
        "values.p: date must list at least one value",
        "values.p: 1 of 2 slots",
    ),
}


@pytest.mark.parametrize(("contents", "fault", "count"), UNUSABLE.values(), ids=UNUSABLE)
def test_what_cannot_be_used_is_left_out_and_named_or_refused(load, contents, fault, count):
    with pytest.raises(ValueError, match=re.escape(fault)):
        load(contents, skip_unusable=False)
    domain = load(contents)
    assert (len(domain.goals), len(domain.records), len(domain.error_values)) == (1, 2, 1)
    assert any(fault in text for text in domain.skipped)
    assert any(count in text for text in domain.skipped)


def test_a_record_is_left_without_its_unknown_slots(load):
    assert load({"kb": {0: {"city": "seattle", "area": "x"}}}).records == ({"city": "seattle"},)


def test_values_that_never_match_their_like_stay_and_are_told_by_file(load):
    kb = {
        4: {"date": "today"},
        7: {"city": "seattle\u00a0", "date": "today "},
        9: {"date": "today"},
    }
    values = {"city": ["seattle", " seattle"], "date": ["to\u200bday"]}
    domain = load({"kb": kb, "values": values})
    assert domain.records[1] == kb[7]
    assert domain.error_values == {slot: tuple(texts) for slot, texts in values.items()}
    some = "some values differ from others of their slot only in blanks, quotes, dashes or how"
    assert domain.doubts == (
        f"kb.p, row 7: {some} letters are encoded, such as date = 'today ', which never matches "
        "'today'",
        rf"values.p, slots date, city: {some} letters are encoded, such as date = 'to\u200bday', "
        "which never matches 'today'",
    )
    assert load().doubts == ()


def test_the_public_corpus_has_such_values_in_each_of_its_files(miulab):
    assert [text.partition(",")[0] for text in miulab.doubts] == [
        "movie_kb.1k.p",
        "dicts.v3.p",
        "user_goals_first_turn_template.v2.p",
    ]
