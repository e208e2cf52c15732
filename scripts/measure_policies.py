"""Measures the scripted policies and the privileged one, and writes results/policies.json.

Plays every line of the table below as ``bbq evaluate`` does and keeps the command
beside its answer; ``scripts/write_docs.py`` makes the documentation's tables from them.

    python scripts/measure_policies.py                        our corpus
    python scripts/measure_policies.py --miulab <folder>      also the public MiuLab corpus
    python scripts/measure_policies.py --policy clairvoyant   this policy alone
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from bbq_torchrl.cli.evaluate import composed, evaluation

FILE = Path(__file__).resolve().parent.parent / "results" / "policies.json"

PLACE = "<folder>"
"""Placeholder for the folder of the MiuLab corpus in saved commands."""

GOALS_V1 = "user_goals_first_turn_template.part.movie.v1.p"
MIULAB = f"domain=miulab domain.path={PLACE}"
REFERENCE = "dialogues=100000 batch=4096"
SHORT = "dialogues=20000 batch=4096"

SCRIPTED = ("rule", "rule_inform", "careful_essential", "careful", "repair")
NO_ERROR, V1 = "env.slot_error_prob=0", f"domain.goals={GOALS_V1}"
SETTINGS: tuple[tuple[str, str, tuple[str, ...], tuple[str, ...]], ...] = (
    ("movie", "reference", (), (*SCRIPTED, "random", "clairvoyant")),
    ("movie", "no error", (NO_ERROR,), (*SCRIPTED, "clairvoyant")),
    ("miulab", "reference", (), (*SCRIPTED, "random", "clairvoyant")),
    ("miulab", "v2, error .05", ("env.slot_error_prob=.05",), ("rule",)),
    (
        "miulab",
        "v2, no error",
        (NO_ERROR,),
        ("rule", "rule_inform", "careful", "repair", "clairvoyant"),
    ),
    ("miulab", "v1, no error", (V1, NO_ERROR), (*SCRIPTED, "clairvoyant")),
    *(
        ("miulab", f"v1, error {error}", (V1, f"env.slot_error_prob={error}"), ("rule",))
        for error in (".05", ".10", ".20", ".30")
    ),
)
"""Corpus, name of the setting, its command-line arguments, and its policies."""

MEASUREMENTS = {
    (corpus, setting, policy): " ".join(
        [
            REFERENCE if (setting, policy) == ("reference", "rule") else SHORT,
            *([MIULAB] if corpus == "miulab" else []),
            *more,
        ]
    )
    for corpus, setting, more, policies in SETTINGS
    for policy in policies
}
"""Corpus, setting and policy -> command-line arguments besides the policy."""


def main() -> None:
    """Measures the selected entries, and keeps the other ones of the file."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--miulab", type=Path, help="folder of the MiuLab files")
    parser.add_argument("--policy", help="measure this policy alone")
    given = parser.parse_args()
    before = json.loads(FILE.read_text(encoding="utf-8")) if FILE.is_file() else []
    known = {(entry["corpus"], entry["setting"], entry["policy"]): entry for entry in before}
    for key, overrides in MEASUREMENTS.items():
        corpus, setting, policy = key
        if (given.miulab is None and corpus == "miulab") or given.policy not in (None, policy):
            continue
        command = f"policy={policy} {overrides}"
        arguments = command.replace(PLACE, str(given.miulab)).split()
        result = evaluation(composed(arguments))
        sys.stdout.write(f"{corpus}, {setting}, {policy}: {result}\n")
        known[key] = {
            "corpus": corpus,
            "setting": setting,
            "policy": policy,
            "command": f"bbq evaluate {command}",
            "result": result,
        }
    entries = [known[key] for key in MEASUREMENTS if key in known]
    FILE.write_text(json.dumps(entries, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
