"use strict";
// Draws the plots of each unfolded recording. Needs uPlot and draw.js; loads nothing.
(() => {
  const { SYMBOLS, color, digits, element, tag, pen } = O2;
  const VERDICTS = ["passed", "failed", "inconclusive"];
  const ROWS = ["fault flag", "paper’s rule", "window", "enabled"]; // bottom up
  const STATISTICS = {
    evidence: "evidence", hypothesis: "best hypothesis", dead_time_rich_to_lean_s: "dead time to lean, s",
    dead_time_lean_to_rich_s: "dead time to rich, s", lag_rich_to_lean_s: "lag to lean, s", lag_lean_to_rich_s: "lag to rich, s",
    gain: "gain", gain_std: "gain std", offset: "offset", offset_std: "offset std", offset_beyond: "offset beyond, std",
  };
  const recordings = [];

  /** One series on the sample grid from spans [begin, end, value]; null outside. */
  function spread(t, spans) {
    const values = new Array(t.length).fill(null);
    let i = 0;
    for (const [begin, end, value] of spans) {
      while (i < t.length && t[i] < begin - 1e-3) i++;
      for (; i < t.length && t[i] < end - 1e-3; i++) values[i] = value;
    }
    return values;
  }

  /** Columns for all plots, aligned on the sample grid. */
  function columns(data) {
    const grid = data.t_s;
    const t = Array.isArray(grid) ? grid : Array.from({ length: grid.count }, (_, i) => grid.start + i * grid.period);
    const step = t.length > 1 ? (t[t.length - 1] - t[0]) / (t.length - 1) : 0;
    const end = (w) => w.t_end_s + 2e-3; // its last sample belongs to it
    const of = (field) => spread(t, data.windows.map((w) => [w.t_start_s, end(w), field(w)]));
    const on = (spans) => spread(t, spans.map(([a, b]) => [a, b, 1])).map((v) => v ?? 0);
    const enabled = on(data.enabled);
    const residual = t.map((_, i) => {
      const [y, p] = [data.measured[i], data.predicted[i]];
      return enabled[i] && y != null && p != null ? y - p : null;
    });
    return {
      t, step, enabled, residual, measured: data.measured, predicted: data.predicted,
      mean: of((w) => w.mean), std: of((w) => w.std), flag: on(data.fault_flag),
      verdict: of((w) => VERDICTS.indexOf(w.verdict)), paper: of((w) => (w.paper_failed ? 1 : 0)),
    };
  }

  /** Begin and end of what is not enabled. */
  function complement(spans, begin, end) {
    const out = [];
    let at = begin;
    for (const [a, b] of spans) {
      if (a > at) out.push([at, a]);
      at = b;
    }
    if (end > at) out.push([at, end]);
    return out;
  }

  class Plots {
    constructor(section) {
      this.section = section;
      this.plots = [];
      this.view = null;
      section.addEventListener("click", (event) => this.press(event.target.dataset.zoom));
    }

    load() {
      if (this.data) return;
      this.data = JSON.parse(document.getElementById(this.section.dataset.series).textContent);
      if (!this.data.samples) return;
      this.columns = columns(this.data);
      const t = this.columns.t;
      this.whole = [t[0], Math.max(t[t.length - 1], t[0] + 1)];
      this.off = this.data.has_model ? complement(this.data.enabled, this.whole[0], this.whole[1]) : [];
      this.marks = [];
      for (const dtc of this.data.dtcs) {
        if (dtc.t_s == null) continue;
        const same = this.marks.find((mark) => Math.abs(mark.t - dtc.t_s) < 1e-3);
        if (same) same.label += ", " + dtc.code;
        else this.marks.push({ t: dtc.t_s, label: dtc.code });
      }
    }

    build(width) {
      this.load();
      this.clear();
      if (!this.data.samples) {
        this.section.classList.add("none");
        element(this.section, "p", { className: "quiet", textContent: "No series were kept for this recording." });
        return;
      }
      this.width = width || this.section.clientWidth;
      this.toolbar();
      const c = this.columns;
      const name = this.data.output;
      const narrow = this.width < 600;
      const range = { range: (u) => O2.outputRange(c, ...u.series[0].idxs, name === "lambda"), top: this.marks.length > 1 ? 36 : 20 };
      if (!this.data.has_model) {
        this.add(`Measured ${name}`, narrow ? 240 : 280, [c.t, c.measured], [{ label: "measured", stroke: color("measured"), width: 1.25, digits: 4 }], { ...range, xlabel: "time in s" });
        if (this.view) this.show(...this.view);
        return;
      }
      const window = { stroke: color("measured"), width: 2, paths: uPlot.paths.stepped({ align: 1 }) };
      const { vehicle_offset: offset, limits, windows, enabled } = this.data;
      const judged = O2.judged(name, offset, limits, [narrow ? 240 : 280, 160, 140], window, range);
      for (const [title, height, of, series, axis] of judged.slice(0, windows.length ? 4 : enabled.length ? 2 : 1)) {
        this.add(title, height, of(c), series, axis);
      }
      this.strip();
      if (this.view) this.show(...this.view);
    }

    /** Rows of states over time, as on a logic analyser. */
    strip() {
      const c = this.columns;
      const word = (yes, no) => (u, v) => (v == null ? "–" : v ? yes : no);
      const none = { paths: () => null, points: { show: false }, stroke: color("band"), width: 0 };
      const series = [
        { ...none, label: "enabled", value: word("yes", "no") },
        { ...none, label: "window", value: (u, v) => (v == null ? "–" : VERDICTS[v]) },
        { ...none, label: "paper’s rule", value: word("failed", "not failed") },
        { ...none, label: "fault flag", value: word("set", "off") },
      ];
      const figure = this.add("States", 170, [c.t, c.enabled, c.verdict, c.paper, c.flag], series, {
        range: () => [0, 4], rows: true, xlabel: "time in s",
      });
      const key = element(figure, "div", { className: "key" });
      element(key, "span", { textContent: "Window verdict:" });
      element(key, "span", { textContent: "▬ half height, ✓ passed" });
      element(key, "span", { textContent: "█ full height, ✕ failed" });
      element(key, "span", { textContent: "▭ outline, ? inconclusive" });
    }

    toolbar() {
      const bar = element(this.section, "div", { className: "toolbar" });
      element(bar, "h3", { textContent: "Over time" });
      for (const [zoom, text, title] of [
        ["left", "◀", "earlier"], ["in", "+", "zoom in"], ["out", "−", "zoom out"],
        ["right", "▶", "later"], ["whole", "whole drive", "show the whole recording"],
      ]) {
        const button = element(bar, "button", { type: "button", textContent: text, title });
        button.setAttribute("aria-label", title);
        button.dataset.zoom = zoom;
      }
      const thin = this.data.shown < this.data.samples
        ? ` ${this.data.shown} of ${this.data.samples} samples are drawn; extremes are kept.` : "";
      element(this.section, "p", {
        className: "quiet hint",
        textContent: "Drag across a plot to zoom, double-click for the whole drive. "
          + (this.data.has_model ? "Grey: not enabled." : "No prediction is drawn: no model judged this recording.") + thin,
      });
      const offset = this.data.vehicle_offset;
      if (offset == null) return;
      element(this.section, "p", {
        className: "quiet hint",
        textContent: `This vehicle reads ${digits(Math.abs(offset), 3)} ${offset > 0 ? "above" : "below"} the model, as a healthy vehicle may: `
          + "fuel, injectors and sensors differ from vehicle to vehicle. Prediction, residual and window means are drawn with this offset, "
          + "the dashed line is the prediction as trained. The offset comes from the first minutes; the verdict does without it.",
      });
    }

    add(title, height, data, series, axis) {
      const figure = element(this.section, "figure");
      const y = { size: this.width < 600 ? 78 : 84, space: 26 };
      if (axis.rows) Object.assign(y, { splits: () => [0.5, 1.5, 2.5, 3.5], values: () => ROWS, grid: { show: false }, ticks: { show: false } });
      const x = { size: axis.xlabel ? 26 : 24, gap: 3, space: 60, label: axis.xlabel,
        values: (u, splits) => splits.map((v) => String(+v.toFixed(3))) };
      const heading = title + (this.section.dataset.name.endsWith("(simulated)") ? " (simulated)" : "");
      this.plots.push(O2.plot(figure, heading, data, series, {
        width: this.width, height, padding: [axis.top || 8, 14, 0, 0], axes: [x, y],
        scales: { x: { time: false, range: (u, min, max) => (min == null ? this.whole : [min, max]) }, y: { range: axis.range } },
        cursor: { sync: { key: this.section.dataset.series, setSeries: false }, drag: { x: true, y: false }, points: { show: !axis.rows } },
        hooks: {
          drawClear: [(u) => O2.shade(u, this.off)],
          draw: [(u) => pen(u, false, () => this.over(u, axis))],
          setScale: [(u, key) => key === "x" && this.follow(u)],
        },
      }));
      return figure;
    }

    over(u, axis) {
      if (axis.rows) this.states(u);
      O2.limits(u, axis);
      this.codes(u, axis.top);
    }

    /** Vertical lines where codes were set, the codes above the first plot, in two rows if need be. */
    codes(u, labelled) {
      const ctx = u.ctx, ratio = uPlot.pxRatio;
      const { left, top, width, height } = u.bbox;
      const free = [-Infinity, -Infinity];
      const labels = [];
      ctx.strokeStyle = color("failed");
      ctx.lineWidth = 1.5 * ratio;
      ctx.setLineDash([]);
      for (const { t, label } of this.marks) {
        const x = u.valToPos(t, "x", true);
        if (x < left || x > left + width) continue;
        const w = ctx.measureText(label).width;
        const from = Math.max(left, Math.min(x - w / 2, left + width - w));
        const row = labelled ? free.findIndex((end) => end < from) : -1;
        const y = top - (10 + 15 * row) * ratio;
        ctx.beginPath();
        ctx.moveTo(x, row < 0 ? top : y);
        ctx.lineTo(x, top + height);
        ctx.stroke();
        if (row < 0) continue;
        labels.push([label, from, y]);
        free[row] = from + w + 8 * ratio;
      }
      for (const [label, from, y] of labels) tag(u, label, from, y, color("failed"));
    }

    /** Rows of boxes; the height of a window's box says its verdict as well as the colour. */
    states(u) {
      const ctx = u.ctx, ratio = uPlot.pxRatio;
      const { left, width } = u.bbox;
      ctx.textAlign = "center";
      const box = (row, a, b, share, name, filled, symbol) => {
        const from = Math.max(left, u.valToPos(a, "x", true));
        const to = Math.min(left + width, u.valToPos(b, "x", true));
        if (to < from || to - from <= 0) return;
        const base = u.valToPos(row + 0.12, "y", true);
        const high = (u.valToPos(row + 0.12, "y", true) - u.valToPos(row + 0.88, "y", true)) * share;
        const gap = to - from > 4 * ratio ? 0.5 * ratio : 0;
        ctx.fillStyle = ctx.strokeStyle = color(name);
        ctx.lineWidth = ratio;
        ctx.setLineDash([]);
        if (filled) ctx.fillRect(from + gap, base - high, to - from - 2 * gap, high);
        else ctx.strokeRect(from + gap, base - high, Math.max(0, to - from - 2 * gap), high);
        if (symbol && to - from > 14 * ratio) {
          ctx.fillStyle = filled && share === 1 ? color("card") : color(name);
          ctx.fillText(symbol, (from + to) / 2, share === 1 ? base - high / 2 : base - high - 6 * ratio);
        }
      };
      for (const [a, b] of this.data.enabled) box(3, a, b, 1, "band", true, "");
      for (const w of this.data.windows) {
        const end = w.t_end_s + this.columns.step;
        const share = { passed: 0.45, failed: 1, inconclusive: 0.45 }[w.verdict];
        box(2, w.t_start_s, end, share, w.verdict, w.verdict !== "inconclusive", SYMBOLS[w.verdict]);
        box(1, w.t_start_s, end, w.paper_failed ? 1 : 0.08, w.paper_failed ? "failed" : "band", true, w.paper_failed ? "✕" : "");
      }
      for (const [a, b] of this.data.fault_flag) box(0, a, b, 1, "failed", true, "");
    }

    follow(source) {
      const { min, max } = source.scales.x;
      if (min == null || this.following) return;
      this.following = true;
      this.view = min <= this.whole[0] && max >= this.whole[1] ? null : [min, max];
      for (const plot of this.plots) {
        const own = plot.scales.x;
        if (plot !== source && (own.min !== min || own.max !== max)) plot.setScale("x", { min, max });
      }
      this.following = false;
    }

    show(from, to) {
      const width = Math.min(to - from, this.whole[1] - this.whole[0]);
      const min = Math.max(this.whole[0], Math.min(from, this.whole[1] - width));
      for (const plot of this.plots) plot.setScale("x", { min, max: min + width });
      this.view = width < this.whole[1] - this.whole[0] ? [min, min + width] : null;
    }

    press(zoom) {
      if (!zoom || !this.plots.length) return;
      const { min, max } = this.plots[0].scales.x;
      const [middle, half] = [(min + max) / 2, (max - min) / 2];
      const least = Math.max(2 * this.columns.step, 0.5);
      if (zoom === "whole") this.show(...this.whole);
      else if (zoom === "in") this.show(middle - Math.max(half / 2, least), middle + Math.max(half / 2, least));
      else if (zoom === "out") this.show(middle - 2 * half, middle + 2 * half);
      else if (zoom === "left") this.show(min - half, max - half);
      else this.show(min + half, max + half);
    }

    clear() {
      for (const plot of this.plots) plot.destroy();
      this.plots = [];
      this.section.replaceChildren();
    }
  }

  /** A cell's text: four digits, no exponent, a dash for nothing. */
  const cell = (v) => (v == null ? "–" : typeof v !== "number" ? v : Math.abs(v) < 1e-6 ? "0" : String(+v.toPrecision(4)).replace("-", "−"));

  /** All windows of a recording as a table, made when it is unfolded. */
  function table(details, windows) {
    if (details.querySelector("table")) return;
    const all = new Set(windows.flatMap((w) => Object.keys(w.statistics ?? {})));
    const keys = Object.keys(STATISTICS).filter((key) => all.delete(key)).concat([...all].sort());
    const head = ["#", "time, s", "mean", "std", "verdict", "paper’s rule", ...keys.map((key) => STATISTICS[key] ?? key)];
    O2.table(element(details, "div", { className: "scroll" }), head, windows.map((w) => [
      w.index, `${w.t_start_s.toFixed(1)}–${w.t_end_s.toFixed(1)}`, cell(w.mean), cell(w.std),
      [[SYMBOLS[w.verdict], w.verdict, w.fault].filter(Boolean).join(" "), `mark ${w.verdict}`],
      w.paper_failed ? "failed" : "–", ...keys.map((key) => cell(w.statistics?.[key])),
    ]));
  }

  for (const section of document.querySelectorAll(".plots")) {
    const each = new Plots(section);
    recordings.push(each);
    const windows = section.parentElement.querySelector(".windows");
    windows?.addEventListener("toggle", () => (each.load(), table(windows, each.data.windows)));
    section.closest("details").addEventListener("click", (event) => {
      const at = parseFloat(event.target.dataset.show);
      if (Number.isNaN(at)) return;
      if (!each.plots.length) each.build();
      if (each.plots.length) each.show(at - 30, at + 30);
      section.scrollIntoView({ behavior: "smooth", block: "start" });
    });
  }

  O2.follow(recordings);

  function openTarget() {
    const target = document.getElementById(location.hash.slice(1));
    if (target instanceof HTMLDetailsElement) {
      target.open = true;
      target.scrollIntoView();
    }
  }
  addEventListener("hashchange", openTarget);
  document.addEventListener("click", (event) => event.target.closest?.('a[href^="#"]') && setTimeout(openTarget));
  openTarget();
})();
