"""Commands of every vehicle: number -> handler, with the results of the real ones."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from pymavlink.dialects.v20 import all as dialect

from lfield_sim.autopilot.body.goals import Orbit, Vector
from lfield_sim.autopilot.flavours import MavResult, Role
from lfield_sim.mavlink.mav_command import CommandAnswer, MavCommand
from lfield_sim.mavlink.message_sender import MessageSender

#: param2 of a forced arming or disarming.
FORCE = 21196
#: Default orbit: metres, and m/s.
ORBIT_RADIUS, ORBIT_SPEED = 10.0, 2.0


def answer(sender: MessageSender, command: MavCommand) -> CommandAnswer:
    """Executes a command: its result, and messages that follow the acknowledgement."""
    if command.number in sender.autopilot.flavour.unsupported:
        return MavResult.UNSUPPORTED, []
    handler = _COMMANDS.get(command.number)
    return handler(sender, command) if handler else (MavResult.UNSUPPORTED, [])


def second_answer(sender: MessageSender, command: MavCommand) -> MavResult | None:
    """PX4's second acknowledgement of a mode: first understood, then available."""
    pilot = sender.autopilot
    if command.number != dialect.MAV_CMD_DO_SET_MODE or not pilot.flavour.submodes:
        return None
    name = pilot.kind.mode_name(_mode_number(sender, command))
    return MavResult.TEMPORARILY_REJECTED if name and name != pilot.mode else MavResult.ACCEPTED


def _arm(sender: MessageSender, command: MavCommand) -> CommandAnswer:
    force = command.whole(2) == FORCE
    requested = command.whole(1)
    if requested not in (0, 1):
        return MavResult.UNSUPPORTED, []
    return (sender.autopilot.arm(force=force) if requested else sender.autopilot.disarm(force=force)), []


def _takeoff(sender: MessageSender, command: MavCommand) -> CommandAnswer:
    """Takes off; the height is above home for ArduPilot, above mean sea level for PX4, or a parameter when
    it is NaN.
    """
    height = command.optional(7)
    if height is not None and sender.autopilot.flavour.takeoff_mode:
        height -= sender.place.altitude - sender.autopilot.home[2]
    return sender.autopilot.takeoff(height), []


def _land(sender: MessageSender, _: MavCommand) -> CommandAnswer:
    if sender.autopilot.flavour.submodes:
        sender.autopilot.say("Landing at current position\t")
    return sender.autopilot.command_role(Role.LAND), []


def _loiter(sender: MessageSender, _: MavCommand) -> CommandAnswer:
    """Enters ArduCopter's mode LOITER."""
    pilot = sender.autopilot
    loiters = pilot.flies and not pilot.flavour.submodes
    return (pilot.command_mode("LOITER") if loiters else MavResult.UNSUPPORTED), []


def _return(sender: MessageSender, _: MavCommand) -> CommandAnswer:
    if sender.autopilot.flavour.submodes:
        sender.autopilot.say("Returning to launch\t")
    return sender.autopilot.go_home(), []


def _set_mode(sender: MessageSender, command: MavCommand) -> CommandAnswer:
    if not command.whole(1) & dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
        return MavResult.DENIED, []
    return sender.autopilot.set_mode(_mode_number(sender, command)), []


def _mode_number(sender: MessageSender, command: MavCommand) -> int:
    number = command.whole(2)
    return number << 16 | (command.whole(3) & 0xFF) << 24 if sender.autopilot.flavour.submodes else number


def _yaw(sender: MessageSender, command: MavCommand) -> CommandAnswer:
    angle, relative = command.value(1), command.whole(4)
    if not 0.0 <= angle <= 360.0 or relative not in (0, 1):
        return MavResult.FAILED, []
    start = sender.autopilot.vehicle.yaw if relative else 0.0
    turn = -1.0 if relative and command.value(3) < 0 else 1.0
    return sender.autopilot.set_yaw(start + turn * math.radians(angle)), []


def _speed(sender: MessageSender, command: MavCommand) -> CommandAnswer:
    if command.whole(1) not in (0, 1):
        return MavResult.UNSUPPORTED, []
    return sender.autopilot.set_speed(command.value(2)), []


def _reposition(sender: MessageSender, command: MavCommand) -> CommandAnswer:
    if command.frame is None and not sender.autopilot.flavour.submodes:
        return MavResult.UNSUPPORTED, []
    place = _place(sender, command)
    speed, pilot = command.value(1), sender.autopilot
    if place is None:
        # On the ground PX4 accepts any position.
        anywhere = pilot.flavour.submodes and not pilot.vehicle.airborne
        return (MavResult.ACCEPTED if anywhere else MavResult.DENIED), []
    change = bool(command.whole(2) & dialect.MAV_DO_REPOSITION_FLAGS_CHANGE_MODE)
    return pilot.reposition(
        place,
        command.optional(4),
        change_mode=change or pilot.flavour.submodes,
        speed=speed if speed > 0.0 else None,
    ), []


def _orbit(sender: MessageSender, command: MavCommand) -> CommandAnswer:
    centre = _place(sender, command)
    radius = command.optional(1) or ORBIT_RADIUS
    speed = command.optional(2) or ORBIT_SPEED
    if centre is None or not 1.0 <= abs(radius) <= 1000.0 or not 0.0 < speed <= 20.0:
        return MavResult.DENIED, []
    return sender.autopilot.orbit(Orbit(centre, abs(radius), math.copysign(speed, radius))), []


def _set_home(sender: MessageSender, command: MavCommand) -> CommandAnswer:
    """Sets home; PX4 in a calibration does so too, but does not answer."""
    present = sender.autopilot.vehicle.place
    place = present if command.whole(1) == 1 else _place(sender, command)
    if place is None:
        return MavResult.DENIED, []
    sender.autopilot.set_home(place, sent=True)
    if sender.autopilot.calibrating and sender.autopilot.flavour.submodes:
        return None, []
    if not sender.autopilot.flies and not sender.autopilot.flavour.submodes:
        latitude, longitude = (each / 1e7 for each in sender.place.at(*place[:2]))
        height = sender.place.altitude - place[2]
        sender.autopilot.say(f"Set HOME to {latitude:.5f} {longitude:.4f} at {height:.2f}m")
    return MavResult.ACCEPTED, []


def _reboot(sender: MessageSender, command: MavCommand) -> CommandAnswer:
    if command.whole(1) == 2 and sender.autopilot.flavour.submodes and not sender.autopilot.armed:
        sender.autopilot.switch_off()
        return None, []
    return (sender.reboot() if command.whole(1) in (1, 3) else MavResult.UNSUPPORTED), []


def _terminate(sender: MessageSender, command: MavCommand) -> CommandAnswer:
    if command.value(1) > 0.5:
        return sender.autopilot.terminate(), []
    return (MavResult.DENIED if sender.autopilot.flavour.submodes else MavResult.FAILED), []


def _set_interval(sender: MessageSender, command: MavCommand) -> CommandAnswer:
    kind, micros = command.whole(1), command.value(2)
    flavour = sender.autopilot.flavour
    if not sender.can_send(kind) or kind in flavour.unasked_only:
        if not flavour.submodes:
            sender.autopilot.say(f"No ap_message for mavlink id ({kind})")
        return (MavResult.FAILED if flavour.submodes else MavResult.DENIED), []
    if micros > 0 and 1e6 / micros > flavour.fastest:
        sender.autopilot.say(f"Requested rate for message ID {kind} too fast. Increase SCHED_LOOP_RATE")
        return MavResult.DENIED, []
    # -1 stops the stream; 0 requests the default rate, which is none on ArduPilot.
    sender.stream(kind, 1e6 / micros if micros > 0 else sender.default_rate(kind) if micros == 0 else 0.0)
    return MavResult.ACCEPTED, []


def _get_interval(sender: MessageSender, command: MavCommand) -> CommandAnswer:
    kind = command.whole(1)
    if not sender.can_send(kind):
        return MavResult.FAILED, []
    micros = round(sender.interval(kind) * 1e6) or -1
    return MavResult.ACCEPTED, [dialect.MAVLink_message_interval_message(kind, micros)]


def _request_message(sender: MessageSender, command: MavCommand) -> CommandAnswer:
    kind = command.whole(1)
    messages = sender.find(kind)
    if messages is None or kind in sender.autopilot.flavour.streamed_only:
        return (MavResult.DENIED if sender.autopilot.flavour.submodes else MavResult.FAILED), []
    return MavResult.ACCEPTED, messages


def _place(sender: MessageSender, command: MavCommand) -> Vector | None:
    return command.place(sender.place, sender.autopilot.vehicle.place, sender.autopilot.home)


_COMMANDS: Mapping[int, Callable[[MessageSender, MavCommand], CommandAnswer]] = {
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
