"""Serves a study."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bbq_torchrl.study.store import Store
from bbq_torchrl.study.web import JOIN, RESEARCHER, application

if TYPE_CHECKING:
    from collections.abc import Callable

    from bbq_torchrl.study.plan import Study
    from bbq_torchrl.study.talk import Talker

__all__ = ["serve"]

MAX_CONNECTIONS = 1_000


def serve(
    study: Study,
    talker: Talker,
    *,
    host: str,
    port: int,
    tell: Callable[[str], None],
) -> None:
    """Serves a study until the process is told to end.

    Args:
        study: what is asked of people; its data is beside its file.
        talker: the agents.
        host: address to listen at.
        port: the port.
        tell: is given the links, once.

    Raises:
        StoreError: the study's data cannot be used.
        ValueError: an agent cannot be loaded.
    """
    import uvicorn

    fingerprints = {agent: talker.fingerprint(agent) for agent in study.terms.agents}
    store = Store(study.data, study.terms, fingerprints)
    try:
        links = {"for people": f"join/{store.key(JOIN)}", "for you": f"r/{store.key(RESEARCHER)}"}
        for whom, link in links.items():
            tell(f"{whom}: http://{host}:{port}/{link}")
        uvicorn.run(
            application(study, store, talker),
            host=host,
            port=port,
            # The links are secrets, so they are in no log.
            access_log=False,
            log_level="warning",
            server_header=False,
            proxy_headers=False,
            limit_concurrency=MAX_CONNECTIONS,
            # Longer than people think: a message must not meet a connection that is just closed.
            timeout_keep_alive=120,
            timeout_graceful_shutdown=10,
        )
    finally:
        store.close()
