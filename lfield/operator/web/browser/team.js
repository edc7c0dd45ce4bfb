// The whole page: STOP and the other buttons, state of the stop, map, vehicles, coordinators, hosts, log, queries,
// plots. It draws the last snapshot and marks an old one.
import { OperatorInput, OrderStatus, Plots, Program, Replay, TeamLog, TeamMap, fetchDrawings, format, geometry, pollSnapshots, sendOrder, sendQuery } from "lfield-watch";

// A snapshot older than this (ms) is marked as old.
const STALE_AFTER = 2000;

const CONFIRMATIONS = {
  lift: "Lift the stop? Programs may then release their devices, and vehicles may move.",
  resume: "Resume the mission? Agents continue, and vehicles may move.",
};

// The most points of a track; of a longer one every second point is dropped.
const MAX_POINTS = 600;

// Orders that let vehicles move again: refused when late (button_orders.py).
const RELEASES = ["lift", "resume"];

// Orders that undo each other.
const PAIRS = [["stop", "lift"], ["pause", "resume"]];
const pairOf = (order) => PAIRS.find((pair) => pair.includes(order));
const without = (table, names) => Object.fromEntries(Object.entries(table).filter(([name]) => !names.includes(name)));

export default {
  components: { OperatorInput, OrderStatus, Plots, Program, Replay, TeamLog, TeamMap },
  props: { title: String, recorded: Boolean, resourcePath: String },
  template: `
  <div class="watch" :class="{stale, stopped: team && (team.is_stopped || Object.keys(team.stop.unreached).length)}">
    <header>
      <button v-if="!recorded" type="button" class="stop" data-testid="stop" :disabled="Boolean(denied.stop)" :title="denied.stop"
              @click="press('stop')">STOP</button>
      <h1>{{ title }}</h1>
      <p class="state" data-testid="state" role="status">{{ state }}</p>
      <nav v-if="!recorded" aria-label="Mission">
        <button type="button" data-testid="pause" :disabled="Boolean(denied.pause)" :title="denied.pause"
                @click="press('pause')">Pause</button>
        <button type="button" data-testid="resume" :disabled="Boolean(denied.resume)" :title="denied.resume"
                @click="confirm('resume')">Resume</button>
        <button type="button" data-testid="lift" :disabled="Boolean(denied.lift) || !liftable" :title="denied.lift"
                @click="confirm('lift')">Lift the stop</button>
      </nav>
    </header>
    <p v-for="(reason, order) in deniedTexts" :key="order" class="denied" :data-testid="'barred-' + order">{{ reason }}</p>
    <p v-if="problem" class="problem" role="alert" data-testid="trouble">{{ problem }}</p>
    <replay v-if="replay" :replay="replay"/>
    <order-status :team="team" :pending="pending" :failures="failures" :now="now"/>
    <operator-input v-if="team && !recorded" :hosts="team.hosts" :at="at" :receivedAt="receivedAt" :denied="denied.resume ?? ''"/>
    <main v-if="team">
      <div class="column">
      <section aria-label="Map">
        <team-map :team="team" :tiles="team.tiles" :tracks="replay ? replay.tracks : tracks" :drawings="drawings" :selected="selected" @select="selected = $event"/>
      </section>
      <section class="panel log" aria-label="Log">
        <h2>Log</h2>
        <team-log :key="epoch" :newLines="newLines" :maxLines="team.max_log_lines"/>
        <p v-for="loss in losses" :key="loss" class="bad">{{ loss }}</p>
      </section>
      </div>
      <div class="column">
      <section class="panel vehicles" aria-label="Vehicles">
        <h2>Vehicles</h2>
        <table>
          <thead><tr><th scope="col">Vehicle</th><th scope="col">State</th><th scope="col" class="number">Height</th><th scope="col" class="number">Battery</th><th v-if="!recorded" scope="col" class="number">Link</th><th scope="col" class="number wide">{{ isGeographic ? "Latitude, longitude" : "East, north, m" }}</th></tr></thead>
          <tbody>
            <tr v-for="v in team.vehicles" :key="v.agent" :data-testid="'vehicle-' + v.agent"
                :class="{old: !v.fresh, selected: v.agent === selected}" @mouseenter="selected = v.agent" @mouseleave="selected = ''">
              <th scope="row"><i class="lamp" :class="lamp(v)"></i>{{ v.agent }}<small>{{ v.host }}</small></th>
              <td>{{ v.mode || "–" }}<small v-if="v.armed !== null">{{ v.armed ? "armed" : "disarmed" }}</small><template v-for="d in v.devices" :key="d.name"><span v-if="d.latched" class="latch" :class="{bad: v.fresh && !d.confirmed, old: !v.fresh}"
                  :data-testid="'latch-' + d.name.replace('.', '-')" :title="d.latched">{{ latchText(d) }}</span></template></td>
              <td class="number" :data-testid="'height-' + v.agent">{{ metres(v.height) }}</td>
              <td class="number" :class="{low: v.battery !== null && v.battery < 0.2}">{{ percent(v.battery) }}</td>
              <td v-if="!recorded" class="number" :class="{low: v.telemetry_age !== null && v.telemetry_age > 3}">{{ age(v.telemetry_age) }}</td>
              <td class="number wide" :data-what="isGeographic ? 'latitude, longitude' : 'east, north, m'" :title="isGeographic ? localPosition(v) : ''" :data-testid="'place-' + v.agent">{{ position(v, isGeographic) }}</td>
            </tr>
          </tbody>
        </table>
        <p v-if="!team.vehicles.length" class="none">No agent of this team has devices.</p>
      </section>
      <section class="panel coordinators" aria-label="Coordinators">
        <h2>Coordinators</h2>
        <article v-for="c in team.coordinators" :key="c.agent" :data-testid="'coordinator-' + c.agent" :class="{old: !c.fresh}">
          <h3>{{ c.agent }}<small>{{ activityOf(c) }}</small></h3>
          <p v-if="c.line || c.waits_for" class="line"><code v-if="c.line">{{ c.file }}:{{ c.line }}</code><template v-if="c.waits_for"> waits for <code>{{ c.waits_for }}</code></template></p>
          <program v-if="programs[c.agent] && !c.finished" :program="programs[c.agent]"/>
          <p v-if="c.doubt" class="bad">{{ c.doubt }}</p>
          <p v-if="c.finished && c.detail" :class="{bad: c.finished !== 'done'}">{{ c.detail }}</p>
          <p class="hops"><span v-if="c.hops !== null" class="hop">{{ c.hops }} hop{{ c.hops === 1 ? "" : "s" }}</span><span v-for="hop in c.trail.slice(-3).reverse()" :key="hop.number" class="hop">{{ hop.source }} → {{ hop.target }}{{ hop.failure ? ", failed" : hop.duration === null ? "" : ", " + duration(hop.duration) }}</span></p>
        </article>
        <p v-if="!team.coordinators.length" class="none">No coordinator known yet.</p>
      </section>
      <section class="panel hosts" aria-label="Hosts">
        <h2>Hosts</h2>
        <ul>
          <li v-for="host in team.hosts" :key="host.host" :data-testid="'host-' + host.host" :class="{old: !host.linked}">
            <i class="lamp" :class="host.linked ? 'ok' : 'unreachable'"></i><b>{{ host.host }}</b><span>{{ hostText(host) }}</span>
          </li>
        </ul>
      </section>
      <section v-if="!recorded" class="panel capabilities" aria-label="Capabilities">
        <h2>Capabilities</h2>
        <form @submit.prevent="submitQuery">
          <input v-model="query" data-testid="query" aria-label="Query" placeholder="Lift where payload >= 2.0" autocomplete="off" spellcheck="false" maxlength="4000"/>
          <button type="submit" :disabled="!query.trim() || isQuerying">Ask</button>
        </form>
        <div v-if="answer" class="answer" data-testid="answer" role="status">
          <p class="why">{{ answer.question }}, asked {{ age(Math.max(0, now - answer.receivedAt) / 1000) }} ago</p>
          <pre v-if="answer.errors" class="bad">{{ answer.errors }}</pre>
          <p v-for="(reason, host) in answer.unreachable" :key="host" class="bad">{{ host }}: {{ reason }}</p>
          <template v-for="found in answer.answers" :key="found.primitive">
            <h3>{{ found.primitive }}<small>{{ found.offers.length ? found.count + " can" : "no agent can" }}</small></h3>
            <ol v-if="found.offers.length"><li v-for="offer in found.offers" :class="{old: unreachableHostsOf(offer).length}" :data-testid="'offer-' + offer.agent"><b>{{ offer.agent }}</b> at {{ offer.host }}, {{ offer.how }}, score {{ offer.score.toFixed(3) }}<small>{{ [...offer.facts, ...offer.parts].join(", ") }}</small><template v-if="unreachableHostsOf(offer).length"> {{ unreachableHostsOf(offer).join(", ") }} unreachable now</template></li></ol>
            <p v-for="note in found.notes">{{ note }}</p>
            <pre v-if="found.refusals" class="why">{{ found.refusals }}</pre>
          </template>
        </div>
        <ul v-else class="offers">
          <li v-for="offer in team.offers" :key="offer.agent" :class="{old: !offer.fresh}"><b>{{ offer.agent }}</b> {{ offer.type }}<span v-if="offer.refusal" class="bad"> {{ offer.refusal }}</span></li>
        </ul>
      </section>
      </div>
      <plots v-if="!recorded"/>
    </main>
    <p v-else-if="!problem" class="none">Waiting for the state of the team.</p>
    <dialog ref="confirmation" @close="onConfirmClosed">
      <form method="dialog">
        <p>{{ confirmText }}</p>
        <button value="" data-testid="no" autofocus>Cancel</button>
        <button value="yes" data-testid="yes">Yes, {{ confirming }}</button>
      </form>
    </dialog>
  </div>`,
  data: () => ({
    team: null, replay: null, tracks: [], drawings: [], epoch: 0, newLines: [], at: null, receivedAt: 0, now: 0, problem: "", pending: {}, failures: {}, selected: "",
    query: "", isQuerying: false, answer: null, confirming: "",
  }),
  computed: {
    stale() {
      return this.team !== null && this.now - this.receivedAt > STALE_AFTER;
    },
    denied() {
      return this.team?.denied_orders ?? {};
    },
    deniedTexts() {
      const reasons = new Set();
      return Object.fromEntries(Object.entries(this.denied).filter(([, reason]) => !reasons.has(reason) && reasons.add(reason)));
    },
    liftable() {
      const stop = this.team?.stop;
      return Boolean(stop) && (this.team.is_stopped || Object.keys({ ...stop.unreached, ...stop.stopped_before }).length > 0);
    },
    state() {
      if (!this.team) return "";
      const linked = this.team.hosts.filter((host) => host.linked).length;
      const parts = [`${linked} of ${this.team.hosts.length} hosts ${this.recorded ? "recorded at this time" : "linked"}`];
      const { hosts, unreached, pending } = this.team.stop;
      const missing = Object.keys(unreached);
      if (hosts.length) parts.push(hosts.length === linked && !pending.length ? "STOPPED" : `STOPPED at ${hosts.join(", ")}`);
      if (pending.length) parts.push(`STOP: ${pending.join(", ")} not answered yet`);
      if (missing.length) parts.push(`STOP has NOT REACHED ${missing.join(", ")}`);
      if (this.team.paused.length) parts.push(`paused at ${this.team.paused.join(", ")}`);
      const voting = this.team.hosts.filter((host) => host.held_by_vote).map((host) => host.host);
      if (voting.length) parts.push(`held by a vote at ${voting.join(", ")}`);
      if (this.stale) parts.push(`updated ${format.age((this.now - this.receivedAt) / 1000)} ago`);
      return parts.join(" · ");
    },
    // The stacks of the coordinators in a recording.
    programs() {
      return Object.fromEntries((this.replay?.coordinators ?? []).map((program) => [program.agent, program]));
    },
    confirmText() {
      return CONFIRMATIONS[this.confirming] ?? "";
    },
    isGeographic() {
      return format.isGeographic(this.team.vehicles);
    },
    losses() {
      const kinds = (host) => Object.entries(host.lost_events).map(([kind, count]) => `${count} ${kind}`).join(", ");
      return this.team.hosts.filter((host) => Object.keys(host.lost_events).length).map((host) => `${host.host}: events lost: ${kinds(host)}`);
    },
  },
  methods: {
    age: format.age, metres: format.metres, percent: format.percent, position: format.position, localPosition: format.localPosition,
    duration: format.duration,
    lamp(v) {
      if (!v.fresh) return "unreachable";
      if (v.devices.some((d) => d.latched)) return "latched";
      return "ok";
    },
    latchText(d) {
      const was = d.fresh ? "" : "was ";
      if (!d.confirmed) return `${was}not confirmed`;
      return `${was}safe, ${d.moving || "at rest"}`;
    },
    activityOf(c) {
      if (c.finished) return `${c.finished} at ${c.host}`;
      if (c.target) return `${c.host} → ${c.target}`;
      return `at ${c.host}${c.state ? ", " + c.state : ""}`;
    },
    hostText(host) {
      const parts = [];
      if (!host.linked) parts.push(host.age === null ? "no contact yet" : `last contact ${format.age(host.age)} ago`);
      if (host.end_reason) parts.push(`ended: ${host.end_reason}`);
      else if (host.problem) parts.push(host.problem);
      const reached = Object.entries(host.links).map(([other, link]) => {
        const measured = format.linkFigures(link);
        return measured ? `${other} (${measured})` : other;
      });
      if (host.linked) parts.push(reached.length ? `linked with ${reached.join(", ")}` : "linked");
      for (const [other, seconds] of Object.entries(host.unreachable_for)) parts.push(`no contact with ${other} for ${format.age(seconds)}`);
      if (host.bundle) parts.push(`bundle ${host.bundle}`);
      if (host.waits_for.length) parts.push(`start waits for ${host.waits_for.join(", ")}`);
      if (host.start_held) parts.push(`start held: ${host.start_held}`);
      for (const [other, reason] of Object.entries(host.refused)) parts.push(`no link with ${other}: ${reason}`);
      if (host.stopped) parts.push(host.linked ? "stopped" : "was stopped");
      if (host.paused) parts.push(host.linked ? "paused" : "was paused");
      if (host.held_by_vote) parts.push(`${host.linked ? "held" : "was held"} until the result of a vote about an activation is known`);
      if (host.clock_offset !== null && Math.abs(host.clock_offset) > 1) parts.push(`its clock is ${format.age(Math.abs(host.clock_offset))} ${host.clock_offset > 0 ? "ahead" : "behind"}`);
      return parts.join(" · ");
    },
    onSnapshot({ at, team, log, epoch, replay, tracks }) {
      // NiceGUI's own connection reloads the page when it times out; the last known state and STOP would be gone.
      // The page does not need that connection.
      window.socket?.disconnect();
      this.team = team;
      this.replay = replay;
      this.addTrackPoints(tracks);
      if (epoch !== this.epoch) [this.epoch, this.newLines] = [epoch, []];
      this.at = at;
      this.receivedAt = this.now = performance.now();
      this.problem = "";
      this.dropReceivedFailures();
      if (log.length) this.newLines = log;
    },
    // Adds the new points of all tracks.
    addTrackPoints({ is_whole, tracks }) {
      if (is_whole) this.tracks = [];
      for (const { agent, points } of tracks) {
        const track = this.tracks.find((each) => each.agent === agent);
        if (track) track.points = geometry.thinned([...track.points, ...points], MAX_POINTS);
        else this.tracks.push({ agent, points });
      }
    },
    // Requests the drawings until the server has answered.
    async loadDrawings() {
      try {
        this.drawings = await fetchDrawings();
      } catch {
        this.retryTimer = setTimeout(this.loadDrawings, 5000);
      }
    },
    async press(order) {
      const press = { since: performance.now(), after: this.newest([...PAIRS.flat()]) };
      const pressed = this.at === null ? null : this.at + (press.since - this.receivedAt) / 1000;
      this.now = press.since;
      this.pending = { ...this.pending, [order]: press };
      this.failures = without(this.failures, pairOf(order));
      try {
        await sendOrder(order, pressed);
      } catch (error) {
        this.failures = { ...this.failures, [order]: { reason: error.message, refused: error.refused, after: press.after, pressed } };
        this.dropReceivedFailures();
      }
      if (this.pending[order]?.since === press.since) this.pending = without(this.pending, [order]);
    },
    // The number of the last order of these kinds that the server has reported.
    newest(kinds) {
      const numbers = this.team?.orders.filter((order) => kinds.includes(order.order)).map((order) => order.number) ?? [];
      return Math.max(0, ...numbers);
    },
    // A failed request may have reached the server all the same: then the snapshot has its result. A release that has
    // not arrived in time is refused.
    dropReceivedFailures() {
      const received = Object.entries(this.failures).filter(([order, failure]) => this.newest(pairOf(order)) > failure.after);
      if (received.length) this.failures = without(this.failures, received.map(([order]) => order));
      for (const order of RELEASES) {
        const failure = this.failures[order];
        if (!failure || failure.refused || failure.pressed === null || this.at <= failure.pressed + this.team.press_timeout) continue;
        const reason = "it did not reach the server in time; check the state, and press it again";
        this.failures = { ...this.failures, [order]: { ...failure, reason, refused: true } };
      }
    },
    // The hosts of an offer that are unreachable now.
    unreachableHostsOf(offer) {
      const linked = this.team.hosts.filter((host) => host.linked).map((host) => host.host);
      return offer.hosts.filter((host) => !linked.includes(host));
    },
    confirm(order) {
      this.confirming = order;
      this.$refs.confirmation.returnValue = "";
      this.$refs.confirmation.showModal();
    },
    onConfirmClosed() {
      if (this.$refs.confirmation.returnValue === "yes") this.press(this.confirming);
    },
    async submitQuery() {
      const question = this.query;
      this.isQuerying = true;
      try {
        this.answer = { ...(await sendQuery(question)), receivedAt: performance.now() };
      } catch (error) {
        this.answer = { question, errors: error.message, unreachable: {}, answers: [], receivedAt: performance.now() };
      }
      this.isQuerying = false;
    },
  },
  async mounted() {
    const stylesheet = document.createElement("link");
    await this.$nextTick();
    stylesheet.rel = "stylesheet";
    stylesheet.href = `${this.resourcePath}/leaflet/leaflet.css`;
    document.head.append(stylesheet);
    this.stopPolling = pollSnapshots(this.onSnapshot, (error) => {
      this.now = performance.now();
      this.problem = `No connection to the server of this page; last known values: ${error.message}`;
    });
    this.loadDrawings();
    this.clockTimer = setInterval(() => (this.now = performance.now()), 500);
  },
  unmounted() {
    this.stopPolling?.();
    clearInterval(this.clockTimer);
    clearTimeout(this.retryTimer);
  },
};
