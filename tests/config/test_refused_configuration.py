"""What is refused before anything runs, each in one sentence."""

from __future__ import annotations

import pytest
from composing import checked

from bbq_torchrl.cli.store import compose
from bbq_torchrl.options import ConfigError, EvaluateConfig

REFUSED = {  # as it is read
    "agent=nope": "agent must be one of bbqn, bootstrap, dqn, got 'nope'",
    "explore=nope": "explore must be one of",
    "env=nope": "env must be one of domain_ext, full",
    "+experiment=nope": "experiment must be one of",
    "experiment=quick": "experiment is added with a plus: write +experiment=quick",
    "+agent=dqn": "+agent=dqn cannot be read: a group is chosen without a plus",
    "agent=bbqn,dqn": "dqn, got 'bbqn,dqn'; several options need --multirun",
    "seed=1,2": "seed=1,2 has several values: add --multirun",
    "seed=range(0,3)": "seed=range(0,3) has several values: add --multirun",
    "spike.name=none": "spike.name must be 'rule', got 'none': choose by spike=none",
    "~agent": "agent must be given",
    "~agent.lr": "~agent.lr cannot be read: no key can be removed",
    "agent.lr": "'agent.lr' cannot be read: write key=value",
    "+agent.nope=1": "agent.nope is not a key; the keys of agent=bbqn are name, hidden, lr",
    "+nope=1": "nope is not a key; the keys of the configuration are agent, explore, intrinsic",
    "agent.priorstd=1": "did you mean agent.prior_std",
    "nope=1": "nope is not a key",
    "seed=abc": "seed must be an integer from 0 to 2**63 - 1, got 'abc'",
    "agent.lr=abc": "lr must be a number from 1e-30 to 1e30 (or a list, one for",
    "agent={lr:1}": "agent must be one of bbqn, bootstrap, dqn, got '{lr:1}'",
    "agent.lr=${nope}": "agent.lr=${nope} cannot be resolved: Interpolation key 'nope' not found",
    "agent.hidden=[8,${nope}]": "agent.hidden[1]=${nope} cannot be resolved",
    "agent.lr=${agent.lr}": "agent.lr=${agent.lr} cannot be resolved: Recursive interpolation",
    "agent.hidden={a:1}": "agent.hidden must be a list of up to 10 integers from 1 to 10000",
    "+seed=1": "'+seed' cannot be read: a key that there is already goes without a plus",
    "=1": "'=1' cannot be read",
    "domain=miulab": "domain.path must be given",
    "domain=movie domain.path=x": "domain.path is not a key; the keys of domain=movie are name",
    "spike=none spike.dialogues=5": "spike.dialogues must be 0, or be given with spike=rule, got 5",
    "env=domain_ext agent.kl=sampled": "agent.kl must be closed",
    "agent=dqn agent.prior_std=.1": "agent.prior_std is not a key",
    "agent.lr=.1,.2": "add --multirun to run them all, or put them in brackets for the replicas",
    "replicas=2 agent.target=[map,mc]": "agent.target must be one of map, mc, got '[map,mc]'",
    "intrinsic.eta=1": "intrinsic.eta is not a key; the keys of intrinsic=none are name",
}


REFUSED_VALUES = {  # as it is checked
    "agent.name=dqn": "agent.name must be 'bbqn', got 'dqn': choose by agent=dqn",
    "agent.hidden=[10000000000]": "integers from 1 to 10000, such as [256,256], got [10000000000]",
    "protocol={rounds:3}": "protocol must be one of paper, quick, got '{rounds:3}'",
    "agent.prior_std=wide": "(or a list, one for each replica) or 'fan_in', got 'wide'",
    "protocol.capacity=8": "protocol.capacity must be at least protocol.batch_size",
    "domain=folder domain.path=''": "domain.path must be a text, got ''",
    "spike.drop_above=.5 spike.protect=false": "spike.drop_above cannot be combined",
    "agent=dqn agent.noisy=true agent.dropout=.5": "agent.dropout must be 0",
    "agent=dqn explore=noisy": "agent.noisy must be true",
    "agent.target_noise=shared": "agent.target_noise must be mean with agent.target=map, got",
    "agent.target=mc agent.target_noise=mean": "agent.target_noise must be independent or shared",
    "agent=bootstrap agent.trunk_layers=3": "agent.trunk_layers must be at most the 2 layers",
    "agent.prior_std=[.1,.2]": "agent.prior_std must be one value or a list of 1 (one for each of",
    "replicas=4 agent.lr=[.1,.2,.3]": "or of a number that divides 4, got 3: [0.1, 0.2, 0.3]",
    "replicas=2 agent.lr=[.1,-1]": "lr must be a number from 1e-30 to 1e30 (or a list, one for",
    "replicas=2 agent.prior_std=[.1,fan_in]": "agent.prior_std must be a number from 1e-15 to 1e15",
    "agent=dqn explore.eps_init=.005": "explore.eps_init must be at least explore.eps_end (0.01)",
    "agent=dqn replicas=2 explore.eps_end=[.1,.2]": "explore.eps_init must be at least explore.eps",
}


LONG = {
    "deep": "agent.hidden=" + "[" * 3000 + "]" * 3000,
    "a number of 400 digits": f"env.success_reward={'9' * 400}",
    "a number of 5000 digits": f"seed={'9' * 5000}",
    "a value": f"agent.mean_init={'x' * 100_000}",
    "a key": f"{'x' * 100_000}=1",
    "no key": "x" * 100_000,
}


@pytest.mark.parametrize("override", LONG.values(), ids=LONG)
def test_what_is_very_long_or_deep_is_refused_in_a_line_that_is_not(override):
    with pytest.raises(ConfigError) as refused:
        compose([override])
    message = str(refused.value)
    assert override[:10] in message
    assert len(message) < 600
    assert "\n" not in message


@pytest.mark.parametrize("command", REFUSED)
def test_what_cannot_be_run_is_refused_in_one_sentence(command):
    with pytest.raises(ConfigError) as refused:
        compose(command.split())
    message = str(refused.value)
    assert REFUSED[command] in message
    assert "\n" not in message.strip()


@pytest.mark.parametrize("command", REFUSED_VALUES)
def test_a_value_that_cannot_be_run_is_refused_in_one_sentence(command):
    with pytest.raises(ConfigError) as refused:
        checked(command)
    message = str(refused.value)
    assert REFUSED_VALUES[command] in message
    assert "\n" not in message.strip()


REFUSED_EVALUATIONS = {
    "dialogues=5": "policy must be given, as policy=<value>",
    "policy=rule seed=1,2": "seed=1,2 has several values: each key has one value in this command",
    "policy=rule env=full,domain_ext": "got 'full,domain_ext'; each key has one value in this",
    "policy=rule dialogues=0": "dialogues must be an integer from 1 to 10000000, got 0",
    "policy=rule weights=first": "weights must be one of last, best, got 'first'",
    "policy=rule agent=dqn": "agent is not a key; the keys of the configuration are env, domain",
    "policy=rule env.priorstd=1": "env.priorstd is not a key; the keys of env=full are name",
    "policy=rule +experiment=quick": "experiment is for training only",
}


@pytest.mark.parametrize("command", REFUSED_EVALUATIONS)
def test_an_evaluation_that_cannot_run_is_refused_in_one_sentence(command):
    with pytest.raises(ConfigError) as refused:
        compose(command.split(), EvaluateConfig)
    assert REFUSED_EVALUATIONS[command] in str(refused.value)
    assert "\n" not in str(refused.value)


COSTLY = ["protocol.rounds=30", "protocol.dialogues=50", "protocol.batch_size=32"]


COSTLY += ["protocol.capacity=640", "protocol.freezes=1", "protocol.epochs=2", "env.max_turn=38"]


@pytest.mark.parametrize(
    ("choices", "cost", "a_round"),
    [
        # 20 steps of 200 + 3,000 dialogues; a round: 20 steps of 200 + 50, 40 updates of 200 + 32.
        (["protocol.eval_batch=3000"], 64_000, 14_280),
        # Three replicas of 3,000, 800 at a time: four times 20 steps.
        (["protocol.eval_batch=2400", "replicas=3"], 208_000, 18_840),
    ],
)
def test_evaluations_that_take_longer_than_training_are_refused_with_the_numbers(
    choices, cost, a_round
):
    choices = [*COSTLY, *choices, "protocol.eval_every_dialogues=3000"]
    enough = -(-cost // a_round)
    compose([*choices, f"protocol.eval_every={enough}"])
    with pytest.raises(ConfigError) as refused:
        compose([*choices, f"protocol.eval_every={enough - 1}"])
    message = str(refused.value)
    assert f"must be 0 or at least {enough} with protocol.eval_every_dialogues=3000" in message
    assert f"got {enough - 1}: an evaluation would" in message
    assert f"({cost:,} against {(enough - 1) * a_round:,}, where" in message


@pytest.mark.parametrize(
    "choices",
    [
        ["protocol.eval_every=0"],  # never
        ["protocol.eval_every=31"],  # not in this training
    ],
)
def test_an_evaluation_that_never_is_costs_nothing(choices):
    compose([*COSTLY, *choices, "protocol.eval_every_dialogues=100000"])
