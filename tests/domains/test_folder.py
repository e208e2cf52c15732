"""Domain folders: what is saved loads again, and damage is reported."""

from __future__ import annotations

import json
import shutil
import subprocess
import tempfile
from pathlib import Path

import pytest
import yaml
from hypothesis import assume, given, settings, strategies as st

from bbq_torchrl.domains import Goal, load_domain, save_data
from bbq_torchrl.domains.values import misspellings

TESTS = Path(__file__).parents[1]


@pytest.fixture
def folder(restaurant_folder, tmp_path):
    """A copy of the restaurant domain that a test may damage."""
    return shutil.copytree(restaurant_folder, tmp_path / "domain")


def edit(path, old, new):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


def test_restaurant_is_read_as_it_stands(restaurant):
    assert restaurant.name == "restaurant"
    assert (len(restaurant.records), len(restaurant.goals)) == (48, 20)
    assert restaurant.records[0] == {
        "cuisine": "italian",
        "day": "saturday",
        "hour": "7:30 pm",
        "price_range": "moderate",
        "restaurant": "Trattoria Lina",
    }
    assert restaurant.opening_slots == ()
    assert restaurant.action_names[-2:] == ("multiple_choice(cuisine)", "multiple_choice(area)")


def test_saving_what_was_loaded_changes_no_byte(restaurant, folder, tmp_path):
    columns = (folder / "knowledge_base.csv").read_text().splitlines()[0].split(",")
    save_data(tmp_path, columns, restaurant.records, restaurant.goals, restaurant.error_values)
    for name in ("knowledge_base.csv", "goals.jsonl", "values.json"):
        assert (tmp_path / name).read_bytes() == (folder / name).read_bytes()


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
@settings(max_examples=60)
def test_any_records_goals_and_values_survive_the_files(restaurant_folder, records, extra):
    goals = tuple(Goal(record, ("phone",)) for record in records)
    values = {"hour": tuple(extra)}
    assume(not misspellings(records, goals, values))
    with tempfile.TemporaryDirectory() as name:
        shutil.copy(restaurant_folder / "domain.yaml", name)
        save_data(name, SLOTS, records, goals, values)
        domain = load_domain(name)
    assert domain.records == tuple(records)
    assert domain.goals == goals
    assert domain.error_values == values


TABLE = yaml.safe_load((TESTS / "adversary" / "bad_input.yaml").read_text())
REFUSED = [
    row
    for row in TABLE
    if row["command"] == "train domain=folder domain.path=domain" and "env=" not in row["says"]
]


@pytest.mark.parametrize("row", REFUSED, ids=lambda row: row["damage"][:40])
def test_a_damaged_folder_is_refused_as_the_table_of_bad_input_says(folder, row):
    subprocess.run(["bash", "-ec", row["damage"]], cwd=folder.parent, check=True)
    with pytest.raises((ValueError, FileNotFoundError)) as caught:
        load_domain(folder)
    assert row["says"] in str(caught.value)


CSV, GOALS, VALUES, YAML = "knowledge_base.csv", "goals.jsonl", "values.json", "domain.yaml"
BOMB = ", ".join(f"&a{n + 1} [*a{n}, *a{n}]" for n in range(60))
EDITED = {
    "unknown key": ("name: restaurant", "name: restaurant\nmood: good", "line 4:.*key 'mood'"),
    "truth": ("turn_width: 24", "turn_width: true", "turn_width must be an integer"),
    "action kind": ("  inform: [", "  tell: [", "unknown keys.*tell"),
    "bomb": (
        "turn_width: 24",
        f"turn_width: [&a0 [x, x], {BOMB}]",
        "its aliases expand to more than 10000",
    ),
}
WRITTEN = {
    "line break": (CSV, 'area,day\n"no\nrth",today\n', "line 2: area must be one line"),
    "long": (GOALS, json.dumps("x" * 1_000_000), r"must have the keys .* characters \.\.\.\]"),
    "blank value": (VALUES, '{"area": [\n"north",\n" "]}', "line 3: area must be one line of"),
    "no value, of a slot that is also a value": (
        VALUES,
        '{"cuisine": ["area"],\n "area": []}\n',
        "values.json, line 2: area must list at least one value",
    ),
    "escaped value": (VALUES, '{"area": [\n "\\u2028caf\\u00e9"]}', "values.json, line 2: area"),
}


@pytest.mark.parametrize(("old", "new", "message"), EDITED.values(), ids=EDITED)
def test_a_faulty_specification_is_refused(folder, old, new, message):
    edit(folder / YAML, old, new)
    with pytest.raises(ValueError, match=message):
        load_domain(folder)


@pytest.mark.parametrize(("name", "text", "message"), WRITTEN.values(), ids=WRITTEN)
def test_damaged_data_are_refused_with_file_and_line(folder, name, text, message):
    (folder / name).write_text(text)
    with pytest.raises(ValueError, match=message):
        load_domain(folder)


def test_every_fault_of_every_file_is_named_at_once_with_its_line(folder, restaurant):
    edit(folder / YAML, "turn_width: 24", "turn_width: wide")
    edit(folder / YAML, "request(area)", "request(zip)")
    edit(folder / CSV, "saturday", " ")
    edit(folder / GOALS, '"japanese"', '"martian"')
    edit(folder / GOALS, '"french"', '"no match"')
    edit(folder / VALUES, "{", '{\n "zip": ["1"],')
    with pytest.raises(ValueError, match="has 6 faults") as caught:
        load_domain(folder)
    assert str(caught.value).splitlines() == [
        f"{folder} has 6 faults:",
        "  domain.yaml, line 19: turn_width must be an integer, got 'wide'",
        "  domain.yaml, line 22: policies.rule needs the action 'request(zip)', which is not among "
        + ", ".join(restaurant.action_names),
        "  knowledge_base.csv, line 2: day must be one line of text, not blank, got ' '",
        "  goals.jsonl, line 2: it wants cuisine = 'martian', a value that is neither in "
        "values.json nor in knowledge_base.csv",
        "  goals.jsonl, line 3: cuisine must not be the reserved value 'no match'",
        "  values.json, line 2: it names the unknown slot 'zip'; the slots are "
        + ", ".join(restaurant.slots),
    ]


def test_what_cannot_be_read_hides_no_fault_of_another_file_or_line(folder):
    (folder / CSV).write_text("")
    edit(folder / VALUES, "cuisine", "kitchen")
    edit(folder / GOALS, '"japanese"', '"no match"')
    with (folder / GOALS).open("a") as file:
        file.write("{\n")
    with pytest.raises(ValueError, match="has 4 faults") as caught:
        load_domain(folder)
    for fault in (
        "knowledge_base.csv: the header, a line of slot names, is missing",
        "unknown slot 'kitchen'",
        "goals.jsonl, line 2: cuisine must not be the reserved value",
        "goals.jsonl, line 21: it is not valid JSON",
    ):
        assert fault in str(caught.value)


def test_a_byte_order_mark_is_no_part_of_the_header(folder, restaurant):
    (folder / CSV).write_text((folder / CSV).read_text(), encoding="utf-8-sig")
    assert load_domain(folder) == restaurant


def test_a_goal_may_spell_a_value_in_another_case(folder):
    goal = {"constraints": {"area": "OLD town"}, "requests": []}
    (folder / GOALS).write_text(json.dumps(goal) + "\n")
    assert load_domain(folder).goals == (Goal({"area": "OLD town"}),)


@pytest.mark.parametrize(
    ("written", "slots"), [("[area, cuisine]", ("area", "cuisine")), ("area", ("area",))]
)
def test_one_slot_or_several_can_open_a_dialogue(folder, written, slots):
    edit(folder / YAML, "opening_slot: null", f"opening_slot: {written}")
    assert load_domain(folder).opening_slots == slots
