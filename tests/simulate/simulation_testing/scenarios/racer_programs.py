"""Stories of racers: crews that begin calls of several resources and fetch them later, or the first result.

A racer says what a crew says (`crew_programs`), and `won` with the number of the piece where the first result
counted. Its resources are those of crews.
"""

from __future__ import annotations

from simulation_testing.scenarios import crew_programs
from simulation_testing.scenarios.crew_programs import LONG, PIECES, SHORT, UNLIMITED

_RACER = """
coordinator Walker {
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
            real limit = 1.0 + 3.0 * random();
            real most = LONG;
            if (random(4) == 0) { limit = 1000.0; most = UNLIMITED; }
            for (int n = 0; n < got.length(); n = n + 1) got[n] = -1;
            print("opens " + life + " " + i2s(number) + " " + f2s(limit, 3));
            string how = "";
            try {
                within (limit) {
                    how = run(posts, life, number, got, most);
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
    _RACER = _RACER.replace(_name, str(_value))
PROGRAM = crew_programs.PROGRAM.partition("coordinator Walker")[0] + _RACER
