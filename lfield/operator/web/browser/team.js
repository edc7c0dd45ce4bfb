// The whole page: STOP and the other buttons, state of the stop, map, vehicles, coordinators, hosts, log, queries,
// plots. It draws the last snapshot and marks an old one.
import { Halt, OperatorInput, Plots, Program, Replay, TeamLog, TeamMap, act, ask, drawings, geometry, looks, words } from "lfield-watch";

// A snapshot older than this (ms) is marked as old.
const OLD = 2000;

const QUESTIONS = {
  lift: "Lift the stop? Programs may then release their devices, and vehicles may move.",
  resume: "Resume the mission? Agents continue, and vehicles may move.",
};

// The most points of a track; of a longer one every second point is dropped.
const MOST_POINTS = 600;

// Orders that let vehicles move again: refused when late (button_orders.py).
const RELEASES = ["lift", "resume"];

// Orders that undo each other.
const PAIRS = [["stop", "lift"], ["pause", "resume"]];
const pairOf = (order) => PAIRS.find((pair) => pair.includes(order));
const without = (table, names) => Object.fromEntries(Object.entries(table).filter(([name]) => !names.includes(name)));

export default {
  components: { TeamMap, Halt, OperatorInput, Plots, Program, Replay, TeamLog },
  props: { title: String, recorded: Boolean, resourcePath: String },
  template: `
  <div class="watch" :class="{stale, halted: look && (look.stands || Object.keys(look.stop.unreached).length)}">
    <header>
      <button v-if="!recorded" type="button" class="stop" data-testid="stop" :disabled="Boolean(barred.stop)" :title="barred.stop"
              @click="press('stop')">STOP</button>
      <h1>{{ title }}</h1>
      <p class="state" data-testid="state" role="status">{{ state }}</p>
      <nav v-if="!recorded" aria-label="Mission">
        <button type="button" data-testid="pause" :disabled="Boolean(barred.pause)" :title="barred.pause"
                @click="press('pause')">Pause</button>
        <button type="button" data-testid="resume" :disabled="Boolean(barred.resume)" :title="barred.resume"
                @click="confirm('resume')">Resume</button>
        <button type="button" data-testid="lift" :disabled="Boolean(barred.lift) || !liftable" :title="barred.lift"
                @click="confirm('lift')">Lift the stop</button>
      </nav>
    </header>
    <p v-for="(why, order) in barredWords" :key="why" class="barred" :data-testid="'barred-' + order">{{ why }}</p>
    <p v-if="trouble" class="trouble" role="alert" data-testid="trouble">{{ trouble }}</p>
    <replay v-if="replay" :replay="replay"/>
    <halt :look="look" :pending="pending" :failures="failures" :now="now"/>
    <operator-input v-if="look && !recorded" :hosts="look.hosts" :at="at" :taken="taken" :denied="barred.resume ?? ''"/>
    <main v-if="look">
      <div class="column-of">
      <section class="place" aria-label="Map">
        <team-map :look="look" :tiles="look.tiles" :tracks="replay ? replay.tracks : tracks" :drawings="drawings" :selected="selected" @select="selected = $event"/>
      </section>
      <section class="panel log" aria-label="Log">
        <h2>Log</h2>
        <team-log :key="epoch" :fresh="fresh" :most="look.lines"/>
        <p v-for="loss in losses" :key="loss" class="bad">{{ loss }}</p>
      </section>
      </div>
      <div class="column-of">
      <section class="panel vehicles" aria-label="Vehicles">
        <h2>Vehicles</h2>
        <table>
          <thead><tr><th scope="col">Vehicle</th><th scope="col">State</th><th scope="col" class="number">Height</th><th scope="col" class="number">Battery</th><th v-if="!recorded" scope="col" class="number">Link</th><th scope="col" class="number wide">{{ geographic ? "Latitude, longitude" : "East, north, m" }}</th></tr></thead>
          <tbody>
            <tr v-for="v in look.vehicles" :key="v.agent" :data-testid="'vehicle-' + v.agent"
                :class="{old: !v.fresh, selected: v.agent === selected}" @mouseenter="selected = v.agent" @mouseleave="selected = ''">
              <th scope="row"><i class="lamp" :class="lamp(v)"></i>{{ v.agent }}<small>{{ v.host }}</small></th>
              <td>{{ v.mode || "–" }}<small v-if="v.armed !== null">{{ v.armed ? "armed" : "disarmed" }}</small><template v-for="d in v.devices" :key="d.name"><span v-if="d.latched" class="latch" :class="{bad: v.fresh && !d.confirmed, old: !v.fresh}"
                  :data-testid="'latch-' + d.name.replace('.', '-')" :title="d.latched">{{ latchWords(d) }}</span></template></td>
              <td class="number" :data-testid="'height-' + v.agent">{{ metres(v.height) }}</td>
              <td class="number" :class="{low: v.battery !== null && v.battery < 0.2}">{{ share(v.battery) }}</td>
              <td v-if="!recorded" class="number" :class="{low: v.link !== null && v.link > 3}">{{ age(v.link) }}</td>
              <td class="number wide" :data-what="geographic ? 'latitude, longitude' : 'east, north, m'" :title="geographic ? local(v) : ''" :data-testid="'place-' + v.agent">{{ place(v, geographic) }}</td>
            </tr>
          </tbody>
        </table>
        <p v-if="!look.vehicles.length" class="none">No agent of this team has devices.</p>
      </section>
      <section class="panel coordinators" aria-label="Coordinators">
        <h2>Coordinators</h2>
        <article v-for="c in look.coordinators" :key="c.agent" :data-testid="'coordinator-' + c.agent" :class="{old: !c.fresh}">
          <h3>{{ c.agent }}<small>{{ where(c) }}</small></h3>
          <p v-if="c.line || c.waits" class="line"><code v-if="c.line">{{ c.file }}:{{ c.line }}</code><template v-if="c.waits"> waits for <code>{{ c.waits }}</code></template></p>
          <program v-if="programs[c.agent] && !c.finished" :program="programs[c.agent]"/>
          <p v-if="c.doubt" class="bad">{{ c.doubt }}</p>
          <p v-if="c.finished && c.detail" :class="{bad: c.finished !== 'done'}">{{ c.detail }}</p>
          <p class="hops"><span v-if="c.hops !== null" class="hop">{{ c.hops }} hop{{ c.hops === 1 ? "" : "s" }}</span><span v-for="hop in c.trail.slice(-3).reverse()" :key="hop.number" class="hop">{{ hop.of }} → {{ hop.to }}{{ hop.failed ? ", failed" : hop.seconds === null ? "" : ", " + duration(hop.seconds) }}</span></p>
        </article>
        <p v-if="!look.coordinators.length" class="none">No coordinator known yet.</p>
      </section>
      <section class="panel hosts" aria-label="Hosts">
        <h2>Hosts</h2>
        <ul>
          <li v-for="host in look.hosts" :key="host.host" :data-testid="'host-' + host.host" :class="{old: !host.linked}">
            <i class="lamp" :class="host.linked ? 'well' : 'gone'"></i><b>{{ host.host }}</b><span>{{ hostWords(host) }}</span>
          </li>
        </ul>
      </section>
      <section v-if="!recorded" class="panel who" aria-label="Who can do it">
        <h2>Who can do it</h2>
        <form @submit.prevent="question">
          <input v-model="asked" data-testid="query" aria-label="Question" placeholder="Lift where payload >= 2.0" autocomplete="off" spellcheck="false" maxlength="4000"/>
          <button type="submit" :disabled="!asked.trim() || asking">Ask</button>
        </form>
        <div v-if="answer" class="answer" data-testid="answer" role="status">
          <p class="why">{{ answer.question }}, asked {{ age(Math.max(0, now - answer.taken) / 1000) }} ago</p>
          <pre v-if="answer.mistakes" class="bad">{{ answer.mistakes }}</pre>
          <p v-for="(why, host) in answer.unreachable" :key="host" class="bad">{{ host }}: {{ why }}</p>
          <template v-for="found in answer.found" :key="found.primitive">
            <h3>{{ found.primitive }}<small>{{ found.offers.length ? found.count + " can" : "no agent can" }}</small></h3>
            <ol v-if="found.offers.length"><li v-for="offer in found.offers" :class="{old: silentOf(offer).length}" :data-testid="'offer-' + offer.agent"><b>{{ offer.agent }}</b> at {{ offer.host }}, {{ offer.how }}, score {{ offer.score.toFixed(3) }}<small>{{ [...offer.facts, ...offer.parts].join(", ") }}</small><template v-if="silentOf(offer).length"> {{ silentOf(offer).join(", ") }} unreachable now</template></li></ol>
            <p v-for="note in found.notes">{{ note }}</p>
            <pre v-if="found.refusals" class="why">{{ found.refusals }}</pre>
          </template>
        </div>
        <ul v-else class="offers">
          <li v-for="offer in look.offers" :key="offer.agent" :class="{old: !offer.fresh}"><b>{{ offer.agent }}</b> {{ offer.type }}<span v-if="offer.refusal" class="bad"> {{ offer.refusal }}</span></li>
        </ul>
      </section>
      </div>
      <plots v-if="!recorded" :stale="stale"/>
    </main>
    <p v-else-if="!trouble" class="none">Waiting for the state of the team.</p>
    <dialog ref="sure" @close="sureClosed">
      <form method="dialog">
        <p>{{ sureWords }}</p>
        <button value="" data-testid="no" autofocus>Cancel</button>
        <button value="yes" data-testid="yes">Yes, {{ sure }}</button>
      </form>
    </dialog>
  </div>`,
  data: () => ({
    look: null, replay: null, tracks: [], drawings: [], epoch: 0, fresh: [], at: null, taken: 0, now: 0, trouble: "", pending: {}, failures: {}, selected: "",
    asked: "", asking: false, answer: null, sure: "",
  }),
  computed: {
    stale() {
      return this.look !== null && this.now - this.taken > OLD;
    },
    barred() {
      return this.look?.barred ?? {};
    },
    barredWords() {
      const seen = new Set();
      return Object.fromEntries(Object.entries(this.barred).filter(([, why]) => !seen.has(why) && seen.add(why)));
    },
    liftable() {
      const stop = this.look?.stop;
      return Boolean(stop) && (this.look.stands || Object.keys({ ...stop.unreached, ...stop.before }).length > 0);
    },
    state() {
      if (!this.look) return "";
      const linked = this.look.hosts.filter((host) => host.linked).length;
      const parts = [`${linked} of ${this.look.hosts.length} hosts ${this.recorded ? "recorded at this time" : "linked"}`];
      const { hosts, unreached, asked } = this.look.stop;
      const missing = Object.keys(unreached);
      if (hosts.length) parts.push(hosts.length === linked && !asked.length ? "STOPPED" : `STOPPED at ${hosts.join(", ")}`);
      if (asked.length) parts.push(`STOP: ${asked.join(", ")} not answered yet`);
      if (missing.length) parts.push(`STOP has NOT REACHED ${missing.join(", ")}`);
      if (this.look.paused.length) parts.push(`paused at ${this.look.paused.join(", ")}`);
      const voting = this.look.hosts.filter((host) => host.held).map((host) => host.host);
      if (voting.length) parts.push(`held by a vote at ${voting.join(", ")}`);
      if (this.stale) parts.push(`updated ${words.age((this.now - this.taken) / 1000)} ago`);
      return parts.join(" · ");
    },
    // The stacks of the coordinators in a recording.
    programs() {
      return Object.fromEntries((this.replay?.coordinators ?? []).map((program) => [program.agent, program]));
    },
    sureWords() {
      return QUESTIONS[this.sure] ?? "";
    },
    geographic() {
      return words.geographic(this.look.vehicles);
    },
    losses() {
      const kinds = (host) => Object.entries(host.lost).map(([kind, count]) => `${count} ${kind}`).join(", ");
      return this.look.hosts.filter((host) => Object.keys(host.lost).length).map((host) => `${host.host}: events lost: ${kinds(host)}`);
    },
  },
  methods: {
    age: words.age, metres: words.metres, share: words.share, place: words.place, local: words.local,
    duration: words.duration,
    lamp(v) {
      if (!v.fresh) return "gone";
      if (v.devices.some((d) => d.latched)) return "held";
      return "well";
    },
    latchWords(d) {
      const was = d.fresh ? "" : "was ";
      if (!d.confirmed) return `${was}not confirmed`;
      return `${was}safe, ${d.moving || "at rest"}`;
    },
    where(c) {
      if (c.finished) return `${c.finished} at ${c.host}`;
      if (c.to) return `${c.host} → ${c.to}`;
      return `at ${c.host}${c.state ? ", " + c.state : ""}`;
    },
    hostWords(host) {
      const parts = [];
      if (!host.linked) parts.push(host.age === null ? "no contact yet" : `last contact ${words.age(host.age)} ago`);
      if (host.ending) parts.push(`ended: ${host.ending}`);
      else if (host.trouble) parts.push(host.trouble);
      const reached = Object.entries(host.links).map(([other, link]) => {
        const measured = words.link(link);
        return measured ? `${other} (${measured})` : other;
      });
      if (host.linked) parts.push(reached.length ? `linked with ${reached.join(", ")}` : "linked");
      for (const [other, seconds] of Object.entries(host.away)) parts.push(`no contact with ${other} for ${words.age(seconds)}`);
      if (host.bundle) parts.push(`bundle ${host.bundle}`);
      if (host.waits_for.length) parts.push(`start waits for ${host.waits_for.join(", ")}`);
      if (host.start_held) parts.push(`start held: ${host.start_held}`);
      for (const [other, reason] of Object.entries(host.refused)) parts.push(`no link with ${other}: ${reason}`);
      if (host.stopped) parts.push(host.linked ? "stopped" : "was stopped");
      if (host.paused) parts.push(host.linked ? "paused" : "was paused");
      if (host.held) parts.push(`${host.linked ? "held" : "was held"} until the result of a vote about an activation is known`);
      if (host.clock !== null && Math.abs(host.clock) > 1) parts.push(`its clock is ${words.age(Math.abs(host.clock))} ${host.clock > 0 ? "ahead" : "behind"}`);
      return parts.join(" · ");
    },
    take({ at, look, log, epoch, replay, tracks }) {
      // NiceGUI's own connection reloads the page when it times out; the last known state and STOP would be gone.
      // The page does not need that connection.
      window.socket?.disconnect();
      this.look = look;
      this.replay = replay;
      this.extend(tracks);
      if (epoch !== this.epoch) [this.epoch, this.fresh] = [epoch, []];
      this.at = at;
      this.taken = this.now = performance.now();
      this.trouble = "";
      this.known();
      if (log.length) this.fresh = log;
    },
    // Adds the new points of all tracks.
    extend({ is_whole, tracks }) {
      if (is_whole) this.tracks = [];
      for (const { agent, points } of tracks) {
        const track = this.tracks.find((each) => each.agent === agent);
        if (track) track.points = geometry.thinned([...track.points, ...points], MOST_POINTS);
        else this.tracks.push({ agent, points });
      }
    },
    // Requests the drawings until the server has answered.
    async fetchDrawings() {
      try {
        this.drawings = await drawings();
      } catch {
        this.again = setTimeout(this.fetchDrawings, 5000);
      }
    },
    async press(order) {
      const press = { since: performance.now(), after: this.newest([...PAIRS.flat()]) };
      const pressed = this.at === null ? null : this.at + (press.since - this.taken) / 1000;
      this.now = press.since;
      this.pending = { ...this.pending, [order]: press };
      this.failures = without(this.failures, pairOf(order));
      try {
        await act(order, pressed);
      } catch (error) {
        this.failures = { ...this.failures, [order]: { why: error.message, refused: error.refused, after: press.after, pressed } };
        this.known();
      }
      if (this.pending[order]?.since === press.since) this.pending = without(this.pending, [order]);
    },
    // The number of the last order of these kinds that the server has reported.
    newest(kinds) {
      const numbers = this.look?.orders.filter((order) => kinds.includes(order.order)).map((order) => order.number) ?? [];
      return Math.max(0, ...numbers);
    },
    // A failed request may have reached the server all the same: then the snapshot has its result. A release that has
    // not arrived in time is refused.
    known() {
      const received = Object.entries(this.failures).filter(([order, failure]) => this.newest(pairOf(order)) > failure.after);
      if (received.length) this.failures = without(this.failures, received.map(([order]) => order));
      for (const order of RELEASES) {
        const failure = this.failures[order];
        if (!failure || failure.refused || failure.pressed === null || this.at <= failure.pressed + this.look.prompt) continue;
        const why = "it did not reach the server in time; check the state, and press it again";
        this.failures = { ...this.failures, [order]: { ...failure, why, refused: true } };
      }
    },
    // The hosts of an offer that are unreachable now.
    silentOf(offer) {
      const linked = this.look.hosts.filter((host) => host.linked).map((host) => host.host);
      return offer.hosts.filter((host) => !linked.includes(host));
    },
    confirm(order) {
      this.sure = order;
      this.$refs.sure.returnValue = "";
      this.$refs.sure.showModal();
    },
    sureClosed() {
      if (this.$refs.sure.returnValue === "yes") this.press(this.sure);
    },
    async question() {
      const question = this.asked;
      this.asking = true;
      try {
        this.answer = { ...(await ask(question)), taken: performance.now() };
      } catch (error) {
        this.answer = { question, mistakes: error.message, unreachable: {}, found: [], taken: performance.now() };
      }
      this.asking = false;
    },
  },
  async mounted() {
    const sheet = document.createElement("link");
    await this.$nextTick();
    sheet.rel = "stylesheet";
    sheet.href = `${this.resourcePath}/leaflet/leaflet.css`;
    document.head.append(sheet);
    this.end = looks(this.take, (error) => {
      this.now = performance.now();
      this.trouble = `No connection to the server of this page; last known values: ${error.message}`;
    });
    this.fetchDrawings();
    this.tick = setInterval(() => (this.now = performance.now()), 500);
  },
  unmounted() {
    this.end?.();
    clearInterval(this.tick);
    clearTimeout(this.again);
  },
};
