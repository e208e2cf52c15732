"""``bbq language measure``, ``train`` and ``count``."""

from __future__ import annotations

if __name__ == "__main__":  # before anything that takes time to import
    from bbq_torchrl.utils import interruption

    interruption.listen()

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import torch

from bbq_torchrl.domains.folder import SHIPPED, named_domain
from bbq_torchrl.people.language.measure import (
    as_json,
    labeled_files,
    measure_round_trip,
    score,
    score_grammar,
    train_measured,
)
from bbq_torchrl.people.language.training_lines import read_lines
from bbq_torchrl.people.language.understander import SENTENCES
from bbq_torchrl.utils import output
from bbq_torchrl.utils.files import write_text

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence

    from tensordict.nn import TensorDictModuleBase

    from bbq_torchrl.domains import Domain

_DOMAIN = f"{', '.join(SHIPPED)}, or a domain's folder"


@output.refusing
def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command; returns 0, or 2 after a line that says what is wrong."""
    parser = output.Parser(prog="bbq language")
    commands = parser.add_subparsers(dest="command", required=True)
    for name, help_ in (
        ("train", "train an understander and write its file"),
        ("measure", "train an understander and measure it on labeled sentences"),
    ):
        command = commands.add_parser(name, help=help_)
        command.add_argument("--domain", default="movie", help=_DOMAIN)
        command.add_argument(
            "--sentences", type=int, default=SENTENCES, help="of people to learn from"
        )
        command.add_argument("--seed", type=int, default=0)
        command.add_argument("--labeled", type=Path, help="your labeled lines, learned as well")
        command.add_argument("--file", type=Path, help="where the understander goes")
        if name == "measure":
            command.add_argument("--data", type=Path, help="folder of labeled sentences")
            command.add_argument("--dialogues", type=int, default=10_000, help="for the round trip")
            command.add_argument("--out", type=Path, help="JSON file")
    count = commands.add_parser(
        "count", help="count what is misheard of simulated users, for env.errors=measured"
    )
    count.add_argument("--domain", default="movie", help=_DOMAIN)
    count.add_argument("--turns", type=int, default=100_000, help="of users, at least")
    count.add_argument("--seed", type=int, default=0)
    count.add_argument(
        "--trained", nargs="+", default=[], help="run folders or shipped:<name>, to play half of it"
    )
    given = parser.parse_args(arguments)
    domain = named_domain(given.domain)
    if given.command == "count":
        return _count(given, domain)
    lines = [] if given.labeled is None else read_lines(given.labeled, domain)
    data = given.data if given.command == "measure" else None
    files = {} if data is None else labeled_files(data, domain)
    understand, figures = train_measured(domain, given.sentences, given.seed, lines)
    if given.file is not None or given.command == "train":
        understand.save(given.file or f"{domain.name}.language.npz")
    if given.command == "train":
        return 0
    figures["grammar"] = score_grammar(understand, given.seed)
    figures |= {name: score(understand, own) for name, own in files.items()}
    text = as_json(figures | measure_round_trip(understand, given.dialogues, given.seed))
    output.write(text)
    if not files:
        output.print_error(
            "people's sentences were not measured: the domain has no labeled ones; name a folder "
            "with --data"
        )
    out = given.out or Path(f"{domain.name}.language.json")
    out.parent.mkdir(parents=True, exist_ok=True)
    write_text(out, text)
    return 0


def _count(given: argparse.Namespace, domain: Domain) -> int:
    # Imported here: the language layer is below the environments, and needs no TorchRL.
    from bbq_torchrl.envs.text_channel import count_errors, save_errors

    torch.set_num_threads(1)
    trained = {name: _agent(name, domain) for name in given.trained}
    counts = count_errors(domain, given.turns, seed=given.seed, trained=trained)
    assert domain.folder is not None
    file = save_errors(domain.folder, counts)
    output.write(f"{counts['turns']} turns counted: {file}\n")
    return 0


def _agent(name: str, domain: Domain) -> TensorDictModuleBase:
    """Returns the policy of a run folder or a shipped agent in a domain."""
    from bbq_torchrl import load_run

    run = load_run(name, dialogues=1)
    own = getattr(run.env, "domain", None)
    if own is None or own.action_names != domain.action_names or run.config.replicas != 1:
        raise ValueError(
            f"--trained must name runs of one replica in the domain {domain.name}, got {name}"
        )
    return run.policy


if __name__ == "__main__":
    sys.exit(main())
