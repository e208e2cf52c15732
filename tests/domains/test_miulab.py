"""The importer of the public corpus: it reads the real files, and refuses all else."""

from __future__ import annotations

import collections
import datetime
import pickle
import re
from pathlib import Path

import pytest
from corpus_statistics import goals_answerable, goals_met

from bbq_torchrl.domains import Domain, Goal, load_miulab
from bbq_torchrl.domains.miulab import read_plain_pickle

V1 = "user_goals_first_turn_template.part.movie.v1.p"
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
def folder(tmp_path: Path) -> Path:
    """A small corpus in the public one's format that a test may damage."""
    for name, content in CORPUS.items():
        write(tmp_path, name, content)
    return tmp_path


def write(folder: Path, name: str, content: object) -> None:
    (folder / FILES[name]).write_bytes(pickle.dumps(content, protocol=0))


# The public corpus, against the numbers that its description states.


def test_public_error_lists_keep_their_length(miulab: Domain):
    # As above: 118 movies and 244 theaters with the blank text.
    lengths = {slot: len(values) for slot, values in miulab.error_values.items()}
    assert (lengths["moviename"], lengths["starttime"], lengths["theater"]) == (117, 343, 243)


def test_public_goals_v1_are_as_described(tcbot: Path):
    goals = load_miulab(tcbot, goals=V1).goals
    assert len(goals) == 128
    assert sum(len(goal.constraints) for goal in goals) / 128 == pytest.approx(4.8, abs=0.05)
    assert sum(len(goal.requests) for goal in goals) / 128 == pytest.approx(1.2, abs=0.05)


@pytest.mark.parametrize(("goals", "met", "answerable"), [(V1, 125, 118), (None, 183, 163)])
def test_public_records_meet_as_many_goals_as_described(tcbot: Path, goals, met, answerable):
    domain = load_miulab(tcbot, goals=goals) if goals else load_miulab(tcbot)
    assert (goals_met(domain), goals_answerable(domain)) == (met, answerable)


def test_public_corpus_is_played_with_our_acts_slots_and_actions(miulab: Domain, movie: Domain):
    assert miulab.name == "miulab"
    assert (miulab.acts, miulab.slots, miulab.actions) == (movie.acts, movie.slots, movie.actions)
    assert miulab.policies == movie.policies


def test_public_corpus_lists_the_acts_and_slots_that_we_have(tcbot: Path, movie: Domain):
    assert tuple((tcbot / "dia_acts.txt").read_text().split()) == movie.acts
    assert tuple((tcbot / "slot_set.txt").read_text().split()) == movie.slots


# The format, on a corpus of two records.


def test_a_corpus_is_read_in_order_without_blanks(folder: Path):
    domain = load_miulab(folder, **FILES)
    assert domain.records == ({"city": "Seattle", "date": "today"}, {"city": "portland"})
    assert domain.goals == (Goal({"city": "seattle", "numberofpeople": "2"}, ("theater",)),)
    assert domain.error_values == {"city": ("seattle", "seattle", "boston")}


@pytest.mark.parametrize("name", FILES)
def test_a_missing_file_is_named(folder: Path, name: str):
    (folder / FILES[name]).unlink()
    with pytest.raises(FileNotFoundError, match=FILES[name]):
        load_miulab(folder, **FILES)


class Trap:
    """Runs code where it is unpickled plainly."""

    def __init__(self, victim: Path) -> None:
        self.victim = victim

    def __reduce__(self):
        return (Path.write_text, (self.victim, "gotcha"))


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("protocol", range(6))
def test_a_pickle_that_calls_something_is_refused_and_calls_nothing(folder, name, protocol):
    victim = folder / "victim"
    (folder / FILES[name]).write_bytes(pickle.dumps([Trap(victim)], protocol))
    with pytest.raises(ValueError, match=rf"{FILES[name]} is not a pickle of plain data.*refers"):
        load_miulab(folder, **FILES)
    assert not victim.exists()


@pytest.mark.parametrize(
    "content", [datetime.date(2018, 2, 2), collections.OrderedDict(), {1, 2}, len, Goal]
)
@pytest.mark.parametrize("protocol", [0, 2])
def test_a_pickle_with_a_class_in_it_is_refused(tmp_path: Path, content, protocol):
    path = tmp_path / "x.p"
    path.write_bytes(pickle.dumps({"a": content}, protocol))
    with pytest.raises(ValueError, match=r"refers to .*only plain data is allowed"):
        read_plain_pickle(path)


DAMAGED = {
    "empty": b"",
    "text": b"moviename,city\n",
    "cut off": pickle.dumps([GOAL], 0)[:-9],
    "followed": pickle.dumps([GOAL], 0) + b"x",
    "outside object": b"Psecret\n.",
    "empty stack": b".",
    "not UTF-8": b"S'\\xff'\n.",
    "huge": b"\x80\x04\x95\xff\xff\xff\xff\xff\xff\xff\x7f.",
}


@pytest.mark.parametrize("content", DAMAGED.values(), ids=DAMAGED)
def test_a_damaged_pickle_is_refused(tmp_path: Path, content: bytes):
    (tmp_path / "x.p").write_bytes(content)
    with pytest.raises(ValueError, match=r"x\.p is not a pickle of plain data"):
        read_plain_pickle(tmp_path / "x.p")


def changed(**changes: object) -> list[dict]:
    return [{**GOAL, **changes}]


WRONG = {
    "goals a dict": ("goals", {}, "must hold a list, got dict"),
    "goal a list": ("goals", [[]], "goal 0 must hold a dict"),
    "goal key more": ("goals", changed(mood="good"), "goal 0 must have the keys.*mood"),
    "unknown act": ("goals", changed(diaact="shrug"), "unknown act 'shrug'.*confirm_question"),
    "other act": ("goals", changed(diaact="inform"), "must open with the act request"),
    "request answered": ("goals", changed(request_slots={"city": "x"}), "value 'UNK', got.*city"),
    "value a number": ("goals", changed(inform_slots={"city": 3}), "city must be a text, got 3"),
    "slot a number": ("goals", changed(inform_slots={3: "x"}), "must have str keys, got 3"),
    "kb a list": ("kb", [{}], r"kb\.p must hold a dict, got list"),
    "kb by name": ("kb", {"0": {}}, "must have int keys, got '0'"),
    "kb by truth": ("kb", {True: {}}, "must have int keys, got True"),
    "row value": ("kb", {0: {"city": ["x"]}}, "row 0, city must be a text"),
    "values a list": ("values", [], r"values\.p must hold a dict, got list"),
    "values a text": ("values", {"city": "x"}, "city must hold a list, got str"),
    "no values": ("values", {}, r"values\.p must list the values of at least one slot"),
}


UNUSABLE = {
    "goal 1 both": (
        "goals",
        [GOAL, changed(request_slots={"city": "UNK"})[0]],
        r"goals\.p, goal 1: it must not constrain and request the same slots \['city'\]",
        r"goals\.p: 1 of 2 goals are left out",
    ),
    "values slot": (
        "values",
        {"area": ["x"], "city": ["seattle"]},
        r"values\.p: it names the unknown slot 'area'",
        r"values\.p: 1 of 2 slots",
    ),
    "a value": (
        "values",
        {"city": ["seattle", "no match"]},
        r"values\.p: city must not have the reserved value 'no match'",
        r"values\.p: 1 of 1 slots",
    ),
    "blank values": (
        "values",
        {"date": [""], "city": ["seattle"]},
        r"values\.p: date must list at least one value",
        r"values\.p: 1 of 2 slots",
    ),
}


@pytest.mark.parametrize(("name", "content", "fault", "count"), UNUSABLE.values(), ids=UNUSABLE)
def test_what_cannot_be_used_is_left_out_and_named_or_refused(folder, name, content, fault, count):
    write(folder, name, content)
    with pytest.raises(ValueError, match=fault):
        load_miulab(folder, **FILES, skip_unusable=False)
    domain = load_miulab(folder, **FILES)
    assert (len(domain.goals), len(domain.records), len(domain.error_values)) == (1, 2, 1)
    assert any(re.search(fault, text) for text in domain.skipped)
    assert any(re.search(count, text) for text in domain.skipped)


def test_a_record_is_left_without_its_unknown_slots(folder: Path):
    write(folder, "kb", {0: {"city": "seattle", "area": "x"}})
    assert load_miulab(folder, **FILES).records == ({"city": "seattle"},)


def test_nothing_is_left_out_of_the_default_files(miulab: Domain, tcbot: Path):
    assert miulab.skipped == ()
    assert load_miulab(tcbot, skip_unusable=False) == miulab


@pytest.mark.parametrize(("name", "content", "message"), WRONG.values(), ids=WRONG)
def test_a_file_of_another_form_is_refused(folder: Path, name, content, message):
    write(folder, name, content)
    with pytest.raises(ValueError, match=message) as caught:
        load_miulab(folder, **FILES)
    assert str(folder) in str(caught.value)
