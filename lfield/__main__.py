"""`lfield` and `python -m lfield`: the way in, where a Ctrl-C ends the process quietly at every moment.

While modules are imported nothing has begun that would have to be ended in order, and an exception in the
middle of an import is a traceback, or worse in a module of C: then the system itself ends the process, which
a shell calls 130 too. What Python does before it comes here (its `site`, `runpy`) is not in our hands.
"""

# Not `signal`: it imports `enum` first, which takes longer than all that is done here.
import _signal  # type: ignore[import-not-found]
import sys


def main() -> int:
    """Run the command line of this process; returns the exit status."""
    # Whoever started it may have had it ignored, as a shell does for what runs in the background.
    heard = _signal.getsignal(_signal.SIGINT) is _signal.default_int_handler
    if heard:
        _signal.signal(_signal.SIGINT, _signal.SIG_DFL)
    try:
        from lfield.cli.main import main as command

        return command()
    except KeyboardInterrupt:
        from lfield.exit_status import INTERRUPTED

        return INTERRUPTED
    finally:
        if heard:
            _signal.signal(_signal.SIGINT, _signal.SIG_DFL)


if __name__ == "__main__":
    sys.exit(main())
