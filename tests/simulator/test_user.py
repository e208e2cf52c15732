"""The agenda-based user: what the rules, which are spelled on the oracle, leave open."""

from __future__ import annotations

import torch

from .scenes import ACTS, SLOTS, Scene


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


def test_the_ticket_is_never_the_random_choice_while_another_slot_is_left():
    scene = Scene({"city": "seattle"}, ("theater",))
    before = scene.situation(agenda=("theater", "ticket"))
    state = scene.say(before, "inform(genre)", agenda={"ticket": 0.9, "theater": 0.1})
    assert scene.user(state)[2] == {"theater"}


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
