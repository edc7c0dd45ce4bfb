// State of the emergency stop and results of the buttons: hosts and devices that have confirmed, have not, or are
// unreachable. Shown for as long as it is true.
import * as format from "./text_format.js";

const TITLES = { stop: "STOP", lift: "Lift the stop", pause: "Pause", resume: "Resume" };
// A completed order is shown for this time (s); after it the state of the team shows the result.
const RESULT_SHOWN = 20;

const count = (table) => Object.keys(table).length;

export default {
  props: { team: Object, pending: Object, failures: Object, now: Number },
  template: `
  <div>
    <p v-for="(press, order) in waiting" :key="order" class="problem pending" role="status" :data-testid="'asking-' + order"><b>{{ titles[order] }}</b> pressed: waiting for the hosts, {{ age((now - press.since) / 1000) }}</p>
    <p v-for="(failure, order) in failures" :key="order" class="problem" role="alert" data-testid="failed">{{ failureText(order, failure) }}</p>
    <section v-if="isVisible" class="order-status" :class="{complete: team.is_stop_complete, quiet: !team.is_stopped && !missing}" data-testid="halt" role="alert">
      <h2>{{ title }}</h2>
      <p v-if="stop.reason">{{ stop.reason }}<template v-if="stop.by">, by {{ stop.by }}</template><template v-if="stop.age !== null">, {{ age(stop.age) }} ago</template></p>
      <ul>
        <li v-for="(reason, host) in stop.unreached" :key="'h' + host" class="bad strong" :data-testid="'unreached-' + host"><b>{{ host }}</b> NOT REACHED: {{ reason }}</li>
        <li v-for="(reason, device) in stop.unconfirmed" :key="'u' + device" class="bad" :data-testid="'unconfirmed-' + device"><b>{{ device }}</b> NOT CONFIRMED: {{ reason }}</li>
        <li v-for="host in stop.pending" :key="'a' + host" class="bad" :data-testid="'asked-' + host"><b>{{ host }}</b> has not answered yet</li>
        <li v-for="device in stop.confirmed" :key="'c' + device" :data-testid="'confirmed-' + device"><b>{{ device }}</b> safe, {{ motionOf(device) }}</li>
        <li v-for="(devices, host) in stop.stopped_before" :key="'b' + host" class="old" :data-testid="'before-' + host"><b>{{ host }}</b> unreachable; stopped {{ lastContact(host) }}{{ devices.length ? ", " + devices.join(", ") + " safe" : "" }}</li>
      </ul>
    </section>
    <section v-for="order in otherOrders" :key="order.number" class="order-status" :class="{quiet: isComplete(order)}" role="status" :data-testid="'order-' + order.order">
      <h2>{{ heading(order) }}</h2>
      <ul>
        <li v-for="(reason, host) in order.unreached" :key="'h' + host" class="bad strong"><b>{{ host }}</b> NOT REACHED: {{ reason }}</li>
        <li v-for="(reason, device) in order.unconfirmed" :key="'u' + device" class="bad"><b>{{ device }}</b> NOT CONFIRMED: {{ reason }}</li>
        <li v-for="(reason, host) in order.warnings" :key="'t' + host" class="bad"><b>{{ host }}</b> {{ reason }}</li>
        <li v-for="host in order.pending" :key="'a' + host"><b>{{ host }}</b> has not answered yet</li>
        <li v-if="order.done.length">done at {{ order.done.join(", ") }}</li>
      </ul>
    </section>
  </div>`,
  data: () => ({ titles: TITLES }),
  computed: {
    stop() {
      return this.team.stop;
    },
    // An order that the server has received is shown by its result.
    waiting() {
      const isReceived = (press) => this.team?.orders.some((order) => order.number > press.after);
      return Object.fromEntries(Object.entries(this.pending).filter(([, press]) => !isReceived(press)));
    },
    missing() {
      return count(this.stop.unreached) + count(this.stop.unconfirmed) + this.stop.pending.length;
    },
    isVisible() {
      return this.team && (this.team.is_stopped || this.missing > 0 || count(this.stop.stopped_before) > 0);
    },
    title() {
      if (this.team.is_stop_complete) {
        const isAtRest = this.stop.confirmed.every((device) => this.motionOf(device) === "at rest");
        return `Stopped: every device is safe${isAtRest ? " and at rest" : ", not yet at rest"}`;
      }
      if (this.team.is_stopped) {
        if (this.missing) return `Stopped: ${this.missing} not confirmed`;
        return `Stopped at ${this.stop.hosts.join(", ")}; unreachable: ${Object.keys(this.stop.stopped_before).join(", ")}`;
      }
      if (this.missing) return `Stop pressed: ${this.missing} not confirmed`;
      const linked = this.team.hosts.some((host) => host.linked);
      return linked ? "No stop is active on the linked hosts" : "No host is linked";
    },
    otherOrders() {
      const open = (order) => !this.isComplete(order) || order.age < RESULT_SHOWN;
      return this.team ? this.team.orders.filter((order) => order.order !== "stop" && open(order)) : [];
    },
  },
  methods: {
    age: format.age,
    failureText(order, { reason, refused }) {
      if (refused) return `${TITLES[order]} not executed: ${reason}`;
      const advice = order === "stop" ? "press it again, or use 'lfield estop'" : "check the state, and press it again";
      return `${TITLES[order]} possibly not executed: ${reason}; ${advice}`;
    },
    isComplete(order) {
      return !(order.pending.length || count(order.unreached) || count(order.unconfirmed) || count(order.warnings));
    },
    heading(order) {
      const missing = order.pending.length + count(order.unreached) + count(order.unconfirmed);
      const result = missing ? `${missing} not confirmed` : "done";
      return `${TITLES[order.order]}, ${format.age(order.age)} ago: ${result}`;
    },
    lastContact(name) {
      const host = this.team.hosts.find((each) => each.host === name);
      return host && host.age !== null ? `at last contact, ${format.age(host.age)} ago` : "at last contact";
    },
    // The remaining motion of a device in its safe state.
    motionOf(name) {
      const devices = this.team.vehicles.flatMap((v) => v.devices);
      const moving = devices.find((d) => d.name === name)?.moving;
      return moving === undefined ? "no report since" : moving || "at rest";
    },
  },
};
