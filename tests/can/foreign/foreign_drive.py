"""A drive made of canopen's LocalNode on a real bus, written independently from CiA 301 and CiA 402-2.

SDO server, NMT and heartbeat are from canopen. The PDOs, the consumer heartbeat, the states and the motor
are here. It is strict where the standards are, has no brake, and coasts when its voltage is off.
"""

from __future__ import annotations

import math
import struct
import threading
import time
from contextlib import contextmanager

import canopen
from can_endpoints import opened, tcp
from canopen.sdo.exceptions import SdoAbortedError
from foreign_objects import MAPPABLE, NO_REMOTE, UNUSED, Variant, dictionary, entry

STEP = 0.005
#: Time constant in seconds of a motor without voltage.
COASTS = 0.15

# Abort codes of CiA 301, table 22.
OUT_OF_RANGE, UNMAPPABLE, TOO_LONG, NOT_NOW = 0x06090030, 0x06040041, 0x06040042, 0x08000022

#: Status words of the states, with voltage enabled and remote (CiA 402-2, state coding).
NOT_READY, DISABLED, READY, ON, ENABLED, STOPPING, REACTING, FAULT = (
    0x0210, 0x0250, 0x0231, 0x0233, 0x0237, 0x0217, 0x021F, 0x0218,
)  # fmt: skip
#: Transitions 2 to 16 by command: (mask, value) of the control word -> state -> next state.
COMMANDS = (
    ((0x82, 0x00), {READY: DISABLED, ON: DISABLED, ENABLED: DISABLED, STOPPING: DISABLED}),
    ((0x86, 0x02), {READY: DISABLED, ON: DISABLED, ENABLED: STOPPING}),
    ((0x87, 0x06), {DISABLED: READY, ON: READY, ENABLED: READY}),
    ((0x8F, 0x07), {READY: ON, ENABLED: ON}),
    ((0x8F, 0x0F), {ON: ENABLED, STOPPING: ENABLED}),
)
REACHED, SPECIFIC = 1 << 10, 1 << 12


class ForeignDrive:
    def __init__(self, network: canopen.Network, node: int, variant: Variant) -> None:
        self.id, self.variant, self.network = node, variant, network
        self.lock = threading.RLock()
        self.state, self.bits, self.controlword, self.mode = DISABLED, 0, 0, 0
        self.position = self.velocity = 0.0
        self.goal: float | None = None
        self.watched_at: float | None = None
        self.pdos_sent_at: dict[int, tuple[float, bytes]] = {}
        self.node = canopen.LocalNode(node, dictionary(variant, node))
        network.add_node(self.node)
        self.node.add_write_callback(self.on_write)
        for number in range(128):
            network.subscribe(0x700 + number, self.on_heartbeat)
        network.subscribe(0x80, self.on_sync)
        for number in range(4):
            network.subscribe(0x200 + 0x100 * number + node, self.on_pdo)
        self.node.nmt.state = "INITIALISING"
        self.node.nmt.state = "PRE-OPERATIONAL"
        self.running = True
        self.thread = threading.Thread(target=self.run, daemon=True)
        self.thread.start()

    def stop(self) -> None:
        self.running = False
        self.thread.join()
        self.node.nmt.stop_heartbeat()

    # -- objects

    def get(self, index: int, subindex: int = 0) -> int:
        variable = self.node.object_dictionary.get_variable(index, subindex)
        return variable.decode_raw(self.node.get_data(index, subindex))

    def put(self, index: int, value: float) -> None:
        variable = self.node.object_dictionary.get_variable(index, 0)
        self.node.data_store.setdefault(index, {})[0] = variable.encode_raw(round(value))

    def on_write(self, index: int, subindex: int, od, data: bytes) -> None:
        value = int.from_bytes(data, "little")
        with self.lock:
            if index & 0xFF00 in (0x1400, 0x1800):
                self.check_parameter(index, subindex, value)
            elif index & 0xFF00 in (0x1600, 0x1A00):
                self.check_mapping(index, subindex, value)
            elif index == 0x1016:
                self.watched_at = None
            elif index == 0x6040:
                self.control(value)
            elif index == 0x6060:
                self.mode = struct.unpack("b", data)[0]
                if self.mode not in (0, 1, 3, 6, 8, 9):
                    raise SdoAbortedError(OUT_OF_RANGE)
                self.put(0x6061, self.mode)

    def check_parameter(self, index: int, subindex: int, value: int) -> None:
        """CiA 301, 7.5.2.35 and 37: while a PDO is enabled only its bit 31 may change."""
        now = self.get(index, 1)
        if subindex == 1:
            if self.variant.no_remote and not value & NO_REMOTE:
                raise SdoAbortedError(OUT_OF_RANGE)
            if not now & UNUSED and (now ^ value) & ~UNUSED:
                raise SdoAbortedError(OUT_OF_RANGE)
            if not value & UNUSED and not value & 0x7FF:
                raise SdoAbortedError(OUT_OF_RANGE)
        elif not now & UNUSED:
            raise SdoAbortedError(NOT_NOW)
        elif subindex == 2 and not self.variant.sync and value <= 240:
            raise SdoAbortedError(OUT_OF_RANGE)

    def check_mapping(self, index: int, subindex: int, value: int) -> None:
        """CiA 301, 7.5.2.36: PDO disabled, no entries, before operational."""
        if not self.get(index - 0x200, 1) & UNUSED or self.node.nmt.state == "OPERATIONAL":
            raise SdoAbortedError(NOT_NOW)
        if subindex:
            if self.get(index, 0):
                raise SdoAbortedError(NOT_NOW)
            if value and (value >> 16 not in MAPPABLE or value != entry(value >> 16)):
                raise SdoAbortedError(UNMAPPABLE)
        elif sum(self.get(index, n + 1) & 0xFF for n in range(value)) > 64:
            raise SdoAbortedError(TOO_LONG)

    # -- process data

    def mapped(self, index: int) -> list[int]:
        return [self.get(index, n + 1) >> 16 for n in range(self.get(index, 0))]

    def on_pdo(self, identifier: int, data: bytes, when: float) -> None:
        with self.lock:
            for number in range(len(self.variant.taken)):
                if self.get(0x1400 + number, 1) & ~NO_REMOTE != identifier:
                    continue
                indices, at = self.mapped(0x1600 + number), 0
                if self.node.nmt.state != "OPERATIONAL" or len(data) < sum(MAPPABLE[i] // 8 for i in indices):
                    return
                for index in indices:
                    self.node.set_data(index, 0, bytes(data[at : at + MAPPABLE[index] // 8]))
                    at += MAPPABLE[index] // 8

    def on_sync(self, identifier: int, data: bytes, when: float) -> None:
        if self.variant.sync:
            self.send_pdos(lambda number: 1 <= self.get(0x1800 + number, 2) <= 240)

    def send_pdos(self, due) -> None:
        with self.lock:
            if self.node.nmt.state != "OPERATIONAL":
                return
            for number in range(len(self.variant.told)):
                cob = self.get(0x1800 + number, 1)
                if cob & UNUSED or not due(number):
                    continue
                data = b"".join(self.node.get_data(i, 0) for i in self.mapped(0x1A00 + number))
                self.pdos_sent_at[number] = (time.monotonic(), data)
                self.network.send_message(cob & 0x7FF, data)

    def is_due(self, number: int) -> bool:
        """By its timer, or after a change, but not before the inhibit time has passed."""
        if self.get(0x1800 + number, 2) <= 240:
            return False
        when, before = self.pdos_sent_at.get(number, (-math.inf, b""))
        since = time.monotonic() - when
        timer = self.get(0x1800 + number, 5) / 1000.0 if self.variant.timer else 0.0
        data = b"".join(self.node.get_data(i, 0) for i in self.mapped(0x1A00 + number))
        changed = data != before and since >= self.get(0x1800 + number, 3) / 10_000.0
        return changed or bool(timer and since >= timer)

    # -- supervision of the master

    def on_heartbeat(self, identifier: int, data: bytes, when: float) -> None:
        with self.lock:
            watched = self.get(0x1016, 1)
            if watched & 0xFFFF and watched >> 16 == identifier - 0x700:
                self.watched_at = time.monotonic()

    def watch(self) -> None:
        if (
            self.watched_at is None
            or time.monotonic() - self.watched_at < (self.get(0x1016, 1) & 0xFFFF) / 1000.0
        ):
            return
        self.watched_at = None
        option = self.get(0x6007)
        if option == 1:
            self.fail(0x8130)
        elif self.state == ENABLED and option in (2, 3):
            self.state = DISABLED if option == 2 else STOPPING

    # -- the state machine

    def control(self, controlword: int) -> None:
        rising, self.controlword = controlword & ~self.controlword, controlword
        if self.state == FAULT:
            if rising & 0x80:
                self.put(0x603F, 0)
                self.state = DISABLED
        else:
            for (mask, value), steps in COMMANDS:
                if controlword & mask == value and self.state in steps:
                    # Transition 16 is for a quick stop that keeps its state (0x605A is 5 to 8).
                    if self.state == STOPPING and steps[self.state] == ENABLED and self.get(0x605A) < 5:
                        break
                    if steps[self.state] == ENABLED != self.state:
                        self.goal, self.bits = None, 0
                    self.state = steps[self.state]
                    break
        if self.state == ENABLED:
            self.command(controlword, rising)
        self.show()

    def command(self, controlword: int, rising: int) -> None:
        """Bit 4, by mode: a new setpoint is acknowledged by bit 12; homing sets the present position to 0."""
        if self.mode == 1:
            if rising & 0x10:
                self.goal = self.get(0x607A)
            self.bits = SPECIFIC if controlword & 0x10 else 0
        elif self.mode == 6:
            self.bits = 0
            if controlword & 0x10 and self.get(0x6098) in (35, 37):
                self.position, self.bits = 0.0, SPECIFIC | REACHED

    def fail(self, code: int) -> None:
        self.state = REACTING if self.state in (ENABLED, STOPPING) else FAULT
        self.put(0x603F, code)
        self.network.send_message(0x80 + self.id, struct.pack("<HB5x", code, 0x11))

    def show(self) -> None:
        self.put(0x6041, self.state | (self.bits if self.state == ENABLED else 0))

    # -- the motor

    def run(self) -> None:
        while self.running:
            time.sleep(STEP)
            with self.lock:
                self.watch()
                self.move()
                self.show()
                self.put(0x6064, self.position)
                self.put(0x606C, self.velocity)
            self.send_pdos(self.is_due)

    def move(self) -> None:
        if self.state == ENABLED:
            self.ramp(self.target_velocity(), self.get(0x6083))
        elif self.state in (STOPPING, REACTING) and self.get(0x605A):
            self.ramp(0.0, self.get(0x6085))
            if self.velocity == 0.0 and self.state == REACTING:
                self.state = FAULT
            elif self.velocity == 0.0 and self.get(0x605A) < 5:
                self.state = DISABLED
        elif self.state in (STOPPING, REACTING):
            self.state = DISABLED if self.state == STOPPING else FAULT
        else:
            self.velocity *= 1.0 - STEP / COASTS
            self.velocity = self.velocity if abs(self.velocity) > 1.0 else 0.0
        self.position += self.velocity * STEP

    def ramp(self, target: float, most: float) -> None:
        self.velocity += max(-most * STEP, min(most * STEP, target - self.velocity))

    def target_velocity(self) -> float:
        fastest = self.get(0x607F)
        if self.mode in (3, 9):
            return max(-fastest, min(fastest, self.get(0x60FF)))
        target = self.get(0x607A) if self.mode == 8 else self.goal
        if self.mode not in (1, 8) or target is None:
            return 0.0
        way = target - self.position
        braking = math.sqrt(2.0 * self.get(0x6083) * abs(way)) * 0.8
        speed = min(fastest, braking, abs(way) / STEP, self.get(0x6081) if self.mode == 1 else math.inf)
        return math.copysign(speed, way)


@contextmanager
def foreign(endpoint: str, node: int, variant: Variant):
    """The drive on the bus behind a socketcand endpoint, for the duration of the block."""
    network = canopen.Network()
    network.bus = opened(tcp(endpoint))
    network.connect()
    drive = ForeignDrive(network, node, variant)
    try:
        yield drive
    finally:
        drive.stop()
        network.disconnect()
