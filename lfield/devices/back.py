"""Puts back what devices had before `lfield setup`: looked at first, and written as it was looked at.

What was kept belongs to a device, not to the place where it was found: another one may be there now. Of one
that has nothing of its own only what fits is put back, and an entry that does not fit stays kept.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from lfield.clock import Clock
from lfield.devices.kept import Change, Entry, Kept
from lfield.devices.setup import Found, Tell, reached
from lfield.driver.known import Drivers
from lfield.driver.settings import same
from lfield.errors import DeviceError, DevicesError


@dataclass(frozen=True, slots=True)
class Step:
    """What becomes of one entry: what is written, and what is left alone and why, a sentence each.

    `there` is who was found in its place.
    """

    entry: Entry
    there: str
    writes: Sequence[Change]
    left: Sequence[str]

    @property
    def is_sure(self) -> bool:
        """Whether the device that was looked at is known to be that of the entry."""
        return bool(self.entry.serial)

    @property
    def needs_yes(self) -> bool:
        """Whether somebody must agree: something is written, or a value that was there is forgotten."""
        return bool(self.writes or (self.left and self.is_sure))

    @property
    def ends_it(self) -> bool:
        """Whether the entry is of no more use then."""
        return self.is_sure or not self.left

    def lines(self) -> list[str]:
        """What it does, for whoever is asked."""
        entry = self.entry
        told = [f"{change.name} from {change.now:.9g} back to {change.was:.9g}" for change in self.writes]
        if not told:
            told.append("nothing to write")
        elif not self.is_sure:
            told.append(f"whether that is {self.there}, which is there now, cannot be known")
        heading = f"{entry.binding.name}, {entry.who} at {entry.binding.endpoint}, since {entry.when}:"
        return [heading, *(f"    {line}" for line in (*told, *self.left))]


async def look_back(
    entries: Sequence[Entry], drivers: Drivers, clock: Clock, tell: Tell
) -> tuple[list[Step], list[str]]:
    """What is to be done, the last entry first, and what is in the way, a sentence each. It writes nothing.

    An entry whose device is not there has no step.
    """
    steps, problems = list[Step](), list[str]()
    # What devices will have by then of what later entries put back.
    by_then: dict[tuple[str, str, str], dict[str, float]] = {}
    for entry in reversed(entries):
        try:
            async with reached(drivers, [entry.binding], clock, tell) as (found,):
                known = by_then.setdefault((*entry.binding.bus, found.who), {})
                step = _step(entry, found, _present(found) | known)
        except DevicesError as error:
            problems += error.problems
            continue
        known.update({change.name: change.was for change in step.writes})
        steps.append(step)
    return steps, problems


def _present(found: Found) -> dict[str, float]:
    return {setting.name: setting.present for setting in found.settings}


def _step(entry: Entry, found: Found, present: Mapping[str, float]) -> Step:
    """Raises DevicesError when it is another device."""
    if entry.serial and found.serial != entry.serial:
        there = f"{found.name}: at {entry.binding.endpoint} is {found.who} now, and not {entry.who}"
        raise DevicesError([f"{there}: what that had before stays kept"])
    writes, left = list[Change](), list[str]()
    for change in entry.changes:
        is_now = present.get(change.name)
        if is_now is not None and same(is_now, change.was):
            continue
        if is_now is not None and same(is_now, change.now):
            writes.append(change)
        else:
            left.append(f"{found.name}: {_left_alone(change, is_now, sure=bool(entry.serial))}")
    if not (writes or left or entry.serial):
        # It was never written to, or it is another one.
        left.append(
            f"{found.name}: whether it is the device of {entry.when} cannot be known: that stays kept"
        )
    return Step(entry, found.who, writes, left)


def _left_alone(change: Change, is_now: float | None, *, sure: bool) -> str:
    told = "is not told any more" if is_now is None else f"is {is_now:.9g}"
    if not sure:
        doubt = "it may be another device, and it stays kept"
        return f"{change.name} {told}: left alone; what was set up had {change.was:.9g} before; {doubt}"
    by = "" if is_now is None else ", by somebody else"
    return f"{change.name} {told}{by}: left alone; it was {change.was:.9g} before"


async def put_back(
    steps: Sequence[Step], kept: Kept, drivers: Drivers, clock: Clock, tell: Tell
) -> list[str]:
    """Do these, in this order; what was left alone or could not be done, a sentence each.

    An entry stays kept when its device could not be reached, or is not as it was looked at.
    """
    problems: list[str] = []
    for step in steps:
        problems += step.left
        try:
            if step.writes:
                async with reached(drivers, [step.entry.binding], clock, tell) as (found,):
                    await _restore(found, step, tell)
        except DevicesError as error:
            problems += error.problems
            continue
        if step.ends_it:
            kept.remove(step.entry)
    return problems


async def _restore(found: Found, step: Step, tell: Tell) -> None:
    """Raises DevicesError when not all could be written."""
    if _step(step.entry, found, _present(found)).writes != step.writes:
        raise DevicesError([f"{found.name}: it has changed since it was looked at: nothing was written"])
    for change in step.writes:
        try:
            await found.device.write_setting(change.name, change.was)
        except DeviceError as error:
            raise DevicesError([f"{found.name}: {error.reason}"]) from None
        tell(f"{found.name}: {change.name} was {change.now:.9g} and is {change.was:.9g} again")
