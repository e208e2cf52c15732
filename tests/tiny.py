"""Trainings of a second or two: their overrides, and what their tables are compared by."""

import copy
import csv
import importlib.util
from contextlib import ExitStack, contextmanager, suppress
from functools import cache

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from omegaconf import OmegaConf, open_dict
from omegaconf.errors import OmegaConfBaseException

from bbq_torchrl.options import Config, schemas
from bbq_torchrl.options.registry import EXPERIMENT, options_folder
from bbq_torchrl.runs.compose import compose_raw, key_of, session, to_config
from bbq_torchrl.runs.prepare import final_config, prepare_run

TINY = (
    "protocol.rounds=2",
    "protocol.dialogues=4",
    "protocol.capacity=200",
    "protocol.eval_dialogues=6",
    "protocol.eval_batch=6",
    "protocol.eval_every=1",
    "protocol.eval_every_dialogues=4",
    "protocol.checkpoint_every=1",
    "protocol.keep_checkpoints=last",
    "spike.dialogues=4",
    "spike.policy=careful",  # chosen: in so few turns it never succeeds
    "agent.hidden=[8,8]",
    "env.max_turn=8",
    "domain=hotel",  # small: to make an environment of the movies takes as long as all else
)
"""A key given again after these replaces theirs."""


@cache
def _of_options(chosen, root, known):
    """Hydra's composition of options alone, of those that are known."""
    with session():
        config = compose_raw(chosen, root)
    with open_dict(config):
        del config["hydra"]
    return config


_parsed = cache(lambda item: OverridesParser.create().parse_override(item))


def composed_raw(overrides, root=Config):
    """Does what ``compose_raw`` does, but has Hydra compose the same options once in a process.

    Values of keys are then set in a copy. All else goes the whole way, errors too.
    """
    groups = (*schemas(), EXPERIMENT)
    chosen = tuple(item for item in overrides if key_of(item) in groups)
    known = tuple(schema for options in schemas().values() for schema in options.values())
    items = [_parsed(item) for item in overrides if item not in chosen and _is_value(item)]
    if options_folder() is None and len(items) + len(chosen) == len(overrides):
        config = copy.deepcopy(_of_options(chosen, root, known))
        with suppress(OmegaConfBaseException):
            for item in items:
                OmegaConf.update(config, item.key_or_group, item.value())
            return config
    with session():
        return compose_raw(overrides, root)


@cache
def _is_value(item):
    """Returns whether an override only sets a key."""
    try:
        override = _parsed(item)
    except HydraException:
        return False
    is_one = override.package is None and not override.is_sweep_override()
    return is_one and not (override.is_add() or override.is_force_add() or override.is_delete())


def composed(*overrides):
    """The configuration of a command line."""
    return to_config(composed_raw(overrides), Config)


def prepared(*overrides):
    """The configuration of a run, and Hydra's part with the name of its folder."""
    with ExitStack() as locks, session():
        composed = compose_raw(overrides)
        return prepare_run(composed, locks), composed.hydra


def resumed(folder, *overrides):
    """The configuration that ``train.py resume=<folder>`` trains with."""
    return final_config(composed_raw([f"resume={folder}", *overrides]), overrides)


@contextmanager
def without_drawing():
    """Within it curves are empty files, and no scripted policy is played beside the agent.

    Either takes as long as a short training.
    """
    others = {"scripted": {"random": 0.5}, "references": {}}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("bbq_torchrl.runs.final._others", lambda *_: others)
        patch.setattr("bbq_torchrl.runs.final.draw_run", lambda file, *_, **__: file.touch())
        yield


def needs(package, extra):
    """Skips the test where the package of an extra is not installed."""
    if importlib.util.find_spec(package) is None:
        pytest.skip(f"needs the extra {extra}: pip install -e '.[{extra}]'")


def nightly(names, daily):
    """Parameters of which all but the daily ones are slow."""
    return [one if one in daily else pytest.param(one, marks=pytest.mark.slow) for one in names]


def rows(file):
    """The rows of a table such as metrics.csv, without their times."""
    with file.open(newline="") as stream:
        return [
            {name: value for name, value in row.items() if not name.startswith("seconds")}
            for row in csv.DictReader(stream)
        ]
