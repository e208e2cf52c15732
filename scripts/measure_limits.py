"""Measures the nlu where a domain ends: ``results/limits.json``.

The sentences of ``tests/data/language/limits`` were written by hand before the nlu could do this.
Those reported were never learned or chosen by; ``--dev`` measures the others, and writes nothing.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING, Any

from bbq_torchrl.domains import movie_domain
from bbq_torchrl.domains.frames import ANY, Frame
from bbq_torchrl.people.language import Understander, read_lines
from bbq_torchrl.people.language.understander import cached_understander, keys_of
from bbq_torchrl.people.language.words import compact, is_farewell
from bbq_torchrl.utils import output

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bbq_torchrl.domains import Domain
    from bbq_torchrl.people.language.asking import Understood
    from bbq_torchrl.people.language.training_lines import Line

ROOT = Path(__file__).parents[1]
SETS = ROOT / "tests" / "data" / "language"
RESULT = ROOT / "results" / "limits.json"
Row = tuple[Frame | None, str, list[tuple[str, str]]]


def rows(path: Path, domain: Domain) -> list[Row]:
    """Returns the question, the sentence and the pairs ``slot=value`` of each line of a set."""
    found: list[Row] = []
    for line in path.read_text("utf-8").splitlines():
        if line.startswith("#") or not line:
            continue
        question, text, *pairs = (part.strip() for part in line.split("|"))
        named = [(pair.partition("=")[0], pair.partition("=")[2]) for pair in pairs]
        found.append((Frame.parse(question, domain) if question else None, text, named))
    return found


def foreign(understand: Understander, lines: Sequence[Row]) -> dict[str, Any]:
    """Returns how often what the domain cannot mean is acted on, and ends the conversation."""
    acted = [
        (text, heard.frame)
        for question, text, _ in lines
        if not understand.asks(heard := understand(text, question))
    ]
    ended = [text for text, frame in acted if frame.act == "closing" and is_farewell(text)]
    closed = [text for text, frame in acted if frame.act == "closing"]
    return {
        "sentences": len(lines),
        "accepted": len(acted) / len(lines),
        "closings": len(closed),
        "ended": len(ended),
        "failures": [f"{text} -> {frame}" for text, frame in acted],
    }


def contrary(understand: Understander, lines: Sequence[Row]) -> dict[str, Any]:
    """Returns how often a denied value is read as wanted, and how often what is meant is there."""
    turned, meant_there, asked, failures = [], [], [], []
    for question, text, ((slot, value), (other, meant)) in lines:
        heard = understand(text, question)
        informs = heard.frame.informs
        key = understand.lexicon.key
        has_value = slot in informs and key(slot, informs[slot]) == key(slot, value)
        is_any = other == "" and informs.get(slot) == ANY
        turned.append(has_value or (is_any and not understand.asks(heard)))
        asked.append(understand.asks(heard))
        if other:
            is_there = other in informs and key(other, informs[other]) == key(other, meant)
            meant_there.append(is_there)
        if turned[-1] or (other and not is_there):
            failures.append(f"{text} -> {heard.frame} {heard.confidence:.2f}")
    return {
        "sentences": len(lines),
        "turned": sum(turned),
        "turned_and_acted_on": sum(t and not a for t, a in zip(turned, asked, strict=True)),
        "meant_value_there": fmean(meant_there),
        "failures": failures,
    }


def _reports(heard: Understood, slot: str, name: str) -> bool:
    said = compact(name)
    return any(one.slot == slot and said in compact(one.text) for one in heard.unclear)


def unknown(understand: Understander, lines: Sequence[Row]) -> dict[str, Any]:
    """Returns how often an unknown name is reported as one, or the sentence asked about."""
    reported, asked, failures = [], [], []
    for question, text, ((slot, name),) in lines:
        heard = understand(text, question)
        reported.append(_reports(heard, slot, name))
        asked.append(reported[-1] or understand.asks(heard))
        if not reported[-1]:
            sign = "?" if asked[-1] else "!"
            names = [f"{one.slot}:{one.text}{list(one.candidates)}" for one in heard.unclear]
            failures.append(f"{sign} {text} -> {heard.frame} {heard.confidence:.2f} {names}")
    return {
        "sentences": len(lines),
        "reported": fmean(reported),
        "reported_or_asked": fmean(asked),
        "failures": failures,
    }


def dropped(understand: Understander, lines: Sequence[Line]) -> dict[str, Any]:
    """Returns the share of values that are acted on without: no value of the slot was heard."""
    said, lost, wrong, failures = 0, 0, 0, []
    for question, text, frame in lines:
        heard = understand(text, question)
        reported = {one.slot for one in heard.unclear}
        values = {slot: value for slot, value in frame.informs.items() if value != ANY}
        missing = [s for s in values if s not in heard.frame.informs and s not in reported]
        other = [
            slot
            for slot, value in values.items()
            if slot in heard.frame.informs
            and understand.lexicon.key(slot, heard.frame.informs[slot])
            != understand.lexicon.key(slot, value)
        ]
        is_acted_on = not understand.asks(heard)
        said += len(values)
        lost += len(missing) * is_acted_on
        wrong += len(other) * is_acted_on
        if is_acted_on and (missing or other):
            failures.append(f"{text} -> {heard.frame} {heard.confidence:.2f}")
    return {
        "values": said,
        "dropped": lost / said,
        "other_value": wrong / said,
        "failures": failures,
    }


def unseen(
    understand: Understander, lines: Sequence[Line], titles: Sequence[str]
) -> dict[str, Any]:
    """Returns the slot F1 of sentences with known titles, and with titles that the domain lacks.

    They are typed with capitals where the known one is. A reported unknown name counts as a value.
    """
    shared, pairs = [0, 0], [0, 0]
    named = [line for line in lines if line.frame.informs.get("moviename", "") in line.text.lower()]
    named = [line for line in named if "moviename" in line.frame.informs]
    for at, (question, text, frame) in enumerate(named):
        title, other = frame.informs["moviename"], titles[at % len(titles)]
        for column, name in enumerate((title, other)):
            start = text.lower().index(title)
            typed = name.title() if text[start].isupper() else name
            heard = understand(text[:start] + typed + text[start + len(title) :], question)
            meant = keys_of(frame, understand.lexicon) | {"moviename": compact(name)}
            got = keys_of(heard.frame, understand.lexicon)
            if "moviename" in got:
                got["moviename"] = compact(heard.frame.informs["moviename"])
            unknown = {one.slot: compact(one.text) for one in heard.unclear if not one.candidates}
            got |= unknown
            shared[column] += len(got.items() & meant.items())
            pairs[column] += len(got) + len(meant)
    f1 = [2 * s / p for s, p in zip(shared, pairs, strict=True)]
    return {
        "sentences": len(named),
        "slot_f1_known": f1[0],
        "slot_f1_unseen": f1[1],
        "cost": f1[0] - f1[1],
        "failures": [],
    }


def main() -> None:
    """Measures all sets."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--dev", action="store_true", help="the sets that were chosen by")
    parser.add_argument("--file", type=Path, help="of an understander; else that of the chat")
    given = parser.parse_args()
    domain = movie_domain()
    if given.file is None:
        understand = cached_understander(domain)
    else:
        understand = Understander.load(given.file, domain)
    end, limits = "_dev" if given.dev else "", SETS / "limits"
    figures = {
        "out_of_scope": foreign(understand, rows(limits / f"out_of_scope{end}.txt", domain)),
        "contrary": contrary(understand, rows(limits / f"contrary{end}.txt", domain)),
        "unknown_names": unknown(understand, rows(limits / f"unknown_names{end}.txt", domain)),
        "crowded": dropped(understand, read_lines(limits / f"crowded{end}.txt", domain)),
    }
    if not given.dev:
        voices = [
            line
            for name in ("terse", "chatty", "nonnative")
            for line in read_lines(SETS / f"{name}.txt", domain)
        ]
        names = [pairs for _, _, pairs in rows(limits / "unknown_names.txt", domain)]
        titles = [name for ((slot, name),) in names if slot == "moviename"]
        figures["unseen_titles"] = unseen(understand, voices, titles)
    for name, own in figures.items():
        failures = own.pop("failures")
        rounded = {key: round(value, 4) for key, value in own.items()}
        output.write(f"{name} {json.dumps(rounded)}\n")
        if given.dev:
            output.write("".join(f"    {line}\n" for line in failures))
    if not given.dev:
        RESULT.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
