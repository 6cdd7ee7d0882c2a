"""Secrets of the pages: who may look, who may ask, and the key of the stop, which never expires.

One small file of this user, mode 0600. A token is a role and its HMAC, so it outlives a restart of the server, and all
of them are void once the file has a new secret. The key of the stop stays: a page whose token is void still stops.
"""

from __future__ import annotations

import hashlib
import hmac
import os
import secrets
from pathlib import Path
from typing import Literal

import msgspec

from station.atomic_file import write_atomic
from station.errors import StationError
from station.life import stop_file

Role = Literal["viewer", "operator"]
ROLES: tuple[Role, ...] = ("viewer", "operator")

DIGITS, CODE_S = 8, 300.0
"""Digits of a code, and how often there is another [s]."""

_BYTES = 24  # 192 bits, of which nobody guesses one


class _Secrets(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    tokens: str
    stop: str


class Keyring:
    """Makes tokens and knows them again.

    Args:
        path: Its file; None for the one of this user, which is made where there is none.

    Raises:
        StationError: the file cannot be read, or everybody may read it.
    """

    def __init__(self, path: Path | None = None) -> None:
        self.path = path or default_path()
        try:
            self._secrets = self._load() or self._renewed(stop="")
        except (OSError, msgspec.DecodeError) as error:
            reason = error.strerror if isinstance(error, OSError) else "no secrets of a console"
            raise StationError(f"{self.path}: {reason}; remove it, and every page gets a new link") from None

    @property
    def stop_key(self) -> str:
        """What a page that was let in once may press the stop with, for ever."""
        return self._mac("stop", self._secrets.stop)

    def token(self, role: Role) -> str:
        """Return what lets a page in as a role."""
        return f"{role}.{self._mac(role, self._secrets.tokens)}"

    def role_of(self, token: str) -> Role | None:
        """Return the role that a token gives; None for one that is not ours, or of a secret that was replaced."""
        for role in ROLES:
            if hmac.compare_digest(self.token(role).encode(), token.encode("utf-8", "replace")):
                return role
        return None

    def code(self, now_s: float) -> str:
        """Return the digits that let a page in as the operator, to be typed where a link cannot be opened.

        Args:
            now_s: Time since 1970 [s]; each code is good for `CODE_S` to twice that.
        """
        return self._code(int(now_s // CODE_S))

    def is_code(self, code: str, now_s: float) -> bool:
        """Whether a page may be let in by these digits now."""
        window = int(now_s // CODE_S)
        given = code.encode("utf-8", "replace")
        return any(hmac.compare_digest(self._code(number).encode(), given) for number in (window, window - 1))

    def _code(self, window: int) -> str:
        return f"{int(self._mac(f'code {window}', self._secrets.tokens), 16) % 10**DIGITS:0{DIGITS}}"

    def is_stop_key(self, key: str) -> bool:
        """Whether a page may press the stop with this."""
        return hmac.compare_digest(self.stop_key.encode(), key.encode("utf-8", "replace"))

    def renew(self) -> None:
        """Make every token void; the key of the stop stays."""
        self._secrets = self._renewed(stop=self._secrets.stop)

    def _load(self) -> _Secrets | None:
        try:
            descriptor = os.open(self.path, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW)
        except FileNotFoundError:
            return None
        with os.fdopen(descriptor, "rb") as file:
            if os.fstat(descriptor).st_mode & 0o077:
                raise StationError(f"{self.path}: others may read it, so its secrets are none; remove it")
            return msgspec.json.decode(file.read(), type=_Secrets)

    def _renewed(self, *, stop: str) -> _Secrets:
        made = _Secrets(tokens=secrets.token_urlsafe(_BYTES), stop=stop or secrets.token_urlsafe(_BYTES))
        self.path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        write_atomic(self.path, msgspec.json.encode(made), mode=0o600)
        return made

    @staticmethod
    def _mac(what: str, secret: str) -> str:
        return hmac.new(secret.encode(), what.encode(), hashlib.sha256).hexdigest()[: 2 * _BYTES]


def default_path() -> Path:
    """Return where this user's secrets are; not necessarily there."""
    return stop_file.folder().parent / "console.json"
