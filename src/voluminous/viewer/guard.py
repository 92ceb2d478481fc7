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
import stat
import tempfile
import time
import warnings
from collections.abc import Callable, Iterable
from pathlib import Path
from urllib.parse import urlsplit

from ..errors import InputError

SUBPROTOCOL = "voluminous.v1"
_LOCAL = ("localhost", "127.0.0.1", "::1")
_ORIGIN = r"https?://([^][/:@?#\s]+|\[[^][/@?#\s]+\])(:\d+)?"
_VARIABLE = "VOLUMINOUS_TOKEN"
# Seconds after which the token of a port is not used again: systems without a folder that ends with
# the user's session keep temporary files for days.
_OLDEST = 86_400.0
_LONGEST = 200
_ASKED = "so pages that were left open ask for the new one"


class Guard:
    """Decides which requests are answered.

    Parameters
    ----------
    hosts : iterable of str
        Names of this machine besides its loopback addresses, behind a proxy for example.
    port : int
        That the user chose; its token is that of the last server there. 0 for a new token.
    """

    def __init__(self, hosts: Iterable[str] = (), port: int = 0) -> None:
        self.token = os.environ.get(_VARIABLE) or (_token_of(port) if port else _new_token())
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


def _new_token() -> str:
    return secrets.token_urlsafe(32)


def _token_of(port: int) -> str:
    """Return the token of a port in the user's session: from a file that they alone can read."""
    token, base = _new_token(), os.environ.get("XDG_RUNTIME_DIR", "")
    if not hasattr(os, "getuid"):
        return token
    base = base if os.access(base, os.W_OK) else tempfile.gettempdir()
    folder = Path(base) / f"voluminous-{os.getuid()}"
    path = folder / f"port-{port}"
    try:
        folder.mkdir(stat.S_IRWXU, exist_ok=True)
        _check(folder.lstat(), stat.S_ISDIR)
        try:
            return _read(path)
        except FileNotFoundError:
            pass
        except OSError as error:
            warnings.warn(f"{path}: {error}; it is made anew, {_ASKED}", stacklevel=4)
            path.unlink()
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL
        with open(os.open(path, flags, stat.S_IRUSR | stat.S_IWUSR), "w") as file:
            file.write(token)
    except OSError as error:
        why = f"{folder}: {error}; remove it, or see what is wrong. No token is read from it"
        warnings.warn(f"{why}, {_ASKED}", stacklevel=4)
    return token


def _read(path: Path) -> str:
    with open(os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)) as file:
        state = os.fstat(file.fileno())
        _check(state, stat.S_ISREG)
        token = file.read(_LONGEST + 1)
    if not re.fullmatch(rf"[\w-]{{20,{_LONGEST}}}", token):
        raise OSError("it holds no token")
    if time.time() - state.st_mtime > _OLDEST:
        raise OSError("it is more than a day old")
    os.utime(path)
    return token


def _check(state: os.stat_result, is_kind: Callable[[int], bool]) -> None:
    """Refuse a file or folder that others own or can open."""
    if not is_kind(state.st_mode) or state.st_uid != os.getuid():
        raise OSError("it is not yours, or something else")
    if state.st_mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise OSError("other users can open it")
