"""The oracle against dialogues worked out by hand."""

import pytest

from bbq_torchrl.domains import Goal

from .draws import choose_index, choose_slot
from .rules import RULES, played, seen
from .small import GOAL, say, start


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.splitlines()[0][2:])
def test_the_oracle_plays_as_the_rules_say(rule):
    for dialogue, expected in played(rule):
        assert expected.items() <= seen(dialogue).items()


def test_a_choice_among_slots_falls_on_the_largest_number_and_on_the_first_of_equals():
    u = [0.9, 0.5, 0.5, 0.1]
    assert choose_slot({"b", "c", "d"}, u, ["a", "b", "c", "d"]) == "b"
    assert choose_slot({"c", "d"}, u, ["a", "b", "c", "d"]) == "c"
    assert [choose_index(u, 4) for u in (0.0, 0.24, 0.25, 0.99)] == [0, 0, 1, 3]


def test_the_features_of_a_state_by_hand():
    dialogue = start(Goal(GOAL, ("theater",)), first={"constraint": "city"})
    say(dialogue, "request(numberofpeople)", "inform(date)")
    assert dialogue.tracker.agent_informs == {"date": "today"}
    # Rows: moviename, city, date, theater, genre, numberofpeople, ticket, taskcomplete, all.
    counts = [4, 3, 3, 2, 2, 0, 2, 2, 2]
    assert dialogue.features() == [
        *[1, 0, 0, 0, 0, 0, 0, 0, 0],  # the user's act: request
        *[0, 0, 0, 0, 0, 0, 0, 0],  # the user's informs
        *[0, 0, 0, 1, 0, 0, 0, 0],  # the user's requests: the theater again
        *[0, 1, 0, 0, 0, 0, 0, 0, 0],  # the agent's act: inform
        *[0, 0, 1, 0, 0, 0, 0, 0],  # the agent's informs
        *[0, 0, 0, 0, 0, 0, 0, 0],  # the agent's request
        *[1, 1, 1, 0, 0, 1, 0, 0],  # filled
        *[0.5, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0],  # five acts so far
        *(float(count > 0) for count in counts),
        *(count / 100 for count in counts),
    ]


def test_a_slot_that_is_not_active_is_seen_nowhere():
    active = ("moviename", "city", "numberofpeople", "ticket", "taskcomplete")
    goal = Goal({**GOAL, "date": "today"}, ("theater",))
    dialogue = start(goal, first={"constraint": "date"}, active=active)
    assert dialogue.features()[-9:] == [0.04, 0.04, 0, 0, 0, 0.04, 0.04, 0.04, 0.04]
    legal = [dialogue.world.action_names[number] for number in dialogue.world.legal_actions()]
    assert {"request(city)", "greeting"} <= {*legal}
    assert not [name for name in legal if "date" in name or "theater" in name or "genre" in name]
