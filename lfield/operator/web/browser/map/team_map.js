// The map: Leaflet moves, zooms and draws the background, if there is one; everything else is drawn above it. Every
// layer comes from the page's own server, except tiles of an address that the operator has named.
import { leaflet as L } from "nicegui-leaflet";
import { colourOf } from "../colours.js";
import * as format from "../text_format.js";
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
const [VEHICLE_SIGN, COORDINATOR_SIGN, HOME_SIGN, ITEM_SIGN] = [12, 6, 8, 4];
// The most numbers of items that are drawn at once.
const MOST_NUMBERS = 200;
// Drawings within these degrees of the vehicles are in the view of all vehicles.
const NEARBY = 0.2;

// Approximate width of a text.
const textWidth = (text, perLetter) => Math.ceil(text.length * perLetter) + 2;

export default {
  components: { MapLegend: Legend },
  props: { team: Object, tiles: Object, tracks: Array, drawings: Array, selected: String },
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
        <path v-for="track in trackPaths" :key="track.agent" class="track" :class="{selected: track.agent === selected}" :style="{stroke: track.colour}" :d="track.path" :data-testid="'track-' + track.agent"/>
        <path v-for="hop in hops" :key="hop.key" class="hop" :d="hop.path" :style="{opacity: hop.opacity}"
              marker-end="url(#tip)"/>
        <path v-for="label in labels" :key="label.key" class="leader" :d="label.line"/>
        <g v-for="v in placed" :key="v.agent" :data-testid="'marker-' + v.agent" class="marker"
           :class="{old: !v.fresh, latched: v.latched, selected: v.agent === selected}"
           :transform="'translate(' + v.x + ' ' + v.y + ')'" @click="$emit('select', v.agent)">
          <circle v-if="v.agent === selected" class="halo" r="17"/>
          <circle v-if="v.latched" class="ring" r="13"/>
          <path v-if="v.heading !== null" class="dart" d="M0 -11 L7.5 8.5 L0 4.5 L-7.5 8.5 z" :style="{fill: v.fresh ? v.colour : ''}"
                :transform="'rotate(' + v.heading * 180 / Math.PI + ')'"/>
          <circle v-else class="dart" r="6" :style="{fill: v.fresh ? v.colour : ''}"/>
        </g>
        <g v-for="dock in hostSigns" :key="dock.host" class="dock" :class="{old: !dock.linked}" :transform="'translate(' + dock.x + ' ' + dock.y + ')'">
          <rect x="-5" y="-5" width="10" height="10"/>
        </g>
        <g v-for="c in coordinators" :key="c.agent" class="mind" :class="{old: !c.fresh}" :transform="'translate(' + c.x + ' ' + c.y + ')'">
          <path d="M0 -6 L6 0 L0 6 L-6 0 z"/>
        </g>
        <g v-for="label in labels" :key="label.key" :class="label.kind" :data-testid="label.id" :transform="'translate(' + label.left.toFixed(1) + ' ' + label.top.toFixed(1) + ')'">
          <text v-for="(text, n) in label.lines" :key="n" :class="n || label.small ? 'small' : 'name'" x="1" :y="11 + 13 * n">{{ text }}</text>
        </g>
      </svg>
      <button type="button" class="fit-all" @click="showAll" title="Show all vehicles">Fit</button>
      <p v-if="!placed.length" class="nowhere">No vehicle has reported a position.</p>
    </div>
    <map-legend :team="team" :drawnKinds="drawnKinds" :drawings="isGeographic ? drawings : []"/>`,
  data: () => ({ moved: 0, isFollowing: true }),
  computed: {
    isGeographic() {
      return format.isGeographic(this.team.vehicles);
    },
    placed() {
      if (this.moved < 0 || !this.map) return [];
      const found = this.team.vehicles.map((v) => ({ ...v, at: this.coordinates(v), latched: v.devices.some((d) => d.latched) })).filter((v) => v.at);
      return found.map((v) => ({ ...v, ...this.pixel(v.at), colour: colourOf(v.agent) }));
    },
    // The tracks of the vehicles until this time.
    trackPaths() {
      if (this.moved < 0 || !this.map) return [];
      const drawn = (track) => track.points.map(([position, geo_position]) => this.coordinates({ position, geo_position })).filter(Boolean).map((at) => this.pixel(at));
      return this.tracks.map((track) => ({ agent: track.agent, colour: colourOf(track.agent), path: line(drawn(track)) })).filter((track) => track.path);
    },
    // Plans, areas and fences of files, in pixels; circles are polygons here.
    outlines() {
      if (this.moved < 0 || !this.map || !this.isGeographic) return [];
      return this.drawings.map((drawing) => ({ ...drawing, pixels: drawing.points.map((at) => this.pixel(at)) }));
    },
    shapes() {
      const lines = this.outlines.filter((drawing) => !["rally", "home"].includes(drawing.kind));
      return lines.map(({ kind, pixels }) => ({ kind, path: line(pixels, kind !== "way") }));
    },
    items() {
      const points = this.outlines.filter((drawing) => ["way", "rally"].includes(drawing.kind));
      const size = this.map?.getSize();
      const all = points.flatMap(({ kind, pixels, numbers }, drawing) => pixels.map((at, n) => ({ ...at, kind, key: `${drawing} ${n}`, number: numbers[n] ?? "" })));
      return all.filter(({ x, y }) => x > 0 && y > 0 && x < size.x && y < size.y);
    },
    homes() {
      if (this.moved < 0 || !this.map || !this.isGeographic) return [];
      const planned = this.outlines.filter((drawing) => drawing.kind === "home").flatMap((drawing) => drawing.pixels);
      const own = this.team.vehicles.filter((v) => v.home).map((v) => this.pixel([v.home[0], v.home[1]]));
      return distinct([...own, ...planned].map((at) => ({ ...at, r: 0 }))).map((home, key) => ({ ...home, key }));
    },
    // The limit of each binding, and the fence of each autopilot around its home.
    circles() {
      if (this.moved < 0 || !this.map || !this.isGeographic) return [];
      const around = (kind, radiusOf) => {
        const known = this.team.vehicles.filter((v) => v.home && radiusOf(v));
        const drawn = known.map((v) => ({ ...this.pixel([v.home[0], v.home[1]]), r: radiusOf(v) / metresPerPixel(this.map.getZoom(), v.home[0]) }));
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
      return [...buttons, ...signs(this.placed, VEHICLE_SIGN - 2), ...signs([...this.coordinators, ...this.hostSigns], COORDINATOR_SIGN), ...signs(this.homes, HOME_SIGN)];
    },
    // What is drawn, for the legend.
    drawnKinds() {
      return {
        track: this.trackPaths.length, hop: this.hops.length, mind: this.coordinators.length, dock: this.hostSigns.length, home: this.homes.length,
        latched: this.placed.filter((v) => v.latched).length, limit: this.circles.filter((c) => c.kind === "limit").length,
        edge: this.circles.filter((c) => c.kind === "edge").length,
      };
    },
    labels() {
      if (this.moved < 0 || !this.map) return [];
      const named = (v) => {
        const lines = v.height === null ? [v.agent] : [v.agent, format.metres(v.height)];
        return { key: `v ${v.agent}`, id: `label-${v.agent}`, kind: { old: !v.fresh }, x: v.x, y: v.y, radius: VEHICLE_SIGN, lines, width: Math.max(textWidth(v.agent, 7.2), textWidth(lines[1] ?? "", 6.2)), height: 13 * lines.length + 1 };
      };
      const small = (key, id, kind, at, text, radius, near) => ({ key, id, kind, x: at.x, y: at.y, radius, lines: [text], small: true, width: textWidth(text, 6.2), height: 14, near });
      const vehicles = [...this.placed].sort((a, b) => (b.agent === this.selected) - (a.agent === this.selected)).map(named);
      const coordinators = this.coordinators.map((c) => small(`c ${c.agent}`, `label-${c.agent}`, { mind: true, old: !c.fresh }, c, c.agent, COORDINATOR_SIGN));
      const hostSigns = this.hostSigns.map((dock) => small(`d ${dock.host}`, `label-${dock.host}`, { old: !dock.linked }, dock, dock.host, COORDINATOR_SIGN));
      const numbers = this.items.slice(0, MOST_NUMBERS).map((item) => small(`n ${item.key}`, null, { numbers: true }, item, String(item.number), ITEM_SIGN, true));
      const candidates = [...vehicles, ...coordinators, ...hostSigns, ...numbers];
      const obstacles = [...this.obstacles, ...this.grid.labels.map(({ box }) => box)];
      const found = placedLabels(candidates, obstacles, this.map.getSize(), this.slots);
      this.slots = Object.fromEntries(Object.entries(found).map(([key, { slot }]) => [key, slot]));
      return candidates.filter((label) => label.key in found).map((label) => ({ ...label, ...found[label.key] }));
    },
    hostSigns() {
      if (this.moved < 0 || !this.map) return [];
      const known = new Set(this.placed.map((v) => v.host));
      const withoutVehicle = this.team.hosts.filter((host) => !known.has(host.host));
      let bottom = this.map.getSize().y - 13;
      return withoutVehicle.slice(0, 12).map((host) => {
        const y = bottom - this.below(host.host);
        bottom = y - 18;
        return { ...host, x: 20, y };
      });
    },
    // How many coordinators are drawn at each host.
    coordinatorCounts() {
      const found = {};
      for (const c of this.team.coordinators) if (!c.finished) found[c.host] = (found[c.host] ?? 0) + 1;
      return found;
    },
    anchors() {
      const found = {};
      for (const dock of this.hostSigns) found[dock.host] = dock;
      for (const v of this.placed) found[v.host] ??= v;
      return found;
    },
    coordinators() {
      const drawnAt = {};
      const here = this.team.coordinators.filter((c) => !c.finished && this.anchors[c.host]);
      return here.map((c) => {
        const at = this.anchors[c.host];
        const nth = (drawnAt[c.host] = (drawnAt[c.host] ?? 0) + 1);
        return { ...c, x: at.x, y: at.y + BELOW + EACH_BELOW * nth };
      });
    },
    hops() {
      const drawn = {};
      for (const c of this.team.coordinators) {
        for (const hop of [...c.trail].reverse()) {
          const key = `${c.agent} ${hop.source} ${hop.target}`;
          const [a, b] = [this.anchors[hop.source], this.anchors[hop.target]];
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
      const step = this.isGeographic ? roundStep((DEGREES_AT_LEAST * (high.lng - low.lng)) / size.x) : roundStep(GRID_AT_LEAST * metresPerPixel(this.map.getZoom()));
      const across = (north) => `M0 ${this.pixel([north, low.lng]).y.toFixed(1)}H${size.x}`;
      const up = (east) => `M${this.pixel([low.lat, east]).x.toFixed(1)} 0V${size.y}`;
      const [rows, columns] = [multiples(step, low.lat, high.lat), multiples(step, low.lng, high.lng)];
      const path = rows.map(across).join("") + columns.map(up).join("");
      if (!this.isGeographic) return { path, axes: across(0) + up(0), labels: [] };
      const places = Math.max(0, -Math.floor(Math.log10(step)));
      const label = (text, x, y) => ({ text, x, y, box: { left: x, right: x + textWidth(text, 5.8), top: y - 10, bottom: y + 2 } });
      const north = (n) => label(format.degrees(n, places, "N", "S"), RIGHT_OF_ZOOM, this.pixel([n, low.lng]).y - 3);
      const east = (e) => label(format.degrees(e, places, "E", "W"), this.pixel([low.lat, e]).x + 3, size.y - 4);
      return { path, axes: "", labels: separate([...columns.map(east), ...rows.map(north)].filter(({ box }) => box.top >= 0), this.obstacles) };
    },
  },
  watch: {
    isGeographic() {
      this.removeMap();
      this.createMap();
    },
    team() {
      if (this.isFollowing) this.fit();
    },
    drawings() {
      this.fit();
    },
  },
  methods: {
    coordinates(v) {
      const coordinates = this.isGeographic ? v.geo_position : v.position;
      return coordinates ? [coordinates[0], coordinates[1]] : null;
    },
    pixel(at) {
      // Leaflet's latLngToContainerPoint rounds to whole pixels, which makes small circles ragged.
      const point = this.map.layerPointToContainerPoint(this.map.project(at).subtract(this.map.getPixelOrigin()));
      return { x: Math.round(point.x * 10) / 10, y: Math.round(point.y * 10) / 10 };
    },
    // The height in pixels of the coordinators drawn below a host.
    below(host) {
      const count = this.coordinatorCounts[host] ?? 0;
      return count ? BELOW + EACH_BELOW * count + HALF : 0;
    },
    createMap() {
      const crs = this.isGeographic ? L.CRS.EPSG3857 : L.CRS.Simple;
      const zooms = this.isGeographic ? { minZoom: 2, maxZoom: 24 } : { minZoom: -6, maxZoom: 8 };
      const options = { crs, ...zooms, zoomSnap: 0.25, attributionControl: false, zoomAnimation: false, fadeAnimation: false, inertia: false };
      this.map = L.map(this.$refs.ground, { ...options, center: [0, 0], zoom: 3 });
      L.control.scale({ imperial: false, position: "bottomright" }).addTo(this.map);
      if (this.isGeographic && this.tiles) this.addTiles();
      this.map.on("move zoom resize", () => this.moved++);
      const stopFollowing = () => (this.isFollowing = false);
      this.map.on("dragstart", stopFollowing);
      for (const kind of ["wheel", "dblclick", "keydown"]) this.$refs.ground.addEventListener(kind, stopFollowing);
      this.isFollowing = true;
      this.moved++;
      this.fit();
    },
    addTiles() {
      // Servers of tiles require to know which page requests them; the address has no secret.
      const options = { minNativeZoom: this.tiles.min_zoom, maxNativeZoom: this.tiles.max_zoom, maxZoom: 24, referrerPolicy: "origin" };
      L.tileLayer(this.tiles.url, options).addTo(this.map);
      const credit = L.control.attribution({ prefix: false, position: "bottomleft" });
      // The text comes from a file: drawnKinds as plain text, never as HTML.
      const plain = document.createElement("i");
      plain.textContent = this.tiles.credit;
      if (this.tiles.credit) credit.addAttribution(plain.innerHTML).addTo(this.map);
    },
    removeMap() {
      this.map?.remove();
      this.map = null;
    },
    showAll() {
      this.isFollowing = true;
      this.fit();
    },
    // Shows all vehicles, the drawings near them, and the coordinators below them. Moves only when one would be outside,
    // or the margin is far too large.
    fit() {
      const positions = this.team.vehicles.map((v) => this.coordinates(v)).filter(Boolean);
      if (!this.map || !positions.length) return;
      const bounds = L.latLngBounds(positions);
      const near = ([north, east]) => Math.abs(north - positions[0][0]) < NEARBY && Math.abs(east - positions[0][1]) < NEARBY;
      const margin = this.isGeographic ? 4e-5 : 3;
      const area = L.latLngBounds(positions).extend([bounds.getNorth() + margin, bounds.getEast() + margin]).extend([bounds.getSouth() - margin, bounds.getWest() - margin]);
      if (this.isGeographic) this.drawings.flatMap((drawing) => drawing.points).filter(near).forEach((at) => area.extend(at));
      // Space for the coordinators below the vehicles.
      const below = Math.max(0, ...this.team.vehicles.filter((v) => this.coordinates(v)).map((v) => this.below(v.host)));
      const size = this.map.getSize();
      const visible = L.latLngBounds(this.map.containerPointToLatLng([0, size.y - below]), this.map.containerPointToLatLng([size.x, 0]));
      const height = (visible.getNorth() - visible.getSouth()) / (area.getNorth() - area.getSouth());
      const width = (visible.getEast() - visible.getWest()) / (area.getEast() - area.getWest());
      if (!visible.contains(area) || Math.min(height, width) > 2.2) this.map.fitBounds(area.pad(0.2), { animate: false, paddingBottomRight: [0, below] });
    },
  },
  created() {
    this.map = null;
    this.slots = {};
  },
  mounted() {
    this.createMap();
    this.watcher = new ResizeObserver(() => this.map?.invalidateSize({ animate: false }));
    this.watcher.observe(this.$refs.ground);
  },
  unmounted() {
    this.watcher.disconnect();
    this.removeMap();
  },
};
