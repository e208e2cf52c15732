"""``env=full``: dialogues with simulated users."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, ClassVar

from bbq_torchrl.options import ConfigError, EnvOption, register
from bbq_torchrl.options.settings import (
    BOOLEAN,
    PROBABILITY,
    REWARD,
    integers,
    one_of,
    option,
    optional,
    setting,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    import torch
    from tensordict.nn import TensorDictModuleBase
    from torchrl.envs import EnvBase

    from bbq_torchrl.domains import Domain
    from bbq_torchrl.envs import DialogueEnv, ExtensionSchedule
    from bbq_torchrl.options import Config
    from bbq_torchrl.simulator import Channel


@register
@dataclass
class FullDomain(EnvOption):
    """All slots from the start."""

    name: str = option("full")
    slot_error_prob: float | None = setting(
        None,
        optional(PROBABILITY, "the domain's calibrated difficulty"),
        "probability that an informed slot is hit by an error",
    )
    slot_error_mode: str = setting(
        "value", one_of("value", "slot", "delete", "mixed"), "what an error does to a slot"
    )
    intent_error_prob: float = setting(0.0, PROBABILITY, "probability of a random user act")
    level: str = setting(
        "act",
        one_of("act", "text"),
        "what users speak: dialogue acts, or sentences that are understood, for evaluation only",
    )
    errors: str = setting(
        "drawn",
        one_of("drawn", "measured"),
        "of dialogue acts: drawn with the probabilities above, or as counted where users spoke in "
        "sentences",
    )
    ask_below: float | None = setting(
        None,
        optional(PROBABILITY, "the understanding's own, .75"),
        "with level=text: confidence below which the system asks a user again; 0: never",
    )
    max_turn: int = setting(40, integers(2, 1_000), "turns of a dialogue, both sides counted")
    success_reward: float = setting(40.0, REWARD, "reward of a dialogue that succeeds")
    failure_reward: float = setting(-10.0, REWARD, "reward of a dialogue that fails")
    turn_reward: float = setting(-1.0, REWARD, "reward of a turn that does not end the dialogue")
    compile_turns: bool = setting(
        False, BOOLEAN, "turns are compiled by torch.compile, which takes up to a minute"
    )

    has_domain: ClassVar[bool] = True

    def check(self, config: Config) -> None:
        """Refuses sentences in training, and errors of two kinds."""
        self._check_errors()
        if self.level == "text":
            raise ConfigError(
                "env.level must be act in training, got 'text': sentences are too slow for it; "
                "env.errors=measured has the errors that were counted at that level"
            )

    def _check_errors(self) -> None:
        """Refuses keys of errors that would not be used.

        Raises:
            ConfigError: with the first of them.
        """
        is_text = self.level == "text"
        if is_text and self.errors != "drawn":
            raise ConfigError(
                f"env.errors must be drawn with env.level=text, whose errors are those of "
                f"sentences, got {self.errors!r}"
            )
        if is_text and self.compile_turns:
            raise ConfigError("env.compile_turns must be false with env.level=text, got true")
        if not is_text and self.ask_below is not None:
            raise ConfigError(
                f"env.ask_below must be null with env.level=act, where there are no sentences to "
                f"ask about, got {self.ask_below}"
            )
        if not is_text and self.errors == "drawn":
            return
        source = "env.level=text" if is_text else "env.errors=measured"
        default = {item.name: item.default for item in fields(self)}
        for key in ("slot_error_prob", "slot_error_mode", "intent_error_prob"):
            if getattr(self, key) != default[key]:
                raise ConfigError(
                    f"env.{key} must be {'null' if default[key] is None else default[key]} with "
                    f"{source}, which has errors of its own, got {getattr(self, key)}"
                )

    def _channel(self, domain: Domain) -> Channel | None:
        """Returns what lies between user and tracker; None: errors as they are drawn.

        Raises:
            ConfigError: the domain or the installation has not what it takes.
        """
        self._check_errors()
        try:
            if self.level == "text":
                from bbq_torchrl.envs.text import text_channel

                return text_channel(domain, self.ask_below)
        except ModuleNotFoundError as error:
            raise ConfigError(f"env.level=text cannot be played: {error}") from error
        if self.errors == "drawn":
            return None
        from bbq_torchrl.envs.measured import load_errors

        try:
            return load_errors(domain)
        except ValueError as error:
            raise ConfigError(str(error)) from error

    def check_domain(self, domain: Domain | None) -> None:
        """Refuses errors that were not counted for the domain."""
        assert domain is not None
        self._channel(domain)

    def steps(self) -> int:
        """The acts of both sides are counted by ``max_turn``; the agent has one act more."""
        return self.max_turn // 2 + 1

    def policies(self, domain: Domain | None) -> tuple[str, ...]:
        """Those of the domain."""
        assert domain is not None
        return tuple(domain.policies)

    def references(self, domain: Domain | None) -> tuple[str, ...]:
        """The one that knows the user's goal."""
        from bbq_torchrl.domains.validate import PRIVILEGED_POLICY

        return (PRIVILEGED_POLICY,)

    def make_policy(self, name: str, env: EnvBase) -> TensorDictModuleBase:
        """A policy of the domain, ``clairvoyant``, or ``random``."""
        from bbq_torchrl.envs import scripted_policy

        return scripted_policy(name, env)

    def schedule(self) -> ExtensionSchedule | None:
        """Says which slots there are in which round; None: all of them, always."""
        return None

    def make(
        self,
        domain: Domain | None,
        batch_size: Sequence[int],
        *,
        seed: int = 0,
        device: torch.device | str = "cpu",
    ) -> DialogueEnv:
        """Makes the environment with a batch of dialogues, such as [replicas, dialogues]."""
        from bbq_torchrl.envs import DialogueEnv

        assert domain is not None
        return DialogueEnv(
            domain,
            batch_size=tuple(batch_size),
            slot_error_prob=self.slot_error_prob,
            slot_error_mode=self.slot_error_mode,  # type: ignore[arg-type]
            intent_error_prob=self.intent_error_prob,
            max_turn=self.max_turn,
            success_reward=self.success_reward,
            failure_reward=self.failure_reward,
            turn_reward=self.turn_reward,
            schedule=self.schedule(),
            seed=seed,
            device=device,
            compile_turns=self.compile_turns,
            channel=self._channel(domain),
        )
