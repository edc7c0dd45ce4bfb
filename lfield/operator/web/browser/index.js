// The page of `lfield watch`. It polls snapshots of the team (page_snapshots.py) and draws the newest.
export { default as TeamMap } from "./map/team_map.js";
export { default as OrderStatus } from "./order_status.js";
export { default as TeamLog } from "./log.js";
export { Program, Replay } from "./replay.js";
export { default as Plots } from "./plots.js";
export { default as OperatorInput } from "./input.js";
export { fetchDrawings, pollSnapshots, sendInput, sendOrder, sendQuery } from "./server.js";
export * as format from "./text_format.js";
// Pure parts, for tests.
export * as geometry from "./map/geometry.js";
export * as labels from "./map/labels.js";
