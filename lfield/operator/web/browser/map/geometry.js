// Geometry of the map. Pure: numbers in, numbers and SVG paths out.

// Pixels of a tile, and the length of the equator in metres.
const TILE = 256;
const EQUATOR = 2 * Math.PI * 6378137;

// The width of a pixel in metres: of Web Mercator at a latitude, or of a plane in metres.
export function metresPerPixel(zoom, latitude = null) {
  return latitude === null ? 2 ** -zoom : (EQUATOR * Math.cos((latitude * Math.PI) / 180)) / (TILE * 2 ** zoom);
}

// 1, 2, 5 or 10 times a power of ten, rounded up.
export function roundStep(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  return [1, 2, 5, 10].map((step) => step * power).find((step) => step >= value) ?? 10 * power;
}

// The multiples of a step from `low` to `high`.
export function multiples(step, low, high) {
  const found = [];
  for (let n = Math.ceil(low / step); n * step <= high; n++) found.push(n * step);
  return found;
}

// An arc from a to b, so that the two directions are two lines.
export function arc(a, b) {
  const [dx, dy] = [b.x - a.x, b.y - a.y];
  const length = Math.hypot(dx, dy) || 1;
  const [ux, uy] = [dx / length, dy / length];
  const gap = Math.min(18, length / 3);
  const bend = Math.min(40, length / 5);
  const [x, y] = [(a.x + b.x) / 2 - uy * bend, (a.y + b.y) / 2 + ux * bend];
  return `M${a.x + ux * gap} ${a.y + uy * gap}Q${x} ${y} ${b.x - ux * gap} ${b.y - uy * gap}`;
}

// A line through pixels, closed or not; "" for less than two.
export function line(pixels, closed = false) {
  if (pixels.length < 2) return "";
  return `M${pixels.map(({ x, y }) => `${x} ${y}`).join("L")}${closed ? "Z" : ""}`;
}

// Every second point of a track that is longer than `most`, counted from the newest, which stays.
export function thinned(points, most) {
  let remaining = points;
  while (remaining.length > most) remaining = remaining.filter((_, n) => (remaining.length - 1 - n) % 2 === 0);
  return remaining;
}

// Circles without those that are drawn by an earlier one: the same middle and radius within a pixel.
export function distinct(circles) {
  const same = (a, b) => Math.abs(a.x - b.x) < 1 && Math.abs(a.y - b.y) < 1 && Math.abs(a.r - b.r) < 1;
  return circles.filter((circle, n) => circles.findIndex((other) => same(circle, other)) === n);
}
