"""A start that an assistant sends is decided by the access file in the active bundle."""

from __future__ import annotations

from pathlib import Path

import pytest

from lfield.mission import bundle
from lfield.mission.loader import load_mission
from lfield.service.bundle_receiver import BundleReceiver
from lfield.wire.service_messages import BundleInfo, MissionCommand

DIGEST = bytes(32)


class StoredBundle:
    """The disk of a service with one bundle, or with none."""

    def __init__(self, data: bytes | None) -> None:
        self.data = data

    def read(self, digest: bytes) -> bytes | None:
        return self.data


def refusal(data: bytes | None, person: str, **command: object) -> str:
    def verified(_: bytes) -> BundleInfo:
        return BundleInfo(DIGEST, "mission", hosts=["alpha"])

    receiver = BundleReceiver(StoredBundle(data), verified, list, lambda line: None, lambda: 0.0)
    return receiver.start_refusal(DIGEST, MissionCommand("start", **command), person)


@pytest.mark.parametrize(
    ("access", "permitted"),
    [
        ("", set()),
        ("assistants: []", set()),
        ("assistants: [anna]", {"anna"}),
        ("assistants: [others]", {"anna", "bob", ""}),
    ],
)
def test_the_access_file_decides_who_may_let_an_assistant_start(
    tmp_path: Path, access: str, permitted: set[str]
) -> None:
    (tmp_path / "mission.L").write_text("resource Sky { init(string[] arg) { } portal say() { } }\n")
    (tmp_path / "mission.dL").write_text("//Sky:one@alpha\n")
    if access:
        (tmp_path / "mission.access.yaml").write_text(f"{access}\n")
    data = bundle.encode(load_mission(tmp_path / "mission.dL"))
    persons = ("anna", "bob", "")
    assert {identity for identity in persons if not refusal(data, identity, is_assistant=True)} == permitted
    assert not any(refusal(data, identity) for identity in persons)
    assert refusal(data, "anna", is_assistant=True, without=["bravo"])
    assert refusal(data, "anna", is_assistant=True, digest=bytes([1] * 32))
    assert refusal(None, "anna", is_assistant=True)
