"""External bytes make no decoder raise other than lfield errors, hang, or use much memory.

`make fuzz-decoders` does the same with any number of inputs.
"""

from __future__ import annotations

import random

import pytest
from decoder_corpus import corpus_of
from decoder_mutations import mutated
from decoder_reach import READS, UNREACHED, unreached
from decoder_target import BYTES, bounded, peak_of
from decoder_targets import TARGETS
from targets_of_links import payloads, unpack

from lfield.wire import codec
from lfield.wire.framing import frame

#: Mutations of each decoder's seeds in this test.
INPUTS = 60


@pytest.mark.few(8)
@pytest.mark.parametrize("name", TARGETS)
def test_known_inputs_are_decoded_within_the_limits(name):
    target = TARGETS[name]
    target.decode(target.good[0])
    for data in (*target.good[: max(3, 40 // target.share)], *corpus_of(name)):
        with bounded():
            assert peak_of(target, data) < BYTES


@pytest.mark.few(6)
@pytest.mark.parametrize("name", TARGETS)
def test_mutated_inputs_are_decoded_or_refused_within_the_limits(name):
    target, rng = TARGETS[name], random.Random(name)
    for _ in range(max(3, INPUTS // target.share)):
        data = mutated(target, rng.choice(target.good), rng, rng.choice(target.good))
        with bounded():
            target.decode(data)


@pytest.mark.few(0)
@pytest.mark.parametrize("name", TARGETS)
def test_same_seed_makes_the_same_inputs(name):
    target = TARGETS[name]

    def made():
        rng = random.Random(3)
        return [mutated(target, target.good[0], rng) for _ in range(20)]

    assert made() == made()
    assert len(set(made())) > 5


@pytest.mark.few(0)
@pytest.mark.parametrize("name", READS)
def test_every_decoding_line_is_reached_except_listed_ones(name):
    assert unreached(TARGETS[name], READS[name]) == set(UNREACHED.get(name, ()))


def test_every_frame_kind_is_in_the_seeds_of_its_decoders():
    kinds = {*codec.HANDSHAKE_LIMITS, *codec.limits("host", 1), *codec.limits("observer", 1)}
    assert set(payloads()) == kinds
    for name in ("greeting", "control"):
        assert {kind for kind, _ in map(unpack, TARGETS[name].good)} == kinds
    for kind in kinds:
        framed = frame(kind, payloads()[kind][0])
        assert any(framed in data for data in TARGETS["stream"].good)
