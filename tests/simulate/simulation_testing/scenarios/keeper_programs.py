"""Scenarios of keepers: coordinators that reserve one or two resources, together or in sequence.

As in every scenario the mission reports its actions (for `invariants/reservation_checks.py`): a resource
prints every call that starts, and whether the caller has reserved it; a keeper prints the outcome of each
round.
"""

from __future__ import annotations

#: Seconds of a call, and of the few calls that take longer than any lease of a scenario.
SHORT, LONG = 0.4, 6.0

PROGRAM = """
resource Post {
    int used;
    init(string[] arg) { used = 0; }
    portal use(string life, int number, string how, real seconds) {
        write("uses " + life + " " + i2s(number) + " " + how + "\\n");
        used = used + 1;
        sleep(seconds);
    }
}
coordinator Walker {
    init(string[] arg) {
        int drawn = random(1000000000);
        string life = arg[0] + "." + i2s(drawn);
        //recovered
        print("born " + life);
        Post[] posts = findPost();
        int number = 0;
        while (number != s2i(arg[1])) {
            number = number + 1;
            Post one = posts[random(posts.length())];
            Post other = posts[random(posts.length())];
            int kind = random(8);
            real seconds = SHORT * random();
            if (random(8) == 0) seconds = LONG;
            string how = "done";
            try {
                if (kind == 0) {
                    one.use(life, number, "alone", seconds);
                } else if (kind == 1) {
                    reserve (one) {
                        one.use(life, number, "inside", seconds);
                        reserve (other) {
                            other.use(life, number, "inside", seconds);
                            one.use(life, number, "inside", 0.1);
                        }
                        one.use(life, number, "inside", 0.1);
                    }
                } else if (kind == 2) {
                    reserve (one) {
                        sleep(LONG * random());
                        one.use(life, number, "inside", 0.1);
                    }
                } else {
                    Post[] both = new Post[2];
                    both[0] = one;
                    both[1] = other;
                    reserve (both) {
                        one.use(life, number, "inside", seconds);
                        other.use(life, number, "inside", 0.1);
                        one.use(life, number, "inside", 0.1);
                        both[random(2)].use(life, number, "inside", 0.1);
                    }
                }
            } catch (UnreachableResourceException gone) {
                how = "failed";
            } catch (RestartException again) {
                how = "restarted";
            } catch (ReservedException others) {
                how = "taken";
            } catch (ReservationLostException late) {
                how = "lost";
            } catch (Exception any) {
                how = "threw";
            }
            print("quits " + life + " " + i2s(number) + " " + how);
            sleep(0.02 + 0.1 * random());
        }
        print("over " + life);
    }
}
"""
for _name, _value in (("LONG", LONG), ("SHORT", SHORT)):
    PROGRAM = PROGRAM.replace(_name, str(_value))
