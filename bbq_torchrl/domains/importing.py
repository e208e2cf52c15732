"""``python -m bbq_torchrl.domains import``: a domain folder from a corpus in MiuLab's format.

Arguments supply what the files lack: the slot that is booked, the slots that a booking needs, and
those that never constrain the knowledge base.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from bbq_torchrl.domains.cleaning import cleaned, only_in_goals
from bbq_torchrl.domains.faults import DomainError, Source
from bbq_torchrl.domains.files import SPECIFICATION_FILE, VALUES_FILE
from bbq_torchrl.domains.folder import load_domain, save_data
from bbq_torchrl.domains.miulab import fitted, read_corpus
from bbq_torchrl.domains.specification import ACTION_KINDS, Action, ScriptedPolicySpec
from bbq_torchrl.utils import output

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterable, Mapping, Sequence

    from bbq_torchrl.domains.domain import Domain
    from bbq_torchrl.domains.miulab import Corpus
    from bbq_torchrl.domains.specification import Goal

_SLOTLESS = ("greeting", "thanks", "deny", "confirm_question", "confirm_answer", "closing")
_TURN_WIDTH = 40


def main(arguments: Sequence[str]) -> int:
    """Runs the command line. Returns the exit code."""
    given = _parser().parse_args(arguments)
    domain, changes = import_corpus(**vars(given))  # the same names
    lines = [
        f"{given.folder}: {len(domain.records)} records, {len(domain.goals)} goals, "
        f"{len(domain.slots)} slots, {len(domain.actions)} actions",
        *changes,
        f"{SPECIFICATION_FILE}: reference_slot_error_prob is 0; `python -m bbq_torchrl.domains "
        f"calibrate domain=folder domain.path={given.folder}` finds the one for a success rate",
    ]
    output.write("".join(f"{line}\n" for line in lines))
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = output.Parser(
        prog="python -m bbq_torchrl.domains import",
        description="Writes a domain folder from a corpus in MiuLab's format (TC-Bot, DDQ, the "
        "Microsoft Dialogue Challenge), and reports what it left out or changed.",
    )
    for name, meaning in (
        ("slots", "text file with one slot per line"),
        ("acts", "text file with one dialogue act per line"),
        ("kb", "pickle: {row: {slot: value}}"),
        ("goals", "pickle: [{diaact, inform_slots, request_slots}]"),
        ("values", "pickle: {slot: [value]}, the values that an error can substitute"),
        ("folder", "output folder, new or empty"),
    ):
        parser.add_argument(name, type=Path, help=meaning)
    add = parser.add_argument
    add("--ticket", required=True, help="the slot that is booked, such as ticket or reservation")
    add(
        "--essential",
        required=True,
        type=_names,
        metavar="SLOTS",
        help="slots that a booking needs, separated by commas: the scripted policies request them "
        "in this order, and domain extension begins with them",
    )
    add(
        "--free",
        type=_names,
        default=(),
        metavar="SLOTS",
        help="slots that never constrain the knowledge base, such as the number of people",
    )
    add("--complete", default="taskcomplete", help="the slot whose inform offers the booking")
    add(
        "--opening",
        type=_names,
        default=(),
        metavar="SLOTS",
        help="slots that users inform in their first turn",
    )
    add(
        "--without",
        type=_names,
        default=(),
        metavar="SLOTS",
        help="slots to remove from goals, records and values, such as greeting",
    )
    add("--name", help="name of the domain; by default that of its folder")
    return parser


def _names(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(",") if name.strip())


def import_corpus(
    folder: str | Path,
    *,
    slots: str | Path,
    acts: str | Path,
    kb: str | Path,
    goals: str | Path,
    values: str | Path,
    ticket: str,
    essential: Sequence[str],
    free: Sequence[str] = (),
    complete: str = "taskcomplete",
    opening: Sequence[str] = (),
    without: Sequence[str] = (),
    name: str | None = None,
) -> tuple[Domain, list[str]]:
    """Writes a domain folder from a corpus in MiuLab's format.

    The agent can request every ordinary slot that users constrain or request, and inform every slot
    that records have. Domain extension adds the slots that are not essential, those named by most
    goals first. Values that differ only in blanks, quotes and the like get their most frequent
    spelling.

    Args:
        folder: output folder, new or empty.
        slots: text file with one slot per line.
        acts: text file with one dialogue act per line.
        kb: pickle of the records.
        goals: pickle of the users' goals.
        values: pickle of the lists of values.
        ticket: the slot that is booked.
        essential: the slots that a booking needs, in the order in which policies request them.
        free: the slots that never constrain the records.
        complete: the slot whose inform offers a booking. Defaults to ``"taskcomplete"``.
        opening: the slots that users inform in their first turn.
        without: slots to remove from goals, records and values.
        name: name of the domain. Defaults to the name of the folder.

    Returns:
        The domain as loaded from the new folder, and a sentence for each kind of change.

    Raises:
        FileNotFoundError: if a file is missing.
        ValueError: if a file is damaged, an argument names an unknown slot, the folder is not
            empty, or no usable entry remains.
    """
    folder = Path(folder)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise ValueError(f"folder must be new or empty, got {folder}, which exists already")
    listed, changes = _lines_of(Path(slots))
    allowed, more = _lines_of(Path(acts))
    changes += more
    for key, names in {
        "ticket": (ticket,),
        "complete": (complete,),
        "essential": essential,
        "free": free,
        "opening": opening,
        "without": without,
    }.items():
        if unknown := [slot for slot in names if slot not in listed]:
            raise ValueError(
                f"{key} must name slots of {slots}, got {', '.join(unknown)}; the slots are "
                f"{', '.join(listed)}"
            )
    files = {"records": Path(kb), "goals": Path(goals), "error_values": Path(values)}
    corpus = read_corpus(files, allowed, ticket)
    special = (ticket, complete)
    corpus, more = cleaned(corpus, files, (*special, *without))
    changes += more
    core = tuple(slot for slot in essential if slot not in special)
    specification = {
        "name": name or folder.resolve().name,
        "acts": allowed,
        "slots": listed,
        **_agent(corpus, allowed, listed, special, core),
        "free_slots": (*(slot for slot in free if slot not in special), *special),
        "ticket_slot": ticket,
        "complete_slot": complete,
        "opening_slot": opening or None,
        "turn_width": _TURN_WIDTH,
        "reference_slot_error_prob": 0.0,
    }
    domain = fitted(specification, corpus, files, "the corpus", skip_unusable=True)
    extra = only_in_goals(domain)
    changes += [
        *domain.skipped,
        *(
            f"{VALUES_FILE}: values of {slot} that only goals have are added: {len(texts)}"
            for slot, texts in extra.items()
        ),
    ]
    lists = {
        slot: (*domain.error_values.get(slot, ()), *extra.get(slot, ()))
        for slot in listed
        if slot in domain.error_values or slot in extra
    }
    folder.mkdir(parents=True, exist_ok=True)
    text = yaml.safe_dump(
        _plain(specification),
        sort_keys=False,
        width=100,
        allow_unicode=True,
        default_flow_style=None,
    )
    (folder / SPECIFICATION_FILE).write_text(text, encoding="utf-8", newline="\n")
    columns = [slot for slot in listed if any(slot in record for record in domain.records)]
    save_data(folder, columns, domain.records, domain.goals, lists)
    return load_domain(folder), changes


def _lines_of(path: Path) -> tuple[tuple[str, ...], list[str]]:
    """Returns the distinct names in a text file, and a sentence about repeated ones."""
    source = Source(path)
    text = source.text()
    if text is None:
        raise DomainError(str(path), source.faults)
    counts = Counter(line.strip() for line in text.splitlines() if line.strip())
    if not counts:
        raise ValueError(f"{path} must have one name per line, got an empty file")
    twice = [name for name, count in counts.items() if count > 1]
    changes = [f"{path.name}: {', '.join(twice)} is listed more than once"] if twice else []
    return tuple(counts), changes


def _agent(
    corpus: Corpus,
    acts: Sequence[str],
    slots: Sequence[str],
    special: tuple[str, str],
    essential: tuple[str, ...],
) -> dict[str, Any]:
    """Returns the fields about the agent: actions, order of slots and policies."""
    ticket, complete = special
    goals: Iterable[Goal] = corpus["goals"].values()
    wanted = Counter(slot for goal in goals for slot in (*goal.constraints, *goal.requests))
    found = {slot for record in corpus["records"].values() for slot in record}
    rest = [slot for slot in slots if slot not in (*special, *essential)]
    order = sorted(
        (slot for slot in rest if slot in found or slot in wanted),
        key=lambda slot: -wanted[slot],
    )
    known = (*essential, *order)
    requests = [slot for slot in known if wanted[slot] or slot in essential]
    informs = [slot for slot in known if slot in found]
    offer = (f"inform({complete})", "thanks")
    rule = (*(f"request({slot})" for slot in essential), *offer)
    return {
        "actions": (
            *(Action(act) for act in _SLOTLESS if act in acts),
            *(Action("request", slot) for slot in requests),
            *(Action("inform", slot) for slot in (*informs, complete, ticket)),
        ),
        "essential": (*essential, *special),
        "extension_order": tuple(slot for slot in order if slot in {*requests, *informs}),
        "policies": {
            "rule": ScriptedPolicySpec("script", rule),
            "careful_essential": ScriptedPolicySpec("careful", essential),
            "careful": ScriptedPolicySpec("careful", tuple(requests)),
        },
    }


def _plain(specification: Mapping[str, Any]) -> dict[str, Any]:
    """Returns a specification in the form of ``domain.yaml``."""
    actions: dict[str, list[str]] = {kind: [] for kind in ACTION_KINDS}
    for action in specification["actions"]:
        actions[action.kind].append(action.slot or action.act)
    policies = {
        name: {"kind": policy.kind, "steps": list(policy.steps)}
        for name, policy in specification["policies"].items()
    }
    lists = {
        key: list(value) if isinstance(value, tuple) else value
        for key, value in specification.items()
    }
    return lists | {"actions": actions, "policies": policies}
