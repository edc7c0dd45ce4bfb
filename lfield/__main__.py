"""`python -m lfield`."""

import sys

from lfield.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
