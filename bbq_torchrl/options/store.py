"""Hydra's configuration store: the roots, and the schema of every option.

``conf/<group>/<option>.yaml`` has the keys of an option of ours with their defaults, and includes
its schema, which has their types; ``scripts/write_docs.py`` writes these files. An option of your
own needs no file.
"""

from __future__ import annotations

from typing import Any

from hydra.core.config_store import ConfigStore

from bbq_torchrl.options.registry import Option, conf_folder, schemas
from bbq_torchrl.options.root import CalibrateConfig, Config, EvaluateConfig

ROOTS = {Config: "config", EvaluateConfig: "evaluate", CalibrateConfig: "calibrate"}
"""Schema of a root -> its YAML file."""

_stored: set[type] = set()


def register_options() -> None:
    """Registers the roots and all options with Hydra."""
    store = ConfigStore.instance()
    for root, name in ROOTS.items():
        store.store(name=f"_{name}", node=root)
    for group, known in schemas().items():
        for name, option in known.items():
            if option in _stored:
                continue
            _stored.add(option)
            store.store(name=f"_{group}_{name}", node=option)
            if not (conf_folder() / group / f"{name}.yaml").is_file():
                store.store(group=group, name=name, node={"defaults": defaults(option)})


def defaults(option: type[Option]) -> list[Any]:
    """Returns the defaults list of an option: its schema, and an agent's default strategy."""
    schema = f"/_{option.group}_{option.name}@_here_"
    chosen = getattr(option, "explores_by", None)
    own = [{"override /explore@_global_.explore": chosen}] if chosen else []
    return [schema, *own, "_self_"]
