"""A user with the traits of a profile, as a list of exceptions from the agenda-based user."""

from .draws import choose_index
from .user import User
from .values import DONT_CARE, plain

MIND_CHANGES_AFTER = range(2, 9)


class Person(User):
    """A user of one of the setting's profiles."""

    def __init__(self, world, goal, draws):
        self.world, self.goal, self.slots = world, goal, world.slots
        below = [sum(one.share for one in world.setting.users[: n + 1]) for n in range(9)]
        number = next(n for n, share in enumerate(below) if draws["profile"] < share)
        profile = world.setting.users[number]
        self.is_prone = {
            habit: draws[habit] < getattr(profile, habit)
            for habit in ("insists", "asks_late", "confirms", "withholds", "explains")
        }
        self.error_prob = profile.slot_error_prob
        if profile.patience is not None:
            self.leaves_after = 2 * between(profile.patience, draws["patience"])
        self.bears = 0 if profile.bears is None else between(profile.bears, draws["bears"])
        self.tells = None if profile.tells is None else between(profile.tells, draws["tells"])
        self.liking = {slot: (draws["order"][n], n) for n, slot in enumerate(world.slots)}
        self.replies, self.changed = 0, ""
        self.changes_after = MIND_CHANGES_AFTER[
            choose_index(draws["changes_at"], len(MIND_CHANGES_AFTER))
        ]
        self.others = {}
        if draws["changes_mind"] < profile.changes_mind:
            self.others = {
                slot: values[choose_index(draws["other"][number], len(values))]
                for number, slot in enumerate(world.slots)
                if (values := self._other_values(slot))
            }
        super().__init__(world, goal, draws)

    def _other_values(self, slot):
        """Returns the values of a constraint with which the whole goal can still be met."""
        world, wanted = self.world, {s: plain(v) for s, v in self.goal.constraints.items()}
        if slot not in wanted or slot not in world.active:
            return []
        rows = [
            {one: plain(value) for one, value in row.items()}
            for row in world.domain.records
            if all(asked in row for asked in self.goal.requests if asked != world.ticket)
        ]
        rows = [
            row
            for row in rows
            if all(
                value == DONT_CARE or row.get(one) == value
                for one, value in wanted.items()
                if one != slot and one not in world.domain.free_slots
            )
        ]
        values = {row[slot] for row in rows if slot in row}
        if slot in world.domain.free_slots:
            goals = world.domain.goals if rows else ()
            values = {plain(g.constraints[slot]) for g in goals if slot in g.constraints}
        values -= {wanted[slot], DONT_CARE}
        return [value for value in world.value_order[slot] if value in values]

    def _liked(self, slots):
        """Returns slots from the one that it likes best to the one that it likes least."""
        return sorted(slots, key=lambda slot: self.liking[slot], reverse=True)

    def _questions(self, slots):
        return self._liked({s for s in slots if s in self.requests and s != self.ticket})

    def _open(self, opening, draws):
        super()._open(opening, draws)
        if self.is_prone["asks_late"]:
            self.fired["person: keeps its questions"] += bool(self._questions(self.agenda))
            self.pending = {self.ticket}
        self._tell(opening)

    def reply(self, kind, act, slot, filled, offered, draws):
        """Answers an agent act that does not end the dialogue."""
        asked, told = self._questions(self.pending), set(self.constraints) - self.agenda
        if self.bears and asked and kind != "request" and not (kind == "inform" and slot in asked):
            self.bears -= 1
            self.fired["person: is passed over"] += 1
            self.leaves_after = self.leaves_after if self.bears else 0
        self.changed = self._change_mind(told)
        later = set()
        if self.is_prone["asks_late"] and not self.constraints_met and kind != "request":
            later = {one for one in self._questions(self.agenda) if one not in self.pending}
        self.agenda -= later
        super().reply(kind, act, slot, filled, offered, draws)
        self.agenda |= later - ({slot} if kind == "inform" else set())
        if self.changed:
            self._inform(self.changed)
            self.act = "inform" if self.act == "thanks" else self.act
        self._ask([one for one in asked if one in self.agenda], slot == self.complete)
        is_told = kind == "inform" and slot != self.complete and slot in self.constraints
        is_right = is_told and filled[slot] == self.constraints[slot]
        is_known = is_right or (kind == "request" and slot in told)
        is_mild = self.act in ("inform", "thanks") and not self.changed
        if self.is_prone["confirms"] and is_known and is_mild:
            self.fired[f"person: yes to {'a value' if is_right else 'a question'}"] += 1
            self.act = "confirm_answer"
        if self.informs:
            self._tell([slot, self.changed])

    def _change_mind(self, told):
        """Returns the slot whose constraint it replaces now, if any."""
        self.replies += 1
        slots = self._liked(told & set(self.others))
        if self.replies <= self.changes_after or not slots:
            return ""
        self.fired["person: changes its mind"] += 1
        self.constraints[slots[0]] = self.others[slots[0]]
        self.constraints_met, self.others = False, {}
        return slots[0]

    def _take_inform(self, slot, value, draws):
        super()._take_inform(slot, value, draws)
        if self.is_prone["withholds"] and self.constraints.get(slot, value) != value:
            self.fired["person: denies a value"] += 1
            del self.informs[slot]
            self.agenda.add(slot)
            self.act = "deny"

    def _judge_offer(self, filled):
        super()._judge_offer(filled)
        if self.is_prone["explains"] and not self.constraints_met:
            self.fired["person: explains"] += 1
            for slot, value in self.constraints.items():
                if filled.get(slot) != value:
                    self._inform(slot)

    def _ask(self, asked, is_offer):
        """Insists on a question asked, or asks one after a right offer."""
        late = self._questions(self.agenda)[:1]
        is_late = self.is_prone["asks_late"] and self.constraints_met
        question = []
        if self.is_prone["insists"] and asked:
            self.fired["person: asks again"] += 1
            question = asked
        elif is_late and is_offer and late:
            self.fired["person: asks after the offer"] += 1
            question = late
        if question:
            self.pending = set(question)
            self.act = "request" if self.act in ("inform", "thanks") else self.act
        elif self.is_prone["insists"] and self._questions(self.pending):
            self.pending -= {self.ticket}
        is_open = (self.agenda | self.pending) - {self.ticket}
        if is_late and not is_open and self.act == "request":
            self.fired["person: thanks after the last answer"] += 1
            self.act = "thanks"

    def _tell(self, first):
        """Tells as many constraints as it does in a turn, starting with those of some slots."""
        if self.tells is None or not self.constraints:
            return
        told = [
            s for s in self._liked(self.constraints) if self.informs.get(s) == self.constraints[s]
        ]
        order = [slot for slot in told if slot in first]
        order += [s for s in self._liked(self.constraints) if s in {*told, *self.agenda} - {*order}]
        self.fired["person: tells less"] += len(told) > self.tells
        self.fired["person: tells more"] += len(told) < min(self.tells, len(order))
        for slot in told:
            del self.informs[slot]
            self.agenda.add(slot)
        for slot in order[: self.tells]:
            self._inform(slot)


def between(bounds, u):
    """Returns an integer between two bounds, both included."""
    return bounds[0] + choose_index(u, bounds[1] - bounds[0] + 1)
