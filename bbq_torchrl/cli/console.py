"""The console command ``bbq``, with the project's commands as subcommands."""

from __future__ import annotations

import importlib
import sys

from bbq_torchrl import __version__
from bbq_torchrl.utils import interruption, output
from bbq_torchrl.utils.text import shown

COMMANDS = {
    "train": ("bbq_torchrl.runs.train", "train an agent and evaluate it, or many (--multirun)"),
    "evaluate": ("bbq_torchrl.cli.evaluate", "play dialogues with a run or a scripted policy"),
    "search": ("bbq_torchrl.search", "search for hyper-parameters"),
    "report": ("bbq_torchrl.evaluation.compare_runs", "compare finished runs over their seeds"),
    "bench": ("bbq_torchrl.cli.bench", "compare agents on domains, error levels and seeds"),
    "domains": ("bbq_torchrl.cli.calibrate", "import a corpus as a domain, calibrate a domain"),
    "language": (
        "bbq_torchrl.people.language.__main__",
        "understand and speak sentences, and measure it",
    ),
    "chat": ("bbq_torchrl.people.chat.__main__", "talk with a trained agent in the terminal"),
    "study": ("bbq_torchrl.people.study.__main__", "have people talk with agents and rate them"),
}
"""Subcommand -> the module of its ``main``, and its help."""


def main() -> int | None:
    """Runs ``bbq <command> ...``. Returns the exit code."""
    arguments = sys.argv[1:]
    if not arguments or arguments[0] in ("-h", "--help"):
        output.write(_usage())
        return 0
    if arguments[0] == "--version":
        output.write(f"{__version__}\n")
        return 0
    name = arguments[0]
    if name not in COMMANDS:
        output.print_error(
            f"error: the command must be one of {', '.join(COMMANDS)}, got {shown(name)}"
        )
        return 2
    interruption.tell(lambda: f"in bbq {name}", lambda: "the same command starts again")
    interruption.listen()
    module = importlib.import_module(COMMANDS[name][0])
    sys.argv[1:] = arguments[1:]
    code: int | None = module.main()
    return code


def _usage() -> str:
    lines = [f"  {name:<10} {meaning}" for name, (_, meaning) in COMMANDS.items()]
    return "\n".join(["usage: bbq <command> ...", "", *lines, "", "bbq <command> --help", ""])


if __name__ == "__main__":
    sys.exit(main())
