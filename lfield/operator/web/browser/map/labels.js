// Places the labels of points so that none hides another one or a point. Pure: pixels in, pixels out.

// Distances of a label from the edge of its point, nearest first. A distant label gets a line to its point.
const DISTANCES = [2, 14, 30, 50, 74, 102, 134, 170];
// Directions in degrees clockwise from the right, in order of preference; the last eight only for distant labels.
const DIRECTIONS = [0, 180, 45, -45, 135, -135, 90, -90, 22, -22, 158, -158, 68, -68, 112, -112];
const NEAR = 8;
// Least distance of two labels.
const GAP = 2;

const SLOTS = DISTANCES.flatMap((distance, ring) => DIRECTIONS.slice(0, ring ? DIRECTIONS.length : NEAR).map((degrees) => ({ ring, distance, turn: (degrees * Math.PI) / 180 })));

function overlaps(a, b) {
  return a.left < b.right + GAP && b.left < a.right + GAP && a.top < b.bottom + GAP && b.top < a.bottom + GAP;
}

// The labels with a `box` that no earlier one and no obstacle hides, in order of importance.
export function separate(labels, obstacles) {
  const occupied = [...obstacles];
  return labels.filter(({ box }) => !occupied.some((other) => overlaps(box, other)) && occupied.push(box));
}

export function boxAround({ x, y, radius }) {
  return { left: x - radius, right: x + radius, top: y - radius, bottom: y + radius };
}

// The box of a label in a slot. It touches its point with the side or corner that faces it.
function boxAt({ x, y, radius, width, height }, { distance, turn }) {
  const [dx, dy] = [Math.cos(turn), Math.sin(turn)];
  const share = (d) => (d > 0.3 ? 0 : d < -0.3 ? 1 : 0.5);
  const left = x + dx * (radius + distance) - width * share(dx);
  const top = y + dy * (radius + distance) - height * share(dy);
  return { left, top, right: left + width, bottom: top + height };
}

// Labels in order of importance: {key, x, y, radius, width, height, near}; a `near` one is omitted rather than
// distant. Obstacles are boxes, `size` is that of the map. `before` are the slots of the last call: a label stays in its
// slot while that is free, and at most one distance farther than the nearest free one. Gives {key: {slot, left, top, line}}; a label without a free slot is omitted.
export function placedLabels(labels, obstacles, size, before = {}) {
  const occupied = [...obstacles];
  const placed = {};
  const fits = (box) => box.left >= 0 && box.top >= 0 && box.right <= size.x && box.bottom <= size.y && !occupied.some((other) => overlaps(box, other));
  for (const label of labels) {
    const slots = [...SLOTS.keys()].slice(0, label.near ? NEAR : SLOTS.length);
    const free = (n) => fits(boxAt(label, SLOTS[n]));
    const nearest = slots.find(free);
    if (nearest === undefined) continue;
    const last = before[label.key] ?? nearest;
    const slot = slots.includes(last) && SLOTS[last].ring <= SLOTS[nearest].ring + 1 && free(last) ? last : nearest;
    const box = boxAt(label, SLOTS[slot]);
    occupied.push(box);
    placed[label.key] = { slot, left: box.left, top: box.top, line: slot < NEAR ? "" : lineTo(label, box) };
  }
  return placed;
}

// From the edge of a point to the nearest place of a box.
function lineTo({ x, y, radius }, box) {
  const [bx, by] = [Math.min(Math.max(x, box.left), box.right), Math.min(Math.max(y, box.top), box.bottom)];
  const length = Math.hypot(bx - x, by - y) || 1;
  return `M${(x + ((bx - x) * radius) / length).toFixed(1)} ${(y + ((by - y) * radius) / length).toFixed(1)}L${bx.toFixed(1)} ${by.toFixed(1)}`;
}
