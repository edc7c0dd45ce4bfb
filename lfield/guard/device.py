"""What a guard knows of one device: whether it is latched, what runs on it, and until when."""

from __future__ import annotations

from dataclasses import dataclass, field

from lfield.guard.messages import Call
from lfield.guard.running import Running, way
from lfield.manifest import DeviceManifest, Instruction


@dataclass(slots=True)
class KnownDevice:
    """What the guard knows of one device. `latched` is the reason, or '' when it is free.

    `barred` is why the program may not release it: an emergency stop, or a lock-out of its driver.
    `told` is the last reason to be safe that a sensor has been given: it has nothing to do for it.
    `state` is the safe state that it is held in; '' for that of its binding.
    `making` says that its safe state is being commanded, `made_at` when that ended last.
    `rest_within` is how long it may take to come to rest, in seconds.
    `acting` is what runs on each channel, `setpoints` are the times when the ones in effect are over.
    """

    name: str
    manifest: DeviceManifest
    ttl: float
    rest_within: float
    latched: str = ""
    state: str = ""
    barred: str = ""
    told: str = ""
    confirmed: bool = False
    moved: bool = False
    making: bool = False
    made_at: float = 0.0
    retry_at: float | None = None
    setpoints: dict[str, float] = field(default_factory=dict)
    acting: dict[str, Running] = field(default_factory=dict)
    asking: dict[int, Running] = field(default_factory=dict)

    def declared(self, call: Call) -> Instruction:
        """The instruction of a call that was let in."""
        instruction = self.manifest.instruction(call.instruction)
        assert instruction is not None, "an unknown instruction is refused before it gets here"
        return instruction

    def expiry(self) -> float | None:
        """When the first setpoint in effect is over. An actuation that runs replaces it, unless it fails."""
        if self.latched or not (self.setpoints or self.acting):
            return None
        times = [until for channel, until in self.setpoints.items() if channel not in self.acting]
        calls = [running.call for running in self.acting.values()]
        times += [call.sent + self.ttl for call in calls if way(self.declared(call)) == "setpoint"]
        return min(times, default=None)

    def due(self) -> float | None:
        """When the next thing about it is due; None when nothing will be by itself."""
        if not (self.setpoints or self.acting):
            return self.retry_at
        times = (self.expiry(), self.retry_at, self.ends_by())
        return min((time for time in times if time is not None), default=None)

    def running(self, token: int) -> Running | None:
        """What runs for the call of a token, None when nothing does."""
        acting = (running for running in self.acting.values() if running.call.token == token)
        return self.asking.get(token) or next(acting, None)

    def forget(self, running: Running) -> None:
        """It runs no more."""
        self.asking.pop(running.call.token, None)
        self.acting = {channel: other for channel, other in self.acting.items() if other is not running}

    def ends_by(self) -> float | None:
        """When the first of the calls that were cancelled must have ended; None without any."""
        ends = (running.until for running in self.acting.values() if running.cancelled is not None)
        return min(ends, default=None)

    def too_slow(self, now: float) -> str:
        """What has not ended a cancelled call in its time, in words; '' for nothing."""
        if not self.acting:
            return ""
        late = (running.call for running in self.acting.values() if now >= running.until)
        return next((f"{call.instruction}() is not done after {self.rest_within:g} s" for call in late), "")
