"""Domains and environments from their configuration."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bbq_torchrl.config.worlds import (
    DomainConfig,
    DomainExtensionConfig,
    EnvConfig,
    FolderDomainConfig,
    MiuLabDomainConfig,
)
from bbq_torchrl.domains import Domain, load_domain, load_miulab, movie_domain
from bbq_torchrl.envs import DialogueEnv, ExtensionSchedule

if TYPE_CHECKING:
    from collections.abc import Sequence

    import torch

__all__ = ["build_domain", "build_env", "build_schedule"]


def build_domain(config: DomainConfig) -> Domain:
    """Loads the domain.

    Raises:
        ValueError or OSError: the corpus is damaged or not there.
    """
    if isinstance(config, MiuLabDomainConfig):
        return load_miulab(
            config.path,
            goals=config.goals,
            kb=config.kb,
            values=config.values,
            skip_unusable=config.skip_unusable,
        )
    if isinstance(config, FolderDomainConfig):
        return load_domain(config.path)
    return movie_domain()


def build_schedule(config: DomainExtensionConfig) -> ExtensionSchedule:
    """Says which slots there are in which round."""
    return ExtensionSchedule(start=config.start, every=config.every)


def build_env(
    config: EnvConfig,
    domain: Domain,
    batch_size: Sequence[int],
    *,
    seed: int = 0,
    device: torch.device | str = "cpu",
) -> DialogueEnv:
    """Makes the environment with a batch of dialogues, such as [replicas, dialogues]."""
    schedule = build_schedule(config) if isinstance(config, DomainExtensionConfig) else None
    return DialogueEnv(
        domain,
        batch_size=tuple(batch_size),
        slot_error_prob=config.slot_error_prob,
        slot_error_mode=config.slot_error_mode,  # type: ignore[arg-type]
        intent_error_prob=config.intent_error_prob,
        max_turn=config.max_turn,
        success_reward=config.success_reward,
        failure_reward=config.failure_reward,
        turn_reward=config.turn_reward,
        schedule=schedule,
        seed=seed,
        device=device,
        compile_turns=config.compile_turns,
    )
