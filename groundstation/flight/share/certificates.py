"""Certificates of one station's machines: an authority of its own signs them, and nobody else's is believed. No I/O.

X.509 v3, ECDSA on P-256 with SHA-256 (RFC 5280, RFC 5480). What a certificate may be used for is in it: one of a camera
computer or of the station may be shown by who listens, one of a client by who connects alone. So a client that turns
bad is no station to others.
"""

from __future__ import annotations

import datetime
import ipaddress
from collections.abc import Sequence
from dataclasses import dataclass, field

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from drivers.secure import Identity

AUTHORITY_DAYS = 3650
DAYS = 365
"""Of a certificate: a year, after which a laptop that was forgotten may do nothing."""
_EARLY = datetime.timedelta(days=1)
"""Certificates hold from yesterday on: clocks of computers in a lab differ."""


@dataclass(frozen=True, slots=True)
class Authority:
    """Who signs: certificate and private key, PEM."""

    certificate: bytes
    key: bytes = field(repr=False)


@dataclass(frozen=True, slots=True)
class Owner:
    """Whom a certificate is for.

    Attributes:
        name: the common name.
        listens: others connect to it, at ``addresses``.
        connects: it connects to others.
        addresses: names and numbers of the computer that listens.
    """

    name: str
    listens: bool = False
    connects: bool = True
    addresses: tuple[str, ...] = ()


def new_authority(name: str, now: datetime.datetime) -> Authority:
    """An authority that signs for one station, and signs no other authority."""
    key = ec.generate_private_key(ec.SECP256R1())
    subject = _named(name)
    builder = _builder(subject, subject, key, now, AUTHORITY_DAYS)
    builder = builder.add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
    builder = builder.add_extension(_usage(signs_certificates=True), critical=True)
    builder = builder.add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
    return Authority(_pem(builder.sign(key, hashes.SHA256())), _key_pem(key))


def issue(authority: Authority, owner: Owner, now: datetime.datetime, days: int = DAYS) -> Identity:
    """A new key and its certificate.

    Args:
        authority: who signs.
        owner: whom it is for.
        now: with a time zone; it holds from a day before.
        days: how long it holds.

    Raises:
        ValueError: the authority's files are damaged, or an address is none.
    """
    signer = serialization.load_pem_private_key(authority.key, password=None)
    if not isinstance(signer, ec.EllipticCurvePrivateKey):
        raise ValueError("the authority's key is of another kind")
    key = ec.generate_private_key(ec.SECP256R1())
    issuer = x509.load_pem_x509_certificate(authority.certificate).subject
    uses = [ExtendedKeyUsageOID.SERVER_AUTH] * owner.listens + [ExtendedKeyUsageOID.CLIENT_AUTH] * owner.connects
    builder = _builder(_named(owner.name), issuer, key, now, days)
    builder = builder.add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
    builder = builder.add_extension(_usage(signs_certificates=False), critical=True)
    builder = builder.add_extension(x509.ExtendedKeyUsage(uses), critical=False)
    signed_by = x509.AuthorityKeyIdentifier.from_issuer_public_key(signer.public_key())
    builder = builder.add_extension(signed_by, critical=False)
    if owner.listens:
        names = x509.SubjectAlternativeName([_place(address) for address in owner.addresses])
        builder = builder.add_extension(names, critical=False)
    return Identity(authority.certificate, _pem(builder.sign(signer, hashes.SHA256())), _key_pem(key))


def expires(certificate: bytes) -> datetime.datetime:
    """Until when a certificate holds.

    Raises:
        ValueError: it is none.
    """
    return x509.load_pem_x509_certificate(certificate).not_valid_after_utc


def _builder(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePrivateKey, now: datetime.datetime, days: int
) -> x509.CertificateBuilder:
    return x509.CertificateBuilder(
        issuer, subject, key.public_key(), x509.random_serial_number(), now - _EARLY,
        now + datetime.timedelta(days=days),
    )  # fmt: skip


def _usage(*, signs_certificates: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs_certificates, content_commitment=False, key_encipherment=False,
        data_encipherment=False, key_agreement=False, key_cert_sign=signs_certificates, crl_sign=False,
        encipher_only=False, decipher_only=False,
    )  # fmt: skip


def _named(name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])


def _place(address: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(address))
    except ValueError:
        return x509.DNSName(address)


def _pem(certificate: x509.Certificate) -> bytes:
    return certificate.public_bytes(serialization.Encoding.PEM)


def _key_pem(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )


def addresses_of(given: Sequence[str], own: Sequence[str]) -> tuple[str, ...]:
    """All by which a computer is called, each once, those given first.

    Raises:
        ValueError: one is neither a number nor a name.
    """
    out = tuple(dict.fromkeys([*given, *own]))
    for address in out:
        _place(address)
    return out
