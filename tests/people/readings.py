"""Readings of a sentence, made by hand."""

import torch

from bbq_torchrl.people.language.asking import OPENING
from bbq_torchrl.people.language.assembly import assemble
from bbq_torchrl.people.language.model import Reading
from bbq_torchrl.people.language.words import OUTSIDE, tokenize


def read(
    text, tagged, lexicon, question=None, *, act="inform", foreign=0.0, asked=(), free=(), new=()
):
    """Returns the frame and what is unclear of words, as if these were tagged, and this act.

    ``asked`` and ``free`` are the probabilities that slots are asked for, or do not matter, and
    ``new`` the unknown words.
    """
    words, domain = tokenize(text), lexicon.domain
    tags = [tagged.get(word, OUTSIDE) for word in words]
    acts = torch.tensor([-0.1 if name == act else -2.5 for name in domain.acts])
    requests, dont_care = (
        torch.tensor([dict(chances).get(slot, 0.0) for slot in domain.slots])
        for chances in (asked, free)
    )
    reading = Reading(
        tags, 1.0, [word in new for word in words], acts, requests, dont_care, foreign
    )
    return assemble(words, reading, question or OPENING, lexicon)[:2]
