"""The recovery of coordinators: from the devices file to the settings of a host, and into bundles."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest
from msgspec.structs import replace

from lfield.errors import BindingError, BundleError
from lfield.mission import bundle
from lfield.mission.bindings import RecoverySettings
from lfield.mission.loader import load_mission, mission_problems, rebound
from lfield.mission.mission import Mission

PROGRAM = """
resource Post { init(string[] arg) { } portal say() { } }
coordinator Boss { init(string[] arg) { HEARTBEAT findPost("p0").say(); } }
coordinator Clerk { init(string[] arg) { } }
"""
Write = Callable[..., Path]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """A team with a post on each of so many hosts, a fenced coordinator and another one."""

    def write(
        hosts: int, devices: str = "", witness: str = "", heartbeat: str = "heartbeatInterval(2);"
    ) -> Path:
        (tmp_path / "m.L").write_text(PROGRAM.replace("HEARTBEAT", heartbeat))
        lines = [f"//Post:p{n}@h{n}\n" for n in range(hosts)]
        (tmp_path / "m.dL").write_text("".join(lines) + f"//Boss:boss@h0\n//Clerk:clerk@h0\n{witness}")
        (tmp_path / "m.devices.yaml").write_text(devices)
        return tmp_path / "m.dL"

    return write


def wrong(deploy: Path) -> str:
    with pytest.raises(BindingError) as error:
        load_mission(deploy)
    return "\n".join(error.value.problems)


def test_all_hosts_are_members_unless_some_are_named(write: Write) -> None:
    mission = load_mission(write(3))
    assert mission.fenced == {"boss"}
    assert mission.recovery == RecoverySettings(2.0, ("h0", "h1", "h2"))
    assert load_mission(write(9)).recovery.members == tuple(f"h{n}" for n in range(9))
    named = load_mission(write(12, "recovery: {lease: 0.5, members: [h7, h2, h11]}")).recovery
    # In the order of the team, so that two hosts with the same members have equal settings.
    assert named == RecoverySettings(0.5, ("h2", "h7", "h11"))
    assert str(named) == "a lease of 0.5 s among h2, h7 and h11"


def test_without_a_fenced_coordinator_there_is_no_member(write: Write) -> None:
    mission = load_mission(write(12, "recovery: {lease: 3}", heartbeat=""))
    assert (mission.fenced, mission.recovery) == (frozenset(), RecoverySettings(3.0, ()))
    assert mission_problems(write(2, heartbeat="")) == []


def test_of_more_than_nine_hosts_members_must_be_named(write: Write) -> None:
    sentence = (
        "a team of 10 hosts with a coordinator that calls heartbeatInterval needs the names of at most 9"
    )
    deploy = write(10, "recovery: {lease: 1}")
    assert sentence in wrong(deploy)
    (found,) = mission_problems(deploy)
    assert found.render().startswith(f"{deploy}:11:1: error[Y115]: {sentence}")
    assert "//Boss:boss@h0\n    ^" in found.render()
    (deploy.with_suffix(".devices.yaml")).unlink()
    (other,) = mission_problems(deploy)
    assert other.as_data() == found.as_data()
    assert found.as_data()["range"]["start"] == {"line": 11, "column": 1}
    assert mission_problems(write(10, "recovery: {members: [h1, h2, h9]}")) == []


@pytest.mark.parametrize(
    ("written", "told"),
    [
        ("{lease: 0.1}", "'lease' must be from 0.2 to 60, not 0.1"),
        ("{lease: 61}", "'lease' must be from 0.2 to 60, not 61"),
        ("{lease: .nan}", "'.nan' is not a finite number"),
        ("{lease: soon}", "'lease' must be a number"),
        ("{members: []}", "'members' must be 1 to 9 hosts, not 0"),
        ("{members: [h0, h1, h0]}", "'h0' is named twice"),
        ("{members: [h0, h12]}", "the deployment has no host 'h12'"),
        ("{members: [h0, 3]}", "'members' must be a list of texts, not the number 3"),
        ("{members: h0}", "'members' must be a list"),
        ("{member: [h0]}", "'recovery' has no key 'member'"),
        ("2", "'recovery' must be a mapping"),
        ("{lease: 0.5}\nsilence: 0.7", "'lease' must be no shorter than 'silence', which is 0.7, not 0.5"),
    ],
)
def test_mistakes_in_the_recovery_section_are_reported_at_their_place(
    write: Write, written: str, told: str
) -> None:
    finding = wrong(write(3, f"recovery: {written}"))
    assert told in finding
    assert "m.devices.yaml:1:" in finding
    assert "^" in finding


def test_no_device_outlives_a_lease(tmp_path: Path) -> None:
    (tmp_path / "m.L").write_text(
        "include <can/winch.L>;\n"
        'coordinator Boss { init(string[] arg) { heartbeatInterval(3); findWinch("w").hold(); } }\n'
    )
    deploy, devices = tmp_path / "m.dL", tmp_path / "m.devices.yaml"
    deploy.write_text("//Winch:w@h0?0.05&0.2&12.0\n//@h2\n//Boss:boss@h1\n")
    axis = "axis: {driver: can, endpoint: 'socketcan:can0', protocol: cia402, node: 5, counts: 4096}"
    devices.write_text(f"silence: 3\nagents: {{w: {{devices: {{{axis}}}}}}}\n")
    assert "m.dL:3:1: error[Y115]: devices go safe after their host was silent for 3 s" in wrong(deploy)
    devices.write_text(f"silence: 3\nrecovery: {{lease: 3}}\nagents: {{w: {{devices: {{{axis}}}}}}}\n")
    assert load_mission(deploy).recovery.lease == 3.0
    # Fakes have a silence of their own.
    devices.write_text("recovery: {lease: 1}\n")
    assert load_mission(deploy, simulate=True).bindings.silence == 1.0


@pytest.mark.parametrize(
    ("members", "told"),
    [
        ("h0", "'members' must be a list"),
        ("{h0: 1}", "'members' must be a list"),
        ("[3]", "'members' must be a list of texts, not the number 3"),
        ("[]", "'members' must be 1 to 9 hosts, not 0"),
        ("", "'members' must be 1 to 9 hosts, not 0"),
    ],
)
def test_one_mistake_in_the_members_is_reported_once(write: Write, members: str, told: str) -> None:
    with pytest.raises(BindingError) as found:
        load_mission(write(3, f"recovery:\n  members: {members}\n"))
    (problem,) = found.value.problems
    assert told in problem


def test_ten_members_are_refused(write: Write) -> None:
    names = ", ".join(f"h{n}" for n in range(10))
    assert "'members' must be 1 to 9 hosts, not 10" in wrong(write(11, f"recovery: {{members: [{names}]}}"))


def test_a_team_of_two_gets_the_hint_to_add_a_witness(write: Write) -> None:
    deploy = write(2)
    (found,) = mission_problems(deploy)
    problem, is_error = found.render(), found.severity == "error"
    assert not is_error
    assert "m.dL:3:1: warning[Y114]: boss cannot be recovered when one of h0 and h1 is lost" in problem
    assert "add a witness, a host without agents: //@name" in problem
    assert load_mission(deploy).warnings == (problem,)
    (deploy.with_suffix(".devices.yaml")).unlink()
    assert [found.render() for found in mission_problems(deploy)] == [problem]
    assert mission_problems(write(2, witness="//@ground\n")) == []
    assert mission_problems(write(1)) == []
    assert mission_problems(write(4)) == []
    (found,) = mission_problems(write(4, "recovery: {members: [h3, h1]}"))
    problem = found.render()
    assert "when one of h1 and h3 is lost" in problem
    # Another host does not become a member automatically.
    assert "name at least three hosts in 'recovery: {members: [...]}'" in problem
    assert "witness" not in problem


@pytest.mark.parametrize(
    ("hosts", "witness", "member", "hint"),
    [
        (2, "", "h0", "add a witness, a host without agents: //@name; and name at least three hosts"),
        (4, "", "h3", "name at least three hosts in 'recovery: {members: [...]}' of the devices file"),
        (2, "//@ground\n", "ground", "name at least three hosts in 'recovery: {members: [...]}'"),
        (1, "//@ground\n", "ground", "add a witness, a host without agents: //@name; and name at least"),
    ],
)
def test_a_single_member_whose_loss_stops_all_is_a_warning(
    write: Write, hosts: int, witness: str, member: str, hint: str
) -> None:
    (found,) = mission_problems(write(hosts, f"recovery: {{members: [{member}]}}", witness))
    problem = found.render()
    assert (
        f"warning[Y114]: boss cannot be recovered when {member} is lost: no other host can decide" in problem
    )
    assert hint in problem


def test_a_host_whose_loss_loses_all_agents_may_decide_alone(write: Write) -> None:
    assert mission_problems(write(1, "recovery: {members: [h0]}", "//@ground\n")) == []
    # A member needs no agents.
    watchers = "//@w0\n//@w1\n//@w2\n"
    assert mission_problems(write(2, "recovery: {members: [w0, w1, w2]}", watchers)) == []


def test_recovery_is_in_the_bundle_and_another_devices_file_changes_it(write: Write, tmp_path: Path) -> None:
    mission = load_mission(write(2, "recovery: {lease: 4}", witness="//@ground:9000\n"))
    read = bundle.decode(bundle.encode(mission))
    assert read.fenced == {"boss"}
    assert read.recovery == RecoverySettings(4.0, ("h0", "h1", "ground"))
    assert (read.team.hosts, read.team.addresses_by_host["ground"]) == (mission.team.hosts, "ground:9000")
    assert read.team == mission.team
    assert read.on_fakes().recovery == read.recovery
    other = tmp_path / "other.yaml"
    other.write_text("recovery: {lease: 1, members: [ground]}")
    assert rebound(read, other).recovery == RecoverySettings(1.0, ("ground",))
    other.write_text("recovery: {lease: 1, members: [h2]}")
    with pytest.raises(BindingError, match="the deployment has no host 'h2'"):
        rebound(read, other)


@pytest.mark.parametrize(
    ("recovery", "told"),
    [
        (RecoverySettings(0.0), "the lease of 'recovery' is out of range"),
        (RecoverySettings(float("nan")), "the lease of 'recovery' is out of range"),
        (
            RecoverySettings(2.0, ("h0", "h0")),
            "the members of 'recovery' are not hosts of the team, or too many",
        ),
        (RecoverySettings(2.0, ("h9",)), "the members of 'recovery' are not hosts of the team, or too many"),
    ],
)
def test_a_bundle_with_invalid_recovery_is_refused(
    write: Write, recovery: RecoverySettings, told: str
) -> None:
    mission = load_mission(write(3))
    changed = mission.with_bindings(replace(mission.bindings, recovery=recovery))
    with pytest.raises(BundleError, match=told):
        bundle.decode(bundle.encode(changed))


def test_a_bundle_with_too_many_unnamed_members_is_refused(write: Write) -> None:
    mission = load_mission(write(10, "recovery: {members: [h1]}"))
    changed = mission.with_bindings(replace(mission.bindings, recovery=RecoverySettings()))
    with pytest.raises(BundleError, match="needs the names of at most 9"):
        bundle.decode(bundle.encode(changed))


def test_bindings_of_an_earlier_bundle_have_the_default_recovery(write: Write) -> None:
    mission: Mission = load_mission(write(3))
    plain = msgspec.to_builtins(mission.bindings)
    del plain["recovery"]
    assert msgspec.convert(plain, type(mission.bindings)).recovery == RecoverySettings()
