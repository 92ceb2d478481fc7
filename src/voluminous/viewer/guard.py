"""Who may speak to the server: a secret token, and pages of this server alone.

Other users of a machine reach its loopback addresses, and so does every page in a browser: neither
an address nor a cookie says who asks. A request needs a host name that is this machine's own, the
origin of the page that this server gave out, and the token.
"""

from __future__ import annotations

import hmac
import os
import re
import secrets
from collections.abc import Iterable
from urllib.parse import urlsplit

from ..errors import InputError

SUBPROTOCOL = "voluminous.v1"
_LOCAL = ("localhost", "127.0.0.1", "::1")
_ORIGIN = r"https?://([^][/:@?#\s]+|\[[^][/@?#\s]+\])(:\d+)?"
_VARIABLE = "VOLUMINOUS_TOKEN"


class Guard:
    """Decides which requests are answered.

    Parameters
    ----------
    hosts : iterable of str
        Names of this machine besides its loopback addresses, behind a proxy for example.
    """

    def __init__(self, hosts: Iterable[str] = ()) -> None:
        self.token = os.environ.get(_VARIABLE) or secrets.token_urlsafe(32)
        if len(self.token) < 20:
            raise InputError(f"{_VARIABLE} must have at least 20 characters")
        # A proxy may give another Host header than the browser, so pages of these may have any.
        self.given = {host.lower().strip("[]") for host in hosts}
        self.hosts = {*_LOCAL, *self.given}

    def knows_host(self, host: str) -> bool:
        """Return whether a Host header names this machine: others are rebound by DNS."""
        try:
            name = urlsplit(f"//{host}").hostname
        except ValueError:
            return False
        return name in self.hosts

    def knows_origin(self, origin: str | None, host: str) -> bool:
        """Return whether a request comes from a page of this server, or from no page."""
        if origin is None or origin.lower() in (f"{s}://{host}".lower() for s in ("http", "https")):
            return True
        found = re.fullmatch(_ORIGIN, origin.lower())
        return found is not None and found[1].strip("[]") in self.given

    def lets_in(self, host: str, origin: str | None, subprotocols: Iterable[str]) -> bool:
        """Return whether a websocket is accepted."""
        offered = list(subprotocols)
        given = [p[len("token.") :] for p in offered if p.startswith("token.")]
        right = any(hmac.compare_digest(one.encode(), self.token.encode()) for one in given)
        return (
            right
            and SUBPROTOCOL in offered
            and self.knows_host(host)
            and self.knows_origin(origin, host)
        )
