"""Reads one device of a devices file: what its field is bound to, held against the manifest of its driver."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from lfield.driver.binding import LEAST_AFTER, DeviceBinding, OptionValue, WithoutPolicy
from lfield.driver.contract import Manifest, Option
from lfield.driver.frame import Placement
from lfield.driver.known import Drivers, KnownDriver
from lfield.driver.plugin import conflicts_of, mistakes_in, why_no_endpoint
from lfield.errors import DeviceError
from lfield.text.source import Span
from lfield.text.visible import as_text
from lfield.text.yaml_fields import Fields
from lfield.text.yaml_source import Entry, Scalar


class DevicesReader:
    """The devices of agents. Files are seen from `folder`."""

    def __init__(self, drivers: Drivers, folder: Path, *, simulate: bool) -> None:
        self._drivers, self._folder, self._simulate = drivers, folder, simulate
        # What was read, each with its fields and where its name stands.
        self._read: list[tuple[DeviceBinding, Fields, Span]] = []
        #: The files that options name, whose mistakes are told once.
        self._files: set[tuple[str, str, str]] = set()

    def devices(
        self, agent: str, fields: Fields, needed: Mapping[str, str], placement: Placement | None
    ) -> dict[str, DeviceBinding]:
        """Those of one agent, which has its `placement`; `needed` are its fields with their types."""
        bound = {}
        for entry, device in fields.section("devices").entries():
            binding = self._device(agent, entry, device, needed, placement)
            if binding is not None:
                bound[entry.key] = binding
                self._read.append((binding, device, entry.key_span))
        return bound

    def report_conflicts(self) -> None:
        """Report the devices that cannot be beside the others. Each fake has a link of its own."""
        for driver in self._drivers.by_driver.values() if not self._simulate else ():
            mine = [binding for binding, _, _ in self._read if binding.driver == driver.name]
            for binding, why in conflicts_of(driver, mine):
                fields, span = next((f, span) for read, f, span in self._read if read is binding)
                fields.report("Y113", f"{binding.name}: {why}", span)

    def _device(
        self,
        agent: str,
        entry: Entry,
        fields: Fields,
        needed: Mapping[str, str],
        placement: Placement | None,
    ) -> DeviceBinding | None:
        """One device; None when it cannot be told what it is."""
        if entry.key not in needed:
            hint = f"its devices: {', '.join(sorted(needed)) or 'none'}"
            fields.report("Y113", f"{agent} has no device '{entry.key}'", entry.key_span, hint)
            return None
        name = fields.text("driver", required=True)
        driver = self._drivers.by_driver.get(name)
        if driver is None:
            if name:
                hint = f"installed: {', '.join(sorted(self._drivers.by_driver)) or 'none'}"
                fields.report("Y113", f"there is no driver '{name}'", fields.value_span("driver"), hint)
            return None
        manifest = driver.manifests.get(needed[entry.key])
        if manifest is None:
            makes = " or ".join(sorted(driver.manifests))
            message = f"driver '{name}' makes a {makes}, and {entry.key} is a {needed[entry.key]}"
            fields.report("Y113", message, fields.value_span("driver"))
            return None
        fields.text("type", choices=(manifest.device.type,))
        reasons = self._waivers(fields, manifest)
        binding = DeviceBinding(
            agent=agent,
            field=entry.key,
            type=manifest.device.type,
            driver=name,
            endpoint=self._endpoint(fields, driver),
            ttl=fields.number("ttl", 0.5, minimum=0.02, maximum=60.0),
            rest_within=fields.number("rest_within", 120.0, minimum=1.0, maximum=3600.0),
            safe_state=_safe_state(fields, manifest),
            without_policy=_without_policy(fields, manifest),
            limits=self._device_limits(fields, manifest),
            options=self._options(fields, manifest, driver),
            waivers=list(reasons),
            reasons={waiver: reason for waiver, reason in reasons.items() if reason},
            frame=placement,
            sim=list(fields.texts("sim")),
        )
        fields.done()
        return binding

    def _endpoint(self, fields: Fields, driver: KnownDriver) -> str:
        """Where it is, in the words of its driver; on fakes nobody asks."""
        text = fields.text("endpoint", required=not self._simulate)
        node = fields.node("endpoint")
        is_text = isinstance(node, Scalar) and node.value == text
        if node is not None and is_text and not self._simulate and (why := why_no_endpoint(driver, text)):
            fields.report("Y113", why, node.span)
        return text

    def _waivers(self, fields: Fields, manifest: Manifest) -> dict[str, str]:
        """The waivers, each with its reason, '' where none is given and none is needed."""
        known = [name for name, _ in manifest.waivers]
        waivers = fields.reasoned("waivers")
        for waiver, reason in waivers.items():
            if waiver not in known:
                hint = f"waivers of a {manifest.device.type}: {', '.join(known)}"
                message = f"there is nothing called '{waiver}' to waive"
                fields.report("Y113", message, fields.value_span("waivers"), hint)
            elif waiver in manifest.reasoned and not reason.strip():
                hint = f"write 'waivers: {{{waiver}: REASON}}': {dict(manifest.waivers)[waiver]}"
                message = f"'{waiver}' is waived without a reason"
                fields.report("Y110", message, fields.value_span("waivers"), hint)
        return waivers

    def _device_limits(self, fields: Fields, manifest: Manifest) -> dict[str, float]:
        section = fields.section("limits")
        limits = {
            limit.name: section.number(limit.name, minimum=0.0)
            for limit in manifest.limits
            if limit.name in section
        }
        section.done()
        return limits

    def _options(self, fields: Fields, manifest: Manifest, driver: KnownDriver) -> dict[str, OptionValue]:
        options: dict[str, OptionValue] = {}
        for option in manifest.options:
            value = self._option(fields, option, driver)
            if value is not None:
                options[option.name] = value
        return options

    def _path(self, fields: Fields, key: str, driver: KnownDriver) -> str:
        """A file as seen from the folder of the devices file, which is read as its driver will read it."""
        text = fields.text(key)
        path = self._folder / text
        if text and not path.is_file():
            fields.report("Y113", f"there is no file {path}", fields.value_span(key))
        whole = str(path.resolve())
        if text and whole != as_text(whole):
            told = f"the file is at {as_text(whole)}, which is no UTF-8 and cannot travel with a binding"
            fields.report("Y113", told, fields.value_span(key), "rename the folder or the file")
        if text and path.is_file() and (driver.name, key, whole) not in self._files:
            self._files.add((driver.name, key, whole))
            try:
                fields.add(mistakes_in(driver, key, str(path)))
            except DeviceError as error:
                fields.report("Y113", error.reason, fields.value_span(key))
        return whole if text else ""

    def _option(self, fields: Fields, option: Option, driver: KnownDriver) -> OptionValue | None:
        required = option.default is None
        if option.name not in fields:
            fields.node(option.name, required=required)
            return option.default
        if option.type == "boolean":
            return fields.flag(option.name)
        if option.type == "string":
            return fields.text(option.name, choices=option.choices)
        if option.type == "path":
            return self._path(fields, option.name, driver)
        if option.type == "int[]":
            return list(fields.integers(option.name))
        if option.type == "string[]":
            return list(fields.texts(option.name))
        if option.type == "real":
            return fields.number(option.name, minimum=option.minimum, maximum=option.maximum)
        lowest, highest = max(option.minimum, -(2.0**63)), min(option.maximum, 2.0**62)
        return fields.integer(option.name, minimum=int(lowest), maximum=int(highest))


def _without_policy(fields: Fields, manifest: Manifest) -> WithoutPolicy | None:
    """None where the key is absent; both of its keys must be given."""
    if "without_policy" not in fields:
        return None
    states = manifest.device.safe_states
    if not states:
        message = f"a {manifest.device.type} only senses: nobody has to bring it into a safe state"
        fields.report("Y113", message, fields.value_span("without_policy"), "leave the key out")
        fields.node("without_policy")
        return None
    section = fields.section("without_policy")
    after = section.number("after", 30.0, required=True, minimum=LEAST_AFTER, maximum=86400.0)
    do = section.text("do", required=True, choices=states)
    section.done()
    return WithoutPolicy(after, do)


def _safe_state(fields: Fields, manifest: Manifest) -> str:
    """One of those of the manifest; '' for a pure sensor, which has none."""
    states = manifest.device.safe_states
    if states:
        return fields.text("safe_state", states[0], choices=states)
    if "safe_state" in fields:
        message = f"a {manifest.device.type} only senses: it has no safe state"
        fields.report("Y113", message, fields.value_span("safe_state"), "leave the key out")
        fields.text("safe_state")
    return ""
