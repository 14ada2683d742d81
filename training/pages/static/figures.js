"use strict";
// Draws the figures that training/pages/drawing.py writes into a page as JSON. Needs uPlot and draw.js.
(() => {
  const { color, element, rule, pen } = O2;
  const COLOURS = ["measured", "predicted", "passed", "failed", "residual", "simulated", "quiet", "band"];
  const NARROW = 620; // px of a figure, below which its plots stand in one column
  const SCALES = { log: { distr: 3 }, symlog: { distr: 4 } };
  const ink = (layer) => color(COLOURS[layer.color % COLOURS.length] ?? layer.color ?? "measured");

  /** A number without an exponent: 0.001 and 1,000. */
  const full = (v) => (v == null ? "" : v.toLocaleString("en-GB", { maximumSignificantDigits: 3 }).replace("-", "−"));

  /** The next lower number with one digit, where a logarithmic axis begins. */
  function rounded(v) {
    const unit = 10 ** Math.floor(Math.log10(v));
    return Math.floor(v / unit) * unit;
  }

  /** What a layer draws, with the canvas and a function from values to canvas pixels. */
  const DRAW = {
    line: ({ ctx, at, layer }) => {
      ctx.beginPath();
      layer.x.forEach((x, i) => {
        if (x == null || layer.y[i] == null) return;
        ctx[layer.y[i - 1] == null ? "moveTo" : "lineTo"](at(x, "x"), at(layer.y[i], "y"));
      });
      ctx.stroke();
    },
    area: ({ ctx, at, layer }) => {
      ctx.beginPath();
      layer.x.forEach((x, i) => ctx.lineTo(at(x, "x"), at(layer.y[i], "y")));
      ctx.fill();
    },
    points: ({ ctx, at, ratio, layer }) => layer.x.forEach((x, i) => {
      if (x == null || layer.y[i] == null) return;
      const [left, top, r] = [at(x, "x"), at(layer.y[i], "y"), (layer.size ?? 3) * ratio];
      ctx.beginPath();
      if (layer.mark === "|") ctx.rect(left - ratio, top - 2 * r, 2 * ratio, 4 * r);
      else ctx.arc(left, top, r, 0, 7);
      ctx.fill();
      if (layer.text?.[i]) ctx.fillText(layer.text[i], left + 1.5 * r + 2 * ratio, top);
    }),
    /** Squares of a grid, the deeper the more samples they hold. */
    cells: ({ ctx, at, layer }) => layer.x.forEach((x, i) => {
      const [w, h] = layer.size, [left, top] = [at(x, "x"), at(layer.y[i] + h, "y")];
      ctx.globalAlpha = 0.15 + 0.85 * Math.log(layer.count[i]) / Math.log(Math.max(2, ...layer.count));
      ctx.fillRect(left, top, at(x + w, "x") - left, at(layer.y[i], "y") - top);
    }),
    /** Horizontal bars from 0, one per row. */
    bars: ({ ctx, at, layer, ratio }) => layer.x.forEach((x, i) => {
      const [zero, end, top] = [at(0, "x"), at(x, "x"), at(layer.y[i] - 0.36, "y")];
      ctx.globalAlpha = layer.alpha?.[i] ?? 1;
      ctx.fillRect(Math.min(zero, end), top, Math.abs(end - zero), at(layer.y[i] + 0.36, "y") - top);
      ctx.globalAlpha = 1;
      ctx.fillStyle = color("quiet");
      ctx.fillText(layer.text?.[i] ?? "", Math.max(zero, end) + 6 * ratio, at(layer.y[i], "y"));
      ctx.fillStyle = ink(layer);
    }),
    /** A histogram: counts between edges, standing on the lower end of the axis. */
    steps: ({ ctx, u, at, layer }) => layer.y.forEach((count, i) => {
      if (!count) return;
      const [left, right, top] = [at(layer.x[i], "x"), at(layer.x[i + 1], "x"), at(count, "y")];
      ctx.fillRect(left, top, Math.max(right - left, 1), u.bbox.top + u.bbox.height - top);
    }),
    rule: ({ ctx, u, at, ratio, layer }) => ["x", "y"].forEach((axis) => (layer[axis] ?? []).forEach((value, i) => {
      rule(u, axis, value, ctx.strokeStyle, layer.dash, layer.width);
      if (layer.text?.[i]) ctx.fillText(layer.text[i], at(value, "x") + 3 * ratio, u.bbox.top + 8 * ratio);
    })),
    spans: () => {},
  };

  /** Lowest and highest value of an axis over all layers, with some room. */
  function extent(plot, axis) {
    const { low = null, high = null, scale, rows } = plot[axis];
    if (rows) return [-0.6, rows.length - 0.4];
    const seen = plot.layers.filter((each) => each.kind !== "spans").flatMap((each) => each[axis] ?? []);
    if (axis === "x") seen.push(...(plot.at ?? []));
    const values = seen.filter((v) => v != null && (scale !== "log" || v > 0));
    let [from, to] = [low ?? Math.min(...values), high ?? Math.max(...values)];
    if (!Number.isFinite(from) || !Number.isFinite(to)) [from, to] = [scale === "log" ? 1 : 0, 10];
    if (scale === "log") return [low ?? rounded(0.9 * from), high ?? (to > from ? to : 10 * from) * 1.3];
    const room = (axis === "x" && plot.at ? 0 : 0.04) * (to - from) || (to > from ? 0 : 0.5);
    return [low ?? from - room, high ?? to + room];
  }

  function axisOf(spec, isX, width, wide) {
    const axis = isX ? { space: 60, size: 26, label: spec.label } : { space: 26, size: wide ?? ((u, values) => 14 + widest(values ?? ["0.000"])) };
    if (spec.scale) axis.values = (u, splits) => splits.map(full);
    if (spec.ticks) Object.assign(axis, { splits: () => spec.ticks.map(([value]) => value), values: (u) => apart(u, spec.ticks) });
    if (!spec.rows) return axis;
    return { ...axis, grid: { show: false }, ticks: { show: false }, splits: () => spec.rows.map((_, i) => i),
      values: () => spec.rows.map((name) => shortened(name, 0.5 * width)) };
  }

  /** Labels of ticks, without those that would stand on another. */
  function apart(u, ticks) {
    let free = -Infinity;
    const places = ticks.map(([value, name]) => [u.valToPos(value, "x"), widest([name]) / 2 + 3, name]);
    const shown = new Set();
    for (const each of [...places].sort((a, b) => a[0] - b[0])) {
      if (each[0] - each[1] < free) continue;
      shown.add(each);
      free = each[0] + each[1];
    }
    return places.map((each) => (shown.has(each) ? each[2] : ""));
  }

  const ruler = document.createElement("canvas").getContext("2d");
  ruler.font = "12px system-ui, sans-serif";
  const widest = (texts) => Math.max(...texts.map((text) => ruler.measureText(text ?? "").width));
  function shortened(text, most) {
    while (text.length > 4 && widest([text]) > most) text = `${text.replace(/…$/, "").slice(0, -1)}…`;
    return text;
  }

  class Figure {
    constructor(section) {
      Object.assign(this, { section, plots: [], wide: 58 }); // px of the y axes of plots that stand together
    }

    build(width) {
      this.spec ??= JSON.parse(this.section.querySelector("script").textContent);
      for (const plot of this.plots) plot.destroy();
      this.grid?.remove();
      this.width = width ?? this.section.clientWidth;
      const shares = this.width < NARROW ? [1] : this.spec.columns;
      this.grid = element(this.section, "div", { className: "grid" });
      this.section.prepend(this.grid);
      this.grid.style.gridTemplateColumns = shares.map((share) => `minmax(0, ${share}fr)`).join(" ");
      const whole = (this.width - 16 * (shares.length - 1)) / shares.reduce((a, b) => a + b);
      this.plots = this.spec.plots.map((plot, i) => this.plot(plot, whole * shares[i % shares.length]));
    }

    plot(spec, width) {
      const holder = element(this.grid, "div");
      const own = spec.layers.filter((each) => each.kind === "line" && !each.x);
      const rest = spec.layers.filter((each) => !own.includes(each));
      const [x, y] = [extent(spec, "x"), extent(spec, "y")];
      const series = own.map((each) => ({ label: each.label, stroke: ink(each), width: each.width ?? 1.25, dash: each.dash,
        digits: spec.digits, points: { show: each.y.filter((v) => v != null).length === 1 } }));
      const data = own.length ? [spec.at, ...own.map((each) => each.y)] : [x, [null, null]];
      const scale = ({ scale, linear, rows, falls }) => ({ ...SCALES[scale], asinh: linear, dir: rows || falls ? -1 : 1 });
      const plot = O2.plot(holder, spec.title, data, own.length ? series : [{}], {
        at: "at", width, height: spec.height + (spec.x.label ? 20 : 0), padding: [8, 14, 0, 0],
        axes: [axisOf(spec.x, true), axisOf(spec.y, false, width, this.spec.together ? (u, values) => (this.wide = Math.max(this.wide, 14 + widest(values ?? [""]))) : undefined)],
        scales: {
          x: { time: false, ...scale(spec.x), range: (u, low, high) => (own.length && low < high ? [low, high] : x) },
          y: { ...scale(spec.y), range: () => y },
        },
        legend: { show: own.some((each) => each.label) },
        cursor: own.length ? { sync: this.spec.together && { key: `figure ${all.indexOf(this)}`, setSeries: false } } : { show: false },
        hooks: {
          drawClear: [(u) => rest.forEach((each) => each.kind === "spans" && O2.shade(u, each.x, each.color && ink(each)))],
          draw: [(u) => pen(u, true, (ctx, ratio) => rest.forEach((layer) => this.over(u, ctx, ratio, layer)))],
        },
      });
      this.key(holder.querySelector("figcaption"), rest.filter((each) => each.label));
      return plot;
    }

    over(u, ctx, ratio, layer) {
      ctx.save();
      ctx.font = ctx.font.replace("600 ", "");
      ctx.fillStyle = ctx.strokeStyle = ink(layer);
      ctx.textAlign = "left";
      ctx.lineWidth = (layer.width ?? 1) * ratio;
      ctx.globalAlpha = typeof layer.alpha === "number" ? layer.alpha : 1;
      DRAW[layer.kind]({ u, ctx, ratio, layer, at: (value, axis) => u.valToPos(value, axis, true) });
      ctx.restore();
    }

    key(caption, layers) {
      const key = element(caption, "span", { className: "key" });
      for (const layer of layers) {
        const name = element(key, "span", { textContent: layer.label });
        name.prepend(Object.assign(document.createElement("i"), { textContent: layer.kind === "line" || layer.kind === "rule" ? "━ " : `${layer.mark ?? "●"} ` }));
        name.firstChild.style.color = ink(layer);
      }
    }
  }

  const all = [...document.querySelectorAll("figure.plots")].map((section) => new Figure(section));
  O2.follow(all);
})();
