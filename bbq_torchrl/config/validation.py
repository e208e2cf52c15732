"""The checks that need more than one key, after every key has been checked alone."""

from __future__ import annotations

from bbq_torchrl.config.agents import BBQNConfig, BootstrapConfig, DQNConfig
from bbq_torchrl.config.evaluation_cost import check_evaluation
from bbq_torchrl.config.explorations import NoisyConfig
from bbq_torchrl.config.pairs import EXPLORATIONS
from bbq_torchrl.config.schema import CalibrateConfig, Config, EvaluateConfig
from bbq_torchrl.config.settings import ConfigError, check_settings
from bbq_torchrl.config.values import check_values
from bbq_torchrl.config.worlds import DomainExtensionConfig

__all__ = ["validate"]

TARGET_NOISE = {"map": ("mean",), "mc": ("independent", "shared")}
"""target -> the noise its weights can have, the default first."""


def validate(config: Config | EvaluateConfig | CalibrateConfig) -> None:
    """Refuses a configuration that cannot be run.

    Raises:
        ConfigError: one sentence that names the key, its value and what is allowed.
    """
    check_settings(config)
    if isinstance(config, Config):
        _check_pair(config)
        check_values(config)
        _check_noise(config)
        _check_trunk(config)
        _check_extension(config)
        _check_spike(config)
        _check_protocol(config)
        check_evaluation(config)


def _check_pair(config: Config) -> None:
    agent, explore = config.agent.name, config.explore.name
    allowed = EXPLORATIONS[agent]
    if explore not in allowed:
        raise ConfigError(
            f"agent={agent} cannot be combined with explore={explore}: "
            f"explore must be one of {', '.join(allowed)}"
        )


def _check_noise(config: Config) -> None:
    agent = config.agent
    if isinstance(agent, DQNConfig):
        if agent.noisy and agent.dropout:
            raise ConfigError(
                "agent.noisy=true cannot be combined with agent.dropout="
                f"{agent.dropout}: the noise takes its place, so agent.dropout must be 0"
            )
        if isinstance(config.explore, NoisyConfig) and not agent.noisy:
            raise ConfigError(
                "explore=noisy needs a network that has noise: agent.noisy must be true"
            )
    if isinstance(agent, BBQNConfig):
        allowed = TARGET_NOISE[agent.target]
        if agent.target_noise not in (None, *allowed):
            raise ConfigError(
                f"agent.target_noise must be {' or '.join(allowed)} with "
                f"agent.target={agent.target}, got {agent.target_noise!r}"
            )


def _check_extension(config: Config) -> None:
    if not isinstance(config.env, DomainExtensionConfig):
        return
    if isinstance(config.agent, BBQNConfig) and config.agent.kl == "sampled":
        raise ConfigError(
            "env=domain_ext cannot be combined with agent.kl=sampled: the sampled estimate moves "
            "the weights of slots that are not there yet, so agent.kl must be closed"
        )


def _check_trunk(config: Config) -> None:
    agent = config.agent
    if isinstance(agent, BootstrapConfig) and (agent.trunk_layers or 0) > len(agent.hidden):
        raise ConfigError(
            f"agent.trunk_layers must be at most the {len(agent.hidden)} layers of agent.hidden, "
            f"got {agent.trunk_layers}"
        )


def _check_spike(config: Config) -> None:
    spike = config.spike
    if spike.drop_above is not None and not spike.protect:
        raise ConfigError(
            "spike.drop_above cannot be combined with spike.protect=false: transitions that are "
            "not protected leave by themselves, so spike.drop_above must be null"
        )


def _check_protocol(config: Config) -> None:
    protocol = config.protocol
    if protocol.capacity < protocol.batch_size:
        raise ConfigError(
            f"protocol.capacity must be at least protocol.batch_size ({protocol.batch_size}), "
            f"got {protocol.capacity}"
        )
