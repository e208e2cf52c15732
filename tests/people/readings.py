"""Readings of a sentence, made by hand."""

from __future__ import annotations

import torch

from bbq_torchrl.people.language.asking import OPENING
from bbq_torchrl.people.language.assembly import assemble
from bbq_torchrl.people.language.learners import OUTSIDE
from bbq_torchrl.people.language.model import Reading
from bbq_torchrl.people.language.words import tokenize


def read(text, tagged, lexicon, question=None, *, act="inform", foreign=0.0):
    """Returns the frame and what is unclear of words, as if these were tagged, and this act."""
    words, domain = tokenize(text), lexicon.domain
    tags = [tagged.get(word, OUTSIDE) for word in words]
    acts = torch.tensor([-0.1 if name == act else -2.5 for name in domain.acts])
    none = torch.zeros(len(domain.slots))
    reading = Reading(tags, 1.0, [1.0] * len(tags), acts, none, none, 0.0, foreign)
    return assemble(words, reading, question or OPENING, lexicon)
