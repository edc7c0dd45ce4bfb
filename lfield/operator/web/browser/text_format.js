// Numbers as text: short, of constant width, "–" for unknown values.

export const UNKNOWN = "–";

// A number with one digit; a small negative one is 0.0, never -0.0.
export function oneDecimal(value) {
  return (Math.round(value * 10) / 10 + 0).toFixed(1);
}

export function metres(value) {
  return value === null ? UNKNOWN : `${oneDecimal(value)} m`;
}

export function percent(value) {
  return value === null ? UNKNOWN : `${Math.round(value * 100)} %`;
}

// An age in seconds: "0.2 s", "12 s", "3 min", "2 h".
export function age(seconds) {
  if (seconds === null) return UNKNOWN;
  if (seconds < 10) return `${seconds.toFixed(1)} s`;
  if (seconds < 120) return `${Math.round(seconds)} s`;
  if (seconds < 7200) return `${Math.round(seconds / 60)} min`;
  return `${Math.round(seconds / 3600)} h`;
}

export function duration(seconds) {
  if (seconds === null) return "";
  if (seconds >= 1) return `${seconds.toFixed(1)} s`;
  return seconds < 0.01 ? `${(seconds * 1000).toPrecision(2)} ms` : `${Math.round(seconds * 1000)} ms`;
}

// Bytes in units of 1,000: "310 B", "12.3 kB", "1.4 MB".
export function bytes(count) {
  if (count < 1000) return `${count} B`;
  return count < 1e6 ? `${(count / 1e3).toFixed(1)} kB` : `${(count / 1e6).toFixed(1)} MB`;
}

// The measurements of a link: "214 ms, 4.8 % lost, 12.3 kB sent, 9.1 kB received, hop 3.1 kB".
export function linkFigures({ round_trip, loss, sent, received, kinds }) {
  const parts = [];
  if (round_trip !== null) parts.push(duration(round_trip));
  if (loss !== null) parts.push(`${(loss * 100).toFixed(1)} % lost`);
  if (sent !== null) parts.push(`${bytes(sent)} sent`);
  if (received !== null) parts.push(`${bytes(received)} received`);
  for (const [kind, count] of Object.entries(kinds ?? {})) parts.push(`${kind} ${bytes(count)}`);
  return parts.join(", ");
}

// Whether positions are shown in degrees: every vehicle with a position has a global one.
export function isGeographic(vehicles) {
  const located = vehicles.filter((v) => v.position || v.geo_position);
  return located.length > 0 && located.every((v) => v.geo_position);
}

export function position({ position, geo_position }, inDegrees) {
  if (geo_position && (inDegrees || !position)) return `${geo_position[0].toFixed(6)}°, ${geo_position[1].toFixed(6)}°`;
  if (position) return `${oneDecimal(position[1])}, ${oneDecimal(position[0])}`;
  return "no position";
}

// The position in the frame of the team.
export function localPosition({ position }) {
  return position ? `${oneDecimal(position[1])} m east, ${oneDecimal(position[0])} m north in the frame of the team` : "";
}

// A latitude or longitude: "47.40005° N".
export function degrees(value, digits, positive, negative) {
  return `${Math.abs(value).toFixed(digits)}° ${value < 0 ? negative : positive}`;
}

export function clock(at) {
  return new Date(at * 1000).toLocaleTimeString("en-GB");
}
