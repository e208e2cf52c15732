"""Corpora in MiuLab's format (TC-Bot, MIT license): a safe reader, and ``bbq domains import``.

A corpus is a folder of Python 2 pickles. Unpickling can run any code, so the reader refuses every
global: only dicts, lists, texts and numbers can come out. Then it checks each file's form. The
command writes a corpus as a domain folder; its arguments supply what the files lack: the slot that
is booked, the slots that a booking needs, and those that never constrain the knowledge base.
"""

from __future__ import annotations

import argparse
import io
import pickle
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from os.path import expanduser
from pathlib import Path
from typing import Any, NoReturn

import yaml

from bbq_torchrl.domains.domain import Domain, DomainError, Fault, Goal, Source, sentences
from bbq_torchrl.domains.folder import (
    SPECIFICATION_FILE,
    VALUES_FILE,
    Corpus,
    content_of,
    fields_of,
    load_domain,
    read_text,
    save_data,
    shipped_domain,
)
from bbq_torchrl.domains.values import misspellings, plain, unlisted
from bbq_torchrl.settings import (
    MAPPING,
    REQUIRED,
    TEXT,
    TEXTS,
    Allowed,
    check,
    filled,
    one_of,
    setting,
)
from bbq_torchrl.utils import output
from bbq_torchrl.utils.files import write_text
from bbq_torchrl.utils.text import FaultsError, sentence

REFERENCE_SLOT_ERROR_PROB = 0.0581
"""The slot error probability (mode ``value``) at which the rule policy succeeds in 18.3 % of the
dialogues on the default files. At 0.058 it succeeded in 18.31 % of 500,000; the rate falls by
0.0119 per 0.01.
"""

_UNITS = {"records": "row", "goals": "goal", "error_values": "slot"}


def _has_keys(content: object, kind: type) -> bool:
    return isinstance(content, dict) and all(type(key) is kind for key in content)


_ROWS = Allowed("a dict with integers as keys", lambda content: _has_keys(content, int))
_LIST = Allowed("a list", lambda content: isinstance(content, list))
_LISTS = Allowed(
    "a dict of lists by slot, not empty", lambda content: bool(content) and _has_keys(content, str)
)
_BY_SLOT = Allowed(
    "a dict of texts by slot",
    lambda content: _has_keys(content, str) and all(map(TEXT.test, content.values())),
)
_REQUESTS = Allowed(
    "a dict of 'UNK' by slot",
    lambda content: _BY_SLOT.test(content) and all(map(one_of("UNK", "").test, content.values())),
)


@dataclass
class _Goal:
    """The keys of a goal."""

    diaact: str = setting(REQUIRED, one_of("request"), "the user's first act")
    inform_slots: Any = setting(REQUIRED, _BY_SLOT, "slot to value")
    request_slots: Any = setting(REQUIRED, _REQUESTS, "the slots asked for")


class _PlainUnpickler(pickle.Unpickler):
    """Unpickles plain data and refuses everything that imports or calls something."""

    def find_class(self, module: str, name: str) -> NoReturn:
        raise pickle.UnpicklingError(f"it refers to {module}.{name}, only plain data is allowed")

    def persistent_load(self, pid: Any) -> NoReturn:
        raise pickle.UnpicklingError(f"it refers to the outside object {pid!r}")


def load_miulab(
    path: str | Path,
    goals: str = "user_goals_first_turn_template.v2.p",
    kb: str = "movie_kb.1k.p",
    values: str = "dicts.v3.p",
    *,
    skip_unusable: bool = True,
) -> Domain:
    """Returns the movie domain with MiuLab's records, goals and values.

    Acts, slots, actions and policies are those of our movie domain. The few blank values of the
    corpus count as absent. Goals may have values that no record has: the corpus is not normalized,
    and some goals cannot be met.

    Some of the public files, though not the default ones, contain unusable entries: goals that
    constrain and request the same slot, or unknown slots. They are left out and listed in the
    domain's ``skipped``. Values that differ only in blanks and the like are kept although they
    never match.

    Args:
        path: the folder with the three files.
        goals: file with the list of user goals.
        kb: file with the knowledge base, row number to record.
        values: file with the possible values, slot to list.
        skip_unusable: whether unusable entries are left out rather than refused.

    Raises:
        FileNotFoundError: if the folder or one of the files is missing.
        ValueError: if a file is damaged or contains anything but plain data of the expected form,
            if no usable entry remains, or, without ``skip_unusable``, if an entry is unusable.
    """
    folder = Path(expanduser(path))
    files = {"records": folder / kb, "goals": folder / goals, "error_values": folder / values}
    if missing := [file.name for file in files.values() if not file.is_file()]:
        raise FileNotFoundError(
            f"the MiuLab folder {folder} lacks {', '.join(missing)}; a clone of TC-Bot has them in "
            "src/deep_dialog/data"
        )
    movie = shipped_domain("movie")
    own = {item.name: getattr(movie, item.name) for item in fields(movie)}
    own |= {"name": "miulab", "reference_slot_error_prob": REFERENCE_SLOT_ERROR_PROB}
    own |= {"folder": None}
    corpus = read_corpus(files, movie.ticket_slot)
    return fitted(own, corpus, files, skip_unusable=skip_unusable)


def read_corpus(files: Mapping[str, Path], ticket: str) -> Corpus:
    """Reads records, goals and lists of values, and checks each file's form.

    Args:
        files: the paths by ``records``, ``goals`` and ``error_values``.
        ticket: the slot that every goal requests; goals leave it implicit.

    Raises:
        FileNotFoundError: if a file is missing.
        ValueError: if a file is damaged or contains anything but plain data of the expected form.
    """
    records, goals, values = files["records"], files["goals"], files["error_values"]
    rows, lists = _read(records, _ROWS), _read(values, _LISTS)
    return {
        "records": {row: _texts(f"{records}: row {row}", rows[row]) for row in sorted(rows)},
        "goals": {
            number: _goal(f"{goals}: goal {number}", goal, ticket)
            for number, goal in enumerate(_read(goals, _LIST))
        },
        # A value listed twice stays twice, and is drawn twice as often.
        "error_values": {
            slot: tuple(text for text in check(f"{values}: {slot}", texts, TEXTS) if text.strip())
            for slot, texts in lists.items()
        },
    }


def fitted(
    own: Mapping[str, Any], corpus: Corpus, files: Mapping[str, Path], *, skip_unusable: bool
) -> Domain:
    """Returns the domain of a corpus, without the entries that cannot be used.

    Args:
        own: the domain's fields; those of the corpus replace them.
        corpus: the result of :func:`read_corpus`.
        files: the same as there; messages name them.
        skip_unusable: whether unusable entries are left out rather than refused.

    Raises:
        FaultsError: if the domain is inconsistent, if no usable entry remains, or, without
            ``skip_unusable``, if an entry is unusable.
    """
    usable, skipped = corpus, list[str]()
    while True:
        try:
            return Domain(**{**own, **content_of(usable), "skipped": tuple(skipped)})
        except DomainError as error:
            sources = {
                field: Source(files[field].name, unit, list(usable[field]))
                for field, unit in _UNITS.items()
            }
            left = _without(usable, error.found, own["slots"])
            skipped += sentences(error.found, sources)
            if left == usable or not skip_unusable:
                raise FaultsError(str(files["records"].parent), skipped) from error
            usable = left


def _without(corpus: Corpus, found: Iterable[Fault], slots: Sequence[str]) -> Corpus:
    """Returns the corpus without the faulty entries.

    A record loses only its unknown slots, a list only its faulty values.
    """
    left = {field: dict(entries) for field, entries in corpus.items()}
    for field, _, entry, value in found:
        if field not in corpus or entry is None:
            continue
        key = list(corpus[field])[entry] if isinstance(entry, int) else entry
        before, now = corpus[field][key], left[field][key]
        if field == "records" and not before.keys() <= {*slots}:
            left[field][key] = {slot: text for slot, text in before.items() if slot in slots}
        elif value is not None:
            left[field][key] = tuple(text for text in now or () if text != value)
        else:
            left[field][key] = None
    return {
        field: {key: entry for key, entry in entries.items() if entry}
        for field, entries in left.items()
    }


def read_plain_pickle(path: str | Path) -> Any:
    """Returns the dicts, lists, texts and numbers in a pickle file.

    Nothing else is imported, called or built. Byte strings of Python 2 are read as UTF-8. CRLF line
    ends, which Git or an editor on Windows put into some public copies, are undone.

    Raises:
        FileNotFoundError: if the file is missing.
        ValueError: if the file is not a pickle, is truncated, has bytes after its end, or refers to
            any class, function or outside object.
    """
    raw = Path(path).read_bytes()
    # Only protocol 0 starts a dict or list like this. It is text, in which a line end is never part
    # of a value; a binary pickle may contain the same two bytes as a length or a text.
    if raw.startswith((b"(d", b"(l")):
        raw = raw.replace(b"\r\n", b"\n").rstrip(b"\n")
    stream = io.BytesIO(raw)
    try:
        content = _PlainUnpickler(stream, encoding="utf-8").load()
    except Exception as error:  # a damaged pickle raises nearly anything, from KeyError to EOFError
        reason = sentence(error) or type(error).__name__
        raise ValueError(f"{path} is not a pickle of plain data: {reason}") from error
    if rest := len(stream.getbuffer()) - stream.tell():
        raise ValueError(f"{path} is not a pickle of plain data: {rest} bytes follow its end")
    return content


def _read(path: Path, allowed: Allowed) -> Any:
    return check(str(path), read_plain_pickle(path), allowed)


def _texts(where: str, content: object) -> dict[str, str]:
    """Returns the values by slot, without blank ones."""
    return {slot: text for slot, text in check(where, content, _BY_SLOT).items() if text.strip()}


def _goal(where: str, content: object, ticket: str) -> Goal:
    goal = filled(_Goal, check(where, content, MAPPING), f"{where}, ")
    requests = _texts("request_slots", goal.request_slots)
    return Goal(
        constraints=_texts("inform_slots", goal.inform_slots),
        requests=tuple(slot for slot in requests if slot != ticket),
    )


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
