"""``bbq chat``: talk with a trained agent in the terminal."""

from __future__ import annotations

if __name__ == "__main__":  # before anything that takes time to import
    from bbq_torchrl.utils import interruption

    interruption.listen()

import argparse
import io
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from bbq_torchrl.options.registry import load_folder
from bbq_torchrl.people.dialogue import RULES
from bbq_torchrl.settings import ConfigError
from bbq_torchrl.utils import output
from bbq_torchrl.utils.output import between, needed, page
from bbq_torchrl.utils.text import shown

_KEY = "BBQ_ENDPOINT_KEY"


@output.refusing
def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command line. Returns the exit code: 2 if refused."""
    given = _parser().parse_args(arguments)
    asks = "endpoint" in (given.nlu, given.nlg)
    if asks and not (given.url and given.model):
        raise ConfigError("--nlu endpoint and --nlg endpoint need --url and --model")
    rules = _rules(given.control)
    extras = {"rich": "chat", "prompt_toolkit": "chat"} | ({"httpx": "llm"} if asks else {})
    for library, extra in extras.items():
        needed(library, library, extra)  # before anything that takes time
    if given.config_dir is not None:
        load_folder(given.config_dir)

    import torch

    from bbq_torchrl.people.chat.terminal import Chat, console, prompt
    from bbq_torchrl.people.dialogue.judge import choose_goal
    from bbq_torchrl.people.dialogue.partner import Partner
    from bbq_torchrl.people.dialogue.spelling import Spelling
    from bbq_torchrl.people.dialogue.trained_agent import TrainedAgent
    from bbq_torchrl.people.language import (
        Endpoint,
        EndpointGenerator,
        EndpointUnderstander,
        Generator,
        Understander,
        load_phrases,
    )
    from bbq_torchrl.people.language.phrases import GENERIC, has_own_phrases
    from bbq_torchrl.people.language.understander import cached_understander

    torch.set_num_threads(1)
    endpoint = Endpoint(given.url, given.model, os.environ.get(_KEY, ""))
    screen = console()
    read = _lines() if given.plain or not sys.stdin.isatty() else prompt()
    agent = TrainedAgent(given.run, replica=given.replica, mode=given.mode, weights=given.weights)
    spelling = Spelling(agent.domain)
    goal = None if given.free else choose_goal(spelling.domain, given.goal, given.seed)
    if given.understander is not None:
        own = Understander.load(given.understander, agent.domain)
    else:
        own = cached_understander(agent.domain, given.labeled, screen.print)
    speak = Generator(spelling.domain)
    nlu = (
        EndpointUnderstander(endpoint, own, output.print_error) if given.nlu == "endpoint" else own
    )
    nlg = (
        EndpointGenerator(endpoint, speak, output.print_error) if given.nlg == "endpoint" else speak
    )
    partner = Partner(agent, nlu, nlg, spelling, ask_below=given.ask_below, rules=rules)
    names = load_phrases(agent.domain).names
    if not has_own_phrases(agent.domain):
        output.write(f"The domain {agent.domain.name} {GENERIC}.\n")
    is_piped = not sys.stdin.isatty()
    Chat(partner, goal, screen, names=names, seed=given.seed, echo=is_piped).run(read)
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = output.Parser(
        prog="bbq chat", description=f"Talk with a trained agent.\nSee {page('people')}"
    )
    parser.add_argument("run", help="a run folder, or shipped:<name>")
    about = parser.add_mutually_exclusive_group()
    about.add_argument("--goal", type=int, help="number of a goal, from 1; drawn unless given")
    about.add_argument("--free", action="store_true", help="talk without a goal")
    parser.add_argument("--seed", type=int, default=0, help="of goal, words and draws")
    parser.add_argument("--replica", type=int, default=0, help="which replica of the run talks")
    parser.add_argument("--mode", help="mean, average, draw or thompson, for a Bayesian agent")
    parser.add_argument("--weights", choices=("last", "best"), default="last")
    parser.add_argument(
        "--config-dir",
        metavar="FOLDER",
        help="of options of your own, as in bbq train; its Python is run",
    )
    parser.add_argument(
        "--ask-below",
        type=between(float, 0, 1),
        metavar="P",
        help="confidence below which it says back what it heard; 0: never",
    )
    parser.add_argument(
        "--control",
        default="all",
        metavar="RULES",
        help="rules between the agent's choice and the sentence: all (the default), none, or some "
        f"of {','.join(RULES)}",
    )
    parser.add_argument("--plain", action="store_true", help="read lines of standard input")
    source = parser.add_mutually_exclusive_group()
    source.add_argument(
        "--understander", type=Path, help="file of `bbq language train`; trained unless given"
    )
    source.add_argument("--labeled", type=Path, help="your labeled lines, learned as well")
    for name, help_ in (("--nlu", "who understands"), ("--nlg", "who speaks")):
        parser.add_argument(name, choices=("own", "endpoint"), default="own", help=help_)
    parser.add_argument("--url", help="of an OpenAI-compatible server, up to and with its /v1")
    parser.add_argument(
        "--model", help=f"the endpoint's; its key, if any, in the environment variable {_KEY}"
    )
    return parser


def _rules(text: str) -> tuple[str, ...]:
    """Returns the names of rules in ``all``, ``none`` or ``name,name``."""
    names = {"all": tuple(RULES), "none": ()}.get(text, tuple(text.split(",")))
    if not set(names) <= set(RULES):
        raise ConfigError(
            f"--control must be all, none, or some of {','.join(RULES)}, got {shown(text)}"
        )
    return names


def _lines() -> Callable[[], str | None]:
    """Returns a reader of lines from standard input, which accepts any bytes."""
    if isinstance(sys.stdin, io.TextIOWrapper):
        sys.stdin.reconfigure(errors="replace")

    def read() -> str | None:
        line = sys.stdin.readline()
        return line.rstrip("\n") if line else None

    return read


if __name__ == "__main__":
    sys.exit(main())
