"""Acting on one head at a time, and by the vote of all."""

import pytest
import torch
from hypothesis import given, strategies as st
from q_actor import ACTIONS, FEATURES, SPEC, heads_actor, observations
from scipy.stats import chisquare
from tensordict import TensorDict
from torchrl.data import Categorical
from torchrl.envs.utils import ExplorationType, set_exploration_type

from bbq_torchrl.exploration import BootstrapSampling, EvaluationPolicy, Greedy, MajorityVote
from bbq_torchrl.networks import BootstrapMLP, bootstrap_actor
from bbq_torchrl.networks.bootstrap import VoteModule

RANDOM, DETERMINISTIC = ExplorationType.RANDOM, ExplorationType.DETERMINISTIC
HEADS = 7


def heads_used(policy, td):
    """The head that each row acted on."""
    policy(td.clone())
    return policy.heads


# -- the vote ------------------------------------------------------------------------------


def winner(values, mask):
    """The vote of one state in plain Python; values[k][a]."""
    legal = [a for a, may in enumerate(mask) if may]
    votes = dict.fromkeys(legal, 0)
    for of_head in values:
        best = max(of_head[a] for a in legal)
        votes[next(a for a in legal if of_head[a] == best)] += 1
    most = max(votes.values())
    tied = [a for a in legal if votes[a] == most]
    total = {a: sum(of_head[a] for of_head in values) for a in tied}
    return next(a for a in tied if total[a] == max(total.values()))


@given(st.data(), st.integers(1, 5), st.integers(1, 4))
def test_the_vote_is_the_one_of_a_plain_count(data, heads, actions):
    # few different numbers, exact in floating point, so that ties of all kinds are common
    row = st.lists(st.integers(-2, 2), min_size=actions, max_size=actions)
    values = data.draw(st.lists(row, min_size=heads, max_size=heads))
    may = st.lists(st.booleans(), min_size=actions, max_size=actions)
    mask = data.draw(may.filter(any))
    td = TensorDict(head_value=torch.tensor([values]).float(), action_mask=torch.tensor([mask]))
    td = VoteModule(Categorical(actions))(td.auto_batch_size_(1))
    expected = winner(values, mask)
    assert td["action"].tolist() == [expected]
    mean = torch.tensor(values).float().mean(0)
    least = torch.finfo(torch.float).min
    assert torch.equal(td["action_value"][0], mean.masked_fill(~torch.tensor(mask), least))
    assert torch.equal(td["chosen_action_value"][0], mean[expected : expected + 1])


@pytest.mark.parametrize("exploration", [RANDOM, DETERMINISTIC, None])
@pytest.mark.parametrize("replicas", [(), (3,)])
def test_the_vote_is_what_the_actor_greedy_and_the_evaluation_do(exploration, replicas):
    actor = heads_actor(replicas)
    td = observations(*replicas, 50, same=False)
    everywhere = [actor, MajorityVote(actor), Greedy(actor), EvaluationPolicy(actor)]
    if exploration is DETERMINISTIC:
        everywhere.append(BootstrapSampling(actor))
    with set_exploration_type(exploration):
        outs = [policy(td.clone()) for policy in everywhere]
    for out in outs[1:]:
        for key in ("action", "action_value", "chosen_action_value"):
            assert torch.equal(out[key], outs[0][key])


# -- one head ------------------------------------------------------------------------------


@pytest.mark.parametrize("redrawn", ["first", "at the beginning", "every step"])
def test_heads_are_uniform_and_independent_between_rows_and_dialogues(redrawn):
    n = 20_000
    policy = BootstrapSampling(heads_actor(), per="step" if redrawn == "every step" else "episode")
    td = observations(n)
    before = heads_used(policy, td)
    if redrawn == "at the beginning":
        td["is_init"] = torch.ones(n, 1, dtype=torch.bool)
    elif redrawn == "first":
        policy.resample()
    drawn = heads_used(policy, td)
    for pairs in (drawn[:, None], torch.stack([before, drawn], -1), drawn.reshape(-1, 2)):
        codes = (pairs * HEADS ** torch.arange(pairs.shape[-1])).sum(-1)
        counts = torch.bincount(codes, minlength=HEADS ** pairs.shape[-1])
        assert chisquare(counts.numpy()).pvalue > 1e-7


def test_it_acts_greedily_on_its_head_among_legal_actions():
    actor, td = heads_actor(), observations(60, same=False)
    policy = BootstrapSampling(actor)
    out = policy(td.clone())
    values = actor(td.clone())["head_value"][torch.arange(60), policy.heads]
    values = values.masked_fill(~td["action_mask"], torch.finfo(torch.float).min)
    assert torch.equal(out["action"], values.argmax(-1))
    assert torch.equal(out["chosen_action_value"][:, 0], values.amax(-1))
    torch.testing.assert_close(out["action_value"], values)


# -- both ----------------------------------------------------------------------------------


@pytest.mark.parametrize("policy", [MajorityVote, BootstrapSampling, Greedy])
def test_a_missing_mask_is_an_error_and_not_that_all_is_legal(policy):
    td = observations(2).exclude("action_mask")
    with pytest.raises(KeyError, match=r"'action_mask' is missing.*action_mask_key=None"):
        policy(heads_actor())(td)
    all_legal = bootstrap_actor(BootstrapMLP(FEATURES, ACTIONS), SPEC, action_mask_key=None)
    assert policy(all_legal)(td)["action"].shape == (2,)


def test_what_they_read_and_write():
    keys = {"action_key": ("act", "a"), "action_value_key": ("act", "q")}
    net = BootstrapMLP(FEATURES, ACTIONS, heads=2)
    actor = bootstrap_actor(net, SPEC, in_keys=["see"], action_mask_key="may", **keys)
    td = observations(4).rename_key_("observation", "see").rename_key_("action_mask", "may")
    for policy in (MajorityVote(actor), BootstrapSampling(actor)):
        assert set(policy.in_keys) - {"is_init"} == {"see", "may"}
        assert policy.out_keys == [("act", "a"), ("act", "q"), "chosen_action_value"]
        assert isinstance(policy.spec["act", "a"], Categorical)
        out = policy(td.clone())
        assert set(out.keys(True, True)) == {"see", "may", "is_init", *policy.out_keys}
    assert set(actor(td.clone()).keys(True, True)) == {"head_value", *out.keys(True, True)}
    assert set(actor.out_keys) == {"head_value", *policy.out_keys}
