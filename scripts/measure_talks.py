"""Measures free conversations of many kinds of people with an agent: ``results/talks.csv``.

The people (``scripts/talks/people.yaml``) type in words that the understanding has not learned
from. Understanding, agent, dialogue control and judge are those of the chat and the study.

    python scripts/measure_talks.py [--agent shipped:bbqn_map] [--goals 10] [--show]
"""

from __future__ import annotations

import argparse
import random
from pathlib import Path

import torch
from talks.counts import COUNTS, save, shares, total
from talks.person import PEOPLE, Person, suits
from talks.talk import Talk

from bbq_torchrl.people.dialogue import RULES
from bbq_torchrl.people.dialogue.judge import Judge
from bbq_torchrl.people.dialogue.partner import Partner
from bbq_torchrl.people.dialogue.spelling import Spelling
from bbq_torchrl.people.dialogue.trained_agent import TrainedAgent
from bbq_torchrl.people.language import Generator, load_phrases
from bbq_torchrl.people.language.understander import cached_understander
from bbq_torchrl.utils import output

RESULT = Path(__file__).parents[1] / "results" / "talks.csv"


def main() -> None:
    """Runs the command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--agent", default="shipped:bbqn_map", help="a run folder, or shipped:name")
    parser.add_argument("--goals", type=int, default=10, help="of each kind")
    parser.add_argument("--seed", type=int, default=1_000, help="of goals, people and words")
    parser.add_argument("--control", choices=("all", "none"), default="all")
    parser.add_argument("--kinds", nargs="*", default=list(PEOPLE["kinds"]))
    parser.add_argument("--show", action="store_true", help="the conversations, too")
    parser.add_argument("--save", metavar="LABEL", help=f"into {RESULT.name} under this label")
    given = parser.parse_args()
    torch.set_num_threads(1)
    agent = TrainedAgent(given.agent)
    spelling = Spelling(agent.domain)
    nlu, nlg = cached_understander(agent.domain), Generator(spelling.domain)
    rules = tuple(RULES) if given.control == "all" else ()
    partner = Partner(agent, nlu, nlg, spelling, rules=rules)
    judge, names = Judge(partner.domain), load_phrases(agent.domain).names
    goals = [goal for goal in partner.domain.goals if judge.is_attainable(goal)]
    rows = []
    for kind in given.kinds:
        fit = [goal for goal in goals if suits(kind, goal)]
        chosen = random.Random(f"{given.seed} {kind}").sample(fit, min(given.goals, len(fit)))
        for seed, goal in enumerate(chosen, given.seed):
            talk = Talk(partner, Person(kind, goal, partner.domain, seed, names))
            talk.play(seed)
            said = [(answer.understood, answer.answered) for _, answer in talk.said]
            reasons = judge.reasons(goal, said, in_time=talk.ended != "turns")
            talk.counts.update(talks=1, success=not reasons and talk.ended == "agent")
            rows.append({"kind": kind, **{name: int(talk.counts[name]) for name in COUNTS}})
            if given.show:
                asked = " ".join(goal.requests)
                output.write(f"--- {kind}: {dict(goal.constraints)} ? {asked}\n")
                output.write("\n".join(talk.lines) + "\n")
                outcome = "success" if talk.counts["success"] else "failure"
                output.write(f"  => {outcome} {talk.ended} {', '.join(reasons)}\n")
    for name, share in shares(rows).items():
        output.write(f"{name}: {share}\n")
    for kind in given.kinds:
        found = total(row for row in rows if row["kind"] == kind)
        output.write(f"  {kind}: {found['success']}/{found['talks']}\n")
    if given.save:
        save(RESULT, rows, given.save, given.agent)


if __name__ == "__main__":
    main()
