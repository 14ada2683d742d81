"use strict";
// Draws the plots of each unfolded recording, those in view first. Needs uPlot; loads nothing.
(() => {
  const PRINT_WIDTH = 690; // px, A4 with usual margins
  const LAMBDA_RANGE = [0.7, 1.3]; // a fuel cut leaves the plot
  const VERDICTS = ["passed", "failed", "inconclusive"];
  const SYMBOLS = { passed: "✓", failed: "✕", inconclusive: "?" };
  const ROWS = ["fault flag", "paper’s rule", "window", "enabled"]; // bottom up
  const FONT = "system-ui, -apple-system, 'Segoe UI', Roboto, 'Noto Sans', sans-serif";
  const recordings = [];

  const color = (name) => getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();
  const digits = (value, n) => (value == null ? "–" : value.toFixed(n).replace("-", "−"));

  /** As many digits as a step needs, at most five: 0.025 needs three. */
  function places(step) {
    let n = 0;
    while (n < 5 && Math.abs(step * 10 ** n - Math.round(step * 10 ** n)) > 1e-6) n++;
    return n;
  }

  function element(parent, tag, properties = {}) {
    return parent.appendChild(Object.assign(document.createElement(tag), properties));
  }

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

    get visible() {
      return this.section.closest("details").open;
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
      const blue = color("measured"), orange = color("predicted"), violet = color("residual");
      const narrow = this.width < 600;
      const range = { range: (u) => this.outputRange(u), top: this.marks.length > 1 ? 36 : 20 };
      const measured = { label: "measured", stroke: blue, width: 1.25, digits: 4 };
      if (!this.data.has_model) {
        this.add(`Measured ${name}`, narrow ? 240 : 280, [c.t, c.measured], [measured], { ...range, xlabel: "time in s" });
        if (this.view) this.show(...this.view);
        return;
      }
      const offset = this.data.vehicle_offset;
      const shift = (values, by) => values.map((v) => (v == null ? null : v + by));
      const adapted = offset == null ? [] : [shift(c.predicted, offset)];
      const own = offset == null ? "" : " for this vehicle";
      const plain = offset == null ? { label: "predicted", stroke: orange, width: 3 } : { label: "predicted, as trained", stroke: color("quiet"), width: 1.25, dash: [6, 4] };
      this.add(`Measured and predicted ${name}`, narrow ? 240 : 280, [c.t, c.predicted, ...adapted, c.measured], [
        { digits: 4, ...plain },
        ...adapted.map(() => ({ label: "predicted for this vehicle", stroke: orange, width: 3, digits: 4 })),
        measured,
      ], range);
      this.add(`Residual: measured − predicted${own}, enabled samples`, 160, [c.t, shift(c.residual, -(offset ?? 0))], [
        { label: "residual", stroke: violet, width: 1.1, digits: 4 },
      ], { range: (u, min, max) => symmetric(min, max, 0.01), zero: true });
      const stepped = uPlot.paths.stepped({ align: 1 });
      const { j_mu: mu, j_sigma: sigma } = this.data.limits;
      this.add(`Window mean of the residual${own}`, 140, [c.t, shift(c.mean, -(offset ?? 0))], [
        { label: "mean", stroke: blue, width: 2, paths: stepped, digits: 4 },
      ], { range: (u, min, max) => symmetric(min, max, (mu || 0.01) * 1.25), zero: true,
        limits: mu == null ? [] : [[mu, "+Jμ"], [-mu, "−Jμ"]] });
      this.add("Window standard deviation of the residual", 140, [c.t, c.std], [
        { label: "std", stroke: blue, width: 2, paths: stepped, digits: 4 },
      ], { range: (u, min, max) => [0, Math.max(max || 0, sigma || 0, 1e-3) * 1.2],
        limits: sigma == null ? [] : [[sigma, "Jσ"]] });
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
      const caption = element(figure, "figcaption");
      element(caption, "strong", { textContent: title + (this.section.dataset.name.endsWith("(simulated)") ? " (simulated)" : "") });
      const font = `12px ${FONT}`;
      const ink = color("quiet"), grid = { stroke: color("grid"), width: 1 };
      const ticks = { stroke: color("line"), width: 1, size: 5 };
      const y = { stroke: ink, font, grid, ticks, size: this.width < 600 ? 78 : 84, gap: 4,
        values: (u, splits, ai, space, step) => splits.map((v) => digits(v, places(step))) };
      if (axis.rows) {
        Object.assign(y, { splits: () => [0.5, 1.5, 2.5, 3.5], values: () => ROWS, grid: { show: false }, ticks: { show: false } });
      } else {
        y.space = 26;
      }
      const x = { stroke: ink, font, grid, ticks, size: axis.xlabel ? 26 : 24, gap: 3, space: 60,
        values: (u, splits) => splits.map((v) => String(+v.toFixed(3))) };
      if (axis.xlabel) Object.assign(x, { label: axis.xlabel, labelSize: 20, labelFont: font, labelGap: 0 });
      const options = {
        width: this.width, height, pxAlign: 0,
        padding: [axis.top || 8, 14, 0, 0],
        scales: { x: { time: false, range: (u, min, max) => (min == null ? this.whole : [min, max]) }, y: { range: axis.range } },
        axes: [x, y],
        series: [
          { label: "t", value: (u, v) => (v == null ? "–" : v.toFixed(1) + " s") },
          ...series.map((s) => ({ points: { show: false }, spanGaps: false, value: (u, v) => digits(v, s.digits), ...s })),
        ],
        legend: { mount: (u, table) => caption.appendChild(table), markers: { width: 0, fill: (u, i) => u.series[i].stroke(u, i) } },
        cursor: { y: false, sync: { key: this.section.dataset.series, setSeries: false }, drag: { x: true, y: false }, points: { show: !axis.rows, size: 6 } },
        hooks: {
          drawClear: [(u) => this.under(u)],
          draw: [(u) => this.over(u, axis)],
          setScale: [(u, key) => key === "x" && this.follow(u)],
        },
      };
      this.plots.push(new uPlot(options, data, figure));
      return figure;
    }

    /** Shades what is not enabled. */
    under(u) {
      const { left, top, width, height } = u.bbox;
      u.ctx.save();
      u.ctx.fillStyle = color("shade");
      for (const [a, b] of this.off) {
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
      ctx.font = `600 ${12 * ratio}px ${FONT}`;
      ctx.textBaseline = "middle";
      if (axis.rows) this.states(u);
      if (axis.zero) line(u, 0, color("band"), [], ratio);
      for (const [value, label] of axis.limits || []) {
        line(u, value, color("failed"), [5 * ratio, 4 * ratio], 1.25 * ratio);
        const at = u.valToPos(value, "y", true);
        const w = ctx.measureText(label).width + 8 * ratio;
        ctx.fillStyle = color("card");
        ctx.fillRect(left + width - w - 4 * ratio, at - 8 * ratio, w, 16 * ratio);
        ctx.fillStyle = color("failed");
        ctx.textAlign = "right";
        ctx.fillText(label, left + width - 8 * ratio, at);
      }
      this.codes(u, axis.top);
      ctx.restore();
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
        labels.push([label, from, y, w]);
        free[row] = from + w + 8 * ratio;
      }
      ctx.textAlign = "left";
      for (const [label, from, y, w] of labels) {
        ctx.fillStyle = color("card");
        ctx.fillRect(from - 2 * ratio, y - 7 * ratio, w + 4 * ratio, 14 * ratio);
        ctx.fillStyle = color("failed");
        ctx.fillText(label, from, y);
      }
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

    /** Range of the enabled samples in view, within what lambda may show. */
    outputRange(u) {
      const c = this.columns;
      const [first, last] = u.series[0].idxs;
      const isLambda = this.data.output === "lambda";
      const seen = (all) => {
        let low = Infinity, high = -Infinity;
        for (let i = first; i <= last; i++) {
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
      [low, high] = [low - pad, high + pad];
      if (!isLambda) return [low, high];
      low = Math.max(low, LAMBDA_RANGE[0]);
      high = Math.min(high, LAMBDA_RANGE[1]);
      return high - low > 0.01 ? [low, high] : LAMBDA_RANGE;
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

    resize() {
      const width = this.section.clientWidth;
      if (!this.plots.length || !width || width === this.width) return;
      this.build();
    }
  }

  function symmetric(min, max, least) {
    const far = Math.max(Math.abs(min || 0), Math.abs(max || 0), least) * 1.1;
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

  function rebuild() {
    for (const each of recordings) if (each.plots.length && each.visible) each.build();
  }

  const byView = new IntersectionObserver((entries) => {
    for (const { isIntersecting, target } of entries) {
      const each = recordings.find((r) => r.section === target);
      if (isIntersecting && !each.plots.length && each.visible) each.build();
    }
  }, { rootMargin: "300px" });

  for (const section of document.querySelectorAll(".plots")) {
    const each = new Plots(section);
    recordings.push(each);
    byView.observe(section);
    const details = section.closest("details");
    details.addEventListener("toggle", () => details.open && each.resize());
    details.addEventListener("click", (event) => {
      const at = parseFloat(event.target.dataset.show);
      if (Number.isNaN(at)) return;
      if (!each.plots.length) each.build();
      if (each.plots.length) each.show(at - 30, at + 30);
      section.scrollIntoView({ behavior: "smooth", block: "start" });
    });
  }

  // What is out of view follows when there is time, so that a picture of the whole page has it.
  const idle = window.requestIdleCallback ?? ((work) => setTimeout(work, 50));
  const rest = recordings.slice();
  function buildNext() {
    const each = rest.shift();
    if (!each) return;
    if (each.visible && !each.plots.length) each.build();
    idle(buildNext);
  }
  addEventListener("load", () => idle(buildNext));

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

  let pending = 0;
  addEventListener("resize", () => {
    clearTimeout(pending);
    pending = setTimeout(() => recordings.forEach((each) => each.visible && each.resize()), 150);
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", rebuild);

  // On paper every recording is unfolded, light, and drawn at the paper's width.
  let folded = [];
  addEventListener("beforeprint", () => {
    document.documentElement.dataset.theme = "light";
    folded = recordings.map((each) => each.section.closest("details")).filter((details) => !details.open);
    for (const details of folded) details.open = true;
    for (const each of recordings) each.build(PRINT_WIDTH);
  });
  addEventListener("afterprint", () => {
    delete document.documentElement.dataset.theme;
    for (const details of folded) details.open = false;
    for (const each of recordings) if (each.visible) each.build();
  });
})();
