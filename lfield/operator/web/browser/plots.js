// Battery, height, link age and hops per minute of the last ten minutes, with ECharts. Nothing is requested while the
// plots are closed.
import { echarts } from "nicegui-echart";
import { colourOf } from "./colours.js";
import { fetchCurves, sleep } from "./server.js";

// Milliseconds between two requests.
const INTERVAL = 4000;

const KINDS = {
  height: { title: "Height, m", scale: 1 },
  battery: { title: "Battery, %", scale: 100, min: 0, max: 100 },
  link: { title: "Link age, s", scale: 1, min: 0 },
  hops: { title: "Hops per minute", scale: 1, min: 0 },
};

function options(kind, curves) {
  const textColour = getComputedStyle(document.documentElement).getPropertyValue("--muted");
  const line = getComputedStyle(document.documentElement).getPropertyValue("--line");
  const minutes = (value) => (value === 0 ? "now" : `${-value / 60} min`);
  const axis = { axisLabel: { color: textColour, fontSize: 11 }, splitLine: { lineStyle: { color: line } } };
  return {
    animation: false,
    grid: { left: 44, right: 14, top: 12, bottom: 24 },
    tooltip: { trigger: "axis", confine: true, valueFormatter: (value) => Number(value).toPrecision(3) },
    xAxis: { type: "value", min: -600, max: 0, interval: 120, ...axis, axisLine: { lineStyle: { color: line } }, splitLine: { show: false }, axisLabel: { ...axis.axisLabel, formatter: minutes } },
    yAxis: { type: "value", splitNumber: 4, axisLine: { show: false, onZero: false }, axisTick: { show: false }, min: kind.min, max: kind.max, scale: kind.min === undefined, ...axis },
    series: curves.map((curve) => ({
      type: "line",
      name: curve.agent,
      showSymbol: curve.points.length === 1,
      lineStyle: { width: 1.5, color: colourOf(curve.agent) },
      itemStyle: { color: colourOf(curve.agent) },
      // Points have ages; the time axis goes to the right.
      data: curve.points.map(([age, value]) => [-age, value * kind.scale]),
    })),
  };
}

export default {
  template: `
    <details class="panel plots" data-testid="plots" @toggle="onToggle">
      <summary><h2>Plots</h2></summary>
      <div class="charts">
        <figure v-for="(kind, quantity) in kinds" :key="quantity"><figcaption>{{ kind.title }}</figcaption><div :ref="quantity" class="chart" :data-testid="'plot-' + quantity"></div></figure>
      </div>
      <p v-for="(names, group) in legends" :key="group" class="key" :data-testid="'key-' + group">{{ titles[group] }}<span v-for="name in names" :key="name"><i :style="{background: colourOf(name)}"></i>{{ name }}</span></p>
      <p v-if="problem" class="bad">{{ problem }}</p>
    </details>`,
  data: () => ({ kinds: KINDS, titles: { vehicles: "Vehicles: ", hops: "Hops of: " }, legends: {}, problem: "" }),
  methods: {
    colourOf,
    onToggle(event) {
      this.open = event.target.open;
      if (this.open && !this.busy) this.drawForever();
    },
    async drawForever() {
      this.busy = true;
      while (this.open) {
        try {
          this.draw(await fetchCurves());
          this.problem = "";
        } catch (error) {
          this.problem = error.message;
        }
        await sleep(INTERVAL);
      }
      this.busy = false;
    },
    draw(curves) {
      const names = (curves) => [...new Set(curves.map((curve) => curve.agent))];
      this.legends = {
        vehicles: names(curves.filter((curve) => curve.quantity !== "hops")),
        hops: names(curves.filter((curve) => curve.quantity === "hops")),
      };
      for (const [quantity, kind] of Object.entries(KINDS)) {
        const chart = (this.charts[quantity] ??= echarts.init(this.$refs[quantity][0]));
        chart.setOption(options(kind, curves.filter((curve) => curve.quantity === quantity)), { notMerge: true });
      }
    },
    onResize() {
      for (const chart of Object.values(this.charts)) chart.resize();
    },
  },
  created() {
    this.charts = {};
    this.open = this.busy = false;
  },
  mounted() {
    window.addEventListener("resize", this.onResize);
  },
  unmounted() {
    this.open = false;
    window.removeEventListener("resize", this.onResize);
    for (const chart of Object.values(this.charts)) chart.dispose();
  },
};
