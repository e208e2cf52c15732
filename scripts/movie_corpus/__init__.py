"""The parts of ``scripts/make_movie_corpus.py``: facts in, records, values and goals out."""

from __future__ import annotations
