"""The handshake: which peers are admitted, which are refused, and the reasons that both receive."""

import pytest

from lfield.authority.identity import ALL_RIGHTS, ANONYMOUS, NO_RIGHTS, Identity, Right
from lfield.authority.peer_verification import AdmissionDecision
from lfield.errors import HandshakeError, WireError
from lfield.net.handshake import Handshake
from lfield.wire.coordinator_messages import Terminated, TransferAccepted
from lfield.wire.messages import PROTOCOL, HandshakeRefused, Hello, IncompatibleHello, Ping, RevocationUpdate
from lfield.wire.observer_messages import (
    EmergencyStop,
    ForgetRequest,
    InputLine,
    Pause,
    RecoverRequest,
    StartRequest,
)
from lfield.wire.subscription_messages import EventBatch, Subscribe

PROGRAM, DEPLOYMENT, REGISTRY = b"p" * 32, b"d" * 32, b"r" * 32
HOSTS = ("a", "b", "c")


def host_hello(host: str = "b", **other) -> Hello:
    hashes = {"program": PROGRAM, "deployment": DEPLOYMENT, "registry": REGISTRY}
    fields = {"role": "host", "incarnation": 7} | hashes | other
    return Hello(host=host, **fields)


def host(name: str) -> Identity:
    return Identity("host", name, NO_RIGHTS)


def person(*may: Right) -> Identity:
    return Identity("person", "anna", frozenset(may))


def local(*may: Right) -> Identity:
    return Identity("local", "bob", frozenset(may))


OBSERVER_HELLO = Hello("observer", "observer", 0)


def handshake(
    dialled: str | None = None,
    linked: dict[str, int] | None = None,
    who: Identity = host("b"),  # noqa: B008
    verdict: AdmissionDecision = AdmissionDecision("all"),  # noqa: B008
) -> Handshake:
    own = host_hello("a", incarnation=1)
    return Handshake(own, who, decision=verdict, hosts=HOSTS, dialled=dialled, linked=linked)


def refused(machine: Handshake, message: object = None) -> str:
    """The reason for which a message is refused, the first or a later one; '' if it is accepted."""
    try:
        machine.first_message()
        if message is not None:
            machine.receive(message) if machine.peer is None else machine.admit(message)
    except HandshakeError as error:
        return machine.refusal.reason if machine.refusal else str(error)
    return ""


def observing(who: Identity, verdict: AdmissionDecision = AdmissionDecision("all")) -> Handshake:  # noqa: B008
    """The handshake of an observer, after its Hello."""
    machine = handshake(who=who, verdict=verdict)
    assert refused(machine, OBSERVER_HELLO) == ""
    return machine


def test_a_host_of_the_deployment_is_admitted():
    for dialled in (None, "b"):
        machine = handshake(dialled)
        assert machine.receive(host_hello()) == host_hello()
        assert machine.peer == host_hello()
        machine.admit(TransferAccepted("Tour:one", 1, 1))


def test_an_unauthenticated_peer_is_refused_without_a_hello():
    machine = handshake(who=ANONYMOUS)
    assert "unknown certificate authority" in refused(machine)
    assert machine.peer is None


def test_a_peer_that_is_not_admitted_gets_only_the_reason():
    machine = handshake(verdict=AdmissionDecision("nothing", "the keys of host b are revoked (list 3)"))
    assert refused(machine) == "the keys of host b are revoked (list 3)"


def test_a_host_must_use_the_name_in_its_certificate():
    reason = refused(handshake(who=host("c")), host_hello("b"))
    assert reason.startswith(
        "host c calls itself b; the name in its certificate must be its name in the deploym"
    )
    assert refused(handshake(who=host("b")), host_hello("b")) == ""


@pytest.mark.parametrize(
    ("who", "name"), [(person(*ALL_RIGHTS), "anna"), (local(*ALL_RIGHTS), "user bob of this computer")]
)
def test_a_peer_without_a_host_certificate_is_not_accepted_as_a_host(who, name):
    reason = refused(handshake(who=who), host_hello("b"))
    assert reason == f"a accepts hosts by certificate, and {name} may only send commands"


ID = bytes(16)
STOP, LIFT, PAUSE, RESUME = EmergencyStop(ID, "fire"), EmergencyStop(ID, "", True), Pause(ID), Pause(ID, True)
OPERATING = [LIFT, RESUME, ForgetRequest("tom"), RecoverRequest("tom", 1, 1, 1), StartRequest(["b"])]
OPERATING.append(InputLine("echo", "yes"))
TABLE = [(Subscribe(once=True), Right.OBSERVE), (STOP, Right.STOP), (PAUSE, Right.STOP)]
TABLE += [(message, Right.OPERATE) for message in OPERATING]


@pytest.mark.parametrize(("message", "right"), TABLE, ids=lambda case: str(case)[:14])
def test_each_message_requires_exactly_its_right(message, right):
    for make in (person, local):
        assert refused(observing(make(right)), message) == ""
        others = ALL_RIGHTS - {right}
        reason = refused(observing(make(*others)), message)
        assert f"and this takes the right to {right}" in reason
    assert refused(observing(person(*ALL_RIGHTS)), message) == ""


def test_a_missing_right_is_named_with_the_way_to_get_it():
    assert refused(observing(person(Right.OBSERVE, Right.STOP)), LIFT) == (
        "anna may observe and stop, and this takes the right to operate: "
        "new keys give it: 'lfield keys revoke person anna', then "
        "'lfield keys person anna --may observe,stop,operate'"
    )
    assert refused(observing(local(Right.OBSERVE)), STOP) == (
        "user bob of this computer may observe, and this takes the right to stop: "
        "the user who runs the host has it, and root"
    )
    assert "anna may do nothing, and this takes" in refused(observing(person()), Subscribe(once=True))


def test_hosts_with_different_bundles_of_one_program_do_not_link():
    ours, remote = host_hello("a", bundle=b"1" * 32), host_hello("b", bundle=b"2" * 32)
    machine = Handshake(ours, host("b"), hosts=HOSTS)
    reason = refused(machine, remote)
    assert reason.startswith(
        "a runs bundle 3131313131313131 and b runs bundle 3232323232323232: copy one of the two to both"
    )
    assert "--devices" in reason
    # A host that runs files has no bundle that others could have, and an observer runs none.
    for other in (ours, host_hello("b"), OBSERVER_HELLO, host_hello("b", bundle=b"1" * 32)):
        if other is not ours:
            assert refused(Handshake(ours, host("b"), hosts=HOSTS), other) == ""
    assert refused(Handshake(host_hello("a"), host("b"), hosts=HOSTS), remote) == ""
    assert refused(Handshake(OBSERVER_HELLO, host("b"), dialled="b"), remote) == ""


def test_both_bundles_are_named_where_their_programs_differ():
    ours, remote = host_hello("a", bundle=b"1" * 32), host_hello("b", bundle=b"2" * 32, program=b"q" * 32)
    machine = Handshake(ours, host("b"), hosts=HOSTS)
    assert refused(machine, remote).startswith(
        "a runs bundle 3131313131313131 and b runs bundle 3232323232323232, which differ in their program"
    )
    assert machine.refused_bundle == b"2" * 32
    # A host that has built its bundle from files sends its digest; the parts decide.
    built = host_hello("b", built=b"3" * 32, program=b"q" * 32)
    assert "b runs bundle 3333333333333333, which" in refused(Handshake(ours, host("b"), hosts=HOSTS), built)
    assert refused(Handshake(ours, host("b"), hosts=HOSTS), host_hello("b", built=b"3" * 32)) == ""


def test_a_local_user_without_rights_is_refused_before_the_hello():
    reason = refused(handshake(who=local()))
    assert reason.startswith("user bob of this computer has no permission here: join the group 'lfield'")


def test_an_observing_host_may_only_observe_and_stop():
    machine = observing(host("b"))
    assert [refused(machine, message) for message in (Subscribe(once=True), STOP, PAUSE)] == ["", "", ""]
    for message in OPERATING:
        assert "a person has it, not a host" in refused(observing(host("b")), message)


def test_a_person_with_an_expired_certificate_may_only_observe_and_stop():
    verdict = AdmissionDecision("finish", "the certificate of anna ended 2026-11-23 20:00 UTC")
    assert refused(observing(person(*ALL_RIGHTS), verdict), STOP) == ""
    assert refused(observing(person(*ALL_RIGHTS), verdict), Subscribe(once=True)) == ""
    reason = refused(observing(person(*ALL_RIGHTS), verdict), LIFT)
    assert reason == f"{verdict.reason}; until then anna may only observe and stop"


BATCH = EventBatch(7, 1, 0.0, 0.0, 0, 0, [])


@pytest.mark.parametrize(
    "message", [TransferAccepted("t:one", 1, 1), Terminated("t", 1, "done", "", "a"), BATCH]
)
@pytest.mark.parametrize(
    "who", [person(*ALL_RIGHTS), local(*ALL_RIGHTS), host("b")], ids=["person", "local", "host"]
)
def test_an_observer_may_not_send_messages_of_hosts(message, who):
    assert "which only hosts may send" in refused(observing(who), message)


def test_any_authenticated_peer_may_send_a_revocation_list():
    assert refused(observing(person()), RevocationUpdate(b"")) == ""


def test_a_command_accepts_only_the_host_that_it_dialled():
    for identity in (host("b"), local(*ALL_RIGHTS)):
        assert refused(Handshake(OBSERVER_HELLO, identity, dialled="b"), host_hello("b")) == ""
    assert "b answered at the address of c" in refused(
        Handshake(OBSERVER_HELLO, host("b"), dialled="c"), host_hello("b")
    )
    assert "host c calls itself b" in refused(
        Handshake(OBSERVER_HELLO, host("c"), dialled="c"), host_hello("b")
    )
    assert "anna may only send commands" in refused(
        Handshake(OBSERVER_HELLO, person(*ALL_RIGHTS)), host_hello("b")
    )
    assert "unknown certificate authority" in refused(Handshake(OBSERVER_HELLO, ANONYMOUS))


def test_a_second_link_of_the_same_incarnation_is_accepted():
    assert handshake(linked={"b": 7}).receive(host_hello()) == host_hello()


@pytest.mark.parametrize(
    ("message", "sentence"),
    [
        (
            IncompatibleHello(PROTOCOL + 1),
            f"peer protocol {PROTOCOL + 1}; install the same version",
        ),
        (
            IncompatibleHello(3),
            f"a uses protocol {PROTOCOL} and its peer protocol 3; install the same version",
        ),
        (host_hello(program=b"q" * 32), "a has program 707070707070 and b has program 717171717171"),
        (host_hello(deployment=b"q" * 32), "a has deployment 646464646464 and b has deployment 7171"),
        (host_hello(registry=b"q" * 32), "a has registry 727272727272 and b has registry 7171"),
        (
            host_hello(registry=b""),
            r"b has registry \(none\); start both from the same .capabilities.yaml file",
        ),
        (host_hello(program=b""), r"b has program \(none\)"),
        (
            host_hello(journal_id=5),
            "b keeps its coordinators in a journal and a does not; start both with --volatile",
        ),
        (host_hello("a"), "two hosts call themselves a"),
        (host_hello("a", incarnation=1), "a reached itself"),
        (host_hello("d"), "the deployment of a has no host d"),
        (host_hello("c"), "c answered at the address of b"),
    ],
)
def test_both_sides_report_the_reason_of_a_refusal(message, sentence):
    machine = handshake(dialled="b", who=host(getattr(message, "host", "b")))
    with pytest.raises(HandshakeError, match=sentence) as error:
        machine.receive(message)
    assert machine.refusal is not None
    assert machine.refusal.reason in str(error.value)
    assert machine.peer is None
    remote = Handshake(host_hello("b"), host("a"), hosts=HOSTS, dialled="a")
    with pytest.raises(HandshakeError, match=sentence) as told:
        remote.receive(machine.refusal)
    assert str(told.value).startswith("a refused the connection: ")
    assert remote.refusal is None


@pytest.mark.parametrize(("ours", "theirs"), [("fakes", "hardware"), ("hardware", "fakes")])
def test_simulated_and_real_devices_do_not_join(ours, theirs):
    machine = Handshake(host_hello("a", devices=ours), host("b"), hosts=HOSTS)
    sentence = f"the devices of a are {ours} and those of b are {theirs}; start both with --sim, or none"
    with pytest.raises(HandshakeError, match=sentence):
        machine.receive(host_hello(devices=theirs))
    assert machine.refusal is not None
    assert sentence in machine.refusal.reason


@pytest.mark.parametrize("theirs", ["", "fakes", "hardware"])
def test_hosts_without_devices_and_observers_join_either_kind(theirs):
    Handshake(host_hello("a"), host("b"), hosts=HOSTS).receive(host_hello(devices=theirs))
    Handshake(host_hello("a", devices=theirs), host("b"), hosts=HOSTS).receive(host_hello())
    observer = host_hello("ps", role="observer", program=b"", deployment=b"", registry=b"")
    Handshake(host_hello("a", devices=theirs), host("b"), hosts=HOSTS).receive(observer)
    Handshake(observer, host("b")).receive(host_hello(devices=theirs))


def test_hosts_with_different_origins_do_not_join():
    ours, remote = "47.3977420, 8.5455940 at 488.00 m", "47.0000000, 8.0000000 at 400.00 m"
    for own, yours in ((ours, remote), (ours, ""), ("", remote)):
        machine = Handshake(host_hello("a", origin=own), host("b"), hosts=HOSTS)
        with pytest.raises(HandshakeError, match=r"give both the same 'frame: \{origin") as told:
            machine.receive(host_hello(origin=yours))
        assert f"a counts places from {own or 'each home'} and b from {yours or 'each home'}" in str(
            told.value
        )
    Handshake(host_hello("a", origin=ours), host("b"), hosts=HOSTS).receive(host_hello(origin=ours))
    Handshake(host_hello("a", origin=ours), host("b"), hosts=HOSTS).receive(host_hello("ps", role="observer"))


def test_hosts_with_different_recovery_groups_do_not_join():
    ours, remote = "a lease of 2 s among a, b and c", "a lease of 2 s among a, b and d"
    for own, yours in ((ours, remote), (ours, ""), ("", remote)):
        machine = Handshake(host_hello("a", recovery=own), host("b"), hosts=HOSTS)
        with pytest.raises(
            HandshakeError, match="give both the same 'recovery' in their devices files"
        ) as told:
            machine.receive(host_hello(recovery=yours))
        assert f"on a coordinators are recovered by {own or 'no host'}" in str(told.value)
        assert f"on b by {yours or 'no host'}" in str(told.value)
    Handshake(host_hello("a", recovery=ours), host("b"), hosts=HOSTS).receive(host_hello(recovery=ours))
    Handshake(host_hello("a", recovery=ours), host("b"), hosts=HOSTS).receive(
        host_hello("ps", role="observer")
    )
    Handshake(host_hello("ps", role="observer"), host("b")).receive(host_hello(recovery=remote))


def test_a_second_host_of_a_name_is_refused_while_the_first_is_linked():
    linked = {"b": 6}
    machine = handshake(linked=linked)
    with pytest.raises(HandshakeError, match="a already has a link to another b"):
        machine.receive(host_hello())
    del linked["b"]
    assert handshake(linked=linked).receive(host_hello()) == host_hello()


def test_a_message_before_the_hello_or_a_second_hello_is_an_error():
    machine = handshake()
    with pytest.raises(WireError, match="received Ping before the handshake"):
        machine.receive(Ping(1))
    with pytest.raises(WireError, match="received Ping before the handshake"):
        machine.admit(Ping(1))
    machine.receive(host_hello())
    with pytest.raises(WireError, match="a second Hello"):
        machine.admit(host_hello())


def test_an_observer_accepts_any_host():
    for told in (host_hello(), host_hello().summary):
        Handshake(OBSERVER_HELLO, host("b")).receive(told)


def test_a_refusal_is_reported_also_from_an_unnamed_peer():
    with pytest.raises(HandshakeError, match="the peer refused the connection: no"):
        handshake().receive(HandshakeRefused("no"))


def test_hosts_with_different_reservation_times_do_not_join():
    machine = Handshake(host_hello("a", reservation=6.0), host("b"), hosts=HOSTS)
    with pytest.raises(HandshakeError, match=r"a last 6 s without contact, those of b 20 s; "):
        machine.receive(host_hello(reservation=20.0))
    Handshake(host_hello("a", reservation=6.0), host("b"), hosts=HOSTS).receive(host_hello(reservation=6.0))
    Handshake(host_hello("a", reservation=6.0), host("b"), hosts=HOSTS).receive(
        host_hello("ps", role="observer")
    )
