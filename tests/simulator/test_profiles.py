"""Users that differ: what each key of a profile promises, over random dialogues."""

from __future__ import annotations

from itertools import pairwise

import pytest
import torch

from bbq_torchrl.domains import tensorize
from bbq_torchrl.domains.values import DONT_CARE, NONE, fold
from bbq_torchrl.settings import USERS
from bbq_torchrl.simulator import ErrorModel, Profile, Simulator
from bbq_torchrl.simulator.measured_errors import load_errors
from bbq_torchrl.simulator.profiles import HABITS, MIXES, Mix, check_slots, profiles_of
from bbq_torchrl.simulator.user import MixedUser

SHAPE = (400,)
ENDS = ("thanks", "closing")


def play(domain, users, seed, *, turns=19, errors=None):
    """Plays random actions. Returns the simulator and the states of all turns."""
    tensors = tensorize(domain)
    channel = ErrorModel(tensors, *errors) if errors else None
    simulator = Simulator(tensors, users=users, errors=channel)
    generator = torch.Generator().manual_seed(seed)
    active = torch.ones(tensors.n_slots, dtype=torch.bool)
    states = [simulator.reset(simulator.draw_reset(SHAPE, generator), active)]
    ends = [number for number, action in enumerate(domain.actions) if action.act in ENDS]
    for _ in range(turns):
        action = torch.randint(tensors.n_actions, SHAPE, generator=generator)
        action[torch.isin(action, torch.tensor(ends))] = tensors.n_actions - 2  # the offer
        draws = simulator.draw_turn(SHAPE, generator)
        states.append(simulator.turn(states[-1], action, draws, active))
    return simulator, states


def test_the_mixes_have_the_names_that_are_allowed():
    assert all(USERS.test(name) for name in MIXES)
    assert f"one of {', '.join(MIXES)}, or" in USERS.text
    for profiles in MIXES.values():
        assert profiles_of(profiles or "paper") == profiles


def test_users_without_differences_are_those_of_the_paper(movie, restaurant):
    assert profiles_of([{"share": 0.5}, {"share": 0.5}]) == ()
    for domain in (movie, restaurant):
        simulator, _ = play(domain, "people", 0, turns=0)
        plain = Simulator(simulator.domain)
        simulator.mix = Mix(simulator.domain, [Profile(0.4), Profile(0.6)])
        simulator.user = MixedUser(simulator.domain, simulator.mix)
        active = torch.ones(simulator.domain.n_slots, dtype=torch.bool)
        draws = simulator.draw_reset(SHAPE)
        state, expected = simulator.reset(draws, active), plain.reset(draws, active)
        for _ in range(25):
            assert (state.exclude("traits") == expected).all()
            action = torch.randint(simulator.domain.n_actions, SHAPE)
            draws = plain.draw_turn(SHAPE)
            state = simulator.turn(state, action, draws, active)
            expected = plain.turn(expected, action, draws, active)


def test_after_a_change_of_mind_the_goal_can_still_be_met(movie):
    simulator, states = play(movie, {"changes_mind": 1.0}, 1)
    first, last = states[0], states[-1]
    texts, slots = simulator.domain.vocabulary, movie.slots
    records = [{slot: fold(value) for slot, value in row.items()} for row in movie.records]

    def can_be_met(state, number):
        wanted = state["constraints"][number].tolist()
        asked = [slots[s] for s in state["requests"][number].nonzero().flatten().tolist()]
        pairs = {slots[s]: fold(texts[s][v]) for s, v in enumerate(wanted) if v > DONT_CARE}
        kept = {slot: v for slot, v in pairs.items() if slot not in movie.free_slots}
        asked = [slot for slot in asked if slot != movie.ticket_slot]
        return any(
            all(row.get(slot) == value for slot, value in kept.items())
            and all(slot in row for slot in asked)
            for row in records
        )

    changed = (first["constraints"] != last["constraints"]).sum(-1)
    could = [can_be_met(first, number) for number in range(SHAPE[0])]
    assert changed.max() == 1
    assert changed.float().mean() > 0.5
    assert all(can_be_met(last, n) for n in range(SHAPE[0]) if could[n] or changed[n])
    for before, after in pairwise(states):
        moved = before["constraints"] != after["constraints"]
        assert not (moved & before["agenda"]).any()  # only what has been told
        assert (after["meant_informs"] == after["constraints"])[moved].all()
        assert not after["constraints_met"][moved.any(-1)].any()


def test_a_user_leaves_when_its_patience_ends(movie):
    _, states = play(movie, {"patience": [2, 5]}, 2)
    patience = states[0]["traits", "limit"] // 2
    turns = states[-1]["turn"] // 2
    assert states[-1]["done"].all()
    assert torch.equal(turns, patience + 1)  # as at max_turn, the agent has spoken once more
    assert not states[-1]["success"].any()
    shares = torch.bincount(patience, minlength=6)[2:] / SHAPE[0]
    # Four standard errors of a share of a quarter.
    assert (shares - 0.25).abs().max() < 4 * (0.25 * 0.75 / SHAPE[0]) ** 0.5


def test_a_user_leaves_when_its_questions_are_passed_over(movie):
    simulator, states = play(movie, {"bears": [2, 2], "insists": 1.0}, 7)
    ticket, acts = simulator.domain.ticket, simulator.domain.act
    passed = torch.zeros(SHAPE, dtype=torch.long)
    for before, after in pairwise(states):
        left = (passed == 2) & ~before["done"]
        assert (after["done"] & ~after["success"])[left].all()
        assert not (after["done"] & ~before["done"] & ~left & (after["turn"] <= 40)).any()
        asked = before["pending"].clone()
        asked[..., ticket] = False
        is_answer = (asked & (after["agent_informs"] != NONE)).any(-1)
        is_request = after["agent_act"] == acts["request"]
        is_offer = after["agent_informs"][..., simulator.domain.complete] != NONE
        ignored = asked.any(-1) & ~is_request & (is_offer | ~is_answer)
        passed += (ignored & ~after["done"]).long()
    assert passed.max() == 2


@pytest.mark.parametrize("most", [1, 3])
def test_a_user_tells_as_many_constraints_as_it_does(movie, most):
    _, states = play(movie, {"tells": [most, most]}, 3)
    for before, after in pairwise(states):
        told = (after["meant_informs"] != NONE) & (after["constraints"] != NONE)
        left = (before["agenda"] & (before["constraints"] != NONE)).sum(-1)
        speaks = (after["meant_informs"] != NONE).any(-1)
        assert told.sum(-1).max() <= most
        enough = speaks & (left >= most) & ~after["done"]
        assert (told.sum(-1)[enough] == most).all()
        assert enough.any() or left.max() < most


def test_a_user_insists_on_one_question_until_it_is_answered(movie):
    simulator, states = play(movie, {"insists": 1.0}, 4)
    ticket = simulator.domain.ticket
    seen = 0
    for before, after in pairwise(states):
        assert after["pending"].sum(-1).max() <= 1
        asked = before["pending"] & ~after["done"][..., None]
        asked[..., ticket] = False
        answered = after["agent_informs"] != NONE
        assert after["pending"][asked & ~answered].all()
        assert not after["pending"][asked & answered].any()
        seen += int((asked & ~answered).sum())
    assert seen > 1_000


def test_a_user_with_late_questions_asks_them_after_a_right_offer(movie):
    simulator, states = play(movie, {"asks_late": 1.0}, 5)
    act, ticket = simulator.domain.act, simulator.domain.ticket
    questions = states[0]["agenda"] & states[0]["requests"]
    questions[..., ticket] = False
    assert questions.any(-1).float().mean() > 0.5
    assert (states[0]["pending"].nonzero()[:, 1] == ticket).all()
    offers = 0
    for after in states[1:]:
        is_offer = (after["agent_informs"][..., simulator.domain.complete] != NONE) & ~after["done"]
        is_right = is_offer & after["constraints_met"]
        is_open = (after["agenda"] & after["requests"] & questions).any(-1)
        assert (after["user_act"][is_right & is_open] == act["request"]).all()
        assert (after["user_act"][is_right & ~is_open] == act["thanks"]).all()
        offers += int((is_right & is_open).sum())
    assert offers > 20


@pytest.mark.parametrize("mode", ["value", "delete"])
def test_slots_have_the_error_rates_of_the_user(movie, mode):
    rates = {"date": 0.5, "moviename": 0.0, "city": 1.0}
    users = [{"share": 0.5, "slot_error_prob": rates}, {"share": 0.5}]
    simulator, states = play(movie, users, 6, errors=(0.2, mode))
    has_rates = states[0]["traits", "error_prob"][:, movie.slots.index("city")] == 1
    for slot in (*rates, "theater"):
        number = movie.slots.index(slot)
        for is_kind, kind in ((has_rates, rates), (~has_rates, {})):
            said = torch.stack([s["meant_informs"][is_kind, number] for s in states[1:]])
            heard = torch.stack([s["user_informs"][is_kind, number] for s in states[1:]])
            hit = (said != heard)[said != NONE].double()
            prob = kind.get(slot, 0.2)
            if mode == "value":  # one of the slot's values may be the same
                values = simulator.domain.error_values[number].tolist()
                same = [values.count(value) > 0 for value in said[said != NONE].tolist()]
                prob *= 1 - sum(same) / len(same) / int(simulator.domain.error_count[number])
            assert hit.numel() > 50
            bound = 4.5 * (prob * (1 - prob) / hit.numel()) ** 0.5 + 1e-9
            assert abs(hit.mean().item() - prob) <= bound


@pytest.mark.parametrize(
    ("users", "message"),
    [
        ("folks", "users .*'folks'"),
        ([], r"users .*\[\]"),
        ([3], r"users\[0\] .*3"),
        ({"patient": 3}, r"users\[0\]\.patient .*patience"),
        ({"patience": [0, 3]}, r"users\[0\]\.patience .*\[0, 3\]"),
        ({"bears": [4, 3]}, r"users\[0\]\.bears .*\[4, 3\]"),
        ({"tells": 2}, r"users\[0\]\.tells .*2"),
        ([{"share": 0.5}, {"share": 0.6}], r"users .*1\.1"),
        ([{"share": 1}, {"share": 0}], r"users\[1\]\.share .*0"),
        ({"slot_error_prob": {"date": 1.1}}, "slot_error_prob .*'date'"),
        *(({habit: 1.5}, rf"users\[0\]\.{habit} .*1") for habit in HABITS),
    ],
)
def test_invalid_users_are_refused(users, message):
    with pytest.raises(ValueError, match=message):
        profiles_of(users)


def test_error_rates_need_a_slot_of_the_domain_and_an_error_model(movie):
    users = profiles_of({"slot_error_prob": {"daet": 0.1}})
    with pytest.raises(ValueError, match=r"users\[0\]\.slot_error_prob .*'daet'"):
        check_slots(users, movie.slots)
    with pytest.raises(ValueError, match="slot_error_prob"):
        Simulator(
            tensorize(movie),
            users={"slot_error_prob": {"date": 0.1}},
            errors=load_errors(movie),
        )
