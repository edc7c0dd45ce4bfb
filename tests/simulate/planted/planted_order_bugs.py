"""The rules that keep confirmed orders, each removed; and links beyond the neighbours."""

from __future__ import annotations

import random
from dataclasses import replace
from typing import Any

from planted_bugs import Bug, Patch

from lfield.devices.device_guards import DeviceGuards
from lfield.host.core import HostCore
from lfield.host.order_history.executed_orders import ExecutedOrders, OrderStanding
from lfield.host.stop_orders.order_executor import OrderExecutor
from lfield.host.team import operator_commands
from lfield.journal.records import PauseFlag
from lfield.replication.transfer.core import Mobility
from lfield.replication.transfer.effects import Effect
from lfield.replication.transfer.transfer_sender import UNREACHABLE
from lfield.wire.order_messages import HOLDS, OrderKind
from simulation_testing.fault_injection import Fault
from simulation_testing.scenarios.scenario import FOR_EVER, Scenario, plain
from simulation_testing.scenarios.scenario_drawing import crowd, under_orders, wrecked


def ordered(seed: int) -> Scenario:
    """A scenario with orders of an operator, of hosts with journals that are often killed."""
    rng = random.Random(f"ordered {seed}")
    means = {kind: rng.uniform(1.5, 4.0) for kind in ("kill", "restart", "guard_kill")}
    scenario = replace(plain(seed), cast=3, hosts=3, arms=2, calls=FOR_EVER, stay=0.04, means=means)
    scenario = replace(scenario, journals=True, lost_after=None, weather=14.0, seconds=14.0)
    return under_orders(scenario, rng)


def a_stop_is_forgotten_by_a_restart(patch: Patch) -> None:
    patch.setattr(OrderExecutor, "restore_emergency_stop", lambda self: None)


def a_pause_is_forgotten_by_a_restart(patch: Patch) -> None:
    patch.setattr(operator_commands, "PauseFlag", lambda on, order: PauseFlag(False, order))


def a_program_can_release_during_a_stop(patch: Patch) -> None:
    def bar(self: DeviceGuards, reason: str) -> None:
        for guard in self._guards:
            for name in guard.actuated_devices:
                guard.make_safe(name, reason)

    patch.setattr(DeviceGuards, "inhibit", bar)


def a_pause_does_not_make_devices_safe(patch: Patch) -> None:
    async def rest(self: DeviceGuards, reason: str) -> dict[str, str]:
        return {name: "" for guard in self._guards for name in guard.actuated_devices}

    patch.setattr(DeviceGuards, "enter_safe_state", rest)


def hasty(seed: int) -> Scenario:
    """A scenario in which the end of a stop is in flight on slow links while the next stop uses fast ones."""
    rng, scenario = random.Random(f"hasty {seed}"), ordered(seed)
    aimed: list[Fault] = []
    for round in range(3):
        pressed = 2.0 + 7.0 * round + rng.uniform(0.0, 0.5)
        ended = pressed + 1.0
        aimed.append(Fault(pressed, "estop", "h0", "h1", 1.0, 0.0))
        # The operator's link is slow: the end has been sent when the next stop arrives, and has not arrived.
        aimed += [Fault(ended - 0.01, "slow", host, host, 2.0, 0.0) for host in ("h0", "h1")]
        aimed.append(Fault(ended + 2.05, "estop", "h0", "h1", 3.0, 0.0))
    return replace(scenario, cast=2, hosts=2, means={}, aimed=tuple(aimed), weather=25.0, seconds=25.0)


def a_delayed_order_ends_a_newer_stop(patch: Patch) -> None:
    standing = ExecutedOrders.standing_of

    def any_epoch(self: ExecutedOrders, kind: OrderKind, id: bytes, epoch: bytes) -> OrderStanding:
        found = standing(self, kind, id, epoch)
        return "new" if found in ("old", "unknown") and kind not in HOLDS else found

    patch.setattr(ExecutedOrders, "standing_of", any_epoch)


def a_forgotten_coordinator_continues(patch: Patch) -> None:
    def forget(self: Mobility, agent: str, detail: str) -> tuple[list[int], list[Effect]]:
        doubted = [
            copy for copy in self._copies.starts_of(agent) if copy.doubt_reason and copy.state == "PREPARED"
        ]
        effects: list[Effect] = []
        for copy in doubted:
            copy.doubt_reason = ""
            effects += self._sender._resume(copy, UNREACHABLE, detail)
        return [copy.generation for copy in doubted], effects

    patch.setattr(Mobility, "declare_lost", forget)


def transfers_are_not_relayed(patch: Patch) -> None:
    def wanted(self: HostCore) -> set[str]:
        return {*self.membership.overlay_links(self._clock.monotonic())} - {self.name}

    patch.setattr(HostCore, "needed_hosts", wanted)
    patch.setattr(HostCore, "require_link", lambda self, host: None)


def _bug(plant: Any, broken: str, found: str, seed: int, draws: Any = ordered) -> Bug:
    return Bug(plant, broken, frozenset(found.split()), seed, draws)


ORDER_BUGS = [
    _bug(
        a_stop_is_forgotten_by_a_restart,
        "a restarted host forgets the emergency stop, and programs can release",
        "stop",
        269,
    ),
    _bug(
        a_pause_is_forgotten_by_a_restart,
        "a restarted host forgets the pause and runs its agents",
        "pause",
        1,
    ),
    _bug(
        a_program_can_release_during_a_stop,
        "a program can release a device during an emergency stop",
        "stop",
        13,
    ),
    _bug(
        a_pause_does_not_make_devices_safe, "a pause does not put devices into their safe states", "pause", 9
    ),
    _bug(
        a_delayed_order_ends_a_newer_stop,
        "a delayed lift ends a newer emergency stop",
        "stop",
        0,
        hasty,
    ),
    _bug(
        a_forgotten_coordinator_continues,
        "a coordinator continues after 'lfield forget'",
        "forget",
        1,
        wrecked,
    ),
    _bug(
        transfers_are_not_relayed,
        "transfers are not relayed: a coordinator never reaches a host without a direct link",
        "reach",
        0,
        crowd,
    ),
]
