"""Scripts that run missions under test, such as those that print the tables of examples."""

from __future__ import annotations

import sys
from collections.abc import Callable

from lfield import exit_status
from lfield.errors import LfieldError, ProgramError
from lfield.text.message_tables import render_findings


def run_script(main: Callable[[], None]) -> None:
    """Run the main function of a script; an error of lfield ends it with its message and its exit status."""
    try:
        main()
    except ProgramError as error:
        print(render_findings(error.diagnostics), file=sys.stderr)
        sys.exit(error.exit_status)
    except LfieldError as error:
        print(error, file=sys.stderr)
        sys.exit(error.exit_status)
    except KeyboardInterrupt:
        sys.exit(exit_status.INTERRUPTED)
