// Numbers in words, as an instrument shows them: short, of constant width, "–" for what is not known.

export const NOT_KNOWN = "–";

export function metres(value) {
  return value === null ? NOT_KNOWN : `${value.toFixed(1)} m`;
}

export function share(value) {
  return value === null ? NOT_KNOWN : `${Math.round(value * 100)} %`;
}

// An age in seconds: "0.2 s", "12 s", "3 min", "2 h".
export function age(seconds) {
  if (seconds === null) return NOT_KNOWN;
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

export function place(vehicle) {
  const { place, earth } = vehicle;
  if (place) return `${place[1].toFixed(1)}, ${place[0].toFixed(1)}`;
  if (earth) return `${earth[0].toFixed(5)}°, ${earth[1].toFixed(5)}°`;
  return "no position";
}

export function clock(at) {
  return new Date(at * 1000).toLocaleTimeString("en-GB");
}
