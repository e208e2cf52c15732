"""The features of a state, in the order of docs/how_it_works.md."""

PER_HUNDRED = 100.0
PER_TEN = 10.0


def features(world, tracker, turn):
    """Returns 2 acts + 7 slots + 3 + turn_width numbers; `turn` is the user's counter."""
    acts, slots, turn_width = world.acts, world.slots, world.domain.turn_width
    acts_so_far = turn + 1
    turn_place = min(acts_so_far, turn_width - 1)
    counts = knowledge_base_counts(tracker, slots, world.active)
    return [
        *(1.0 if act == tracker.heard_act else 0.0 for act in acts),
        *marks(tracker.heard_informs, slots),
        *marks(tracker.user_requests, slots),
        *(1.0 if act == tracker.agent_act else 0.0 for act in acts),
        *marks(tracker.agent_informs, slots),
        *marks(tracker.agent_requests, slots),
        *marks(tracker.held, slots),
        acts_so_far / PER_TEN,
        *(1.0 if place == turn_place else 0.0 for place in range(turn_width)),
        *(1.0 if count > 0 else 0.0 for count in counts),
        *(count / PER_HUNDRED for count in counts),
    ]


def marks(chosen, slots):
    """Returns a number for each slot: 1 if it is chosen."""
    return [1.0 if slot in chosen else 0.0 for slot in slots]


def knowledge_base_counts(tracker, slots, active):
    """Returns a count for each slot, then the number of records that match all values held."""
    matching = len(tracker.records.matching(tracker.held))
    counts = []
    for slot in slots:
        if slot not in active:
            counts.append(0)
        elif slot in tracker.held:
            counts.append(tracker.records.count_with(slot, tracker.held[slot]))
        else:
            counts.append(matching)
    return [*counts, matching]
