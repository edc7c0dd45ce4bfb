"""Verifies a bundle as a host does before it runs it."""

from __future__ import annotations

from lfield.authority.admission_policy import CertificateAdmission
from lfield.authority.key_material import Keys
from lfield.errors import BundleError
from lfield.mission import bundle
from lfield.mission.access.signed_bundle import accept_bundle
from lfield.mission.mission import Mission
from lfield.wire.fields import MAX_LABEL, truncate
from lfield.wire.service_messages import BundleInfo


class BundleVerifier:
    """Checks format, digests, program and signature, and that `host` belongs to the mission."""

    def __init__(self, host: str, keys: Keys, admission: CertificateAdmission) -> None:
        self._host, self._keys, self._admission = host, keys, admission

    def __call__(self, data: bytes) -> BundleInfo:
        """The bundle in some bytes. Raises BundleError, SignatureError."""
        mission = bundle.decode(data)
        if self._host not in mission.team.hosts:
            raise BundleError(f"its mission has no host {self._host}", "push it with --without this host")
        release = accept_bundle(
            mission.release,
            self._keys.authority,
            self._admission.own.authority,
            at=self._admission.time.now(),
            revoked=self._admission.revoked,
        ).bundle
        self._admission.time.on_signature(release.at, f"the signature of bundle {release.short}")
        return BundleInfo(release.digest, truncate(mission.name, MAX_LABEL), release.by, release.at)


def vehicles_of(data: bytes, host: str) -> list[str]:
    """The vehicles of a host in a verified bundle. Raises BundleError."""
    mission: Mission = bundle.decode(data)
    return mission.vehicles_of(host)
