"""YAML from users: loaded as plain values, or refused at once in a sentence."""

import pytest
import yaml

from bbq_torchrl.runs.sweeps import table_of_runs
from bbq_torchrl.utils.files import read_yaml

FAULTS = {
    "[" * 50_000: "it is not valid YAML: maximum recursion depth",
    "a: [": "it is not valid YAML: expected the node content, but found '<stream end>' in line 1",
    "a: *b": "it is not valid YAML: found undefined alias 'b' in line 1",
    "a: \x00": "it is not valid YAML: ",
}
OF_VALUES = {
    "a: 1\na: 2": "keys must be given once, got 'a' again in line 2",
    '!!int ""': "it is not valid YAML",
    "!!bool x": "it is not valid YAML",
    "!!timestamp x": "it is not valid YAML",
    "2001-99-99": "month must be in 1..12",
    "!!python/object/apply:os.system [x]": "could not determine a constructor for the tag",
    "9" * 5_000: "Exceeds the limit",
}


@pytest.mark.parametrize(("text", "says"), FAULTS.items(), ids=range(len(FAULTS)))
def test_what_cannot_be_values_is_refused_at_once(text, says):
    with pytest.raises(ValueError, match=says.replace("[", r"\[")):
        read_yaml(text)


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


@pytest.mark.parametrize("noted", ["[", "a: 1", "- [1]", "3"])
def test_a_sweep_is_shown_whatever_its_overrides_hold(tmp_path, noted):
    (tmp_path / "0" / ".hydra").mkdir(parents=True)
    (tmp_path / "0" / "config.yaml").write_text("seed: 0\n")
    (tmp_path / "0" / ".hydra" / "overrides.yaml").write_text(noted)
    assert table_of_runs(tmp_path).splitlines()[-1].split()[0] == "0"
