// State of the emergency stop and results of the buttons: hosts and devices that have confirmed, have not, or are
// unreachable. Shown for as long as it is true.
import * as words from "./words.js";

const CALLED = { stop: "STOP", lift: "Lift the stop", pause: "Pause", resume: "Resume" };
// A completed order is shown for this time (s); after it the state of the team shows the result.
const DONE_SHOWN = 20;

const count = (things) => Object.keys(things).length;

export default {
  props: { look: Object, pending: Object, failures: Object, now: Number },
  template: `
  <div>
    <p v-for="(press, order) in waiting" :key="order" class="trouble asking" role="status" :data-testid="'asking-' + order"><b>{{ called[order] }}</b> pressed: waiting for the hosts, {{ age((now - press.since) / 1000) }}</p>
    <p v-for="(failure, order) in failures" :key="order" class="trouble" role="alert" data-testid="failed">{{ failed(order, failure) }}</p>
    <section v-if="shown" class="halt" :class="{complete: look.complete, quiet: !look.stands && !missing}" data-testid="halt" role="alert">
      <h2>{{ title }}</h2>
      <p v-if="stop.reason">{{ stop.reason }}<template v-if="stop.by">, by {{ stop.by }}</template><template v-if="stop.age !== null">, {{ age(stop.age) }} ago</template></p>
      <ul>
        <li v-for="(why, host) in stop.unreached" :key="'h' + host" class="bad loud" :data-testid="'unreached-' + host"><b>{{ host }}</b> NOT REACHED: {{ why }}</li>
        <li v-for="(why, device) in stop.unconfirmed" :key="'u' + device" class="bad" :data-testid="'unconfirmed-' + device"><b>{{ device }}</b> NOT CONFIRMED: {{ why }}</li>
        <li v-for="host in stop.asked" :key="'a' + host" class="bad" :data-testid="'asked-' + host"><b>{{ host }}</b> has not answered yet</li>
        <li v-for="device in stop.confirmed" :key="'c' + device" :data-testid="'confirmed-' + device"><b>{{ device }}</b> safe, {{ doing(device) }}</li>
        <li v-for="(devices, host) in stop.before" :key="'b' + host" class="old" :data-testid="'before-' + host"><b>{{ host }}</b> unreachable; stopped {{ silence(host) }}{{ devices.length ? ", " + devices.join(", ") + " safe" : "" }}</li>
      </ul>
    </section>
    <section v-for="order in others" :key="order.number" class="halt" :class="{quiet: well(order)}" role="status" :data-testid="'order-' + order.order">
      <h2>{{ heading(order) }}</h2>
      <ul>
        <li v-for="(why, host) in order.unreached" :key="'h' + host" class="bad loud"><b>{{ host }}</b> NOT REACHED: {{ why }}</li>
        <li v-for="(why, device) in order.unconfirmed" :key="'u' + device" class="bad"><b>{{ device }}</b> NOT CONFIRMED: {{ why }}</li>
        <li v-for="(why, host) in order.troubles" :key="'t' + host" class="bad"><b>{{ host }}</b> {{ why }}</li>
        <li v-for="host in order.asked" :key="'a' + host"><b>{{ host }}</b> has not answered yet</li>
        <li v-if="order.done.length">done at {{ order.done.join(", ") }}</li>
      </ul>
    </section>
  </div>`,
  data: () => ({ called: CALLED }),
  computed: {
    stop() {
      return this.look.stop;
    },
    // An order that the server has received is shown by its result.
    waiting() {
      const isReceived = (press) => this.look?.orders.some((order) => order.number > press.after);
      return Object.fromEntries(Object.entries(this.pending).filter(([, press]) => !isReceived(press)));
    },
    missing() {
      return count(this.stop.unreached) + count(this.stop.unconfirmed) + this.stop.asked.length;
    },
    shown() {
      return this.look && (this.look.stands || this.missing > 0 || count(this.stop.before) > 0);
    },
    title() {
      if (this.look.complete) {
        const isAtRest = this.stop.confirmed.every((device) => this.doing(device) === "at rest");
        return `Stopped: every device is safe${isAtRest ? " and at rest" : ", not yet at rest"}`;
      }
      if (this.look.stands) {
        if (this.missing) return `Stopped: ${this.missing} not confirmed`;
        return `Stopped at ${this.stop.hosts.join(", ")}; unreachable: ${Object.keys(this.stop.before).join(", ")}`;
      }
      if (this.missing) return `Stop pressed: ${this.missing} not confirmed`;
      const linked = this.look.hosts.some((host) => host.linked);
      return linked ? "No stop is active on the linked hosts" : "No host is linked";
    },
    others() {
      const open = (order) => !this.well(order) || order.age < DONE_SHOWN;
      return this.look ? this.look.orders.filter((order) => order.order !== "stop" && open(order)) : [];
    },
  },
  methods: {
    age: words.age,
    failed(order, { why, refused }) {
      if (refused) return `${CALLED[order]} not executed: ${why}`;
      const advice = order === "stop" ? "press it again, or use 'lfield estop'" : "check the state, and press it again";
      return `${CALLED[order]} possibly not executed: ${why}; ${advice}`;
    },
    well(order) {
      return !(order.asked.length || count(order.unreached) || count(order.unconfirmed) || count(order.troubles));
    },
    heading(order) {
      const missing = order.asked.length + count(order.unreached) + count(order.unconfirmed);
      const came = missing ? `${missing} not confirmed` : "done";
      return `${CALLED[order.order]}, ${words.age(order.age)} ago: ${came}`;
    },
    silence(name) {
      const host = this.look.hosts.find((each) => each.host === name);
      return host && host.age !== null ? `at last contact, ${words.age(host.age)} ago` : "at last contact";
    },
    // The remaining motion of a device in its safe state.
    doing(name) {
      const devices = this.look.vehicles.flatMap((v) => v.devices);
      const moving = devices.find((d) => d.name === name)?.moving;
      return moving === undefined ? "no report since" : moving || "at rest";
    },
  },
};
