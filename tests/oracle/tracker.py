"""The state tracker: the values held, and the completion of the agent's acts."""

from .values import AVAILABLE, NO_MATCH


class Tracker:
    """Holds the latest value of each slot, from either side."""

    def __init__(self, world):
        self.records, self.fired = world.records, world.fired
        self.ticket, self.complete = world.ticket, world.complete
        self.held = {}
        self.heard_act = ""
        self.heard_informs = {}
        self.user_requests = set()
        self.agent_act = None
        self.agent_informs = {}
        self.agent_requests = set()

    def hear(self, act, informs, requests):
        """Updates the state with the user's act as transmitted."""
        self.heard_act = act
        self.heard_informs = dict(informs)
        self.user_requests = set(requests)
        self.held.update(informs)

    def speak(self, kind, act, slot):
        """Completes the agent's act with values and updates the state."""
        self.agent_informs = {}
        self.agent_requests = set()
        self.agent_act = act if kind == "act" else kind
        if kind == "request":
            self.agent_requests = {slot}
        elif kind == "inform":
            rows = self.records.matching(self.held)
            if slot == self.complete:
                self.agent_informs = dict(self.held)
                self.agent_informs[slot] = self._availability(rows)
            elif slot == self.ticket:
                self.agent_informs[slot] = self._availability(rows)
            else:
                self.agent_informs[slot] = self._most_frequent(slot, rows)
            self.held.update(self.agent_informs)
        elif kind == "multiple_choice":
            rows = self.records.matching(self.held)
            choices = self.records.values_on(slot, rows)
            self.agent_informs[slot] = AVAILABLE if choices else NO_MATCH  # and nothing is held

    def _availability(self, rows):
        return AVAILABLE if rows else NO_MATCH

    def _most_frequent(self, slot, rows):
        counts = self.records.values_on(slot, rows)
        if not counts:
            self.fired["fill: no match"] += 1
            return NO_MATCH
        most = max(counts.values())
        best = [value for value, count in counts.items() if count == most]
        if slot in self.held:
            self.fired["fill: slot held already"] += 1
        self.fired["fill: only one most frequent" if len(best) == 1 else "fill: tie"] += 1
        return self.records.in_order(slot, best)[0]
