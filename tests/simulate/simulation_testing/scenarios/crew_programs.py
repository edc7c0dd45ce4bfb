"""Stories of crews: coordinators that have several resources work at a time, and give that up after a while.

As in every story the mission says by itself what it does (`invariants/block_checks.py` listens): a resource
writes down every piece of work that it begins, goes on with, leaves and gives; a crew when it opens a block,
and how it has closed it. A piece of work gives a number that tells which one it was.
"""

from __future__ import annotations

#: Of so many pieces of work a block is.
PIECES = 3
#: Seconds that a piece of work takes that nobody will wait for, the longest in a block that has all time, and
#: most others.
LONG, UNLIMITED, SHORT = 25.0, 8.0, 0.6

PROGRAM = """
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
    init(string[] arg) {
        int drawn = random(1000000000);
        string life = arg[0] + "." + i2s(drawn);
        //recovered
        print("born " + life);
        Post[] posts = findPost();
        int[] got = new int[PIECES];
        int number = 0;
        while (number != s2i(arg[1])) {
            number = number + 1;
            int first = random(posts.length());
            real limit = 1.0 + 3.0 * random();
            real most = LONG;
            if (random(4) == 0) { limit = 1000.0; most = UNLIMITED; }
            for (int n = 0; n < got.length(); n = n + 1) got[n] = -1;
            print("opens " + life + " " + i2s(number) + " " + f2s(limit, 3));
            string how = "came-back";
            try {
                within (limit) {
                    together {
                        for (int piece = 0; piece < PIECES; piece = piece + 1) {
                            real seconds = SHORT;
                            if (random(4) == 0) seconds = most;
                            int at = first + piece;
                            while (at >= posts.length()) at = at - posts.length();
                            got[piece] = posts[at].work(life, number, piece, seconds);
                        }
                    }
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
for _name, _value in (("PIECES", PIECES), ("UNLIMITED", UNLIMITED), ("LONG", LONG), ("SHORT", SHORT)):
    PROGRAM = PROGRAM.replace(_name, str(_value))
