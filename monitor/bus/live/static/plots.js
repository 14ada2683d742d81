// The plots over time: newest sample at the right edge, time counted back from it.
import { digits, element, signed } from "./panels.js";

const LAMBDA_RANGE = [0.7, 1.3]; // a fuel cut leaves the plot
const GAP_S = 1; // without samples, after which lines break
const FONT = "system-ui, -apple-system, 'Segoe UI', Roboto, 'Noto Sans', sans-serif";
const STEPS = [5, 10, 15, 30, 60, 120, 300];
export const SYMBOLS = { passed: "✓", failed: "✕", inconclusive: "?" };

const color = (name) => getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();

/** As many digits as a step needs, at most five. */
function places(step) {
  let n = 0;
  while (n < 5 && Math.abs(step * 10 ** n - Math.round(step * 10 ** n)) > 1e-6 * step * 10 ** n) n++;
  return n;
}

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
    const { j_mu: mu, j_sigma: sigma } = this.state.limits;
    const name = this.state.output.replace(/_measured$/, "");
    const [blue, orange, violet] = ["measured", "predicted", "residual"].map(color);
    const number = (u, v) => digits(v, 4);
    const plus = (u, v) => signed(v, 4);
    this.offset = this.state.vehicle_offset ?? null;
    const shift = (values, by) => values.map((v) => (v == null ? null : v + by));
    const own = this.offset == null ? "" : " for this vehicle", by = this.offset ?? 0;
    const adapted = this.offset == null ? [] : [{ label: "predicted for this vehicle", stroke: orange, width: 3, value: number }];
    const plain = adapted.length ? { label: "predicted, as trained", stroke: color("quiet"), width: 1.25, dash: [6, 4] } : { label: "predicted", stroke: orange, width: 3 };
    const hidden = { paths: () => null, stroke: color("quiet"), width: 0 };
    this.add(`Measured and predicted ${name}`, this.inner < 600 ? 200 : 230, (c) => [c.t, c.predicted, ...adapted.map(() => shift(c.predicted, by)), c.measured], [
      { value: number, ...plain },
      ...adapted,
      { label: "measured", stroke: blue, width: 1.3, value: number },
    ], { range: () => this.outputRange(), top: 8 });
    this.add(`Residual${own}, enabled samples`, 120, (c) => [c.t, shift(c.residual, -by)], [
      { label: "residual", stroke: violet, width: 1.2, value: plus },
    ], { range: (u, low, high) => symmetric(low, high, 0.01), zero: true });
    this.add(`Window mean${own}`, 120, (c) => [c.t, shift(c.mean, -by)], [{ ...hidden, label: "mean", value: plus }], {
      range: (u, low, high) => symmetric(low, high, (mu || 0.01) * 1.3), zero: true, windows: "mean",
      limits: mu == null ? [] : [[mu, "±Jμ"], [-mu, "±Jμ"]],
    });
    this.add("Window standard deviation", 120, (c) => [c.t, c.std], [{ ...hidden, label: "std", value: number }], {
      range: (u, low, high) => [0, Math.max(high || 0, sigma || 0, 1e-3) * 1.3], windows: "std", xlabels: true,
      limits: sigma == null ? [] : [[sigma, "Jσ"]],
    });
  }

  add(title, height, data, series, axis) {
    const figure = element(this.section, "figure");
    const caption = element(figure, "figcaption");
    element(caption, "strong", { textContent: title });
    if (axis.windows === "mean") {
      element(caption, "span", { className: "key", textContent: "✓ passed  ✕ failed  ? not judged" });
    }
    const font = `12px ${FONT}`;
    const ink = color("quiet"), grid = { stroke: color("grid"), width: 1 };
    const ticks = { stroke: color("line"), width: 1, size: 4 };
    const options = {
      width: this.inner, height: height + (axis.xlabels ? 18 : 0), pxAlign: 0,
      padding: [axis.top || 8, 18, 0, 0],
      scales: { x: { time: false, range: () => [this.c.begin, this.c.end] }, y: { range: axis.range } },
      axes: [
        { stroke: ink, font, grid, ticks, size: axis.xlabels ? 24 : 6, gap: 4, splits: () => this.times(),
          values: (u, splits) => splits.map((t) => (axis.xlabels ? back(this.c.end - t, this.span) : "")) },
        { stroke: ink, font, grid, ticks, size: 58, gap: 4, space: 26,
          values: (u, splits, i, space, step) => splits.map((v) => digits(v, places(step))) },
      ],
      series: [
        { label: "t", value: (u, t) => (t == null ? "–" : `${digits(t, 1)} s`) },
        ...series.map((each) => ({ points: { show: false }, spanGaps: false, ...each })),
      ],
      legend: { mount: (u, table) => caption.appendChild(table), markers: { width: 0, fill: (u, i) => u.series[i].stroke(u, i) } },
      cursor: { y: false, sync: { key: "live", setSeries: false }, drag: { x: false, y: false }, points: { size: 6 } },
      hooks: { setCursor: [latest], drawClear: [(u) => this.under(u)], draw: [(u) => this.over(u, axis)] },
    };
    const plot = new uPlot(options, data(this.c), figure);
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

  /** Shades what is not enabled. */
  under(u) {
    const { left, top, width, height } = u.bbox;
    u.ctx.save();
    u.ctx.fillStyle = color("shade");
    for (const [a, b] of this.c.off) {
      const from = Math.max(left, u.valToPos(a, "x", true));
      const to = Math.min(left + width, u.valToPos(b, "x", true));
      if (to > from) u.ctx.fillRect(from, top, to - from, height);
    }
    u.ctx.restore();
  }

  over(u, axis) {
    const ctx = u.ctx, ratio = uPlot.pxRatio;
    const { left, top, width, height } = u.bbox;
    ctx.save();
    ctx.beginPath();
    ctx.rect(left, top, width, height);
    ctx.clip();
    ctx.font = `600 ${12 * ratio}px ${FONT}`;
    ctx.textBaseline = "middle";
    if (axis.zero) line(u, 0, color("band"), [], ratio);
    if (axis.windows) this.boxes(u, axis.windows);
    let before = Infinity;
    for (const [value, label] of axis.limits || []) {
      line(u, value, color("failed"), [5 * ratio, 4 * ratio], 1.25 * ratio);
      const at = u.valToPos(value, "y", true);
      if (Math.abs(at - before) < 18 * ratio) continue; // one label for two lines this close
      before = at;
      const w = ctx.measureText(label).width + 8 * ratio;
      ctx.fillStyle = color("card");
      ctx.fillRect(left + 4 * ratio, at - 8 * ratio, w, 16 * ratio);
      ctx.fillStyle = color("failed");
      ctx.textAlign = "left";
      ctx.fillText(label, left + 8 * ratio, at);
    }
    ctx.restore();
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

  /** Range of the enabled samples, within what lambda may show. */
  outputRange() {
    const c = this.c;
    const isLambda = this.state.output.startsWith("lambda");
    const seen = (all) => {
      let low = Infinity, high = -Infinity;
      for (let i = 0; i < c.t.length; i++) {
        if (!all && !c.enabled[i]) continue;
        for (const v of [c.measured[i], c.predicted[i]]) {
          if (v == null || (isLambda && (v < LAMBDA_RANGE[0] || v > LAMBDA_RANGE[1]))) continue;
          if (v < low) low = v;
          if (v > high) high = v;
        }
      }
      return [low, high];
    };
    let [low, high] = seen(false);
    if (low > high) [low, high] = seen(true);
    if (low > high) return isLambda ? LAMBDA_RANGE : [0, 1];
    const least = isLambda ? 0.04 : Math.max(1e-6, Math.abs(high) * 1e-3);
    const pad = Math.max(0.12 * (high - low), (least - (high - low)) / 2);
    return isLambda
      ? [Math.max(low - pad, LAMBDA_RANGE[0]), Math.min(high + pad, LAMBDA_RANGE[1])]
      : [low - pad, high + pad];
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

function symmetric(low, high, least) {
  const far = Math.max(Math.abs(low || 0), Math.abs(high || 0), least) * 1.1;
  return [-far, far];
}

function line(u, value, stroke, dash, width) {
  const { left, width: length } = u.bbox;
  const y = u.valToPos(value, "y", true);
  u.ctx.strokeStyle = stroke;
  u.ctx.lineWidth = width;
  u.ctx.setLineDash(dash);
  u.ctx.beginPath();
  u.ctx.moveTo(left, y);
  u.ctx.lineTo(left + length, y);
  u.ctx.stroke();
  u.ctx.setLineDash([]);
}
