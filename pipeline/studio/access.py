"""Access control: only the studio's own pages, at its own address, with the token.

All other requests are refused before anything is looked up: another program on this machine has no token, a
page of another site has another origin, and with DNS rebinding the host is not ours.
"""

from __future__ import annotations

import errno
import ipaddress
import secrets
import socket
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tornado.netutil import bind_sockets
from tornado.web import HTTPError, RequestHandler

from turtlebag.datasets.errors import InputError

LOOPBACK = "127.0.0.1"
KINDS = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".svg": "image/svg+xml",
    ".png": "image/png",
}
"""Files of the page by type. The system's MIME table is not used: it may have any type for .js."""
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
    "connect-src 'self' ws://{host}; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
HEADERS = {
    "X-Frame-Options": "DENY",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-store",
}
"""No framing, no content sniffing, no referrer: the address contains the token."""


@dataclass(frozen=True)
class Access:
    """Accepts requests to the listening `host` and `port` with the token."""

    token: str
    host: str
    port: int

    @property
    def url(self) -> str:
        """The page's address with the token; the loopback one when all addresses are listened at."""
        name = LOOPBACK if _is_any(self.host) else self.host
        return f"http://{_in_url(name)}:{self.port}/?token={self.token}"

    def is_ours(self, host_header: str) -> bool:
        """Whether a Host header names this machine and port.

        When all addresses are listened at, any number will do: a number cannot be rebound as a name can.
        """
        name, _, port = host_header.lower().rpartition(":")
        if port != str(self.port):
            return False
        if name in (LOOPBACK, "localhost", "[::1]", _in_url(self.host).lower()):
            return True
        return _is_any(self.host) and (name == socket.gethostname().lower() or _address(name) is not None)

    def knows(self, token: str) -> bool:
        """Whether this is the token, compared in constant time."""
        return secrets.compare_digest(token.encode(), self.token.encode())


def new_token() -> str:
    """A secret of 32 random bytes, fit for an address."""
    return secrets.token_urlsafe(32)


def is_loopback(host: str) -> bool:
    """Whether only programs on this machine can connect to it."""
    address = _address(host)
    return host == "localhost" or (address is not None and address.is_loopback)


def _is_any(host: str) -> bool:
    address = _address(host)
    return address is not None and address.is_unspecified


def _address(name: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(name.removeprefix("[").removesuffix("]"))
    except ValueError:
        return None


def _in_url(host: str) -> str:
    return f"[{host}]" if ":" in host else host


def listen(host: str, port: int) -> list[socket.socket]:
    """Sockets that listen at `host` and `port` (0: any free one); InputError when that cannot be."""
    try:
        return bind_sockets(port, address=host)
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            raise InputError(
                f"--port {port}: in use; choose another, or leave it out for a free one"
            ) from None
        if error.errno == errno.EACCES:
            raise InputError(f"--port {port}: permission denied; choose 1024 or higher") from None
        raise InputError(f"--host {host}: {error.strerror}; give an address of this machine") from None


class CheckedHandler(RequestHandler):
    """A request that is answered only when `access` of the application's settings lets it in."""

    @property
    def needs_token(self) -> bool:
        """Whether it is answered only with the token."""
        return True

    def set_default_headers(self) -> None:
        """What every answer bears, refusals included."""
        for name, value in HEADERS.items():
            self.set_header(name, value)
        ours = self._access.is_ours(self.request.host)
        self.set_header("Content-Security-Policy", POLICY.format(host=self.request.host if ours else "none"))
        self.clear_header("Server")

    def prepare(self) -> None:
        """403 for a host, an origin or a token that is not ours."""
        host, origin = self.request.host, self.request.headers.get("Origin")
        if not self._access.is_ours(host):
            raise HTTPError(403, reason="Wrong host: open the address that turtlebag studio printed")
        if origin is not None and origin != f"http://{host}":
            raise HTTPError(403, reason="Request from a page of another site")
        if self.needs_token and not self._access.knows(self.get_query_argument("token", "")):
            raise HTTPError(403, reason="Wrong token: open the address that turtlebag studio printed")

    def write_error(self, status_code: int, **kwargs: object) -> None:
        """One line of plain text."""
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.finish(f"{status_code}: {self._reason}\n")

    def log_exception(self, kind: Any, error: Any, trace: Any) -> None:
        """Refusals are the client's concern: the terminal shows only our own errors."""
        if not isinstance(error, HTTPError):
            super().log_exception(kind, error, trace)

    @property
    def _access(self) -> Access:
        access: Access = self.settings["access"]
        return access


class Page(CheckedHandler):
    """The page itself, which needs the token."""

    def get(self, name: str = "index.html") -> None:
        """One of the files that were there when the studio began; no other name leads anywhere."""
        files: dict[str, Path] = self.settings["files"]
        if name not in files:
            raise HTTPError(404)
        self.set_header("Content-Type", KINDS[files[name].suffix])
        self.finish(files[name].read_bytes())


class Part(Page):
    """A file by its name. Scripts and styles are the same for everybody and public; pages need the token."""

    @property
    def needs_token(self) -> bool:
        """Whether it is a page, by whatever spelling of its name."""
        return self.path_args[0].endswith(".html")


def page_files(folder: Path) -> dict[str, Path]:
    """The files of a page by their names below its folder, links left out."""
    found = [path for path in folder.rglob("*") if path.suffix in KINDS and not path.is_symlink()]
    return {path.relative_to(folder).as_posix(): path for path in sorted(found) if path.is_file()}


class Rate:
    """At most `most` calls in any second."""

    def __init__(self, most: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._times: deque[float] = deque(maxlen=most)
        self._clock = clock

    def exceeded(self) -> bool:
        """Count one more call: whether it is one too many."""
        now = self._clock()
        if len(self._times) == self._times.maxlen and now - self._times[0] < 1.0:
            return True
        self._times.append(now)
        return False
