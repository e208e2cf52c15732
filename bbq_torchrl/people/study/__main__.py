"""``bbq study``: serve, simulate and report a study, keep its data, compute its power."""

from __future__ import annotations

if __name__ == "__main__":  # before anything that takes time to import
    from bbq_torchrl.utils import interruption

    interruption.listen()

import argparse
import os
import pkgutil
import socket
import sys
from collections.abc import Callable, Sequence
from contextlib import closing, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from bbq_torchrl.people.study.plan import Address, data_of, load_study
from bbq_torchrl.utils import interruption, output
from bbq_torchrl.utils.output import between, needed, page
from bbq_torchrl.utils.text import sentence, shown

TALKER = "bbq_torchrl.people.study.players:make_talker"
USERS = "bbq_torchrl.people.study.players:make_users"
"""Names, not imports: the study depends on neither networks nor language."""


@output.refusing
def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command line. Returns the exit code: 2 if refused."""
    given = _parser().parse_args(arguments)
    before = os.umask(0o077)  # texts and secrets are for their owner alone
    try:
        given.command(given)
    finally:
        os.umask(before)
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = output.Parser(prog="bbq study", description=f"A human study.\nSee {page('people')}")
    commands = parser.add_subparsers(
        required=True, metavar="serve | simulate | report | participants | backup | forget | power"
    )

    def add(name: str, run: Callable[[argparse.Namespace], None], meaning: str) -> Any:
        command = commands.add_parser(name, help=meaning)
        command.set_defaults(command=run)
        if name != "power":
            command.add_argument("study", type=Path, help="the study file; its data is next to it")
        if name in ("serve", "simulate"):
            talker = "module:function that makes the talker of a study; by default of run folders"
            command.add_argument("--talker", default=TALKER, help=talker)
        if name in ("simulate", "report"):
            command.add_argument("--out", type=Path, help="folder; by default next to the file")
        if name in ("simulate", "power"):
            seed = between(int, 0, 2**32 - 1)
            command.add_argument("--seed", type=seed, default=0, help="the random seed")
        return command

    serve = add("serve", _serve, "serve a study to browsers")
    serve.add_argument("--host", default="127.0.0.1", help="address to listen at")
    port = between(int, 1, 65_535)
    serve.add_argument("--port", type=port, default=8000, help="port to listen at")

    meaning = "play the study with simulated users, in files named -simulated, and report it"
    add("simulate", _simulate, meaning)
    add("report", _report, "write report, figures and data")
    add("participants", _participants, "write who takes part, by the ids of the join link")
    backup = add("backup", _backup, "copy the data, also while the study is served")
    backup.add_argument("copy", type=Path, help="the copy, a file that does not exist")
    forget = add("forget", _forget, "delete all that a person said and rated")
    forget.add_argument("participant", help="the number on your page, or the person's link")

    power = add("power", _power, "how likely a study finds a difference")
    rate, count = between(float, 0.001, 0.999), between(int, 1, 1_000)
    power.add_argument("better", type=rate, help="success of one agent")
    power.add_argument("worse", type=rate, help="success of the other")
    power.add_argument("people", type=between(int, 1, 100_000), help="people; each meets both")
    power.add_argument("--sessions", type=count, default=1, help="of a person with each agent")
    power.add_argument("--pairs", type=count, default=1, help="pairs declared")
    spread = "standard deviation between participants, in log-odds"
    power.add_argument("--person-sd", type=between(float, 0.0, 10.0), default=1.0, help=spread)
    power.add_argument("--simulations", type=between(int, 100, 1_000_000), default=4_000)
    return parser


def _serve(given: argparse.Namespace) -> None:
    for library in ("starlette", "jinja2", "uvicorn"):
        needed(library, library, "study")
    with listen(given.host, given.port) as listener:  # before anything that takes time
        make = _function(given.talker)
        study = load_study(given.study)
        output.print_error(f"loading the agents {', '.join(study.terms.agents)} ...")
        talker = make(study)
        interruption.tell(lambda: "while serving", lambda: "the same command continues the study")
        import uvicorn

        from bbq_torchrl.people.study.storage import Store
        from bbq_torchrl.people.study.web import JOIN, RESEARCHER, application

        host = f"[{given.host}]" if ":" in given.host else given.host
        address = Address.of(study.terms.url or f"http://{host}:{given.port}")
        with closing(Store(study, talker)) as store, suppress(KeyboardInterrupt):
            _say(f"for people: {address.link(f'/join/{store.key(JOIN)}')}")
            _say(f"for you: {address.link(f'/r/{store.key(RESEARCHER)}')}")
            config = uvicorn.Config(
                application(study, store, talker),
                # The links are secret, so they must not be logged.
                access_log=False,
                log_level="warning",
                server_header=False,
                proxy_headers=False,
                limit_concurrency=1_000,
                # Longer than people think, so that no message arrives as its connection closes.
                timeout_keep_alive=120,
                timeout_graceful_shutdown=10,
            )
            uvicorn.Server(config).run(sockets=[listener])


def listen(host: str, port: int) -> socket.socket:
    """Returns a listening socket; clients that connect wait until they are served.

    Raises:
        ValueError: it cannot listen there.
    """
    try:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        return socket.create_server((host, port), family=family)
    except (OSError, UnicodeError) as error:  # UnicodeError: an invalid host name
        text = f"--host {shown(host)} and --port {port} cannot be served: {sentence(error)}"
        raise ValueError(text) from error


def _simulate(given: argparse.Namespace) -> None:
    make_talker = _function(given.talker)
    make_users = _function(USERS)
    study = load_study(given.study)
    from bbq_torchrl.people.study.conversations import simulate

    # A separate name: the study's data file is for participants.
    given.study = given.study.with_stem(f"{given.study.stem}-simulated")
    study = replace(study, path=given.study)
    interruption.tell(lambda: "while simulating", lambda: "the same command continues it")
    simulate(study, make_talker(study), make_users(study), seed=given.seed, tell=_say)
    _report(given)


def _function(name: str) -> Any:
    try:
        return pkgutil.resolve_name(name)
    except (ImportError, AttributeError, ValueError) as error:
        text = f"--talker must be module:function, got {shown(name)}: {error}"
        raise ValueError(text) from error


def _report(given: argparse.Namespace) -> None:
    from bbq_torchrl.people.study.outcomes import read_outcomes
    from bbq_torchrl.people.study.report import write_report

    outcomes = read_outcomes(data_of(given.study))
    folder = given.out or given.study.with_name(f"{given.study.stem}-report")
    write_report(folder, outcomes)
    _say(f"{len(outcomes.sessions)} ended sessions: {folder / 'report.md'}")


def _participants(given: argparse.Namespace) -> None:
    from bbq_torchrl.people.study.export import export_participants

    file = given.study.with_name(f"{given.study.stem}-participants.csv")
    people = export_participants(file, data_of(given.study))
    _say(f"{people} people: {file}; it tells who is who in the report, so keep them apart")


def _backup(given: argparse.Namespace) -> None:
    from bbq_torchrl.people.study.export import backup

    backup(data_of(given.study), given.copy)
    _say(f"copied to {given.copy}, with texts and the secret of all links: keep it as safe")


def _forget(given: argparse.Namespace) -> None:
    from bbq_torchrl.people.study.export import forget

    number = forget(data_of(given.study), given.participant)
    _say(f"person {number} is forgotten; copies and reports made before still have them")


def _power(given: argparse.Namespace) -> None:
    from bbq_torchrl.people.study.outcomes import power

    found = power(**{name: value for name, value in vars(given).items() if name != "command"})
    _say(f"power of the report's test: {found:.3f}")
    _say(f"standard error: at most {0.5 / given.simulations**0.5:.3f}")


def _say(line: str) -> None:
    output.write(f"{line}\n")


if __name__ == "__main__":
    sys.exit(main())
