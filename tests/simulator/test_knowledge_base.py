"""The bit-packed knowledge base against the oracle's, and its memory."""

from dataclasses import replace

import torch
from hypothesis import given, strategies as st
from oracle.dialogue import value_order_of
from oracle.knowledge_base import Records
from oracle.small import SLOTS, small_domain
from oracle.values import DONT_CARE, NO_MATCH

from bbq_torchrl.domains import Goal, tensorize
from bbq_torchrl.domains.frames import Coding
from bbq_torchrl.simulator import KnowledgeBase

INFORMED = SLOTS[:5]
N_VALUES = {"moviename": 3, "city": 4, "date": 12, "theater": 20, "genre": 1, "numberofpeople": 3}
RECORD = st.fixed_dictionaries(
    {}, optional={s: st.sampled_from([f"v{n}" for n in range(N_VALUES[s])]) for s in N_VALUES}
).filter(bool)


@st.composite
def looked_up(draw):
    """Draws records, and values held, most of them those of one record."""
    records = draw(st.lists(RECORD, min_size=1, max_size=150))
    held = {s: v for s, v in draw(st.sampled_from(records)).items() if draw(st.booleans())}
    other = st.sampled_from([DONT_CARE, NO_MATCH])
    return records, held | draw(st.dictionaries(st.sampled_from(SLOTS[:6]), other, max_size=1))


@given(drawn=looked_up(), slot=st.sampled_from(INFORMED))
def test_look_ups_are_those_of_the_oracle(drawn, slot):
    records, held = drawn
    domain = small_domain(Goal({}), records=records)
    plain = Records(records, domain.free_slots, value_order_of(domain))
    tensors = tensorize(domain)
    knowledge_base, coding = KnowledgeBase(tensors), Coding(tensors)
    ids, index = torch.tensor(coding.ids(held)), torch.tensor(SLOTS.index(slot))

    matching = plain.matching(held)
    assert int(knowledge_base.matching_counts(ids)) == len(matching)
    with_value = [plain.count_with(s, held[s]) if s in held else 0 for s in SLOTS]
    assert knowledge_base.value_counts(ids).tolist() == with_value

    on_rows = plain.values_on(slot, matching)
    counts, total = knowledge_base.counts_by_value(ids, index)
    counted = knowledge_base.counted_values(index).tolist()
    assert int(total) == len(matching)
    assert counted == sorted(counted)
    texts = [tensors.vocabulary[index][number] for number in counted]
    assert {t: n for t, n in zip(texts, counts.tolist(), strict=True) if n} == on_rows

    best = [value for value, count in on_rows.items() if count == max(on_rows.values())]
    value = knowledge_base.most_frequent(counts, index)
    first = plain.in_order(slot, best)[0] if best else NO_MATCH
    assert tensors.vocabulary[index][value] == first


def test_memory_grows_with_the_records_and_not_with_their_square(movie):
    def words(times):
        larger = KnowledgeBase(replace(domain, records=domain.records.repeat(times, 1)))
        return larger.sets.numel() + larger.ordered_sets.numel()

    domain = tensorize(movie)
    assert words(4) < 5 * words(1)
