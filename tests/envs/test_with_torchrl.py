"""The environment with TorchRL's environments, transforms, collectors and saved states."""

from functools import partial

import pytest
import torch
from tensordict import TensorDict
from torchrl.collectors import Collector
from torchrl.envs import Compose, InitTracker, SerialEnv, StepCounter, TransformedEnv

from bbq_torchrl.envs import DialogueEnv, EnvState, UniformPolicy, scripted_policy


@pytest.mark.parametrize(("batch_size", "last"), [((6,), ()), ((2, 3), (1,))])
def test_dialogues_that_wait_stay_as_they_are_and_the_others_play_on(restaurant, batch_size, last):
    which = torch.tensor([True, False, True, False, False, True]).view(batch_size)
    settings = {"batch_size": batch_size, "slot_error_prob": 0.5, "intent_error_prob": 0.5}
    env, whole = (DialogueEnv(restaurant, seed=0, **settings) for _ in range(2))
    for one in (env, whole):
        told = one.reset()
        torch.manual_seed(0)
        for _ in range(2):
            told = one.rand_step(told)["next"]
    before, state = told.clone(), env.dialogues.clone()
    action = torch.full(batch_size, restaurant.action_index("request(area)"))
    step = TensorDict(action=action, batch_size=batch_size)
    after = env.step(step.clone().set("_step", which.view(*batch_size, *last)))["next"]
    expected = whole.step(step)["next"]

    waits = ~which
    assert (env.dialogues[waits].exclude("reward") == state[waits].exclude("reward")).all()
    assert (env.dialogues[which] == whole.dialogues[which]).all()
    assert (after[which] == expected[which]).all()
    assert (after[waits].exclude("reward") == before[waits].exclude("reward")).all()
    assert (after["reward"][waits] == 0).all()


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


def around_serial(restaurant, seed):
    made = partial(DialogueEnv, restaurant, batch_size=(6,))
    return TransformedEnv(SerialEnv(2, [partial(made, seed=seed + n) for n in (0, 1)]), EnvState())


@pytest.mark.parametrize("make", [transformed, around_serial])
def test_dialogues_go_on_where_they_were_saved(restaurant, make, tmp_path):
    one, other = make(restaurant, 0), make(restaurant, 7)
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
    seen = ("observation", "action_mask", "goal_id", "turns", "success", "done")
    keys = (*seen, "action", *(("next", key) for key in (*seen, "reward")))
    assert (found.select(*keys) == expected.select(*keys)).all()
    for each in (one, other):
        each.shutdown()


def test_what_cannot_be_resumed_is_refused(restaurant):
    env = DialogueEnv(restaurant, batch_size=(2,), seed=0)
    settings = {"frames_per_batch": 20, "auto_register_policy_transforms": False}
    collector = Collector(env, UniformPolicy(), total_frames=-1, **settings)
    with pytest.raises(ValueError, match="EnvState"):
        collector.load_state_dict(collector.state_dict())
    collector.shutdown()
    env = DialogueEnv(restaurant, batch_size=(2,), seed=0)
    ends = env.reset().set("action", torch.tensor([0, restaurant.action_index("thanks")]))
    env.step(ends)
    with pytest.raises(ValueError, match="resume=True"):
        env.reset(resume=True)
