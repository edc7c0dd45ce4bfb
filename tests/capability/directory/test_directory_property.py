"""Reports are lost, late or repeated, and links fail: after one exchange both sides have equal values."""

from __future__ import annotations

from directory_team import AGENTS, REGISTRY, Seat
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from lfield.capability.directory.agent_directory import ANSWER_REUSE_SECONDS
from lfield.capability.directory.directory_delta import AgentCondition, AttributeSample, Unavailability
from lfield.host.directory_updates.directory_codec import DirectoryCodec
from lfield.wire.codec import decode, encode
from lfield.wire.framing import HEADER_SIZE

OWN = ("rover1", "arm2", "shelf")
VALUES = {
    "battery": st.sampled_from([0.0, 0.5, 0.501, 0.51, 1.0]),
    "steps": st.integers(-3, 3),
    "armed": st.booleans(),
    "mode": st.sampled_from(["hold", "fly", ""]),
}
LIVE = {"rover1": ("battery",), "arm2": tuple(VALUES), "shelf": ()}
TROUBLES = st.sampled_from([None, ("fc: in its safe state hold: why", None), ("fc: no message", 3.0)])


class Exchange(RuleBasedStateMachine):
    """bravo reports to alpha over links with any faults except changed messages."""

    @initialize()
    def begin(self):
        self.life, self.linked, self.reports = 7, False, DirectoryCodec(REGISTRY, AGENTS)
        self.under_way, self.sent, self.moment = [], [], ANSWER_REUSE_SECONDS
        self.alpha, self.bravo = Seat("alpha"), Seat("bravo", life=7)
        self.conditions = {}
        self.ages = {}

    def post(self, news):
        if news is not None:
            self.sent.append(encode(self.reports.encode(news, self.bravo.clock.monotonic())))
            self.under_way.append(self.sent[-1])

    def deliver(self, frame):
        report = decode(frame[HEADER_SIZE - 1], frame[HEADER_SIZE:])
        self.hear()
        self.alpha.directory.on_delta(
            "bravo", self.reports.decode("bravo", report, self.alpha.clock.monotonic())
        )

    def hear(self):
        # Candidates are cached for a moment; let it pass before a message.
        self.time_passes(self.moment)
        self.alpha.receive("bravo")
        self.ages.clear()

    @rule(agent=st.sampled_from(OWN), trouble=TROUBLES, data=st.data())
    def change(self, agent, trouble, data):
        now = self.bravo.clock.monotonic()
        known = [name for name in LIVE[agent] if data.draw(st.booleans())]
        samples = {
            name: AttributeSample(
                data.draw(VALUES[name]), now - data.draw(st.sampled_from([0.0, 1.0, 30.0])), now
            )
            for name in known
        }
        unknown = {name: f"fc has not reported {name}" for name in LIVE[agent] if name not in known}
        reason = None if trouble is None else Unavailability(trouble[0], trouble[1] and now - trouble[1])
        self.conditions[agent] = AgentCondition(reason, samples, unknown)
        self.bravo.directory.set_own(agent, self.conditions[agent])

    @rule()
    def tell(self):
        self.post(self.bravo.directory.next_delta())

    @rule(seconds=st.sampled_from([0.1, 1.0, 20.0]))
    def wait(self, seconds):
        self.time_passes(seconds)

    def time_passes(self, seconds):
        self.alpha.clock.advance(seconds)
        self.bravo.clock.advance(seconds)
        for agent, condition in self.conditions.items():
            aged = {
                name: AttributeSample(s.value, s.when, self.bravo.clock.monotonic())
                for name, s in condition.samples.items()
            }
            self.conditions[agent] = AgentCondition(condition.unavailability, aged, condition.unknown)
            self.bravo.directory.set_own(agent, self.conditions[agent])

    @precondition(lambda self: self.under_way)
    @rule(data=st.data(), kept=st.booleans())
    def arrive(self, data, kept):
        place = data.draw(st.integers(0, len(self.under_way) - 1))
        self.deliver(self.under_way[place] if kept else self.under_way.pop(place))

    @precondition(lambda self: self.under_way)
    @rule(data=st.data())
    def lose(self, data):
        self.under_way.pop(data.draw(st.integers(0, len(self.under_way) - 1)))

    @precondition(lambda self: self.linked)
    @rule()
    def ping(self):
        self.hear()

    @precondition(lambda self: self.linked)
    @rule()
    def unlink(self):
        self.linked = False
        self.alpha.wires.down_since["bravo"] = self.alpha.clock.monotonic()
        self.alpha.directory.on_link_down("bravo")

    @precondition(lambda self: not self.linked)
    @rule(restarted=st.booleans())
    def link(self, restarted):
        if restarted:
            self.life += 1
            clock = self.bravo.clock
            self.bravo = Seat("bravo", clock, self.life)
            for agent, condition in self.conditions.items():
                self.bravo.directory.set_own(agent, condition)
        self.linked = True
        self.alpha.wires.down_since.pop("bravo", None)
        self.hear()
        self.alpha.directory.on_link_up("bravo", self.life)
        self.post(self.bravo.directory.full_delta())

    @invariant()
    def ages_never_shrink_without_news(self):
        for candidate in self.alpha.directory.all_candidates():
            for name, fact in candidate.facts.items():
                key = candidate.agent, name
                assert fact.age >= self.ages.get(key, 0.0) - 1e-9
                self.ages[key] = fact.age

    @invariant()
    def candidates_stay_in_order(self):
        assert [c.agent for c in self.alpha.directory.all_candidates()] == [
            a.id for a in AGENTS if a.type in REGISTRY.providers
        ]

    def teardown(self):
        """One exchange on a new link, on which everything is sent. Late messages have no effect after it."""
        if not hasattr(self, "alpha"):
            return
        if self.linked:
            self.unlink()
        for frame in self.under_way:
            self.deliver(frame)
        self.time_passes(ANSWER_REUSE_SECONDS)
        self.moment = 0.0
        self.bravo.directory.next_delta()
        self.under_way.clear()
        self.link(restarted=False)
        for frame in [*self.under_way, *reversed(self.sent)]:
            self.deliver(frame)
        for agent, condition in self.conditions.items():
            self.same(agent, condition)

    def same(self, agent, condition):
        found = self.alpha.candidate(agent)
        self.same_trouble(found.refusal, condition.unavailability)
        assert found.unknown == dict(condition.unknown)
        assert {n for n in found.facts if n in LIVE[agent]} == set(condition.samples)
        for name, sample in condition.samples.items():
            fact = found.facts[name]
            if isinstance(sample.value, float):
                assert abs(fact.value - sample.value) <= 0.005
            else:
                assert fact.value == sample.value
            half_age = REGISTRY.attributes[name].max_age / 2
            assert abs(fact.age - (sample.at - sample.when)) <= max(half_age, 1.0) + 1e-6

    def same_trouble(self, refusal, trouble):
        if trouble is None or trouble.since is None:
            assert refusal == (trouble.reason if trouble else "")
            return
        reason, _, seconds = refusal.removesuffix(" s").rpartition(" for ")
        assert reason == trouble.reason
        # Up to one second may be unreported, and rounding may add half a second.
        assert abs(float(seconds) - (self.bravo.clock.monotonic() - trouble.since)) <= 1.51


Exchange.TestCase.settings = settings(
    max_examples=80, stateful_step_count=40, deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
TestExchange = Exchange.TestCase
