"""What the oracle's agent informs and sees, against dialogues worked out by hand."""

from __future__ import annotations

from .small import GOAL, SLOTS, say, start


def test_the_agent_informs_the_most_frequent_value_of_the_matching_rows():
    dialogue = start({"moviename": "deadpool"}, ("theater",))
    tracker = dialogue.tracker
    say(dialogue, "inform(city)")
    assert tracker.agent_informs == {"city": "seattle"}
    say(dialogue, "inform(city)")  # the slot's own value is held and takes part in the match
    assert tracker.agent_informs == {"city": "seattle"}
    say(dialogue, "inform(genre)")  # no Deadpool row has a genre
    assert tracker.agent_informs == {"genre": "no match"} == {"genre": tracker.held["genre"]}
    say(dialogue, "inform(theater)")  # "no match" is held and matches nothing
    assert tracker.agent_informs == {"theater": "no match"}
    say(dialogue, "inform(ticket)")
    assert tracker.agent_informs == {"ticket": "no match"}


def test_equally_frequent_values_are_told_apart_by_their_order():
    goal = {"moviename": "deadpool", "date": "today"}
    tracker = (dialogue := start(goal, ("theater",), first={"constraint": "date"})).tracker
    say(dialogue, "inform(theater)")  # Roxy, Odeon and Lux once each; Roxy is named first
    assert tracker.agent_informs == {"theater": "roxy"}


def test_do_not_care_matches_rows_that_lack_the_slot():
    tracker = (dialogue := start({"moviename": "deadpool"}, ("theater",))).tracker
    say(dialogue, "request(genre)")
    assert tracker.held["genre"] == "i do not care"
    assert len(tracker.shelf.matching(tracker.held)) == 4
    assert len(tracker.shelf.matching({"genre": "comedy"})) == 1
    assert len(tracker.shelf.matching({"genre": "no match"})) == 0
    assert len(tracker.shelf.matching({"numberofpeople": "2", "ticket": "no match"})) == 5


def test_the_features_of_a_state_by_hand():
    dialogue = start(GOAL, ("theater",), first={"constraint": "city"})
    say(dialogue, "request(numberofpeople)", "inform(date)")
    assert dialogue.tracker.agent_informs == {"date": "today"}
    # Rows: moviename, city, date, theater, genre, numberofpeople, ticket, taskcomplete.
    counts = [4, 3, 3, 2, 2, 0, 2, 2, 2]
    assert dialogue.features() == [
        *[1, 0, 0, 0, 0, 0, 0, 0, 0],  # the user's act: request
        *[0, 0, 0, 0, 0, 0, 0, 0],  # what the user informs
        *[0, 0, 0, 1, 0, 0, 0, 0],  # what the user requests: the theater again
        *[0, 1, 0, 0, 0, 0, 0, 0, 0],  # the agent's act: inform
        *[0, 0, 1, 0, 0, 0, 0, 0],  # what the agent informs
        *[0, 0, 0, 0, 0, 0, 0, 0],  # what the agent requests
        *[1, 1, 1, 0, 0, 1, 0, 0],  # filled
        *[0.5, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0],  # five acts so far
        *(float(count > 0) for count in counts),
        *(count / 100 for count in counts),
    ]
    assert len(dialogue.features()) == 2 * 9 + 7 * len(SLOTS) + 3 + 10


def test_a_slot_that_is_not_active_is_seen_nowhere():
    active = {"moviename", "city", "numberofpeople", "ticket", "taskcomplete"}
    goal = GOAL | {"date": "today"}
    dialogue = start(goal, ("theater",), first={"constraint": "date"}, active=active)
    user = dialogue.user
    assert user.constraints == GOAL
    assert user.requests == {"ticket"}
    assert user.pending == {"ticket"}
    counts = dialogue.features()[-9:]
    assert [round(100 * count) for count in counts] == [4, 4, 0, 0, 0, 4, 4, 4, 4]
    names = [str(dialogue.world.domain.actions[i]) for i in dialogue.world.legal_actions()]
    assert "request(city)" in names
    assert "greeting" in names
    assert not [name for name in names if "date" in name or "theater" in name or "genre" in name]
