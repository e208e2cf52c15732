"""The report of a study: tables, tests, flags, the two figures and the data."""

from __future__ import annotations

import math
from collections import Counter
from io import BytesIO
from itertools import chain
from typing import TYPE_CHECKING, Any

from bbq_torchrl.people.study.comparisons import compare_pairs
from bbq_torchrl.people.study.database import PRIVATE
from bbq_torchrl.people.study.export import export
from bbq_torchrl.people.study.records import HIGHEST, LOWEST, SCALES
from bbq_torchrl.people.study.simulate import RATING_RULE
from bbq_torchrl.utils.files import write_bytes, write_text
from bbq_torchrl.utils.reports import table
from bbq_torchrl.utils.statistics import auroc, kappa, participant_mean, proportion

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from bbq_torchrl.people.study.comparisons import Comparison
    from bbq_torchrl.people.study.results import Result, Results
    from bbq_torchrl.utils.statistics import Estimate

FIRST = 3
"""The number of a session's first answers whose entropy could warn in time."""


def write_report(folder: Path, results: Results) -> None:
    """Writes ``report.md``, ``success.png``, ``ratings.png`` and the data.

    Args:
        folder: the output folder, created if missing.
        results: the study's results.
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
        by_person = results.successes(agent).values()
        own = proportion(results.by_person(lambda item: item.verdict, agent).values())
        bounds = LOWEST, HIGHEST
        scales = [
            participant_mean(results.ratings(agent, name).values(), bounds) for name in SCALES
        ]
        rows.append((agent, _count(by_person), proportion(by_person), own, *scales))
    yield table(("agent", "sessions", "success", "own verdict", *SCALES), rows)
    yield (
        "Means with 95 % intervals: Wilson's for success if everybody meets an agent once, else "
        "Student's t over people, as for ratings from 1 to 5. Where that would leave the scale, or "
        "has no width, two more people are counted, one at each end of the scale (Bonett and Price "
        "2012); so it is for differences. Success is the judge's, by goal "
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
        (f"{item.better} – {item.worse}", item.rating.mean, item.rating.p,
         item.rating.holm, item.mann_whitney)
        for item in comparisons
    ]  # fmt: skip
    yield table(("pair", "overall rating", "p sign-flip", "Holm", "Mann-Whitney"), rows)
    if flagged := results.flags():
        yield f"Without the {len(flagged)} people who are flagged below:"
        yield _comparison_table(compare_pairs(results, flagged))


def _comparison_table(comparisons: Iterable[Comparison]) -> str:
    rows = [
        (f"{item.better} – {item.worse}", item.success.people, item.success.mean,
         item.success.p, f"**{item.success.holm}**", item.fisher, item.boschloo)
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
    """Returns a table of each agent's count of each item."""
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
            f"Cohen's κ {found} over {_count(both.values())} sessions "
            "(95 % bootstrap interval over people)."
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
            "Area under the curve as a sign of failure, with 95 % bootstrap intervals over people: "
            ".5 says nothing, 1 all. "
            "Entropy is that of the best action, a mean over a session's "
            "answers or over its first ones; length is the number of messages. Where conversations "
            "that fail are long, a sign that comes no sooner than length and is no better adds "
            "nothing."
        )


def _warning(
    people: Collection[Sequence[Result]], sign: Callable[[Result], float | None]
) -> Estimate:
    """Returns the AUROC of a sign as a predictor of failed sessions, where it is present."""
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


def _count(by_person: Collection[Sequence[object]]) -> int:
    return sum(map(len, by_person))


BAR = "#56B4E9"
RATINGS = ("#D55E00", "#E6A277", "#DDDDDD", "#7FB3D5", "#0072B2")  # from 1 to 5


def draw_success(file: Path, results: Results, comparisons: Sequence[Comparison]) -> None:
    """Draws each agent's success with its interval and number of sessions, and each pair's p-value.

    Args:
        file: a PNG file.
        results: the study's results.
        comparisons: those of the declared pairs; Holm's p-value is shown.
    """
    agents = list(results.terms.agents)
    axes = _axes(results)
    level = 0.0
    for place, agent in enumerate(agents):
        by_person = results.successes(agent).values()
        share = proportion(by_person)
        if by_person:
            error = [[share.value - share.low], [share.high - share.value]]
            axes.bar(place, share.value, color=BAR, yerr=error, capsize=4, width=0.6)
            axes.text(place, 0.02, f"n = {_count(by_person)}", ha="center", fontsize=8)
            level = max(level, share.high)
    level += 0.04
    for comparison in comparisons:
        if comparison.success.people:
            left, right = agents.index(comparison.better), agents.index(comparison.worse)
            heights = [level, level + 0.02, level + 0.02, level]
            axes.plot([left, left, right, right], heights, color="black", lw=1)
            p = comparison.success.holm
            label = f"p {'' if p < 0.001 else '= '}{p}"
            axes.text((left + right) / 2, level + 0.025, label, ha="center", fontsize=8)
            level += 0.09
    axes.set(ylabel="success rate", ylim=(0, max(1.0, level + 0.03)))
    _save(axes, file)


def draw_ratings(file: Path, results: Results) -> None:
    """Draws the counts and the mean of each agent's overall ratings.

    Args:
        file: a PNG file.
        results: the study's results.
    """
    axes = _axes(results)
    for place, agent in enumerate(results.terms.agents):
        people = results.ratings(agent).values()
        values = [value for person in people for value in person]
        bottom = 0.0
        for rating, color in enumerate(RATINGS, start=1):
            share = values.count(rating) / len(values) if values else 0.0
            label = {"label": f"rating {rating}"} if place == 0 else {}
            axes.bar(place, share, bottom=bottom, color=color, width=0.6, **label)
            bottom += share
        if values:
            text = (
                f"mean {participant_mean(people, (LOWEST, HIGHEST)).value:.2f}\nn = {len(values)}"
            )
            axes.text(place, 1.02, text, ha="center", fontsize=8)
    whose = "simulated " if results.simulated else ""
    axes.set(ylabel=f"share of {whose}ratings", ylim=(0, 1.15))
    axes.figure.legend(loc="outside lower center", ncols=5, fontsize=8, frameon=False)
    _save(axes, file)


def _axes(results: Results) -> Any:
    """Returns empty axes with a place for each agent."""
    # The object interface needs no window system and shares no global state with other figures.
    from matplotlib.figure import Figure

    agents = list(results.terms.agents)
    width = max(4.0, 1.4 * len(agents) + 1)
    axes = Figure(figsize=(width, 4.5), layout="constrained").add_subplot()
    axes.set_title(results.title)
    axes.set_xticks(range(len(agents)), agents)
    axes.set_yticks([0, 0.2, 0.4, 0.6, 0.8, 1.0])
    axes.spines[["top", "right"]].set_visible(False)
    return axes


def _save(axes: Any, file: Path) -> None:
    axes.set_xlim(-0.6, len(axes.get_xticks()) - 0.4)
    picture = BytesIO()
    axes.figure.savefig(picture, dpi=150, format="png")
    write_bytes(file, picture.getvalue(), PRIVATE)
