"""Reports of an exception that went through a `together` or a `finally`: every line appears once."""

from __future__ import annotations

from joined_hosts import JoinedHosts

from lfield.testing.golden import compile_text
from lfield.vm.inspection.block_view import view

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


OWN = """
class Boom { public int n; public Boom(int n) { this.n = n; } }
resource Post { init(string[] arg) { } portal boom(int n) { throw new Boom(n); } }
coordinator Boss {
  init(string[] arg) {
    Post[] r = findPost();
    try together { r[0].boom(1); r[0].boom(2); }
    catch (Boom b) { Exception e = b; sleep(9.0); print(b.n + e.others().length()); }
  }
}
"""


def test_other_exceptions_of_an_object_are_not_shown_as_fields() -> None:
    joined = JoinedHosts(compile_text(OWN), 1)
    joined.run(until=5.0)
    frame_locals = dict(view(joined.boss[1].block, joined.program).threads[0].frames[0].locals)
    assert frame_locals["b"].startswith("Boom @")
    assert frame_locals["b"].endswith(" {1}")
    joined.run()
    assert joined.printed == ["r0.boom() also failed: Boom {2}", "2"]


def test_a_report_has_each_line_once() -> None:
    joined = JoinedHosts(compile_text(THROWING), 1)
    joined.run()
    assert joined.places[0].endings[0].report.splitlines() == [
        "IndexException: gone",
        "    at Post.outer (golden.L:9) in r0",
        "    at Post.outer (golden.L:9) in r0",
        "    at Post.fail (golden.L:5) in r0",
        "    at Boss.init (golden.L:16)",
    ]
