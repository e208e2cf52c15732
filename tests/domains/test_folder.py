"""Domain folders: what is saved loads again, and damage is reported by file, line and value."""

import json
import shutil
import tempfile
from dataclasses import replace

import pytest
from hypothesis import assume, given, strategies as st

from bbq_torchrl.domains import Goal, load_domain
from bbq_torchrl.domains.folder import save_data
from bbq_torchrl.domains.values import misspellings, plain
from bbq_torchrl.people.language.phrases import load_phrases
from bbq_torchrl.people.language.training_lines import lines_of
from bbq_torchrl.simulator.measured_errors import load_errors

CSV, GOALS, VALUES, YAML = "knowledge_base.csv", "goals.jsonl", "values.json", "domain.yaml"


@pytest.fixture
def folder(restaurant_folder, tmp_path):
    """A copy of the restaurant domain that a test may damage."""
    return shutil.copytree(restaurant_folder, tmp_path / "domain")


def edit(path, old, new, count=1):
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new, count), encoding="utf-8")


def refusal(folder):
    with pytest.raises(ValueError, match="domain") as caught:
        load_domain(folder)
    return str(caught.value)


# Any one-line text: commas, quotes, spaces at the ends, other scripts.
RESERVED = {"i do not care", "no match", "ticket available"}
TEXT = st.text(
    st.characters(exclude_categories=["Cs", "Cc", "Zl", "Zp"]) | st.sampled_from(",\"'\t")
)
VALUE = TEXT.filter(lambda text: text.strip() and text.casefold() not in RESERVED)
SLOTS = ["cuisine", "area", "day"]
RECORD = st.dictionaries(st.sampled_from(SLOTS), VALUE, min_size=1)


@given(
    records=st.lists(RECORD, min_size=1, max_size=5), extra=st.lists(VALUE, min_size=1, max_size=3)
)
def test_any_records_goals_and_values_survive_the_files(restaurant_folder, records, extra):
    goals = tuple(Goal(record, ("phone",)) for record in records)
    values = {"hour": tuple(extra)}
    assume(not misspellings(records, goals, values))
    with tempfile.TemporaryDirectory() as name:
        shutil.copy(restaurant_folder / YAML, name)
        save_data(name, SLOTS, records, goals, values)
        domain = load_domain(name)
    assert domain.records == tuple(records)
    assert domain.goals == goals
    assert domain.error_values == values


@pytest.mark.parametrize("name", [YAML, CSV, GOALS, VALUES])
def test_a_file_that_is_no_text_is_refused(folder, name):
    (folder / name).write_bytes(b"\xff\xfe")
    assert name in refusal(folder)


def test_contradictions_between_files_are_named_at_once_with_their_lines(folder, restaurant):
    edit(folder / YAML, "turn_width: 24", "turn_width: wide")
    edit(folder / YAML, "request(area)", "request(zip)")
    edit(folder / CSV, "terrace", "balcony")
    edit(folder / GOALS, '"japanese"', '"martian"')
    edit(folder / GOALS, '"french"', '"no match"')
    told = refusal(folder).splitlines()
    places = [line.strip().partition(": ")[0] for line in told[1:]]
    with_balcony = f"{CSV}, lines 7, 11, 13 and 5 more"
    assert places == [YAML, YAML, with_balcony, f"{GOALS}, line 2", f"{GOALS}, line 3"]


def test_the_damage_of_every_file_is_named_at_once(folder):
    (folder / CSV).write_text("")
    edit(folder / YAML, "name: restaurant", "name: 3")
    edit(folder / GOALS, '{"constraints"', "{", 2)
    (folder / VALUES).write_text("{")
    places = [line.strip().partition(": ")[0] for line in refusal(folder).splitlines()[1:]]
    assert places == [YAML, CSV, f"{GOALS}, line 1", f"{GOALS}, line 2", VALUES]


def test_a_goal_may_spell_a_value_in_another_case(folder):
    goal = {"constraints": {"area": "OLD town"}, "requests": []}
    (folder / GOALS).write_text(json.dumps(goal) + "\n")
    assert load_domain(folder).goals == (Goal({"area": "OLD town"}),)


def test_several_slots_can_open_a_dialogue(folder):
    edit(folder / YAML, "opening_slot: null", "opening_slot: [area, cuisine]")
    assert load_domain(folder).opening_slots == ("area", "cuisine")


ALIKE = {
    "a blank at the end": ("reno", "reno "),
    "a no-break space": ("las vegas", "las\u00a0vegas"),
    "two blanks": ("las vegas", "las  vegas"),
    "an apostrophe": ("freddy's", "Freddy\u2019s"),
    "quotes": ('the "best"', "the \u201cbest\u201d"),
    "a dash": ("sci-fi", "sci\u2011fi"),
    "an accent beside its letter": ("caf\u00e9", "cafe\u0301"),
    "a ligature": ("fish", "\ufb01sh"),
    "a space without width": ("reno", "re\u200bno"),
    "a byte-order mark": ("reno", "\ufeffreno"),
}


@pytest.mark.parametrize(("one", "other"), ALIKE.values(), ids=ALIKE)
def test_texts_that_people_read_as_one_are_alike(one, other):
    assert plain(one) == plain(other) == plain(plain(other))


@pytest.mark.parametrize(
    ("one", "other"),
    [("7pm", "7 pm"), ("cafe", "caf\u00e9"), ("o'fallon", "ofallon"), ("sci-fi", "scifi")],
)
def test_texts_of_other_letters_are_not_alike(one, other):
    assert plain(one) != plain(other)


@pytest.mark.parametrize(
    ("name", "old", "new", "told"),
    [
        (CSV, "7:30 pm", "7:30\u00a0pm", r"line 2: it has hour = '7:30\xa0pm'"),
        (CSV, "7:30 pm", "no\u00a0match", r"hour = 'no\xa0match', which never matches 'no match'"),
        (VALUES, '"7:30 pm"', '"7:30 pm "', "hour = '7:30 pm ', which never matches '7:30 pm'"),
        (GOALS, '"7:30 pm"', '"7:30  pm"', "line 2: it has hour = '7:30  pm'"),
    ],
)
def test_a_value_that_never_matches_its_like_is_refused(folder, name, old, new, told):
    edit(folder / name, old, new)
    assert told in refusal(folder)


def test_the_spelling_that_most_places_have_is_the_one_to_write(folder):
    edit(folder / CSV, "italian", "italian ", (folder / CSV).read_text().count("italian"))
    assert "'italian', which never matches 'italian '" in refusal(folder)


def test_a_byte_order_mark_is_no_part_of_a_file_of_a_domain(movie, tmp_path):
    folder = shutil.copytree(movie.folder, tmp_path / "domain")
    for name in (YAML, CSV, GOALS, VALUES, "errors.json", "language.yaml", "learned.txt"):
        text = (folder / name).read_text(encoding="utf-8")
        (folder / name).write_text(text, encoding="utf-8-sig")
    domain = load_domain(folder)
    assert replace(domain, folder=movie.folder) == movie
    assert load_phrases(domain) == load_phrases(movie)
    assert lines_of(domain, "learned.txt") == lines_of(movie, "learned.txt")
    load_errors(domain)
