"""The root CA for browsers, separate from the CA of a team: it issues the certificates of web pages only.

Browsers reject Ed25519, so its keys use NIST's curve P-256. Name constraints limit it to servers in private
networks (`web_names.py`). Its certificates name no host and no person, and no host trusts this root: they
prove nothing on a link between hosts.
"""

from __future__ import annotations

from collections.abc import Sequence

from cryptography import x509
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.x509.oid import ExtendedKeyUsageOID

from lfield.authority.certificate_authority import (
    CertificateSigner,
    IssuedCertificate,
    certificate_builder,
    private_pem,
    subject_of,
    usage,
)
from lfield.authority.peer_verification import format_time
from lfield.authority.pem import certificate_in, parse_or_error
from lfield.authority.web_ca.web_names import ENDINGS, NETWORKS, address_in, is_private_name
from lfield.errors import KeysError


class BrowserCa(CertificateSigner[ec.EllipticCurvePrivateKey]):
    """The root with its private key. A person with that key can impersonate any page of a private network."""

    def issue(self, names: Sequence[str], *, at: float, ends: float) -> IssuedCertificate:
        """A certificate of a page with these names (`web_names.normalised`) and its key, valid from `at`.

        Raises KeysError, also for names outside private networks.
        """
        for name in names:
            if not is_private_name(name):
                raise KeysError(_PUBLIC.format(name=name, endings=", ".join(f".{e}" for e in ENDINGS)))
        if at >= self.valid_until:
            raise KeysError(
                f"the root certificate for browsers expired {format_time(self.valid_until)}: remove "
                "browsers.crt and browsers.key; the next start of the page creates another one, which each "
                "browser must import"
            )
        key = ec.generate_private_key(ec.SECP256R1())
        subject, usages = f"page {names[0]}", [ExtendedKeyUsageOID.SERVER_AUTH]
        certificate = self._signed(
            subject, key.public_key(), at, ends, usages, [_general_name(name) for name in names]
        )
        return IssuedCertificate(certificate, private_pem(key))


_PUBLIC = (
    "{name} is in no private network, and the root for browsers vouches for those alone (names end in "
    "{endings}): for any other put a certificate that browsers believe, and its key, into a folder as "
    "page.crt and page.key"
)


def new_browser_ca(at: float, ends: float) -> BrowserCa:
    """A root with a new key, valid from now (`at`) until `ends`, in seconds since 1970 UTC."""
    key = ec.generate_private_key(ec.SECP256R1())
    public = key.public_key()
    name = subject_of(
        f"pages of a team {x509.SubjectKeyIdentifier.from_public_key(public).digest.hex()[:12]}"
    )
    allowed: list[x509.GeneralName] = [x509.IPAddress(network) for network in NETWORKS]
    allowed += [x509.DNSName(suffix) for suffix in ENDINGS]
    certificate = (
        certificate_builder(name, name, public, at, ends)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(usage(signs_certificates=True), critical=True)
        .add_extension(x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH]), critical=False)
        .add_extension(x509.NameConstraints(allowed, None), critical=True)
        .sign(key, SHA256())
    )
    return BrowserCa(certificate, key)


def read_browser_ca(certificate: bytes, key: bytes) -> BrowserCa:
    """The root in two PEM texts. Raises KeysError."""
    sentence = "the root for browsers cannot be read: put back browsers.crt and browsers.key of one copy"
    read = certificate_in(certificate)
    private_key = parse_or_error(sentence, lambda: serialization.load_pem_private_key(key, None))
    if (
        not isinstance(private_key, ec.EllipticCurvePrivateKey)
        or read.public_key() != private_key.public_key()
    ):
        raise KeysError(sentence)
    return BrowserCa(read, private_key)


def _general_name(name: str) -> x509.GeneralName:
    address = address_in(name)
    return x509.DNSName(name) if address is None else x509.IPAddress(address)
