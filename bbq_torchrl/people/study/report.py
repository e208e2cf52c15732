"""The report of a study: tables, tests, flags, figures and the data."""

from __future__ import annotations

import math
from collections import Counter
from functools import partial
from itertools import chain
from typing import TYPE_CHECKING

from bbq_torchrl.people.study.database import HIGHEST, LOWEST, SCALES
from bbq_torchrl.people.study.export import export
from bbq_torchrl.people.study.outcomes import compare_pairs
from bbq_torchrl.people.study.simulate import RATING_RULE
from bbq_torchrl.utils.reports import Report, Table, add_legend, draw_intervals, subplots
from bbq_torchrl.utils.statistics import auroc, kappa, participant_mean, proportion

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator, Sequence
    from pathlib import Path

    from matplotlib.figure import Figure

    from bbq_torchrl.people.study.outcomes import Comparison, Difference, Outcome, Outcomes
    from bbq_torchrl.utils.statistics import Estimate

FIRST = 3
"""The number of a session's first answers whose entropy could warn in time."""

_RATINGS = range(LOWEST, HIGHEST + 1)
_COLORS = ("#D55E00", "#E6A277", "#DDDDDD", "#7FB3D5", "#0072B2")  # from the worst to the best


def write_report(folder: Path, outcomes: Outcomes) -> None:
    """Writes ``report.md`` with its tables and figures, and the data.

    Args:
        folder: the output folder, created if missing.
        outcomes: the study's outcomes.
    """
    report(outcomes).write(folder)
    export(folder, outcomes)


def report(outcomes: Outcomes) -> Report:
    """Returns the report of a study."""
    title = f"{outcomes.terms.name}{' (simulated users)' if outcomes.simulated else ''}"
    if not outcomes.sessions:
        nothing = "No session has ended yet: there is nothing to report."
        return Report("report", title, [*_head(outcomes), nothing], {})
    compared = compare_pairs(outcomes)
    sections = (
        *(_head(outcomes), _agents(outcomes), _pairs(outcomes, compared), _ratings(outcomes)),
        *(_failures(outcomes), _agreement(outcomes), _uncertainty(outcomes), _flags(outcomes)),
    )
    success = {
        f"{agent} (n = {_count(by_person)})": proportion(by_person)
        for agent in outcomes.terms.agents
        if (by_person := outcomes.successes(agent).values())
    }
    figures = {
        "success": ("Success", partial(draw_intervals, {"success": success}, title=title)),
        "ratings": ("Distribution of ratings", partial(draw_ratings, title, outcomes)),
    }
    if compared:
        differences = {
            f"{pair.better} – {pair.worse} (p {pair.success.holm} by Holm)": pair.success.mean
            for pair in compared
        }
        panels = {"difference in success": differences}
        draw = partial(draw_intervals, panels, title=title, limits=(-1.0, 1.0))
        figures["differences"] = ("Differences of the declared pairs", draw)
    return Report("report", title, list(chain(*sections)), figures)


def _head(outcomes: Outcomes) -> Iterator[str]:
    if outcomes.simulated:
        yield f"**The people of this study are simulated users.** {RATING_RULE}"
    rated = sum(session.is_rated for session in outcomes.sessions)
    yield (
        f"{outcomes.enrolled} {_who(outcomes)} enrolled of {outcomes.terms.participants} wanted; "
        f"{len(outcomes.sessions)} sessions ended, {rated} of them rated; {outcomes.open} begun "
        f"and not ended (they are in no number below). bbq-torchrl {outcomes.package}."
    )


def _agents(outcomes: Outcomes) -> Iterator[str | Table]:
    yield "## Agents"
    rows = []
    for agent in outcomes.terms.agents:
        by_person = outcomes.successes(agent).values()
        own = proportion(outcomes.by_person(lambda item: item.verdict, agent).values())
        row = {"agent": agent, "sessions": _count(by_person)}
        row |= {"success": proportion(by_person), "own verdict": own}
        for scale in SCALES:
            ratings = outcomes.ratings(agent, scale).values()
            row[scale] = participant_mean(ratings, (LOWEST, HIGHEST))
        rows.append(row)
    yield Table("agents", rows)
    yield (
        "Means with 95 % intervals: Wilson's for success if everybody meets an agent once, else "
        "Student's t over people, as for ratings from 1 to 5. Where that would leave the scale, or "
        "has no width, two more people are counted, one at each end of the scale (Bonett and Price "
        "2012); so it is for differences. Success is the judge's, by goal card and dialogue acts; "
        f"own verdict is what {_who(outcomes)} said."
    )


def _pairs(outcomes: Outcomes, compared: Sequence[Comparison]) -> Iterator[str | Table]:
    yield "## Declared pairs"
    if not compared:
        yield "No pair was declared, so nothing is tested."
        return
    yield _compared("pairs", "success", compared)
    yield (
        "Primary: p of the sign-flip permutation test of people's differences in success, and "
        "the same by Holm over all declared pairs. Fisher, Boschloo and Mann-Whitney take sessions "
        "for independent and stand beside it, unadjusted. The unit is the person."
    )
    yield _compared("pairs_by_rating", "rating", compared)
    if flagged := outcomes.flags():
        yield f"Without the {len(flagged)} people who are flagged below:"
        yield _compared("pairs_without_flagged", "success", compare_pairs(outcomes, flagged))


def _compared(name: str, quantity: str, compared: Sequence[Comparison]) -> Table:
    rows = []
    for pair in compared:
        found: Difference = getattr(pair, quantity)
        row = {"pair": f"{pair.better} – {pair.worse}", "people": found.people}
        row |= {quantity: found.mean, "p sign-flip": found.p, "Holm": found.holm}
        rows.append({**row, **found.classical})
    return Table(name, rows)


def _ratings(outcomes: Outcomes) -> Iterator[str | Table]:
    yield "## Distribution of overall ratings"
    rows = []
    for agent in outcomes.terms.agents:
        counts = Counter(chain(*outcomes.ratings(agent).values()))
        rows.append({"agent": agent, **{str(rating): counts[rating] for rating in _RATINGS}})
    yield Table("ratings", rows)


def _failures(outcomes: Outcomes) -> Iterator[str | Table]:
    yield "## Why sessions failed"
    counts = {agent: Counter[str]() for agent in outcomes.terms.agents}
    for session in outcomes.sessions:
        counts[session.agent].update(session.reasons)
    if reasons := sorted(set(chain(*counts.values()))):
        rows = [{"agent": agent, **{r: of[r] for r in reasons}} for agent, of in counts.items()]
        yield Table("failures", rows)
        yield "A session may fail for several reasons."
    else:
        yield "No session failed."


def _agreement(outcomes: Outcomes) -> Iterator[str]:
    both = outcomes.by_person(
        lambda item: None if item.verdict is None else (item.verdict, item.success)
    )
    found = kappa(list(both.values()))
    whose = "The simulated users'" if outcomes.simulated else "People's"
    yield f"## {whose} own verdict and the judge's"
    if math.isnan(found.value):
        yield "κ is undefined: one of the two is always the same, or nothing is rated."
    else:
        yield (
            f"Cohen's κ {found} over {_count(both.values())} sessions "
            "(95 % bootstrap interval over people)."
        )


def _uncertainty(outcomes: Outcomes) -> Iterator[str | Table]:
    rows = []
    for agent in outcomes.terms.agents:
        people = outcomes.by_person(
            lambda item: None if item.entropy() is None else item, agent
        ).values()
        if people:
            rows.append(
                {
                    "agent": agent,
                    "sessions": _count(people),
                    "entropy": _warning(people, lambda item: item.entropy()),
                    f"entropy of the first {FIRST} answers": _warning(
                        people, lambda item: item.entropy(FIRST)
                    ),
                    "length": _warning(people, lambda item: len(item.exchanges)),
                }
            )
    if rows:
        yield "## Does uncertainty predict failure?"
        yield Table("uncertainty", rows)
        yield (
            "Area under the curve as a sign of failure, with 95 % bootstrap intervals over people: "
            ".5 says nothing, 1 all. "
            "Entropy is that of the best action, a mean over a session's "
            "answers or over its first ones; length is the number of messages. Where conversations "
            "that fail are long, a sign that comes no sooner than length and is no better adds "
            "nothing."
        )


def _warning(
    people: Collection[Sequence[Outcome]], sign: Callable[[Outcome], float | None]
) -> Estimate:
    """Returns the AUROC of a sign as a predictor of failed sessions, where it is present."""
    return auroc(
        [
            [(value, not item.success) for item in sessions if (value := sign(item)) is not None]
            for sessions in people
        ]
    )


def _flags(outcomes: Outcomes) -> Iterator[str | Table]:
    yield "## Flags"
    if flags := outcomes.flags():
        rows = [{"person": who, "flags": "; ".join(what)} for who, what in flags.items()]
        yield Table("flags", rows, words=2)
        yield "All of them are in every number above unless it says otherwise."
    else:
        yield "Nobody is conspicuous."


def _who(outcomes: Outcomes) -> str:
    return "simulated users" if outcomes.simulated else "people"


def _count(by_person: Collection[Sequence[object]]) -> int:
    return sum(map(len, by_person))


def draw_ratings(title: str, outcomes: Outcomes) -> Figure:
    """Draws the shares of each agent's overall ratings.

    Args:
        title: the heading of the figure.
        outcomes: the study's outcomes.
    """
    agents = list(outcomes.terms.agents)
    rated = [list(chain(*outcomes.ratings(agent).values())) for agent in agents]
    figure, [panel] = subplots(1)
    left = [0.0] * len(agents)
    for rating in _RATINGS:
        shares = [values.count(rating) / max(1, len(values)) for values in rated]
        panel.barh(
            agents, shares, left=left, color=_COLORS[rating - LOWEST], label=f"rating {rating}"
        )
        left = [before + share for before, share in zip(left, shares, strict=True)]
    whose = "simulated " if outcomes.simulated else ""
    panel.set(title=title, xlabel=f"share of {whose}ratings")
    panel.invert_yaxis()
    add_legend(figure)
    return figure
