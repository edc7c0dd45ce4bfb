// Requests of the page to its server.

// Milliseconds between two snapshots, the same in a hidden page, and the time-out of a request.
const INTERVAL = 200;
const HIDDEN = 2000;
const PATIENCE = 3000;
// Time-out of an order: devices need time to confirm it.
const LONG_PATIENCE = 20000;

async function answerOf(path, options, patience) {
  const answer = await fetch(path, { cache: "no-store", signal: AbortSignal.timeout(patience), ...options });
  if (!answer.ok) {
    const error = new Error((await answer.text()) || `the server answers ${answer.status}`);
    // The server has understood the request and refused it.
    error.refused = answer.status >= 400 && answer.status < 500;
    throw error;
  }
  return answer.json();
}

function post(path, body) {
  const headers = { "Content-Type": "application/json" };
  return answerOf(path, { method: "POST", headers, body: JSON.stringify(body) }, LONG_PATIENCE);
}

// Sends an order and returns its result; nothing is stored and sent later. `pressed` is the time of the press by the
// server's clock. The server refuses a late order, except one that makes the team safer (button_orders.py).
export const act = (action, pressed) => post("act", { action, pressed });

// A line of input for an agent of a host that waits for one.
export const enter = (host, agent, text, pressed) => post("type", { host, agent, text, pressed });

export const ask = (text) => post("query", { text });

// Moves a replay; of several requests the server executes the newest.
export const move = (command) => post("replay", command);

// Plans, areas and fences of files, which do not change.
export const drawings = () => answerOf("drawings", {}, PATIENCE);

export const samples = () => answerOf("plots", {}, PATIENCE);

// Waits for some milliseconds, longer while the page is hidden; ends when the page becomes visible.
export function rest(milliseconds) {
  return new Promise((resolve) => {
    const timer = setTimeout(over, document.hidden ? Math.max(milliseconds, HIDDEN) : milliseconds);
    document.addEventListener("visibilitychange", over);
    function over() {
      clearTimeout(timer);
      document.removeEventListener("visibilitychange", over);
      resolve();
    }
  });
}

// Polls snapshots: calls `take` with each, or `fail` with an error; returns a function that ends the polling. The next
// one is requested after drawing, so nothing queues up for an inactive page, and one snapshot brings it up to date.
export function looks(take, fail) {
  let ended = false;
  let line = 0;
  let point = 0;
  let epoch = 0;

  async function look() {
    const answer = await answerOf(`look?after=${line}&point=${point}&epoch=${epoch}`, {}, PATIENCE);
    line = answer.log.at(-1)?.serial ?? (answer.epoch === epoch ? line : 0);
    epoch = answer.epoch;
    point = answer.tracks.newest;
    if (!ended) take(answer);
  }

  async function forever() {
    while (!ended) {
      const began = performance.now();
      await look().catch((error) => ended || fail(error));
      await rest(Math.max(0, began + INTERVAL - performance.now()));
    }
  }

  forever();
  return () => {
    ended = true;
  };
}
