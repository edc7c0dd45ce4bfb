"""A vehicle built from MAVSDK's server plugins, on a UDP port of the loopback interface.

MAVSDK implements commands, parameters, missions, files, telemetry, heartbeats. Its HEARTBEAT has
MAV_TYPE 0 and MAV_AUTOPILOT 0 (generic); version 4.1 cannot change them from Python, and a driver for
ArduPilot and PX4 must not accept a generic autopilot. The modes and parameters are those of PX4, so the
endpoint writes "quadrotor, PX4" into every HEARTBEAT and changes nothing else.
"""

from __future__ import annotations

import asyncio
from typing import Any

from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.action_server import ActionServerAsync
from mavsdk.asyncio.plugins.ftp_server import FtpServerAsync
from mavsdk.asyncio.plugins.mission_raw_server import MissionRawServerAsync
from mavsdk.asyncio.plugins.param_server import ParamServerAsync
from mavsdk.asyncio.plugins.telemetry_server import TelemetryServerAsync
from mavsdk.plugins.action_server import AllowableFlightModes, FlightMode
from mavsdk.plugins.telemetry_server import (
    AngularVelocityBody,
    Battery,
    EulerAngle,
    FixedwingMetrics,
    FixType,
    GpsInfo,
    Heading,
    LandedState,
    Position,
    PositionNed,
    PositionVelocityNed,
    RawGps,
    VelocityNed,
    VtolState,
)
from pymavlink.dialects.v20 import all as dialect

QUADROTOR, PX4 = 2, 12
#: Seconds between two rounds of telemetry.
PERIOD = 0.1
LATITUDE, LONGITUDE, ALTITUDE = 47.3977420, 8.5455940, 488.0
NORTH, EAST = 3.0, -4.0


class StandIn:
    """The vehicle: `async with StandIn() as vehicle`; it is at `vehicle.endpoint`.

    `files` is the folder that it serves; `label`: whether its HEARTBEAT names PX4. It stands at `NORTH` and
    `EAST`, at a `height` that the test sets, until it lands; `missions` are the received missions.
    """

    def __init__(self, files: str = "", *, label: bool = True) -> None:
        self._files, self._label = files, label
        self._tasks: list[asyncio.Task[Any]] = []
        self.height = 0.0
        self.missions: asyncio.Queue[Any] = asyncio.Queue()

    async def __aenter__(self) -> StandIn:
        loop = asyncio.get_running_loop()
        self._mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.AUTOPILOT))
        self._endpoint = _Endpoint(self._mavsdk, loop, label=self._label)
        transport, _ = await loop.create_datagram_endpoint(lambda: self._endpoint, ("127.0.0.1", 0))
        self.endpoint = f"udp:127.0.0.1:{transport.get_extra_info('sockname')[1]}"
        await self._mavsdk.add_any_connection("raw://")
        self._mavsdk._mavsdk.subscribe_raw_bytes_to_be_sent(self._endpoint.send_soon)
        component = await self._mavsdk.server_component()
        self.telemetry = TelemetryServerAsync(component)
        self.action = ActionServerAsync(component)
        self.parameters = ParamServerAsync(component)
        self.mission = MissionRawServerAsync(component)
        self.files = FtpServerAsync(component)
        await self._set_up()
        works = (self._publish(), self._on_mission(), self._land())
        self._tasks = [loop.create_task(work) for work in works]
        return self

    async def __aexit__(self, *_: object) -> None:
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        # A cancelled task leaves its call running on a thread, which must end before MAVSDK is destroyed.
        await asyncio.get_running_loop().shutdown_default_executor()
        self._endpoint.close()
        self._mavsdk.destroy()

    async def _set_up(self) -> None:
        await self.action.set_armable(True, True)
        await self.action.set_disarmable(True, True)
        await self.action.set_allow_takeoff(True)
        await self.action.set_allowable_flight_modes(AllowableFlightModes(*[True] * 7))
        await self.action.set_armed_state(False)
        # Its action server refuses the mode HOLD even if allowed, so HOLD is the initial mode.
        await self.action.set_flight_mode(FlightMode.HOLD)
        if self._files:
            await self.files.set_root_dir(self._files)
        for name, value in (
            ("COM_DL_LOSS_T", 10),
            ("NAV_DLL_ACT", 3),
            ("COM_OBL_RC_ACT", 4),
            ("COM_DLL_EXCEPT", 0),
            ("COM_RC_OVERRIDE", 3),
        ):
            await self.parameters.provide_param_int(name, value)
        for name, number in (("COM_OF_LOSS_T", 1.0), ("COM_FAIL_ACT_T", 0.0), ("MIS_TAKEOFF_ALT", 2.5)):
            await self.parameters.provide_param_float(name, number)

    async def _publish(self) -> None:
        """Publishes position, state and battery."""
        velocity, t = VelocityNed(0.48, 0.36, 0.0), self.telemetry
        while True:
            up = self.height
            place, ned = Position(LATITUDE, LONGITUDE, ALTITUDE + up, up), PositionNed(NORTH, EAST, -up)
            landed = LandedState.IN_AIR if up else LandedState.ON_GROUND
            await t.publish_extended_sys_state(VtolState.UNDEFINED, landed)
            await t.publish_home(Position(LATITUDE, LONGITUDE, ALTITUDE, 0.0))
            await t.publish_position(place, velocity, Heading(90.0))
            await t.publish_position_velocity_ned(PositionVelocityNed(ned, velocity))
            await t.publish_attitude(EulerAngle(0.0, 0.0, 90.0, 0), AngularVelocityBody(0.0, 0.0, 0.1))
            await t.publish_visual_flight_rules_hud(FixedwingMetrics(1.0, 50.0, 0.0, 0.6, 90.0, 493.0))
            await t.publish_raw_gps(
                RawGps(0, LATITUDE, LONGITUDE, ALTITUDE, *[0.5] * 10), GpsInfo(14, FixType.FIX_3D)
            )
            await t.publish_sys_status(Battery(12.5, 0.75), True, True, True, True, True)
            await asyncio.sleep(PERIOD)

    async def _on_mission(self) -> None:
        async for _, plan in self.mission.subscribe_incoming_mission():
            self.missions.put_nowait(plan)

    async def _land(self) -> None:
        """Lands on a change of mode: MAVSDK never answers NAV_LAND itself."""
        async for _, mode in self.action.subscribe_flight_mode_change():
            if mode == FlightMode.LAND:
                self.height = 0.0


class _Endpoint(asyncio.DatagramProtocol):
    """Forwards packets between MAVSDK and the peer that sent last."""

    def __init__(self, mavsdk: Mavsdk, loop: asyncio.AbstractEventLoop, *, label: bool) -> None:
        self._mavsdk, self._loop, self._label = mavsdk, loop, label
        self._peer: Any = None
        self._reader = dialect.MAVLink(None)
        self._reader.robust_parsing = True

    def connection_made(self, transport: Any) -> None:
        self._transport = transport

    def datagram_received(self, data: bytes, addr: Any) -> None:
        self._peer = addr
        self._mavsdk._mavsdk.pass_received_raw_bytes(data)

    def send_soon(self, data: bytes) -> None:
        """Send a packet from a thread of MAVSDK."""
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._send, data)

    def _send(self, data: bytes) -> None:
        if self._peer is None or self._transport.is_closing():
            return
        for message in self._reader.parse_buffer(data) or ():
            self._transport.sendto(self._relabelled(message), self._peer)

    def _relabelled(self, message: Any) -> bytes:
        if message.get_msgId() != dialect.MAVLINK_MSG_ID_HEARTBEAT or not self._label:
            return bytes(message.get_msgbuf())
        message.type, message.autopilot = QUADROTOR, PX4
        packer = dialect.MAVLink(None, message.get_srcSystem(), message.get_srcComponent())
        packer.seq = message.get_seq()
        return bytes(message.pack(packer))

    def close(self) -> None:
        self._transport.close()
