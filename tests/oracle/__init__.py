"""A plain oracle of the dialogue: one dialogue, dicts and strings, written from the rules alone.

Nothing here is fast or batched, and nothing here uses torch: the oracle is what the tensor
simulator is checked against, so it must be readable beside docs/environment rule by rule.
"""
