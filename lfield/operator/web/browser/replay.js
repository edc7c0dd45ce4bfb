// Recordings on the page (`lfield watch --replay`): the time slider with its buttons, and the programs at that time.
import { sendReplayCommand } from "./server.js";
import * as format from "./text_format.js";

// The slider follows the server again this time (ms) after the last change.
const FOLLOW_AFTER = 400;

const STEPS = ["hop", "event", "statement"];

// Seconds as "1:02.345".
function elapsed(seconds) {
  const minutes = Math.floor(seconds / 60);
  return `${minutes}:${(seconds - 60 * minutes).toFixed(3).padStart(6, "0")}`;
}

export const Replay = {
  props: { replay: Object },
  template: `
  <section class="panel replay" aria-label="Time of the recording">
    <div class="moves">
      <button v-for="step in back" :key="step" type="button" :data-testid="'replay-back-' + step" :title="'One ' + step + ' back'" @click="send({ go: step, backward: true, agent })">‹ {{ step }}</button>
      <button type="button" class="play" data-testid="replay-play" @click="send(replay.speed ? { go: 'pause' } : { go: 'play', speed })">{{ replay.speed ? "Pause" : "Play" }}</button>
      <button v-for="step in forward" :key="step" type="button" :data-testid="'replay-' + step" :title="'One ' + step + ' forward'" @click="send({ go: step, agent })">{{ step }} ›</button>
      <label>Speed <select v-model.number="speed" data-testid="replay-speed" @change="replay.speed && send({ go: 'play', speed })"><option v-for="each in [0.1, 0.5, 1, 2, 5, 20, 100]" :key="each" :value="each">{{ each }}</option></select></label>
      <label>Statements of <select v-model="agent" data-testid="replay-agent"><option value="">all agents</option><option v-for="c in replay.coordinators" :key="c.agent">{{ c.agent }}</option></select></label>
    </div>
    <input type="range" min="0" :max="replay.duration" step="0.001" :value="targetTime ?? replay.seconds" data-testid="replay-time" aria-label="Time since the start of the recording" @input="onSlide($event.target.valueAsNumber)"/>
    <p><span data-testid="replay-clock">{{ elapsed(targetTime ?? replay.seconds) }} of {{ elapsed(replay.duration) }}</span> · {{ clock(replay.at) }} · {{ replay.host }}<span v-if="busy" data-testid="replay-busy"> · replaying</span><span v-if="replay.progress < 1" data-testid="replay-progress"> · events read: {{ percent(replay.progress) }}</span></p>
    <p v-if="problem || replay.problem" class="bad" data-testid="replay-trouble" role="status">{{ problem || replay.problem }}</p>
    <p v-if="replay.missing.length" class="why" data-testid="replay-missing">No recording of {{ replay.missing.join(", ") }}</p>
    <p v-for="problem in replay.problems" :key="problem" class="why" data-testid="replay-problem">{{ problem }}</p>
  </section>`,
  data: () => ({ targetTime: null, speed: 1, agent: "", problem: "", back: STEPS, forward: [...STEPS].reverse() }),
  computed: {
    busy() {
      return this.replay.requested !== this.replay.executed;
    },
  },
  watch: {
    replay() {
      if (!this.busy && !this.sending && performance.now() - this.lastSlideAt > FOLLOW_AFTER) this.targetTime = null;
    },
  },
  methods: {
    elapsed, clock: format.clock, percent: format.percent,
    onSlide(seconds) {
      this.targetTime = seconds;
      this.lastSlideAt = performance.now();
      this.send({ go: "time", seconds });
    },
    // One request at a time; of several that wait the newest is sent.
    async send(command) {
      this.next = command;
      if (this.sending) return;
      this.sending = true;
      while (this.next) {
        const sent = this.next;
        this.next = null;
        try {
          await sendReplayCommand(sent);
          this.problem = "";
        } catch (error) {
          this.problem = error.message;
        }
      }
      this.sending = false;
    },
  },
  created() {
    this.next = null;
    this.sending = false;
    this.lastSlideAt = 0;
  },
};

// A variable, with its parts below it.
const Variable = {
  name: "ReplayVariable",
  props: { variable: Object },
  template: `
    <li><details v-if="variable.parts.length"><summary><code>{{ variable.name }}</code> {{ variable.type }} <code>{{ variable.value }}</code></summary>
      <ul><replay-variable v-for="part in variable.parts" :key="part.name" :variable="part"/></ul></details>
    <template v-else><code>{{ variable.name }}</code> {{ variable.type }} <code>{{ variable.value }}</code></template></li>`,
};

// The stack of a coordinator, innermost frame first: lines of L, and variables.
export const Program = {
  components: { ReplayVariable: Variable },
  props: { program: Object },
  template: `
  <div class="program" :data-testid="'program-' + program.agent">
    <details v-for="(frame, n) in program.frames" :key="n" :open="n === 0">
      <summary :data-testid="'frame-' + program.agent + '-' + n"><code>{{ frame.method }}</code> {{ frame.agent }} <code v-if="frame.line">{{ frame.file }}:{{ frame.line }}</code></summary>
      <ol v-if="frame.source.length" class="source"><li v-for="[number, text] in frame.source" :key="number" :class="{current: number === frame.line}" :data-testid="'line-' + program.agent + '-' + n + '-' + number"><i>{{ number }}</i><code>{{ text }}</code></li></ol>
      <ul class="variables" :data-testid="'variables-' + program.agent + '-' + n"><replay-variable v-for="variable in frame.variables" :key="variable.name" :variable="variable"/></ul>
    </details>
    <p v-if="program.more" class="why">{{ program.more }} more frames</p>
  </div>`,
};
