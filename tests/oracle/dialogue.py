"""One dialogue between an agent and the user: turns, ends and rewards."""

from collections import Counter
from dataclasses import dataclass

from .draws import choose_index
from .features import features
from .knowledge_base import Records
from .noise import Noise
from .person import Person
from .tracker import Tracker
from .user import User
from .values import plain

SUCCESS_REWARD = 40.0
FAILURE_REWARD = -10.0
TURN_REWARD = -1.0


def value_order_of(domain):
    """Returns every slot's values in the order of the domain's data."""
    order = {slot: {} for slot in domain.slots}
    for slot, values in domain.error_values.items():
        order[slot].update(dict.fromkeys(plain(value) for value in values))
    for row in (*domain.records, *(goal.constraints for goal in domain.goals)):
        for slot, value in row.items():
            order[slot][plain(value)] = None
    return {slot: list(values) for slot, values in order.items()}


@dataclass(frozen=True)
class Setting:
    """A setting of the environment; by default all slots are active."""

    slot_error_prob: float = 0.0
    slot_error_mode: str = "value"
    intent_error_prob: float = 0.0
    max_turn: int = 40
    active: tuple[str, ...] | None = None
    extension: int | None = None
    users: tuple = ()

    def active_slots(self, domain):
        """Returns the slots active in this setting, in slot order."""
        chosen = domain.slots if self.active is None else self.active
        if self.extension is not None:
            chosen = (*domain.essential, *domain.extension_order[: self.extension])
        return [slot for slot in domain.slots if slot in chosen]


class World:
    """The objects that all dialogues of a setting share."""

    def __init__(self, domain, setting):
        self.domain = domain
        self.setting = setting
        self.slots = list(domain.slots)
        self.acts = list(domain.acts)
        self.ticket, self.complete = domain.special_slots
        self.action_names = [str(action) for action in domain.actions]
        self.active = set(setting.active_slots(domain))
        self.fired = Counter()
        self.value_order = value_order_of(domain)
        self.records = Records(domain.records, domain.free_slots, self.value_order)
        self.noise = Noise(self)

    def legal_actions(self):
        """Returns the numbers of the slotless actions and those of active slots."""
        return [
            number
            for number, action in enumerate(self.domain.actions)
            if action.slot is None or action.slot in self.active
        ]


class Dialogue:
    """One dialogue, from its first user act to its end."""

    def __init__(self, world, draws):
        goals = world.domain.goals
        self.world = world
        self.goal_number = choose_index(draws["goal"], len(goals))
        kind = Person if world.setting.users else User
        self.user = kind(world, goals[self.goal_number], draws)
        self.tracker = Tracker(world)
        self.tracker.hear(self.user.act, self.user.informs, self.user.pending)
        self.meant_informs = dict(self.user.informs)
        self.turn_count = 0
        self.done = False
        self.success = False
        self.reward = 0.0

    def turn(self, action, draws):
        """Plays one agent act and the user's answer to it."""
        if self.done:
            raise ValueError("the dialogue has ended")
        kind, act, slot = action.kind, action.act, action.slot
        offered = self._offered(slot) if kind == "multiple_choice" else []
        self.tracker.speak(kind, act, slot)
        self.turn_count += 2
        if self.turn_count > min(self.world.setting.max_turn, self.user.leaves_after):
            is_patient = self.turn_count > self.world.setting.max_turn
            self.world.fired["end: out of " + ("turns" if is_patient else "patience")] += 1
            self._end(success=False)
            return
        self.user.remember_last_act()
        if kind == "act" and act in ("thanks", "closing"):
            self._judge(act)
            return
        self.user.reply(kind, act, slot, self.tracker.agent_informs, offered, draws)
        self.reward = TURN_REWARD
        self.meant_informs = dict(self.user.informs)
        heard_act, self.user.informs = self.world.noise.transmit(
            self.user.act, self.user.informs, draws, self.user.error_prob
        )
        self.tracker.hear(heard_act, self.user.informs, self.user.pending)

    def _offered(self, slot):
        records = self.world.records
        values = records.values_on(slot, records.matching(self.tracker.held))
        return records.in_order(slot, values)

    def _judge(self, act):
        faults = self.user.faults()
        self.world.fired[f"end: {act}, {'failure' if faults else 'success'}"] += 1
        if len(faults) == 1:
            self.world.fired[f"end: failure only by {faults[0]}"] += 1
        self._end(success=not faults)

    def _end(self, *, success):
        self.done = True
        self.success = success
        self.reward = SUCCESS_REWARD if success else FAILURE_REWARD
        self.user.close()
        self.meant_informs = {}
        self.tracker.hear(self.user.act, self.user.informs, self.user.pending)

    def features(self):
        """Returns the features of this state."""
        return features(self.world, self.tracker, self.turn_count)
