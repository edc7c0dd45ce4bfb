// The map: Leaflet moves, zooms and draws the background, if there is one; vehicles and hops are drawn above it. Every
// layer comes from the page's own server.
import { leaflet as L } from "nicegui-leaflet";
import * as words from "./words.js";

// A hop is drawn for this time (s), and fades.
const HOP_SHOWN = 20;
const GRID_AT_LEAST = 48;
// Lines of latitude and longitude are further apart, because each has a label.
const DEGREES_AT_LEAST = 96;
// Labels at the left edge are drawn to the right of the zoom buttons.
const RIGHT_OF_ZOOM = 56;
// Distance of a coordinator below its anchor, of the next one below it, and half its height (pixels).
const BELOW = 14;
const EACH_BELOW = 13;
const HALF = 7;

function metresEach(map) {
  const size = map.getSize();
  const [a, b] = [map.containerPointToLatLng([0, size.y / 2]), map.containerPointToLatLng([100, size.y / 2])];
  return map.distance(a, b) / 100;
}

function degreesEach(map) {
  const y = map.getSize().y / 2;
  return (map.containerPointToLatLng([100, y]).lng - map.containerPointToLatLng([0, y]).lng) / 100;
}

function roundStep(metres) {
  const power = 10 ** Math.floor(Math.log10(metres));
  return [1, 2, 5, 10].map((step) => step * power).find((step) => step >= metres) ?? 10 * power;
}

// Hides names that would overlap others, except that of the selected vehicle.
function unhidden(vehicles, selected) {
  const taken = [];
  const free = (v) => taken.every((t) => Math.abs(t.x - v.x) > 64 || Math.abs(t.y - v.y) > 27);
  const first = [...vehicles].sort((a, b) => (b.agent === selected) - (a.agent === selected));
  for (const v of first) {
    v.named = free(v);
    if (v.named) taken.push(v);
  }
  return vehicles;
}

export default {
  props: { look: Object, tiles: Object, tracks: Array, selected: String, resources: String },
  emits: ["select"],
  template: `
    <div class="map" role="img" aria-label="Map of the team; the table has the same data as text">
      <div ref="ground" class="ground" data-testid="map"></div>
      <svg class="sky" aria-hidden="true">
        <defs>
          <marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" orient="auto">
            <path d="M0 0 L8 4 L0 8 z" class="tip"/>
          </marker>
        </defs>
        <g v-if="grid" class="grid"><path :d="grid.path"/><path class="axes" :d="grid.axes"/><text v-for="label in grid.labels" :key="label.text" :x="label.x" :y="label.y">{{ label.text }}</text></g>
        <path v-for="track in ways" :key="track.agent" class="track" :class="{selected: track.agent === selected}" :d="track.path" :data-testid="'track-' + track.agent"/>
        <path v-for="hop in hops" :key="hop.key" class="hop" :d="hop.path" :style="{opacity: hop.opacity}"
              marker-end="url(#tip)"/>
        <g v-for="v in placed" :key="v.agent" :data-testid="'marker-' + v.agent" class="marker"
           :class="{old: !v.fresh, latched: v.latched, selected: v.agent === selected}"
           :transform="'translate(' + v.x + ' ' + v.y + ')'" @click="$emit('select', v.agent)">
          <circle v-if="v.agent === selected" class="halo" r="17"/>
          <circle v-if="v.latched" class="ring" r="13"/>
          <path v-if="v.heading !== null" class="dart" d="M0 -11 L7.5 8.5 L0 4.5 L-7.5 8.5 z"
                :transform="'rotate(' + v.heading * 180 / Math.PI + ')'"/>
          <circle v-else class="dart" r="6"/>
          <text v-if="v.named" class="name" x="15" y="-1">{{ v.agent }}</text>
          <text v-if="v.named && v.height !== null" class="small" x="15" y="12">{{ metres(v.height) }}</text>
        </g>
        <g v-for="dock in docks" :key="dock.host" class="dock" :class="{old: !dock.linked}"
           :transform="'translate(' + dock.x + ' ' + dock.y + ')'">
          <rect x="-5" y="-5" width="10" height="10"/><text class="small" x="10" y="4">{{ dock.host }}</text>
        </g>
        <g v-for="c in minds" :key="c.agent" class="mind" :class="{old: !c.fresh}"
           :transform="'translate(' + c.x + ' ' + c.y + ')'">
          <path d="M0 -6 L6 0 L0 6 L-6 0 z"/><text class="small" x="10" y="4">{{ c.agent }}</text>
        </g>
      </svg>
      <button type="button" class="fit-all" @click="refit" title="Show all vehicles">Fit</button>
      <p v-if="!placed.length" class="nowhere">No vehicle has reported a position.</p>
    </div>`,
  data: () => ({ moved: 0, follows: true }),
  computed: {
    earth() {
      return words.geographic(this.look.vehicles);
    },
    placed() {
      if (this.moved < 0 || !this.map) return [];
      const found = this.look.vehicles.map((v) => ({ ...v, at: this.spot(v), latched: v.devices.some((d) => d.latched) })).filter((v) => v.at);
      return unhidden(found.map((v) => ({ ...v, ...this.pixel(v.at) })), this.selected);
    },
    // The ways of the vehicles until this time, in recordings.
    ways() {
      if (this.moved < 0 || !this.map) return [];
      const path = (points) => points.map(({ x, y }) => `${x} ${y}`).join("L");
      const drawn = (track) => track.points.map(([place, earth]) => this.spot({ place, earth })).filter(Boolean).map((at) => this.pixel(at));
      return (this.tracks ?? []).map((track) => ({ agent: track.agent, points: drawn(track) })).filter((track) => track.points.length > 1).map((track) => ({ ...track, path: `M${path(track.points)}` }));
    },
    docks() {
      if (this.moved < 0 || !this.map) return [];
      const known = new Set(this.placed.map((v) => v.host));
      const bare = this.look.hosts.filter((host) => !known.has(host.host));
      let bottom = this.map.getSize().y - 13;
      return bare.slice(0, 12).map((host) => {
        const y = bottom - this.below(host.host);
        bottom = y - 18;
        return { ...host, x: 20, y };
      });
    },
    // How many coordinators are drawn at each host.
    guests() {
      const found = {};
      for (const c of this.look.coordinators) if (!c.finished) found[c.host] = (found[c.host] ?? 0) + 1;
      return found;
    },
    anchors() {
      const found = {};
      for (const dock of this.docks) found[dock.host] = dock;
      for (const v of this.placed) found[v.host] ??= v;
      return found;
    },
    minds() {
      const taken = {};
      const here = this.look.coordinators.filter((c) => !c.finished && this.anchors[c.host]);
      return here.map((c) => {
        const at = this.anchors[c.host];
        const nth = (taken[c.host] = (taken[c.host] ?? 0) + 1);
        return { ...c, x: at.x, y: at.y + BELOW + EACH_BELOW * nth };
      });
    },
    hops() {
      const drawn = {};
      for (const c of this.look.coordinators) {
        for (const hop of [...c.trail].reverse()) {
          const key = `${c.agent} ${hop.of} ${hop.to}`;
          const [a, b] = [this.anchors[hop.of], this.anchors[hop.to]];
          if (!a || !b || hop.age > HOP_SHOWN || key in drawn) continue;
          drawn[key] = { key, path: this.bow(a, b), opacity: 1 - (0.85 * hop.age) / HOP_SHOWN };
        }
      }
      return Object.values(drawn);
    },
    grid() {
      if (this.moved < 0 || !this.map) return null;
      const size = this.map.getSize();
      const step = this.earth ? roundStep(DEGREES_AT_LEAST * degreesEach(this.map)) : roundStep(GRID_AT_LEAST * metresEach(this.map));
      const [low, high] = [this.map.containerPointToLatLng([0, size.y]), this.map.containerPointToLatLng([size.x, 0])];
      const lines = (from, to) => {
        const found = [];
        for (let n = Math.ceil(from / step); n * step <= to; n++) found.push(n * step);
        return found;
      };
      const across = (north) => `M0 ${this.pixel([north, low.lng]).y.toFixed(1)}H${size.x}`;
      const up = (east) => `M${this.pixel([low.lat, east]).x.toFixed(1)} 0V${size.y}`;
      const [rows, columns] = [lines(low.lat, high.lat), lines(low.lng, high.lng)];
      const path = rows.map(across).join("") + columns.map(up).join("");
      if (!this.earth) return { path, axes: across(0) + up(0), labels: [] };
      const places = Math.max(0, -Math.floor(Math.log10(step)));
      const north = (n) => ({ text: words.degrees(n, places, "N", "S"), x: RIGHT_OF_ZOOM, y: this.pixel([n, low.lng]).y - 3 });
      const east = (e) => ({ text: words.degrees(e, places, "E", "W"), x: this.pixel([low.lat, e]).x + 3, y: size.y - 4 });
      // The scale is in that corner.
      const labels = [...rows.map(north), ...columns.map(east).filter((label) => label.x < size.x - 160)];
      return { path, axes: "", labels };
    },
  },
  watch: {
    earth() {
      this.unmake();
      this.make();
    },
    look() {
      if (this.follows) this.fit();
    },
  },
  methods: {
    metres: words.metres,
    spot(v) {
      const spot = this.earth ? v.earth : v.place;
      return spot ? [spot[0], spot[1]] : null;
    },
    pixel(at) {
      const point = this.map.latLngToContainerPoint(at);
      return { x: Math.round(point.x * 10) / 10, y: Math.round(point.y * 10) / 10 };
    },
    // The height in pixels of the coordinators drawn below a host.
    below(host) {
      const guests = this.guests[host] ?? 0;
      return guests ? BELOW + EACH_BELOW * guests + HALF : 0;
    },
    // An arc, so that the two directions are two lines.
    bow(a, b) {
      const [dx, dy] = [b.x - a.x, b.y - a.y];
      const length = Math.hypot(dx, dy) || 1;
      const [ux, uy] = [dx / length, dy / length];
      const gap = Math.min(18, length / 3);
      const bend = Math.min(40, length / 5);
      const [x, y] = [(a.x + b.x) / 2 - uy * bend, (a.y + b.y) / 2 + ux * bend];
      return `M${a.x + ux * gap} ${a.y + uy * gap}Q${x} ${y} ${b.x - ux * gap} ${b.y - uy * gap}`;
    },
    make() {
      const crs = this.earth ? L.CRS.EPSG3857 : L.CRS.Simple;
      const zooms = this.earth ? { minZoom: 2, maxZoom: 24 } : { minZoom: -6, maxZoom: 8 };
      const options = { crs, ...zooms, zoomSnap: 0.25, attributionControl: false, zoomAnimation: false, fadeAnimation: false, inertia: false };
      this.map = L.map(this.$refs.ground, { ...options, center: [0, 0], zoom: 3 });
      L.control.scale({ imperial: false, position: "bottomright" }).addTo(this.map);
      if (this.earth && this.tiles) this.background();
      this.map.on("move zoom resize", () => this.moved++);
      const taken = () => (this.follows = false);
      this.map.on("dragstart", taken);
      for (const kind of ["wheel", "dblclick", "keydown"]) this.$refs.ground.addEventListener(kind, taken);
      this.follows = true;
      this.moved++;
      this.fit();
    },
    background() {
      const zooms = { minNativeZoom: this.tiles.least, maxNativeZoom: this.tiles.most, maxZoom: 24 };
      L.tileLayer("tiles/{z}/{x}/{y}", zooms).addTo(this.map);
      const credit = L.control.attribution({ prefix: false, position: "bottomleft" });
      // The text comes from a file: shown as plain text, never as HTML.
      const plain = document.createElement("i");
      plain.textContent = this.tiles.credit;
      if (this.tiles.credit) credit.addAttribution(plain.innerHTML).addTo(this.map);
    },
    unmake() {
      this.map?.remove();
      this.map = null;
    },
    refit() {
      this.follows = true;
      this.fit();
    },
    // Shows all vehicles and the coordinators below them. Moves only when one would be outside, or the margin is far too large.
    fit() {
      const spots = this.look.vehicles.map((v) => this.spot(v)).filter(Boolean);
      if (!this.map || !spots.length) return;
      const team = L.latLngBounds(spots);
      const reach = this.earth ? 4e-5 : 3;
      const least = L.latLngBounds(spots).extend([team.getNorth() + reach, team.getEast() + reach]).extend([team.getSouth() - reach, team.getWest() - reach]);
      // Space for the coordinators below the vehicles.
      const below = Math.max(0, ...this.look.vehicles.filter((v) => this.spot(v)).map((v) => this.below(v.host)));
      const size = this.map.getSize();
      const seen = L.latLngBounds(this.map.containerPointToLatLng([0, size.y - below]), this.map.containerPointToLatLng([size.x, 0]));
      const room = (seen.getNorth() - seen.getSouth()) / (least.getNorth() - least.getSouth());
      const wide = (seen.getEast() - seen.getWest()) / (least.getEast() - least.getWest());
      if (!seen.contains(least) || Math.min(room, wide) > 2.2) this.map.fitBounds(least.pad(0.2), { animate: false, paddingBottomRight: [0, below] });
    },
  },
  created() {
    this.map = null;
  },
  mounted() {
    this.make();
    this.watcher = new ResizeObserver(() => this.map?.invalidateSize({ animate: false }));
    this.watcher.observe(this.$refs.ground);
  },
  unmounted() {
    this.watcher.disconnect();
    this.unmake();
  },
};
