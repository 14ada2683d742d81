"use strict";
// What every page draws with: colours, numbers, axes, and when to draw. Needs uPlot; loads nothing.
const O2 = (() => {
  const PRINT_WIDTH = 690; // px, A4 with usual margins
  const LAMBDA_RANGE = [0.7, 1.3]; // a fuel cut leaves the plot
  const FONT = "system-ui, -apple-system, 'Segoe UI', Roboto, 'Noto Sans', sans-serif";
  const SYMBOLS = { passed: "✓", failed: "✕", inconclusive: "?" };

  const color = (name) => getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();
  const digits = (value, n) => (value == null ? "–" : value.toFixed(n).replace("-", "−"));
  const shift = (values, by) => values.map((v) => (v == null ? null : v + by));

  /** As many digits as a step needs, at most five: 0.025 needs three. */
  function places(step) {
    let n = 0;
    while (n < 5 && Math.abs(step * 10 ** n - Math.round(step * 10 ** n)) > 1e-6 * step * 10 ** n) n++;
    return n;
  }

  function element(parent, tag, properties = {}) {
    return parent.appendChild(Object.assign(document.createElement(tag), properties));
  }

  /** A table under its head; a cell is a text, or a text with its class. */
  function table(parent, head, rows) {
    const made = element(parent, "table"), names = element(element(made, "thead"), "tr"), body = element(made, "tbody");
    for (const textContent of head) element(names, "th", { textContent, scope: "col" });
    for (const row of rows) {
      const line = element(body, "tr");
      for (const [textContent, className = ""] of row.map((each) => [each].flat())) element(line, "td", { textContent, className });
    }
    return made;
  }

  function symmetric(low, high, least) {
    const far = Math.max(Math.abs(low || 0), Math.abs(high || 0), least) * 1.1;
    return [-far, far];
  }

  /** What lambda may show: a fuel cut leaves the plot, a sensor that always reads beyond does not. */
  function lambdaRange(c, first, last) {
    const seen = [];
    for (let i = first; i <= last; i++) if (c.enabled[i] && c.measured[i] != null) seen.push(c.measured[i]);
    const middle = seen.sort((a, b) => a - b)[seen.length >> 1] ?? 1;
    return [Math.min(LAMBDA_RANGE[0], 0.95 * middle), Math.max(LAMBDA_RANGE[1], 1.05 * middle)];
  }

  /** Range of the enabled samples from `first` to `last`, within what lambda may show. */
  function outputRange(c, first, last, isLambda) {
    const [least, most] = isLambda ? lambdaRange(c, first, last) : [-Infinity, Infinity];
    const seen = (all) => {
      let low = Infinity, high = -Infinity;
      for (let i = first; i <= last; i++) {
        if (!all && !c.enabled[i]) continue;
        for (const v of [c.measured[i], c.predicted[i]]) {
          if (v == null || v < least || v > most) continue;
          if (v < low) low = v;
          if (v > high) high = v;
        }
      }
      return [low, high];
    };
    let [low, high] = seen(false);
    if (low > high) [low, high] = seen(true);
    if (low > high) return isLambda ? LAMBDA_RANGE : [0, 1];
    const span = isLambda ? 0.04 : Math.max(1e-6, Math.abs(high) * 1e-3);
    const pad = Math.max(0.12 * (high - low), (span - (high - low)) / 2);
    [low, high] = [Math.max(low - pad, least), Math.min(high + pad, most)];
    if (!isLambda) return [low, high];
    return high - low > 0.01 ? [low, high] : LAMBDA_RANGE;
  }

  /** A line across the plot at a value of one of its scales, in CSS pixels wide. */
  function rule(u, scale, value, stroke, dash = [], width = 1) {
    const { ctx, bbox: { left, top, width: wide, height: high } } = u;
    const at = u.valToPos(value, scale, true), ratio = uPlot.pxRatio;
    ctx.strokeStyle = stroke;
    ctx.lineWidth = width * ratio;
    ctx.setLineDash(dash.map((each) => each * ratio));
    ctx.beginPath();
    if (scale === "y") ctx.moveTo(left, at), ctx.lineTo(left + wide, at);
    else ctx.moveTo(at, top), ctx.lineTo(at, top + high);
    ctx.stroke();
    ctx.setLineDash([]);
  }

  /** Text on a card over the plot, from its left end in canvas pixels. */
  function tag(u, text, left, y, ink) {
    const { ctx } = u, ratio = uPlot.pxRatio;
    ctx.fillStyle = color("card");
    ctx.fillRect(left - 4 * ratio, y - 8 * ratio, ctx.measureText(text).width + 8 * ratio, 16 * ratio);
    ctx.fillStyle = ink;
    ctx.textAlign = "left";
    ctx.fillText(text, left, y);
  }

  /** Zero and the limits of a plot, one label for two lines that are close. */
  function limits(u, axis) {
    const { ctx, bbox: { left, width } } = u, ratio = uPlot.pxRatio;
    if (axis.zero) rule(u, "y", 0, color("band"));
    let before = Infinity;
    for (const [value, label] of axis.limits ?? []) {
      rule(u, "y", value, color("failed"), [5, 4], 1.25);
      const at = u.valToPos(value, "y", true), isClose = Math.abs(at - before) < 18 * ratio;
      if (!isClose) tag(u, label, left + width - ctx.measureText(label).width - 8 * ratio, at, color("failed"));
      before = at;
    }
  }

  /** Grey, or an ink thinned, behind spans [begin, end) of x. */
  function shade(u, spans, ink) {
    const { ctx, bbox: { left, top, width, height } } = u;
    ctx.save();
    ctx.fillStyle = ink ?? color("shade");
    ctx.globalAlpha = ink ? 0.35 : 1;
    for (const [a, b] of spans) {
      const from = Math.max(left, u.valToPos(a, "x", true));
      const to = Math.min(left + width, u.valToPos(b, "x", true));
      if (to > from) ctx.fillRect(from, top, to - from, height);
    }
    ctx.restore();
  }

  /** Work on the canvas of a plot with the text of all pages, at most `inside` its frame. */
  function pen(u, inside, work) {
    const { ctx, bbox: { left, top, width, height } } = u;
    ctx.save();
    if (inside) {
      ctx.beginPath();
      ctx.rect(left, top, width, height);
      ctx.clip();
    }
    ctx.font = `600 ${12 * uPlot.pxRatio}px ${FONT}`;
    ctx.textBaseline = "middle";
    work(ctx, uPlot.pxRatio);
    ctx.restore();
  }

  /** A plot under its title and legend; what is in `own` goes over the options of all plots. */
  function plot(figure, title, data, series, own) {
    const caption = element(figure, "figcaption");
    element(caption, "strong", { textContent: title });
    const font = `12px ${FONT}`;
    const look = { stroke: color("quiet"), font, labelFont: font, labelSize: 20, labelGap: 0, gap: 4,
      grid: { stroke: color("grid"), width: 1 }, ticks: { stroke: color("line"), width: 1, size: 5 } };
    const options = {
      pxAlign: 0, ...own,
      axes: own.axes.map((each) => ({ ...look, values: (u, splits, i, space, step) => splits.map((v) => digits(v, places(step))), ...each })),
      series: [
        { label: own.at ?? "t", value: (u, v) => (v == null ? "–" : digits(v, 1) + (own.at ? "" : " s")) },
        ...series.map((s) => ({ points: { show: false }, spanGaps: false, value: (u, v) => digits(v, s.digits), ...s })),
      ],
      legend: { mount: (u, table) => caption.appendChild(table), markers: { width: 0, fill: (u, i) => u.series[i].stroke(u, i) }, ...own.legend },
      cursor: { y: false, ...own.cursor, points: { size: 6, ...own.cursor?.points } },
    };
    return new uPlot(options, data, figure);
  }

  /** Title, height, columns, series and what is drawn over them, for each plot of a judged drive. */
  function judged(name, offset, { j_mu: mu, j_sigma: sigma }, [high, ...low], window, outputs) {
    const by = offset ?? 0, own = offset == null ? "" : " for this vehicle";
    const value = (u, v) => digits(v, 4), signed = (u, v) => (v >= 0 && v != null ? "+" : "") + digits(v, 4);
    const model = { stroke: color("predicted"), width: 3, value };
    const trained = { label: "predicted, as trained", stroke: color("quiet"), width: 1.25, dash: [6, 4], value };
    const models = offset == null ? [{ ...model, label: "predicted" }] : [trained, { ...model, label: "predicted for this vehicle" }];
    const shifts = offset == null ? [0] : [0, by];
    return [
      [`Measured and predicted ${name}`, high, (c) => [c.t, ...shifts.map((each) => shift(c.predicted, each)), c.measured],
        [...models, { label: "measured", stroke: color("measured"), width: 1.25, value }], outputs],
      [`Residual: measured − predicted${own}, enabled samples`, low[0], (c) => [c.t, shift(c.residual, -by)],
        [{ label: "residual", stroke: color("residual"), width: 1.1, value: signed }],
        { range: (u, a, b) => symmetric(a, b, 0.01), zero: true }],
      [`Window mean of the residual${own}`, low[1], (c) => [c.t, shift(c.mean, -by)], [{ ...window, label: "mean", value: signed }],
        { range: (u, a, b) => symmetric(a, b, (mu || 0.01) * 1.3), zero: true, windows: "mean", limits: mu == null ? [] : [[mu, "±Jμ"], [-mu, "±Jμ"]] }],
      ["Window standard deviation of the residual", low[1], (c) => [c.t, c.std], [{ ...window, label: "std", value }],
        { range: (u, a, b) => [0, Math.max(b || 0, sigma || 0, 1e-3) * 1.3], windows: "std", limits: sigma == null ? [] : [[sigma, "Jσ"]] }],
    ];
  }

  /** Draw each of `all` when it comes into view or there is time, again at another width or in
   * other colours, and for paper. Each has its `section`, its `plots` and `build(width)`. */
  function follow(all) {
    const folds = (each) => each.section.closest("details");
    const isShown = (each) => folds(each)?.open ?? true;
    const first = (each) => isShown(each) && !each.plots.length && each.build();
    const again = (each) => each.plots.length && isShown(each) && each.section.clientWidth && each.build();
    const resize = (each) => each.section.clientWidth !== each.width && again(each);
    const byView = new IntersectionObserver((entries) => {
      for (const { isIntersecting, target } of entries) if (isIntersecting) first(all.find((each) => each.section === target));
    }, { rootMargin: "300px" });
    for (const each of all) {
      byView.observe(each.section);
      folds(each)?.addEventListener("toggle", () => (first(each), resize(each)));
    }
    // What is out of view follows when there is time, so that a picture of the whole page has it.
    const idle = window.requestIdleCallback ?? ((work) => setTimeout(work, 50));
    const rest = all.slice();
    const next = () => {
      const each = rest.shift();
      if (!each) return;
      first(each);
      idle(next);
    };
    addEventListener("load", () => idle(next));
    let pending = 0;
    addEventListener("resize", () => {
      clearTimeout(pending);
      pending = setTimeout(() => all.forEach(resize), 150);
    });
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => all.forEach((each) => {
      each.width = 0; // what is folded is drawn when it is unfolded
      again(each);
    }));
    // On paper everything is unfolded, light, and drawn at the paper's width.
    let folded = [];
    addEventListener("beforeprint", () => {
      document.documentElement.dataset.theme = "light";
      folded = [...document.querySelectorAll("details.part, details:has(.plots)")].filter((details) => !details.open);
      for (const details of folded) details.open = true;
      for (const each of all) each.build(PRINT_WIDTH);
    });
    addEventListener("afterprint", () => {
      delete document.documentElement.dataset.theme;
      for (const details of folded) details.open = false;
      all.forEach(again);
    });
  }

  return { SYMBOLS, color, digits, shift, places, element, table, symmetric, outputRange, rule, tag, limits, shade, pen, plot, judged, follow };
})();
