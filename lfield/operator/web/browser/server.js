// What the page asks of its server.

// Milliseconds between two looks, also while nobody sees them; and how long one may take before the page says
// that it is not up to date.
const INTERVAL = 200;
const HIDDEN = 2000;
const PATIENCE = 3000;
// Devices take their time to confirm what a button wants.
const LONG_PATIENCE = 20000;

async function answerOf(path, options, patience) {
  const answer = await fetch(path, { cache: "no-store", signal: AbortSignal.timeout(patience), ...options });
  if (!answer.ok) {
    const error = new Error((await answer.text()) || `the server answers ${answer.status}`);
    // It has understood, and has not done it.
    error.refused = answer.status >= 400 && answer.status < 500;
    throw error;
  }
  return answer.json();
}

function post(path, says) {
  const headers = { "Content-Type": "application/json" };
  return answerOf(path, { method: "POST", headers, body: JSON.stringify(says) }, LONG_PATIENCE);
}

// Whoever presses a button hears what came of it; nothing is kept and sent later. `pressed` is when that was, by
// the server's clock (button_orders.py): what is too old by then is refused, but for what makes a team safer.
export const act = (action, pressed) => post("act", { action, pressed });

export const ask = (text) => post("query", { text });

export const samples = () => answerOf("plots", {}, PATIENCE);

// So many milliseconds, more while nobody sees the page, and no more once somebody does.
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

// Calls `take` with a look, again and again, and `fail` with why there is none; returns what ends that. The
// next is asked for when one has been drawn. So nothing queues up for a page that sleeps, and when it wakes it
// is up to date with one.
export function looks(take, fail) {
  let ended = false;
  let line = 0;

  async function look() {
    const answer = await answerOf(`look?after=${line}`, {}, PATIENCE);
    line = answer.log.at(-1)?.serial ?? line;
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
