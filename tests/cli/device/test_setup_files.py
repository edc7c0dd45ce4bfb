"""`lfield setup --apply` with a parameter file of a ground station, on both simulated autopilots."""

from __future__ import annotations

import pytest

pytestmark = pytest.mark.process

#: Files with a harmless value and an unknown name, by autopilot; the name, the old and the new value.
HARMLESS = {
    "ardupilot": ("PILOT_TKOFF_ALT,120\nNO_SUCH_NAME,1\nSERIAL1_PROTOCOL,10\n", "PILOT_TKOFF_ALT", "120"),
    "px4": (
        "# Stack: PX4 Pro\n# Vehicle: Quadrotor\n1\t1\tMIS_TAKEOFF_ALT\t7.5\t9\n1\t1\tNO_SUCH_NAME\t1\t6\n",
        "MIS_TAKEOFF_ALT",
        "7.5",
    ),
}
FORBIDDEN = {
    "ardupilot": "FS_GCS_ENABLE,0\nPILOT_TKOFF_ALT,120\n",
    "px4": "COM_OBL_RC_ACT 0\nMIS_TAKEOFF_ALT 9\n",
}


@pytest.fixture
def setup(lfield, here):
    """Run `lfield setup` on one fake, by autopilot."""

    def start(autopilot):
        arguments = ("--listen", "udp:127.0.0.1:0", "--until-stdin-closes", "--flavour", autopilot)
        endpoint = lfield.start("sim", "mavlink", *arguments, stdin=True).wait_for(r"^ready (\S+)")[1]
        named = ("mavlink", "--endpoint", endpoint, "--set", "ttl=1.0", "--state", lfield.folder / "state")
        return lambda *more: here("setup", *named, *more)

    return start


@pytest.mark.few(1)
@pytest.mark.parametrize("autopilot", HARMLESS)
def test_a_file_is_shown_written_read_back_and_reverted(lfield, setup, autopilot):
    text, name, value = HARMLESS[autopilot]
    file, run = lfield.write("mine.param", text), setup(autopilot)

    result = run("--apply", file)
    assert result.status == 64
    (change,) = [line for line in result.out if line.startswith(f"    {name} from ")]
    before = change.split()[2]
    assert change.endswith(f" to {value}")
    assert any("NO_SUCH_NAME" in line for line in result.out)
    if autopilot == "ardupilot":
        assert any("restart: SERIAL1_PROTOCOL" in line for line in result.out)

    done = run("--apply", file, "--yes")
    assert done.status == 0, done
    assert f"kit.device: {name} was {before} and is now {value}" in done.out
    again = run("--apply", file)
    assert (again.status, "    nothing to write" in again.out) == (0, True)

    backup = lfield.folder / "state" / "setup-1.json"
    back = run("--apply", backup, "--yes")
    assert back.status == 0, back
    assert f"kit.device: {name} was {value} and is {before} again" in back.out
    assert any(line == change for line in run("--apply", file).out)


@pytest.mark.few(1)
@pytest.mark.parametrize("autopilot", FORBIDDEN)
def test_values_that_the_binding_forbids_refuse_the_whole_file(lfield, setup, autopilot):
    run = setup(autopilot)
    # The values of `lfield setup`, which the file would undo.
    assert run("--yes").status == 0
    refused = run("--apply", lfield.write("bad.param", FORBIDDEN[autopilot]), "--yes")
    assert refused.status == 65
    assert not any("is now" in line for line in refused.out)
    assert not (lfield.folder / "state" / "setup-2.json").exists()
    other = HARMLESS["px4" if autopilot == "ardupilot" else "ardupilot"][0]
    assert run("--apply", lfield.write("other.param", other), "--yes").status == 65


def test_the_device_and_the_file_are_validated(lfield, setup, here):
    file = lfield.write("mine.param", "PILOT_TKOFF_ALT,120\n")
    here("setup", "--apply", file, status=64)
    run = setup("ardupilot")
    assert run("--apply", lfield.write("broken.param", "PILOT_TKOFF_ALT\n"), "--yes").status == 65
    assert run("--apply", "none.param").status == 66
