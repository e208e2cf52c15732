"""A plain oracle of the simulator: one dialogue, dicts and strings, written from the rules alone.

It uses no torch and no batches. The tensor simulator is checked against it, so it must be readable
next to docs/how_it_works.md, rule by rule.
"""
