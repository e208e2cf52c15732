"""Agents that follow a script or their user's wishes but sometimes take another action."""

STRAYS = (1.0, 0.3, 0.1, 0.0)
"""The probabilities of another action; with the first the agent is completely random."""

ODD = 0.3
"""The probability that another action is one of the rare acts."""

ASKS_AGAIN = 0.5
"""The probability that an agent about to succeed asks again, so that an error can still occur."""

ANSWERS, TELLS = 0.7, 0.25
"""With users that differ: the probabilities that an agent answers a question before it ends, and
that it tells a constraint."""

CLOSES = 0.2
"""The probability that an agent closes instead of giving thanks."""


class StrayingAgent:
    """Follows one of the domain's scripts, or the user's wishes, with some other actions."""

    def __init__(self, world, number, random):
        self.random = random
        self.legal = [world.action_names[index] for index in world.legal_actions()]
        ticket = f"inform({world.ticket})"
        odd = ("confirm_answer", "confirm_question", "greeting", "deny", ticket)
        self.odd = [name for name in self.legal if name in odd or "choice" in name]
        policies = world.domain.policies.values()
        plans = [*(spec.steps for spec in policies if spec.kind == "script"), ()]
        self.script = plans[number % len(plans)]
        self.has_asked_again = False
        self.stray = STRAYS[number // len(plans) % len(STRAYS)]

    def act(self, dialogue):
        """Returns the name of a legal action."""
        if self.random.random() < self.stray:
            return self.random.choice(self.odd if self.random.random() < ODD else self.legal)
        plan = self.script[dialogue.turn_count // 2 :] or wished(dialogue)
        action = "thanks" if self.has_asked_again else plan[0]
        if dialogue.world.setting.users:
            user, ends = dialogue.user, action == "thanks"
            slots = user.pending - {dialogue.world.ticket} if ends else user.constraints
            told = [name for slot in sorted(slots) if (name := f"inform({slot})") in self.legal]
            if told and self.random.random() < (ANSWERS if ends else TELLS):
                return self.random.choice(told)
        if action == "thanks" and dialogue.user.is_content():
            again = [f"request({slot})" for slot in dialogue.user.constraints]
            again = [name for name in again if name in self.legal]
            if again and not self.has_asked_again and self.random.random() < ASKS_AGAIN:
                self.has_asked_again = True
                return self.random.choice(again)
        if action == "thanks" and "closing" in self.legal and self.random.random() < CLOSES:
            return "closing"
        return action if action in self.legal else self.random.choice(self.legal)


def wished(dialogue):
    """Returns the actions that the user still needs, as only the oracle knows."""
    user, world = dialogue.user, dialogue.world
    heard = [s for s, value in user.constraints.items() if dialogue.tracker.held.get(s) == value]
    asked = (user.pending | user.agenda) - {world.ticket, *user.constraints}
    return [
        *(f"request({slot})" for slot in user.constraints if slot not in heard),
        *(f"inform({slot})" for slot in sorted(asked)),
        *([] if user.constraints_met else [f"inform({world.complete})"]),
        "thanks",
    ]
