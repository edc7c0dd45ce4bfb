"""Scenarios of crews: coordinators with concurrent calls to several resources, under time limits.

As in every scenario the mission reports its actions (for `invariants/block_checks.py`): a resource prints the
start, continuation, cancellation and end of a piece of work, a crew the start and outcome of a block. A piece
of work returns a number that identifies it.
"""

from __future__ import annotations

#: The number of pieces of work of a block.
PIECES = 3
#: Seconds of a piece of work that exceeds its limit, of the longest in a block without a limit, and of most
#: others.
LONG, UNLIMITED, SHORT = 25.0, 8.0, 0.6

_SCENARIO = """
resource Post {
    init(string[] arg) { }
    portal work(string life, int number, int piece, real seconds) emit int {
        string what = life + " " + i2s(number) + " " + i2s(piece);
        write("sets " + what + "\\n");
        try {
            for (real gone = 0.0; gone < seconds; gone = gone + 0.2) {
                sleep(0.2);
                write("steps " + what + "\\n");
            }
        } catch (CancelledException e) {
            write("leaves " + what + "\\n");
            throw e;
        }
        write("gives " + what + "\\n");
        return 10 * number + piece;
    }
    portal look() emit int { return 1; }
}
coordinator Walker {
METHODS    init(string[] arg) {
        int drawn = random(1000000000);
        string life = arg[0] + "." + i2s(drawn);
        //recovered
        print("born " + life);
        Post[] posts = findPost();
        int[] got = new int[PIECES];
        int number = 0;
        while (number != s2i(arg[1])) {
            number = number + 1;
FIRST            real limit = 1.0 + 3.0 * random();
            real most = LONG;
            if (random(4) == 0) { limit = 1000.0; most = UNLIMITED; }
            for (int n = 0; n < got.length(); n = n + 1) got[n] = -1;
            print("opens " + life + " " + i2s(number) + " " + f2s(limit, 3));
            string how = "HOW";
            try {
                within (limit) {
                    BLOCK
                }
            } catch (UnreachableResourceException gone) {
                how = "failed";
            } catch (RestartException again) {
                how = "restarted";
            } catch (TimeLimitException late) {
                how = "late";
            } catch (Exception other) {
                how = "threw";
            }
            string all = "";
            for (int n = 0; n < got.length(); n = n + 1) all = all + " " + i2s(got[n]);
            print("closes " + life + " " + i2s(number) + " " + how + all);
            try {
                if (random(3) == 0) posts[random(posts.length())].look();
            } catch (RestartException again) {
                print("told " + life + " " + i2s(number));
            } catch (Exception other) { }
            sleep(0.02 + 0.1 * random());
        }
        print("over " + life);
    }
}
"""
_TOGETHER = """together {
                        for (int piece = 0; piece < PIECES; piece = piece + 1) {
                            real seconds = SHORT;
                            if (random(4) == 0) seconds = most;
                            int at = first + piece;
                            while (at >= posts.length()) at = at - posts.length();
                            got[piece] = posts[at].work(life, number, piece, seconds);
                        }
                    }"""


def scenario_program(block: str, how: str, first: str = "", methods: str = "") -> str:
    """The program of a scenario.

    `block` is the code of a coordinator in a block, after `first`, and `how` its outcome unless the code sets
    another one. `methods` are further methods of the coordinator.
    """
    parts = {"BLOCK": block, "HOW": how, "FIRST": first, "METHODS": methods}
    numbers = {"PIECES": PIECES, "UNLIMITED": UNLIMITED, "LONG": LONG, "SHORT": SHORT}
    program = _SCENARIO
    for name, value in (parts | numbers).items():
        program = program.replace(name, str(value))
    return program


PROGRAM = scenario_program(_TOGETHER, "came-back", "            int first = random(posts.length());\n")
#: Racers start calls of several resources and fetch them later, or the first result. They report like a crew,
#: and `won` with the number of the piece of the first result.
_RUN = """
    private string run(Post[] posts, string life, int number, int[] got, real most) {
        future<int>[] pieces = {};
        int first = random(posts.length());
        for (int piece = 0; piece < PIECES; piece += 1) {
            real seconds = SHORT;
            if (random(4) == 0) seconds = most;
            int at = (first + piece) % posts.length();
            pieces.append(async posts[at].work(life, number, piece, seconds));
        }
        int way = random(3);
        if (way == 0) {
            int winner = pieces.race();
            got[winner] = pieces[winner].await();
            return "won";
        }
        if (way == 1) {
            for (int i = pieces.next(); i >= 0; i = pieces.next()) {
                got[i] = pieces[i].await();
                pieces[i] = null;
            }
        } else {
            for (int i = 0; i < PIECES; i += 1) got[i] = pieces[i].await();
        }
        return "came-back";
    }
"""
RACER_PROGRAM = scenario_program(
    "how = run(posts, life, number, got, most);", "", methods=_RUN.removeprefix("\n")
)
