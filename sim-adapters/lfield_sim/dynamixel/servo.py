"""One servo: execution of instructions, and protection.

Pure: time is given in seconds. https://emanual.robotis.com/docs/en/dxl/protocol2/.
"""

from __future__ import annotations

from lfield.errors import UsageError
from lfield_sim.dynamixel.control_table import ControlTable, InstructionRefused, RefusalCode
from lfield_sim.dynamixel.servo_model import BAUDS, POSITION, Register, ServoModel
from lfield_sim.dynamixel.servo_motion import ServoMotion
from lfield_sim.state_log import Facts

#: The control period in seconds while the servo moves, and while no value changes.
PERIOD, IDLE_PERIOD = 0.002, 0.1
#: rad/s below which a servo is at rest.
STILL = 0.02
#: Seconds of silence after a reboot.
BOOT = 0.1
#: An overload: share of the stall current, and its duration in seconds.
OVERLOAD_SHARE, OVERLOAD_TIME = 0.8, 1.0
#: Duration of a wrong voltage until it counts, in seconds.
VOLTAGE_TIME = 0.2

#: Bits of Hardware Error Status and Shutdown.
VOLTAGE_ERROR, OVERHEATING, ENCODER_ERROR, OVERLOAD = 0x01, 0x04, 0x08, 0x20
ALERT, ERRORS_1 = 0x80, 0x25
#: Unit of Return Delay Time, in seconds.
DELAY_UNIT = 2e-6
#: Value of Bus Watchdog after it expired, and its unit in seconds.
WATCHDOG_EXPIRED, WATCHDOG_UNIT = 255, 0.02
#: Bits of Startup Configuration and Drive Mode.
STARTUP_TORQUE, TORQUE_BY_GOAL = 0x01, 0x08
#: Secondary ids are below this.
NO_SECONDARY = 253

GOALS = frozenset({"goal_pwm", "goal_current", "goal_velocity", "goal_position"})
#: The status return level from which a servo answers instructions other than pings and reads.
ANSWER_ALL = 2
#: Parameters of the Clear instruction: multi-turn information, and four fixed bytes.
CLEAR_TURNS = bytes([0x01, 0x44, 0x58, 0x4C, 0x22])
#: Registers that Factory Reset keeps, by option.
PRESERVED_BY_OPTION = {0xFF: frozenset[str](), 0x01: frozenset({"id"}), 0x02: frozenset({"id", "baud_rate"})}


class Servo:
    """A servo powered up at time `now`. `encoder_fault` makes its encoder fail."""

    def __init__(self, model: ServoModel, now: float = 0.0) -> None:
        self.model = model
        self.table = ControlTable(model)
        self.motion = self.make_motion()
        self.encoder_fault = False
        self._time = self._powered_up_at = self._last_packet_at = now
        self._awake_at = now
        self._registered: list[tuple[Register, int]] = []
        self._is_shut_down = False
        self._overload_time = self._voltage_error_time = 0.0
        self._stale = True
        self.motion.reset_goals()

    def make_motion(self) -> ServoMotion:
        """The motion model of this kind of servo."""
        return ServoMotion(self.model, self.table)

    @property
    def id(self) -> int:
        """The id of the servo."""
        return self.table["id"]

    @property
    def baud(self) -> int:
        """Bits per second."""
        return BAUDS[self.table["baud_rate"]]

    def start_with(self, id: int, baud: int, protocol: int, return_delay: float) -> None:
        """Sets id, baud rate, protocol and return delay (s). Raises UsageError if the model does not support
        them.
        """
        protocols = self.model.items["protocol_type"]
        if not protocols.low <= protocol <= protocols.high:
            raise UsageError(f"{self.model.name} does not support protocol {protocol}.0")
        if baud not in BAUDS[: self.model.items["baud_rate"].high + 1]:
            raise UsageError(f"{self.model.name} does not support {baud} baud")
        self.table.put("protocol_type", protocol)
        self.table.put("baud_rate", BAUDS.index(baud))
        self.answer_as(id, return_delay)

    def answer_as(self, id: int, return_delay: float) -> None:
        """Sets the id and return delay (s) of the servo. Raises UsageError."""
        delay = self.model.items["return_delay_time"]
        if not delay.low <= round(return_delay / DELAY_UNIT) <= delay.high:
            raise UsageError(f"the return delay is from 0 to {delay.high * DELAY_UNIT * 1e6:g} microseconds")
        self.table.put("id", id)
        self.table.put("return_delay_time", round(return_delay / DELAY_UNIT))

    @property
    def protocol(self) -> int:
        """1 or 2."""
        return 1 if self.table["protocol_type"] == 1 else 2

    @property
    def awake(self) -> bool:
        """Whether the servo is not rebooting."""
        return self._time >= self._awake_at

    @property
    def return_delay(self) -> float:
        """The delay of answers, in seconds."""
        return self.table["return_delay_time"] * DELAY_UNIT

    @property
    def secondary(self) -> int | None:
        """The secondary id, which is never answered."""
        number = self.table["secondary_id"]
        return number if number < NO_SECONDARY else None

    def answers(self, level: int) -> bool:
        """Whether the servo answers an instruction that needs this status return level."""
        return self.table["status_return_level"] >= level

    def calibrate(self, drive_mode: int, homing_offset: int, lowest: int, highest: int) -> None:
        """Sets the registers that a calibration sets; the shaft is in the middle of its range, in counts."""
        for name, value in (
            ("drive_mode", drive_mode),
            ("homing_offset", homing_offset),
            ("min_position_limit", lowest),
            ("max_position_limit", highest),
        ):
            self.table.put(name, value)
        self.motion.put_in((lowest + highest) / 2.0)

    @property
    def alert(self) -> int:
        """Error bits of answers while an error is present; specific in protocol 1.0."""
        errors = self.table["hardware_error_status"]
        return (ALERT if errors else 0) if self.protocol == 2 else errors & ERRORS_1

    # ---- time ---------------------------------------------------------------------------------------

    def advance(self, now: float) -> None:
        """Advances to `now`, in whole control periods."""
        while now - self._time >= PERIOD:
            dt = min(now - self._time, IDLE_PERIOD if self.motion.resting else PERIOD)
            self._time += dt
            self.motion.step(dt)
            self.watch_bus()
            self.protect(dt)
            self._stale = True

    def on_packet(self, now: float) -> None:
        """Feeds the watchdog with a packet on the bus, for any servo."""
        self._last_packet_at = now

    def watch_bus(self) -> None:
        """Stops the servo after the time of Bus Watchdog without packets."""
        limit = self.table["bus_watchdog"]
        if not 0 < limit < WATCHDOG_EXPIRED or not self.table["torque_enable"]:
            return
        if self._time - self._last_packet_at > limit * WATCHDOG_UNIT:
            self.table.put("bus_watchdog", WATCHDOG_EXPIRED)
            self.motion.stop()

    def protect(self, dt: float) -> None:
        """Updates errors, and shuts down for those in Shutdown."""
        errors, table = self.errors(dt), self.table
        if errors:
            table.put("hardware_error_status", table["hardware_error_status"] | errors)
            if errors & table["shutdown"]:
                self._is_shut_down = True
                table.put("torque_enable", 0)

    def errors(self, dt: float) -> int:
        """Present errors, as bits of the hardware error status."""
        table, motor = self.table, self.motion.motor
        is_overloaded = abs(motor.current) > OVERLOAD_SHARE * motor.strength.stall_current
        self._overload_time = self._overload_time + dt if is_overloaded else 0.0
        is_voltage_wrong = (
            not table["min_voltage_limit"] <= motor.voltage * 10.0 <= table["max_voltage_limit"]
        )
        self._voltage_error_time = self._voltage_error_time + dt if is_voltage_wrong else 0.0
        errors = OVERLOAD if self._overload_time > OVERLOAD_TIME else 0
        errors |= VOLTAGE_ERROR if self._voltage_error_time > VOLTAGE_TIME else 0
        errors |= OVERHEATING if motor.temperature > table["temperature_limit"] else 0
        return errors | (ENCODER_ERROR if self.encoder_fault else 0)

    def facts(self) -> Facts:
        """The log entries of the servo; `goals` are those of position, velocity and current, in counts."""
        goals = ("goal_position", "goal_velocity", "goal_current")
        return {
            "torque": bool(self.table["torque_enable"]),
            "goals": ",".join(str(self.table[name]) for name in goals if name in self.table),
            "moving": abs(self.motion.motor.speed) > STILL,
            "watchdog_bit": "bus_watchdog" in self.table and self.table["bus_watchdog"] == WATCHDOG_EXPIRED,
        }

    # ---- instructions -------------------------------------------------------------------------------

    def ping(self) -> bytes:
        """Model number and firmware version."""
        return self.model.number.to_bytes(2, "little") + bytes([self.table["firmware_version"]])

    def read(self, address: int, length: int) -> bytes:
        """Registers with present values. Raises InstructionRefused."""
        if self._stale:
            self.motion.publish(self._time - self._powered_up_at)
            self._stale = False
        return self.table.read(address, length)

    def write(self, address: int, data: bytes, *, secondary: bool = False) -> None:
        """Sets all registers of the bytes, or none. Raises InstructionRefused."""
        self._apply(self._allowed(address, data, secondary))

    def register(self, address: int, data: bytes, *, secondary: bool = False) -> None:
        """Stores a write for `act`. Raises InstructionRefused."""
        self._registered = self._allowed(address, data, secondary)
        self.table.put("registered_instruction", 1)

    def act(self) -> None:
        """Executes the registered write. Raises InstructionRefused."""
        if not self.table["registered_instruction"]:
            raise InstructionRefused(RefusalCode.RESULT_FAIL)
        self.table.put("registered_instruction", 0)
        self._apply(self._registered)

    def reboot(self) -> None:
        """Restarts: the RAM area with initial values, errors cleared (persisting ones return)."""
        self.table.reset(eeprom=False)
        self._is_shut_down = False
        self.restart()
        if self.table["startup_configuration"] & STARTUP_TORQUE:
            self.table.put("torque_enable", 1)

    def restart(self) -> None:
        """Powers up: no registered write, new goals, silent while the servo boots."""
        self._registered = []
        self._overload_time = self._voltage_error_time = 0.0
        self._awake_at = self._time + BOOT
        self.motion.single_turn()
        self.motion.reset_goals()
        self._stale = True

    def factory_reset(self, option: int) -> None:
        """Resets the registers; `option` selects those that are kept. Raises InstructionRefused."""
        if option not in PRESERVED_BY_OPTION:
            raise InstructionRefused(RefusalCode.RANGE)
        self.table.reset(PRESERVED_BY_OPTION[option])
        self.reboot()

    def clear(self, parameters: bytes) -> None:
        """Clears the turns. Raises InstructionRefused for other parameters, or while the servo moves."""
        if parameters != CLEAR_TURNS:
            raise InstructionRefused(RefusalCode.RANGE)
        if self.motion.moving:
            raise InstructionRefused(RefusalCode.RESULT_FAIL)
        self.motion.single_turn()
        self.motion.hold()
        self._stale = True

    # ---- writing ------------------------------------------------------------------------------------

    def _allowed(self, address: int, data: bytes, secondary: bool) -> list[tuple[Register, int]]:
        changes = self.table.changes(address, data)
        for item, value in changes:
            self.check(item, value, secondary)
        return changes

    def check(self, item: Register, value: int, secondary: bool) -> None:
        """Raises InstructionRefused: a register is read-only, or the value is invalid."""
        if not item.writable or (item.eeprom and (secondary or self.table["torque_enable"])):
            raise InstructionRefused(RefusalCode.ACCESS)
        if not item.low <= value <= item.high or (item.choices and value not in item.choices):
            raise InstructionRefused(RefusalCode.RANGE)
        is_expired = self.table["bus_watchdog"] == WATCHDOG_EXPIRED
        if is_expired and (item.name in GOALS or (item.name == "bus_watchdog" and value)):
            raise InstructionRefused(RefusalCode.RANGE)
        if item.limit and abs(value) > self.table[item.limit]:
            raise InstructionRefused(RefusalCode.LIMIT)
        if item.name == "goal_position" and not self.allows_goal(value):
            raise InstructionRefused(RefusalCode.LIMIT)

    def allows_goal(self, place: int) -> bool:
        """Whether a goal is allowed; the limits are those of position mode."""
        limits = self.table["min_position_limit"], self.table["max_position_limit"]
        return self.table["operating_mode"] != POSITION or limits[0] <= place <= limits[1]

    def _apply(self, changes: list[tuple[Register, int]]) -> None:
        for item, value in changes:
            before = self.table[item.name]
            self.table.put(item.name, value)
            self.follow_up(item.name, before, value)
        self.motion.resting = False
        self._stale = True

    def follow_up(self, name: str, before: int, value: int) -> None:
        """Applies the effects of a register's new value."""
        if name == "torque_enable" and self._is_shut_down:
            self.table.put("torque_enable", 0)
        elif name == "torque_enable" and value and not before:
            self.motion.hold()
        elif name == "operating_mode":
            self._new_mode(value)
        elif name in ("drive_mode", "homing_offset"):
            self.motion.hold()
        elif name in GOALS:
            self._new_goal(name, value)

    def _new_mode(self, mode: int) -> None:
        if mode == POSITION:
            self.motion.single_turn()
        self.motion.reset_goals()

    def _new_goal(self, name: str, value: int) -> None:
        by_goal = self.table["drive_mode"] & TORQUE_BY_GOAL and not self._is_shut_down
        if by_goal and not self.table["torque_enable"]:
            self.motion.hold()
            self.table.put("torque_enable", 1)
            self.table.put(name, value)
        if name == "goal_position":
            self.motion.approach()
        elif name == "goal_velocity":
            self.motion.accelerate()
