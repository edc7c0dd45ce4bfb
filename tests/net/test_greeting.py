"""Who is let in, who is not, and what both are told."""

import pytest

from lfield.errors import GreetingError, WireError
from lfield.net.greeting import Greeting
from lfield.wire.coordinators import Accepted
from lfield.wire.messages import ForeignHello, Hello, Ping, Refuse
from lfield.wire.observing import StatusRequest

PROGRAM, DEPLOYMENT, REGISTRY = b"p" * 32, b"d" * 32, b"r" * 32
HOSTS = ("a", "b", "c")


def hello(host: str = "b", **other) -> Hello:
    hashes = {"program": PROGRAM, "deployment": DEPLOYMENT, "registry": REGISTRY}
    fields = {"role": "host", "incarnation": 7} | hashes | other
    return Hello(host=host, **fields)


def greeting(dialled: str | None = None, linked: dict[str, int] | None = None) -> Greeting:
    return Greeting(hello("a", incarnation=1), hosts=HOSTS, dialled=dialled, linked=linked)


def test_a_host_of_the_deployment_is_let_in():
    for dialled in (None, "b"):
        machine = greeting(dialled)
        assert machine.receive(hello()) == hello()
        assert machine.peer == hello()
        machine.admit(Accepted("Tour:one", 1, 1))


def test_where_only_observers_are_let_in():
    machine = Greeting(hello("a", incarnation=1), hosts=HOSTS, observers_only=True)
    with pytest.raises(GreetingError, match="a takes hosts at its address; this socket is for commands"):
        machine.receive(hello())
    assert machine.peer is None
    assert isinstance(machine.refusal, Refuse)
    observer = Hello("observer", "observer", 0)
    machine = Greeting(hello("a", incarnation=1), hosts=HOSTS, observers_only=True)
    assert machine.receive(observer) == observer


def test_the_same_life_may_have_a_second_link():
    assert greeting(linked={"b": 7}).receive(hello()) == hello()


@pytest.mark.parametrize(
    ("message", "sentence"),
    [
        (ForeignHello(8), "a speaks protocol 7 and its peer protocol 8; install the same version"),
        (ForeignHello(3), "a speaks protocol 7 and its peer protocol 3; install the same version"),
        (hello(program=b"q" * 32), "a has program 707070707070 and b has program 717171717171"),
        (hello(deployment=b"q" * 32), "a has deployment 646464646464 and b has deployment 7171"),
        (hello(registry=b"q" * 32), "a has registry 727272727272 and b has registry 7171"),
        (hello(registry=b""), r"b has registry \(none\); start both from the same .capabilities.yaml file"),
        (hello(program=b""), r"b has program \(none\)"),
        (hello(memory=5), "b keeps its coordinators in a journal and a does not; start both with --volatile"),
        (hello("a"), "two hosts call themselves a"),
        (hello("a", incarnation=1), "a reached itself"),
        (hello("d"), "the deployment of a has no host d"),
        (hello("c"), "c answered at the address of b"),
    ],
)
def test_who_does_not_fit_is_told_why(message, sentence):
    machine = greeting(dialled="b")
    with pytest.raises(GreetingError, match=sentence) as caught:
        machine.receive(message)
    assert machine.refusal is not None
    assert machine.refusal.reason in str(caught.value)
    assert machine.peer is None
    theirs = Greeting(hello("b"), hosts=HOSTS, dialled="a")
    with pytest.raises(GreetingError, match=sentence) as told:
        theirs.receive(machine.refusal)
    assert str(told.value).startswith("a refused this host: ")
    assert theirs.refusal is None


@pytest.mark.parametrize(("ours", "theirs"), [("fakes", "hardware"), ("hardware", "fakes")])
def test_fakes_do_not_join_hardware(ours, theirs):
    machine = Greeting(hello("a", devices=ours), hosts=HOSTS)
    sentence = f"the devices of a are {ours} and those of b are {theirs}; start both with --sim, or none"
    with pytest.raises(GreetingError, match=sentence):
        machine.receive(hello(devices=theirs))
    assert machine.refusal is not None
    assert sentence in machine.refusal.reason


@pytest.mark.parametrize("theirs", ["", "fakes", "hardware"])
def test_a_team_without_devices_and_an_observer_join_either(theirs):
    Greeting(hello("a"), hosts=HOSTS).receive(hello(devices=theirs))
    Greeting(hello("a", devices=theirs), hosts=HOSTS).receive(hello())
    observer = hello("ps", role="observer", program=b"", deployment=b"", registry=b"")
    Greeting(hello("a", devices=theirs), hosts=HOSTS).receive(observer)
    Greeting(observer).receive(hello(devices=theirs))


def test_who_counts_places_from_elsewhere_is_refused():
    ours, theirs = "47.3977420, 8.5455940 at 488.00 m", "47.0000000, 8.0000000 at 400.00 m"
    for mine, yours in ((ours, theirs), (ours, ""), ("", theirs)):
        machine = Greeting(hello("a", origin=mine), hosts=HOSTS)
        with pytest.raises(GreetingError, match=r"give both the same 'frame: \{origin") as told:
            machine.receive(hello(origin=yours))
        assert f"a counts places from {mine or 'each home'} and b from {yours or 'each home'}" in str(
            told.value
        )
    Greeting(hello("a", origin=ours), hosts=HOSTS).receive(hello(origin=ours))
    Greeting(hello("a", origin=ours), hosts=HOSTS).receive(hello("ps", role="observer"))


def test_two_majorities_of_different_members_need_not_meet():
    ours, theirs = "a lease of 2 s among a, b and c", "a lease of 2 s among a, b and d"
    for mine, yours in ((ours, theirs), (ours, ""), ("", theirs)):
        machine = Greeting(hello("a", recovery=mine), hosts=HOSTS)
        with pytest.raises(
            GreetingError, match="give both the same 'recovery' in their devices files"
        ) as told:
            machine.receive(hello(recovery=yours))
        assert f"a recovers coordinators by {mine or 'nobody'}" in str(told.value)
        assert f"b by {yours or 'nobody'}" in str(told.value)
    Greeting(hello("a", recovery=ours), hosts=HOSTS).receive(hello(recovery=ours))
    Greeting(hello("a", recovery=ours), hosts=HOSTS).receive(hello("ps", role="observer"))
    Greeting(hello("ps", role="observer")).receive(hello(recovery=theirs))


def test_a_second_host_of_a_name_is_refused_while_the_first_is_linked():
    linked = {"b": 6}
    machine = greeting(linked=linked)
    with pytest.raises(GreetingError, match="a already has a link to another b"):
        machine.receive(hello())
    del linked["b"]
    assert greeting(linked=linked).receive(hello()) == hello()


def test_nothing_comes_before_the_greeting_nor_a_second_one_after():
    machine = greeting()
    with pytest.raises(WireError, match="a Ping came before the greeting"):
        machine.receive(Ping(1))
    with pytest.raises(WireError, match="a Ping came before the greeting"):
        machine.admit(Ping(1))
    machine.receive(hello())
    with pytest.raises(WireError, match="a second greeting"):
        machine.admit(hello())


def test_an_observer_may_look_and_no_more():
    observer = hello("ps", role="observer", program=b"", deployment=b"", registry=b"")
    machine = greeting()
    assert machine.receive(observer) == observer
    machine.admit(StatusRequest())
    machine.admit(Ping(1))
    with pytest.raises(WireError, match="an observer sent a Accepted"):
        machine.admit(Accepted("Tour:one", 1, 1))


def test_an_observer_takes_any_host_and_names_the_deployment_it_wants():
    Greeting(hello("ps", role="observer", program=b"", deployment=b"", registry=b"")).receive(hello())
    picky = Greeting(hello("ps", role="observer", program=b"", deployment=b"x" * 32, registry=b""))
    with pytest.raises(GreetingError, match="ps has deployment 7878"):
        picky.receive(hello())


def test_a_refusal_is_shown_without_knowing_who_sent_it():
    with pytest.raises(GreetingError, match="the peer refused this host: no"):
        greeting().receive(Refuse("no"))


def test_who_renews_too_seldom_for_others_loses_what_it_has():
    machine = Greeting(hello("a", reservation=6.0), hosts=HOSTS)
    with pytest.raises(GreetingError, match=r"a last 6 s unheard and those of b 20 s; give both the same"):
        machine.receive(hello(reservation=20.0))
    Greeting(hello("a", reservation=6.0), hosts=HOSTS).receive(hello(reservation=6.0))
    Greeting(hello("a", reservation=6.0), hosts=HOSTS).receive(hello("ps", role="observer"))
