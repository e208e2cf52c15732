"""The bit-packed knowledge base against counting by hand."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from oracle.small import SLOTS, small_domain

from bbq_torchrl.domains import Goal, tensorize
from bbq_torchrl.simulator import KnowledgeBase
from bbq_torchrl.simulator.bits import byte_counts, pack, popcount

NONE, DONT_CARE, NO_MATCH, FIRST = 0, 1, 2, 4
FREE = {"numberofpeople", "ticket", "taskcomplete"}
INFORMED = ("moviename", "city", "date", "theater", "genre")
VALUES = {"moviename": 3, "city": 4, "date": 12, "theater": 20, "genre": 1, "numberofpeople": 3}

rows = st.lists(
    st.fixed_dictionaries(
        {}, optional={slot: st.integers(0, VALUES[slot] - 1) for slot in VALUES}
    ).filter(bool),
    min_size=1,
    max_size=150,
)


@st.composite
def shelves(draw):
    """Draws showings and values held, as texts."""
    showings = draw(rows)
    held = {}
    for slot in VALUES:
        # Mostly a value of a showing, so that something matches.
        source = draw(st.sampled_from(showings))
        choices = [NONE, NONE, DONT_CARE, NO_MATCH] if draw(st.booleans()) else []
        if slot in source:
            choices += [str(source[slot])] * 2
        if choices:
            held[slot] = draw(st.sampled_from(choices))
    texts = tuple({slot: f"v{value}" for slot, value in row.items()} for row in showings)
    return texts, {s: f"v{v}" if isinstance(v, str) else v for s, v in held.items()}


@settings(max_examples=150, deadline=None)
@given(shelf=shelves(), slot=st.sampled_from(INFORMED))
def test_look_ups_agree_with_going_through_the_records_one_by_one(shelf, slot):
    showings, held = shelf
    domain = tensorize(small_domain(Goal({}), records=showings))
    knowledge_base = KnowledgeBase(domain)
    ids = torch.tensor(
        [
            value if isinstance(value := held.get(name, NONE), int) else words.index(value)
            for name, words in zip(SLOTS, domain.vocabulary, strict=True)
        ]
    )

    def meets(showing, name, value):
        if name in FREE or value in (NONE, DONT_CARE):
            return True
        return value != NO_MATCH and showing.get(name) == value

    matching = [row for row in showings if all(meets(row, *item) for item in held.items())]
    assert int(knowledge_base.matching_counts(ids)) == len(matching)

    for name, literal in zip(SLOTS, knowledge_base.value_counts(ids).tolist(), strict=True):
        same = sum(row.get(name) == held.get(name, NONE) for row in showings)
        assert literal == (0 if name in FREE else same)

    position = SLOTS.index(slot)
    words = domain.vocabulary[position]
    counted = Counter(row[slot] for row in matching if slot in row)
    counts, total = knowledge_base.counts_by_value(ids, torch.tensor(position))
    assert int(total) == len(matching)
    counted_ids = knowledge_base.counted_values(torch.tensor(position)).tolist()
    assert {words[v]: n for v, n in zip(counted_ids, counts.tolist(), strict=True) if n} == counted
    assert counted_ids == sorted(counted_ids)

    value, has_match = knowledge_base.fill(ids, torch.tensor(position))
    most = max(counted.values(), default=0)
    best = [words.index(word) for word, count in counted.items() if count == most]
    assert int(value) == min(best, default=NO_MATCH)
    assert bool(has_match) == bool(matching)


@given(st.lists(st.booleans(), min_size=1, max_size=200))
def test_packed_sets_count_their_members(members):
    words = pack(torch.tensor(members))
    assert words.shape == (-(-len(members) // 64),)
    assert int(popcount(words)) == sum(members)
    by_byte = [sum(members[start : start + 8]) for start in range(0, len(members), 8)]
    assert byte_counts(words)[: len(by_byte)].tolist() == by_byte


def test_many_dialogues_at_once_fill_as_one_does(movie):
    domain = tensorize(movie)
    shelf = KnowledgeBase(domain)
    generator = torch.Generator().manual_seed(0)
    count = 5_000  # more than are filled in one block
    record = torch.randint(domain.records.shape[0], (count,), generator=generator)
    is_held = torch.rand(count, domain.n_slots, generator=generator) < 0.3
    held = domain.records[record] * is_held
    told = [action.slot for action in movie.actions if action.kind == "inform"]
    slots = [domain.slot[slot] for slot in told if slot not in movie.special_slots]
    slot = torch.tensor(slots)[torch.randint(len(slots), (count,), generator=generator)]
    value, has_match = shelf.fill(held, slot)
    assert has_match.all()
    for row in range(0, count, 499):
        alone = shelf.fill(held[row], slot[row])
        assert (int(alone[0]), bool(alone[1])) == (int(value[row]), bool(has_match[row]))


def test_memory_grows_with_the_records_and_not_with_their_square(movie):
    def bits(n_records):
        shelf = KnowledgeBase(replace(domain, records=domain.records.repeat(n_records, 1)))
        return 64 * (shelf.sets.numel() + shelf.ordered_sets.numel())

    domain = tensorize(movie)
    assert bits(4) < 5 * bits(1)


def test_a_look_up_does_not_grow_with_values_that_no_record_has(restaurant):
    long = {
        s: (*v, *(f"{s} {n}" for n in range(2_000))) for s, v in restaurant.error_values.items()
    }
    shelves = [
        KnowledgeBase(tensorize(domain))
        for domain in (restaurant, replace(restaurant, error_values=long))
    ]
    held = torch.zeros(3, len(restaurant.slots), dtype=torch.long)
    slot = torch.full((3,), restaurant.slots.index("cuisine"))
    short, grown = (shelf.counts_by_value(held, slot)[0] for shelf in shelves)
    assert short.shape == grown.shape
    assert torch.equal(short, grown)
