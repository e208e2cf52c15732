"""Imports the public MiuLab movie-booking corpus (TC-Bot, MIT license) without trusting it.

The corpus is a folder of Python 2 pickles. A pickle is a program: loaded plainly it can run
anything. The reader here refuses every global, so that nothing but dicts, lists, texts and
numbers can come out, and then checks each file's form.
"""

from __future__ import annotations

import io
import pickle
from os.path import expanduser
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from bbq_torchrl.checks import TEXT, check
from bbq_torchrl.domains.domain import Domain
from bbq_torchrl.domains.faults import DomainError, Fault, tell
from bbq_torchrl.domains.folder import MOVIE_FOLDER
from bbq_torchrl.domains.parts import Goal
from bbq_torchrl.domains.specification import SPECIFICATION_FILE, read_specification
from bbq_torchrl.domains.spelling import DIFFERENCE, misspellings
from bbq_torchrl.domains.tables import NEEDS_VALUES
from bbq_torchrl.utils.text import sentence, shown

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

REFERENCE_SLOT_ERROR_PROB = 0.0581
"""The slot error probability (mode ``value``) at which the rule policy succeeds in 18.3 % of the
dialogues on the default files: 18.31 % of 500,000 at 0.058, and 0.0119 less for every 0.01 more.
"""

_GOAL_KEYS = {"diaact", "inform_slots", "request_slots"}
_UNKNOWN = "UNK"

Corpus = dict[str, dict[Any, Any]]
"""Records, goals and lists of values, by the numbers and names that they have in the files."""

_UNITS = {"records": "row", "goals": "goal", "error_values": "slot"}


class _PlainUnpickler(pickle.Unpickler):
    """Unpickles plain data and refuses whatever would import or call something."""

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

    Acts, slots, actions and policies are those of our movie domain. Blank values, of which the
    corpus has a few, count as absent. A value that only a goal has is allowed: the corpus is not
    normalized, and some goals cannot be met.

    Some of the public files hold a few entries that are none: goals that constrain and request the
    same slot, slots that no list of slots has. They are left out, and ``skipped`` of the domain
    says how many and which. The default files have none. Values that differ only in blanks and the
    like stay as they are, and never match; ``doubts`` says where.

    Args:
        path: the folder that holds the three files.
        goals: file with the list of user goals.
        kb: file with the knowledge base, row number to record.
        values: file with the possible values, slot to list.
        skip_unusable: whether such entries are left out; otherwise they are refused.

    Raises:
        FileNotFoundError: if the folder or one of the files is missing.
        ValueError: if a file is damaged or holds anything but plain data of the expected form, if
            no entry is left, or, without ``skip_unusable``, if one cannot be used.
    """
    folder = Path(expanduser(path))
    if missing := [name for name in (goals, kb, values) if not (folder / name).is_file()]:
        raise FileNotFoundError(f"the MiuLab folder {folder} lacks {missing}")
    specification = read_specification(MOVIE_FOLDER / SPECIFICATION_FILE).content
    specification |= {
        "name": "miulab",
        "reference_slot_error_prob": REFERENCE_SLOT_ERROR_PROB,
    }
    files = {"records": folder / kb, "goals": folder / goals, "error_values": folder / values}
    corpus = read_corpus(files, specification["acts"], specification["ticket_slot"])
    return fitted(specification, corpus, files, str(folder), skip_unusable=skip_unusable)


def read_corpus(files: Mapping[str, Path], acts: Sequence[str], ticket: str) -> Corpus:
    """Reads records, goals and lists of values, and checks each file's form.

    Args:
        files: by ``records``, ``goals`` and ``error_values``.
        acts: those that goals may have.
        ticket: the slot that every goal requests, which is left out of them.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if a file is damaged or holds anything but plain data of the expected form.
    """
    goals = files["goals"]
    return {
        "records": _records(files["records"]),
        "goals": {
            number: _goal(f"{goals}: goal {number}", entry, acts, ticket)
            for number, entry in enumerate(_expect(goals, read_plain_pickle(goals)))
        },
        "error_values": _values(files["error_values"]),
    }


def fitted(
    specification: Mapping[str, Any],
    corpus: Corpus,
    files: Mapping[str, Path],
    where: str,
    *,
    skip_unusable: bool,
) -> Domain:
    """Returns the domain of a corpus; entries that cannot be used are left out and named.

    Args:
        specification: all fields of the domain but those of the corpus.
        corpus: of :func:`read_corpus`.
        files: as there; their names stand in what is said.
        where: what is said to have faults.
        skip_unusable: whether entries are left out; otherwise they are refused.

    Raises:
        DomainError: if the specification does not fit together, if no entry is left, or, without
            ``skip_unusable``, if one cannot be used.
    """
    names = {field: path.name for field, path in files.items()}
    faults: list[Fault] = []
    usable = corpus
    while True:
        try:
            return Domain(
                **specification,
                records=tuple(usable["records"].values()),
                goals=tuple(usable["goals"].values()),
                error_values=usable["error_values"],
                skipped=(*_changes(names, corpus, usable), *tell(faults)) if faults else (),
                doubts=tuple(tell(dict.fromkeys(_misspelled(names, usable)))),
            )
        except DomainError as error:
            if own := [fault for fault in error.found if fault.place[0] not in names]:
                raise DomainError(where, own) from error
            for fault in error.found:
                field, *which = fault.place
                name = str(field)
                number = _key(usable, name, which) if name != "error_values" else None
                faults.append(fault._replace(file=names[name], unit=_UNITS[name], number=number))
            left = _without(usable, error.found, specification["slots"])
            if not skip_unusable or left == usable:
                raise DomainError(where, faults) from error
            usable = left


def _key(corpus: Corpus, name: str, which: Sequence[str | int]) -> Any:
    """Returns what the file calls the entry that a place of the domain is in; ``None`` for none."""
    if name == "error_values" or not which:
        return which[0] if which else None
    return list(corpus[name])[int(which[0])]


def _without(corpus: Corpus, found: Iterable[Fault], slots: Sequence[str]) -> Corpus:
    """Returns the corpus without what the faults are about.

    Of a record with unknown slots only these are left out, of a list only the values named.
    """
    left = {name: dict(entries) for name, entries in corpus.items()}
    for (field, *which), *_ in found:
        name = str(field)
        key = _key(corpus, name, which)
        if key is None:
            continue
        before, entry = corpus[name][key], left[name][key]
        if name == "records":
            known = {slot: text for slot, text in before.items() if slot in slots}
            left[name][key] = known if len(known) < len(before) else None
        elif name == "error_values" and len(which) > 1 and entry:
            left[name][key] = tuple(text for text in entry if text != which[1])
        else:
            left[name][key] = None
    return {
        name: {key: entry for key, entry in entries.items() if entry}
        for name, entries in left.items()
    }


def _changes(files: Mapping[str, str], whole: Corpus, left: Corpus) -> Iterator[str]:
    """Yields how many entries of each file were changed."""
    for name, before in whole.items():
        unlike = sum(left[name].get(key) != entry for key, entry in before.items())
        if unlike:
            entries = f"{unlike} of {len(before)} {_UNITS[name]}s"
            yield f"{files[name]}: {entries} are left out or in part"


def _misspelled(files: Mapping[str, str], corpus: Corpus) -> Iterator[Fault]:
    """Yields where values never match others; an example for each file."""
    texts: dict[str, str] = {}
    for item in misspellings(
        tuple(corpus["records"].values()), tuple(corpus["goals"].values()), corpus["error_values"]
    ):
        field, *which = item.place
        name = str(field)
        text = f"some values differ from others of their slot {DIFFERENCE}, such as {item}"
        text = texts.setdefault(name, text)
        yield Fault(item.place[:2], text, files[name], _UNITS[name], _key(corpus, name, which))


def read_plain_pickle(path: str | Path) -> Any:
    """Returns the dicts, lists, texts and numbers that the pickle file ``path`` holds.

    Nothing is imported, called or built but those. Byte strings of Python 2 are read as UTF-8.
    Some public copies went through Git or an editor on Windows, which ends every line with CRLF.
    They are read as they were before.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if the file is no pickle, is truncated, has bytes after its end, or refers to
            any class, function or outside object.
    """
    raw = Path(path).read_bytes()
    # A dict or list starts so in protocol 0 alone. That is text, in which a line end is never part
    # of a value; a binary pickle may hold the same two bytes as a length or a text.
    if raw.startswith((b"(d", b"(l")):
        raw = raw.replace(b"\r\n", b"\n").rstrip(b"\n")
    stream = io.BytesIO(raw)
    try:
        content = _PlainUnpickler(stream, encoding="utf-8").load()
    except Exception as error:  # a damaged pickle raises nearly anything, from KeyError to EOFError
        is_memory = isinstance(error, MemoryError)
        reason = "it asks for more memory than there is" if is_memory else sentence(error)
        raise ValueError(
            f"{path} is not a pickle of plain data: {reason or type(error).__name__}"
        ) from error
    if rest := len(stream.getbuffer()) - stream.tell():
        raise ValueError(f"{path} is not a pickle of plain data: {rest} bytes follow its end")
    return content


def _expect(where: str | Path, content: object) -> list[Any]:
    if not isinstance(content, list):
        raise ValueError(f"{where} must hold a list, got {type(content).__name__}")
    return content


def _expect_mapping(where: str | Path, content: object, key_type: type) -> Mapping[Any, Any]:
    if not isinstance(content, dict):
        raise ValueError(f"{where} must hold a dict, got {type(content).__name__}")
    for key in content:
        if type(key) is not key_type:
            raise ValueError(f"{where} must have {key_type.__name__} keys, got {shown(key)}")
    return content


def _slot_values(where: str, content: object) -> dict[str, str]:
    """Returns slot to value; blank values are left out."""
    values = _expect_mapping(where, content, str)
    texts = {slot: check(f"{where}, {slot}", value, TEXT) for slot, value in values.items()}
    return {slot: text for slot, text in texts.items() if text.strip()}


def _records(path: Path) -> dict[int, dict[str, str]]:
    table = _expect_mapping(path, read_plain_pickle(path), int)
    return {row: _slot_values(f"{path}: row {row}", table[row]) for row in sorted(table)}


def _values(path: Path) -> dict[str, tuple[str, ...]]:
    """Returns slot to values; a value that is listed twice stays so and is drawn twice as often."""
    lists = _expect_mapping(path, read_plain_pickle(path), str)
    if not lists:
        raise ValueError(f"{path} {NEEDS_VALUES}")
    values = {
        slot: [check(f"{path}: {slot}", text, TEXT) for text in _expect(f"{path}: {slot}", entry)]
        for slot, entry in lists.items()
    }
    return {slot: tuple(text for text in texts if text.strip()) for slot, texts in values.items()}


def _goal(where: str, content: object, acts: Sequence[str], ticket: str) -> Goal:
    goal = _expect_mapping(where, content, str)
    if set(goal) != _GOAL_KEYS:
        raise ValueError(
            f"{where} must have the keys {sorted(_GOAL_KEYS)}, got {shown(sorted(goal))}"
        )
    if goal["diaact"] not in acts:
        raise ValueError(
            f"{where} has the unknown act {shown(goal['diaact'])}; allowed: {', '.join(acts)}"
        )
    if goal["diaact"] != "request":
        raise ValueError(f"{where} must open with the act request, got {shown(goal['diaact'])}")
    requests = _slot_values(f"{where}, request_slots", goal["request_slots"])
    if odd := {slot: value for slot, value in requests.items() if value != _UNKNOWN}:
        raise ValueError(
            f"{where} must request slots with the value {_UNKNOWN!r}, got {shown(odd)}"
        )
    return Goal(
        constraints=_slot_values(f"{where}, inform_slots", goal["inform_slots"]),
        requests=tuple(slot for slot in requests if slot != ticket),
    )
