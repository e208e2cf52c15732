"""The report of a study: tables, tests, flags, figures and the data."""

from __future__ import annotations

import math
from collections import Counter
from functools import partial
from itertools import chain
from typing import TYPE_CHECKING

import numpy as np

from bbq_torchrl.people.study.conversations import RATING_RULE
from bbq_torchrl.people.study.database import HIGHEST, LOWEST, SCALES
from bbq_torchrl.people.study.export import export
from bbq_torchrl.people.study.outcomes import (
    Outcome,
    auroc,
    compare_pairs,
    kappa,
    participant_mean,
    proportion,
)
from bbq_torchrl.utils.reports import Report, Table, add_legend, draw_intervals, subplots

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator, Sequence
    from pathlib import Path

    from matplotlib.figure import Figure

    from bbq_torchrl.people.study.outcomes import Difference, Outcomes
    from bbq_torchrl.utils.statistics import Estimate

FIRST = 3
"""The number of a session's first answers whose entropy could warn in time."""

_RATINGS = range(LOWEST, HIGHEST + 1)
_COLORS = ("#D55E00", "#E6A277", "#DDDDDD", "#7FB3D5", "#0072B2")  # from the worst to the best


def write_report(folder: Path, outcomes: Outcomes) -> None:
    """Writes ``report.md`` with its tables and figures, and the data.

    Args:
        folder: the output folder; if missing, it is created for its owner alone.
        outcomes: the study's outcomes.
    """
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    report(outcomes).write(folder)
    export(folder, outcomes)


def report(outcomes: Outcomes) -> Report:
    """Returns the report of a study."""
    title = f"{outcomes.terms.name}{' (simulated users)' if outcomes.simulated else ''}"
    if not outcomes.sessions:
        nothing = "No session has ended yet: there is nothing to report."
        return Report("report", title, [*_head(outcomes), nothing], {})
    compared = compare_pairs(outcomes, "success")
    sections = (
        *(_head(outcomes), _agents(outcomes), _pairs(outcomes, compared), _ratings(outcomes)),
        *(_failures(outcomes), _agreement(outcomes), _uncertainty(outcomes), _flags(outcomes)),
    )
    agents = outcomes.terms.agents
    success = {agent: proportion(outcomes.successes(agent).values()) for agent in agents}
    figures = {
        "success": ("Success", partial(draw_intervals, {"success": success}, title=title)),
        "ratings": ("Distribution of ratings", partial(draw_ratings, title, outcomes)),
    }
    if compared:
        panels = {"difference in success": {found.pair: found.mean for found in compared}}
        draw = partial(draw_intervals, panels, title=title, limits=(-1.0, 1.0))
        figures["differences"] = ("Differences of the declared pairs", draw)
    return Report("report", title, list(chain(*sections)), figures)


def _head(outcomes: Outcomes) -> Iterator[str]:
    if outcomes.simulated:
        yield f"**The people of this study are simulated users.** {RATING_RULE}"
    rated = sum(session.is_rated for session in outcomes.sessions)
    yield (
        f"{outcomes.enrolled} people enrolled of {outcomes.terms.participants} wanted; "
        f"{len(outcomes.sessions)} sessions ended, {rated} of them rated; {outcomes.open} begun "
        f"and not ended (they are in no number below). bbq-torchrl {outcomes.package}."
    )


def _agents(outcomes: Outcomes) -> Iterator[str | Table]:
    yield "## Agents"
    rows = []
    for agent in outcomes.terms.agents:
        judged = outcomes.successes(agent).values()
        own = outcomes.by_person(lambda item: item.verdict, agent).values()
        row = {"agent": agent, "sessions": _count(judged)}
        row |= {"success": proportion(judged), "own verdict": proportion(own)}
        for scale in SCALES:
            ratings = outcomes.ratings(agent, scale).values()
            row[scale] = participant_mean(ratings, (LOWEST, HIGHEST))
        rows.append(row)
    yield Table("agents", rows)
    yield (
        "Means with 95 % intervals: Wilson's for success if everybody meets an agent once, else "
        "Student's t over people; where that would leave the scale or has no width, with two more "
        "people, one at each end (Bonett and Price 2012). Success is the judge's, by goal card and "
        "dialogue acts; own verdict is what people said."
    )


def _pairs(outcomes: Outcomes, compared: Sequence[Difference]) -> Iterator[str | Table]:
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
    yield _compared("pairs_by_rating", "rating", compare_pairs(outcomes, "rating"))
    if flagged := outcomes.flags():
        yield f"Without the {len(flagged)} people who are flagged below:"
        without = compare_pairs(outcomes, "success", flagged)
        yield _compared("pairs_without_flagged", "success", without)


def _compared(name: str, quantity: str, compared: Sequence[Difference]) -> Table:
    rows = [
        {
            **{"pair": found.pair, "people": found.people, quantity: found.mean},
            **{"p sign-flip": found.p, "Holm": found.holm, **found.classical},
        }
        for found in compared
    ]
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
    yield "## People's own verdict and the judge's"
    pairs = Counter(chain(*both.values()))
    own, judges = pairs[True, False], pairs[False, True]
    yield (
        f"They differ in {own + judges} of {_count(both.values())} sessions: {own} are a success "
        f"by people's own verdict alone, {judges} by the judge's alone."
    )
    found = kappa(list(both.values()))
    if math.isnan(found.value):
        yield "κ is undefined: one of the two is always the same, or nothing is rated."
    else:
        yield (f"Cohen's κ {found} (95 % bootstrap interval over people).")


def _uncertainty(outcomes: Outcomes) -> Iterator[str | Table]:
    signs: dict[str, Callable[[Outcome], float | None]] = {
        "entropy": Outcome.entropy,
        f"entropy of the first {FIRST} answers": lambda item: item.entropy(FIRST),
        "length": lambda item: len(item.exchanges),
    }
    rows = []
    for agent in outcomes.terms.agents:
        if doubts := outcomes.by_person(Outcome.entropy, agent).values():
            warnings = {name: _warning(outcomes, agent, sign) for name, sign in signs.items()}
            rows.append({"agent": agent, "sessions": _count(doubts), **warnings})
    if rows:
        yield "## Does uncertainty predict failure?"
        yield Table("uncertainty", rows)
        yield (
            "Area under the curve as a sign of failure, with 95 % bootstrap intervals over people: "
            ".5 says nothing, 1 all. Entropy is that of the best action, a mean over a session's "
            "answers; length is the number of messages. A sign that comes no sooner than length "
            "and is no better adds nothing."
        )


def _warning(outcomes: Outcomes, agent: str, sign: Callable[[Outcome], float | None]) -> Estimate:
    """Returns the AUROC of a sign as a predictor of failed sessions, where it is present."""
    found = outcomes.by_person(
        lambda item: None if (value := sign(item)) is None else (value, not item.success), agent
    )
    return auroc(list(found.values()))


def _flags(outcomes: Outcomes) -> Iterator[str | Table]:
    yield "## Flags"
    if flags := outcomes.flags():
        rows = [{"person": who, "flags": "; ".join(what)} for who, what in flags.items()]
        yield Table("flags", rows, words=2)
        yield "All of them are in every number above unless it says otherwise."
    else:
        yield "Nobody is conspicuous."


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
    counts = np.array([[of.count(rating) for of in rated] for rating in _RATINGS])
    shares = counts / counts.sum(0).clip(min=1)
    figure, [panel] = subplots(1)
    for number, color in enumerate(_COLORS):
        left, label = shares[:number].sum(0), f"rating {_RATINGS[number]}"
        panel.barh(agents, shares[number], left=left, color=color, label=label)
    panel.set(title=title, xlabel="share of ratings")
    panel.invert_yaxis()
    add_legend(figure)
    return figure
