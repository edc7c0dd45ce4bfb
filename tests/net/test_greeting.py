"""Who is let in, who is not, and what both are told."""

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


def hello(host: str = "b", **other) -> Hello:
    hashes = {"program": PROGRAM, "deployment": DEPLOYMENT, "registry": REGISTRY}
    fields = {"role": "host", "incarnation": 7} | hashes | other
    return Hello(host=host, **fields)


def host(name: str) -> Identity:
    return Identity("host", name, NO_RIGHTS)


def person(*may: Right) -> Identity:
    return Identity("person", "anna", frozenset(may))


def local(*may: Right) -> Identity:
    return Identity("local", "bob", frozenset(may))


LOOK = Hello("observer", "observer", 0)


def greeting(
    dialled: str | None = None,
    linked: dict[str, int] | None = None,
    who: Identity = host("b"),  # noqa: B008
    verdict: AdmissionDecision = AdmissionDecision("all"),  # noqa: B008
) -> Handshake:
    own = hello("a", incarnation=1)
    return Handshake(own, who, decision=verdict, hosts=HOSTS, dialled=dialled, linked=linked)


def refused(machine: Handshake, message: object = None) -> str:
    """Why a message is refused, the first or a later one; '' if it is not."""
    try:
        machine.first_message()
        if message is not None:
            machine.receive(message) if machine.peer is None else machine.admit(message)
    except HandshakeError as error:
        return machine.refusal.reason if machine.refusal else str(error)
    return ""


def looking(who: Identity, verdict: AdmissionDecision = AdmissionDecision("all")) -> Handshake:  # noqa: B008
    """Somebody who looks has greeted."""
    machine = greeting(who=who, verdict=verdict)
    assert refused(machine, LOOK) == ""
    return machine


def test_a_host_of_the_deployment_is_let_in():
    for dialled in (None, "b"):
        machine = greeting(dialled)
        assert machine.receive(hello()) == hello()
        assert machine.peer == hello()
        machine.admit(TransferAccepted("Tour:one", 1, 1))


def test_a_stranger_hears_nothing():
    machine = greeting(who=ANONYMOUS)
    assert "unknown certificate authority" in refused(machine)
    assert machine.peer is None


def test_whoever_is_not_to_have_a_link_hears_only_why():
    machine = greeting(verdict=AdmissionDecision("nothing", "the keys of host b are revoked (list 3)"))
    assert refused(machine) == "the keys of host b are revoked (list 3)"


def test_a_host_is_who_its_certificate_says():
    why = refused(greeting(who=host("c")), hello("b"))
    assert why.startswith(
        "host c calls itself b; the name in its certificate must be its name in the deploym"
    )
    assert refused(greeting(who=host("b")), hello("b")) == ""


@pytest.mark.parametrize(
    ("who", "name"), [(person(*ALL_RIGHTS), "anna"), (local(*ALL_RIGHTS), "user bob of this computer")]
)
def test_who_gives_commands_is_no_host(who, name):
    why = refused(greeting(who=who), hello("b"))
    assert why == f"a accepts hosts by certificate, and {name} may only send commands"


ID = bytes(16)
STOP, LIFT, PAUSE, RESUME = EmergencyStop(ID, "fire"), EmergencyStop(ID, "", True), Pause(ID), Pause(ID, True)
OPERATING = [LIFT, RESUME, ForgetRequest("tom"), RecoverRequest("tom", 1, 1, 1), StartRequest(["b"])]
OPERATING.append(InputLine("yes"))
TABLE = [(Subscribe(once=True), Right.OBSERVE), (STOP, Right.STOP), (PAUSE, Right.STOP)]
TABLE += [(message, Right.OPERATE) for message in OPERATING]


@pytest.mark.parametrize(("message", "right"), TABLE, ids=lambda case: str(case)[:14])
def test_each_message_takes_its_right_and_no_other(message, right):
    for make in (person, local):
        assert refused(looking(make(right)), message) == ""
        others = ALL_RIGHTS - {right}
        why = refused(looking(make(*others)), message)
        assert f"and this takes the right to {right}" in why
    assert refused(looking(person(*ALL_RIGHTS)), message) == ""


def test_the_right_that_is_missing_is_named_with_what_to_do():
    assert refused(looking(person(Right.OBSERVE, Right.STOP)), LIFT) == (
        "anna may observe and stop, and this takes the right to operate: "
        "new keys give it: 'lfield keys revoke person anna', then "
        "'lfield keys person anna --may observe,stop,operate'"
    )
    assert refused(looking(local(Right.OBSERVE)), STOP) == (
        "user bob of this computer may observe, and this takes the right to stop: "
        "the user who runs the host has it, and root"
    )
    assert "anna may do nothing, and this takes" in refused(looking(person()), Subscribe(once=True))


def test_two_bundles_of_one_program_do_not_link():
    ours, theirs = hello("a", bundle=b"1" * 32), hello("b", bundle=b"2" * 32)
    machine = Handshake(ours, host("b"), hosts=HOSTS)
    why = refused(machine, theirs)
    assert why.startswith(
        "a runs bundle 3131313131313131 and b runs bundle 3232323232323232: copy one of the two to both"
    )
    assert "--devices" in why
    # Of files there is no bundle that others could have, and who gives commands runs none.
    for other in (ours, hello("b"), LOOK, hello("b", bundle=b"1" * 32)):
        if other is not ours:
            assert refused(Handshake(ours, host("b"), hosts=HOSTS), other) == ""
    assert refused(Handshake(hello("a"), host("b"), hosts=HOSTS), theirs) == ""
    assert refused(Handshake(LOOK, host("b"), dialled="b"), theirs) == ""


def test_both_bundles_are_named_also_where_their_programs_differ():
    ours, theirs = hello("a", bundle=b"1" * 32), hello("b", bundle=b"2" * 32, program=b"q" * 32)
    machine = Handshake(ours, host("b"), hosts=HOSTS)
    assert refused(machine, theirs).startswith(
        "a runs bundle 3131313131313131 and b runs bundle 3232323232323232, which differ in their program"
    )
    assert machine.refused_bundle == b"2" * 32
    # A host that has built its bundle of files shows which one that is; the parts decide.
    built = hello("b", built=b"3" * 32, program=b"q" * 32)
    assert "b runs bundle 3333333333333333, which" in refused(Handshake(ours, host("b"), hosts=HOSTS), built)
    assert refused(Handshake(ours, host("b"), hosts=HOSTS), hello("b", built=b"3" * 32)) == ""


def test_who_may_nothing_at_a_door_does_not_even_hear_a_greeting():
    why = refused(greeting(who=local()))
    assert why.startswith("user bob of this computer has no permission here: join the group 'lfield'")


def test_a_host_that_looks_may_stop_others_and_no_more():
    machine = looking(host("b"))
    assert [refused(machine, message) for message in (Subscribe(once=True), STOP, PAUSE)] == ["", "", ""]
    for message in OPERATING:
        assert "a person has it, not a host" in refused(looking(host("b")), message)


def test_whoever_is_only_let_finish_may_look_and_stop():
    verdict = AdmissionDecision("finish", "the certificate of anna ended 2026-11-23 20:00 UTC")
    assert refused(looking(person(*ALL_RIGHTS), verdict), STOP) == ""
    assert refused(looking(person(*ALL_RIGHTS), verdict), Subscribe(once=True)) == ""
    why = refused(looking(person(*ALL_RIGHTS), verdict), LIFT)
    assert why == f"{verdict.why}; until then anna may only observe and stop"


BATCH = EventBatch(7, 1, 0.0, 0.0, 0, 0, [])


@pytest.mark.parametrize(
    "message", [TransferAccepted("t:one", 1, 1), Terminated("t", 1, "done", "", "a"), BATCH]
)
@pytest.mark.parametrize(
    "who", [person(*ALL_RIGHTS), local(*ALL_RIGHTS), host("b")], ids=["person", "local", "host"]
)
def test_what_only_hosts_say_no_observer_says(message, who):
    assert "which only hosts may send" in refused(looking(who), message)


def test_anybody_known_may_bring_a_revocation_list():
    assert refused(looking(person()), RevocationUpdate(b"")) == ""


def test_a_command_asks_the_host_that_it_means():
    for who in (host("b"), local(*ALL_RIGHTS)):
        assert refused(Handshake(LOOK, who, dialled="b"), hello("b")) == ""
    assert "b answered at the address of c" in refused(Handshake(LOOK, host("b"), dialled="c"), hello("b"))
    assert "host c calls itself b" in refused(Handshake(LOOK, host("c"), dialled="c"), hello("b"))
    assert "anna may only send commands" in refused(Handshake(LOOK, person(*ALL_RIGHTS)), hello("b"))
    assert "unknown certificate authority" in refused(Handshake(LOOK, ANONYMOUS))


def test_the_same_life_may_have_a_second_link():
    assert greeting(linked={"b": 7}).receive(hello()) == hello()


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
        (hello(program=b"q" * 32), "a has program 707070707070 and b has program 717171717171"),
        (hello(deployment=b"q" * 32), "a has deployment 646464646464 and b has deployment 7171"),
        (hello(registry=b"q" * 32), "a has registry 727272727272 and b has registry 7171"),
        (hello(registry=b""), r"b has registry \(none\); start both from the same .capabilities.yaml file"),
        (hello(program=b""), r"b has program \(none\)"),
        (
            hello(journal_id=5),
            "b keeps its coordinators in a journal and a does not; start both with --volatile",
        ),
        (hello("a"), "two hosts call themselves a"),
        (hello("a", incarnation=1), "a reached itself"),
        (hello("d"), "the deployment of a has no host d"),
        (hello("c"), "c answered at the address of b"),
    ],
)
def test_who_does_not_fit_is_told_why(message, sentence):
    machine = greeting(dialled="b", who=host(getattr(message, "host", "b")))
    with pytest.raises(HandshakeError, match=sentence) as caught:
        machine.receive(message)
    assert machine.refusal is not None
    assert machine.refusal.reason in str(caught.value)
    assert machine.peer is None
    theirs = Handshake(hello("b"), host("a"), hosts=HOSTS, dialled="a")
    with pytest.raises(HandshakeError, match=sentence) as told:
        theirs.receive(machine.refusal)
    assert str(told.value).startswith("a refused this host: ")
    assert theirs.refusal is None


@pytest.mark.parametrize(("ours", "theirs"), [("fakes", "hardware"), ("hardware", "fakes")])
def test_fakes_do_not_join_hardware(ours, theirs):
    machine = Handshake(hello("a", devices=ours), host("b"), hosts=HOSTS)
    sentence = f"the devices of a are {ours} and those of b are {theirs}; start both with --sim, or none"
    with pytest.raises(HandshakeError, match=sentence):
        machine.receive(hello(devices=theirs))
    assert machine.refusal is not None
    assert sentence in machine.refusal.reason


@pytest.mark.parametrize("theirs", ["", "fakes", "hardware"])
def test_a_team_without_devices_and_an_observer_join_either(theirs):
    Handshake(hello("a"), host("b"), hosts=HOSTS).receive(hello(devices=theirs))
    Handshake(hello("a", devices=theirs), host("b"), hosts=HOSTS).receive(hello())
    observer = hello("ps", role="observer", program=b"", deployment=b"", registry=b"")
    Handshake(hello("a", devices=theirs), host("b"), hosts=HOSTS).receive(observer)
    Handshake(observer, host("b")).receive(hello(devices=theirs))


def test_who_counts_places_from_elsewhere_is_refused():
    ours, theirs = "47.3977420, 8.5455940 at 488.00 m", "47.0000000, 8.0000000 at 400.00 m"
    for mine, yours in ((ours, theirs), (ours, ""), ("", theirs)):
        machine = Handshake(hello("a", origin=mine), host("b"), hosts=HOSTS)
        with pytest.raises(HandshakeError, match=r"give both the same 'frame: \{origin") as told:
            machine.receive(hello(origin=yours))
        assert f"a counts places from {mine or 'each home'} and b from {yours or 'each home'}" in str(
            told.value
        )
    Handshake(hello("a", origin=ours), host("b"), hosts=HOSTS).receive(hello(origin=ours))
    Handshake(hello("a", origin=ours), host("b"), hosts=HOSTS).receive(hello("ps", role="observer"))


def test_two_majorities_of_different_members_need_not_meet():
    ours, theirs = "a lease of 2 s among a, b and c", "a lease of 2 s among a, b and d"
    for mine, yours in ((ours, theirs), (ours, ""), ("", theirs)):
        machine = Handshake(hello("a", recovery=mine), host("b"), hosts=HOSTS)
        with pytest.raises(
            HandshakeError, match="give both the same 'recovery' in their devices files"
        ) as told:
            machine.receive(hello(recovery=yours))
        assert f"on a coordinators are recovered by {mine or 'no host'}" in str(told.value)
        assert f"on b by {yours or 'no host'}" in str(told.value)
    Handshake(hello("a", recovery=ours), host("b"), hosts=HOSTS).receive(hello(recovery=ours))
    Handshake(hello("a", recovery=ours), host("b"), hosts=HOSTS).receive(hello("ps", role="observer"))
    Handshake(hello("ps", role="observer"), host("b")).receive(hello(recovery=theirs))


def test_a_second_host_of_a_name_is_refused_while_the_first_is_linked():
    linked = {"b": 6}
    machine = greeting(linked=linked)
    with pytest.raises(HandshakeError, match="a already has a link to another b"):
        machine.receive(hello())
    del linked["b"]
    assert greeting(linked=linked).receive(hello()) == hello()


def test_nothing_comes_before_the_greeting_nor_a_second_one_after():
    machine = greeting()
    with pytest.raises(WireError, match="received Ping before the handshake"):
        machine.receive(Ping(1))
    with pytest.raises(WireError, match="received Ping before the handshake"):
        machine.admit(Ping(1))
    machine.receive(hello())
    with pytest.raises(WireError, match="a second Hello"):
        machine.admit(hello())


def test_an_observer_takes_any_host_whatever_that_says_of_its_mission():
    for told in (hello(), hello().summary):
        Handshake(LOOK, host("b")).receive(told)


def test_a_refusal_is_shown_without_knowing_who_sent_it():
    with pytest.raises(HandshakeError, match="the peer refused this host: no"):
        greeting().receive(HandshakeRefused("no"))


def test_who_renews_too_seldom_for_others_loses_what_it_has():
    machine = Handshake(hello("a", reservation=6.0), host("b"), hosts=HOSTS)
    with pytest.raises(HandshakeError, match=r"a last 6 s without contact, those of b 20 s; "):
        machine.receive(hello(reservation=20.0))
    Handshake(hello("a", reservation=6.0), host("b"), hosts=HOSTS).receive(hello(reservation=6.0))
    Handshake(hello("a", reservation=6.0), host("b"), hosts=HOSTS).receive(hello("ps", role="observer"))
