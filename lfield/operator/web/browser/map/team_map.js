// The map: Leaflet moves, zooms and draws the background, if there is one; everything else is drawn above it. Every
// layer comes from the page's own server, except tiles of an address that the operator has named.
import { leaflet as L } from "nicegui-leaflet";
import { colourOf } from "../colours.js";
import * as words from "../words.js";
import { arc, distinct, line, metresPerPixel, multiples, roundStep } from "./geometry.js";
import { boxAround, placedLabels, separate } from "./labels.js";
import Legend from "./legend.js";

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
// Half the size of the signs of vehicles, of coordinators and hosts, and of homes; the same of items of a plan.
const [DART, DIAMOND, HOME, ITEM] = [12, 6, 8, 4];
// The most numbers of items that are drawn at once.
const MOST_NUMBERS = 200;
// Drawings within these degrees of the vehicles are in the view of all vehicles.
const NEARBY = 0.2;

// Approximate width of a text.
const width = (text, each) => Math.ceil(text.length * each) + 2;

export default {
  components: { MapLegend: Legend },
  props: { look: Object, tiles: Object, tracks: Array, drawings: Array, selected: String, resources: String },
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
        <g v-if="grid" class="grid"><path :d="grid.path"/><path class="axes" :d="grid.axes"/><text v-for="label in grid.labels" :key="label.text" :data-testid="'degrees-' + label.text" :x="label.x" :y="label.y">{{ label.text }}</text></g>
        <path v-for="(shape, n) in shapes" :key="n" class="shape" :class="shape.kind" :d="shape.path" :data-testid="'shape-' + shape.kind"/>
        <circle v-for="c in circles" :key="c.key" class="shape" :class="c.kind" :cx="c.x" :cy="c.y" :r="c.r" :data-testid="'shape-' + c.kind"/>
        <circle v-for="item in items" :key="item.key" class="item" :class="item.kind" :cx="item.x" :cy="item.y" r="3"/>
        <g v-for="home in homes" :key="home.key" class="home" data-testid="home" :transform="'translate(' + home.x + ' ' + home.y + ')'"><circle r="7"/><path d="M-2.5 -3.5V3.5M2.5 -3.5V3.5M-2.5 0H2.5"/></g>
        <path v-for="track in ways" :key="track.agent" class="track" :class="{selected: track.agent === selected}" :style="{stroke: track.ink}" :d="track.path" :data-testid="'track-' + track.agent"/>
        <path v-for="hop in hops" :key="hop.key" class="hop" :d="hop.path" :style="{opacity: hop.opacity}"
              marker-end="url(#tip)"/>
        <path v-for="label in labels" :key="label.key" class="leader" :d="label.line"/>
        <g v-for="v in placed" :key="v.agent" :data-testid="'marker-' + v.agent" class="marker"
           :class="{old: !v.fresh, latched: v.latched, selected: v.agent === selected}"
           :transform="'translate(' + v.x + ' ' + v.y + ')'" @click="$emit('select', v.agent)">
          <circle v-if="v.agent === selected" class="halo" r="17"/>
          <circle v-if="v.latched" class="ring" r="13"/>
          <path v-if="v.heading !== null" class="dart" d="M0 -11 L7.5 8.5 L0 4.5 L-7.5 8.5 z" :style="{fill: v.fresh ? v.ink : ''}"
                :transform="'rotate(' + v.heading * 180 / Math.PI + ')'"/>
          <circle v-else class="dart" r="6" :style="{fill: v.fresh ? v.ink : ''}"/>
        </g>
        <g v-for="dock in docks" :key="dock.host" class="dock" :class="{old: !dock.linked}" :transform="'translate(' + dock.x + ' ' + dock.y + ')'">
          <rect x="-5" y="-5" width="10" height="10"/>
        </g>
        <g v-for="c in minds" :key="c.agent" class="mind" :class="{old: !c.fresh}" :transform="'translate(' + c.x + ' ' + c.y + ')'">
          <path d="M0 -6 L6 0 L0 6 L-6 0 z"/>
        </g>
        <g v-for="label in labels" :key="label.key" :class="label.kind" :data-testid="label.id" :transform="'translate(' + label.left.toFixed(1) + ' ' + label.top.toFixed(1) + ')'">
          <text v-for="(text, n) in label.lines" :key="n" :class="n || label.small ? 'small' : 'name'" x="1" :y="11 + 13 * n">{{ text }}</text>
        </g>
      </svg>
      <button type="button" class="fit-all" @click="refit" title="Show all vehicles">Fit</button>
      <p v-if="!placed.length" class="nowhere">No vehicle has reported a position.</p>
    </div>
    <map-legend :look="look" :shown="shown" :drawings="earth ? drawings : []"/>`,
  data: () => ({ moved: 0, follows: true }),
  computed: {
    earth() {
      return words.geographic(this.look.vehicles);
    },
    placed() {
      if (this.moved < 0 || !this.map) return [];
      const found = this.look.vehicles.map((v) => ({ ...v, at: this.spot(v), latched: v.devices.some((d) => d.latched) })).filter((v) => v.at);
      return found.map((v) => ({ ...v, ...this.pixel(v.at), ink: colourOf(v.agent) }));
    },
    // The ways of the vehicles until this time.
    ways() {
      if (this.moved < 0 || !this.map) return [];
      const drawn = (track) => track.points.map(([place, earth]) => this.spot({ place, earth })).filter(Boolean).map((at) => this.pixel(at));
      return this.tracks.map((track) => ({ agent: track.agent, ink: colourOf(track.agent), path: line(drawn(track)) })).filter((track) => track.path);
    },
    // Plans, areas and fences of files, in pixels; circles are polygons here.
    outlines() {
      if (this.moved < 0 || !this.map || !this.earth) return [];
      return this.drawings.map((drawing) => ({ ...drawing, pixels: drawing.points.map((at) => this.pixel(at)) }));
    },
    shapes() {
      const lines = this.outlines.filter((drawing) => !["rally", "home"].includes(drawing.kind));
      return lines.map(({ kind, pixels }) => ({ kind, path: line(pixels, kind !== "way") }));
    },
    items() {
      const points = this.outlines.filter((drawing) => ["way", "rally"].includes(drawing.kind));
      const size = this.map?.getSize();
      const all = points.flatMap(({ kind, pixels, numbers }, of) => pixels.map((at, n) => ({ ...at, kind, key: `${of} ${n}`, number: numbers[n] ?? "" })));
      return all.filter(({ x, y }) => x > 0 && y > 0 && x < size.x && y < size.y);
    },
    homes() {
      if (this.moved < 0 || !this.map || !this.earth) return [];
      const planned = this.outlines.filter((drawing) => drawing.kind === "home").flatMap((drawing) => drawing.pixels);
      const own = this.look.vehicles.filter((v) => v.home).map((v) => this.pixel([v.home[0], v.home[1]]));
      return distinct([...own, ...planned].map((at) => ({ ...at, r: 0 }))).map((home, key) => ({ ...home, key }));
    },
    // The limit of each binding, and the fence of each autopilot around its home.
    circles() {
      if (this.moved < 0 || !this.map || !this.earth) return [];
      const around = (kind, of) => {
        const known = this.look.vehicles.filter((v) => v.home && of(v));
        const drawn = known.map((v) => ({ ...this.pixel([v.home[0], v.home[1]]), r: of(v) / metresPerPixel(this.map.getZoom(), v.home[0]) }));
        return distinct(drawn).map((circle, n) => ({ ...circle, kind, key: `${kind} ${n}` }));
      };
      return [...around("limit", (v) => v.radius), ...around("edge", (v) => v.fence)];
    },
    // The boxes of all signs and of the buttons, which no label hides.
    obstacles() {
      if (this.moved < 0 || !this.map) return [];
      const size = this.map.getSize();
      const signs = (points, radius) => points.map(({ x, y }) => boxAround({ x, y, radius }));
      const buttons = [{ left: 0, top: 0, right: 48, bottom: 80 }, { left: size.x - 64, top: 0, right: size.x, bottom: 44 }, { left: size.x - 130, top: size.y - 30, right: size.x, bottom: size.y }];
      return [...buttons, ...signs(this.placed, DART - 2), ...signs([...this.minds, ...this.docks], DIAMOND), ...signs(this.homes, HOME)];
    },
    // What is drawn, for the legend.
    shown() {
      return {
        track: this.ways.length, hop: this.hops.length, mind: this.minds.length, dock: this.docks.length, home: this.homes.length,
        latched: this.placed.filter((v) => v.latched).length, limit: this.circles.filter((c) => c.kind === "limit").length,
        edge: this.circles.filter((c) => c.kind === "edge").length,
      };
    },
    labels() {
      if (this.moved < 0 || !this.map) return [];
      const named = (v) => {
        const lines = v.height === null ? [v.agent] : [v.agent, words.metres(v.height)];
        return { key: `v ${v.agent}`, id: `label-${v.agent}`, kind: { old: !v.fresh }, x: v.x, y: v.y, radius: DART, lines, width: Math.max(width(v.agent, 7.2), width(lines[1] ?? "", 6.2)), height: 13 * lines.length + 1 };
      };
      const small = (key, id, kind, at, text, radius, near) => ({ key, id, kind, x: at.x, y: at.y, radius, lines: [text], small: true, width: width(text, 6.2), height: 14, near });
      const vehicles = [...this.placed].sort((a, b) => (b.agent === this.selected) - (a.agent === this.selected)).map(named);
      const minds = this.minds.map((c) => small(`c ${c.agent}`, `label-${c.agent}`, { mind: true, old: !c.fresh }, c, c.agent, DIAMOND));
      const docks = this.docks.map((dock) => small(`d ${dock.host}`, `label-${dock.host}`, { old: !dock.linked }, dock, dock.host, DIAMOND));
      const numbers = this.items.slice(0, MOST_NUMBERS).map((item) => small(`n ${item.key}`, null, { numbers: true }, item, String(item.number), ITEM, true));
      const wanted = [...vehicles, ...minds, ...docks, ...numbers];
      const obstacles = [...this.obstacles, ...this.grid.labels.map(({ box }) => box)];
      const found = placedLabels(wanted, obstacles, this.map.getSize(), this.slots);
      this.slots = Object.fromEntries(Object.entries(found).map(([key, { slot }]) => [key, slot]));
      return wanted.filter((label) => label.key in found).map((label) => ({ ...label, ...found[label.key] }));
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
          drawn[key] = { key, path: arc(a, b), opacity: 1 - (0.85 * hop.age) / HOP_SHOWN };
        }
      }
      return Object.values(drawn);
    },
    grid() {
      if (this.moved < 0 || !this.map) return null;
      const size = this.map.getSize();
      const [low, high] = [this.map.containerPointToLatLng([0, size.y]), this.map.containerPointToLatLng([size.x, 0])];
      const step = this.earth ? roundStep((DEGREES_AT_LEAST * (high.lng - low.lng)) / size.x) : roundStep(GRID_AT_LEAST * metresPerPixel(this.map.getZoom()));
      const across = (north) => `M0 ${this.pixel([north, low.lng]).y.toFixed(1)}H${size.x}`;
      const up = (east) => `M${this.pixel([low.lat, east]).x.toFixed(1)} 0V${size.y}`;
      const [rows, columns] = [multiples(step, low.lat, high.lat), multiples(step, low.lng, high.lng)];
      const path = rows.map(across).join("") + columns.map(up).join("");
      if (!this.earth) return { path, axes: across(0) + up(0), labels: [] };
      const places = Math.max(0, -Math.floor(Math.log10(step)));
      const label = (text, x, y) => ({ text, x, y, box: { left: x, right: x + width(text, 5.8), top: y - 10, bottom: y + 2 } });
      const north = (n) => label(words.degrees(n, places, "N", "S"), RIGHT_OF_ZOOM, this.pixel([n, low.lng]).y - 3);
      const east = (e) => label(words.degrees(e, places, "E", "W"), this.pixel([low.lat, e]).x + 3, size.y - 4);
      return { path, axes: "", labels: separate([...columns.map(east), ...rows.map(north)].filter(({ box }) => box.top >= 0), this.obstacles) };
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
    drawings() {
      this.fit();
    },
  },
  methods: {
    spot(v) {
      const spot = this.earth ? v.earth : v.place;
      return spot ? [spot[0], spot[1]] : null;
    },
    pixel(at) {
      // Leaflet's latLngToContainerPoint rounds to whole pixels, which makes small circles ragged.
      const point = this.map.layerPointToContainerPoint(this.map.project(at).subtract(this.map.getPixelOrigin()));
      return { x: Math.round(point.x * 10) / 10, y: Math.round(point.y * 10) / 10 };
    },
    // The height in pixels of the coordinators drawn below a host.
    below(host) {
      const guests = this.guests[host] ?? 0;
      return guests ? BELOW + EACH_BELOW * guests + HALF : 0;
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
      // Servers of tiles require to know which page requests them; the address has no secret.
      const options = { minNativeZoom: this.tiles.least, maxNativeZoom: this.tiles.most, maxZoom: 24, referrerPolicy: "origin" };
      L.tileLayer(this.tiles.address, options).addTo(this.map);
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
    // Shows all vehicles, the drawings near them, and the coordinators below them. Moves only when one would be outside,
    // or the margin is far too large.
    fit() {
      const spots = this.look.vehicles.map((v) => this.spot(v)).filter(Boolean);
      if (!this.map || !spots.length) return;
      const team = L.latLngBounds(spots);
      const near = ([north, east]) => Math.abs(north - spots[0][0]) < NEARBY && Math.abs(east - spots[0][1]) < NEARBY;
      const reach = this.earth ? 4e-5 : 3;
      const least = L.latLngBounds(spots).extend([team.getNorth() + reach, team.getEast() + reach]).extend([team.getSouth() - reach, team.getWest() - reach]);
      if (this.earth) this.drawings.flatMap((drawing) => drawing.points).filter(near).forEach((at) => least.extend(at));
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
    this.slots = {};
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
