"""The simulator beyond the oracle: features, draws, batch shapes, compilation, settings."""

from dataclasses import replace

import pytest
import torch

from bbq_torchrl.domains import tensorize
from bbq_torchrl.domains.tensors import index_below
from bbq_torchrl.simulator import ErrorModel, FeatureLayout, KnowledgeBase, Rewards, Simulator


def simulator_of(domain, errors=None, users="paper"):
    tensors = tensorize(domain)
    return Simulator(tensors, errors=errors or ErrorModel(tensors, 0.3, "mixed", 0.2), users=users)


def play(simulator, shape, turns=12):
    """Plays random actions. Returns the last state, and action and draws for the next turn."""
    generator = torch.Generator().manual_seed(3)
    active = torch.ones(simulator.domain.n_slots, dtype=torch.bool)
    state = simulator.reset(simulator.draw_reset(shape, generator), active)
    for turn in range(turns + 1):
        action = torch.randint(simulator.domain.n_actions, shape, generator=generator)
        draws = simulator.draw_turn(shape, generator)
        if turn < turns:
            state = simulator.turn(state, action, draws, active)
    return state, action, draws, active


@pytest.mark.parametrize("shape", [(), (1,), (2, 1, 4), (0,)])
@pytest.mark.parametrize("users", ["paper", "people"])
def test_a_batch_of_any_shape_plays_as_the_flat_one(restaurant, shape, users):
    simulator = simulator_of(restaurant, users=users)
    count = torch.Size(shape).numel()
    for turns in (0, 12):
        state, *_, active = play(simulator, shape, turns)
        flat, *_ = play(simulator, (count,), turns)
        assert state.batch_size == torch.Size(shape)
        assert (state.reshape(count) == flat).all()
        features = simulator.observe(state, active)
        assert features.shape == (*shape, simulator.layout.size)
        assert torch.equal(features.flatten(), simulator.observe(flat, active).flatten())


def test_a_turn_leaves_state_action_and_draws_as_they_were(movie):
    simulator = simulator_of(movie)
    given = play(simulator, (40,), 5)
    copies = [one.clone() for one in given]
    simulator.turn(*given)
    assert all((now == before).all() for now, before in zip(given, copies, strict=True))


def test_draws_are_uniform(movie):
    simulator = simulator_of(movie)
    turn = simulator.draw_turn((2, 2_000), torch.Generator().manual_seed(0))
    for value in (*simulator.draw_reset((2, 2_000)).values(), *turn.values()):
        assert (value.dtype, value.shape[:2]) == (torch.float32, (2, 2_000))
        assert 0 <= value.min() <= value.max() < 1
        # The mean of n uniform numbers has the standard deviation 1 / sqrt(12 n).
        assert abs(value.double().mean() - 0.5) < 5 / (12 * value.numel()) ** 0.5


def test_the_largest_number_never_reaches_the_count():
    largest = torch.tensor(1 - 2**-24)
    counts = torch.tensor([1, 3, 7, 1_000, 2**24 + 1])
    assert (index_below(largest, counts) < counts).all()
    assert index_below(largest, 0) == 0


def test_memory_grows_with_the_records_and_not_with_their_square(movie):
    def words(times):
        larger = KnowledgeBase(replace(domain, records=domain.records.repeat(times, 1)))
        return larger.sets.numel() + larger.ordered_sets.numel()

    domain = tensorize(movie)
    assert words(4) < 5 * words(1)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda domain: Simulator(domain, max_turn=1), "max_turn .* 1"),
        (lambda domain: ErrorModel(domain, 1.5), r"slot_error_prob .* 1\.5"),
        (lambda domain: ErrorModel(domain, 0.1, "typo"), "slot_error_mode .*'typo'"),
        (lambda domain: ErrorModel(domain, intent_error_prob=-0.1), r"intent_error_prob .* -0\.1"),
        (lambda _: Rewards(success=float("nan")), "success .* nan"),
    ],
)
def test_settings_out_of_range_are_refused(restaurant, make, message):
    with pytest.raises(ValueError, match=message):
        make(tensorize(restaurant))


def test_the_layout_of_the_movies_has_the_papers_268_features(movie):
    layout = FeatureLayout(tensorize(movie))
    assert layout.size == len({*layout.names}) == 268
    members = [(group, member) for group, names in layout.groups.items() for member in names]
    assert [layout.column(*member) for member in members] == list(range(268))
    assert layout.names == tuple(":".join(member) for member in members)
