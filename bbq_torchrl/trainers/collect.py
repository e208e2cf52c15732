"""Plays dialogues in parallel, each to its end, and stores them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, NamedTuple

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor, nn
from torchrl.envs.utils import ExplorationType, set_exploration_type

from bbq_torchrl.trainers.errors import TrainingError

if TYPE_CHECKING:
    from torchrl.envs import EnvBase

    from bbq_torchrl.data import ReplicaReplay

Policy = Callable[[TensorDictBase], TensorDictBase]


class EpisodeStats(NamedTuple):
    """Statistics of dialogues, one entry for each, shape [*batch].

    Attributes:
        success: whether the dialogue succeeded (bool).
        reward: the sum of its rewards (float64).
        turns: the number of turns that the agent took (int64).
    """

    success: Tensor
    reward: Tensor
    turns: Tensor


@torch.no_grad()
def rollout(
    env: EnvBase,
    policy: Policy,
    *,
    max_steps: int = 1000,
    exploration: ExplorationType = ExplorationType.RANDOM,
) -> TensorDictBase:
    """Plays one dialogue in every place of the environment's batch, each to its end.

    Returns the rollout, batch size [*batch, turns], with the entry ``valid`` [*batch, turns]: a
    dialogue that is over waits for the last one, and what it repeats meanwhile is not valid. The
    policy finds ``is_init`` [*batch, 1], True in the first turn (as of ``InitTracker``). Every
    dialogue that begins is played to its end, so there is no bias towards short ones. The policy
    plays in evaluation mode (no dropout) and is given back in the mode that it came in.

    Args:
        env: an environment whose last batch dimension is the dialogues.
        policy: writes an action.
        max_steps: the most turns of a dialogue. Defaults to 1000.
        exploration: what the policy finds as ``exploration_type()``. Defaults to
            ``ExplorationType.RANDOM``.

    Raises:
        RuntimeError: if a dialogue is not over after ``max_steps`` turns.
    """
    was_training = isinstance(policy, nn.Module) and policy.training
    if isinstance(policy, nn.Module):
        policy.eval()
    try:
        with set_exploration_type(exploration):
            played = env.rollout(
                max_steps,
                _marking_the_first_turn(policy),
                break_when_any_done=False,
                break_when_all_done=True,
                trust_policy=True,
            )
    finally:
        if isinstance(policy, nn.Module):
            policy.train(was_training)
    done = played["next", "done"].squeeze(-1)
    if not bool(done[..., -1].all()):
        raise RuntimeError(f"every dialogue must be over after max_steps = {max_steps} turns")
    return played.set("valid", (done.cumsum(-1) - done.long()) == 0)


def _marking_the_first_turn(policy: Policy) -> Policy:
    """Returns a policy that marks the first turn of a rollout, without the cost of a transform."""
    is_first = True

    def act(tensordict: TensorDictBase) -> TensorDictBase:
        nonlocal is_first
        shape = (*tensordict.batch_size, 1)
        marks = torch.full(shape, is_first, dtype=torch.bool, device=tensordict.device)
        is_first = False
        return policy(tensordict.set("is_init", marks))

    return act


def rollouts(
    env: EnvBase,
    policy: Policy,
    dialogues: int,
    *,
    max_steps: int = 1000,
    exploration: ExplorationType = ExplorationType.RANDOM,
) -> Iterator[TensorDictBase]:
    """Yields rollouts as :func:`rollout` does until every replica has played its dialogues.

    Args:
        env: batch size [*replicas, places]; each rollout fills all places.
        policy: writes an action.
        dialogues: how many dialogues each replica plays. Of the last rollout, only as many
            dialogues are kept as are missing: the first places, whatever their lengths.
        max_steps: the most turns of a dialogue. Defaults to 1000.
        exploration: what the policy finds as ``exploration_type()``.
    """
    places = env.batch_size[-1]
    for begun in range(0, dialogues, places):
        played = rollout(env, policy, max_steps=max_steps, exploration=exploration)
        yield played[..., : min(places, dialogues - begun), :]


def episode_stats(rollout: TensorDictBase) -> EpisodeStats:
    """Returns how the dialogues of a rollout of :func:`rollout` went, each entry of shape [*batch].

    Args:
        rollout: batch size [*batch, turns], with ``valid``, and whether the dialogue is a success
            so far under ``("next", "success")``.

    Raises:
        TrainingError: if it does not say so.
    """
    valid = rollout["valid"]
    after = rollout["next"]
    success = after.get("success", None)
    if success is None:
        raise TrainingError(
            "the environment must write ('next', 'success'), which says that an episode has ended "
            "well"
        )
    success = success.squeeze(-1) & valid
    reward = after["reward"].squeeze(-1).double() * valid
    return EpisodeStats(success.any(-1), reward.sum(-1), valid.sum(-1))


def rows_per_replica(rollout: TensorDictBase, keys: tuple[NestedKey, ...]) -> list[TensorDictBase]:
    """Returns each replica's valid transitions, dialogue after dialogue: batch sizes [rows].

    Args:
        rollout: batch size [replicas, dialogues, turns], with ``valid``.
        keys: the entries to keep.
    """
    valid = rollout["valid"]
    counts = valid.sum((-2, -1)).tolist()
    return list(rollout.select(*keys)[valid].split(counts))


def collect_dialogues(
    replay: ReplicaReplay,
    env: EnvBase,
    policy: Policy,
    dialogues: int,
    *,
    max_steps: int,
) -> dict[str, Tensor]:
    """Plays dialogues and stores them. Returns their mean statistics by metric, [replicas] each.

    With them are the metrics that the replay's transform noted of these transitions.

    Args:
        replay: the buffers.
        env: batch size [replicas, places].
        policy: writes an action.
        dialogues: how many dialogues each replica plays.
        max_steps: the most turns of a dialogue.
    """
    totals: Tensor | None = None
    for played in rollouts(env, policy, dialogues, max_steps=max_steps):
        result = episode_stats(played)
        sums = torch.stack([entry.double().sum(-1) for entry in result])
        totals = sums if totals is None else totals + sums
        replay.extend(rows_per_replica(played, replay.keys))
    assert totals is not None
    means = dict(zip(("success_rate", "reward", "turns"), totals / dialogues, strict=True))
    return {**means, **replay.pop_metrics()}
