/* The ten programs of kernels.L in C, the same way, statement by statement; an exception is a status that every
   caller hands on, and what L leaves to its collector is freed. Arguments: what each gives. */
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

typedef int64_t number;

typedef struct tree { struct tree *left, *right; } tree;
typedef struct link { number value; struct link *next; } link_;
typedef struct { link_ *first, *last; } queue;
typedef struct { number value, turns; } counter;

static number loop(number n) {
    number x = 1;
    double y = 0.0;
    for (number i = 0; i < n; i = i + 1) {
        x = (x * 31 + i) % 65521;
        y = y * 0.5 + x;
    }
    return x + (number)y;
}

static number fib(number n) {
    if (n < 2) return n;
    return fib(n - 1) + fib(n - 2);
}

static number sort(number n) {
    number *numbers = calloc(n, sizeof *numbers);
    number seed = 42;
    for (number i = 0; i < n; i = i + 1) {
        seed = (seed * 1103 + 12345) % 65536;
        numbers[i] = seed;
    }
    for (number i = 1; i < n; i = i + 1) {
        number it = numbers[i];
        number k = i - 1;
        while (k >= 0 && numbers[k] > it) {
            numbers[k + 1] = numbers[k];
            k = k - 1;
        }
        numbers[k + 1] = it;
    }
    number sum = numbers[0] + numbers[n / 2] + numbers[n - 1];
    free(numbers);
    return sum;
}

static number sieve(number n) {
    bool *crossed = calloc(n + 1, sizeof *crossed);
    number primes = 0;
    number i = 2;
    while (i <= n) {
        if (!crossed[i]) {
            primes = primes + 1;
            number k = i + i;
            while (k <= n) {
                crossed[k] = true;
                k = k + i;
            }
        }
        i = i + 1;
    }
    free(crossed);
    return primes;
}

static double **filled(number n) {
    double **m = malloc(n * sizeof *m);
    for (number i = 0; i < n; i = i + 1) {
        m[i] = malloc(n * sizeof **m);
        for (number j = 0; j < n; j = j + 1) m[i][j] = i - j;
    }
    return m;
}

static void emptied(double **m, number n) {
    for (number i = 0; i < n; i = i + 1) free(m[i]);
    free(m);
}

static number matrix(number n) {
    double **a = filled(n), **b = filled(n);
    double trace = 0.0;
    for (number i = 0; i < n; i = i + 1) {
        for (number j = 0; j < n; j = j + 1) {
            double sum = 0.0;
            for (number k = 0; k < n; k = k + 1) sum = sum + a[i][k] * b[k][j];
            if (i == j) trace = trace + sum;
        }
    }
    emptied(a, n);
    emptied(b, n);
    return (number)trace;
}

static number strings(number n) {
    number sum = 0;
    for (number i = 0; i < n; i = i + 1) {
        char words[64], part[64];
        snprintf(words, sizeof words, "agent %lld of %lld", (long long)i, (long long)n);
        number end = strstr(words, " of") - words;
        memcpy(part, words + 6, end - 6);
        part[end - 6] = 0;
        sum = sum + (number)strlen(words) + (strstr(words, "of") - words) + atoll(part);
    }
    return sum;
}

static tree *grown(number depth) {
    tree *made = calloc(1, sizeof *made);
    if (depth > 0) {
        made->left = grown(depth - 1);
        made->right = grown(depth - 1);
    }
    return made;
}

static number count(const tree *it) {
    if (it->left == NULL) return 1;
    return 1 + count(it->left) + count(it->right);
}

static void felled(tree *it) {
    if (it == NULL) return;
    felled(it->left);
    felled(it->right);
    free(it);
}

static number objects(number depth, number many) {
    number nodes = 0;
    for (number i = 0; i < many; i = i + 1) {
        tree *it = grown(depth);
        nodes = nodes + count(it);
        felled(it);
    }
    return nodes;
}

static int __attribute__((noinline)) risky(number i, number *result) {
    if (i % 3 == 0) return 1;
    *result = i;
    return 0;
}

static int __attribute__((noinline)) checked(number i, number *result) {
    int thrown = risky(i, result);
    if (thrown) return thrown;
    *result = *result + 1;
    return 0;
}

static number exceptions(number n) {
    number few[4] = {0}, sum = 0;
    for (number i = 0; i < n; i = i + 1) {
        number result;
        if (checked(i, &result)) {
            sum = sum + 1;
            continue;
        }
        sum = sum + result;
        if (i % 5 == 0) sum = sum + (i < 4 ? few[i] : 2);
    }
    return sum;
}

static void __attribute__((noinline)) add(counter *it, number value) { it->value = it->value + value; }
static void __attribute__((noinline)) subtract(counter *it, number value) { it->value = it->value - value; }
static void __attribute__((noinline)) halve(counter *it) { it->value = it->value / 2; }
static void __attribute__((noinline)) swap(counter *it) {
    number kept = it->value;
    it->value = it->turns;
    it->turns = kept;
}
static void __attribute__((noinline)) turn(counter *it) { it->turns = it->turns + 1; }

static number dispatch(number n) {
    counter it = {0, 0};
    number seed = 7;
    for (number i = 0; i < n; i = i + 1) {
        seed = (seed * 1103 + 12345) % 65536;
        number what = seed % 5;
        if (what == 0) add(&it, seed);
        else if (what == 1) subtract(&it, i);
        else if (what == 2) halve(&it);
        else if (what == 3) swap(&it);
        else turn(&it);
    }
    return it.value + it.turns;
}

static void put(queue *it, number value) {
    link_ *made = malloc(sizeof *made);
    made->value = value;
    made->next = NULL;
    if (it->last == NULL) it->first = made;
    else it->last->next = made;
    it->last = made;
}

static number take(queue *it) {
    link_ *first = it->first;
    number value = first->value;
    it->first = first->next;
    if (it->first == NULL) it->last = NULL;
    free(first);
    return value;
}

static number queues(number n) {
    queue it = {NULL, NULL};
    for (number i = 0; i < 50; i = i + 1) put(&it, i);
    number sum = 0;
    for (number i = 0; i < n; i = i + 1) {
        number value = take(&it);
        sum = sum + value;
        put(&it, (value * 7 + i) % 1000);
    }
    while (it.first != NULL) take(&it);
    return sum;
}

/* The compiler must not know them, or it would run some of the programs itself. */
static volatile number sizes[] = {20000, 18, 250, 12000, 22, 1200, 7, 4000, 8000, 6000};
static volatile number many = 20;
static const char *names[] = {"loop", "fib", "sort", "sieve", "matrix", "strings", "objects", "exceptions", "dispatch",
                              "queues"};

static number run(int which) {
    number n = sizes[which];
    switch (which) {
    case 0: return loop(n);
    case 1: return fib(n);
    case 2: return sort(n);
    case 3: return sieve(n);
    case 4: return matrix(n);
    case 5: return strings(n);
    case 6: return objects(n, many);
    case 7: return exceptions(n);
    case 8: return dispatch(n);
    default: return queues(n);
    }
}

static double now(void) {
    struct timespec it;
    clock_gettime(CLOCK_MONOTONIC, &it);
    return it.tv_sec + it.tv_nsec * 1e-9;
}

int main(int count, char **words) {
    for (;;) {
        for (int which = 0; which < 10 && which + 1 < count; which++) {
            number result = 0, runs = 0, expected = atoll(words[which + 1]);
            double start = now(), took = 0.0;
            while (took < 0.02) {
                result = run(which);
                runs = runs + 1;
                took = now() - start;
            }
            if (result == expected) printf("%s = %.9g\n", names[which], took / runs);
            else printf("error: %s gave %lld instead of %lld\n", names[which], (long long)result, (long long)expected);
        }
        printf("end\n");
        fflush(stdout);
        usleep(250000);
    }
}
