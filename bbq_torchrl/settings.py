"""Settings: a dataclass field with its default, its allowed values and its meaning.

The one validator of options, study files, domain files, searches and constructors' arguments::

    @dataclass
    class Optimizer:
        lr: float = setting(1e-3, STEP_SIZE, "learning rate")
        steps: int = setting(REQUIRED, COUNT, "number of updates")


    faults(Optimizer, {"lr": -1})  # {"lr": "lr must be ...", "steps": "steps must be given: ..."}
    filled(Optimizer, {"steps": 3})  # Optimizer(lr=0.001, steps=3), or a ConfigError
    check_values(optimizer)  # a ConfigError if a value of the instance is not allowed
    check("lr", lr, STEP_SIZE)  # a ValueError if this value is not allowed

Every sentence names the key, what is allowed and what was given. Values that the bounds below do
not describe have an own :class:`Allowed`, a text and a test.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import MISSING, Field, dataclass, field, fields, is_dataclass
from typing import TYPE_CHECKING, Any, TypeVar

from bbq_torchrl.utils.text import sentence, shown

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    Values = float | list[float]
else:
    # OmegaConf has no union with a list, so the key's allowed values check the type.
    Values = Any

Schema = TypeVar("Schema")

REQUIRED = "???"
"""The default of a key that must be given, which OmegaConf also knows."""


@dataclass(frozen=True)
class Allowed:
    """The allowed values of a setting.

    Attributes:
        text: completes the sentence ``"<name> must be ..."``.
        test: returns whether a value is allowed.
        per_replica: whether a list can give each replica a separate value.
    """

    text: str
    test: Callable[[Any], bool]
    per_replica: bool = False

    def fault(self, name: str, value: Any) -> str | None:
        """Returns the sentence on a value that is missing or not allowed; None for others.

        Examples:
            >>> BOOLEAN.fault("masked", 1)
            'masked must be true or false, got 1'
        """
        if isinstance(value, str) and value == REQUIRED:
            return f"{name} must be given: it must be {self.text}"
        return None if self.test(value) else f"{name} must be {self.text}, got {shown(value)}"


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _is_integer(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _number(text: str, test: Callable[[Any], bool]) -> Allowed:
    return Allowed(text, lambda value: _is_number(value) and test(value))


def numbers(low: float, high: float) -> Allowed:
    """The numbers from ``low`` to ``high``."""
    text = f"a number from {low:g} to {high:g}".replace("e+", "e")
    return _number(text, lambda value: low <= value <= high)


def at_least(low: float) -> Allowed:
    """The numbers from ``low`` on."""
    return Allowed(f"at least {low}", lambda value: bool(value >= low))


def integers(low: int, high: int = 10**9) -> Allowed:
    """The integers from ``low`` to ``high``, by default a billion."""
    text = f"an integer from {low} to {'10**9' if high == 10**9 else high}"
    return Allowed(text, lambda value: _is_integer(value) and low <= value <= high)


ABOVE_ZERO = _number("positive and finite", lambda value: 0 < value < math.inf)
AT_LEAST_ZERO = _number("at least 0 and finite", lambda value: 0 <= value < math.inf)
# Networks and rewards are float32, at most 3e38, so squared values must be below its root.
POSITIVE = numbers(1e-15, 1e15)
NON_NEGATIVE = numbers(0, 1e15)
REWARD = numbers(-1e15, 1e15)
STEP_SIZE = numbers(1e-30, 1e30)
PROBABILITY = _number("a number between 0 and 1", lambda value: 0 <= value <= 1)
BELOW_ONE = _number("a number from 0 to below 1", lambda value: 0 <= value < 1)
ABOVE_ZERO_TO_ONE = _number("a number above 0 and up to 1", lambda value: 0 < value <= 1)
COUNT = integers(1)
NON_NEGATIVE_INTEGER = integers(0)
SIZE = integers(1, 1_000)  # a factor of the memory use
BATCH = integers(1, 100_000)
THREADS = integers(1, 1024)  # torch crashes with many times as many
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
TEXT = Allowed("text", lambda value: isinstance(value, str))
ANY_TEXT = Allowed("text", lambda value: isinstance(value, str) and value != "")
WORDS = Allowed("text, not blank", lambda value: isinstance(value, str) and bool(value.strip()))
TEXTS = Allowed(
    "a list of texts",
    lambda value: isinstance(value, list) and all(isinstance(text, str) for text in value),
)
MAPPING = Allowed("a mapping", lambda value: isinstance(value, dict))

USERS = Allowed(
    "one of paper, people, mixed, or profiles, such as [{share: .7, insists: 1}, {share: .3}]",
    lambda value: (
        isinstance(value, Mapping)
        or value in ("paper", "people", "mixed")
        or (isinstance(value, (list, tuple)) and bool(value))
    ),
)


def one_of(*choices: str) -> Allowed:
    """The given strings."""
    if len(choices) == 1:
        return Allowed(f"{choices[0]!r}", lambda value: value == choices[0])
    return Allowed(f"one of {', '.join(choices)}", lambda value: value in choices)


def or_text(allowed: Allowed, text: str) -> Allowed:
    """The values of ``allowed``, and the string ``text``."""
    return Allowed(
        f"{allowed.text} or {text!r}",
        lambda value: value == text or allowed.test(value),
        allowed.per_replica,
    )


def optional(allowed: Allowed, meaning: str) -> Allowed:
    """The values of ``allowed``, and null, which means ``meaning``."""
    return Allowed(
        f"{allowed.text} or null ({meaning})",
        lambda value: value is None or allowed.test(value),
        allowed.per_replica,
    )


def per_replica(allowed: Allowed) -> Allowed:
    """The values of ``allowed``, and a list of them with one for each replica.

    The length of the list is checked once the number of replicas is known.

    Examples:
        >>> per_replica(POSITIVE).test([0.1, 0.2]), per_replica(POSITIVE).test([0.1, -1])
        (True, False)
    """

    def test(value: Any) -> bool:
        if isinstance(value, list):
            return bool(value) and all(map(allowed.test, value))
        return allowed.test(value)

    return Allowed(f"{allowed.text} (or a list, one for each replica)", test, per_replica=True)


def check(name: str, value: Any, allowed: Allowed, error: type[ValueError] = ValueError) -> Any:
    """Returns the value if it is allowed.

    Args:
        name: the setting's name in the error message.
        value: the value.
        allowed: the allowed values.
        error: the class of the error. Defaults to ``ValueError``.

    Raises:
        ValueError: one sentence that names the setting, the value and the allowed values.

    Examples:
        >>> check("mode", "drawn", one_of("draw", "mean"))
        Traceback (most recent call last):
        ValueError: mode must be one of draw, mean, got 'drawn'
    """
    if fault := allowed.fault(name, value):
        raise error(fault)
    return value


class ConfigError(ValueError):
    """An invalid configuration, explained in one sentence."""


def setting(default: Any, allowed: Allowed, meaning: str) -> Any:
    """A dataclass field with a default, the values it may take, and its meaning.

    Args:
        default: the default value, or :data:`REQUIRED`; lists and dicts are copied.
        allowed: the allowed values.
        meaning: the key's meaning, with its unit.
    """
    metadata = {"allowed": allowed, "meaning": meaning}
    if isinstance(default, (list, dict)):
        return field(default_factory=default.copy, metadata=metadata)
    return field(default=default, metadata=metadata)


def other_default(base: type, key: str, default: Any) -> Any:
    """A base class's field with another default, the same allowed values and meaning."""
    return field(default=default, metadata=base.__dataclass_fields__[key].metadata)  # type: ignore[attr-defined]


def option(name: str) -> Any:
    """The field ``name`` of an option, which identifies it in its group."""
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


def check_values(config: Any, prefix: str = "") -> None:
    """Checks every value of a configuration dataclass against what its field allows.

    Args:
        config: the dataclass.
        prefix: prefix of keys in messages.

    Raises:
        ConfigError: the value of a key is not allowed.
    """
    for key, item, value in walk(config, prefix):
        if fault := item.metadata["allowed"].fault(key, value):
            raise ConfigError(fault)


def faults(schema: type, given: Mapping[Any, Any], prefix: str = "") -> dict[Any, str]:
    """Returns a sentence for each key that is unknown, missing, or has a value not allowed.

    Args:
        schema: a dataclass of settings.
        given: values by key; other keys have their defaults.
        prefix: prefix of keys in messages.

    Examples:
        >>> @dataclass
        ... class Optimizer:
        ...     lr: float = setting(1e-3, PROBABILITY, "learning rate")
        ...     steps: int = setting(REQUIRED, COUNT, "number of updates")
        >>> for sentence in faults(Optimizer, {"lr": -1, "step": 3}, "optimizer.").values():
        ...     print(sentence)
        optimizer.step is not a key; the keys are lr, steps
        optimizer.lr must be a number between 0 and 1, got -1
        optimizer.steps must be given: it must be an integer from 1 to 10**9
    """
    known = {item.name: item for item in fields(schema)}
    found = {
        key: f"{prefix}{sentence(key)} is not a key; the keys are {', '.join(known)}"
        for key in given
        if key not in known
    }
    for key, item in known.items():
        default = None if item.default is MISSING else item.default
        if key in given or default == REQUIRED:
            allowed: Allowed = item.metadata["allowed"]
            fault = allowed.fault(f"{prefix}{key}", given.get(key, default))
            found |= {key: fault} if fault else {}
    return found


def filled(schema: type[Schema], given: Mapping[str, Any], prefix: str = "") -> Schema:
    """Returns a dataclass of settings with the given values, otherwise its defaults.

    Args:
        schema: the dataclass.
        given: values by key.
        prefix: prefix of keys in messages.

    Raises:
        ConfigError: the first of :func:`faults`.
    """
    for fault in faults(schema, given, prefix).values():
        raise ConfigError(fault)
    return schema(**given)
