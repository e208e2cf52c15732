"""The knowledge base: records, looked up by values."""

from collections import Counter

from .values import DONT_CARE, NO_MATCH, RESERVED, plain


class Records:
    """Records as dicts; `value_order` breaks ties between equally frequent values."""

    def __init__(self, records, free_slots, value_order):
        self.records = [{slot: plain(value) for slot, value in row.items()} for row in records]
        self.free_slots = set(free_slots)
        self.value_number = {
            slot: {plain(value): number for number, value in enumerate(values)}
            for slot, values in value_order.items()
        }
        self.rows_with = {}
        for number, row in enumerate(self.records):
            for slot, value in row.items():
                self.rows_with.setdefault((slot, value), set()).add(number)
        self.cache = {}

    def matching(self, held):
        """Returns the numbers of the records that match all values held."""
        wanted = frozenset(
            (slot, value)
            for slot, value in held.items()
            if slot not in self.free_slots and value != DONT_CARE
        )
        if wanted not in self.cache:
            rows = set(range(len(self.records)))
            for slot, value in wanted:
                rows &= self.rows_with.get((slot, value), set()) if value != NO_MATCH else set()
            self.cache[wanted] = rows
        return self.cache[wanted]

    def count_with(self, slot, value):
        """Returns the number of records with this value of this slot."""
        if slot in self.free_slots or value in RESERVED:
            return 0
        return len(self.rows_with.get((slot, value), ()))

    def values_on(self, slot, rows):
        """Returns the number of rows with each value of a slot."""
        return Counter(self.records[row][slot] for row in rows if slot in self.records[row])

    def in_order(self, slot, values):
        """Returns values of a slot in their fixed order."""
        return sorted(values, key=self.value_number[slot].__getitem__)
