"""What a report says of an exception that went through a `together` or a `finally`: every line once."""

from __future__ import annotations

from joined_hosts import Joined

from lfield.testing.golden import compile_text

THROWING = """
resource Post {
  init(string[] arg) { }
  portal fail(int n) {
    try { outer(n); }
    finally { sleep(0.1); }
  }
  private void outer(int n) {
    try { if (n > 0) outer(n - 1); else throw new IndexException("gone"); }
    finally { sleep(0.1); }
  }
}
coordinator Boss {
  init(string[] arg) {
    Post[] r = findPost();
    together {
      r[0].fail(1);
    }
  }
}
"""


def test_a_report_has_every_line_once() -> None:
    joined = Joined(compile_text(THROWING), 1)
    joined.run()
    assert joined.places[0].endings[0].report.splitlines() == [
        "IndexException: gone",
        "    at Post.outer (golden.L:9) in r0",
        "    at Post.outer (golden.L:9) in r0",
        "    at Post.fail (golden.L:5) in r0",
        "    at Boss.init (golden.L:16)",
    ]
