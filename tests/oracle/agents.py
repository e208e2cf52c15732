"""Agents that follow a scripted policy but sometimes take another action."""

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
    """Follows one of the domain's script or careful policies, with some other actions."""

    def __init__(self, world, number, random):
        self.random = random
        self.legal = [world.action_names[index] for index in world.legal_actions()]
        ticket = f"inform({world.ticket})"
        odd = ("confirm_answer", "confirm_question", "greeting", "deny", ticket)
        self.odd = [name for name in self.legal if name in odd or "choice" in name]
        specs = [spec for spec in world.domain.policies.values() if spec.kind != "repair"]
        spec = specs[number % len(specs)]
        if spec.kind == "script":
            self.policy = follow(spec.steps)
        else:
            self.policy = careful([s for s in spec.steps if f"request({s})" in self.legal])
        self.has_asked_again = False
        self.stray = STRAYS[number // len(specs) % len(STRAYS)]

    def act(self, dialogue):
        """Returns the name of a legal action."""
        if self.random.random() < self.stray:
            return self.random.choice(self.odd if self.random.random() < ODD else self.legal)
        action = "thanks" if self.has_asked_again else self.policy(dialogue)
        if dialogue.world.setting.users:
            user, ends = dialogue.user, action == "thanks"
            slots = user.pending - {dialogue.world.ticket} if ends else user.constraints
            told = [name for slot in sorted(slots) if (name := f"inform({slot})") in self.legal]
            if told and self.random.random() < (ANSWERS if ends else TELLS):
                return self.random.choice(told)
        if action == "thanks" and not dialogue.user.faults():
            again = [f"request({slot})" for slot in dialogue.user.constraints]
            again = [name for name in again if name in self.legal]
            if again and not self.has_asked_again and self.random.random() < ASKS_AGAIN:
                self.has_asked_again = True
                return self.random.choice(again)
        if action == "thanks" and "closing" in self.legal and self.random.random() < CLOSES:
            return "closing"
        return action if action in self.legal else self.random.choice(self.legal)


def follow(script):
    """Returns an agent that plays its script whatever the user says."""
    return lambda dialogue: script[min(dialogue.turn_count // 2, len(script) - 1)]


def careful(asked):
    """Returns an agent that requests unfilled slots, answers requests, offers, and thanks."""

    def act(dialogue):
        tracker = dialogue.tracker
        if tracker.agent_act is None or tracker.agent_act == "request":
            requested = [asked.index(slot) for slot in tracker.agent_requests if slot in asked]
            already = max(requested, default=-1)
            for slot in asked[already + 1 :]:
                if slot not in tracker.held:
                    return f"request({slot})"
        if dialogue.world.complete in tracker.agent_informs:
            return "thanks"
        for slot in dialogue.world.slots:
            is_open = slot in tracker.user_requests and slot != dialogue.world.ticket
            if is_open and f"inform({slot})" in dialogue.world.action_names:
                return f"inform({slot})"
        return f"inform({dialogue.world.complete})"

    return act
