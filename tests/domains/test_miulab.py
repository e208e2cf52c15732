"""The reader of the public corpus, on a corpus of two records: its format, and refusals."""

import datetime
import pickle
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


class Trap:
    """Runs code when an ordinary unpickler loads it."""

    def __init__(self, victim):
        self.victim = victim

    def __reduce__(self):
        return (Path.write_text, (self.victim, "gotcha"))


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("protocol", range(6))
@pytest.mark.parametrize("line_end", [b"\n", b"\r\n"])
def test_a_pickle_that_calls_something_calls_nothing(load, tmp_path, name, protocol, line_end):
    trap = pickle.dumps([Trap(tmp_path / "victim")], protocol)
    trap = trap if protocol else trap.replace(b"\n", line_end)
    with pytest.raises(ValueError, match=rf"{FILES[name]}.*(Path|getattr)"):
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


def pickled(content):
    return pickle.dumps({"a": content}, 0)


DAMAGED = {
    "a date": (pickled(datetime.date(2018, 2, 2)), "datetime"),
    "a function": (pickled(len), "len"),
    "an outside object": (b"Psecret\n.", "secret"),
    "a part": (pickle.dumps([GOAL], 0)[:-9], ""),
    "something after it": (pickle.dumps([GOAL], 0) + b"x", "1 bytes"),
    "a huge text": (b"\x80\x04\x8e" + b"\xff" * 7 + b"\x0f", "MemoryError"),
    "a huge frame": (b"\x80\x04\x95\xff\xff\xff\xff\xff\xff\xff\x7f.", ""),
}


@pytest.mark.parametrize(("content", "why"), DAMAGED.values(), ids=DAMAGED)
def test_a_pickle_that_is_damaged_or_holds_more_than_plain_data_is_refused(tmp_path, content, why):
    (tmp_path / "x.p").write_bytes(content)
    with pytest.raises(ValueError, match=rf"x\.p.*{why}"):
        read_plain_pickle(tmp_path / "x.p")


WRONG = {
    "goals a dict": ("goals", {}, ["{}"]),
    "goal key more": ("goals", [GOAL | {"mood": "good"}], ["goal 0", "mood"]),
    "unknown act": ("goals", [GOAL | {"diaact": "shrug"}], ["goal 0", "diaact", "'shrug'"]),
    "request answered": (
        "goals",
        [GOAL | {"request_slots": {"city": "x"}}],
        ["goal 0", "request_slots", "city", "'UNK'", "'x'"],
    ),
    "kb by truth": ("kb", {True: {}}, ["True"]),
    "row value": ("kb", {0: {"city": ["x"]}}, ["row 0", "city"]),
    "values a text": ("values", {"city": "x"}, ["city", "'x'"]),
    "value no text": ("values", {"city": ["seattle", 3]}, ["city", "3"]),
}


@pytest.mark.parametrize(("name", "content", "named"), WRONG.values(), ids=WRONG)
def test_a_file_of_another_form_is_refused(load, tmp_path, name, content, named):
    with pytest.raises(ValueError, match=str(tmp_path)) as caught:
        load({name: content})
    assert all(text in str(caught.value) for text in named)


UNUSABLE = {
    "a record": (
        {"kb": {1: {"city": "x"}, 4: {"ticket": "x"}, 7: {"city": "y", "zip": "no match"}}},
        ["kb.p, row 4: ", "'ticket'"],
    ),
    "a list of an unknown slot": (
        {"values": {"area": ["x"], "city": ["seattle"]}},
        ["values.p: ", "'area'"],
    ),
    "a value": ({"values": {"city": ["seattle", "no match"]}}, ["values.p: city ", "'no match'"]),
    "a list of blanks": (
        {"values": {"date": [""], "city": ["seattle"]}},
        ["values.p: date must list at least one value"],
    ),
}


@pytest.mark.parametrize(("contents", "named"), UNUSABLE.values(), ids=UNUSABLE)
def test_what_cannot_be_used_is_left_out_and_named_or_refused(load, contents, named):
    with pytest.raises(ValueError, match="|".join(FILES.values())) as caught:
        load(contents, skip_unusable=False)
    assert all(text in str(caught.value) for text in named)
    domain = load(contents)
    sizes = len(domain.goals), len(domain.records), len(domain.error_values)
    assert sizes == (1, 1 if "kb" in contents else 2, 1)
    assert any(all(text in told for text in named) for told in domain.skipped)


def test_a_corpus_without_usable_goals_is_refused_and_says_why(load):
    with pytest.raises(ValueError, match=r"goals\.p, goal 0: .*'area'.*(?s:.*)goals") as caught:
        load({"goals": [GOAL | {"request_slots": {"area": "UNK"}}]})
    assert len(caught.value.faults) == 2


def test_values_that_never_match_their_like_stay(load):
    kb = {4: {"date": "today"}, 7: {"city": "seattle\u00a0", "date": "today "}}
    values = {"city": ["seattle", " seattle"], "date": ["to\u200bday"]}
    domain = load({"kb": kb, "values": values})
    assert domain.records[1] == kb[7]
    assert domain.error_values == {slot: tuple(texts) for slot, texts in values.items()}
