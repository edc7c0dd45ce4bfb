// The legend below the map: the kinds of signs that are drawn now.
import * as format from "../text_format.js";

const SIGNS = {
  track: "M1 10L9 3L15 9L23 2", way: "M2 7H22", area: "M2 2H22V12H2Z", inside: "M2 2H22V12H2Z", outside: "M2 2H22V12H2Z", limit: "M2 12A10 10 0 0 1 22 12", edge: "M2 12A10 10 0 0 1 22 12",
  rally: "M12 4a3 3 0 1 0 .01 0", home: "M12 1a6 6 0 1 0 .01 0M10 4V10M14 4V10M10 7H14", mind: "M12 1L18 7L12 13L6 7Z", hop: "M2 10Q12 -2 22 10", dock: "M7 2H17V12H7Z", latched: "M12 1a6 6 0 1 0 .01 0",
};

// Files by kind of drawing: "north.plan, south.plan".
function files(drawings, kind) {
  return [...new Set(drawings.filter((drawing) => drawing.kind === kind).map((drawing) => drawing.name))].join(", ");
}

// "limits of ada and bob: 80.0 m from home, 10.0 m above home"; one for each different text.
function limits(vehicles) {
  const found = {};
  for (const v of vehicles) {
    const parts = [];
    if (v.radius !== null) parts.push(`${format.metres(v.radius)} from home`);
    if (v.ceiling !== null) parts.push(`${format.metres(v.ceiling)} above home`);
    if (parts.length) (found[parts.join(", ")] ??= []).push(v.agent);
  }
  return Object.entries(found).map(([text, agents]) => `limit of ${agents.join(", ")}: ${text}`);
}

export default {
  props: { team: Object, drawnKinds: Object, drawings: Array },
  template: `
  <ul class="legend" data-testid="legend" aria-label="Legend of the map">
    <li v-for="entry in entries" :key="entry.text" :data-testid="'legend-' + entry.kind"><svg viewBox="0 0 24 14" aria-hidden="true"><path :class="entry.kind" :d="entry.sign"/></svg>{{ entry.text }}</li>
  </ul>`,
  computed: {
    entries() {
      const { team, drawnKinds, drawings } = this;
      const found = [];
      const add = (kind, text, sign = SIGNS[kind]) => found.push({ kind, text, sign });
      if (drawnKinds.track) add("track", "track");
      for (const [kind, what] of Object.entries({ way: "plan", area: "area", inside: "fence, stay inside", outside: "fence, stay outside", rally: "rally points" })) {
        const named = files(drawings, kind);
        if (named) add(kind, `${what}: ${named}`);
      }
      for (const text of limits(team.vehicles)) add("limit", text, drawnKinds.limit ? SIGNS.limit : "");
      if (drawnKinds.edge) add("edge", "fence of the autopilot");
      if (drawnKinds.home) add("home", "home");
      if (drawnKinds.mind) add("mind", "coordinator");
      if (drawnKinds.hop) add("hop", "hop of the last 20 s");
      if (drawnKinds.dock) add("dock", "host without a vehicle");
      if (drawnKinds.latched) add("latched", "in its safe state");
      return found;
    },
  },
};
