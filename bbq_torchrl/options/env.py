"""The options of ``env=``: simulated users, or another environment."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, ClassVar

from bbq_torchrl.options.registry import Option, register
from bbq_torchrl.options.settings import (
    BOOLEAN,
    COUNT,
    NON_NEGATIVE_INTEGER,
    PROBABILITY,
    REWARD,
    ConfigError,
    integers,
    one_of,
    option,
    optional,
    other_default,
    setting,
)
from bbq_torchrl.options.task import action_mask_key

if TYPE_CHECKING:
    from collections.abc import Sequence

    import torch
    from tensordict.nn import TensorDictModuleBase
    from torch import Tensor
    from torchrl.envs import EnvBase

    from bbq_torchrl.domains import Domain
    from bbq_torchrl.envs import DialogueEnv, ExtensionSchedule
    from bbq_torchrl.simulator import Channel


@dataclass
class EnvOption(Option):
    """An environment that the agent acts in.

    What it makes is an ``EnvBase`` of batch size [replicas, episodes] whose specs have
    ``observation`` (one dimension of floats), a categorical or one-hot ``action``, and
    ``action_mask`` if not all actions are always legal. It writes ``("next", "success")``, bool
    [replicas, episodes, 1], which says that an episode has ended well. Where it is a
    :class:`~bbq_torchrl.protocols.RoundEnv`, it enters every round.

    Attributes:
        has_domain: whether ``domain=`` is about it.
        extends: whether features or actions come into use only in later rounds.
    """

    group: ClassVar[str] = "env"

    paper_rounds: int = setting(400, COUNT, "rounds of training in the paper")

    has_domain: ClassVar[bool] = False
    extends: ClassVar[bool] = False

    @abstractmethod
    def make(
        self,
        domain: Domain | None,
        batch_size: Sequence[int],
        *,
        seed: int = 0,
        device: torch.device | str = "cpu",
    ) -> EnvBase:
        """Makes the environment.

        Args:
            domain: what the dialogues are about; None without :attr:`has_domain`.
            batch_size: such as [replicas, episodes].
            seed: of everything random in it.
            device: where it is.
        """

    @abstractmethod
    def steps(self) -> int:
        """Returns how many steps an episode lasts at most."""

    def policies(self, domain: Domain | None) -> tuple[str, ...]:
        """Returns the names of the scripted policies; there is also ``random``."""
        return ()

    def references(self, domain: Domain | None) -> tuple[str, ...]:
        """Returns the names of the privileged policies: they read what no agent is shown.

        They are an upper bound for agents, and are shown next to them in results and figures.
        """
        return ()

    def make_policy(self, name: str, env: EnvBase) -> TensorDictModuleBase:
        """Makes a scripted policy, a privileged one, or the random one."""
        from torchrl.envs.utils import RandomPolicy

        from bbq_torchrl.envs import UniformPolicy as RandomLegalPolicy

        return RandomLegalPolicy() if action_mask_key(env) else RandomPolicy(env.action_spec)

    def check_domain(self, domain: Domain | None) -> None:
        """Raises ValueError for a domain that cannot be played in."""

    def inactive(self, env: EnvBase) -> tuple[Tensor, Tensor] | None:
        """Returns which features and which actions come into use later (bool), or None."""
        return None

    def counted(self, env: EnvBase) -> Tensor | None:
        """Returns which features tell kinds of states apart (bool), for counts of visits.

        None stands for all of them.
        """
        return None

    def inactive_slots(self, domain: Domain | None) -> set[str]:
        """Returns the slots that no round activates."""
        return set()

    def additions(self, domain: Domain | None) -> dict[int, str]:
        """Returns the slot that each round adds, by round."""
        return {}


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

    def check(self) -> None:
        """Refuses keys of errors that would not be used."""
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
        """Returns the error channel between user and tracker; None: errors as they are drawn.

        Raises:
            ConfigError: the domain or the installation lacks what it needs.
        """
        self.check()
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
        from bbq_torchrl.domains.parts import PRIVILEGED_POLICY

        return (PRIVILEGED_POLICY,)

    def make_policy(self, name: str, env: EnvBase) -> TensorDictModuleBase:
        """A policy of the domain, ``clairvoyant``, or ``random``."""
        from bbq_torchrl.envs import scripted_policy

        return scripted_policy(name, env)

    def schedule(self) -> ExtensionSchedule | None:
        """Returns the slots of each round; None: all of them, always."""
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

    def counted(self, env: EnvBase) -> Tensor:
        """The filled slots, the open questions, and whether the last act was an offer."""
        import torch

        from bbq_torchrl.envs import DialogueEnv

        assert isinstance(env, DialogueEnv)
        features = torch.zeros(env.layout.size, dtype=torch.bool)
        for group in ("filled", "user_requested"):
            features[env.layout[group]] = True
        features[env.layout.column("agent_informed", "taskcomplete")] = True
        return features


@register
@dataclass
class DomainExtension(FullDomain):
    """The essential slots first; then the others one by one, in the domain's order."""

    name: str = option("domain_ext")
    start: int = setting(40, NON_NEGATIVE_INTEGER, "round in which the first new slot appears")
    every: int = setting(10, COUNT, "rounds between two new slots")
    paper_rounds: int = other_default(FullDomain, "paper_rounds", 200)

    extends: ClassVar[bool] = True

    def schedule(self) -> ExtensionSchedule:
        """Returns the slots of each round."""
        from bbq_torchrl.envs import ExtensionSchedule

        return ExtensionSchedule(start=self.start, every=self.every)

    def check_domain(self, domain: Domain | None) -> None:
        """Refuses a slot that the agent has actions for and that no round adds, too."""
        super().check_domain(domain)
        assert domain is not None
        self.schedule().never_active(domain)

    def inactive(self, env: EnvBase) -> tuple[Tensor, Tensor]:
        """Those of the slots that are not there in the first round."""
        return ~env.active_features, ~env.simulator.action_mask(env.active_slots)

    def inactive_slots(self, domain: Domain | None) -> set[str]:
        """Those that are not essential and that the domain's order lacks."""
        assert domain is not None
        return set(self.schedule().never_active(domain))

    def additions(self, domain: Domain | None) -> dict[int, str]:
        """The slot that each round adds."""
        assert domain is not None
        return self.schedule().additions(domain)
