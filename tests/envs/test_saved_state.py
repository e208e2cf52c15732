"""The state of environments in what TorchRL saves, and the dialogues after loading it."""

from functools import partial

import pytest
import torch
from torchrl.collectors import Collector
from torchrl.envs import (
    Compose,
    InitTracker,
    ParallelEnv,
    SerialEnv,
    StepCounter,
    TransformedEnv,
)

from bbq_torchrl.envs import DialogueEnv, EnvState, UniformPolicy, scripted_policy


def transformed(restaurant, seed=None):
    base = DialogueEnv(restaurant, batch_size=(6,), seed=seed)
    return TransformedEnv(base, Compose(StepCounter(), EnvState(), InitTracker()))


def saved(state, tmp_path):
    torch.save(state, tmp_path / "state.pt")
    return torch.load(tmp_path / "state.pt", weights_only=True)


def played(env, told, turns=30):
    """Returns the observations of a number of turns, with actions from a seed."""
    torch.manual_seed(0)
    found = []
    for _ in range(turns):
        step, told = env.step_and_maybe_reset(env.rand_action(told))
        found.append(step["next"].select("observation", "reward", "done", "goal_id", "turns"))
    return torch.stack(found)


def two(make, restaurant, seed):
    return [partial(make, restaurant, seed=seed + number) for number in range(2)]


ENVIRONMENTS = {
    "transformed": transformed,
    "serial": lambda restaurant, seed: SerialEnv(2, two(transformed, restaurant, seed)),
    "around serial": lambda restaurant, seed: TransformedEnv(
        SerialEnv(2, two(partial(DialogueEnv, batch_size=(6,)), restaurant, seed)), EnvState()
    ),
    "parallel": lambda restaurant, seed: ParallelEnv(
        2, two(transformed, restaurant, seed), mp_start_method="spawn", use_buffers=False
    ),
}


@pytest.mark.parametrize(
    "make",
    [
        pytest.param(
            make, id=name, marks=pytest.mark.slow if name in ("parallel", "serial") else ()
        )
        for name, make in ENVIRONMENTS.items()
    ],
)
def test_dialogues_go_on_where_they_were_saved(restaurant, make, tmp_path):
    one, other = make(restaurant, 0), make(restaurant, 7)
    try:
        told = one.reset()
        for _ in range(3):
            told = one.step_and_maybe_reset(one.rand_action(told))[1]
        state = saved(one.state_dict(), tmp_path)
        other.reset()
        other.load_state_dict(state)
        resumed = other.reset(resume=True)
        for key in ("observation", "turns", "goal_id"):
            assert torch.equal(resumed[key], told[key])
        assert (played(other, resumed) == played(one, told)).all()
    finally:
        for env in (one, other):
            env.close()


def test_a_collector_goes_on_where_it_was_saved(restaurant, tmp_path):
    def collector(seed):
        env = transformed(restaurant, seed)
        policy = scripted_policy("careful", env)
        return Collector(env, policy, frames_per_batch=60, total_frames=-1)

    one, other = collector(0), collector(7)
    batches = iter(one)
    next(batches)
    state = saved(one.state_dict(), tmp_path)
    expected = next(batches)
    other.load_state_dict(state)
    other.reset(resume=True)
    found = next(iter(other))
    for part in ((), ("next",)):
        for key in ("observation", "action_mask", "goal_id", "turns", "success", "done"):
            assert torch.equal(found[(*part, key)], expected[(*part, key)])
    assert torch.equal(found["action"], expected["action"])
    assert torch.equal(found["next", "reward"], expected["next", "reward"])
    for each in (one, other):
        each.shutdown()


def test_outside_of_an_environment_there_is_nothing_to_save():
    state = EnvState().state_dict()
    EnvState().load_state_dict(state)


def test_what_cannot_be_resumed_is_refused(restaurant):
    env = DialogueEnv(restaurant, batch_size=(2,), seed=0)
    collector = Collector(
        env,
        UniformPolicy(),
        frames_per_batch=20,
        total_frames=-1,
        auto_register_policy_transforms=False,
    )
    with pytest.raises(ValueError, match="EnvState"):
        collector.load_state_dict(collector.state_dict())
    collector.shutdown()
    env = DialogueEnv(restaurant, batch_size=(2,), seed=0)
    with pytest.raises(RuntimeError, match=r"call reset\(\) first"):
        env.reset(resume=True)
    ends = env.reset().set("action", torch.tensor([0, restaurant.action_index("thanks")]))
    env.step(ends)
    with pytest.raises(ValueError, match="resume=True"):
        env.reset(resume=True)
