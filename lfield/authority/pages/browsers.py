"""The root for browsers, beside an authority: it makes the certificates of pages, and no host believes it.

Browsers take no Ed25519, so its keys are of NIST's curve P-256. It can vouch for servers in private networks
alone (`names.py`), says its certificate. Those that it makes name no host and no person: on a link between
hosts they prove nothing, and no host has this root.
"""

from __future__ import annotations

from collections.abc import Sequence

from cryptography import x509
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.x509.oid import ExtendedKeyUsageOID

from lfield.authority.judge import when
from lfield.authority.making import Issued, Signer, begun, private_pem, subject_of, usage
from lfield.authority.pages.names import ENDINGS, NETWORKS, address_in, private
from lfield.authority.pem import certificate_in, sound
from lfield.errors import KeysError


class Browsers(Signer[ec.EllipticCurvePrivateKey]):
    """The root with its private key. Whoever has that can pass for any page of a private network."""

    def issue(self, names: Sequence[str], *, at: float, ends: float) -> Issued:
        """A certificate of a page with these names (`names.spelled`), from now (`at`) until `ends`; its key.

        Raises KeysError, also for what is not in a private network.
        """
        for name in names:
            if not private(name):
                raise KeysError(_PUBLIC.format(name=name, endings=", ".join(f".{e}" for e in ENDINGS)))
        if at >= self.ends:
            raise KeysError(
                f"the root for browsers ended {when(self.ends)}: remove browsers.crt and browsers.key, and "
                "the next page begins another, to be imported anew"
            )
        key = ec.generate_private_key(ec.SECP256R1())
        subject, usages = f"page {names[0]}", [ExtendedKeyUsageOID.SERVER_AUTH]
        made = self._signed(subject, key.public_key(), at, ends, usages, [_general(name) for name in names])
        return Issued(made, private_pem(key))


_PUBLIC = (
    "{name} is in no private network, and the root for browsers vouches for those alone (names end in "
    "{endings}): for any other put a certificate that browsers believe, and its key, into a folder as "
    "page.crt and page.key"
)


def new_browsers(at: float, ends: float) -> Browsers:
    """A root with a key of its own, from now (`at`) until `ends`, in seconds since 1970 UTC."""
    key = ec.generate_private_key(ec.SECP256R1())
    public = key.public_key()
    name = subject_of(
        f"pages of a team {x509.SubjectKeyIdentifier.from_public_key(public).digest.hex()[:12]}"
    )
    allowed: list[x509.GeneralName] = [x509.IPAddress(network) for network in NETWORKS]
    allowed += [x509.DNSName(ending) for ending in ENDINGS]
    made = (
        begun(name, name, public, at, ends)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(usage(signs_certificates=True), critical=True)
        .add_extension(x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH]), critical=False)
        .add_extension(x509.NameConstraints(allowed, None), critical=True)
        .sign(key, SHA256())
    )
    return Browsers(made, key)


def read_browsers(certificate: bytes, key: bytes) -> Browsers:
    """The root in two PEM texts. Raises KeysError."""
    sentence = "the root for browsers cannot be read: put back browsers.crt and browsers.key of one copy"
    read = certificate_in(certificate)
    private_key = sound(sentence, lambda: serialization.load_pem_private_key(key, None))
    if (
        not isinstance(private_key, ec.EllipticCurvePrivateKey)
        or read.public_key() != private_key.public_key()
    ):
        raise KeysError(sentence)
    return Browsers(read, private_key)


def _general(name: str) -> x509.GeneralName:
    address = address_in(name)
    return x509.DNSName(name) if address is None else x509.IPAddress(address)
