"""Entry point of `lfield` and `python -m lfield`; Ctrl-C ends the process without a traceback at any time.

While modules are imported, the default action of SIGINT ends the process (status 130 in a shell): an
exception during an import would print a traceback, or crash in a C module. Python's own start-up (`site`,
`runpy`) is not covered.
"""

# `signal` is not used, because it imports `enum`, which takes longer than this whole module.
import _signal  # type: ignore[import-not-found]  # has no types
import gc
import sys


def main() -> int:
    """Run the command line of this process; returns the exit status."""
    # Modules are no garbage, and the collector would scan them many times during imports. The command enables
    # it later.
    gc.disable()
    # The parent may have set SIGINT to be ignored, as a shell does for background jobs.
    is_default = _signal.getsignal(_signal.SIGINT) is _signal.default_int_handler
    if is_default:
        _signal.signal(_signal.SIGINT, _signal.SIG_DFL)
    try:
        from lfield.cli.main import main as command

        return command()
    except KeyboardInterrupt:
        from lfield.exit_status import INTERRUPTED

        return INTERRUPTED
    finally:
        if is_default:
            _signal.signal(_signal.SIGINT, _signal.SIG_DFL)


if __name__ == "__main__":
    sys.exit(main())
