"""Ten whole hosts on simulated computers: links are cut, hosts crash, and a seed determines the run."""

from __future__ import annotations

import gc
import os
import random
import subprocess
import sys
import weakref
from collections import Counter
from pathlib import Path

import pytest

from lfield.mission.loader import load_mission
from lfield.mission.mission import Mission
from lfield.replication.transfer.coordinator_copies import CoordinatorCopy
from lfield.replication.transfer.effects import Effect
from lfield.replication.transfer.transfer_sender import TransferSender
from lfield.simulate.computers import process_loop
from lfield.simulate.host_fleet import Fleet, FleetOptions, copies
from simulation_testing.fault_injection import FaultRates

HOSTS = 10
PROGRAM = """
resource Post {
    string id;
    init(string[] arg) { id = arg[0]; }
    portal stamp(string who, int number) emit int {
        write(who + " " + i2s(number) + "\\n");
        sleep(0.05);
        return number + 1;
    }
}
coordinator Walker {
    init(string[] arg) {
        Post[] all = findPost();
        int number = 0;
        int at = 0;
        while (true) {
            at = at + 1 + random(all.length() - 1);
            try {
                number = all[at % all.length()].stamp(arg[1], number);
            } catch (UnreachableResourceException lost) {
                number = number + 1000000;
            }
            sleep(0.2);
        }
    }
}
"""
ROUGH = FaultRates(cut=3.0, one_way=6.0, reset=4.0, slow=8.0, kill=20.0, stop=20.0, power=60.0)


@pytest.fixture(scope="module")
def mission(tmp_path_factory: pytest.TempPathFactory) -> Mission:
    return written(tmp_path_factory.mktemp("mission"))


def written(folder: Path) -> Mission:
    lines = [f"//Post:p{n}@host{n}" for n in range(HOSTS)]
    lines += [f"//Walker:w{n}@host{n}?w{n}" for n in range(0, HOSTS, 3)]
    (folder / "mission.L").write_text(PROGRAM)
    (folder / "mission.dL").write_text("\n".join(lines) + "\n")
    return load_mission(folder / "mission.dL")


def one_copy(fleet: Fleet) -> None:
    """Check that one start of a coordinator never has two runnable copies."""
    for start, hosts in copies(fleet).items():
        assert len(hosts) == 1, f"{start} runs on {hosts} at {fleet.now:.3f} s"


def stamps(fleet: Fleet) -> Counter[str]:
    """The number of each stamp."""
    texts = (text for _, _, text in fleet.log)
    return Counter(text.strip() for text in texts if text.startswith("w") and text.endswith("\n"))


@pytest.mark.few(0)
def test_without_faults_all_walkers_hop_and_nothing_is_lost(mission: Mission) -> None:
    fleet = Fleet(mission, seed=1, watch=one_copy)
    fleet.run(30.0)
    recorded = stamps(fleet)
    assert set(recorded.values()) == {1}
    for walker in ("w0", "w3", "w6", "w9"):
        numbers = [int(stamp.split()[1]) for stamp in recorded if stamp.startswith(walker)]
        assert numbers == list(range(len(numbers)))
        assert len(numbers) > 75


@pytest.mark.few(1)
@pytest.mark.parametrize("seed", range(4))
def test_under_cut_links_and_crashes_no_start_has_two_copies(mission: Mission, seed: int) -> None:
    fleet = Fleet(mission, seed, watch=one_copy)
    storm = ROUGH.inject(fleet, random.Random(seed))
    fleet.run(60.0)
    assert len(storm.faults) > 30
    assert sum(stamps(fleet).values()) > 50
    assert any(text.startswith("link to ") and text.endswith(" lost\n") for _, _, text in fleet.log)


@pytest.mark.few(0)
def test_a_sender_that_resumes_what_it_has_sent_is_found(
    mission: Mission, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A sender without an answer resumes the sent coordinator: two copies run."""

    def overdue(self: TransferSender, copy: CoordinatorCopy, now: float) -> list[Effect]:
        return self._resume(copy, "UnreachableResourceException", "it took too long")

    monkeypatch.setattr(TransferSender, "on_deadline", overdue)
    monkeypatch.setattr("lfield.replication.transfer.transfer_sender.MIN_DOUBT_TIME", 0.0)

    def breach(seed: int) -> bool:
        fleet = Fleet(mission, seed, watch=one_copy, options=FleetOptions(unreachable_after=0.5))
        FaultRates(cut=0.5).inject(fleet, random.Random(seed))
        try:
            fleet.run(40.0)
        except AssertionError as found:
            return "runs on" in str(found)
        return False

    assert any(breach(seed) for seed in range(20))


@pytest.mark.few(0)
def test_cut_and_broken_links_alone_repeat_no_call(mission: Mission) -> None:
    fleet = Fleet(mission, seed=5, watch=one_copy)
    FaultRates(cut=2.0, reset=2.0, one_way=3.0, slow=3.0).inject(fleet, random.Random(5))
    fleet.run(100.0)
    recorded = stamps(fleet)
    assert set(recorded.values()) == {1}
    assert sum(recorded.values()) > 300


@pytest.mark.few(0)
def test_the_same_seed_gives_the_same_run_and_another_seed_another(mission: Mission) -> None:
    def digest(seed: int) -> str:
        fleet = Fleet(mission, seed)
        ROUGH.inject(fleet, random.Random(seed))
        fleet.run(20.0)
        return fleet.digest

    assert digest(7) == digest(7)
    assert digest(7) != digest(8)


@pytest.mark.few(0)
def test_a_run_does_not_depend_on_the_process(tmp_path: Path) -> None:
    """Sets of strings have another order in every process, and must have no effect."""
    written(tmp_path)
    command = [
        sys.executable,
        str(Path(__file__).with_name("simulate.py")),
        str(tmp_path / "mission.dL"),
        "--seed",
        "3",
    ]
    command += ["--seconds", "20", "--faults", "cut=2", "kill=10", "power=20", "--quiet"]
    runs = [
        subprocess.run(
            command, env={**os.environ, "PYTHONHASHSEED": salt}, capture_output=True, text=True, check=True
        ).stdout
        for salt in ("1", "2")
    ]
    assert runs[0] == runs[1]
    assert "digest" in runs[0]


def test_closed_fleets_are_freed_when_the_process_has_grown(
    mission: Mission, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(process_loop, "MAX_GROWTH", -(10**9))
    gc.disable()
    try:
        fleet = Fleet(mission)
        fleet.run(0.5)
        fleet.close()
        closed = weakref.ref(fleet)
        del fleet
        assert closed() is not None
        Fleet(mission).close()
        assert closed() is None
    finally:
        gc.enable()
