"""Every invalid value of a key is refused by name, and so is YAML that holds no values."""

import math

import pytest
import yaml

from bbq_torchrl.options import schemas
from bbq_torchrl.settings import (
    POSITIVE,
    SEED,
    ConfigError,
    check_values,
    integers,
    one_of,
    optional,
    or_text,
    per_replica,
    walk,
)
from bbq_torchrl.utils.files import read_yaml

CANDIDATES = (-1, 0, 1, 2, 1.5, -0.5, math.nan, math.inf, True, None, "", "nope", [], [0], [8], {})

OPTIONS = [schema for known in schemas().values() for schema in known.values()]


def leaves(schema):
    """The keys of a schema, without groups."""
    return [(key, item) for key, item, _ in walk(schema()) if "allowed" in item.metadata]


def valid(schema):
    """A valid configuration of the schema, with its required values."""
    config = schema()
    for key, item in leaves(schema):
        if getattr(config, key) == "???":
            setattr(config, key, "given")
        elif isinstance(getattr(config, key), str) and getattr(config, key).startswith("${"):
            setattr(config, key, 1)
        assert item.metadata["meaning"]
    return config


@pytest.mark.parametrize("schema", OPTIONS)
def test_a_value_that_is_not_allowed_is_refused_by_key_and_value(schema):
    check_values(valid(schema))
    for key, item in leaves(schema):
        allowed = item.metadata["allowed"]
        refused = [value for value in CANDIDATES if not allowed.test(value)]
        assert len(refused) >= 3
        for value in refused:
            config = valid(schema)
            setattr(config, key, value)
            with pytest.raises(ConfigError) as error:
                check_values(config)
            assert str(error.value) == f"{key} must be {allowed.text}, got {value!r}"


NUMBER = "a number from 1e-15 to 1e15"
LISTED = f"{NUMBER} (or a list, one for each replica)"


@pytest.mark.parametrize(
    ("allowed", "text", "accepted", "refused"),
    [
        (POSITIVE, NUMBER, [1e-9, 3], [0, -1, True, "1", math.inf, 1e-200]),
        (SEED, "an integer from 0 to 2**63 - 1", [0, 2**63 - 1], [-1, 2**63, 2**64, 1e3]),
        (integers(2), "an integer from 2 to 10**9", [2, 40], [1, 2.0, True, 10**9 + 1]),
        (one_of("map", "mc"), "one of map, mc", ["map", "mc"], ["MAP", None]),
        (or_text(POSITIVE, "fan_in"), f"{NUMBER} or 'fan_in'", ["fan_in", 1], ["fan", 0]),
        (per_replica(POSITIVE), LISTED, [1, [0.1], [1, 2]], [0, [], [0, 1], [True], [[1]], "1"]),
        (optional(POSITIVE, "never"), f"{NUMBER} or null (never)", [None, 1], [0, "null"]),
    ],
)
def test_what_is_allowed_says_so(allowed, text, accepted, refused):
    assert allowed.text == text
    assert all(map(allowed.test, accepted))
    assert not any(map(allowed.test, refused))


FAULTS = ["[" * 1_000, "a: [", "a: *b", "a: \x00", "a: 1\na: 2", '!!int ""', "!!bool x"]
FAULTS += ["!!timestamp x", "2001-99-99", "!!python/object/apply:os.system [x]", "9" * 5_000]


@pytest.mark.parametrize("text", FAULTS, ids=range(len(FAULTS)))
def test_what_cannot_be_values_is_refused_in_a_sentence(text):
    with pytest.raises(ValueError, match=r"valid YAML|once|month|limit") as error:
        read_yaml(text)
    assert len(str(error.value)) < 300


def test_aliases_that_save_some_lines_and_long_texts_are_read():
    shared = "base: &base {lr: 1, hidden: [8, 8]}\none: *base\nother: {<<: *base, lr: 2}\n"
    assert read_yaml(shared)["other"] == {"lr": 2, "hidden": [8, 8]}
    long = yaml.safe_dump({"values": list(range(5_000))})
    assert read_yaml(long)["values"][-1] == 4_999
    assert read_yaml("") is None
