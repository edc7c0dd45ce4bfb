"""`lfield` and `python -m lfield`: the way in, which imports nothing before somebody would hear a Ctrl-C."""

import sys


def main() -> int:
    """Run the command line of this process; returns the exit status."""
    try:
        from lfield.cli.main import main as command

        return command()
    except KeyboardInterrupt:
        from lfield.exits import INTERRUPTED

        return INTERRUPTED


if __name__ == "__main__":
    sys.exit(main())
