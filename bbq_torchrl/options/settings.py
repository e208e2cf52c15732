"""One configuration key: its default, what it may be, and what it means.

A schema field is declared once with all three::

    lr: float = setting(1e-3, STEP_SIZE, "step size of Adam")

OmegaConf checks the type, :func:`check_settings` the value; both refusals are one sentence that
names the key, what is allowed and what was given.
"""

from __future__ import annotations

from dataclasses import Field, dataclass, field, fields, is_dataclass
from typing import TYPE_CHECKING, Any, TypeVar

from bbq_torchrl.text import shown

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    Values = float | list[float]
else:
    # OmegaConf has no union with a list; what a key allows checks these instead.
    Values = Any

Schema = TypeVar("Schema")

REQUIRED = "???"
"""OmegaConf's mark for a value that somebody has to give."""


class ConfigError(ValueError):
    """A configuration that cannot be run. Its text is one sentence for the person who wrote it."""


@dataclass(frozen=True)
class Allowed:
    """The values a key may take.

    Attributes:
        text: completes the sentence ``"<key> must be ..."``.
        test: whether a value (already of the right type) is one of them.
        per_replica: whether a list can give the replicas values of their own.
    """

    text: str
    test: Callable[[Any], bool]
    per_replica: bool = False


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _is_integer(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def numbers(low: float, high: float) -> Allowed:
    """The numbers from ``low`` to ``high``."""
    return Allowed(
        f"a number from {low:g} to {high:g}".replace("e+", "e"),
        lambda value: _is_number(value) and low <= value <= high,
    )


def integers(low: int, high: int = 10**9) -> Allowed:
    """The integers from ``low`` to ``high``, which is a billion unless given."""
    last = "10**9" if high == 10**9 else str(high)
    return Allowed(
        f"an integer from {low} to {last}",
        lambda value: _is_integer(value) and low <= value <= high,
    )


# Networks and rewards are float32, which ends at 3e38: what is squared must stay below its root.
POSITIVE = numbers(1e-15, 1e15)
NON_NEGATIVE = numbers(0, 1e15)
REWARD = numbers(-1e15, 1e15)
STEP_SIZE = numbers(1e-30, 1e30)
PROBABILITY = Allowed(
    "a number between 0 and 1", lambda value: _is_number(value) and 0 <= value <= 1
)
BELOW_ONE = Allowed(
    "a number from 0 to below 1", lambda value: _is_number(value) and 0 <= value < 1
)
ABOVE_ZERO_TO_ONE = Allowed(
    "a number above 0 and up to 1", lambda value: _is_number(value) and 0 < value <= 1
)
COUNT = integers(1)
NON_NEGATIVE_INTEGER = integers(0)
SIZE = integers(1, 1_000)  # what memory is multiplied with
BATCH = integers(1, 100_000)
THREADS = integers(1, 1024)  # torch crashes where it gets many times as many
SEED = Allowed(
    "an integer from 0 to 2**63 - 1", lambda value: _is_integer(value) and 0 <= value < 2**63
)
COUNTS = Allowed(
    "a list of up to 10 integers from 1 to 10000, such as [256,256]",
    lambda value: (
        isinstance(value, list)
        and 1 <= len(value) <= 10
        and all(map(integers(1, 10_000).test, value))
    ),
)
BOOLEAN = Allowed("true or false", lambda value: isinstance(value, bool))
ANY_TEXT = Allowed("a text", lambda value: isinstance(value, str) and value != "")


def one_of(*choices: str) -> Allowed:
    """Exactly the given texts."""
    if len(choices) == 1:
        return Allowed(f"{choices[0]!r}", lambda value: value == choices[0])
    return Allowed(f"one of {', '.join(choices)}", lambda value: value in choices)


def or_text(allowed: Allowed, text: str) -> Allowed:
    """What ``allowed`` lets through, and the word ``text``."""
    return Allowed(
        f"{allowed.text} or {text!r}",
        lambda value: value == text or allowed.test(value),
        allowed.per_replica,
    )


def optional(allowed: Allowed, meaning: str) -> Allowed:
    """What ``allowed`` lets through, and null; ``meaning`` says what null does."""
    return Allowed(
        f"{allowed.text} or null ({meaning})",
        lambda value: value is None or allowed.test(value),
        allowed.per_replica,
    )


def per_replica(allowed: Allowed) -> Allowed:
    """What ``allowed`` lets through, and a list of it whose values the replicas share out.

    How long the list may be is checked where the number of replicas is known.

    Examples:
        >>> per_replica(POSITIVE).test([0.1, 0.2]), per_replica(POSITIVE).test([0.1, -1])
        (True, False)
    """

    def test(value: Any) -> bool:
        if isinstance(value, list):
            return bool(value) and all(map(allowed.test, value))
        return allowed.test(value)

    return Allowed(f"{allowed.text} (or a list, one for each replica)", test, per_replica=True)


def setting(default: Any, allowed: Allowed, meaning: str) -> Any:
    """A dataclass field with a default, the values it may take, and its meaning.

    Args:
        default: the value where nobody chooses one; lists are copied for each instance.
        allowed: the values that pass :func:`check_settings`.
        meaning: what the key does, with its unit.
    """
    metadata = {"allowed": allowed, "meaning": meaning}
    if isinstance(default, list):
        return field(default_factory=default.copy, metadata=metadata)
    return field(default=default, metadata=metadata)


def other_default(base: type, key: str, default: Any) -> Any:
    """The field of a base class with another default: what it allows and means stays."""
    return field(default=default, metadata=base.__dataclass_fields__[key].metadata)  # type: ignore[attr-defined]


def option(name: str) -> Any:
    """The field ``name`` of the schema of a group's option, by which the option is told."""
    return setting(name, one_of(name), "the option of the group; chosen by <group>=<option>")


def walk(config: Any, prefix: str = "") -> Iterator[tuple[str, Field[Any], Any]]:
    """Yields (dotted key, dataclass field, value) of every leaf of a configuration dataclass."""
    for item in fields(config):
        key = f"{prefix}{item.name}"
        value = getattr(config, item.name)
        if is_dataclass(value):
            yield from walk(value, f"{key}.")
        else:
            yield key, item, value


def check_settings(config: Any, prefix: str = "") -> None:
    """Checks every value of a configuration dataclass against what its field allows.

    Args:
        config: the dataclass.
        prefix: what stands before a key where errors name it.

    Raises:
        ConfigError: naming the first key whose value is not allowed.

    Examples:
        >>> from dataclasses import dataclass
        >>> @dataclass
        ... class Optimizer:
        ...     lr: float = setting(1e-3, STEP_SIZE, "step size")
        >>> check_settings(Optimizer(lr=-1.0))
        Traceback (most recent call last):
        ...
        bbq_torchrl.options.settings.ConfigError: lr must be a number from 1e-30 to 1e30, got -1.0
    """
    for key, item, value in walk(config, prefix):
        allowed: Allowed = item.metadata["allowed"]
        if value == REQUIRED:
            raise ConfigError(f"{key} must be given: it must be {allowed.text}")
        if not allowed.test(value):
            raise ConfigError(f"{key} must be {allowed.text}, got {shown(value)}")


def filled(schema: type[Schema], given: Mapping[str, Any], prefix: str) -> Schema:
    """Returns a dataclass of settings with the values that are given, checked.

    Args:
        schema: the dataclass.
        given: key to value.
        prefix: what stands before a key where errors name it.

    Raises:
        ConfigError: naming the first key that there is not, or whose value is not allowed.
    """
    known = list(schema.__dataclass_fields__)  # type: ignore[attr-defined]
    for key in given:
        if key not in known:
            raise ConfigError(f"{prefix}{key} is not a key; there are {', '.join(known)}")
    config = schema(**given)
    check_settings(config, prefix)
    return config
