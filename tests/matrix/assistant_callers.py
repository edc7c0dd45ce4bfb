"""AI assistants: portal calls to a simulated host, and starts at the service of a robot."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from calling_person import CallingPerson, fleet_of

from lfield.mission import bundle
from lfield.mission.loader import load_mission
from lfield.service.bundle_receiver import BundleReceiver
from lfield.wire.service_messages import BundleInfo, MissionCommand

PROGRAM = "resource Post { init(string[] arg) { } portal count() { } portal visit() { } }\n"
TEAM = "//Post:post@alpha\n"
CALLS = "calls:\n  carl: {}\n  others: {Post: [count]}\n"
#: Access files.
LISTED, OTHERS, CLOSED, NONE = (
    f"{CALLS}assistants: [anna, carl]\n",
    f"{CALLS}assistants: [others]\n",
    f"{CALLS}assistants: []\n",
    "",
)
#: The person and the access file of each row; a user of the host's own computer has no name.
ROWS = {
    "listed": ("anna", LISTED),
    "portalless": ("carl", LISTED),
    "unlisted": ("bob", LISTED),
    "local": ("", LISTED),
    "others": ("bob", OTHERS),
    "closed": ("anna", CLOSED),
    "none": ("anna", NONE),
}
DIGEST = bytes(32)


class StoredBundle:
    """The disk of a service with one bundle."""

    def __init__(self, data: bytes) -> None:
        self._data = data

    def read(self, digest: bytes) -> bytes:
        return self._data


class Assistants:
    """Hosts and services of missions with these access files."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._fleet, self._caller = cache(self._start_fleet), cache(self._make_caller)

    def tried(self, who: str, what: str) -> bool:
        """Whether the host executes the call, or the service accepts the start.

        The prefix `own-` selects actions of the person, without an assistant.
        """
        person, access = ROWS[who]
        is_assistant = not what.startswith("own-")
        action = what.removeprefix("own-")
        if action == "start":
            return not self._start_refusal(person, access, is_assistant)
        return (
            self._caller(person, access).result(action, seconds=1.0, is_assistant=is_assistant).outcome
            == "returned"
        )

    def _make_caller(self, person: str, access: str) -> CallingPerson:
        # One sender for all calls: each call draws another id.
        return CallingPerson(self._fleet(access), person or "joe", kind="person" if person else "local")

    def _start_fleet(self, access: str):
        return fleet_of(self._of(access), PROGRAM, TEAM, access)

    def _of(self, access: str) -> Path:
        folder = self._folder / str(hash(access))
        folder.mkdir(exist_ok=True)
        return folder

    def _start_refusal(self, person: str, access: str, is_assistant: bool) -> str:
        self._fleet(access)
        data = bundle.encode(load_mission(self._of(access) / "mission.dL"))
        receiver = BundleReceiver(
            StoredBundle(data), lambda _: BundleInfo(DIGEST, "mission"), list, lambda line: None, lambda: 0.0
        )
        return receiver.start_refusal(DIGEST, MissionCommand("start", is_assistant=is_assistant), person)
