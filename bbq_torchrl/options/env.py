"""The options of ``env=``, simulated users or another environment, and of ``domain=``."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from bbq_torchrl.options.registry import Option, register
from bbq_torchrl.options.task import action_mask_key
from bbq_torchrl.settings import (
    ANY_TEXT,
    BOOLEAN,
    COUNT,
    NON_NEGATIVE_INTEGER,
    PROBABILITY,
    REQUIRED,
    REWARD,
    USERS,
    ConfigError,
    integers,
    one_of,
    option,
    optional,
    other_default,
    setting,
)

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
    """An environment for the agent.

    It is an ``EnvBase`` of batch size [replicas, episodes]. Its specs have ``observation`` (one
    dimension of floats), a categorical or one-hot ``action``, and ``action_mask`` if some actions
    can be illegal. It writes ``("next", "success")``, bool [replicas, episodes, 1]: whether an
    episode has ended in success. A :class:`~bbq_torchrl.protocols.RoundEnv` is notified of every
    round.

    Attributes:
        has_domain: whether the environment uses ``domain=``.
        extends: whether some features or actions become active only in later rounds.
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
            domain: the domain of the dialogues; None without :attr:`has_domain`.
            batch_size: such as [replicas, episodes].
            seed: seed of its random numbers.
            device: its device.
        """

    @abstractmethod
    def steps(self) -> int:
        """Returns the largest number of steps of an episode."""

    def returns(self, gamma: float) -> tuple[float, float] | None:
        """Returns bounds of the discounted sum of an episode's rewards; None if unknown."""
        return None

    def policies(self, domain: Domain | None) -> tuple[str, ...]:
        """Returns the names of the scripted policies, without ``random``."""
        return ()

    def references(self, domain: Domain | None) -> tuple[str, ...]:
        """Returns the names of the privileged policies, which read more than agents observe.

        Results and figures show them next to agents as an upper bound.
        """
        return ()

    def make_policy(self, name: str, env: EnvBase) -> TensorDictModuleBase:
        """Makes a scripted policy, a privileged one, or the random one."""
        from torchrl.envs.utils import RandomPolicy

        from bbq_torchrl.envs import UniformPolicy as RandomLegalPolicy

        return RandomLegalPolicy() if action_mask_key(env) else RandomPolicy(env.action_spec)

    def check_domain(self, domain: Domain | None) -> None:
        """Raises ValueError for a domain that the environment cannot use."""

    def inactive(self, env: EnvBase) -> tuple[Tensor, Tensor] | None:
        """Returns the features and the actions that become active later (bool), or None."""
        return None

    def additions(self, domain: Domain | None) -> dict[int, str]:
        """Returns the added slot by round."""
        return {}


@register
@dataclass
class FullDomain(EnvOption):
    """All slots from the start."""

    name: str = option("full")
    slot_error_prob: float | None = setting(
        None, optional(PROBABILITY, "the domain's"), "probability of an error in an informed slot"
    )
    slot_error_mode: str = setting(
        "value", one_of("value", "slot", "delete", "mixed"), "effect of an error on a slot"
    )
    intent_error_prob: float = setting(0.0, PROBABILITY, "probability of a random user act")
    level: str = setting(
        "act", one_of("act", "text"), "users' output: acts, or, in evaluations only, sentences"
    )
    errors: str = setting(
        "drawn", one_of("drawn", "measured"), "errors in acts: by probability, or as in sentences"
    )
    ask_below: float | None = setting(
        None, optional(PROBABILITY, "the nlu's"), "for level=text: confidence to ask again below"
    )
    max_turn: int = setting(40, integers(2, 1_000), "turns of a dialogue, counting both sides")
    success_reward: float = setting(40.0, REWARD, "reward of a dialogue that succeeds")
    failure_reward: float = setting(-10.0, REWARD, "reward of a dialogue that fails")
    turn_reward: float = setting(-1.0, REWARD, "reward of a turn that does not end the dialogue")
    users: Any = setting("paper", USERS, "simulated users: a mix by name, or its profiles")

    has_domain: ClassVar[bool] = True

    def check(self) -> None:
        """Refuses invalid users, and error rates of users whose errors have another source."""
        if isinstance(self.users, str):
            return
        from bbq_torchrl.simulator.profiles import profiles_of

        try:
            has_rates = any(kind.slot_error_prob for kind in profiles_of(self.users))
        except ValueError as error:
            raise ConfigError(f"env.{error}") from error
        if has_rates and (self.level == "text" or self.errors == "measured"):
            raise ConfigError(
                "env.users must have no slot_error_prob with env.level=text or env.errors=measured"
            )

    def check_domain(self, domain: Domain | None) -> None:
        """Refuses measured errors without counts, and slots of users or extension not there."""
        try:
            self.make(domain, (1,))
        except ModuleNotFoundError as error:
            raise ConfigError(f"env.level=text cannot be played: {error}") from error

    def _channel(self, domain: Domain) -> Channel | None:
        """Returns the error channel between user and tracker; None: the default of drawn errors."""
        if self.level == "text":
            from bbq_torchrl.envs.text_channel import text_channel

            return text_channel(domain, self.ask_below)
        if self.errors == "measured":
            from bbq_torchrl.simulator.measured_errors import load_errors

            return load_errors(domain)
        return None

    def steps(self) -> int:
        """Half of ``max_turn``, which counts both sides, and one more act of the agent."""
        return self.max_turn // 2 + 1

    def returns(self, gamma: float) -> tuple[float, float]:
        """The rewards of the longest dialogue's turns, and the worst or best end at once."""
        turns = self.turn_reward * sum(gamma**turn for turn in range(self.steps()))
        ends = (self.success_reward, self.failure_reward, 0.0)
        return min(ends) + min(turns, 0.0), max(ends) + max(turns, 0.0)

    def policies(self, domain: Domain | None) -> tuple[str, ...]:
        """The domain's policies."""
        assert domain is not None
        return tuple(domain.policies)

    def references(self, domain: Domain | None) -> tuple[str, ...]:
        """The policy that knows the user's goal."""
        from bbq_torchrl.domains.domain import PRIVILEGED_POLICY

        return (PRIVILEGED_POLICY,)

    def make_policy(self, name: str, env: EnvBase) -> TensorDictModuleBase:
        """A policy of the domain, ``clairvoyant``, or ``random``."""
        from bbq_torchrl.envs import scripted_policy

        return scripted_policy(name, env)

    def schedule(self) -> ExtensionSchedule | None:
        """Returns the schedule of slots; None: all slots are always active."""
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
        keys = ("slot_error_prob", "slot_error_mode", "intent_error_prob", "max_turn", "users")
        rewards = ("success_reward", "failure_reward", "turn_reward")
        return DialogueEnv(
            domain,
            batch_size=tuple(batch_size),
            schedule=self.schedule(),
            channel=self._channel(domain),
            seed=seed,
            device=device,
            **{name: getattr(self, name) for name in (*keys, *rewards)},
        )


@register
@dataclass
class DomainExtension(FullDomain):
    """The essential slots at first, then the others one by one in the domain's order."""

    name: str = option("domain_ext")
    start: int = setting(40, NON_NEGATIVE_INTEGER, "round that adds the first slot")
    every: int = setting(10, COUNT, "rounds from one new slot to the next")
    paper_rounds: int = other_default(FullDomain, "paper_rounds", 200)

    extends: ClassVar[bool] = True

    def schedule(self) -> ExtensionSchedule:
        """Returns the schedule of slots."""
        from bbq_torchrl.envs import ExtensionSchedule

        return ExtensionSchedule(start=self.start, every=self.every)

    def inactive(self, env: EnvBase) -> tuple[Tensor, Tensor]:
        """The features and actions of slots that are not active in the first round."""
        return ~env.active_features, ~env.simulator.action_mask(env.active_slots)

    def additions(self, domain: Domain | None) -> dict[int, str]:
        """The added slot by round."""
        assert domain is not None
        return self.schedule().additions(domain)


@dataclass
class DomainOption(Option):
    """The subject of the dialogues."""

    group: ClassVar[str] = "domain"

    @abstractmethod
    def make(self) -> Domain:
        """Loads the domain.

        Raises:
            ValueError or OSError: the corpus is damaged or missing.
        """


@dataclass
class ShippedDomain(DomainOption):
    """A corpus that ships with the package."""

    def make(self) -> Domain:
        """Loads the corpus."""
        from bbq_torchrl.domains import shipped_domain

        return shipped_domain(self.name)


@register
@dataclass
class MovieDomain(ShippedDomain):
    """The movie-booking corpus that ships with the package."""

    name: str = option("movie")


@register
@dataclass
class HotelDomain(ShippedDomain):
    """Rooms in hotels, with the slots of MultiWOZ's hotels and values of our making."""

    name: str = option("hotel")


@register
@dataclass
class RestaurantDomain(ShippedDomain):
    """Tables in restaurants, with the slots of MultiWOZ's restaurants and values of our making."""

    name: str = option("restaurant")


@register
@dataclass
class FolderDomain(DomainOption):
    """A domain folder: domain.yaml, knowledge_base.csv, goals.jsonl, values.json."""

    name: str = option("folder")
    path: str = setting(REQUIRED, ANY_TEXT, "the folder")

    def make(self) -> Domain:
        """Loads and validates the folder."""
        from bbq_torchrl.domains import load_domain

        return load_domain(self.path)


@register
@dataclass
class MiuLabDomain(DomainOption):
    """The public MiuLab files (TC-Bot), read safely; they are not part of this project."""

    name: str = option("miulab")
    path: str = setting(REQUIRED, ANY_TEXT, "folder of the files")
    goals: str = setting("user_goals_first_turn_template.v2.p", ANY_TEXT, "file of user goals")
    kb: str = setting("movie_kb.1k.p", ANY_TEXT, "file of the knowledge base")
    values: str = setting("dicts.v3.p", ANY_TEXT, "file of the values that errors draw from")
    skip_unusable: bool = setting(
        True, BOOLEAN, "leave out and report unusable goals, rows and slots; false: refuse them"
    )

    def make(self) -> Domain:
        """Reads the files."""
        from bbq_torchrl.domains import load_miulab

        return load_miulab(**{key: value for key, value in vars(self).items() if key != "name"})
