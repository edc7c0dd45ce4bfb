// The ten programs of kernels.L in JavaScript, statement by statement. Arguments: the expected results.
"use strict";

class Tree {
    constructor(depth) {
        this.left = this.right = null;
        if (depth > 0) {
            this.left = new Tree(depth - 1);
            this.right = new Tree(depth - 1);
        }
    }
    count() {
        if (this.left === null) return 1;
        return 1 + this.left.count() + this.right.count();
    }
}

class Link {
    constructor(number, next) {
        this.number = number;
        this.next = next;
    }
}

class Queue {
    constructor() { this.first = this.last = null; }
    put(number) {
        const link = new Link(number, null);
        if (this.last === null) this.first = link;
        else this.last.next = link;
        this.last = link;
    }
    take() {
        const link = this.first;
        this.first = link.next;
        if (this.first === null) this.last = null;
        return link.number;
    }
}

class Counter {
    constructor() { this.value = this.turns = 0; }
    add(number) { this.value = this.value + number; }
    subtract(number) { this.value = this.value - number; }
    halve() { this.value = Math.trunc(this.value / 2); }
    swap() {
        const kept = this.value;
        this.value = this.turns;
        this.turns = kept;
    }
    turn() { this.turns = this.turns + 1; }
}

function loop(n) {
    let x = 1, y = 0.0;
    for (let i = 0; i < n; i++) {
        x = (x * 31 + i) % 65521;
        y = y * 0.5 + x;
    }
    return x + Math.trunc(y);
}

function fib(n) {
    if (n < 2) return n;
    return fib(n - 1) + fib(n - 2);
}

function sort(n) {
    const numbers = new Array(n).fill(0);
    let seed = 42;
    for (let i = 0; i < n; i++) {
        seed = (seed * 1103 + 12345) % 65536;
        numbers[i] = seed;
    }
    for (let i = 1; i < n; i++) {
        const number = numbers[i];
        let k = i - 1;
        while (k >= 0 && numbers[k] > number) {
            numbers[k + 1] = numbers[k];
            k = k - 1;
        }
        numbers[k + 1] = number;
    }
    return numbers[0] + numbers[Math.trunc(n / 2)] + numbers[n - 1];
}

function sieve(n) {
    const crossed = new Array(n + 1).fill(false);
    let primes = 0;
    let i = 2;
    while (i <= n) {
        if (!crossed[i]) {
            primes = primes + 1;
            let k = i + i;
            while (k <= n) {
                crossed[k] = true;
                k = k + i;
            }
        }
        i = i + 1;
    }
    return primes;
}

function filled(n) {
    const m = new Array(n);
    for (let i = 0; i < n; i++) {
        m[i] = new Array(n);
        for (let j = 0; j < n; j++) m[i][j] = i - j;
    }
    return m;
}

function matrix(n) {
    const a = filled(n), b = filled(n);
    let trace = 0.0;
    for (let i = 0; i < n; i++) {
        for (let j = 0; j < n; j++) {
            let sum = 0.0;
            for (let k = 0; k < n; k++) sum = sum + a[i][k] * b[k][j];
            if (i === j) trace = trace + sum;
        }
    }
    return Math.trunc(trace);
}

function strings(n) {
    let sum = 0;
    for (let i = 0; i < n; i++) {
        const words = "agent " + String(i) + " of " + String(n);
        sum = sum + words.length + words.indexOf("of") + Number(words.substring(6, words.indexOf(" of")));
    }
    return sum;
}

function objects(depth, many) {
    let nodes = 0;
    for (let i = 0; i < many; i++) {
        const tree = new Tree(depth);
        nodes = nodes + tree.count();
    }
    return nodes;
}

function exceptions(n) {
    const few = [0, 0, 0, 0];
    let sum = 0;
    for (let i = 0; i < n; i++) {
        try {
            sum = sum + checked(i);
            if (i % 5 === 0) sum = sum + element(few, i);
        } catch (error) {
            sum = sum + (error instanceof RangeError ? 2 : 1);
        }
    }
    return sum;
}

function checked(i) { return risky(i) + 1; }

function risky(i) {
    if (i % 3 === 0) throw new Error("a third");
    return i;
}

// JavaScript does not check array bounds.
function element(array, i) {
    if (i >= array.length) throw new RangeError("no such element");
    return array[i];
}

function dispatch(n) {
    const counter = new Counter();
    let seed = 7;
    for (let i = 0; i < n; i++) {
        seed = (seed * 1103 + 12345) % 65536;
        const what = seed % 5;
        if (what === 0) counter.add(seed);
        else if (what === 1) counter.subtract(i);
        else if (what === 2) counter.halve();
        else if (what === 3) counter.swap();
        else counter.turn();
    }
    return counter.value + counter.turns;
}

function queues(n) {
    const queue = new Queue();
    for (let i = 0; i < 50; i++) queue.put(i);
    let sum = 0;
    for (let i = 0; i < n; i++) {
        const number = queue.take();
        sum = sum + number;
        queue.put((number * 7 + i) % 1000);
    }
    return sum;
}

const KERNELS = {
    loop: () => loop(20000), fib: () => fib(18), sort: () => sort(250), sieve: () => sieve(12000),
    matrix: () => matrix(22), strings: () => strings(1200), objects: () => objects(7, 20),
    exceptions: () => exceptions(4000), dispatch: () => dispatch(8000), queues: () => queues(6000),
};

function round() {
    const told = [];
    Object.entries(KERNELS).forEach(([name, run], which) => {
        let result = 0, runs = 0, took = 0;
        const start = performance.now();
        while (took < 20) {
            result = run();
            runs = runs + 1;
            took = performance.now() - start;
        }
        const expected = Number(process.argv[2 + which]);
        if (result === expected) told.push(`${name} = ${took / runs / 1e3}`);
        else told.push(`error: ${name} gave ${result} instead of ${expected}`);
    });
    console.log([...told, "end"].join("\n"));
}

// Each round is one turn of the timer, so that output is flushed between rounds.
round();
setInterval(round, 250);
