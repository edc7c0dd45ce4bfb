"""What makes a reservation its holder's alone, each left out: the judge must find what comes of it."""

from __future__ import annotations

from typing import Any

from planted_bugs import Bug, Patch

from lfield.host.team.reservation_service import ReservationService
from lfield.host.team.reservations import Reservations, StartKey
from simulation_testing.scenarios.scenario import keeper


def a_number_is_told_before_it_is_kept(patch: Patch) -> None:
    write = ReservationService._write

    def boldly(self: ReservationService, effect: Any) -> None:
        write(self, effect)
        if effect.holder is not None:
            self._reservations.on_durable(effect.resource, effect.number, self._clock.monotonic())

    patch.setattr(ReservationService, "_write", boldly)


def no_wait_after_a_restart(patch: Patch) -> None:
    restore = Reservations.restore

    def free(self: Reservations, resource: str, number: int, holder: StartKey | None, now: float) -> None:
        restore(self, resource, number, None, now)

    patch.setattr(Reservations, "restore", free)


def a_stale_holder_renews(patch: Patch) -> None:
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


def numbers_begin_again(patch: Patch) -> None:
    def nothing(self: Reservations, resource: str, number: int, holder: StartKey | None, now: float) -> None:
        """Nothing is known of earlier lives."""
        self._first = 1

    patch.setattr(Reservations, "restore", nothing)


def any_number_will_do(patch: Patch) -> None:
    serves = Reservations.may_serve

    def whoever(
        self: Reservations, start: StartKey, resource: str, number: int, now: float, *, nested: bool
    ) -> bool:
        return bool(number) or serves(self, start, resource, number, now, nested=nested)

    patch.setattr(Reservations, "may_serve", whoever)


def it_is_given_while_others_are_at_work(patch: Patch) -> None:
    patch.setattr(ReservationService, "_busy", lambda self, resource, agent: False)


def who_only_calls_need_not_ask(patch: Patch) -> None:
    patch.setattr(Reservations, "is_contended", lambda self, resource: False)


def _bug(plant: Any, broken: str, found: str, seed: int) -> Bug:
    return Bug(plant, broken, frozenset(found.split()), seed, keeper)


RESERVE_BUGS = [
    _bug(
        a_number_is_told_before_it_is_kept,
        "a host that was started again gives the same number to somebody else",
        "given",
        0,
    ),
    _bug(
        no_wait_after_a_restart,
        "somebody has what a host gives away that has just been started again",
        "reserved robbed",
        19,
    ),
    _bug(
        a_stale_holder_renews,
        "who was cut off for long becomes the holder again beside the one that has it since",
        "reserved robbed stale",
        13,
    ),
    _bug(numbers_begin_again, "a number of an earlier life is given once more", "number robbed", 1),
    _bug(any_number_will_do, "who has lost what it had acts on", "stale reserved", 28),
    _bug(it_is_given_while_others_are_at_work, "a holder is not alone with what it has", "busy", 1),
    _bug(who_only_calls_need_not_ask, "a portal begins for others while somebody has it", "reserved", 1),
]
