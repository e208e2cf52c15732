"""Configurations as ``compose`` makes them, without composing the same options again."""

from __future__ import annotations

import copy
import functools
import shutil

from bbq_torchrl.cli import store
from bbq_torchrl.cli.store import compose_raw, conf_folder, session, to_config
from bbq_torchrl.options import Config, schemas


@functools.cache
def composed(*choices):
    with session():
        return compose_raw(choices)


def checked(command):
    """The configuration of a command line as ``compose`` makes it, its options composed once.

    Only the reading of the keys is another: that is what takes long, and has tests of its own.
    """
    given = command.split()
    choices = [item for item in given if item.partition("=")[0] in schemas()]
    raw = copy.deepcopy(composed(*choices))
    raw.merge_with_dotlist([item for item in given if item not in choices])
    return to_config(raw, Config)


def own_conf(tmp_path, monkeypatch):
    """A copy of the configuration folder that takes its place."""
    conf = tmp_path / "conf"
    shutil.copytree(conf_folder(), conf)
    monkeypatch.setattr(store, "conf_folder", lambda: conf)
    return conf
