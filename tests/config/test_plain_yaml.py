"""YAML from users: loaded as plain values, or refused at once in a sentence."""

from __future__ import annotations

import pytest
import yaml

from bbq_torchrl.people.study.plan import StudyError, load_study
from bbq_torchrl.runs.sweeps import table_of_runs
from bbq_torchrl.utils.files import check_yaml, read_yaml


def doubled(first, pattern):
    """Returns lines of which each expands to eight times the one before."""
    lines = [f"a0: &a0 {first}"]
    for number in range(1, 30):
        aliases = ", ".join([f"*a{number - 1}"] * 8)
        lines.append(f"a{number}: &a{number} {pattern % aliases}")
    return "\n".join(lines) + "\n"


BOMBS = {
    "lists": doubled("[x]", "[%s]"),
    "merges": doubled("{x: 1}", "{<<: [%s]}"),
    "keys": doubled("[x]", "{? [%s] : 1}"),
}
TOO_MUCH = "its aliases expand to more than 10000 values"
FAULTS = {
    **dict.fromkeys(BOMBS.values(), TOO_MUCH),
    "a: &a [*a]": "an alias in line 1 refers to a value that contains it",
    "a: &a {b: {c: *a}}": "an alias in line 1 refers to a value that contains it",
    "[" * 50_000: "it is nested too deeply",
    "a: [": "it is not valid YAML: expected the node content, but found '<stream end>' in line 1",
    "a: *b": "it is not valid YAML: found undefined alias 'b' in line 1",
    "a: \x00": "it is not valid YAML: ",
}
OF_VALUES = {
    "a: 1\na: 2": "keys must be given once, got 'a' again in line 2",
    '!!int ""': "a tag does not fit its value",
    "!!bool x": "a tag does not fit its value",
    "!!timestamp x": "a tag does not fit its value",
    "2001-99-99": "month must be in 1..12",
    "!!python/object/apply:os.system [x]": "could not determine a constructor for the tag",
    "9" * 5_000: "Exceeds the limit",
}


@pytest.mark.parametrize(("text", "says"), FAULTS.items(), ids=range(len(FAULTS)))
@pytest.mark.parametrize("read", [read_yaml, check_yaml])
def test_what_cannot_be_values_is_refused_at_once(read, text, says):
    with pytest.raises(ValueError, match=says.replace("[", r"\[")):
        read(text)


@pytest.mark.parametrize(("text", "says"), OF_VALUES.items(), ids=range(len(OF_VALUES)))
def test_values_that_cannot_be_made_are_refused_in_a_sentence(text, says):
    with pytest.raises(ValueError, match=says):
        read_yaml(text)


def test_aliases_that_save_some_lines_and_long_texts_are_read():
    shared = "base: &base {lr: 1, hidden: [8, 8]}\none: *base\nother: {<<: *base, lr: 2}\n"
    assert read_yaml(shared)["other"] == {"lr": 2, "hidden": [8, 8]}
    long = yaml.safe_dump({"values": list(range(20_000))})
    assert read_yaml(long)["values"][-1] == 19_999
    assert read_yaml("") is None
    check_yaml(shared + long)


@pytest.mark.parametrize("bomb", BOMBS.values(), ids=BOMBS)
def test_a_study_file_of_aliases_is_refused_at_once(tmp_path, bomb):
    file = tmp_path / "study.yaml"
    file.write_text(bomb)
    with pytest.raises(StudyError, match=TOO_MUCH):
        load_study(file)


@pytest.mark.parametrize("noted", [*BOMBS.values(), "[", "a: 1", "- [1]", "3"])
def test_a_sweep_is_shown_whatever_its_overrides_hold(tmp_path, noted):
    (tmp_path / "0" / ".hydra").mkdir(parents=True)
    (tmp_path / "0" / "config.yaml").write_text("seed: 0\n")
    (tmp_path / "0" / ".hydra" / "overrides.yaml").write_text(noted)
    assert table_of_runs(tmp_path, 1).splitlines()[-1].split()[0] == "0"
