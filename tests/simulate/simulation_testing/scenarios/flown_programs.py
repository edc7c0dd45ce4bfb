"""Scenarios of keepers whose resources have devices: reserved devices move, one or two at a time.

As in `keeper_programs.py` the mission reports its actions, and each command of a device identifies its
caller: a number that the coordinator has drawn, its round, and a step that is unique within the round.
"""

from __future__ import annotations

from simulation_testing.scenarios.keeper_programs import LONG

PROGRAM = """
resource Post {
    Mavlink fc;
    init(string[] arg) { }
    portal use(string life, int drawn, int number, int step, string how, int steps) {
        write("uses " + life + " " + i2s(number) + " " + how + "\\n");
        fc.release();
        int sum = 0;
        for (int n = 0; n < steps; n = n + 1) {
            fc.setVelocity(i2f(drawn), i2f(number), i2f(100 * step + n));
            for (int k = 0; k < 50; k = k + 1) sum = sum + k;
            sleep(0.1);
        }
        fc.hold();
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
            int steps = 1 + random(4);
            if (random(8) == 0) steps = 30;
            string how = "done";
            try {
                if (kind == 0) {
                    one.use(life, drawn, number, 0, "alone", steps);
                } else if (kind == 1) {
                    reserve (one) {
                        one.use(life, drawn, number, 0, "inside", steps);
                        reserve (other) {
                            other.use(life, drawn, number, 1, "inside", steps);
                            one.use(life, drawn, number, 2, "inside", 1);
                        }
                        one.use(life, drawn, number, 3, "inside", 1);
                    }
                } else if (kind == 2) {
                    reserve (one) {
                        sleep(LONG * random());
                        one.use(life, drawn, number, 0, "inside", 1);
                    }
                } else {
                    Post[] both = new Post[2];
                    both[0] = one;
                    both[1] = other;
                    reserve (both) {
                        if (kind < 6) {
                            real limit = 1.0 + 3.0 * random();
                            within (limit) {
                                together {
                                    one.use(life, drawn, number, 0, "begun", steps);
                                    other.use(life, drawn, number, 1, "begun", 2);
                                }
                            }
                        } else {
                            one.use(life, drawn, number, 0, "inside", steps);
                            other.use(life, drawn, number, 1, "inside", 1);
                        }
                        one.use(life, drawn, number, 2, "inside", 1);
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
""".replace("LONG", str(LONG))
