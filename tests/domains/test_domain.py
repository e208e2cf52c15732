"""Domains: consistent data is accepted, every inconsistency is refused by name."""

from __future__ import annotations

import pickle
from dataclasses import replace

import pytest

from bbq_torchrl.domains import Action, Goal, ScriptedPolicySpec

REQUESTED = [
    *("moviename", "theater", "starttime", "date", "numberofpeople", "genre", "state", "city"),
    *("zip", "critic_rating", "mpaa_rating", "distanceconstraints", "video_format"),
    *("theater_chain", "price", "actor"),
]


def test_movie_actions_are_slotless_acts_then_requests_then_informs(movie):
    informed = [slot for slot in REQUESTED if slot != "numberofpeople"]
    expected = ["greeting", "thanks", "deny", "confirm_question", "confirm_answer", "closing"]
    expected += [f"request({slot})" for slot in REQUESTED]
    expected += [f"inform({slot})" for slot in [*informed, "taskcomplete", "ticket"]]
    assert list(movie.action_names) == expected


def test_movie_extension_adds_ten_slots_that_have_actions(movie):
    assert len(movie.extension_order) == 10
    assert list(movie.extension_order) == [s for s in REQUESTED if s not in movie.essential]
    active = {*movie.essential, *movie.extension_order}
    assert all(action.slot is None or action.slot in active for action in movie.actions)


def test_rule_policy_is_the_eight_turns_of_the_reference_setting(movie):
    asked = ["moviename", "starttime", "city", "date", "theater", "numberofpeople"]
    requests = tuple(f"request({slot})" for slot in asked)
    told = ("inform(moviename)", "inform(theater)")
    end = ("inform(taskcomplete)", "thanks")
    assert movie.policies["rule"] == ScriptedPolicySpec("script", requests + end)
    assert movie.policies["rule_inform"] == ScriptedPolicySpec("script", requests + told + end)


def test_an_action_reads_as_act_and_slot():
    assert str(Action("thanks")) == "thanks"
    assert str(Action("multiple_choice", "city")) == "multiple_choice(city)"
    with pytest.raises(ValueError, match=r"carry a slot in an action, got 'deny\(city\)'"):
        Action("deny", "city")


def test_action_index_names_the_actions_where_there_is_no_such_one(restaurant):
    assert restaurant.actions[restaurant.action_index("inform(area)")].slot == "area"
    with pytest.raises(ValueError, match=r"request\(moviename\).*restaurant.*request\(cuisine\)"):
        restaurant.action_index("request(moviename)")


ACTIONS = (Action("thanks"), Action("request", "area"), Action("inform", "booking"))
THANKS = ScriptedPolicySpec("script", ("thanks",))
SLOTS = (
    *("table", "party_size", "cuisine", "area", "day", "hour", "price_range", "restaurant"),
    *("phone", "terrace", "booking"),
)


def actions(*first):
    """The domain's actions, with the first ones replaced."""
    return {"actions": (*first, *ACTIONS[len(first) :])}


def careful(slot, kind="careful"):
    return {"policies": {"x": ScriptedPolicySpec(kind, (slot,))}}


FAULTS = {
    "act not a word": ({"acts": ("a b",)}, "identifiers.*a b"),
    "slot all": ({"slots": (*SLOTS, "all")}, "slots must consist of letters.*got 'all'"),
    "slot of digits": ({"slots": (*SLOTS, "0")}, "slots must consist of letters.*got '0'"),
    "ticket not free": ({"free_slots": ("booking",)}, "ticket_slot must be among free_slots"),
    "all slots free": ({"free_slots": SLOTS}, "leave a slot that constrains the records"),
    "action twice": ({"actions": (*ACTIONS, ACTIONS[-1])}, r"distinct.*inform\(booking\)"),
    "action order": ({"actions": ACTIONS[::-1]}, "slotless acts, then requests"),
    "action act unknown": (actions(Action("shrug")), "unknown act 'shrug'"),
    "action slot unknown": (
        {"actions": (*ACTIONS, Action("inform", "zip"))},
        "unknown slot 'zip'",
    ),
    "action without slot": (actions(Action("inform")), "needs a slot"),
    "ticket requested": (actions(ACTIONS[0], Action("request", "table")), "constrains table"),
    "policy empty": ({"policies": {"x": ScriptedPolicySpec("script", ())}}, "x.*one step"),
    "policy request": (careful("terrace"), r"needs.*request\(terrace\)"),
    "policy farewell": (actions(Action("closing")) | careful("area"), "needs the action 'thanks'"),
    "policy confirm": (actions() | careful("area", "repair"), "needs the action 'confirm_answer'"),
    "policy slot": (careful("zip", "repair"), "policies.x names the unknown slot 'zip'"),
    "policy random": ({"policies": {"random": THANKS}}, "not have.*got 'random'"),
    "policy clairvoyant": ({"policies": {"clairvoyant": THANKS}}, "not have.*got 'clairvoyant'"),
    "policy without name": ({"policies": {"": THANKS}}, "not have.*got ''"),
    "record slot": ({"records": ({"zip": "1"},)}, "record 0.*unknown slot 'zip'"),
    "record number": ({"records": ({"area": 3},)}, "record 0.*area.*3"),
    "goal request": ({"goals": (Goal({}, ("zip",)),)}, "goal 0.*unknown slot 'zip'"),
    "values reserved": ({"error_values": {"area": ("I do not care",)}}, "reserved"),
    "values special": ({"error_values": {"booking": ("yes",)}}, "special slot 'booking'"),
}
"""Faults that the damaged folders of test_folder.py do not cover."""


@pytest.mark.parametrize(("change", "message"), FAULTS.values(), ids=FAULTS)
def test_a_fault_is_refused_by_name(restaurant, change, message):
    with pytest.raises(ValueError, match=message):
        replace(restaurant, **change)


@pytest.mark.parametrize("change", [{"goals": ()}, {"name": "", "turn_width": 0, "goals": ()}])
def test_all_faults_are_refused_at_once_by_an_error_that_survives_pickling(restaurant, change):
    texts = {
        "name": "name of a domain must not be empty",
        "turn_width": "turn_width must be between",
        "goals": "the list of goals is empty",
    }
    with pytest.raises(ValueError, match="domain ") as caught:
        replace(restaurant, **change)
    error = caught.value
    assert all((text in str(error)) == (key in change) for key, text in texts.items())
    assert ("has 3 faults" in str(error)) == (len(change) == 3)
    other = pickle.loads(pickle.dumps(error))
    assert (str(other), other.found) == (str(error), error.found)


def test_a_domain_survives_pickling(restaurant):
    assert pickle.loads(pickle.dumps(restaurant)) == restaurant


def test_a_user_may_not_care(restaurant):
    goal = Goal({"area": "i do NOT care"})
    assert replace(restaurant, goals=(goal,)).goals == (goal,)
