"""The default of a key equals that of the part's argument it sets."""

from __future__ import annotations

import ast
import textwrap
from dataclasses import MISSING, fields
from importlib import import_module
from inspect import Parameter, getsource, isclass, signature

import pytest

from bbq_torchrl.bayes import BayesLayer
from bbq_torchrl.options import schemas

ON_PURPOSE = {
    ("BayesMLP", "std_init"): "searched for dialogues; in short loops .09 is noise for too long",
    ("BootstrapMLP", "prior_scale"): "searched for dialogues; 0 is the paper's network",
    ("BootstrapMask", "prob"): "searched for dialogues; .5 is the paper's bootstrap",
    ("Boltzmann", "annealing_num_steps"): "the key is a share of the rounds of a training",
    ("ReplicaAdam", "lr"): "the key follows protocol.lr",
    ("ThompsonSampling", "shared"): "None depends on per, and is false for the default of that",
    ("GaussianProcess", "prior_std"): "null depends on the features",
    ("GPLoss", "noise_std"): "null depends on the features",
    ("GPLoss", "sweeps"): "null depends on the features",
    ("DynamicsLoss", "every"): "at every batch, VIME would more than double the time of DQN",
}
"""(part, argument) -> why its default differs from the key's."""


def arguments(part):
    """The arguments of a part by name: first those it declares, then those it passes on."""
    functions = [kind.__init__ for kind in (*part.__mro__, BayesLayer)] if isclass(part) else [part]
    found = {}
    for function in functions:
        for name, argument in signature(function).parameters.items():
            found.setdefault(name, argument)
    found.pop("self", None)
    return found


def calls(option):
    """Each call of an import of ours in the methods of an option: (import, call)."""
    ours = [cls for cls in option.__mro__ if cls.__module__.startswith("bbq_torchrl.options")]
    for method in (part for cls in ours for part in _parsed(cls).body):
        nodes = list(ast.walk(method))
        parts = {
            name.name: getattr(import_module(node.module), name.name)
            for node in nodes
            if isinstance(node, ast.ImportFrom) and node.module.startswith("bbq_torchrl.")
            for name in node.names
        }
        for node in nodes:
            if isinstance(node, ast.Call) and getattr(node.func, "id", None) in parts:
                yield parts[node.func.id], node


def _parsed(cls):
    return ast.parse(textwrap.dedent(getsource(cls))).body[0]


def pairs():
    """Each key that is an argument with a default: (key, default, part, argument, default).

    An argument belongs to a key if it has the key's name, or if ``self.<key>`` is in its value.
    """
    found = {}
    for group, known in schemas().items():
        for option in known.values():
            keys = {
                item.name: item.default_factory() if item.default is MISSING else item.default
                for item in fields(option)
            }
            for part, call in calls(option):
                takes = arguments(part)
                given = [*zip(takes, call.args, strict=False)]
                given += [(keyword.arg, keyword.value) for keyword in call.keywords]
                for name, value in given:
                    inside = [getattr(node, "attr", "") for node in ast.walk(value)]
                    key = next((word for word in (name, *inside) if word in keys), None)
                    default = takes[name].default
                    if key is None or default is Parameter.empty:
                        continue
                    row = (f"{group}.{key}", keys[key], part.__name__, name, default)
                    found[str(row)] = row
    return list(found.values())


PAIRS = pairs()


@pytest.mark.parametrize(("key", "ours", "part", "argument", "its"), PAIRS)
def test_a_key_has_the_default_of_its_argument_unless_there_is_a_reason(
    key, ours, part, argument, its
):
    is_same = ours == (list(its) if isinstance(its, tuple) else its)
    assert is_same != ((part, argument) in ON_PURPOSE)


def test_every_reason_is_of_an_argument_that_there_is():
    assert set(ON_PURPOSE) <= {(part, argument) for _, _, part, argument, _ in PAIRS}
