"""A domain that exists is consistent: everything else is refused by name."""

from __future__ import annotations

import pickle
from dataclasses import replace

import pytest

from bbq_torchrl.domains import Action, Domain, Goal, ScriptedPolicySpec

REQUESTED = [
    "moviename",
    "theater",
    "starttime",
    "date",
    "numberofpeople",
    "genre",
    "state",
    "city",
    "zip",
    "critic_rating",
    "mpaa_rating",
    "distanceconstraints",
    "video_format",
    "theater_chain",
    "price",
    "actor",
]


def test_movie_actions_are_slotless_acts_then_requests_then_informs(movie: Domain):
    informed = [slot for slot in REQUESTED if slot != "numberofpeople"]
    expected = ["greeting", "thanks", "deny", "confirm_question", "confirm_answer", "closing"]
    expected += [f"request({slot})" for slot in REQUESTED]
    expected += [f"inform({slot})" for slot in [*informed, "taskcomplete", "ticket"]]
    assert list(movie.action_names) == expected


def test_movie_extension_adds_ten_slots_that_have_actions(movie: Domain):
    assert len(movie.extension_order) == 10
    assert list(movie.extension_order) == [s for s in REQUESTED if s not in movie.essential]
    active = {*movie.essential, *movie.extension_order}
    assert all(action.slot is None or action.slot in active for action in movie.actions)


def test_rule_policy_is_the_eight_turns_of_the_reference_setting(movie: Domain):
    rule, longer = movie.policies["rule"], movie.policies["rule_inform"]
    asked = ["moviename", "starttime", "city", "date", "theater", "numberofpeople"]
    assert rule == ScriptedPolicySpec(
        "script", (*(f"request({slot})" for slot in asked), "inform(taskcomplete)", "thanks")
    )
    assert longer.steps == (
        *rule.steps[:6],
        "inform(moviename)",
        "inform(theater)",
        *rule.steps[6:],
    )


def test_an_action_reads_as_act_and_slot():
    assert str(Action("thanks")) == "thanks"
    assert str(Action("multiple_choice", "city")) == "multiple_choice(city)"
    with pytest.raises(ValueError, match=r"carry a slot in an action, got 'deny\(city\)'"):
        Action("deny", "city")


def test_action_index_names_the_actions_where_there_is_no_such_one(restaurant: Domain):
    assert restaurant.actions[restaurant.action_index("inform(area)")].slot == "area"
    with pytest.raises(ValueError, match=r"request\(moviename\).*restaurant.*request\(cuisine\)"):
        restaurant.action_index("request(moviename)")


def test_a_domain_survives_pickling(restaurant: Domain):
    assert pickle.loads(pickle.dumps(restaurant)) == restaurant


ACTIONS = (Action("thanks"), Action("request", "area"), Action("inform", "booking"))
SLOTS = (
    *("table", "party_size", "cuisine", "area", "day", "hour", "price_range", "restaurant"),
    *("phone", "terrace", "booking"),
)
FAULTS = {
    "act not a word": ({"acts": ("a b",)}, "identifiers.*a b"),
    "ticket not free": ({"free_slots": ("booking",)}, "ticket_slot must be among free_slots"),
    "action twice": ({"actions": (*ACTIONS, ACTIONS[-1])}, r"distinct.*inform\(booking\)"),
    "action order": ({"actions": ACTIONS[::-1]}, "slotless acts, then requests"),
    "action act unknown": (
        {"actions": (Action("shrug"), *ACTIONS)},
        "unknown act 'shrug'",
    ),
    "action slot unknown": (
        {"actions": (*ACTIONS, Action("inform", "zip"))},
        "unknown slot 'zip'",
    ),
    "action without slot": ({"actions": (Action("inform"), *ACTIONS)}, "needs a slot"),
    "ticket requested": (
        {"actions": (ACTIONS[0], Action("request", "table"), *ACTIONS[2:])},
        "no user constrains table",
    ),
    "policy empty": ({"policies": {"x": ScriptedPolicySpec("script", ())}}, "x.*one step"),
    "policy request": (
        {"policies": {"x": ScriptedPolicySpec("careful", ("terrace",))}},
        r"needs.*request\(terrace\)",
    ),
    "policy farewell": (
        {
            "actions": (Action("closing"), *ACTIONS[1:]),
            "policies": {"x": ScriptedPolicySpec("careful", ("area",))},
        },
        "needs the action 'thanks'",
    ),
    "policy random": (
        {"policies": {"random": ScriptedPolicySpec("script", ("thanks",))}},
        "got 'random'",
    ),
    "policy clairvoyant": (
        {"policies": {"clairvoyant": ScriptedPolicySpec("script", ("thanks",))}},
        "policies must have names of their own.*got 'clairvoyant'",
    ),
    "policy without name": (
        {"policies": {"": ScriptedPolicySpec("script", ("thanks",))}},
        "policies must have names of their own.*got ''",
    ),
    "slot all": ({"slots": (*SLOTS, "all")}, "slots must consist of letters.*got 'all'"),
    "slot of digits": ({"slots": (*SLOTS, "0")}, "slots must consist of letters.*got '0'"),
    "all slots free": (
        {"slots": SLOTS, "free_slots": SLOTS},
        "free_slots must leave a slot to constrain the records by",
    ),
    "record slot": ({"records": ({"zip": "1"},)}, "record 0.*unknown slot 'zip'"),
    "record number": ({"records": ({"area": 3},)}, "record 0.*area.*3"),
    "goal request": ({"goals": (Goal({}, ("zip",)),)}, "goal 0.*unknown slot 'zip'"),
    "values reserved": ({"error_values": {"area": ("I do not care",)}}, "reserved"),
    "values special": ({"error_values": {"booking": ("yes",)}}, "special slot 'booking'"),
}
"""Those that the damaged folders of test_folder.py do not have."""


@pytest.mark.parametrize(("change", "message"), FAULTS.values(), ids=FAULTS)
def test_a_fault_is_refused_by_name(restaurant: Domain, change, message):
    with pytest.raises(ValueError, match=message):
        replace(restaurant, **change)


def test_all_faults_are_refused_at_once(restaurant: Domain):
    with pytest.raises(ValueError, match="domain '' has 3 faults") as caught:
        replace(restaurant, name="", turn_width=0, goals=())
    for text in ("name of a domain must not", "turn_width must be between", "there are no goals"):
        assert text in str(caught.value)


def test_an_error_with_all_its_faults_survives_pickling(restaurant: Domain):
    for change in ({"goals": ()}, {"goals": (), "name": ""}):
        with pytest.raises(ValueError, match="there are no goals") as caught:
            replace(restaurant, **change)
        other = pickle.loads(pickle.dumps(caught.value))
        assert (str(other), other.found) == (str(caught.value), caught.value.found)


def test_a_user_may_not_care(restaurant: Domain):
    goal = Goal({"area": "i do NOT care"})
    assert replace(restaurant, goals=(goal,)).goals == (goal,)
