"""Whether what a configuration asks for can be held: an estimate, before anything is made.

The estimates are of what grows with a key, in the worst case (every dialogue lasts as long as it
may). They are there to refuse what is far too large by name; what is a little too large still fails
when it is made.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, NamedTuple

import torch

from bbq_torchrl.options import ConfigError

if TYPE_CHECKING:
    from collections.abc import Iterable

    from bbq_torchrl.domains import Domain
    from bbq_torchrl.options import CalibrateConfig, Config, EnvOption, EvaluateConfig

__all__ = ["Need", "check_memory", "device_memory", "evaluation_needs", "training_needs"]

_FLOAT = 4
_FLAGS = 16  # bytes of a transition besides observations and action masks
_NUMBERS = 100  # bytes of a dialogue's outcome, once more as Python's numbers


class Need(NamedTuple):
    """Something that takes memory.

    Attributes:
        what: it is.
        size: in bytes.
        keys: the keys it grows with, each with its value.
    """

    what: str
    size: int
    keys: dict[str, object]


def check_memory(needs: Iterable[Need], device: str) -> None:
    """Refuses what a device cannot hold.

    Raises:
        ConfigError: naming the keys of the largest need, what it takes, and what there is.
    """
    held, needs = device_memory(device), list(needs)
    if sum(need.size for need in needs) <= held:
        return
    most = max(needs, key=lambda need: need.size)
    keys = ", ".join(f"{key}={value}" for key, value in most.keys.items())
    raise ConfigError(
        f"{most.what} would take about {_gigabytes(most.size)} with {keys}, and device={device} "
        f"has {_gigabytes(held)}: at least one of these must be smaller"
    )


def device_memory(device: str) -> int:
    """The memory of a device, in bytes, whether it is in use or not."""
    if device.startswith("cuda"):
        return int(torch.cuda.get_device_properties(device).total_memory)
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def training_needs(config: Config, domain: Domain | None) -> list[Need]:
    """What a training and its final evaluation take."""
    features, actions = config.env.shape(domain)
    protocol, replicas = config.protocol, config.replicas
    transition = 2 * (_FLOAT * features + actions) + _FLAGS
    dialogues = max(
        protocol.eval_dialogues, protocol.eval_every_dialogues if protocol.eval_every else 0
    )
    evaluated = min(protocol.eval_batch, replicas * dialogues)
    return [
        # Stored, and once more in an epoch's order.
        Need(
            "the replay buffer",
            2 * replicas * protocol.capacity * transition,
            {"replicas": replicas, "protocol.capacity": protocol.capacity},
        ),
        _rollout(
            config.env,
            features,
            actions,
            replicas * protocol.dialogues,
            {"replicas": replicas, "protocol.dialogues": protocol.dialogues},
        ),
        _rollout(
            config.env,
            features,
            actions,
            evaluated,
            {"protocol.eval_batch": protocol.eval_batch},
        ),
        Need(
            "the outcomes of an evaluation",
            replicas * dialogues * _NUMBERS,
            {
                "replicas": replicas,
                "protocol.eval_dialogues": protocol.eval_dialogues,
                "protocol.eval_every_dialogues": protocol.eval_every_dialogues,
            },
        ),
        *(
            Need(
                what,
                _FLOAT * replicas * part.floats(features, actions),
                {"replicas": replicas, **part.sizes()},
            )
            for what, part in (
                ("the networks", config.agent),
                ("the model of the intrinsic reward", config.intrinsic),
            )
        ),
    ]


def evaluation_needs(
    config: EvaluateConfig | CalibrateConfig, domain: Domain | None, replicas: int
) -> list[Need]:
    """What an evaluation takes, its networks left out."""
    places = replicas * min(config.batch, config.dialogues)
    outcomes = replicas * config.dialogues * _NUMBERS
    return [
        _rollout(config.env, *config.env.shape(domain), places, {"batch": config.batch}),
        Need("the outcomes of dialogues", outcomes, {"dialogues": config.dialogues}),
    ]


def _rollout(
    env: EnvOption, features: int, actions: int, places: int, keys: dict[str, object]
) -> Need:
    """Dialogues side by side: all their turns, and once more where they are put together."""
    turn = 2 * (_FLOAT * features + actions) + _FLOAT * actions + _FLAGS
    turns = env.steps()
    return Need("dialogues side by side", 2 * places * turns * turn, {**keys, **env.sizes()})


def _gigabytes(size: int) -> str:
    return f"{max(1, round(size / 1e9)):,} GB"
