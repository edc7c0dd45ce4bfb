// The page of `lfield watch`: what it shows is one look at the team (page_snapshots.py), asked for again and again.
export { default as TeamMap } from "./map.js";
export { default as Halt } from "./halt.js";
export { default as TeamLog } from "./log.js";
export { default as Plots } from "./plots.js";
export { act, ask, looks } from "./server.js";
export * as words from "./words.js";
