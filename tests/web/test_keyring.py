"""Tokens of pages, and the key of the stop, which outlives them."""

from __future__ import annotations

import stat
from pathlib import Path

import pytest

from station.errors import StationError
from station.web.keyring import CODE_S, DIGITS, Keyring


def test_tokens_are_known_again_after_a_restart(tmp_path: Path) -> None:
    first, again = Keyring(tmp_path / "keys"), Keyring(tmp_path / "keys")
    assert again.role_of(first.token("operator")) == "operator"
    assert again.role_of(first.token("viewer")) == "viewer"
    assert again.stop_key == first.stop_key


def test_a_role_cannot_be_raised(tmp_path: Path) -> None:
    keyring = Keyring(tmp_path / "keys")
    forged = keyring.token("viewer").replace("viewer", "operator")
    assert keyring.role_of(forged) is None
    for wrong in ("", "operator", "operator.", "é" * 40, keyring.stop_key, f"operator.{keyring.stop_key}"):
        assert keyring.role_of(wrong) is None
        assert wrong == keyring.stop_key or not keyring.is_stop_key(wrong)


def test_new_links_void_tokens_but_not_the_stop(tmp_path: Path) -> None:
    keyring = Keyring(tmp_path / "keys")
    token, stop_key = keyring.token("operator"), keyring.stop_key
    keyring.renew()
    assert keyring.role_of(token) is None
    assert keyring.is_stop_key(stop_key)
    assert Keyring(tmp_path / "keys").role_of(token) is None


def test_a_code_is_good_for_five_to_ten_minutes(tmp_path: Path) -> None:
    keyring, now_s = Keyring(tmp_path / "keys"), 1_800_000_123.0
    code = keyring.code(now_s)
    assert len(code) == DIGITS
    assert code.isdigit()
    begins_s = now_s - now_s % CODE_S
    for at_s, is_good in ((begins_s - 1, False), (begins_s, True), (begins_s + 2 * CODE_S - 1, True),
                          (begins_s + 2 * CODE_S, False)):  # fmt: skip
        assert keyring.is_code(code, at_s) is is_good
    assert keyring.code(now_s + CODE_S) != code
    for wrong in ("", code[:-1], f"{code}0", "é" * DIGITS):
        assert not keyring.is_code(wrong, now_s)
    keyring.renew()
    assert not keyring.is_code(code, now_s)


def test_the_file_is_this_users_alone(tmp_path: Path) -> None:
    path = tmp_path / "keys"
    Keyring(path)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    path.chmod(0o644)
    with pytest.raises(StationError, match="others may read it"):
        Keyring(path)


@pytest.mark.parametrize("held", [b"", b"{}", b'{"tokens": 1, "stop": 2}', b"\xff" * 100])
def test_a_file_that_holds_no_secrets_is_named(tmp_path: Path, held: bytes) -> None:
    path = tmp_path / "keys"
    path.write_bytes(held)
    path.chmod(0o600)
    with pytest.raises(StationError, match=str(path)):
        Keyring(path)
