"""Measures free conversations of twenty kinds of people with an agent: ``results/talks.csv``.

The people (``scripts/talks/people.yaml``) type in words that the understanding has not learned
from. Understanding, agent, dialogue control and judge are those of the chat and the study.

    python scripts/measure_talks.py [--agent shipped:bbqn_map] [--goals 10] [--show terse]
"""

from __future__ import annotations

import argparse
import csv
import random
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from talks.person import PEOPLE, Person, Said

from bbq_torchrl.domains.values import RESERVED_TEXT
from bbq_torchrl.people.dialogue import RULE_NAMES
from bbq_torchrl.people.dialogue.agent import TrainedAgent
from bbq_torchrl.people.dialogue.judge import Judge
from bbq_torchrl.people.dialogue.partner import Partner
from bbq_torchrl.people.dialogue.spelling import Spelling
from bbq_torchrl.people.language import Generator, load_phrases
from bbq_torchrl.people.language.cache import cached_understander
from bbq_torchrl.utils import output

if TYPE_CHECKING:
    from collections.abc import Mapping

    from bbq_torchrl.domains import Goal
    from bbq_torchrl.people.dialogue.partner import Answer

RESULT = Path(__file__).parents[1] / "results" / "talks.csv"
_MOST_TEXTS = 25
_RESERVED = frozenset(RESERVED_TEXT.values())
COUNTS = (
    "texts", "values", "dropped", "acted", "wrong", "questions", "answered", "late_questions",
    "late_answered", "asked", "repeated", "yes", "yes_ends", "never", "turned_round", "unknown",
    "reported", "cut_off",
)  # fmt: skip
"""What is counted of a conversation; :class:`Talk` says what each is."""
_FAULTS = ("dropped", "wrong", "repeated", "turned_round", "cut_off")


class Talk:
    """One conversation, and its counts.

    - texts: of the person
    - values: told, and dropped: of them neither held nor asked about after the reply
    - acted: replies by an act, and wrong: of them on a value or question that was not meant, or not
      on a question that was
    - questions: of the person, and answered: of them in the next reply; late: the same after an
      offer
    - asked: questions of the agent, and repeated: of them asked before, though nothing new was told
      since, or the answer was
    - yes: to an offer, and yes_ends: of them the conversation ended
    - never: values excluded, and turned_round: of them held afterwards
    - unknown: names that the domain lacks, and reported: of them told or asked about
    - cut_off: ended by the agent without a yes or a farewell
    """

    def __init__(self, partner: Partner, person: Person) -> None:
        self.lines: list[str] = []
        self.said: list[tuple[Said, Answer]] = []
        self.counts: Counter[str] = Counter()
        self.ended = ""
        self._partner, self._person = partner, person
        self._asked: dict[str, int] = {}
        self._told: dict[str, tuple[str, int]] = {}
        self._news = -1

    def play(self, seed: int) -> None:
        """Talks until somebody ends it."""
        answer: Answer | None = None
        for turn in range(_MOST_TEXTS):
            said = self._person.say(answer, self._held(answer))
            memory = None if answer is None else answer.memory
            now = self._partner.reply(memory, said.text, seed * 1000 + turn)
            earlier = self.counts.copy()
            self._count(turn, said, answer, now)
            self.said.append((said, now))
            new = self.counts - earlier
            faults = [name for name in _FAULTS if new[name]]
            faults += ["unanswered"] * (new["answered"] < new["questions"])
            note = f"heard {now.heard}" if now.acted else "asks"
            marks = "".join(f" !{name}" for name in faults)
            self.lines += [f"  person: {said.text}", f"  agent:  {now.text}  [{note}]{marks}"]
            answer, self.ended = now, now.ended
            if self.ended or said.act == "bye":
                break
        if answer is not None:
            self._person.hears(answer)
        self.ended = self.ended or "left"

    def _held(self, answer: Answer | None) -> Mapping[str, str]:
        if answer is None or answer.memory.state is None:
            return {}
        return self._partner._tracking.held(answer.memory.state)

    def _count(self, turn: int, said: Said, before: Answer | None, now: Answer) -> None:
        count = self.counts
        count["texts"] += 1
        held, act = self._held(now), now.said
        waiting = now.memory.asking.waiting
        kept = {**held, **(waiting.informs if waiting else {})}
        asked = {*act.requests, *(act.informs if act.act == "not_sure" else ())}
        is_vague = act.act == "not_sure" and not act.informs
        complete = self._partner.domain.complete_slot
        for slot, value in said.informs.items():
            count["values"] += 1
            is_lost = kept.get(slot) != value and slot not in asked and not is_vague
            count["dropped"] += is_lost and now.ended != "agent"
            if self._told.get(slot, ("",))[0] != value:
                self._news = turn
            self._told[slot] = (value, turn)
        if now.acted:
            count["acted"] += 1
            heard = {k: v for k, v in now.heard.informs.items() if v not in _RESERVED}
            is_foreign = any(said.informs.get(k, self._earlier(k)) != v for k, v in heard.items())
            questions = set(now.heard.requests) - {self._partner.domain.ticket_slot}
            is_other = bool(questions - set(said.requests)) or not set(said.requests) <= questions
            count["wrong"] += is_foreign or is_other
        was_offered = any(complete in answer.said.informs for _, answer in self.said)
        for slot in said.requests:
            is_answered = act.informs.get(slot, "no match") not in _RESERVED
            count["questions"] += 1
            count["answered"] += is_answered
            count["late_questions"] += was_offered
            count["late_answered"] += was_offered and is_answered
            self._news = turn
        self._count_question(turn, said, now)
        is_offered = before is not None and complete in before.said.informs
        if said.act == "yes" and is_offered and not (before and before.memory.checked):
            count["yes"] += 1
            count["yes_ends"] += now.ended == "agent"
        for slot, value in said.never.items():
            count["never"] += 1
            count["turned_round"] += held.get(slot) == value
            self._news = turn
        if said.unknown:
            count["unknown"] += 1
            is_told = not now.acted or said.unknown in act.requests
            count["reported"] += is_told and said.unknown not in held
        is_end = now.ended in ("agent", "person")
        wants_end = said.act in ("yes", "bye", "book")
        count["cut_off"] += is_end and not wants_end

    def _count_question(self, turn: int, said: Said, now: Answer) -> None:
        """Counts a question of the agent's, and whether it was asked before in vain."""
        act = now.said
        if not (act.requests or act.act == "not_sure"):
            return
        slots = [now.memory.checked] if now.memory.checked else [*act.requests, *act.informs]
        key = f"{'check' if now.memory.checked else act.act} {' '.join(slots)}"
        since = self._asked.get(key)
        self._asked[key] = turn
        self.counts["asked"] += 1
        if since is None or said.act == "nothing":
            return
        has_answer = any(self._told.get(slot, ("", -1))[1] > since for slot in slots)
        self.counts["repeated"] += self._news <= since or has_answer

    def _earlier(self, slot: str) -> str:
        """Returns the value that the person told before: a reply may join it."""
        return self._told.get(slot, ("", 0))[0]


def main() -> None:
    """Runs the command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--agent", default="shipped:bbqn_map", help="a run folder, or shipped:name")
    parser.add_argument("--goals", type=int, default=10, help="of each kind")
    parser.add_argument("--seed", type=int, default=1_000, help="of goals, people and words")
    parser.add_argument("--control", choices=("all", "none"), default="all")
    parser.add_argument("--kinds", nargs="*", default=list(PEOPLE["kinds"]))
    parser.add_argument("--show", action="store_true", help="the conversations, too")
    parser.add_argument("--save", type=Path, help=f"a table such as {RESULT.name}")
    given = parser.parse_args()
    torch.set_num_threads(1)
    agent = TrainedAgent(given.agent)
    spelling = Spelling(agent.domain)
    rules = RULE_NAMES if given.control == "all" else ()
    nlu, nlg = cached_understander(agent.domain), Generator(spelling.domain)
    partner = Partner(agent, nlu, nlg, spelling, rules=rules)
    judge, names = Judge(partner.domain), load_phrases(agent.domain).names
    goals = [goal for goal in partner.domain.goals if judge.is_attainable(goal)]
    rows = []
    for kind in given.kinds:
        needs = set(PEOPLE["kinds"][kind].get("needs", ()))
        fit = [goal for goal in goals if needs <= goal.constraints.keys()]
        chosen = random.Random(f"{given.seed} {kind}").sample(fit, min(given.goals, len(fit)))
        for number, goal in enumerate(chosen):
            talk = Talk(partner, Person(kind, goal, partner.domain, given.seed + number, names))
            talk.play(given.seed + number)
            said = [(answer.heard, answer.said) for _, answer in talk.said]
            reasons = judge.reasons(goal, said, in_time=talk.ended != "turns")
            success = not reasons and talk.ended == "agent"
            rows.append(
                {
                    "kind": kind, "goal": agent.domain.goals.index(_same(agent, partner, goal)) + 1,
                    "seed": given.seed + number, "success": int(success), "ended": talk.ended,
                    "reasons": "; ".join(reasons), **{k: int(talk.counts[k]) for k in COUNTS},
                }
            )  # fmt: skip
            if given.show:
                output.write(f"--- {kind}: {dict(goal.constraints)} ? {' '.join(goal.requests)}\n")
                output.write("\n".join(talk.lines) + "\n")
                output.write(f"  => {'success' if success else 'failure'} {talk.ended} {reasons}\n")
    output.write(summary(rows))
    if given.save:
        with given.save.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)


def summary(rows: list[dict]) -> str:
    """Returns the shares of all conversations, and the success of each kind."""
    total = Counter[str]()
    for row in rows:
        total.update({name: row[name] for name in ("success", *COUNTS)})
    shares = {
        "success": ("success", None), "values dropped": ("dropped", "values"),
        "wrong acts": ("wrong", "acted"), "answered next": ("answered", "questions"),
        "answered next, after an offer": ("late_answered", "late_questions"),
        "repeated questions, of texts": ("repeated", "texts"),
        "yes ends": ("yes_ends", "yes"), "turned round": ("turned_round", "never"),
        "unknown names reported": ("reported", "unknown"), "cut off": ("cut_off", None),
    }  # fmt: skip
    lines = []
    for name, (part, whole) in shares.items():
        of = total[whole] if whole else len(rows)
        lines.append(f"{name}: {total[part]}/{of} = {total[part] / max(of, 1):.3f}")
    lines.append(f"texts: {total['texts'] / len(rows):.2f}")
    kinds = dict.fromkeys(row["kind"] for row in rows)
    for kind in kinds:
        of = [row["success"] for row in rows if row["kind"] == kind]
        lines.append(f"  {kind}: {sum(of)}/{len(of)}")
    return "\n".join(lines) + "\n"


def _same(agent: TrainedAgent, partner: Partner, goal: Goal) -> Goal:
    return agent.domain.goals[partner.domain.goals.index(goal)]


if __name__ == "__main__":
    main()
