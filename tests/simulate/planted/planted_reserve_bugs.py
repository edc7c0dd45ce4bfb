"""The rules that make a reservation exclusive, each removed: the judge must find the effect."""

from __future__ import annotations

import random
from dataclasses import replace
from typing import Any

from planted_bugs import Bug, Patch

from lfield.host.migration.write_ahead import WriteAheadQueue
from lfield.host.team.reservation_service import ReservationService
from lfield.host.team.reservations import Reservations, StartKey
from simulation_testing.scenarios.scenario import Scenario, doubted, keeper


def a_reservation_number_is_granted_before_it_is_on_disk(patch: Patch) -> None:
    write = ReservationService._write

    def write_and_confirm(self: ReservationService, effect: Any) -> None:
        write(self, effect)
        if effect.holder is not None:
            self._reservations.on_durable(effect.resource, effect.number, self._clock.monotonic())

    patch.setattr(ReservationService, "_write", write_and_confirm)


def a_restarted_host_grants_without_waiting(patch: Patch) -> None:
    restore = Reservations.restore

    def free(self: Reservations, resource: str, number: int, holder: StartKey | None, now: float) -> None:
        restore(self, resource, number, None, now)

    patch.setattr(Reservations, "restore", free)


def an_expired_holder_renews(patch: Patch) -> None:
    def renew(self: Reservations, start: StartKey, resource: str, number: int, now: float) -> None:
        found = self._find(resource, now)
        if found.number >= number:
            found.holder, found.until, found.is_durable, found.is_granted = (
                start,
                now + self._lease,
                True,
                True,
            )

    patch.setattr(Reservations, "renew", renew)


def reservation_numbers_restart_at_1(patch: Patch) -> None:
    def restore_nothing(
        self: Reservations, resource: str, number: int, holder: StartKey | None, now: float
    ) -> None:
        """Restore no records of earlier lives."""
        self._first = 1

    patch.setattr(Reservations, "restore", restore_nothing)


def reservation_numbers_are_not_checked(patch: Patch) -> None:
    serves = Reservations.may_serve

    def serve_any_start(
        self: Reservations, start: StartKey, resource: str, number: int, now: float, *, nested: bool
    ) -> bool:
        return bool(number) or serves(self, start, resource, number, now, nested=nested)

    patch.setattr(Reservations, "may_serve", serve_any_start)


def a_reservation_is_granted_while_other_calls_run(patch: Patch) -> None:
    patch.setattr(ReservationService, "_busy", lambda self, resource, agent: False)


def a_call_without_a_reservation_starts(patch: Patch) -> None:
    patch.setattr(Reservations, "is_contended", lambda self, resource: False)


def a_reservation_ends_before_the_fence_is_on_disk(patch: Patch) -> None:
    patch.setattr(WriteAheadQueue, "is_pending_durable", lambda self, agent: False)


def fenced_keeper(seed: int) -> Scenario:
    """`keeper` in a small team with quick failovers, where hosts with slow disks lose power."""
    rng, doubts = random.Random(f"fenced keeper {seed}"), doubted(seed)
    pauses = {"cut": (0.8, 3.0), "disk_slow": (1.0, 3.0), "power": (1.0, 4.0), "island": (1.0, 4.0)}
    return replace(
        keeper(seed),
        cast=3,
        hosts=3,
        witnesses=0,
        calls=doubts.calls,
        interval=doubts.interval,
        lease=doubts.lease,
        stays=doubts.stays,
        sync=0.002,
        means={kind: rng.uniform(*bounds) for kind, bounds in pauses.items()},
        weather=doubts.weather,
        seconds=doubts.seconds,
    )


def _bug(plant: Any, broken: str, found: str, seed: int) -> Bug:
    return Bug(plant, broken, frozenset(found.split()), seed, keeper)


RESERVE_BUGS = [
    _bug(
        a_reservation_number_is_granted_before_it_is_on_disk,
        "a reservation number is granted before it is on disk: a restarted host grants it again",
        "given",
        0,
    ),
    _bug(
        a_restarted_host_grants_without_waiting,
        "a restarted host grants a resource without waiting for the lease of its holder",
        "reserved robbed",
        23,
    ),
    _bug(
        an_expired_holder_renews,
        "an expired holder can renew its reservation although another one holds it",
        "reserved robbed stale",
        151,
    ),
    _bug(
        reservation_numbers_restart_at_1,
        "reservation numbers restart at 1 after a restart",
        "number robbed",
        1,
    ),
    _bug(
        reservation_numbers_are_not_checked,
        "the reservation number of a call is not checked: a former holder can call",
        "stale reserved",
        20,
    ),
    _bug(
        a_reservation_is_granted_while_other_calls_run,
        "a reservation is granted while calls of other coordinators are running",
        "busy",
        1,
    ),
    _bug(
        a_call_without_a_reservation_starts,
        "a call without a reservation starts while another coordinator holds one",
        "reserved",
        1,
    ),
    Bug(
        a_reservation_ends_before_the_fence_is_on_disk,
        "the reservation of a fenced start ends before the fence is on disk: a restarted host gives it back",
        frozenset({"reserved"}),
        6,
        fenced_keeper,
    ),
]
