"""A mission that contains each kind of symbol about which an editor can send a request."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from lfield.editor.workspace import Workspace

PROGRAM = """include <mavlink/copter.L>;
include "shared.L";

// Watches a field.
resource Watcher {
    Mavlink fc;     // its autopilot
    string name;

    init(string[] arg) { name = arg[0]; }

    // Climbs, and returns the height.
    portal rise(real height) emit real {
        fc.takeoff(height);
        return -fc.position()[2];
    }

    portal rise(int height) emit real { return height; }
}

coordinator Boss {
    init(string[] arg) {
        Watcher first = findWatcher(arg[1]);
        real height = first.rise(2.0);
        Note note = new Note("up", height);
        print(note.text() + f2s(height, 1));
        Lift[] lifts = findLift("payload >= 0.2");
        if (lifts.length() > 0) lifts[0].lift(1.0);
        within (5) { first.rise(note.value); }
        first.rise(3);
        findWatcher("eye").rise(max(1, 2));
    }
}
"""
SHARED = """// An observation.
class Note {
    public string subject;
    public real value;

    public Note(string text, real number) { subject = text; value = number; }

    public string text() { return subject; }
}
"""
DEPLOYMENT = "//Watcher:eye@sky\n//Boss:boss@sky?eye\n//@desk\n"
DEVICES = (
    "agents:\n  eye:\n    devices:\n      fc: {driver: mavlink, endpoint: 'udp:127.0.0.1:14550', system: 1}\n"
)
FILES = {
    "mission.L": PROGRAM,
    "shared.L": SHARED,
    "mission.dL": DEPLOYMENT,
    "mission.devices.yaml": DEVICES,
}
FOLDER = Path("/mission")


class MemoryFiles:
    """Files of the mission in memory. Files outside of the mission folder, as of drivers, are on the disk."""

    def __init__(self, files: dict[str, str]) -> None:
        self.files = {FOLDER / name: text for name, text in files.items()}

    def read(self, path: Path) -> str | None:
        if path in self.files:
            return self.files[path]
        return path.read_text(encoding="utf-8") if FOLDER not in path.parents and path.is_file() else None

    def names(self, folder: Path) -> Sequence[str]:
        return sorted(path.name for path in self.files if path.parent == folder)


def offset(text: str, marked: str) -> int:
    """The offset of `|` in a piece of the text: `fi|rst.rise`."""
    before, _, after = marked.partition("|")
    assert text.count(before + after) >= 1, marked
    return text.index(before + after) + len(before)


def place(text: str, marked: str) -> tuple[int, int]:
    """The line and column of `|`, from 0."""
    before = text[: offset(text, marked)]
    return before.count("\n"), len(before) - (before.rfind("\n") + 1)


def findings_of(workspace: Workspace, name: str) -> list[tuple[int, str]]:
    """Do all steps of a workspace. Return the line and code of each finding of a file."""
    found: list[tuple[int, str]] = []
    while (changed := workspace.step()) is not None:
        if FOLDER / name in changed:
            found = [(one.span.line, one.code) for one in changed[FOLDER / name]]
    return found
