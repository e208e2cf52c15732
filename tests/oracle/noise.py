"""The error channel between user and tracker."""

from .draws import choose_index
from .values import plain


class Noise:
    """Errors in informed slots and in the act, with fixed probabilities."""

    def __init__(self, world):
        self.world = world
        self.setting = world.setting
        self.slots, self.fired = world.slots, world.fired
        self.error_values = {
            slot: [plain(value) for value in values]
            for slot, values in world.domain.error_values.items()
            if values
        }

    def transmit(self, act, informs, draws, rates):
        """Returns the act and the informs as the tracker hears them."""
        heard = {}
        replacements = []
        for number, slot in enumerate(self.slots):
            if slot not in informs:
                continue
            if draws["error"][number] >= rates.get(slot, self.setting.slot_error_prob):
                heard[slot] = informs[slot]
                continue
            mode = self.setting.slot_error_mode
            if mode == "mixed":
                mode = self._mixed(draws["error_kind"][number])
            if mode == "value":
                replacements.append((slot, self._other_value(slot, informs[slot], number, draws)))
            elif mode == "slot":
                replacements.extend(self._other_slot(slot, number, draws))
            else:
                self.fired["error: delete"] += 1
        for slot, value in replacements:
            if slot in heard:
                self.fired["error: overlays another slot"] += 1
            heard[slot] = value
        if draws["intent"] < self.setting.intent_error_prob:
            self.fired["error: intent"] += 1
            acts = self.world.acts
            act = acts[choose_index(draws["intent_act"], len(acts))]
        return act, heard

    def _mixed(self, u):
        if u < 1 / 3:
            return "value"
        return "slot" if u < 2 / 3 else "delete"

    def _other_value(self, slot, value, number, draws):
        if slot not in self.error_values:
            self.fired["error: value, but no list"] += 1
            return value
        self.fired["error: value"] += 1
        values = self.error_values[slot]
        return values[choose_index(draws["error_value"][number], len(values))]

    def _other_slot(self, slot, number, draws):
        others = [
            other
            for other in self.slots
            if other != slot and other in self.world.active and other in self.error_values
        ]
        if not others:
            self.fired["error: slot, but no other"] += 1
            return []
        self.fired["error: slot"] += 1
        other = others[choose_index(draws["error_slot"][number], len(others))]
        values = self.error_values[other]
        return [(other, values[choose_index(draws["error_value"][number], len(values))])]
