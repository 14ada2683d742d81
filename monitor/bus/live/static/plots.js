// The plots over time: newest sample at the right edge, time counted back from it.
const { SYMBOLS, color, element } = O2;
const GAP_S = 1; // without samples, after which lines break
const STEPS = [5, 10, 15, 30, 60, 120, 300];

/** A time before the newest sample, in the unit of an axis that spans so many seconds. */
function back(seconds, span) {
  const s = Math.round(seconds);
  return s === 0 ? "now" : span > 60 ? `−${s / 60} min` : `−${s} s`;
}

export class Plots {
  constructor(section, state) {
    Object.assign(this, { section, state, plots: [], span: innerWidth < 600 ? 60 : 180, held: null });
    const spans = document.getElementById("spans");
    spans.addEventListener("click", (event) => {
      if (!event.target.dataset.span) return;
      this.span = Number(event.target.dataset.span);
      this.press();
      this.update();
    });
    this.hold = document.getElementById("hold");
    this.hold.addEventListener("click", () => {
      this.held = this.held ? null : { samples: this.state.samples, windows: this.state.windows };
      this.press();
      this.update();
    });
    this.press();
    new ResizeObserver(() => this.section.clientWidth !== this.width && this.build()).observe(section);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.build());
  }

  press() {
    for (const button of document.querySelectorAll("#spans button")) {
      button.setAttribute("aria-pressed", String(Number(button.dataset.span) === this.span));
    }
    this.hold.setAttribute("aria-pressed", String(Boolean(this.held)));
    this.hold.textContent = this.held ? "go on" : "hold";
  }

  /** The samples of the span as columns; time in s. */
  columns() {
    const { samples, windows } = this.held || this.state;
    const all = (1 << this.state.conditions.length) - 1;
    const end = samples[samples.length - 1][0] / 1000;
    const begin = end - this.span;
    let first = samples.findIndex((sample) => sample[0] / 1000 >= begin);
    first = Math.max(0, first - 1);
    const c = { t: [], measured: [], predicted: [], residual: [], enabled: [], begin, end };
    const add = (t, y, p, on) => {
      c.t.push(t);
      c.measured.push(y);
      c.predicted.push(p);
      c.enabled.push(on);
      c.residual.push(on && y != null && p != null ? y - p : null);
    };
    for (let i = first; i < samples.length; i++) {
      const [ms, y, p, held] = samples[i];
      if (c.t.length && ms / 1000 - c.t[c.t.length - 1] > GAP_S) add(c.t[c.t.length - 1] + 0.01, null, null, false);
      add(ms / 1000, y, p, held === all);
    }
    c.windows = windows.filter((each) => each.end_ms / 1000 >= begin && each.start_ms / 1000 <= end);
    c.off = complement(c);
    const of = (field) => {
      const values = new Array(c.t.length).fill(null);
      for (const each of c.windows) {
        for (let i = 0; i < c.t.length; i++) if (c.t[i] * 1000 >= each.start_ms - 1 && c.t[i] * 1000 <= each.end_ms + 1) values[i] = each[field];
      }
      return values;
    };
    c.mean = of("mean");
    c.std = of("std");
    return c;
  }

  update() {
    if (!this.state.samples.length) return;
    const isOther = (this.state.vehicle_offset == null) !== (this.offset == null);
    if (!this.plots.length || isOther) return this.build();
    this.offset = this.state.vehicle_offset ?? null;
    this.c = this.columns();
    for (const { plot, data } of this.plots) {
      plot.setData(data(this.c));
      latest(plot);
    }
  }

  build() {
    for (const { plot, figure } of this.plots) {
      plot.destroy();
      figure.remove();
    }
    this.plots = [];
    this.width = this.section.clientWidth;
    if (!this.state.samples.length || !this.width) return;
    this.c = this.columns();
    const style = getComputedStyle(this.section);
    this.inner = this.width - parseFloat(style.paddingLeft) - parseFloat(style.paddingRight);
    const name = this.state.output.replace(/_measured$/, ""), isLambda = name.startsWith("lambda");
    this.offset = this.state.vehicle_offset ?? null;
    const hidden = { paths: () => null, stroke: color("quiet"), width: 0 };
    const outputs = { range: () => O2.outputRange(this.c, 0, this.c.t.length - 1, isLambda), top: 8 };
    const heights = [this.inner < 600 ? 200 : 230, 120, 120];
    for (const each of O2.judged(name, this.offset, this.state.limits, heights, hidden, outputs)) this.add(...each);
  }

  add(title, height, data, series, axis) {
    const figure = element(this.section, "figure"), isLast = axis.windows === "std";
    const x = { size: isLast ? 24 : 6, splits: () => this.times(),
      values: (u, splits) => splits.map((t) => (isLast ? back(this.c.end - t, this.span) : "")) };
    const plot = O2.plot(figure, title, data(this.c), series, {
      width: this.inner, height: height + (isLast ? 18 : 0), padding: [axis.top || 8, 18, 0, 0],
      scales: { x: { time: false, range: () => [this.c.begin, this.c.end] }, y: { range: axis.range } },
      axes: [x, { size: 58, space: 26 }],
      cursor: { sync: { key: "live", setSeries: false }, drag: { x: false, y: false } },
      hooks: { setCursor: [latest], drawClear: [(u) => O2.shade(u, this.c.off)], draw: [(u) => O2.pen(u, true, () => (O2.limits(u, axis), axis.windows && this.boxes(u, axis.windows)))] },
    });
    if (axis.windows === "mean") {
      const key = element(figure.firstChild, "span", { className: "key", textContent: "✓ passed  ✕ failed  ? not judged" });
      figure.firstChild.firstChild.after(key);
    }
    plot.root.setAttribute("role", "img");
    plot.root.setAttribute("aria-label", `${title}; the figures stand in the panels`);
    latest(plot);
    this.plots.push({ plot, figure, data });
  }

  /** Round distances back from the newest sample. */
  times() {
    const most = this.inner < 600 ? 4 : 9;
    const step = STEPS.find((s) => this.span / s <= most) || this.span;
    const at = [];
    for (let s = Math.floor(this.span / step) * step; s >= 0; s -= step) at.push(this.c.end - s);
    return at;
  }

  /** A bar for each window at its value; its verdict as colour and sign. */
  boxes(u, field) {
    const ctx = u.ctx, ratio = uPlot.pxRatio;
    const { top, height } = u.bbox;
    ctx.textAlign = "center";
    for (const each of this.c.windows) {
      if (each[field] == null) continue;
      const from = u.valToPos(each.start_ms / 1000, "x", true) + ratio;
      const to = u.valToPos(each.end_ms / 1000, "x", true) - ratio;
      const y = u.valToPos(each[field] - (field === "mean" ? this.offset ?? 0 : 0), "y", true);
      ctx.fillStyle = color(each.verdict);
      ctx.fillRect(from, y - 2 * ratio, Math.max(to - from, 2 * ratio), 4 * ratio);
      if (to - from < 10 * ratio) continue;
      const above = y - top > height / 2 && y - top > 18 * ratio;
      ctx.fillText(SYMBOLS[each.verdict], (from + to) / 2, y + (above ? -10 : 11) * ratio);
    }
  }
}

/** The legend reads the newest sample while no pointer is on the plot. */
function latest(plot) {
  if (plot.cursor.idx == null && plot.data?.[0].length) plot.setLegend({ idx: plot.data[0].length - 1 }, false);
}

/** Begin and end of what is not enabled. */
function complement(c) {
  const off = [];
  let from = null;
  c.t.forEach((t, i) => {
    if (!c.enabled[i] && from == null) from = t;
    if (c.enabled[i] && from != null) {
      off.push([from, t]);
      from = null;
    }
  });
  if (from != null) off.push([from, c.end]);
  return off;
}
