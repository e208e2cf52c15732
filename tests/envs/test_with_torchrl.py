"""The environment with TorchRL's vectorized environments, transforms and partial steps."""

from functools import partial

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import (
    ConditionalSkip,
    ParallelEnv,
    SerialEnv,
    TransformedEnv,
    check_env_specs,
)

from bbq_torchrl.envs import DialogueEnv, ExtensionSchedule, UniformPolicy, scripted_policy


@pytest.mark.parametrize(
    "vectorized",
    [
        SerialEnv,
        pytest.param(partial(ParallelEnv, mp_start_method="spawn"), marks=pytest.mark.slow),
    ],
    ids=["serial", "parallel"],
)
def test_several_environments_play_side_by_side(movie, vectorized):
    schedule = ExtensionSchedule(start=1, every=1)
    env = vectorized(2, partial(DialogueEnv, movie, batch_size=(4,), schedule=schedule))
    try:
        env.set_seed(0)
        check_env_specs(env)
        # Their spec has no mask, so a policy is needed that reads it.
        rollout = env.rollout(12, UniformPolicy(), break_when_any_done=False)
    finally:
        env.close()
    assert rollout.shape == (2, 4, 12)
    assert rollout["action_mask"].gather(-1, rollout["action"][..., None]).all()
    assert not torch.equal(rollout["goal_id"][0], rollout["goal_id"][1])
    done = rollout["next", "done"].squeeze(-1)[..., :-1]
    assert done.any()
    assert (rollout["turns"].squeeze(-1)[..., 1:][done] == 0).all()


def make(movie, batch_size, seed=0):
    return DialogueEnv(
        movie, batch_size=batch_size, seed=seed, slot_error_prob=0.5, intent_error_prob=0.5
    )


@pytest.mark.parametrize(("batch_size", "last"), [((6,), ()), ((2, 3), (1,))])
def test_dialogues_that_wait_stay_as_they_are_and_the_others_play_on(restaurant, batch_size, last):
    which = torch.tensor([True, False, True, False, False, True]).view(batch_size)
    env, whole = (make(restaurant, batch_size) for _ in range(2))
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


def test_a_transform_can_have_dialogues_wait(restaurant):
    def plays(td):
        return (td["turns"].squeeze(-1) == 2) & (td["goal_id"].squeeze(-1) % 2 == 0)

    env = TransformedEnv(make(restaurant, (40,)), ConditionalSkip(plays))
    rollout = env.rollout(6, scripted_policy("rule", env), break_when_any_done=False)
    even = rollout["goal_id"][:, 0, 0] % 2 == 0
    assert even.any()
    assert not even.all()
    turns = rollout["turns"].squeeze(-1)
    assert (turns[even] == torch.tensor([0, 1, 2, 2, 2, 2])).all()
    assert (turns[~even] == torch.arange(6)).all()
