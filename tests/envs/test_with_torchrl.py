"""The environment with TorchRL's collectors, vectorized environments and transforms."""

from functools import partial

import pytest
import torch
from torchrl.envs import (
    ParallelEnv,
    SerialEnv,
    check_env_specs,
)

from bbq_torchrl.envs import DialogueEnv, ExtensionSchedule, UniformPolicy


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
