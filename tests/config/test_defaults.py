"""The default of a key equals that of the part's argument it sets."""

from dataclasses import MISSING, fields
from inspect import Parameter, signature

import pytest

from bbq_torchrl import (
    bayes,
    data,
    domains,
    envs,
    exploration,
    networks,
    objectives,
    trainers,
    vime,
)
from bbq_torchrl.networks.gaussian_process import StateFeatures
from bbq_torchrl.options import agent, env, explore, protocol

PARTS = {
    agent.BBQN: (bayes.BayesMLP, objectives.BBQNLoss, exploration.EvaluationPolicy),
    agent.Bootstrap: (networks.BootstrapMLP, objectives.BootstrapDQNLoss, data.BootstrapMask),
    agent.GP: (StateFeatures, networks.GaussianProcess, objectives.GPLoss),
    agent.DQN: (networks.FlatMLP, objectives.DropoutDQNLoss, trainers.ReplicaAdam),
    explore.BoltzmannActing: (exploration.Boltzmann,),
    explore.Thompson: (exploration.ThompsonSampling,),
    explore.BootstrapActing: (exploration.BootstrapSampling,),
    explore.NoisyActing: (exploration.NoisySampling,),
    explore.VIME: (vime.DynamicsModel, vime.VIMEReward, vime.DynamicsLoss),
    env.FullDomain: (envs.DialogueEnv,),
    env.DomainExtension: (envs.DialogueEnv, envs.ExtensionSchedule),
    env.MiuLabDomain: (domains.load_miulab,),
    protocol.RuleSpike: (trainers.Spike,),
}
"""Option -> the parts that its keys are arguments of."""

OTHER_NAMES = {"double": "double_dqn", "mask_prob": "prob", "evaluate_draws": "num_draws"}
"""Key -> the argument's name."""

ON_PURPOSE = {
    ("BayesMLP", "std_init"): "searched for dialogues; in short loops .09 is noise for too long",
    ("BayesMLP", "prior_std"): "searched for dialogues; by fan-in for other networks",
    ("BootstrapMLP", "prior_scale"): "searched for dialogues; 0 is the paper's network",
    ("BootstrapMask", "prob"): "searched for dialogues; .5 is the paper's bootstrap",
    ("ReplicaAdam", "lr"): "the key follows protocol.lr",
    ("ThompsonSampling", "shared"): "None depends on per, and is false for the default of that",
    ("GaussianProcess", "prior_std"): "chosen for inducing states",
}
"""(part, argument) -> why its default differs from the key's."""


def arguments(part):
    """The arguments of a part by name: first those it declares, then those it passes on."""
    functions = [kind.__init__ for kind in part.__mro__] if isinstance(part, type) else [part]
    found = {}
    for function in functions:
        for name, argument in signature(function).parameters.items():
            found.setdefault(name, argument)
    return found


def pairs():
    """Each key that is an argument with a default: (key, default, part, argument, default)."""
    for option, parts in PARTS.items():
        for item in fields(option):
            ours = item.default if item.default_factory is MISSING else item.default_factory()
            name = OTHER_NAMES.get(item.name, item.name)
            for part in parts:
                argument = arguments(part).get(name)
                if argument is not None and argument.default is not Parameter.empty:
                    yield f"{option.group}.{item.name}", ours, part.__name__, name, argument.default


@pytest.mark.parametrize(("key", "ours", "part", "argument", "its"), list(pairs()))
def test_a_key_has_the_default_of_its_argument_unless_there_is_a_reason(
    key, ours, part, argument, its
):
    is_same = ours == (list(its) if isinstance(its, tuple) else its)
    assert is_same != ((part, argument) in ON_PURPOSE)


def test_every_reason_is_of_an_argument_that_there_is():
    assert set(ON_PURPOSE) <= {(part, argument) for _, _, part, argument, _ in pairs()}
