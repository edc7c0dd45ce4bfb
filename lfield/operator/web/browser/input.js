// A field for each agent that waits for a line of input (`read`). `at` is the time of the snapshot by the server's clock,
// `receivedAt` when it arrived by the clock of the page (ms).
import { sendInput } from "lfield-watch";

export default {
  props: { hosts: Array, at: Number, receivedAt: Number, denied: String },
  template: `
  <section v-if="waiting.length || problem" class="panel input" aria-label="Input">
    <form v-for="each in waiting" :key="each.agent" :data-testid="'input-' + each.agent" @submit.prevent="submit(each)">
      <label>{{ each.agent }} at {{ each.host }} waits for a line
        <input v-model="texts[each.agent]" :data-testid="'type-' + each.agent" :disabled="!each.linked || Boolean(denied)" :title="denied"
               autocomplete="off" spellcheck="false" maxlength="1024"/></label>
      <button type="submit" :disabled="!each.linked || Boolean(denied) || sending">Enter</button>
    </form>
    <p v-if="problem" class="bad" role="alert" data-testid="input-trouble">{{ problem }}</p>
  </section>`,
  data: () => ({ texts: {}, problem: "", sending: false }),
  computed: {
    // In the order of their names: a field that is moved loses the focus.
    waiting() {
      return this.hosts.flatMap(({ host, linked, awaiting_input }) => [...awaiting_input].sort().map((agent) => ({ host, linked, agent })));
    },
  },
  watch: {
    // A text that was typed for a question is no answer to the next one.
    waiting(now) {
      const agents = new Set(now.map((each) => each.agent));
      for (const agent of Object.keys(this.texts)) if (!agents.has(agent)) delete this.texts[agent];
    },
  },
  methods: {
    async submit({ host, agent }) {
      const pressed = this.at === null ? null : this.at + (performance.now() - this.receivedAt) / 1000;
      this.sending = true;
      try {
        await sendInput(host, agent, this.texts[agent] ?? "", pressed);
        delete this.texts[agent];
        this.problem = "";
      } catch (error) {
        this.problem = error.message;
      }
      this.sending = false;
    },
  },
};
