"""Checks beyond the configuration: device, corpus, scripted policy and checkpoint."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import torch

from bbq_torchrl.runs.build import make_domain, spike_policy
from bbq_torchrl.runs.resume import config_fingerprint, result_of
from bbq_torchrl.settings import ConfigError
from bbq_torchrl.trainers import (
    CheckpointDamagedError,
    CheckpointFolder,
    derive_seed,
    rollouts,
)
from bbq_torchrl.utils.files import CHECKPOINTS, METRICS, RESULT
from bbq_torchrl.utils.text import shown

if TYPE_CHECKING:
    from bbq_torchrl.domains import Domain
    from bbq_torchrl.options import Config


class Checked(NamedTuple):
    """A checked configuration, and the parts loaded for the checks, which the run reuses.

    Attributes:
        config: the configuration.
        domain: the domain; None if the environment has no domain.
        spiking: the scripted policy of the spike; None without a spike.
    """

    config: Config
    domain: Domain | None
    spiking: str | None


def check(config: Config) -> Checked:
    """Checks device, logger, corpus, scripted policy and checkpoint before anything runs.

    Raises:
        ConfigError: the device is absent, the logger cannot be used here, the domain lacks the
            scripted policy, or the spike would fill the replay buffer.
        TrainingError: the run to resume has no usable checkpoint.
        ValueError or OSError: the corpus is damaged or missing, or the spike cannot be played in
            the first round.
    """
    check_device(config.device)
    config.logger.check_ready()
    domain = make_domain(config)
    spike, policies = config.spike, config.env.policies(domain)
    if spike.dialogues and not policies:
        raise ConfigError(
            f"spike must be none with env={config.env.name}, where there are no scripted "
            f"policies, got {spike.name!r}"
        )
    if spike.policy not in (None, *policies):
        raise ConfigError(
            f"spike.policy must be one of {', '.join(policies)} or null, got {shown(spike.policy)}"
        )
    config.env.check_domain(domain)
    spiking = spike_policy(config, domain) if spike.dialogues else None
    if spiking is not None:
        _check_spike(config, domain, spiking)
    if config.resume is not None:
        _check_resumable(Path(config.resume), config)
    return Checked(config, domain, spiking)


def _check_resumable(folder: Path, config: Config) -> None:
    """Raises CheckpointDamagedError if a run has started but has no checkpoint to continue from."""
    if result_of(folder, config.protocol.rounds) is not None:
        return  # only the curve may be missing
    found = CheckpointFolder(folder / CHECKPOINTS).check(config_fingerprint(config), "replay")
    if not found and any((folder / name).exists() for name in (METRICS, RESULT)):
        raise CheckpointDamagedError.gone(folder)


def _check_spike(config: Config, domain: Domain | None, name: str) -> None:
    """Refuses a policy that needs a slot added later, and a capacity that the spike would fill.

    Dialogues are played if the number of their transitions cannot be bounded otherwise.
    """
    spike, capacity = config.spike, config.protocol.capacity
    if config.env.extends:
        config.env.make_policy(name, config.env.make(domain, (1,)))
    if spike.dialogues * config.env.steps() < capacity:
        return
    count, seed = spike.dialogues, config.seed
    if count < capacity:
        env = config.env.make(
            domain, (config.replicas, config.protocol.dialogues), device=config.device
        )
        torch.manual_seed(derive_seed(seed, "torch", "spike", 0))
        env.set_seed(derive_seed(seed, "env", "spike", 0))
        policy, steps = config.env.make_policy(name, env), config.env.steps()
        played = rollouts(env, policy, spike.dialogues, max_steps=steps)
        count = sum(int(rollout["valid"].sum((-2, -1)).max()) for rollout in played)
    if count >= capacity:
        raise ConfigError(
            f"protocol.capacity must be more than the transitions of spike.dialogues="
            f"{spike.dialogues}, which are at least {count}, got {capacity}"
        )


def check_device(device: str) -> None:
    """Raises ConfigError if a device is absent."""
    if device.startswith("cuda"):
        found = torch.cuda.device_count()
        if int(device.partition(":")[2] or 0) >= found:
            raise ConfigError(f"device={device} is absent: {found} CUDA devices found; use cpu")
