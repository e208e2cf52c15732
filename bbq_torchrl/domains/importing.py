"""``bbq domains import``: a domain folder from a corpus in MiuLab's format.

Arguments supply what the files lack: the slot that is booked, the slots that a booking needs, and
those that never constrain the knowledge base.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from bbq_torchrl.domains.domain import Goal
from bbq_torchrl.domains.folder import (
    SPECIFICATION_FILE,
    VALUES_FILE,
    content_of,
    fields_of,
    load_domain,
    read_text,
    save_data,
)
from bbq_torchrl.domains.miulab import fitted, read_corpus
from bbq_torchrl.domains.values import misspellings, plain, unlisted
from bbq_torchrl.settings import check, one_of
from bbq_torchrl.utils import output
from bbq_torchrl.utils.files import write_text

if TYPE_CHECKING:
    import argparse
    from collections.abc import Mapping, Sequence

    from bbq_torchrl.domains.domain import Domain
    from bbq_torchrl.domains.folder import Corpus

_FILES = {
    "slots": "text file with one slot per line",
    "acts": "text file with one dialogue act per line",
    "kb": "pickle: {row: {slot: value}}",
    "goals": "pickle: [{diaact, inform_slots, request_slots}]",
    "values": "pickle: {slot: [value]}, the values that an error can substitute",
}
_SLOTLESS = ("greeting", "thanks", "deny", "confirm_question", "confirm_answer", "closing")
_TURN_WIDTH = 40


def main(arguments: Sequence[str]) -> int:
    """Runs the command line. Returns the exit code."""
    given = _parser().parse_args(arguments)
    domain, changes = _import(given)
    lines = [
        f"{given.folder}: {len(domain.records)} records, {len(domain.goals)} goals, "
        f"{len(domain.slots)} slots, {len(domain.actions)} actions",
        *changes,
        f"{SPECIFICATION_FILE}: reference_slot_error_prob is 0; `bbq domains calibrate "
        f"domain=folder domain.path={given.folder}` finds the one for a success rate",
    ]
    output.write("".join(f"{line}\n" for line in lines))
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = output.Parser(
        prog="bbq domains import",
        description="Writes a domain folder from a corpus in MiuLab's format (TC-Bot, DDQ, the "
        "Microsoft Dialogue Challenge), and reports what it left out or changed.",
    )
    add = parser.add_argument
    for name, meaning in _FILES.items():
        add(name, type=Path, help=meaning)
    add("folder", type=Path, help="output folder, new or empty")
    add("--ticket", required=True, help="the slot that is booked, such as ticket or reservation")
    add("--complete", default="taskcomplete", help="the slot whose inform offers the booking")
    for option, meaning in (
        (
            "--essential",
            "slots that a booking needs, separated by commas: the scripted policies request them "
            "in this order, and domain extension begins with them",
        ),
        ("--free", "slots that never constrain the knowledge base, such as the number of people"),
        ("--opening", "slots that users inform in their first turn"),
        ("--without", "slots to remove from goals, records and values, such as greeting"),
    ):
        required = option == "--essential"
        add(option, required=required, type=_names, default=(), metavar="SLOTS", help=meaning)
    add("--name", help="name of the domain; by default that of its folder")
    return parser


def _names(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(",") if name.strip())


def _import(given: argparse.Namespace) -> tuple[Domain, list[str]]:
    """Writes the domain folder. Returns the domain, and a sentence for each kind of change.

    The agent can request every ordinary slot that users constrain or request, and inform every slot
    that records have. Domain extension adds the slots that are not essential, those named by most
    goals first. Values that differ only in blanks, quotes and the like get their most frequent
    spelling.
    """
    folder, special = given.folder, (given.ticket, given.complete)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise ValueError(f"folder must be new or empty, got {folder}, which exists already")
    slots, acts = _names_in(given.slots), _names_in(given.acts)
    for key in ("ticket", "complete", "essential", "free", "opening", "without"):
        names = getattr(given, key)
        for slot in (names,) if isinstance(names, str) else names:
            check(f"a slot of {key}", slot, one_of(*slots))
    core = tuple(slot for slot in given.essential if slot not in special)
    pickles = {"records": "kb", "goals": "goals", "error_values": "values"}
    data = {field: getattr(given, key) for field, key in pickles.items()}
    corpus, changes = _cleaned(read_corpus(data, given.ticket), {*special, *given.without})
    specification = {
        "name": given.name or folder.resolve().name,
        "acts": list(acts),
        "slots": list(slots),
        **_agent(corpus, acts, slots, special, core),
        "free_slots": [*(slot for slot in given.free if slot not in special), *special],
        "ticket_slot": given.ticket,
        "complete_slot": given.complete,
        "opening_slot": list(given.opening) or None,
        "turn_width": _TURN_WIDTH,
        "reference_slot_error_prob": 0.0,
    }
    domain = fitted(fields_of(specification), corpus, data, skip_unusable=True)
    changes += [f"left out: {text}" for text in domain.skipped]
    lists = {slot: [*texts] for slot, texts in domain.error_values.items()}
    added: dict[str, dict[str, str]] = {}
    for _, slot, value in unlisted(domain.records, domain.goals, domain.error_values):
        added.setdefault(slot, {}).setdefault(plain(value), value)
    for slot, texts in added.items():
        lists.setdefault(slot, []).extend(texts.values())
        changes.append(f"{VALUES_FILE}: {len(texts)} values of {slot} are added from goals")
    folder.mkdir(parents=True, exist_ok=True)
    text = yaml.safe_dump(
        specification, sort_keys=False, width=100, allow_unicode=True, default_flow_style=None
    )
    write_text(folder / SPECIFICATION_FILE, text)
    columns = [slot for slot in slots if any(slot in record for record in domain.records)]
    save_data(folder, columns, domain.records, domain.goals, lists)
    return load_domain(folder), changes


def _names_in(path: Path) -> tuple[str, ...]:
    """Returns the distinct names in a text file."""
    names = dict.fromkeys(line.strip() for line in read_text(path).splitlines() if line.strip())
    if not names:
        raise ValueError(f"{path} must have one name per line, got an empty file")
    return tuple(names)


def _cleaned(corpus: Corpus, out: set[str]) -> tuple[Corpus, list[str]]:
    """Returns a corpus with single blanks, and with every value in its most frequent spelling.

    Args:
        corpus: records, goals and lists of values.
        out: slots to remove everywhere.

    Returns:
        The corpus, and a sentence for each kind of change.
    """
    usual = {(item.slot, item.text): item.usual for item in misspellings(**content_of(corpus))}
    changed: Counter[str] = Counter()

    def spelled(slot: str, text: str) -> str:
        new = " ".join(usual.get((slot, text), text).split())
        changed[slot] += new != text
        return new

    def kept(entry: Mapping[str, str]) -> dict[str, str]:
        return {slot: spelled(slot, text) for slot, text in entry.items() if slot not in out}

    after: Corpus = {
        "records": {row: kept(record) for row, record in corpus["records"].items()},
        "goals": {
            number: Goal(
                kept(goal.constraints), tuple(slot for slot in goal.requests if slot not in out)
            )
            for number, goal in corpus["goals"].items()
        },
        "error_values": {
            slot: tuple(spelled(slot, text) for text in texts)
            for slot, texts in corpus["error_values"].items()
            if slot not in out
        },
    }
    return after, [
        f"{count} values of {slot} are respelled as most often, with single blanks"
        for slot, count in changed.items()
        if count
    ]


def _agent(
    corpus: Corpus,
    acts: Sequence[str],
    slots: Sequence[str],
    special: tuple[str, str],
    essential: tuple[str, ...],
) -> dict[str, Any]:
    """Returns the keys of ``domain.yaml`` about the agent: actions, order of slots, policies."""
    ticket, complete = special
    goals = corpus["goals"].values()
    wanted = Counter(slot for goal in goals for slot in (*goal.constraints, *goal.requests))
    found = {slot for record in corpus["records"].values() for slot in record}
    rest = [slot for slot in slots if slot not in (*special, *essential)]
    order = sorted(
        (slot for slot in rest if slot in found or slot in wanted),
        key=lambda slot: -wanted[slot],
    )
    known = (*essential, *order)
    requests = [slot for slot in known if wanted[slot] or slot in essential]
    rule = [*(f"request({slot})" for slot in essential), f"inform({complete})", "thanks"]
    return {
        "actions": {
            "act": [act for act in _SLOTLESS if act in acts],
            "request": requests,
            "inform": [*(slot for slot in known if slot in found), complete, ticket],
            "multiple_choice": [],
        },
        "essential": [*essential, *special],
        "extension_order": [slot for slot in order if slot in {*requests, *found}],
        "policies": {
            "rule": {"kind": "script", "steps": rule},
            "careful_essential": {"kind": "careful", "steps": list(essential)},
            "careful": {"kind": "careful", "steps": list(requests)},
            "repair": {"kind": "repair", "steps": list(requests)},
        },
    }
