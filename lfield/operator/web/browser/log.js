// The log of programs and hosts in the order of their timestamps, the newest last.
import * as format from "./text_format.js";

// By timestamp, host and number.
const byHost = (a, b) => (a.host === b.host ? 0 : a.host < b.host ? -1 : 1);
const inOrder = (a, b) => a.at - b.at || a.tick - b.tick || byHost(a, b) || a.serial - b.serial;

export default {
  props: { newLines: Array, maxLines: Number },
  template: `
    <div ref="lines" class="lines" data-testid="log" role="log" tabindex="0" @scroll="scrolled">
      <template v-for="line in log" :key="line.serial">
        <p v-if="line.missing" class="bad" data-testid="log-gap">{{ line.missing }} line{{ line.missing === 1 ? " is" : "s are" }} missing here: the page was inactive</p>
        <p><time>{{ clock(line.at) }}</time><b>{{ line.host }}</b><span>{{ lineText(line) }}</span></p>
      </template>
    </div>`,
  data: () => ({ log: [] }),
  watch: {
    newLines: { immediate: true, handler: "addLines" },
  },
  methods: {
    clock: format.clock,
    // Many programs print the name of their agent themselves.
    lineText({ agent, text }) {
      return agent && !text.startsWith(`${agent}:`) ? `${agent}: ${text}` : text;
    },
    addLines(newLines) {
      if (!newLines.length) return;
      // The server keeps as many lines as the page; older ones are lost when the page was inactive.
      const missing = this.last ? newLines[0].serial - this.last - 1 : 0;
      this.last = newLines.at(-1).serial;
      const added = newLines.map((line, n) => (n || !missing ? line : { ...line, missing }));
      const all = [...this.log, ...added].sort(inOrder);
      const cut = all.splice(0, Math.max(0, all.length - this.maxLines));
      // Gaps among the removed lines move to the first line that stays.
      const lost = cut.reduce((sum, line) => sum + (line.missing ?? 0), all[0].missing ?? 0);
      if (lost) all[0] = { ...all[0], missing: lost };
      this.log = all;
      this.$nextTick(() => {
        const lines = this.$refs.lines;
        if (lines && this.atEnd) lines.scrollTop = lines.scrollHeight;
      });
    },
    scrolled() {
      const lines = this.$refs.lines;
      this.atEnd = lines.scrollHeight - lines.scrollTop - lines.clientHeight < 24;
    },
  },
  created() {
    this.last = 0;
    this.atEnd = true;
  },
};
