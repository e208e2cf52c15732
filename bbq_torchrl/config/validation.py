"""The checks that need more than one key, after every key has been checked alone."""

from __future__ import annotations

from bbq_torchrl.config.pairs import EXPLORATIONS
from bbq_torchrl.config.schema import BBQNConfig, Config, DomainExtensionConfig, EvaluateConfig
from bbq_torchrl.config.settings import ConfigError, check_settings

__all__ = ["validate"]


def validate(config: Config | EvaluateConfig) -> None:
    """Refuses a configuration that cannot be run.

    Raises:
        ConfigError: one sentence that names the key, its value and what is allowed.
    """
    check_settings(config)
    if isinstance(config, Config):
        _check_pair(config)
        _check_extension(config)
        _check_spike(config)
        _check_protocol(config)


def _check_pair(config: Config) -> None:
    agent, explore = config.agent.name, config.explore.name
    allowed = EXPLORATIONS[agent]
    if explore not in allowed:
        raise ConfigError(
            f"agent={agent} cannot be combined with explore={explore}: "
            f"explore must be one of {', '.join(allowed)}"
        )


def _check_extension(config: Config) -> None:
    if not isinstance(config.env, DomainExtensionConfig):
        return
    if isinstance(config.agent, BBQNConfig) and config.agent.kl == "sampled":
        raise ConfigError(
            "env=domain_ext cannot be combined with agent.kl=sampled: the sampled estimate moves "
            "the weights of slots that are not there yet, so agent.kl must be closed"
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
