// Requests of the page to its server.

// Milliseconds between two snapshots, the same in a hidden page, and the time-out of a request.
const INTERVAL = 200;
const HIDDEN_INTERVAL = 2000;
const TIMEOUT = 3000;
// Time-out of an order: devices need time to confirm it.
const ORDER_TIMEOUT = 20000;

async function request(path, options, timeout) {
  const answer = await fetch(path, { cache: "no-store", signal: AbortSignal.timeout(timeout), ...options });
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
  return request(path, { method: "POST", headers, body: JSON.stringify(body) }, ORDER_TIMEOUT);
}

// Sends an order and returns its result; nothing is stored and sent later. `pressed` is the time of the press by the
// server's clock. The server refuses a late order, except one that makes the team safer (button_orders.py).
export const sendOrder = (action, pressed) => post("order", { action, pressed });

// A line of input for an agent of a host that waits for one.
export const sendInput = (host, agent, text, pressed) => post("input", { host, agent, text, pressed });

export const sendQuery = (text) => post("query", { text });

// Moves a replay; of several requests the server executes the newest.
export const sendReplayCommand = (command) => post("replay", command);

// Plans, areas and fences of files, which do not change.
export const fetchDrawings = () => request("drawings", {}, TIMEOUT);

export const fetchCurves = () => request("plots", {}, TIMEOUT);

// Waits for some milliseconds, longer while the page is hidden; ends when the page becomes visible.
export function sleep(milliseconds) {
  return new Promise((resolve) => {
    const timer = setTimeout(finish, document.hidden ? Math.max(milliseconds, HIDDEN_INTERVAL) : milliseconds);
    document.addEventListener("visibilitychange", finish);
    function finish() {
      clearTimeout(timer);
      document.removeEventListener("visibilitychange", finish);
      resolve();
    }
  });
}

// Polls snapshots: calls `onSnapshot` with each, or `onError` with an error; returns a function that ends the polling.
// The next one is requested after drawing, so nothing queues up for an inactive page, and one snapshot brings it up to
// date.
export function pollSnapshots(onSnapshot, onError) {
  let ended = false;
  let line = 0;
  let point = 0;
  let epoch = 0;

  async function poll() {
    const answer = await request(`snapshot?after=${line}&point=${point}&epoch=${epoch}`, {}, TIMEOUT);
    line = answer.log.at(-1)?.serial ?? (answer.epoch === epoch ? line : 0);
    epoch = answer.epoch;
    point = answer.tracks.newest;
    if (!ended) onSnapshot(answer);
  }

  async function pollForever() {
    while (!ended) {
      const start = performance.now();
      await poll().catch((error) => ended || onError(error));
      await sleep(Math.max(0, start + INTERVAL - performance.now()));
    }
  }

  pollForever();
  return () => {
    ended = true;
  };
}
