"""Hydra's configuration store: the roots and all options, by group and name."""

from __future__ import annotations

from hydra.core.config_store import ConfigStore

from bbq_torchrl.options.agent import AgentOption
from bbq_torchrl.options.registry import schemas
from bbq_torchrl.options.root import CalibrateConfig, Config, EvaluateConfig

ROOTS = {Config: "config", EvaluateConfig: "evaluate", CalibrateConfig: "calibrate"}
"""Schema of a root -> its YAML file."""

_registered: set[tuple[str, str]] = set()


def register_options() -> None:
    """Registers the roots and all options with Hydra."""
    store = ConfigStore.instance()
    for root, name in ROOTS.items():
        store.store(name=f"_{name}", node=root)
    for group, known in schemas().items():
        for name, option in known.items():
            if (group, name) in _registered:
                continue
            _registered.add((group, name))
            if not issubclass(option, AgentOption):
                store.store(group=group, name=name, node=option)
                continue
            # An agent chooses its default strategy.
            own = {"override /explore@_global_.explore": option.explores_by}
            store.store(group=group, name=f"_{name}", node=option)
            store.store(group=group, name=name, node={"defaults": [f"_{name}", own, "_self_"]})
