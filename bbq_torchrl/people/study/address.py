"""Addresses of a study: where its server listens, and where people reach it."""

from __future__ import annotations

import re
import socket
from dataclasses import dataclass
from typing import Any

from bbq_torchrl.settings import Allowed
from bbq_torchrl.utils.text import sentence, shown

_PATTERN = re.compile(
    r"(https?://(?:\[[0-9a-f:.]+\]|[\w.-]+)(?::\d{1,5})?)((?:/[\w.~-]+)*)/?",
    re.ASCII | re.IGNORECASE,
)


@dataclass(frozen=True)
class Address:
    """The address at which people reach a study.

    Attributes:
        origin: scheme, host and port, as browsers send them: ``https://lab.example``; empty if
            it comes from the ``Host`` of a request.
        prefix: path prefix of all pages, without a trailing slash: ``/study``.
    """

    origin: str = ""
    prefix: str = ""

    @classmethod
    def of(cls, url: str) -> Address:
        """Returns the address that a URL of :data:`ADDRESS` names.

        Examples:
            >>> Address.of("https://Lab.example/study/")
            Address(origin='https://lab.example', prefix='/study')
        """
        found = _PATTERN.fullmatch(url)
        return cls(found[1].lower(), found[2]) if found else cls()

    def link(self, path: str) -> str:
        """Returns the link to a page."""
        return f"{self.origin}{self.prefix}{path}"

    def inner(self, path: str) -> str:
        """Returns the page's path from a request's path, with or without the prefix.

        Examples:
            >>> address = Address.of("https://lab.example/study")
            >>> address.inner("/study/p/x/"), address.inner("/p/x")
            ('/p/x', '/p/x')
        """
        if path.startswith(f"{self.prefix}/"):
            path = path.removeprefix(self.prefix)
        return path.rstrip("/") or "/"


def _is_address(value: Any) -> bool:
    return isinstance(value, str) and (value == "" or bool(_PATTERN.fullmatch(value)))


ADDRESS = Allowed("an address such as https://lab.example/study/", _is_address)
"""The values of a study's ``url``."""


def listen(host: str, port: int) -> socket.socket:
    """Returns a listening socket; clients that connect wait until they are served.

    Raises:
        ValueError: it cannot listen there.
    """
    try:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        return socket.create_server((host, port), family=family)
    except (OSError, UnicodeError) as error:  # UnicodeError: an invalid host name
        text = f"--host {shown(host)} and --port {port} cannot be served: {sentence(error)}"
        raise ValueError(text) from error
