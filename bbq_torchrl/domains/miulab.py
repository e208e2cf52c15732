"""A safe reader of the public MiuLab movie-booking corpus (TC-Bot, MIT license).

The corpus is a folder of Python 2 pickles. Unpickling can run any code, so the reader refuses every
global: only dicts, lists, texts and numbers can come out. Then it checks each file's form.
"""

from __future__ import annotations

import io
import pickle
from os.path import expanduser
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from bbq_torchrl.domains.domain import Domain
from bbq_torchrl.domains.faults import DomainError, Fault, sentences
from bbq_torchrl.domains.files import NEEDS_VALUES, SPECIFICATION_FILE, read_specification
from bbq_torchrl.domains.folder import MOVIE_FOLDER
from bbq_torchrl.domains.specification import Goal
from bbq_torchrl.domains.values import DIFFERENCE, misspellings
from bbq_torchrl.settings import TEXT, check
from bbq_torchrl.utils.text import sentence, shown

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

REFERENCE_SLOT_ERROR_PROB = 0.0581
"""The slot error probability (mode ``value``) at which the rule policy succeeds in 18.3 % of the
dialogues on the default files. At 0.058 it succeeded in 18.31 % of 500,000; the rate falls by
0.0119 per 0.01.
"""

_GOAL_KEYS = {"diaact", "inform_slots", "request_slots"}
_UNKNOWN = "UNK"

Corpus = dict[str, dict[Any, Any]]
"""Records, goals and lists of values, keyed as in the files."""

_UNITS = {"records": "row", "goals": "goal", "error_values": "slot"}


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
    never match; ``doubts`` lists them.

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
        files: the paths by ``records``, ``goals`` and ``error_values``.
        acts: the acts that goals may have.
        ticket: the slot that every goal requests; goals leave it implicit.

    Raises:
        FileNotFoundError: if a file is missing.
        ValueError: if a file is damaged or contains anything but plain data of the expected form.
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
    """Returns the domain of a corpus, without the entries that cannot be used.

    Args:
        specification: all fields of the domain but those of the corpus.
        corpus: the result of :func:`read_corpus`.
        files: the same as there; messages name them.
        where: the subject of the error message.
        skip_unusable: whether unusable entries are left out rather than refused.

    Raises:
        DomainError: if the specification is inconsistent, if no usable entry remains, or, without
            ``skip_unusable``, if an entry is unusable.
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
                skipped=(*_changes(names, corpus, usable), *sentences(faults)) if faults else (),
                doubts=tuple(sentences(dict.fromkeys(_misspelled(names, usable)))),
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
    """Returns the file's key of the entry at a location in the domain, or ``None``."""
    if name == "error_values" or not which:
        return which[0] if which else None
    return list(corpus[name])[int(which[0])]


def _without(corpus: Corpus, found: Iterable[Fault], slots: Sequence[str]) -> Corpus:
    """Returns the corpus without the faulty entries.

    A record loses only its unknown slots, a list only its faulty values.
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
    """Yields the number of changed entries of each file, as a sentence."""
    for name, before in whole.items():
        unlike = sum(left[name].get(key) != entry for key, entry in before.items())
        if unlike:
            entries = f"{unlike} of {len(before)} {_UNITS[name]}s"
            yield f"{files[name]}: {entries} are left out wholly or in part"


def _misspelled(files: Mapping[str, str], corpus: Corpus) -> Iterator[Fault]:
    """Yields the locations of values that never match others, with one example per file."""
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
        is_memory = isinstance(error, MemoryError)
        reason = "it asks for more memory than the machine has" if is_memory else sentence(error)
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
    """Returns the values by slot, without blank ones."""
    values = _expect_mapping(where, content, str)
    texts = {slot: check(f"{where}, {slot}", value, TEXT) for slot, value in values.items()}
    return {slot: text for slot, text in texts.items() if text.strip()}


def _records(path: Path) -> dict[int, dict[str, str]]:
    table = _expect_mapping(path, read_plain_pickle(path), int)
    return {row: _slot_values(f"{path}: row {row}", table[row]) for row in sorted(table)}


def _values(path: Path) -> dict[str, tuple[str, ...]]:
    """Returns the values by slot; a value listed twice stays twice, and is drawn twice as often."""
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
