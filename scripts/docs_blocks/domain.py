"""Actions, features and example dialogues, from the objects that the code uses."""

from __future__ import annotations

import re

from bbq_torchrl.cli.evaluate import transcripts
from bbq_torchrl.domains import movie_domain, tensorize
from bbq_torchrl.envs import DialogueEnv, scripted_policy
from bbq_torchrl.simulator import FeatureLayout
from scripts.docs_blocks.common import block, code, table


@block("actions")
def _actions() -> str:
    domain = movie_domain()
    rows = []
    for kind, title in (("act", "without a slot"), ("request", "request"), ("inform", "inform")):
        chosen = {n: a.slot or a.act for n, a in enumerate(domain.actions) if a.kind == kind}
        index = f"{min(chosen)}–{max(chosen)}"
        rows.append((title, index, len(chosen), ", ".join(chosen.values())))
    return table(("kind", "index", "count", "in this order"), rows)


@block("features")
def _features() -> str:
    layout = FeatureLayout(tensorize(movie_domain()))
    described = re.findall(r"^ *``(\w+)`` +(.+(?:\n {20,}.+)?)", FeatureLayout.__doc__ or "", re.M)
    rows = []
    for group, meaning in described:
        place = layout[group]
        index = "–".join(dict.fromkeys((f"{place.start}", f"{place.stop - 1}")))
        rows.append((code(group), index, len(layout.groups[group]), " ".join(meaning.split())))
    return table(("group", "index", "count", "the features are"), rows)


@block("dialogues")
def _dialogues() -> str:
    """Returns the first successful dialogue and the first that fails from a misheard value."""
    env = DialogueEnv(movie_domain(), batch_size=(1, 64), seed=0)
    texts = transcripts(env, scripted_policy("careful_essential", env), 64)
    good = next(text for text in texts if text.endswith("success\n"))
    spoiled = next(text for text in texts if text.endswith("failure\n") and "[heard" in text)
    parts = (("A dialogue that succeeds:", good), ("One that a misheard value spoils:", spoiled))
    return "\n\n".join(f"{title}\n\n```text\n{text}```" for title, text in parts)
