// The colours of vehicles and coordinators: a name has the same one on the map and in all plots.
const COLOURS = ["#2f6690", "#c8553d", "#588157", "#8d6a9f", "#b08968", "#3a7d7c", "#a3333d", "#5f6c7b"];

const assigned = new Map();

// The n-th name gets the n-th colour: first from the palette, then distinct hues.
export function colourOf(name) {
  const n = assigned.size;
  if (!assigned.has(name)) assigned.set(name, COLOURS[n] ?? `hsl(${Math.round(n * 137.508) % 360} 45% 47%)`);
  return assigned.get(name);
}
