"""An in-process guard with devices of type Thing, whose driver the test defines: no pipe, no port."""

from __future__ import annotations

from types import SimpleNamespace

from lfield.driver.contract import Manifest
from lfield.driver.device import Driver
from lfield.driver.driver_index import DriverInfo, ManifestFile
from lfield.guard.messages import MessageReader
from lfield.guard.shell import Shell
from lfield.manifest import DeviceManifest
from lfield.simulate.jumping_loop import LoopClock


class Output:
    """The pipe to the host: stores the messages."""

    def __init__(self):
        self._reader, self.received, self.writes = MessageReader(), [], []
        #: Bytes that the host has not read.
        self.unread = 0

    def write(self, data):
        self.writes.append(list(self._reader.feed(data)))
        self.received += self.writes[-1]

    def is_closing(self):
        return False

    def get_write_buffer_size(self):
        return self.unread


def guard_of(kind, output):
    """A guard whose driver creates devices of this class, on a bus that needs no opening."""

    class Bus(Driver):
        def _device(self, binding):
            return kind(binding, self.manifests[binding.type], self.clock, self.reports)

        async def _open(self):
            pass

        async def _close(self):
            pass

    plugin = SimpleNamespace(load=lambda: Bus, has_manifest=lambda file: True)
    return Shell(plugin, output, LoopClock())


def known_thing(*instructions, telemetry=()):
    """The host's information about that driver."""
    manifest = Manifest(DeviceManifest("Thing", "thing", instructions, telemetry, safe_states=("off",)))
    files = {"Thing": ManifestFile("manifest.yaml", bytes(32))}
    return DriverInfo("thing", "lfield_thing:PLUGIN", {"Thing": manifest}, files, "")
