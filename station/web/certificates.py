"""TLS of a page that other machines open: an authority of this station's own, and a certificate for its addresses.

A phone that has been told once to trust the authority trusts every later certificate of it. The authority's key never
leaves this user's state folder, mode 0600.
"""

from __future__ import annotations

import datetime
import ipaddress
import socket
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from station.atomic_file import write_atomic
from station.life import stop_file

if TYPE_CHECKING:
    from cryptography import x509
    from cryptography.hazmat.primitives.asymmetric import ec

_AUTHORITY = "authority.pem"
_DAYS, _AUTHORITY_DAYS = 397, 3650  # Apple's devices take no leaf for longer
_EARLY = datetime.timedelta(days=1)  # a phone's clock may be behind
_RENEW = datetime.timedelta(days=30)


class ServerCertificate(NamedTuple):
    """Files of a server's certificate, as PEM: it, its key, and the authority that a browser is to trust."""

    file: Path
    key_file: Path
    ca_file: Path


def own(names: Sequence[str], folder: Path | None = None) -> ServerCertificate:
    """Return a certificate for some names and addresses of this machine, made or still good.

    Args:
        names: Host names and addresses that a browser may open.
        folder: Where it is kept; None for this user's.

    Raises:
        OSError: the disk refused it.
    """
    where = folder or _folder()
    where.mkdir(mode=0o700, parents=True, exist_ok=True)
    found = ServerCertificate(where / "page.pem", where / "page.key", where / _AUTHORITY)
    if not _is_good(found, names):
        _make(found, where / "authority.key", names)
    return found


def authority() -> Path:
    """Return the file of this user's authority; not necessarily there."""
    return _folder() / _AUTHORITY


def _folder() -> Path:
    return stop_file.folder().parent / "console"


def _is_good(files: ServerCertificate, names: Sequence[str]) -> bool:
    from cryptography import x509

    try:
        leaf = x509.load_pem_x509_certificate(files.file.read_bytes())
        authority = x509.load_pem_x509_certificate(files.ca_file.read_bytes())
        leaf.verify_directly_issued_by(authority)
        listed = leaf.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except (OSError, ValueError, TypeError, x509.ExtensionNotFound):
        return False
    except Exception as error:  # the library's own for a signature that is another's
        if type(error).__name__ != "InvalidSignature":
            raise
        return False
    covered = {*listed.get_values_for_type(x509.DNSName), *map(str, listed.get_values_for_type(x509.IPAddress))}
    is_fresh = leaf.not_valid_after_utc - _RENEW > datetime.datetime.now(datetime.UTC)
    return is_fresh and set(names) <= covered and files.key_file.exists()


def _make(files: ServerCertificate, authority_key: Path, names: Sequence[str]) -> None:
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec
    from cryptography.x509.oid import ExtendedKeyUsageOID

    ca_key, ca = _authority(files.ca_file, authority_key)
    key, now = ec.generate_private_key(ec.SECP256R1()), datetime.datetime.now(datetime.UTC)
    leaf = (
        _begun(socket.gethostname(), ca.subject, key, now, _DAYS)
        .add_extension(x509.SubjectAlternativeName([_name(name) for name in names]), critical=False)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH]), critical=False)
        .sign(ca_key, hashes.SHA256())
    )
    write_atomic(files.key_file, _private(key), mode=0o600)
    write_atomic(files.file, leaf.public_bytes(serialization.Encoding.PEM))


def _authority(file: Path, key_file: Path) -> tuple[ec.EllipticCurvePrivateKey, x509.Certificate]:
    """Return the authority and its key, made where they are not there."""
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec

    if file.exists() and key_file.exists():
        loaded = serialization.load_pem_private_key(key_file.read_bytes(), None)
        if isinstance(loaded, ec.EllipticCurvePrivateKey):
            return loaded, x509.load_pem_x509_certificate(file.read_bytes())
    key, now = ec.generate_private_key(ec.SECP256R1()), datetime.datetime.now(datetime.UTC)
    name = f"Teleop Station on {socket.gethostname()}"
    made = (
        _begun(name, None, key, now, _AUTHORITY_DAYS)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .sign(key, hashes.SHA256())
    )
    write_atomic(key_file, _private(key), mode=0o600)
    write_atomic(file, made.public_bytes(serialization.Encoding.PEM))
    return key, made


def _begun(
    name: str, issuer: x509.Name | None, key: ec.EllipticCurvePrivateKey, now: datetime.datetime, days: int
) -> x509.CertificateBuilder:
    from cryptography import x509
    from cryptography.x509.oid import NameOID

    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name[:64])])
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer or subject)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - _EARLY)
        .not_valid_after(now - _EARLY + datetime.timedelta(days=days))
    )


def _name(name: str) -> x509.GeneralName:
    from cryptography import x509

    try:
        return x509.IPAddress(ipaddress.ip_address(name))
    except ValueError:
        return x509.DNSName(name)


def _private(key: ec.EllipticCurvePrivateKey) -> bytes:
    from cryptography.hazmat.primitives import serialization

    return key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
