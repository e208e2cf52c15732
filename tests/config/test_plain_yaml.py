"""YAML from users: loaded as plain values, or refused at once in a sentence."""

import pytest
import yaml

from bbq_torchrl.runs.sweeps import table_of_runs
from bbq_torchrl.utils.files import read_yaml

FAULTS = ["[" * 50_000, "a: [", "a: *b", "a: \x00", "a: 1\na: 2", '!!int ""', "!!bool x"]
FAULTS += ["!!timestamp x", "2001-99-99", "!!python/object/apply:os.system [x]", "9" * 5_000]


@pytest.mark.parametrize("text", FAULTS, ids=range(len(FAULTS)))
def test_what_cannot_be_values_is_refused_in_a_sentence(text):
    with pytest.raises(ValueError, match=r"valid YAML|once|month|limit") as error:
        read_yaml(text)
    assert len(str(error.value)) < 300


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
