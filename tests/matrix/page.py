"""`python tests/matrix/page.py --write` generates lfield/docs/security-matrix.md from the table."""

from __future__ import annotations

import sys

from security_table import PAGE, page

if __name__ == "__main__":
    if "--write" in sys.argv:
        PAGE.write_text(page(), encoding="utf-8")
    else:
        print(page(), end="")
