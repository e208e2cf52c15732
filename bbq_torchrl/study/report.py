"""The report of a study: tables, tests, flags, the two figures and the data."""

from __future__ import annotations

import math
from collections import Counter
from itertools import chain
from typing import TYPE_CHECKING, Any

from bbq_torchrl.reports import table
from bbq_torchrl.run_folder import write_text
from bbq_torchrl.study.comparisons import compare_pairs
from bbq_torchrl.study.database import PRIVATE
from bbq_torchrl.study.export import export
from bbq_torchrl.study.figures import draw_ratings, draw_success
from bbq_torchrl.study.rating import RATING_RULE
from bbq_torchrl.study.records import HIGHEST, LOWEST, SCALES
from bbq_torchrl.study.statistics import auroc, kappa, mean, proportion

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from bbq_torchrl.study.comparisons import Comparison
    from bbq_torchrl.study.results import Result, Results
    from bbq_torchrl.study.statistics import Interval

FIRST = 3
"""Answers of a session whose entropy could warn in time."""


def write_report(folder: Path, results: Results) -> None:
    """Writes ``report.md``, ``success.png``, ``ratings.png`` and the data.

    Args:
        folder: where to; it is made where it is missing.
        results: the study's.
    """
    folder.mkdir(parents=True, exist_ok=True)
    export(folder, results)
    if results.sessions:
        draw_success(folder / "success.png", results, compare_pairs(results))
        draw_ratings(folder / "ratings.png", results)
    write_text(folder / "report.md", report_text(results), PRIVATE)


def report_text(results: Results) -> str:
    """Returns the report as Markdown."""
    found = (_agents, _pairs, _ratings, _failures, _agreement, _uncertainty, _flags)
    sections = (_head, *(found if results.sessions else (_nothing,)))
    blocks = chain.from_iterable(section(results) for section in sections)
    return "\n\n".join(blocks) + "\n"


def _head(results: Results) -> Iterator[str]:
    yield f"# {results.title}"
    if results.simulated:
        yield f"**The people of this study are simulated users.** {RATING_RULE}"
    rated = sum(session.is_rated for session in results.sessions)
    yield (
        f"{results.enrolled} {_who(results)} enrolled of {results.terms.participants} wanted; "
        f"{len(results.sessions)} sessions ended, {rated} of them rated; {results.open} begun and "
        f"not ended (they are in no number below). bbq-torchrl {results.package}."
    )


def _nothing(_: Results) -> Iterator[str]:
    yield "No session has ended yet: there is nothing to report."


def _agents(results: Results) -> Iterator[str]:
    yield "## Agents"
    rows = []
    for agent in results.terms.agents:
        success = proportion(results.successes(agent).values())
        own = proportion(results.by_person(lambda item: item.verdict, agent).values())
        bounds = LOWEST, HIGHEST
        scales = [mean(results.ratings(agent, name).values(), bounds) for name in SCALES]
        rows.append((agent, success.count, success, own, *scales))
    yield table(("agent", "sessions", "success", "own verdict", *SCALES), rows)
    yield (
        "Means with 95 % intervals: Wilson's for success (sessions of one person counted by "
        "their design effect), Student's t over people for ratings from 1 to 5. Where that would "
        "leave the scale, or has no width, two more people are counted, one at each end of the "
        "scale (Bonett and Price 2012); so it is for differences. Success is the judge's, by goal "
        f"card and dialogue acts; own verdict is what {_who(results)} said."
    )
    yield "![Success of each agent](success.png)"


def _pairs(results: Results) -> Iterator[str]:
    yield "## Declared pairs"
    if not results.terms.pairs:
        yield "No pair was declared, so nothing is tested."
        return
    comparisons = compare_pairs(results)
    yield _comparison_table(comparisons)
    yield (
        "Primary: p of the sign-flip permutation test of people's differences in success, and "
        "the same by Holm over all declared pairs. Fisher and Boschloo take sessions for "
        "independent and stand beside it, unadjusted. The unit is the person."
    )
    rows = [
        (f"{item.better} – {item.worse}", item.rating.mean, _p(item.rating.p),
         _p(item.rating.holm), _p(item.mann_whitney))
        for item in comparisons
    ]  # fmt: skip
    yield table(("pair", "overall rating", "p sign-flip", "Holm", "Mann-Whitney"), rows)
    if flagged := results.flags():
        yield f"Without the {len(flagged)} people who are flagged below:"
        yield _comparison_table(compare_pairs(results, flagged))


def _comparison_table(comparisons: Iterable[Comparison]) -> str:
    rows = [
        (f"{item.better} – {item.worse}", item.success.people, item.success.mean,
         _p(item.success.p), f"**{_p(item.success.holm)}**", _p(item.fisher), _p(item.boschloo))
        for item in comparisons
    ]  # fmt: skip
    head = ("pair", "people", "success", "p sign-flip", "Holm", "Fisher", "Boschloo")
    return table(head, rows)


def _ratings(results: Results) -> Iterator[str]:
    yield "## Distribution of overall ratings"
    counts = {
        agent: Counter(chain(*results.ratings(agent).values())) for agent in results.terms.agents
    }
    yield _counted(counts, range(1, 6))
    yield "![Distribution of ratings](ratings.png)"


def _failures(results: Results) -> Iterator[str]:
    yield "## Why sessions failed"
    counts = {agent: Counter[str]() for agent in results.terms.agents}
    for session in results.sessions:
        counts[session.agent].update(session.reasons)
    if reasons := sorted(set(chain(*counts.values()))):
        yield _counted(counts, reasons)
        yield "A session may fail for several reasons."
    else:
        yield "No session failed."


def _counted(counts: Mapping[str, Counter[Any]], items: Sequence[object]) -> str:
    """Returns a table of how often each agent has each item."""
    rows = [(agent, *(counter[item] for item in items)) for agent, counter in counts.items()]
    return table(("agent", *map(str, items)), rows)


def _agreement(results: Results) -> Iterator[str]:
    both = results.by_person(
        lambda item: None if item.verdict is None else (item.verdict, item.success)
    )
    found = kappa(list(both.values()))
    whose = "The simulated users'" if results.simulated else "People's"
    yield f"## {whose} own verdict and the judge's"
    if math.isnan(found.value):
        yield "κ is undefined: one of the two is always the same, or nothing is rated."
    else:
        yield (
            f"Cohen's κ {found} over {found.count} sessions (95 % bootstrap interval over people; "
            "Wilson's where all resamples agree alike)."
        )


def _uncertainty(results: Results) -> Iterator[str]:
    rows = []
    for agent in results.terms.agents:
        people = results.by_person(
            lambda item: item if item.entropy is not None else None, agent
        ).values()
        if count := sum(map(len, people)):
            whole = _warning(people, lambda item: item.entropy)
            soon = _warning(people, lambda item: item.entropy_of_first(FIRST))
            rows.append((agent, count, whole, soon, _warning(people, lambda i: len(i.exchanges))))
    if rows:
        yield "## Does uncertainty predict failure?"
        head = ("agent", "sessions", "entropy", f"entropy of the first {FIRST} answers", "length")
        yield table(head, rows)
        yield (
            "Area under the curve as a sign of failure, with 95 % bootstrap intervals over people "
            "(Newcombe's where all resamples are ordered alike): .5 says nothing, 1 all. "
            "Entropy is that of the best action, a mean over a session's "
            "answers or over its first ones; length is the number of messages. Conversations that "
            "fail are long: a sign that comes no sooner than length and is no better adds nothing."
        )


def _warning(
    people: Collection[Sequence[Result]], sign: Callable[[Result], float | None]
) -> Interval:
    """Returns how well a sign tells sessions that fail, where there is one."""
    return auroc(
        [
            [(value, not item.success) for item in sessions if (value := sign(item)) is not None]
            for sessions in people
        ]
    )


def _flags(results: Results) -> Iterator[str]:
    yield "## Flags"
    if flags := results.flags():
        yield table(("person", "flags"), [(who, "; ".join(what)) for who, what in flags.items()])
        yield "All of them are in every number above unless it says otherwise."
    else:
        yield "Nobody is conspicuous."


def _who(results: Results) -> str:
    return "simulated users" if results.simulated else "people"


def _p(value: float) -> str:
    return "< 0.001" if value < 0.001 else f"{value:.3f}"
