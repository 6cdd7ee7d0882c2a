"""The console's own authority, and certificates of it that a browser takes."""

from __future__ import annotations

import datetime
import ssl
import stat
from pathlib import Path

import pytest

x509 = pytest.importorskip("cryptography.x509", reason="needs the extra 'console'")

from station.web import certificates  # noqa: E402

NAMES = ["192.0.2.7", "robot.local", "::1"]


def test_a_certificate_is_kept_while_it_is_good(tmp_path: Path) -> None:
    first = certificates.own(NAMES, tmp_path)
    held, authority = first.file.read_bytes(), first.ca_file.read_bytes()
    assert certificates.own(NAMES[:1], tmp_path).file.read_bytes() == held
    again = certificates.own([*NAMES, "192.0.2.8"], tmp_path)
    assert again.file.read_bytes() != held
    assert again.ca_file.read_bytes() == authority  # what a phone trusts goes on being trusted


def test_it_is_what_devices_ask_for(tmp_path: Path) -> None:
    made = certificates.own(NAMES, tmp_path)
    leaf = x509.load_pem_x509_certificate(made.file.read_bytes())
    assert leaf.not_valid_after_utc - leaf.not_valid_before_utc <= datetime.timedelta(days=397)
    named = leaf.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert set(map(str, named.get_values_for_type(x509.IPAddress))) == {"192.0.2.7", "::1"}
    context = ssl.create_default_context(cafile=made.ca_file)
    context.load_cert_chain(made.file, made.key_file)
    for secret in (made.key_file, tmp_path / "authority.key"):
        assert stat.S_IMODE(secret.stat().st_mode) == 0o600


def test_a_damaged_one_is_made_anew(tmp_path: Path) -> None:
    made = certificates.own(NAMES, tmp_path)
    made.file.write_text("nothing")
    x509.load_pem_x509_certificate(certificates.own(NAMES, tmp_path).file.read_bytes())
