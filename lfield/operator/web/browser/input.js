// A field for each host at which an agent waits for a line of input (`read`). `at` is the time of the snapshot by the
// server's clock, `taken` when it arrived by the clock of the page (ms).
import { enter } from "lfield-watch";

export default {
  props: { hosts: Array, at: Number, taken: Number, denied: String },
  template: `
  <section v-if="waiting.length" class="panel input" aria-label="Input">
    <form v-for="host in waiting" :key="host.host" :data-testid="'input-' + host.host" @submit.prevent="send(host.host)">
      <label>{{ host.reads[0] }} at {{ host.host }} waits for a line
        <input v-model="texts[host.host]" :data-testid="'line-' + host.host" :disabled="!host.linked || Boolean(denied)" :title="denied"
               autocomplete="off" spellcheck="false" maxlength="1024"/></label>
      <button type="submit" :disabled="!host.linked || Boolean(denied) || sending">Enter</button>
      <p v-if="troubles[host.host]" class="bad" role="alert">{{ troubles[host.host] }}</p>
    </form>
  </section>`,
  data: () => ({ texts: {}, troubles: {}, sending: false }),
  computed: {
    waiting() {
      return this.hosts.filter((host) => host.reads.length);
    },
  },
  methods: {
    async send(host) {
      const pressed = this.at === null ? null : this.at + (performance.now() - this.taken) / 1000;
      this.sending = true;
      try {
        await enter(host, this.texts[host] ?? "", pressed);
        this.texts = { ...this.texts, [host]: "" };
        this.troubles = { ...this.troubles, [host]: "" };
      } catch (error) {
        this.troubles = { ...this.troubles, [host]: error.message };
      }
      this.sending = false;
    },
  },
};
