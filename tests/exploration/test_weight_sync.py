"""Syncing an actor's weights into its policies as TorchRL's trainers and collectors do."""

import pytest
import torch
from q_actor import bayes_actor, heads_actor, noisy_actor, observations, values
from tensordict import TensorDict
from torch import nn

from bbq_torchrl.exploration import (
    BootstrapSampling,
    EvaluationPolicy,
    Greedy,
    MajorityVote,
    NoisySampling,
    ThompsonSampling,
)

POLICIES = {
    "greedy": (bayes_actor, Greedy),
    "vote": (heads_actor, MajorityVote),
    "heads": (heads_actor, lambda actor: BootstrapSampling(actor, per="round")),
    "noisy": (noisy_actor, NoisySampling),
    **{
        f"thompson {per}": (bayes_actor, lambda actor, per=per: ThompsonSampling(actor, per=per))
        for per in ("step", "episode", "round")
    },
    **{
        f"evaluation {mode}": (
            bayes_actor,
            lambda actor, mode=mode: EvaluationPolicy(actor, mode=mode),
        )
        for mode in ("mean", "average", "draw", "thompson")
    },
}
made = pytest.mark.parametrize(("make", "wrap"), POLICIES.values(), ids=POLICIES)


def weights(module: nn.Module) -> TensorDict:
    """Copies of a module's weights by name."""
    return TensorDict.from_module(module).data.clone()


@made
def test_a_policy_names_its_weights_as_its_actor_does(make, wrap):
    actor = make((2,))
    policy = wrap(actor)
    assert [*policy.state_dict()] == [*actor.state_dict()]
    names = [name for name, _ in actor.named_parameters()]
    assert [name for name, _ in policy.named_parameters()] == names
    ours, theirs = (TensorDict.from_module(module) for module in (policy, actor))
    assert set(ours.keys(True, True)) == set(theirs.keys(True, True))


def test_a_policy_and_its_actor_train_and_evaluate_together():
    policy = Greedy(bayes_actor())
    policy.eval()
    assert not policy.actor.training
    assert policy.train().actor.training


@pytest.mark.parametrize("name", ["thompson round", "evaluation average", "evaluation draw"])
@pytest.mark.parametrize(
    "change",
    [
        lambda actor, new: TensorDict.from_module(actor).data.update_(new),
        lambda actor, new: new.to_module(actor),
    ],
    ids=["in place", "replaced"],
)
def test_draws_of_weights_that_were_synced_are_made_anew(name, change):
    make, wrap = POLICIES[name]
    actor, td = make(), observations(6)
    policy = wrap(actor)
    first = values(policy, td)
    assert torch.equal(values(policy, td), first)
    new = weights(actor).apply(lambda weight: weight + 1e-3)
    change(policy, new)
    second = values(policy, td)
    assert not (second == first).any()
    assert torch.equal(values(policy, td), second)


def test_heads_of_a_round_are_drawn_anew_once_weights_were_synced():
    policy, td = BootstrapSampling(heads_actor(heads=1000), per="round"), observations(40)
    values(policy, td)
    heads = policy.heads
    values(policy, td)
    assert torch.equal(policy.heads, heads)
    TensorDict.from_module(policy).data.apply_(lambda weight: weight.mul_(1.01))
    values(policy, td)
    assert (policy.heads != heads).sum() > 30


def test_an_episode_under_way_keeps_its_draw_while_weights_are_learned():
    policy, td = ThompsonSampling(bayes_actor(), per="episode"), observations(6)
    first = values(policy, td)
    TensorDict.from_module(policy).data.apply_(lambda weight: weight.add_(1.0))
    assert torch.equal(values(policy, td), first)
    td["is_init"] = ~td["is_init"]
    assert not (values(policy, td) == first).any()
