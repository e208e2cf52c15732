"""Addresses of a study: where its server listens, and where people reach it."""

from __future__ import annotations

import errno
import re
import socket
from dataclasses import dataclass

from bbq_torchrl.utils.text import shown

_ORIGIN = r"(https?)://(\[[0-9a-f:.]+\]|[\w.-]+)(?::(\d{1,5}))?"
_ADDRESS = re.compile(rf"{_ORIGIN}((?:/[\w.~-]+)*)/?", re.ASCII | re.IGNORECASE)
_PORTS = {"http": 80, "https": 443}
_NO_HOST = "--host must be an address of this machine"
_PAGES = ("/join", "/p", "/r", "/static")
"""The first parts of the paths of a study's pages."""

ALLOWED = (
    "an address such as https://lab.example/study/: http or https, host, port and path, without "
    "user, query and fragment"
)
"""Addresses that :meth:`Address.of` reads."""


@dataclass(frozen=True)
class Address:
    """The address at which people reach a study.

    The default is for a server without one: it has no prefix, and its origin comes from the
    ``Host`` of a request.

    Attributes:
        origin: scheme, host and port, as browsers send them: ``https://lab.example``.
        prefix: path prefix of all pages, without a trailing slash: ``/study``.
    """

    origin: str = ""
    prefix: str = ""

    @classmethod
    def of(cls, url: str) -> Address:
        """Returns the address that a URL names.

        Raises:
            ValueError: if the URL is not allowed; the message says which are.

        Examples:
            >>> Address.of("https://Lab.example:443/study/")
            Address(origin='https://lab.example', prefix='/study')
        """
        found = _ADDRESS.fullmatch(url)
        if found is None or not _is_port(found[3]) or {".", ".."} & set(found[4].split("/")):
            raise ValueError(f"be {ALLOWED}")
        scheme, host, prefix = found[1].lower(), found[2].lower(), found[4]
        if prefix in _PAGES:
            raise ValueError(f"have another path than the study's pages ({', '.join(_PAGES)})")
        port = int(found[3] or _PORTS[scheme])
        return cls(f"{scheme}://{host}{'' if port == _PORTS[scheme] else f':{port}'}", prefix)

    @classmethod
    def local(cls, host: str, port: int) -> Address:
        """Returns the address of a server for this machine.

        Examples:
            >>> Address.local("::1", 8000).origin, Address.local("0.0.0.0", 8000).origin
            ('http://[::1]:8000', 'http://127.0.0.1:8000')
        """
        host = {"": "127.0.0.1", "0.0.0.0": "127.0.0.1", "::": "::1"}.get(host, host)
        return cls(f"http://{f'[{host}]' if ':' in host else host}:{port}")

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

    def is_own(self, origin: str, host: str | None) -> bool:
        """Returns whether a form comes from a page of the study.

        Args:
            origin: the ``Origin`` header of the form.
            host: the ``Host`` header of the form, or ``None``.
        """
        scheme = origin.partition("://")[0].lower()
        given = _normal(origin)
        return given is not None and given in (self.origin, _normal(f"{scheme}://{host or ''}"))


def _normal(origin: str) -> str | None:
    try:
        return Address.of(origin).origin
    except ValueError:
        return None


def _is_port(text: str | None) -> bool:
    return text is None or 1 <= int(text) <= 65_535


def is_everywhere(host: str) -> bool:
    """Returns whether a server with this host listens on all addresses of its machine."""
    return host in ("", "0.0.0.0", "::")


def listen(host: str, port: int) -> socket.socket:
    """Returns a listening socket; clients that connect wait until they are served.

    Raises:
        ValueError: if it cannot listen there; the message says what to change.
    """
    try:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        return socket.create_server((host, port), family=family)
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            where = host or "all addresses"
            text = f"--port {port} is in use at {where}: end what listens there, or name another"
        elif error.errno == errno.EACCES:
            text = f"--port {port} needs rights that you lack: name one from 1024"
        else:
            text = f"{_NO_HOST}, got {shown(host)}"
        raise ValueError(text) from error
    except UnicodeError as error:  # an invalid host name
        raise ValueError(f"{_NO_HOST}, got {shown(host)}") from error
