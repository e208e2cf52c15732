"""The rules of the agenda-based user, one situation each."""

from __future__ import annotations

import pytest
import torch

from .scenes import ACTS, SLOTS, Scene

# -- the first turn --------------------------------------------------------------------------------


def test_user_opens_with_the_movie_one_more_constraint_and_one_request():
    scene = Scene({"movie": "deadpool", "city": "boston", "date": "today"}, ("theater", "genre"))
    state = scene.start(constraint="date", request="genre")
    assert scene.user(state) == (
        "request",
        {"movie": "deadpool", "date": "today"},
        {"genre"},
    )
    assert scene.slots(state["agenda"]) == {"city", "theater", "genre", "ticket"}
    assert scene.values(state["held"]) == {"movie": "deadpool", "date": "today"}
    assert scene.values(state["history"]) == {}


def test_the_random_constraint_of_the_first_turn_can_be_the_movie_again():
    scene = Scene({"movie": "deadpool", "city": "boston"})
    state = scene.start(constraint="movie")
    assert scene.user(state) == ("request", {"movie": "deadpool"}, {"ticket"})
    assert scene.slots(state["agenda"]) == {"city", "ticket"}


def test_user_without_an_opening_slot_opens_with_one_random_constraint():
    scene = Scene({"movie": "deadpool", "city": "boston"}, opening=None)
    state = scene.start(constraint="city")
    assert scene.user(state)[1] == {"city": "boston"}


def test_user_opens_with_all_of_several_opening_slots_that_it_constrains():
    constraints = {"movie": "deadpool", "city": "boston", "date": "today"}
    opening = ("date", "movie", "theater")
    scene = Scene(constraints, ("genre",), opening=opening)
    state = scene.start(constraint="city")
    assert scene.user(state) == ("request", constraints, {"genre"})
    assert scene.slots(state["agenda"]) == {"genre", "ticket"}
    state = scene.start(constraint="movie")
    assert scene.user(state)[1] == {"movie": "deadpool", "date": "today"}
    assert scene.slots(state["agenda"]) == {"city", "genre", "ticket"}
    # One that is not active yet is not spoken of.
    scene = Scene(constraints, opening=opening, active=("movie", "city", "people"))
    assert scene.user(scene.start(constraint="city"))[1] == {"movie": "deadpool", "city": "boston"}


def test_user_without_constraints_informs_nothing_first():
    scene = Scene({}, ("theater",))
    assert scene.user(scene.start()) == ("request", {}, {"theater"})


def test_a_goal_is_restricted_to_the_active_slots_but_keeps_the_ticket():
    scene = Scene({"movie": "deadpool", "city": "boston"}, ("theater",), active=("movie", "people"))
    state = scene.start()
    assert scene.values(state["constraints"]) == {"movie": "deadpool"}
    assert scene.slots(state["requests"]) == {"ticket"}
    assert scene.user(state) == ("request", {"movie": "deadpool"}, {"ticket"})


def test_first_turns_draw_goals_constraints_and_requests_evenly(movie):
    from bbq_torchrl.domains import tensorize
    from bbq_torchrl.simulator import Simulator

    domain = tensorize(movie)
    simulator, count = Simulator(domain), 40_000
    generator = torch.Generator().manual_seed(0)
    state = simulator.reset(
        simulator.draw_reset((count,), generator), torch.ones(domain.n_slots, dtype=torch.bool)
    )
    n_goals = domain.goal_constraints.shape[0]
    drawn = torch.bincount(state["goal_id"], minlength=n_goals) / count
    sigma = (1 / n_goals / count) ** 0.5
    assert (drawn - 1 / n_goals).abs().max() < 6 * sigma

    wanted = state["requests"].clone()
    wanted[:, domain.ticket] = False
    several = wanted.sum(-1) > 1
    first = (wanted & (wanted.cumsum(-1) == 1))[several]
    share = (state["pending"][several] & first).any(-1).double()
    expected = 1 / wanted[several].sum(-1).double()
    sigma = (expected * (1 - expected)).sum().sqrt() / several.sum()
    assert (share.mean() - expected.mean()).abs() < 5 * sigma


# -- the agent requests ----------------------------------------------------------------------------


def test_user_answers_a_request_for_a_constraint_and_forgets_what_it_asked():
    scene = Scene({"city": "boston", "date": "today"}, ("theater",))
    before = scene.situation(agenda=("city", "date", "theater", "ticket"), pending=("theater",))
    state = scene.say(before, "request(city)")
    assert scene.user(state) == ("inform", {"city": "boston"}, set())
    assert scene.slots(state["agenda"]) == {"date", "theater", "ticket"}


def test_user_answers_a_request_for_what_it_was_told_with_that_value():
    scene = Scene({}, ("theater",))
    before = scene.situation(agenda=("ticket",), pending=("ticket",), history={"theater": "odeon"})
    state = scene.say(before, "request(theater)")
    assert scene.user(state) == ("inform", {"theater": "odeon"}, set())


def test_what_the_user_said_last_counts_as_told():
    scene = Scene({}, ("theater",))
    before = scene.situation(history={"theater": "odeon"}, user_informs={"theater": "roxy"})
    state = scene.say(before, "request(theater)")
    assert scene.user(state)[1] == {"theater": "roxy"}


def test_user_asks_an_open_request_back_and_informs_all_that_is_left():
    scene = Scene({"city": "boston", "date": "today"}, ("theater", "genre"))
    before = scene.situation(
        agenda=("city", "date", "theater", "genre", "ticket"), pending=("genre",)
    )
    state = scene.say(before, "request(theater)")
    assert scene.user(state) == (
        "request",
        {"city": "boston", "date": "today"},
        {"theater", "genre"},
    )
    assert scene.slots(state["agenda"]) == {"theater", "genre", "ticket"}


@pytest.mark.parametrize(
    ("agenda", "pending", "act"),
    [((), (), "thanks"), (("ticket",), (), "inform"), ((), ("theater",), "inform")],
)
def test_user_does_not_care_about_other_slots_and_thanks_when_idle(agenda, pending, act):
    scene = Scene({"city": "boston"}, ("theater",))
    before = scene.situation(agenda=agenda, pending=pending)
    state = scene.say(before, "request(genre)")
    assert scene.user(state) == (act, {"genre": "I do not care"}, set(pending))


# -- the agent informs -----------------------------------------------------------------------------


def test_user_corrects_a_wrong_value_and_still_waits_for_its_answer():
    scene = Scene({"city": "boston"}, ("theater",))
    before = scene.situation(
        agenda=("city", "theater", "ticket"), pending=("theater",), held={"date": "friday"}
    )
    state = scene.say(before, "inform(city)")
    assert scene.values(state["agent_informs"]) == {"city": "seattle"}
    assert scene.user(state) == ("inform", {"city": "boston"}, {"theater"})
    assert scene.slots(state["agenda"]) == {"theater", "ticket"}
    assert scene.values(state["history"]) == {"city": "seattle"}
    assert scene.values(state["held"])["city"] == "boston"


CONTINUE = [
    # agenda, pending, draw; after a right value: act, informs, pending; after an answer: the same
    ((), ("theater",), "", ("request", {}, {"theater"}), ("request", {}, {"theater"})),
    (("date",), (), "date", ("inform", {"date": "today"}, set()), None),
    (
        ("date", "ticket"),
        (),
        "date",
        ("inform", {"date": "today"}, set()),
        ("request", {"date": "today"}, {"ticket"}),
    ),
    (("date", "theater"), (), "theater", ("request", {}, {"theater"}), None),
    (("ticket",), (), "ticket", ("request", {}, {"ticket"}), None),
    ((), (), "", ("thanks", {}, set()), None),
]


@pytest.mark.parametrize(("agenda", "pending", "draw", "after_right", "after_answer"), CONTINUE)
def test_user_goes_on_after_an_inform(agenda, pending, draw, after_right, after_answer):
    scene = Scene({"city": "seattle", "date": "today"}, ("theater", "genre"))
    chosen = {"agenda": draw} if draw else {}

    before = scene.situation(agenda=(*agenda, "city"), pending=pending, held={"theater": "roxy"})
    right = scene.say(before, "inform(city)", **chosen)
    assert scene.user(right) == after_right
    said = set(after_right[1])
    assert scene.slots(right["agenda"]) == set(agenda) - said

    before = scene.situation(agenda=(*agenda, "genre"), pending=(*pending, "genre"))
    answered = scene.say(before, "inform(genre)", **chosen)
    assert scene.user(answered) == (after_answer or after_right)
    assert scene.slots(answered["agenda"]) == set(agenda) - said


def test_the_ticket_is_never_the_random_choice_while_another_slot_is_left():
    scene = Scene({"city": "seattle"}, ("theater",))
    before = scene.situation(agenda=("theater", "ticket"))
    state = scene.say(before, "inform(genre)", agenda={"ticket": 0.9, "theater": 0.1})
    assert scene.user(state)[2] == {"theater"}


def test_telling_the_ticket_answers_the_request_for_it():
    scene = Scene({"city": "boston"})
    before = scene.situation(agenda=("ticket",), pending=("ticket",))
    state = scene.say(before, "inform(ticket)")
    assert scene.user(state) == ("thanks", {}, set())
    assert scene.values(state["history"]) == {"ticket": "ticket available"}
    assert scene.slots(state["agenda"]) == set()


# -- the agent offers a booking --------------------------------------------------------------------


def test_user_accepts_a_booking_that_has_every_constraint():
    scene = Scene({"city": "boston", "people": "9"})
    before = scene.situation(held={"city": "boston", "people": "9"}, pending=("ticket",))
    state = scene.say(before, "inform(done)")
    assert scene.user(state) == ("thanks", {}, {"ticket"})
    assert state["constraints_met"]


@pytest.mark.parametrize("held", [{"city": "boston"}, {"city": "seattle", "people": "9"}])
def test_user_denies_a_booking_that_breaks_a_constraint(held):
    scene = Scene({"city": "boston", "people": "9"})
    before = scene.situation(held=held, pending=("ticket",), constraints_met=True)
    state = scene.say(before, "inform(done)")
    assert scene.user(state) == ("deny", {}, set())
    assert not state["constraints_met"]


@pytest.mark.parametrize(("city", "act"), [("seattle", "thanks"), ("boston", "deny")])
def test_a_booking_without_a_match_is_remembered_whatever_the_verdict(city, act):
    scene = Scene({"city": city})
    before = scene.situation(
        held={"city": "seattle", "theater": "lux"},
        agenda=("ticket",),
        pending=("ticket",),
        user_informs={"city": "seattle"},
    )
    state = scene.say(before, "inform(done)")
    assert scene.user(state) == (act, {}, set())
    assert scene.values(state["history"]) == {"city": "seattle", "ticket": "no match"}
    assert scene.slots(state["agenda"]) == set()


def test_the_verdict_holds_until_the_next_offer():
    scene = Scene({"city": "boston"}, ("theater",))
    before = scene.situation(
        held={"city": "boston"}, pending=("theater",), agenda=("theater", "ticket")
    )
    state = scene.say(before, "inform(done)", "inform(theater)")
    assert state["constraints_met"]
    assert scene.user(state) == ("request", {}, {"ticket"})


# -- the other acts --------------------------------------------------------------------------------


def test_user_goes_on_with_any_agenda_slot_when_asked_to():
    scene = Scene({"city": "boston"}, ("theater",))
    before = scene.situation(agenda=("city", "theater", "ticket"), pending=("theater",))
    for slot, expected in {
        "city": ("inform", {"city": "boston"}, {"theater"}),
        "ticket": ("request", {}, {"theater", "ticket"}),
    }.items():
        state = scene.say(before, "confirm_answer", agenda=slot)
        assert scene.user(state) == expected
    assert scene.user(scene.say(scene.situation(), "confirm_answer"))[0] == "thanks"


@pytest.mark.parametrize("act", ["greeting", "deny", "confirm_question"])
def test_user_repeats_its_act_after_small_talk(act):
    scene = Scene({"city": "boston"}, ("theater",))
    before = scene.situation(
        user_act="deny", user_informs={"city": "boston"}, pending=("theater",), agenda=("ticket",)
    )
    state = scene.say(before, act)
    assert scene.user(state) == ("deny", {}, {"theater"})
    assert scene.slots(state["agenda"]) == {"ticket"}
    assert scene.values(state["history"]) == {"city": "boston"}


def test_user_chooses_its_constraint_or_one_of_the_values_offered():
    scene = Scene({"theater": "lux"})
    before = scene.situation(agenda=("theater", "ticket"))
    state = scene.say(before, "multiple_choice(theater)", offer=0.0)
    assert scene.user(state)[:2] == ("inform", {"theater": "lux"})
    assert scene.slots(state["agenda"]) == {"ticket"}

    scene = Scene({"city": "boston"})
    before = scene.situation(held={"city": "boston"})
    for number, choice in ((0.0, "odeon"), (0.49, "odeon"), (0.5, "lux"), (0.99, "lux")):
        state = scene.say(before, "multiple_choice(theater)", offer=number)
        assert scene.user(state)[1] == {"theater": choice}

    before = scene.situation(held={"city": "seattle", "theater": "lux"})
    state = scene.say(before, "multiple_choice(theater)")
    assert scene.user(state)[1] == {"theater": "I do not care"}


def test_every_agent_act_leaves_the_goal_and_the_shape_of_the_state_alone():
    from .scenes import ACTIONS

    scene = Scene({"city": "boston", "date": "today"}, ("theater",))
    before = scene.start()
    for action in ACTIONS:
        after = scene.say(before, action)
        assert after.keys() == before.keys()
        for key in before.keys():  # noqa: SIM118  (a TensorDict iterates over its rows)
            assert after[key].dtype == before[key].dtype, (action, key)
            assert after[key].shape == before[key].shape, (action, key)
        for key in ("goal_id", "constraints", "requests"):
            assert (after[key] == before[key]).all(), (action, key)
        assert 0 <= int(after["user_act"]) < len(ACTS)
        assert after["agenda"].shape == (len(SLOTS),)
