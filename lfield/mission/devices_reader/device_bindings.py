"""Reads one device of a devices file: its binding, checked against the manifest of its driver."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from lfield.driver.binding import MIN_ORPHAN_TIMEOUT, DeviceBinding, OptionValue, OrphanPolicy
from lfield.driver.contract import Manifest, Option
from lfield.driver.driver_index import DriverInfo, DriverLookup
from lfield.driver.frame import Placement
from lfield.driver.plugin import conflicts_of, mistakes_in, why_no_endpoint
from lfield.errors import DeviceError
from lfield.text.source_text import Span
from lfield.text.terminal_escape import printable_argument
from lfield.text.yaml_fields import YamlFields
from lfield.text.yaml_source import YamlEntry, YamlScalar


class DeviceBindingsReader:
    """The devices of agents. Paths of files are relative to `folder`."""

    def __init__(
        self,
        drivers: DriverLookup,
        folder: Path,
        *,
        simulate: bool,
        resources: Mapping[str, str] | None = None,
    ) -> None:
        #: The types of the agents: some options follow from them.
        self._resources = resources or {}
        self._drivers, self._folder, self._simulate = drivers, folder, simulate
        # The devices read so far, each with its fields and the position of its name.
        self._read: list[tuple[DeviceBinding, YamlFields, Span]] = []
        #: The files of options, whose errors are reported once.
        self._files: set[tuple[str, str, str]] = set()

    def devices(
        self, agent: str, fields: YamlFields, needed: Mapping[str, str], placement: Placement | None
    ) -> dict[str, DeviceBinding]:
        """The devices of one agent, which has its `placement`; `needed` are its fields with their types."""
        bound = {}
        for entry, device in fields.section("devices").entries():
            binding = self._device(agent, entry, device, needed, placement)
            if binding is not None:
                bound[entry.key] = binding
                self._read.append((binding, device, entry.key_span))
        return bound

    def report_conflicts(self) -> None:
        """Report devices that conflict with others. Each simulated device has its own link."""
        for driver in self._drivers.by_driver.values() if not self._simulate else ():
            bindings = [binding for binding, _, _ in self._read if binding.driver == driver.name]
            for binding, reason in conflicts_of(driver, bindings):
                fields, span = next((f, span) for read, f, span in self._read if read is binding)
                fields.report("Y113", f"{binding.name}: {reason}", span)

    def _device(
        self,
        agent: str,
        entry: YamlEntry,
        fields: YamlFields,
        needed: Mapping[str, str],
        placement: Placement | None,
    ) -> DeviceBinding | None:
        """One device; None when its type is unknown."""
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
            message = f"driver '{name}' provides a {makes}, but {entry.key} is a {needed[entry.key]}"
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
            options=self._options(agent, fields, manifest, driver),
            waivers=list(reasons),
            reasons={waiver: reason for waiver, reason in reasons.items() if reason},
            frame=placement,
            sim=list(fields.texts("sim")),
        )
        fields.report_unread()
        return binding

    def _endpoint(self, fields: YamlFields, driver: DriverInfo) -> str:
        """The endpoint, in the syntax of its driver; not checked when simulated."""
        text = fields.text("endpoint", required=not self._simulate)
        node = fields.node("endpoint")
        is_text = isinstance(node, YamlScalar) and node.value == text
        if node is not None and is_text and not self._simulate and (reason := why_no_endpoint(driver, text)):
            fields.report("Y113", reason, node.span)
        return text

    def _waivers(self, fields: YamlFields, manifest: Manifest) -> dict[str, str]:
        """The waivers, each with its reason; '' if none is given and none is required."""
        known = [name for name, _ in manifest.waivers]
        waivers = fields.names_with_reasons("waivers")
        for waiver, reason in waivers.items():
            if waiver not in known:
                hint = f"waivers of a {manifest.device.type}: {', '.join(known)}"
                message = f"unknown waiver '{waiver}'"
                fields.report("Y113", message, fields.value_span("waivers"), hint)
            elif waiver in manifest.reasoned and not reason.strip():
                hint = f"write 'waivers: {{{waiver}: REASON}}': {dict(manifest.waivers)[waiver]}"
                message = f"'{waiver}' is waived without a reason"
                fields.report("Y110", message, fields.value_span("waivers"), hint)
        return waivers

    def _device_limits(self, fields: YamlFields, manifest: Manifest) -> dict[str, float]:
        section = fields.section("limits")
        values = {limit.name: section.number(limit.name, minimum=0.0) for limit in manifest.limits}
        section.report_unread()
        return {name: value for name, value in values.items() if name in section}

    def _options(
        self, agent: str, fields: YamlFields, manifest: Manifest, driver: DriverInfo
    ) -> dict[str, OptionValue]:
        options: dict[str, OptionValue] = {}
        resource = self._resources.get(agent, "")
        required = manifest.resource_options(resource)
        suggested = manifest.named_options(resource, agent)
        for option in manifest.options:
            value = self._option(fields, option, driver)
            expected = required.get(option.name, value)
            if option.name not in fields:
                value = suggested.get(option.name, value)
            elif value != expected:
                hint = f"write '{option.name}: {expected}', or leave the key out, or rename the resource"
                message = f"'{option.name}: {value}' contradicts the resource type {resource}"
                fields.report("Y113", message, fields.value_span(option.name), hint)
            if value is not None:
                options[option.name] = value
        return options

    def _path(self, fields: YamlFields, key: str, driver: DriverInfo) -> str:
        """A file relative to the folder of the devices file, read as its driver will read it."""
        text = fields.text(key)
        path = self._folder / text
        if text and not path.is_file():
            fields.report("Y113", f"there is no file {path}", fields.value_span(key))
        absolute = str(path.resolve())
        if text and absolute != printable_argument(absolute):
            message = (
                f"the file is at {printable_argument(absolute)}, which is not valid UTF-8 and cannot be part "
                "of a binding"
            )
            fields.report("Y113", message, fields.value_span(key), "rename the folder or the file")
        if text and path.is_file() and (driver.name, key, absolute) not in self._files:
            self._files.add((driver.name, key, absolute))
            try:
                fields.add(mistakes_in(driver, key, str(path)))
            except DeviceError as error:
                fields.report("Y113", error.reason, fields.value_span(key))
        return absolute if text else ""

    def _option(self, fields: YamlFields, option: Option, driver: DriverInfo) -> OptionValue | None:
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
        if option.type == "real[]":
            return list(fields.numbers(option.name))
        if option.type == "string[]":
            return list(fields.texts(option.name))
        if option.type == "real":
            return fields.number(option.name, minimum=option.minimum, maximum=option.maximum)
        lowest, highest = max(option.minimum, -(2.0**63)), min(option.maximum, 2.0**62)
        return fields.integer(option.name, minimum=int(lowest), maximum=int(highest))


def _without_policy(fields: YamlFields, manifest: Manifest) -> OrphanPolicy | None:
    """The policy without a coordinator, None without the key; both of its keys are required."""
    if "without_policy" not in fields:
        return None
    states = manifest.device.safe_states
    if not states:
        message = f"a {manifest.device.type} only senses: it has no safe state"
        fields.report("Y113", message, fields.value_span("without_policy"), "leave the key out")
        fields.node("without_policy")
        return None
    section = fields.section("without_policy")
    after = section.number("after", 30.0, required=True, minimum=MIN_ORPHAN_TIMEOUT, maximum=86400.0)
    do = section.text("do", required=True, choices=states)
    section.report_unread()
    return OrphanPolicy(after, do)


def _safe_state(fields: YamlFields, manifest: Manifest) -> str:
    """A safe state of the manifest; '' for a pure sensor, which has none."""
    states = manifest.device.safe_states
    if states:
        return fields.text("safe_state", states[0], choices=states)
    if "safe_state" in fields:
        message = f"a {manifest.device.type} only senses: it has no safe state"
        fields.report("Y113", message, fields.value_span("safe_state"), "leave the key out")
        fields.text("safe_state")
    return ""
