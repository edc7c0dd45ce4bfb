"""The commands every vehicle of the fake knows: number -> what it does, with the results of the real ones."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from pymavlink.dialects.v20 import all as dialect

from lfield_sim.autopilot.body.goals import Circle, Vector
from lfield_sim.autopilot.flavours import Result, Role
from lfield_sim.mavlink.command import Answer, Command
from lfield_sim.mavlink.sender import Sender

#: param2 of an arming or disarming that is meant whatever the checks say, even in the air.
FORCE = 21196
#: Of an orbit, when it is not told: metres, and m/s.
ORBIT_RADIUS, ORBIT_SPEED = 10.0, 2.0


def answer(sender: Sender, command: Command) -> Answer:
    """Carry a command out: its result, and messages that follow the acknowledgement."""
    if command.number in sender.autopilot.flavour.unsupported:
        return Result.UNSUPPORTED, []
    handler = _COMMANDS.get(command.number)
    return handler(sender, command) if handler else (Result.UNSUPPORTED, [])


def second_answer(sender: Sender, command: Command) -> Result | None:
    """PX4 acknowledges a mode twice: that it has understood, and whether it is available."""
    pilot = sender.autopilot
    if command.number != dialect.MAV_CMD_DO_SET_MODE or not pilot.flavour.submodes:
        return None
    name = pilot.kind.mode_name(_mode_number(sender, command))
    return Result.TEMPORARILY_REJECTED if name and name != pilot.mode else Result.ACCEPTED


def _arm(sender: Sender, command: Command) -> Answer:
    force = command.whole(2) == FORCE
    wanted = command.whole(1)
    if wanted not in (0, 1):
        return Result.UNSUPPORTED, []
    return (sender.autopilot.arm(force=force) if wanted else sender.autopilot.disarm(force=force)), []


def _takeoff(sender: Sender, command: Command) -> Answer:
    """The height is above home for ArduPilot; for PX4 above mean sea level, or a parameter when it is NaN."""
    height = command.given(7)
    if height is not None and sender.autopilot.flavour.takeoff_mode:
        height -= sender.place.altitude - sender.autopilot.home[2]
    return sender.autopilot.takeoff(height), []


def _land(sender: Sender, _: Command) -> Answer:
    if sender.autopilot.flavour.submodes:
        sender.autopilot.say("Landing at current position\t")
    return sender.autopilot.command_role(Role.LAND), []


def _loiter(sender: Sender, _: Command) -> Answer:
    """ArduCopter's mode LOITER."""
    pilot = sender.autopilot
    loiters = pilot.flies and not pilot.flavour.submodes
    return (pilot.command_mode("LOITER") if loiters else Result.UNSUPPORTED), []


def _return(sender: Sender, _: Command) -> Answer:
    if sender.autopilot.flavour.submodes:
        sender.autopilot.say("Returning to launch\t")
    return sender.autopilot.go_home(), []


def _set_mode(sender: Sender, command: Command) -> Answer:
    if not command.whole(1) & dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
        return Result.DENIED, []
    return sender.autopilot.set_mode(_mode_number(sender, command)), []


def _mode_number(sender: Sender, command: Command) -> int:
    number = command.whole(2)
    return number << 16 | (command.whole(3) & 0xFF) << 24 if sender.autopilot.flavour.submodes else number


def _yaw(sender: Sender, command: Command) -> Answer:
    angle, relative = command.value(1), command.whole(4)
    if not 0.0 <= angle <= 360.0 or relative not in (0, 1):
        return Result.FAILED, []
    start = sender.autopilot.vehicle.yaw if relative else 0.0
    turn = -1.0 if relative and command.value(3) < 0 else 1.0
    return sender.autopilot.set_yaw(start + turn * math.radians(angle)), []


def _speed(sender: Sender, command: Command) -> Answer:
    if command.whole(1) not in (0, 1):
        return Result.UNSUPPORTED, []
    return sender.autopilot.set_speed(command.value(2)), []


def _reposition(sender: Sender, command: Command) -> Answer:
    if command.frame is None and not sender.autopilot.flavour.submodes:
        return Result.UNSUPPORTED, []
    place = _place(sender, command)
    speed, pilot = command.value(1), sender.autopilot
    if place is None:
        # On the ground PX4 says yes to any place.
        anywhere = pilot.flavour.submodes and not pilot.vehicle.airborne
        return (Result.ACCEPTED if anywhere else Result.DENIED), []
    change = bool(command.whole(2) & dialect.MAV_DO_REPOSITION_FLAGS_CHANGE_MODE)
    return pilot.reposition(
        place,
        command.given(4),
        change_mode=change or pilot.flavour.submodes,
        speed=speed if speed > 0.0 else None,
    ), []


def _orbit(sender: Sender, command: Command) -> Answer:
    centre = _place(sender, command)
    radius = command.given(1) or ORBIT_RADIUS
    speed = command.given(2) or ORBIT_SPEED
    if centre is None or not 1.0 <= abs(radius) <= 1000.0 or not 0.0 < speed <= 20.0:
        return Result.DENIED, []
    return sender.autopilot.orbit(Circle(centre, abs(radius), math.copysign(speed, radius))), []


def _set_home(sender: Sender, command: Command) -> Answer:
    """PX4 in a calibration takes it too, and does not get round to answering."""
    here = sender.autopilot.vehicle.place
    place = here if command.whole(1) == 1 else _place(sender, command)
    if place is None:
        return Result.DENIED, []
    sender.autopilot.take_home(place, told=True)
    if sender.autopilot.calibrating and sender.autopilot.flavour.submodes:
        return None, []
    if not sender.autopilot.flies and not sender.autopilot.flavour.submodes:
        latitude, longitude = (each / 1e7 for each in sender.place.at(*place[:2]))
        height = sender.place.altitude - place[2]
        sender.autopilot.say(f"Set HOME to {latitude:.5f} {longitude:.4f} at {height:.2f}m")
    return Result.ACCEPTED, []


def _reboot(sender: Sender, command: Command) -> Answer:
    if command.whole(1) == 2 and sender.autopilot.flavour.submodes and not sender.autopilot.armed:
        sender.autopilot.switch_off()
        return None, []
    return (sender.reboot() if command.whole(1) in (1, 3) else Result.UNSUPPORTED), []


def _terminate(sender: Sender, command: Command) -> Answer:
    if command.value(1) > 0.5:
        return sender.autopilot.terminate(), []
    return (Result.DENIED if sender.autopilot.flavour.submodes else Result.FAILED), []


def _set_interval(sender: Sender, command: Command) -> Answer:
    kind, micros = command.whole(1), command.value(2)
    flavour = sender.autopilot.flavour
    if not sender.can_send(kind) or kind in flavour.unasked_only:
        if not flavour.submodes:
            sender.autopilot.say(f"No ap_message for mavlink id ({kind})")
        return (Result.FAILED if flavour.submodes else Result.DENIED), []
    if micros > 0 and 1e6 / micros > flavour.fastest:
        sender.autopilot.say(f"Requested rate for message ID {kind} too fast. Increase SCHED_LOOP_RATE")
        return Result.DENIED, []
    # -1 stops the stream; 0 asks for the default rate, which on ArduPilot is none.
    sender.stream(kind, 1e6 / micros if micros > 0 else sender.default_rate(kind) if micros == 0 else 0.0)
    return Result.ACCEPTED, []


def _get_interval(sender: Sender, command: Command) -> Answer:
    kind = command.whole(1)
    if not sender.can_send(kind):
        return Result.FAILED, []
    micros = round(sender.interval(kind) * 1e6) or -1
    return Result.ACCEPTED, [dialect.MAVLink_message_interval_message(kind, micros)]


def _request_message(sender: Sender, command: Command) -> Answer:
    kind = command.whole(1)
    found = sender.find(kind)
    if found is None or kind in sender.autopilot.flavour.streamed_only:
        return (Result.DENIED if sender.autopilot.flavour.submodes else Result.FAILED), []
    return Result.ACCEPTED, found


def _place(sender: Sender, command: Command) -> Vector | None:
    return command.place(sender.place, sender.autopilot.vehicle.place, sender.autopilot.home)


_COMMANDS: Mapping[int, Callable[[Sender, Command], Answer]] = {
    dialect.MAV_CMD_NAV_LOITER_UNLIM: _loiter,
    dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH: _return,
    dialect.MAV_CMD_NAV_LAND: _land,
    dialect.MAV_CMD_NAV_TAKEOFF: _takeoff,
    dialect.MAV_CMD_DO_ORBIT: _orbit,
    dialect.MAV_CMD_CONDITION_YAW: _yaw,
    dialect.MAV_CMD_DO_SET_MODE: _set_mode,
    dialect.MAV_CMD_DO_CHANGE_SPEED: _speed,
    dialect.MAV_CMD_DO_SET_HOME: _set_home,
    dialect.MAV_CMD_DO_FLIGHTTERMINATION: _terminate,
    dialect.MAV_CMD_DO_REPOSITION: _reposition,
    dialect.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN: _reboot,
    dialect.MAV_CMD_COMPONENT_ARM_DISARM: _arm,
    dialect.MAV_CMD_GET_MESSAGE_INTERVAL: _get_interval,
    dialect.MAV_CMD_SET_MESSAGE_INTERVAL: _set_interval,
    dialect.MAV_CMD_REQUEST_MESSAGE: _request_message,
}
