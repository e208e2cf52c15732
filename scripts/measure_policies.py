"""Measures the scripted policies and the privileged one, and writes results/policies.json.

Plays every line of the table below by ``python -m bbq_torchrl.evaluate`` and keeps the command
beside its answer; ``scripts/write_docs.py`` makes the documentation's tables from them.

    python scripts/measure_policies.py                        our corpus
    python scripts/measure_policies.py --miulab <folder>      also the public MiuLab corpus
    python scripts/measure_policies.py --policy clairvoyant   this policy alone
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

FILE = Path(__file__).resolve().parent.parent / "results" / "policies.json"

PLACE = "<folder>"
"""Stands for the folder of the MiuLab corpus in the commands that are kept."""

GOALS_V1 = "user_goals_first_turn_template.part.movie.v1.p"
MIULAB = f"domain=miulab domain.path={PLACE}"
REFERENCE = "dialogues=100000 batch=4096"
SHORT = "dialogues=20000 batch=4096"


class Measurement(NamedTuple):
    """A policy in a setting.

    Args:
        corpus: ``movie`` or ``miulab``.
        setting: goals and errors, as the tables call them.
        policy: name of the scripted policy.
        overrides: what the command line says besides the policy.
    """

    corpus: str
    setting: str
    policy: str
    overrides: str


SCRIPTED = ("rule", "rule_inform", "careful_essential", "careful")
NO_ERROR, V1 = "env.slot_error_prob=0", f"domain.goals={GOALS_V1}"
SETTINGS: tuple[tuple[str, str, tuple[str, ...], tuple[str, ...]], ...] = (
    ("movie", "reference", (), (*SCRIPTED, "random", "clairvoyant")),
    ("movie", "no error", (NO_ERROR,), (*SCRIPTED, "clairvoyant")),
    ("miulab", "reference", (), (*SCRIPTED, "random", "clairvoyant")),
    ("miulab", "v2, error .05", ("env.slot_error_prob=.05",), ("rule",)),
    ("miulab", "v2, no error", (NO_ERROR,), ("rule", "rule_inform", "careful", "clairvoyant")),
    ("miulab", "v1, no error", (V1, NO_ERROR), (*SCRIPTED, "clairvoyant")),
    *(
        ("miulab", f"v1, error {error}", (V1, f"env.slot_error_prob={error}"), ("rule",))
        for error in (".05", ".10", ".20", ".30")
    ),
)
"""Corpus, name of the setting, what the command line says of it, and who is measured in it."""

MEASUREMENTS = tuple(
    Measurement(
        corpus,
        setting,
        policy,
        " ".join(
            [
                REFERENCE if (setting, policy) == ("reference", "rule") else SHORT,
                *([MIULAB] if corpus == "miulab" else []),
                *more,
            ]
        ),
    )
    for corpus, setting, more, policies in SETTINGS
    for policy in policies
)


def measure(measurement: Measurement, miulab: Path | None) -> dict[str, object]:
    """Returns the measurement with its command and what the command answered."""
    arguments = f"policy={measurement.policy} {measurement.overrides}".split()
    given = [argument.replace(PLACE, str(miulab)) for argument in arguments]
    answer = subprocess.run(
        [sys.executable, "-m", "bbq_torchrl.evaluate", *given],
        check=True,
        capture_output=True,
        text=True,
        cwd=FILE.parent.parent,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    return {
        "corpus": measurement.corpus,
        "setting": measurement.setting,
        "policy": measurement.policy,
        "command": "python -m bbq_torchrl.evaluate " + " ".join(arguments),
        "result": json.loads(answer.stdout.strip().splitlines()[-1]),
    }


def main() -> None:
    """Measures, and keeps what was measured before and is not to be measured now."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--miulab", type=Path, help="folder of the MiuLab files")
    parser.add_argument("--policy", help="measure this policy alone")
    given = parser.parse_args()
    miulab = given.miulab
    corpora = {"movie"} if miulab is None else {"movie", "miulab"}
    before = json.loads(FILE.read_text(encoding="utf-8")) if FILE.is_file() else []
    known = {(entry["corpus"], entry["setting"], entry["policy"]): entry for entry in before}
    for measurement in MEASUREMENTS:
        if measurement.corpus in corpora and given.policy in (None, measurement.policy):
            entry = measure(measurement, miulab and miulab.resolve())
            sys.stdout.write(f"{shlex.join(map(str, measurement[:3]))}: {entry['result']}\n")
            known[measurement[:3]] = entry
    entries = [known[item[:3]] for item in MEASUREMENTS if item[:3] in known]
    FILE.parent.mkdir(exist_ok=True)
    FILE.write_text(json.dumps(entries, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
