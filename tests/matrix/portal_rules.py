"""Hosts of a mission whose access file states which coordinators may call which portals.

Every coordinator tries every portal in every way, and the resource prints each call that it
executes: the machines are those of hosts, on simulated computers.
"""

from __future__ import annotations

from functools import cached_property
from pathlib import Path

from lfield.mission.loader import load_mission
from lfield.simulate.host_fleet import Fleet, FleetOptions

#: The portals of each resource, and the primitives that offer them.
PORTALS = {
    ("Arm", "arm1"): ("home", "grab"),
    ("Arm", "arm2"): ("home", "grab"),
    ("Winch", "winch"): ("up", "unreel"),
}
OFFERED = {"home": "Homing", "grab": "Grabbing", "up": "Raising", "unreel": "Unreeling"}
#: The ways of calling a portal: access is allowed in all of these, or in none.
PLAIN, TOGETHER, RESERVED, OFFER = HOW = ("plain", "together", "reserved", "offered")
#: Output of a coordinator before it calls an offer, in a reservation, and at its end.
FOUND, KEPT, THROUGH = "found", "kept", "through"
#: Seconds of virtual time for all attempts.
MAX_TIME = 60.0


def _resource(kind: str, portals: tuple[str, ...]) -> str:
    says = "".join(f'portal {p}(string by) {{ print(by + " {p}"); }}\n' for p in portals)
    return f"resource {kind} {{\ninit(string[] arg) {{ }}\n{says}}}\n"


def _tries(kind: str, resource: str, portals: tuple[str, ...]) -> str:
    """Statements that call all portals of a resource, in all ways."""
    calls = {p: f'it.{p}(me + " {TOGETHER}");' for p in portals}
    tries = [f"together {{ {' '.join(calls.values())} }}"]
    for portal in portals:
        tries.append(f'it.{portal}(me + " {PLAIN}");')
        tries.append(f'reserve (it) {{ print("{KEPT} {resource}"); it.{portal}(me + " {RESERVED}"); }}')
        tries.append(
            f"""{OFFERED[portal]}[] some = find{OFFERED[portal]}();
            for (int i = 0; i < some.length(); i = i + 1) {{
                if (some[i].agent() == "{resource}") {{
                    print("{FOUND} {resource}.{portal}");
                    some[i].{portal}(me + " {OFFER}");
                }}
            }}"""
        )
    each = "".join(f"try {{ {one} }} catch (AccessException e) {{ }}\n" for one in tries)
    return f'{{ {kind} it = find{kind}("{resource}");\n{each} }}\n'


def _coordinator(kind: str) -> str:
    """A coordinator that tries the resources in sequence: a reserved resource is not offered to others."""
    body = "".join(_tries(*caller, portals) for caller, portals in PORTALS.items())
    begins = "string me = arg[0];\nsleep(s2f(arg[1]));\n"
    return f'coordinator {kind} {{\ninit(string[] arg) {{\n{begins}{body}print("{THROUGH}");\n}}\n}}\n'


def _primitive(name: str, portal: str) -> str:
    portals = f"{{{portal}: {{parameters: {{by: {{type: string}}}}}}}}"
    return f"  {name}: {{id: skill.{portal}, portals: {portals}}}"


FILES = {
    ".L": "".join(
        [
            *(_resource(kind, portals) for kind, portals in {k: p for (k, _), p in PORTALS.items()}.items()),
            *(_coordinator(kind) for kind in ("Loader", "Watch", "Guest")),
        ]
    ),
    ".dL": """//Arm:arm1@alpha
//Arm:arm2@bravo
//Winch:winch@bravo
//Loader:loader@alpha?1.0
//Watch:day@alpha?3.0
//Watch:night@bravo?5.0
//Guest:guest@bravo?7.0
""",
    ".capabilities.yaml": "\n".join(
        [
            "registry: 1",
            "taxonomy:",
            *(f"  skill.{portal}: {{meaning: what is tried here}}" for portal in OFFERED),
            "primitives:",
            *(_primitive(name, portal) for portal, name in OFFERED.items()),
            "providers:",
            "  Arm: {serves: {Homing: {}, Grabbing: {}}}",
            "  Winch: {serves: {Raising: {}, Unreeling: {}}}",
        ]
    ),
    ".access.yaml": """coordinators:
  loader:
    Arm: [home]
    arm1: all
  Watch:
    others: [home, up]
    winch: []
  night: {}
  others: all
""",
}


class Portals:
    """The results of all attempts in the mission."""

    def __init__(self, folder: Path) -> None:
        for ending, text in FILES.items():
            (folder / f"mission{ending}").write_text(text)
        self._mission = load_mission(folder / "mission.dL")

    @cached_property
    def said(self) -> frozenset[str]:
        """Every line of the team, until each coordinator has finished."""
        fleet = Fleet(self._mission, 1, options=FleetOptions(keeps=False))
        through = {f"{member.id}: {THROUGH}" for member in self._mission.team.coordinators}
        while not through <= (lines := frozenset(text.strip() for _, _, text in fleet.log)):
            assert fleet.now < MAX_TIME, f"a coordinator has not finished: {fleet.log}"
            fleet.run(1.0)
        fleet.close()
        return lines

    def tried(self, who: str, what: str) -> bool:
        """Whether a coordinator may call a portal: `arm1.home`; in every way, or in none."""
        resource, _, portal = what.partition(".")
        done = {how: self._has_started(who, how, resource, portal) for how in HOW}
        done[FOUND] = f"{who}: {FOUND} {what}" in self.said
        assert len(set(done.values())) == 1, f"{who} calls {what}: {done}"
        return done[PLAIN]

    def reserved(self, who: str, resource: str) -> bool:
        """Whether a coordinator has reserved a resource."""
        return f"{who}: {KEPT} {resource}" in self.said

    def _has_started(self, who: str, how: str, resource: str, portal: str) -> bool:
        return f"{resource}: {who} {how} {portal}" in self.said
