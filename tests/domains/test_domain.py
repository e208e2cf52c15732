"""Domains: consistent data is accepted, inconsistencies are refused; and their tensors."""

import pickle
import re
from dataclasses import replace

import pytest

from bbq_torchrl.domains import Action, Goal, ScriptedPolicySpec, fold, tensorize
from bbq_torchrl.domains.domain import DomainError
from bbq_torchrl.domains.values import DONT_CARE, FIRST_VALUE, RESERVED_TEXT


def test_rule_policy_is_the_eight_turns_of_the_reference_setting(movie):
    asked = ["moviename", "starttime", "city", "date", "theater", "numberofpeople"]
    requests = tuple(f"request({slot})" for slot in asked)
    told = ("inform(moviename)", "inform(theater)")
    end = ("inform(taskcomplete)", "thanks")
    assert movie.policies["rule"] == ScriptedPolicySpec("script", requests + end)
    assert movie.policies["rule_inform"] == ScriptedPolicySpec("script", requests + told + end)


def test_action_index_names_the_actions_where_there_is_no_such_one(restaurant):
    assert restaurant.actions[restaurant.action_index("inform(area)")].slot == "area"
    with pytest.raises(ValueError, match=r"request\(moviename\).*restaurant.*request\(cuisine\)"):
        restaurant.action_index("request(moviename)")


ACTS = ("request", "inform", "confirm_question", "confirm_answer", "greeting", "closing")
ACTS += ("multiple_choice", "thanks", "deny")
ACTIONS = (Action("thanks"), Action("request", "area"), Action("inform", "booking"))
SLOTS = (
    *("table", "party_size", "cuisine", "area", "day", "hour", "price_range", "restaurant"),
    *("phone", "terrace", "booking"),
)


def policy(kind, *steps, name="x"):
    return {name: ScriptedPolicySpec(kind, steps)}


FAULTS = [
    ("name", "", "''"),
    ("turn_width", 0, "from 1 to 1000"),
    ("reference_slot_error_prob", 1.5, "1.5"),
    ("records", (), "none"),
    ("acts", (*ACTS, "a b"), "'a b'"),
    ("acts", ACTS[:-1], "['deny'] are missing"),
    ("slots", (*SLOTS, "all"), "got 'all'"),
    ("essential", ("table", "booking", "zip"), "'zip'"),
    ("extension_order", ("cuisine",), "['cuisine']"),
    ("free_slots", SLOTS, "constrains the records"),
    ("ticket_slot", "area", "among free_slots, 'area'"),
    ("complete_slot", "table", "'table' for both"),
    ("opening_slots", ("table",), "['table']"),
    ("actions", (*ACTIONS, ACTIONS[-1]), "distinct, got ['inform(booking)']"),
    ("actions", ACTIONS[::-1], "slotless acts, then requests"),
    ("actions", ACTIONS[:-1], "must contain inform(booking)"),
    ("actions", ACTIONS[1:], "thanks or closing"),
    ("actions", (Action("shrug"), *ACTIONS), "unknown act 'shrug'"),
    ("actions", (*ACTIONS, Action("inform", "zip")), "unknown slot 'zip'"),
    ("actions", (Action("inform"), *ACTIONS), "inform(slot)"),
    ("actions", (ACTIONS[0], Action("request", "table"), ACTIONS[-1]), "request(table)"),
    ("actions", (*ACTIONS, Action("multiple_choice", "booking")), "constrains booking"),
    ("policies", policy("script"), "policies.x must have at least one step"),
    ("policies", policy("play", "thanks"), "policies.x must be of kind"),
    ("policies", policy("script", "shrug"), "policies.x needs the action 'shrug'"),
    ("policies", policy("careful", "terrace"), "policies.x needs the action 'request(terrace)'"),
    ("policies", policy("repair", "zip"), "policies.x names the unknown slot 'zip'"),
    ("policies", policy("script", "thanks", name="random"), "'random'"),
    ("records", ({},), "at least one value"),
    ("records", ({"zip": "1"},), "unknown slot 'zip'"),
    ("records", ({"area": 3},), "area must be one line of text, not blank, got 3"),
    ("records", ({"area": "\ud800"},), "UTF-8"),
    ("records", ({"area": "I do not care"},), "reserved value 'I do not care'"),
    ("records", ({"table": "x"},), "special slot 'table'"),
    ("goals", (Goal({}, ("zip",)),), "unknown slot 'zip'"),
    ("goals", (Goal({}, ("area", "area")),), "once, got ['area']"),
    ("goals", (Goal({"area": "no match"}),), "reserved value 'no match'"),
    ("goals", (Goal({}, ("table",)),), "'table'"),
    ("goals", (Goal({"booking": "x"}),), "'booking'"),
    ("goals", (Goal({"area": "x"}, ("area",)),), "constrain and request the same slots ['area']"),
    ("error_values", {"area": ()}, "area must list at least one value"),
    ("error_values", {"zip": ("1",)}, "unknown slot 'zip'"),
    ("error_values", {"booking": ("yes",)}, "special slot 'booking'"),
]


@pytest.mark.parametrize(("field", "value", "named"), FAULTS)
def test_a_fault_is_refused_by_field_and_value(restaurant, field, value, named):
    with pytest.raises(DomainError) as caught:
        replace(restaurant, **{field: value})
    assert any(fault.field == field and named in fault.text for fault in caught.value.found)


@pytest.mark.parametrize(
    ("kind", "missing"),
    [("careful", "thanks"), ("repair", "confirm_answer"), ("repair", "inform(table)")],
)
def test_a_policy_needs_its_actions(restaurant, kind, missing):
    actions = tuple(action for action in restaurant.actions if str(action) != missing)
    with pytest.raises(DomainError, match=re.escape(f"policies.x needs the action {missing!r}")):
        replace(restaurant, actions=actions, policies=policy(kind, "area"))


def test_all_faults_are_refused_at_once_by_an_error_that_survives_pickling(restaurant):
    with pytest.raises(ValueError, match="has 4 faults") as caught:
        replace(restaurant, name="", turn_width=0, goals=(Goal({}, ("zip",)), Goal({}, ("a",))))
    error = caught.value
    assert [fault.field for fault in error.found] == ["name", "turn_width", "goals", "goals"]
    assert "goal 1: " in str(error)
    other = pickle.loads(pickle.dumps(error))
    assert (str(other), other.found) == (str(error), error.found)


@pytest.mark.parametrize("name", ["movie", "restaurant", "miulab"])
def test_a_slots_ids_are_the_reserved_ones_and_all_its_values_once(name, request):
    domain = request.getfixturevalue(name)
    tensors = tensorize(domain)
    for index, slot in enumerate(domain.slots):
        reserved, texts = tensors.vocabulary[index][:FIRST_VALUE], tensors.vocabulary[index][4:]
        assert reserved == ("", *RESERVED_TEXT.values())
        texts = [fold(text) for text in texts]
        known = {fold(text) for text in domain.error_values.get(slot, ())}
        known |= {fold(record[slot]) for record in domain.records if slot in record}
        known |= {fold(g.constraints[slot]) for g in domain.goals if slot in g.constraints}
        assert sorted(texts) == sorted(known - {fold(RESERVED_TEXT[DONT_CARE])})
        assert int(tensors.n_values[index]) == FIRST_VALUE + len(texts)


def test_spellings_that_differ_in_case_are_one_value_shown_as_first_met(restaurant):
    domain = replace(
        restaurant,
        error_values={"area": ("North",)},
        records=({"area": "NORTH"}, {"area": "south"}),
        goals=(Goal({"area": "SOUTH"}), Goal({"area": "i DO not care"})),
    )
    tensors = tensorize(domain)
    area = tensors.slot["area"]
    assert tensors.vocabulary[area][FIRST_VALUE:] == ("North", "south")
    assert tensors.records[:, area].tolist() == [FIRST_VALUE, FIRST_VALUE + 1]
    assert tensors.goal_constraints[:, area].tolist() == [FIRST_VALUE + 1, DONT_CARE]


def test_a_value_listed_twice_is_drawn_twice_as_often(restaurant):
    tensors = tensorize(replace(restaurant, error_values={"area": ("north", "south", "North")}))
    area = tensors.slot["area"]
    assert tensors.error_values[area].tolist() == [FIRST_VALUE, FIRST_VALUE + 1, FIRST_VALUE]


def test_a_domain_without_error_values_has_counts_of_zero(restaurant):
    tensors = tensorize(replace(restaurant, error_values={}))
    assert tensors.error_count.sum() == 0
    assert tensors.error_values.shape == (len(restaurant.slots), 1)
