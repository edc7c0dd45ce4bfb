"""Snapshots of a core's state, and their restoration into a newly constructed core.

A core is a graph of objects. Some objects exist since its construction: its parts, their tables, the
functions that connect them. They form the *skeleton*, which is the same in every core of a mission: it is
numbered by one walk in a fixed order, and so are the objects of the mission. A snapshot has the state of each
object of the skeleton that can change, and the objects that were created since then. It contains no code: a
restored core has its own functions, and only classes of lfield are instantiated, without a call of their
constructors.

External objects (clock, engine, environment, event recorder, random numbers) have names instead of states.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import msgspec

from lfield.capability.matching.provider_plans import ProviderPlans
from lfield.errors import RecordingError
from lfield.host.core import HostCore
from lfield.host.recording.object_graph import GraphReader, GraphWriter, walk
from lfield.vm.engine_interface import Reading
from lfield.vm.hooks import VmHooks
from lfield.vm.memory.block_verifier import BlockVerifier
from lfield.vm.memory.liveness import Liveness

#: Objects whose state follows from the program (caches of it), and the connections to observers.
_OPAQUE = (BlockVerifier, Liveness, VmHooks)
#: Objects without a state in a snapshot: the opaque ones, and caches that are filled again when they are
#: queried.
_STATELESS = (*_OPAQUE, ProviderPlans)


class CoreSnapshots:
    """Takes and restores snapshots of one core. Construct it before the core has run.

    `number_of` returns the number of a reading of the environment.
    """

    def __init__(self, core: HostCore, number_of: Callable[[Reading], int] = lambda reading: -1) -> None:
        self._core, self._number_of = core, number_of
        self._externals = _externals(core)
        self._known: dict[int, list[Any]] = {id(each): ["external", k] for k, each in self._externals.items()}
        self._mission = walk(core.mission, self._known, ())
        self._known.update((id(each), ["mission", n]) for n, each in enumerate(self._mission))
        self._skeleton = walk(core, self._known, _OPAQUE)
        self._known.update((id(each), ["part", n]) for n, each in enumerate(self._skeleton))

    def capture(self) -> bytes:
        """The state of the core, between two turns. Raises RecordingError if an object has no encoding."""
        writer = GraphWriter(self._known, self._number_of)
        states = [writer.state_of(each) for each in self._skeleton if not isinstance(each, _STATELESS)]
        sizes = len(self._mission), len(self._skeleton)
        version, numbers, gauss = self._core.context.rng.getstate()
        return msgspec.msgpack.encode([sizes, states, writer.objects(), [version, numbers, gauss]])

    def restore(self, data: bytes, readings: list[Reading]) -> None:
        """Restore a state into this core. Raises RecordingError for a state of another mission or version."""
        try:
            sizes, states, objects, (version, numbers, gauss) = msgspec.msgpack.decode(data)
            if sizes != [len(self._mission), len(self._skeleton)]:
                raise RecordingError("the checkpoint belongs to another mission or version of lfield")
            reader = GraphReader(self._resolve, readings, self._core.machine.engine.space)
            reader.create(objects)
            parts = [each for each in self._skeleton if not isinstance(each, _STATELESS)]
            # Containers last: the hashes of their elements must be final.
            rows = [row for row in zip(parts, states, strict=True) if row[1] is not None]
            for item, state in sorted(rows, key=lambda row: isinstance(row[0], (dict, set))):
                reader.set_state(item, state)
            self._core.context.rng.setstate((version, tuple(numbers), gauss))
        except (
            msgspec.DecodeError, ValueError, TypeError, KeyError, IndexError, AttributeError, OverflowError,
            RecursionError, MemoryError, BufferError,
        ) as error:  # fmt: skip
            raise RecordingError(f"the checkpoint cannot be restored: {error}") from None

    def _resolve(self, reference: list[Any]) -> object:
        match reference:
            case ["external", str(name)]:
                return self._externals[name]
            case ["mission", int(number)]:
                return self._mission[number]
            case ["part", int(number)]:
                return self._skeleton[number]
        raise RecordingError("a checkpoint has an unknown reference")


def _externals(core: HostCore) -> dict[str, object]:
    """The objects that are not part of the state, by name."""
    context, engine = core.context, core.machine.engine
    named = {
        "clock": context.clock,
        "monotonic": context.clock.monotonic,
        "environment": context.environment,
        "recorder": context.recorder,
        "hybrid": context.recorder.hybrid_clock,
        "rng": context.rng,
        "engine": engine,
        "space": engine.space,
        "layouts": engine.layouts,
        "groups": engine.groups,
        "limit": context.run_limit,
        "fresh": context.fresh_time,
        "stopwatch": context.stopwatch,
        "random": context.random_bytes,
        "engines": context.engines,
        "records": context.records,
        "times": context.times,
    }
    return {name: each for name, each in named.items() if each is not None}
