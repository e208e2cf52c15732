"""The same dialogues in any batch, on any device, compiled or not."""

from __future__ import annotations

import pytest
import torch

from bbq_torchrl.domains import tensorize
from bbq_torchrl.envs.measured import load_errors
from bbq_torchrl.simulator import ErrorModel, Simulator
from bbq_torchrl.simulator.choices import index_below, one_of, pick_slot


def simulator_of(domain):
    tensors = tensorize(domain)
    errors = ErrorModel(tensors, 0.3, "mixed", intent_error_prob=0.2)
    return Simulator(tensors, errors=errors)


def all_active(simulator):
    return torch.ones(simulator.domain.n_slots, dtype=torch.bool, device=simulator.device)


def play(simulator, shape, turns, generator, start=None):
    """Plays random actions. Returns states and features of all turns."""
    active = all_active(simulator)
    state = start
    if state is None:
        state = simulator.reset(simulator.draw_reset(shape, generator), active)
    states, features = [state], [simulator.observe(state, active)]
    for _ in range(turns):
        action = torch.randint(simulator.domain.n_actions, shape, generator=generator)
        state = simulator.turn(state, action, simulator.draw_turn(shape, generator), active)
        states.append(state)
        features.append(simulator.observe(state, active))
    return states, features


@pytest.mark.parametrize("domain_name", ["movie", "restaurant"])
@pytest.mark.parametrize("shape", [(), (1,), (3, 5), (2, 1, 4), (0,)])
def test_a_batch_of_any_shape_plays_as_the_flat_one(domain_name, shape, request):
    simulator = simulator_of(request.getfixturevalue(domain_name))
    count = torch.Size(shape).numel()
    shaped = play(simulator, shape, 12, torch.Generator().manual_seed(3))
    flat = play(simulator, (count,), 12, torch.Generator().manual_seed(3))
    for one, other in zip(shaped[0], flat[0], strict=True):
        assert one.batch_size == torch.Size(shape)
        assert (one.reshape(count) == other).all()
    for one, other in zip(shaped[1], flat[1], strict=True):
        assert one.shape == (*shape, simulator.layout.size)
        assert torch.equal(one.reshape(other.shape), other)


def test_a_turn_leaves_state_action_and_draws_as_they_were(movie):
    simulator = simulator_of(movie)
    generator = torch.Generator().manual_seed(7)
    (*_, state), _ = play(simulator, (40,), 5, generator)
    action = torch.randint(simulator.domain.n_actions, (40,), generator=generator)
    draws = simulator.draw_turn((40,), generator)
    copies = state.clone(), action.clone(), draws.clone()
    simulator.turn(state, action, draws, all_active(simulator))
    for now, before in zip((state, action, draws), copies, strict=True):
        assert (now == before).all()


def test_draws_are_uniform_and_named_as_documented(movie):
    simulator = simulator_of(movie)
    n_slots = simulator.domain.n_slots
    reset = simulator.draw_reset((2, 3))
    assert {key: tuple(value.shape) for key, value in reset.items()} == {
        "goal": (2, 3),
        "constraint": (2, 3, n_slots),
        "request": (2, 3, n_slots),
    }
    draws = simulator.draw_turn((4_000,), torch.Generator().manual_seed(0))
    per_slot = {"agenda", "error", "error_kind", "error_slot", "error_value"}
    assert set(draws.keys()) == per_slot | {"intent", "intent_act", "offer"}
    for key, value in draws.items():
        assert value.dtype == torch.float32
        assert value.shape == ((4_000, n_slots) if key in per_slot else (4_000,))
        assert value.min() >= 0
        assert value.max() < 1
        # The mean of n uniform numbers has the standard deviation 1 / sqrt(12 n).
        assert abs(value.double().mean() - 0.5) < 5 / (12 * value.numel()) ** 0.5


@pytest.mark.parametrize("mode", ["mixed", "measured"])
def test_a_turn_compiles_without_a_graph_break(movie, mode):
    simulator = simulator_of(movie)
    if mode == "measured":
        simulator = Simulator(simulator.domain, errors=load_errors(movie))
    active = all_active(simulator)

    def turn_and_observe(state, action, draws):
        state = simulator.turn(state, action, draws, active)
        return state, simulator.observe(state, active)

    # The backend "eager" traces all of it and generates no code.
    torch._dynamo.reset()
    compiled = torch.compile(turn_and_observe, fullgraph=True, backend="eager", dynamic=False)
    generator = torch.Generator().manual_seed(2)
    (*_, state), _ = play(simulator, (6,), 3, generator)
    action = torch.randint(simulator.domain.n_actions, (6,), generator=generator)
    draws = simulator.draw_turn((6,), generator)
    one, other = compiled(state, action, draws), turn_and_observe(state, action, draws)
    assert (one[0] == other[0]).all()
    assert torch.equal(one[1], other[1])


def test_a_choice_of_none_chooses_nothing():
    empty = torch.zeros(4, dtype=torch.bool)
    assert not pick_slot(empty, torch.rand(4)).any()
    assert int(index_below(torch.tensor(0.99), 0)) == 0
    assert not one_of(torch.tensor(-1), 4).any()


def test_the_largest_number_never_reaches_the_count():
    largest = torch.tensor(1 - 2**-24)
    counts = torch.tensor([1, 3, 7, 1_000, 2**24 + 1])
    assert (index_below(largest, counts) < counts).all()


def test_equal_numbers_choose_the_lowest_slot():
    pool = torch.tensor([False, True, True, False, True])
    for number in (0.0, 0.5):
        assert pick_slot(pool, torch.full((5,), number)).tolist() == [False, True, *[False] * 3]
