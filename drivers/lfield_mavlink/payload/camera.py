"""Camera protocol v2: https://mavlink.io/en/services/camera.html.

A camera is a component 100 to 105 with heartbeats of its own; `camera` of the binding selects one of several.
If none has ever sent heartbeats, commands go to the autopilot, which may trigger a camera without MAVLink.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from functools import partial
from typing import Any

from msgspec import Struct
from msgspec.structs import replace

from lfield.driver import DeviceError
from lfield_mavlink.contact.components import CAMERAS
from lfield_mavlink.contact.contact import STATE_TIMEOUT, Contact
from lfield_mavlink.geodesy import Place
from lfield_mavlink.link.dialect import AUTOPILOT, dialect, result_text
from lfield_mavlink.payload.state_reports import CAPTURE, IMAGE, SETTINGS, StateReports

#: Modes of a camera (CAMERA_MODE).
PICTURES, VIDEO = dialect.CAMERA_MODE_IMAGE, dialect.CAMERA_MODE_VIDEO
#: Seconds from the command to the picture at most, and after which its report is requested again.
PICTURE_TIMEOUT, REPORT_INTERVAL = 10.0, 1.0
#: Seconds between two requests for the status of the camera.
POLL = 5.0
#: MiB below which its card counts as full; numbers of single pictures are below this.
FULL, SEQUENCES = 10.0, 1_000_000

#: Pictures of a series at most.
LONGEST_SERIES = 0xFFFF


class CameraOrder(Struct, frozen=True):
    """A command to a camera: its name in L, MAV_CMD and parameters, and the mode that it requires.

    `is_confirmed` returns whether a CAMERA_CAPTURE_STATUS shows that it was executed.
    """

    instruction: str
    number: int
    values: tuple[float, ...] = (0.0,)
    mode: int | None = None
    is_confirmed: Callable[[Any], bool] = lambda _: False


TRIGGER = CameraOrder("triggerCamera", dialect.MAV_CMD_IMAGE_START_CAPTURE, mode=PICTURES)
START_PICTURES = replace(TRIGGER, instruction="startPictures", is_confirmed=lambda now: now.image_status > 1)
STOP_PICTURES = CameraOrder(
    "stopPictures", dialect.MAV_CMD_IMAGE_STOP_CAPTURE, is_confirmed=lambda now: now.image_status <= 1
)
START_VIDEO = CameraOrder(
    "startVideo",
    dialect.MAV_CMD_VIDEO_START_CAPTURE,
    (0.0, 0.0),
    VIDEO,
    lambda now: now.video_status == 1,
)
STOP_VIDEO = CameraOrder(
    "stopVideo", dialect.MAV_CMD_VIDEO_STOP_CAPTURE, is_confirmed=lambda now: now.video_status == 0
)


class Camera:
    """Instructions of the camera, and its telemetry."""

    def __init__(self, vehicle: Contact, reports: StateReports) -> None:
        self._vehicle, self._reports = vehicle, reports
        # Differs from the numbers before a restart of this program: a repeated number is a repeated command.
        self._sequence = int(vehicle.clock.monotonic()) % SEQUENCES
        vehicle.on(CAPTURE, self._on_status)
        vehicle.on(IMAGE, self._on_picture)

    async def run(self) -> None:
        """Requests the status of a camera component until cancelled."""
        await self._vehicle.components.appeared.wait()
        while True:
            await asyncio.sleep(POLL)
            camera = self._component
            present = self._vehicle.components.present(CAMERAS)
            if camera not in present or self._vehicle.is_quiet or self._vehicle.lost:
                continue
            try:
                await self._reports.request(CAPTURE, camera)
            except DeviceError:
                # The identity of the vehicle is uncertain; the next request follows.
                continue

    # -- instructions ---------------------------------------------------------------------------------

    async def do_trigger_camera(self) -> None:
        """Takes one picture; waits until the camera has stored it."""
        instruction = TRIGGER.instruction
        camera = self._present_camera(instruction)
        if camera == AUTOPILOT:
            await self._trigger()
            return
        first = (await self._status(instruction, camera)).image_count
        self._sequence = self._sequence % SEQUENCES + 1
        await self._order(camera, replace(TRIGGER, values=(0.0, 0.0, 1.0, float(self._sequence))))
        end = self._vehicle.clock.monotonic() + PICTURE_TIMEOUT
        while (report := self._report(camera, first)) is None:
            if self._vehicle.clock.monotonic() >= end:
                raise self._vehicle.error(
                    f"{instruction} was accepted but no picture came within {PICTURE_TIMEOUT:g} s"
                )
            self._vehicle.check_link()
            if not await self._vehicle.wait_for(lambda: bool(self._report(camera, first)), REPORT_INTERVAL):
                # The report of the picture was lost, or the picture was not taken yet: then this request is
                # refused.
                await self._reports.request(IMAGE, camera, float(first))
        if report.capture_result != 1:
            raise self._vehicle.error(f"{instruction} failed: the camera stored no picture")

    async def do_start_pictures(self, interval: float, count: int) -> None:
        """Starts a series: a picture each `interval` seconds, `count` times, 0 until stopPictures."""
        if not (0.0 < interval < math.inf and 0 <= count <= LONGEST_SERIES):
            raise self._vehicle.error(
                f"startPictures requires an interval above 0 and a count from 0 to {LONGEST_SERIES}"
            )
        await self._switch(replace(START_PICTURES, values=(0.0, interval, float(count), 0.0)))

    async def do_stop_pictures(self) -> None:
        """Ends a series."""
        await self._switch(STOP_PICTURES)

    async def do_start_video(self) -> None:
        """Starts to record."""
        await self._switch(START_VIDEO)

    async def do_stop_video(self) -> None:
        """Ends recording."""
        await self._switch(STOP_VIDEO)

    # -- telemetry ------------------------------------------------------------------------------------

    def _on_status(self, message: Any) -> None:
        if message.get_srcComponent() != self._component:
            return
        recording = message.video_status == 1
        values: dict[str, Any] = {"pictures": max(message.image_count, 0), "recording": recording}
        if math.isfinite(message.available_capacity):
            values["storage"] = message.available_capacity
        self._vehicle.publish(**values)

    def _on_picture(self, message: Any) -> None:
        place = Place.scaled(message.lat, message.lon, message.alt)
        if message.get_srcComponent() == self._component and message.capture_result == 1 and place:
            self._vehicle.publish(lastPicture=[place.latitude, place.longitude, place.altitude])

    def _report(self, camera: int, index: int) -> Any | None:
        """The report of a picture."""
        message = self._reports.recent(IMAGE, camera, PICTURE_TIMEOUT)
        return message if message is not None and message.image_index >= index else None

    # -- commands -------------------------------------------------------------------------------------

    @property
    def _component(self) -> int:
        """The camera that is used: that of the binding, the lowest with heartbeats, or the autopilot.

        A camera whose heartbeats are gone is not replaced: pictures would be missing without an error.
        """
        chosen: int = self._vehicle.binding.option("camera")
        return chosen or next(iter(self._vehicle.components.known(CAMERAS)), AUTOPILOT)

    def _present_camera(self, instruction: str) -> int:
        """The component of the camera. Raises DeviceError when it is absent."""
        camera, present = self._component, self._vehicle.components.present(CAMERAS)
        if camera != AUTOPILOT and camera not in present:
            others = ", ".join(map(str, present)) or "none"
            is_selected = self._vehicle.binding.option("camera")
            advice = "is 'camera' in its binding right?" if is_selected else "is it switched on?"
            raise self._vehicle.error(
                f"{instruction} refused: no heartbeat of camera {camera} of system {self._vehicle.system}; "
                f"cameras with heartbeats: {others}; {advice}"
            )
        return camera

    async def _trigger(self) -> None:
        """Takes one picture by the autopilot, which reports no result."""
        capture, legacy = dialect.MAV_CMD_IMAGE_START_CAPTURE, dialect.MAV_CMD_DO_DIGICAM_CONTROL
        camera = partial(self._vehicle.command, "triggerCamera", once=True, component="camera")
        if not await camera(capture, 0.0, 0.0, 1.0, optional=True):
            await camera(legacy, 0.0, 0.0, 0.0, 0.0, 1.0)

    async def _switch(self, order: CameraOrder) -> None:
        """Starts or stops a series or a video; waits until the status of the camera shows it."""
        camera = self._present_camera(order.instruction)
        previous_count = (
            math.inf if camera == AUTOPILOT else (await self._status(order.instruction, camera)).image_count
        )
        await self._order(camera, order)

        def is_executed(status: Any) -> bool:
            # A short series may be complete before its status arrives.
            return order.is_confirmed(status) or (
                order.mode == PICTURES and status.image_count > previous_count
            )

        await self._reports.confirm(order.instruction, CAPTURE, is_executed, component=camera)

    async def _status(self, instruction: str, camera: int) -> Any:
        """CAMERA_CAPTURE_STATUS. Raises DeviceError."""
        end = self._vehicle.clock.monotonic() + STATE_TIMEOUT
        while self._vehicle.clock.monotonic() < end:
            self._vehicle.check_link()
            if (status := await self._reports.request(CAPTURE, camera)) is not None:
                return status
            await asyncio.sleep(0.1)
        raise self._vehicle.error(f"{instruction}: camera {camera} does not report its status", timeout=True)

    async def _order(self, camera: int, order: CameraOrder) -> None:
        """Sends a command until it is accepted; changes the mode of the camera once if it is the obstacle.

        A repeated command may be refused since its first copy was executed: then the status decides.
        """
        vehicle, instruction = self._vehicle, order.instruction
        for attempt in range(2):
            answer = await vehicle.exchange.command(order.number, *order.values, target=camera)
            if answer.result == dialect.MAV_RESULT_ACCEPTED:
                return
            if answer.result is None:
                raise vehicle.error(f"{instruction}: {self._name(camera)} did not answer", timeout=True)
            if (
                answer.attempts > 1
                and camera != AUTOPILOT
                and order.is_confirmed(await self._status(instruction, camera))
            ):
                return
            obstacle = await self._obstacle(camera, order.mode)
            if obstacle or attempt or not await self._has_changed_mode(camera, order.mode):
                raise vehicle.error(f"{instruction} refused: {result_text(answer.result)}{obstacle}")

    def _name(self, camera: int) -> str:
        return "the autopilot, which may have no camera," if camera == AUTOPILOT else f"camera {camera}"

    async def _obstacle(self, camera: int, mode: int | None) -> str:
        """The reported state of the camera that explains a refusal, '' for none."""
        if camera == AUTOPILOT:
            return f"; no camera (components 100 to 105 of system {self._vehicle.system}) sends heartbeats"
        status = await self._reports.request(CAPTURE, camera)
        if status is None or mode is None:
            return ""
        if status.video_status == 1:
            return ": it records a video; stopVideo() ends that"
        if status.image_status:
            return ": it takes pictures; stopPictures() ends that"
        if status.available_capacity < FULL:
            return f": its card is full, {status.available_capacity:.1f} MiB are left"
        return ""

    async def _has_changed_mode(self, camera: int, mode: int | None) -> bool:
        """Whether the camera was in another mode, and is now in this one."""
        settings = None if mode is None else await self._reports.request(SETTINGS, camera)
        if settings is None or settings.mode_id == mode:
            return False
        number = dialect.MAV_CMD_SET_CAMERA_MODE
        answer = await self._vehicle.exchange.command(number, 0.0, float(mode or 0), target=camera)
        return bool(answer.result == dialect.MAV_RESULT_ACCEPTED)
