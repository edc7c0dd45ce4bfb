"""The exit status of a desk command that not all robots have carried out."""

from __future__ import annotations

import pytest

from lfield import exit_status
from lfield.cli.fleet.desk import failure_status, report_unreached
from lfield.errors import AddressError, HandshakeError, LfieldError, NoListener, WireError

REFUSED = HandshakeError("cannot write state.json: No space left on device")
UNREACHED = AddressError("127.0.0.1:2", "no answer within 8 s")
OTHER = HandshakeError("carol answered at an address of bravo", answered_by="carol")


@pytest.mark.parametrize(
    ("errors", "status"),
    [
        ([], exit_status.DONE),
        ([REFUSED], exit_status.FAILED),
        ([UNREACHED], exit_status.UNAVAILABLE),
        ([NoListener("127.0.0.1:2")], exit_status.UNAVAILABLE),
        ([WireError("not TLS")], exit_status.UNAVAILABLE),
        ([OTHER], exit_status.UNAVAILABLE),
        ([REFUSED, UNREACHED], exit_status.UNAVAILABLE),
    ],
)
def test_a_refusal_and_an_unreachable_robot_have_their_own_statuses(
    errors: list[LfieldError], status: int
) -> None:
    assert failure_status({str(number): error for number, error in enumerate(errors)}) == status


def test_a_robot_at_a_wrong_address_is_reported_as_not_reached(capsys) -> None:
    report_unreached({"alpha": REFUSED, "bravo": OTHER, "carol": UNREACHED}, "")
    codes = [line.split(":")[1].strip() for line in capsys.readouterr().err.splitlines()]
    assert codes == ["REFUSED", "NOT REACHED", "NOT REACHED"]
