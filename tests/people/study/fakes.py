"""A talker without networks and language: people write slot=value, "ask slot", "book" and "bye"."""

import json
import time

from bbq_torchrl.domains import fold
from bbq_torchrl.people.study import Belief, Beliefs, Frame, Reply


class FakeTalker:
    """Holds what it hears; answers and offers from the records that match."""

    def __init__(self, domain):
        self.labels = {"moviename": "movie", "numberofpeople": "number of people"}
        self.domain, self.seconds, self.calls = domain, 0.0, 0

    def fingerprint(self, agent):
        return f"weights of {agent}"

    def reply(self, agent, state, text, seed):
        self.calls += 1
        time.sleep(self.seconds)
        if text == "crash":
            raise RuntimeError("the agent is out of order")
        held = {} if state is None else json.loads(state)
        pairs = (part.partition("=") for part in text.split(";") if "=" in part)
        heard = {slot.strip(): value.strip() for slot, _, value in pairs}
        asked = tuple(text.split()[1:]) if text.startswith("ask ") else ()
        held |= heard
        known = {slot: v for slot, v in held.items() if slot not in self.domain.free_slots}
        records = self.domain.records
        rows = [r for r in records if all(fold(r.get(s, "")) == fold(known[s]) for s in known)]
        said, answer = Frame("request", heard, ("city",)), f"Which city? ({len(text)} letters)"
        if asked:
            row = next((row for row in rows if set(asked) <= set(row)), {})
            values = {slot: row.get(slot, "no match") for slot in asked}
            held |= values
            said, answer = Frame("inform", values), f"It is {', '.join(values.values())}."
        elif text == "book":
            found = "ticket available" if rows else "no match"
            said = Frame("inform", {**held, "taskcomplete": found})
            answer = f"I can book that: {found}."
        elif text == "bye":
            said, answer = Frame("thanks"), "Goodbye."
        actions = (
            Belief("request(city)", 1.25, (1.0, 1.5), (0.5, 2.0), 0.75),
            Belief("thanks", -3.0, (-3.5, -2.5), (-4.0, -2.0), 0.25),
        )
        return Reply(
            text=answer,
            understood=Frame("inform" if heard else "request", heard, asked),
            answered=said,
            confidence=0.875,
            ended=text == "bye",
            state=json.dumps(held),
            beliefs=Beliefs(actions, 0.5625),
        )


def make(study):
    """The talker that --talker names."""
    return FakeTalker(study.domain)


def script(domain, goal):
    """The messages of a person who gets all they want, without the farewell."""
    wishes = "; ".join(f"{slot}={value}" for slot, value in goal.constraints.items())
    questions = [f"ask {' '.join(goal.requests)}"] if goal.requests else []
    return [wishes, *questions, "book"]
