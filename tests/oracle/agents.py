"""Agents that follow a scripted policy but sometimes take another action."""

STRAYS = (1.0, 0.3, 0.1, 0.0)
"""The probabilities of another action; with the first the agent is completely random."""

ODD = 0.3
"""The probability that another action is one of the rare acts."""

ASKS_AGAIN = 0.8
"""The probability that an agent about to succeed asks again, so that an error can still occur."""

ANSWERS, TELLS = 0.7, 0.25
"""The probabilities that an agent answers a question before it ends, and tells a constraint."""

CLOSES = 0.2
"""The probability that an agent closes instead of giving thanks."""


class StrayingAgent:
    """Requests the slots of the domain's careful policy, with some other actions."""

    def __init__(self, world, number, random):
        self.random = random
        self.legal = [world.action_names[index] for index in world.legal_actions()]
        odd = ("confirm_answer", "confirm_question", "greeting", "deny", f"inform({world.ticket})")
        self.odd = [name for name in self.legal if name in odd or "choice" in name]
        asked = world.domain.policies["careful"].steps
        self.asked = [slot for slot in asked if f"request({slot})" in self.legal]
        self.has_asked_again = False
        self.stray = STRAYS[number % len(STRAYS)]

    def act(self, dialogue):
        """Returns the name of a legal action."""
        if self.random.random() < self.stray:
            return self.random.choice(self.odd if self.random.random() < ODD else self.legal)
        action = "thanks" if self.has_asked_again else self.planned(dialogue)
        user, ends = dialogue.user, action == "thanks"
        slots = user.pending - {dialogue.world.ticket} if ends else user.constraints
        told = [name for slot in sorted(slots) if (name := f"inform({slot})") in self.legal]
        if told and self.random.random() < (ANSWERS if ends else TELLS):
            return self.random.choice(told)
        again = [name for slot in user.constraints if (name := f"request({slot})") in self.legal]
        may_ask = ends and again and not user.faults() and not self.has_asked_again
        if may_ask and self.random.random() < ASKS_AGAIN:
            self.has_asked_again = True
            return self.random.choice(again)
        if ends and "closing" in self.legal and self.random.random() < CLOSES:
            return "closing"
        return action if action in self.legal else self.random.choice(self.legal)

    def planned(self, dialogue):
        """Requests unfilled slots, answers requests, offers, and thanks."""
        asked, world, tracker = self.asked, dialogue.world, dialogue.tracker
        if tracker.agent_act is None or tracker.agent_act == "request":
            requested = [asked.index(slot) for slot in tracker.agent_requests if slot in asked]
            already = max(requested, default=-1)
            for slot in asked[already + 1 :]:
                if slot not in tracker.held:
                    return f"request({slot})"
        if world.complete in tracker.agent_informs:
            return "thanks"
        for slot in world.slots:
            is_open = slot in tracker.user_requests and slot != world.ticket
            if is_open and f"inform({slot})" in world.action_names:
                return f"inform({slot})"
        return f"inform({world.complete})"
