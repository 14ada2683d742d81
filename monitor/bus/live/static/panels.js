// The panels beside the plots. Every text goes in as text, never as markup.
const SVG = "http://www.w3.org/2000/svg";
const STRIP_S = 180; // of each condition's strip
const SHOWN_WINDOWS = 12;
const FAULTLESS = new Set(["absent", "frames", "reconnects", "receive_buffer_bytes", "timestamps", "unmapped", "sinks_sent"]); // count nothing bad

export const { digits, element } = O2;
export const signed = (value, n) => (value == null ? "–" : (value >= 0 ? "+" : "") + digits(value, n));

function shape(parent, tag, attributes) {
  const node = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
  return parent.appendChild(node);
}

const put = (node, text) => {
  if (node.textContent !== text) node.textContent = text;
};
const words = (name) => name.replaceAll("_", " ");

/** The part of a section under its heading, emptied. */
function fresh(id) {
  const section = document.getElementById(id);
  section.querySelector(".body")?.remove();
  return element(section, "div", { className: "body" });
}

/** Time of a sample or code: since the first sample of this run, else the day. */
function when(t_ns, now) {
  if (!t_ns) return "";
  const since = now ? Number(BigInt(t_ns) - BigInt(now.t0_ns)) / 1e9 : -1;
  if (since >= 0) return `${digits(since, 1)} s after the start`;
  const ms = Number(BigInt(t_ns) / 1000000n);
  return ms > 1e12 ? new Date(ms).toLocaleString("en-GB") : "before this run";
}

let rows = null;
let stripped = -Infinity;
function conditions(state, changed) {
  const { now } = state;
  if (!now || !state.conditions.length) return;
  if (changed.conditions || !rows) {
    const list = element(fresh("conditions"), "ul", { className: "conditions" });
    rows = state.conditions.map((each) => {
      const item = element(list, "li");
      const sign = element(item, "span", { className: "sign" });
      const text = element(item, "div", { className: "what" });
      element(text, "strong", { textContent: each.what });
      element(text, "span", { className: "quiet", textContent: ` ${each.need}` });
      const seen = element(item, "span", { className: "seen" });
      const strip = shape(item, "svg", { viewBox: `0 0 ${STRIP_S} 1`, preserveAspectRatio: "none", class: "strip", "aria-hidden": "true" });
      return { item, sign, seen, strip: shape(strip, "path", {}) };
    });
  }
  state.conditions.forEach((each, i) => {
    const kind = !each.available ? "absent" : now.held[i] ? "held" : "blocks";
    rows[i].item.className = kind;
    put(rows[i].sign, { absent: "–", held: "✓", blocks: "✕" }[kind]);
    rows[i].sign.setAttribute("aria-label", { absent: "not provided, never blocks", held: "holds", blocks: "does not hold" }[kind]);
    rows[i].sign.setAttribute("role", "img");
    put(rows[i].seen, now.seen[i]);
  });
  if (changed.conditions || performance.now() - stripped > 900) strips(state);
}

/** In which of the last minutes each condition held. */
function strips({ samples }) {
  stripped = performance.now();
  if (!samples.length) return;
  const end = samples[samples.length - 1][0] / 1000;
  const seen = samples.slice(-STRIP_S * 11).filter((sample) => sample[0] / 1000 > end - STRIP_S);
  rows.forEach((row, i) => {
    let path = "", from = null, last = 0;
    for (const [ms, , , held] of seen) {
      const x = ms / 1000 - end + STRIP_S;
      const on = (held >> i) & 1;
      if (on && from == null) from = x;
      if (from != null && (!on || x - last > 1.5)) {
        path += `M${from.toFixed(1)} 0H${(on ? last : x).toFixed(1)}V1H${from.toFixed(1)}z`;
        from = on ? x : null;
      }
      last = x;
    }
    if (from != null) path += `M${from.toFixed(1)} 0H${STRIP_S}V1H${from.toFixed(1)}z`;
    row.strip.setAttribute("d", path);
  });
}

const open = new Set(); // codes whose freeze frame is unfolded
let codesText = "";
function codes(state, changed) {
  if (!changed.memory) return;
  const text = JSON.stringify([state.memory.codes, state.memory.permanent]) + !state.now;
  if (text === codesText) return;
  codesText = text;
  const body = fresh("codes");
  if (!state.memory.codes.length) element(body, "p", { className: "quiet", textContent: "No code is stored." });
  for (const each of state.memory.codes) code(body, each, state);
  const gone = state.memory.permanent.filter((name) => !state.memory.codes.some((each) => each.code === name));
  for (const name of gone) {
    const card = element(body, "article", { className: "dtc" });
    element(card, "strong", { className: "code", textContent: name });
    element(card, "span", { className: "badge inconclusive", textContent: "permanent" });
  }
}

function code(body, each, { now, memory }) {
  const card = element(body, "article", { className: `dtc ${each.state || "healed"}` });
  element(card, "strong", { className: "code", textContent: each.code });
  element(card, "span", { className: `badge ${each.state ? "failed" : "inconclusive"}`, textContent: each.state || "no longer set" });
  if (memory.permanent.includes(each.code)) element(card, "span", { className: "badge inconclusive", textContent: "permanent" });
  element(card, "p", { textContent: each.meaning || words(each.fault) });
  for (const { effect, causes, check } of each.state ? each.advice : []) {
    element(card, "p", { textContent: `${effect} Likely: ${causes.join("; ")}.` });
    element(card, "p", { textContent: `Next: ${check}.` });
  }
  const facts = [when(each.t_ns, now), `status 0x${each.status.toString(16).toUpperCase().padStart(2, "0")}: ${each.bits.join(", ")}`];
  element(card, "p", { className: "quiet", textContent: facts.filter(Boolean).join("; ") });
  if (!each.frame) return;
  const details = element(card, "details");
  details.open = open.has(each.code);
  details.addEventListener("toggle", () => (details.open ? open.add(each.code) : open.delete(each.code)));
  element(details, "summary", { textContent: `Freeze frame, ${when(each.frame.t_ns, now)}` });
  pairs(details, each.frame.values);
}

/** Names and values; a list that shows the same names already is only brought up to date. */
function pairs(parent, entries) {
  let list = parent.querySelector(":scope > .pairs");
  if (list?.children.length !== entries.length) {
    list?.remove();
    list = element(parent, "dl", { className: "pairs" });
    for (const _ of entries) {
      const box = element(list, "div");
      element(box, "dt");
      element(box, "dd");
    }
  }
  entries.forEach(([name, value, kind], i) => {
    const box = list.children[i];
    box.className = kind || "";
    put(box.firstChild, name);
    put(box.lastChild, value);
  });
}

const ESTIMATES = [
  ["lag_rich_to_lean", "Lag to lean", "s", "lag_s"],
  ["lag_lean_to_rich", "Lag to rich", "s", "lag_s"],
  ["dead_time_rich_to_lean", "Dead time to lean", "s", "dead_time_s"],
  ["dead_time_lean_to_rich", "Dead time to rich", "s", "dead_time_s"],
  ["gain", "Gain", "", "gain"],
  ["offset", "Offset", "λ", "offset"],
];

function response(state, changed) {
  if (!changed.windows && !changed.limits && !changed.memory) return;
  const body = fresh("response");
  const last = state.windows[state.windows.length - 1];
  if (!last) return element(body, "p", { className: "quiet", textContent: "No window has been filled yet." });
  const s = last.statistics;
  const table = element(body, "div", { className: "gauges" });
  for (const [name, label, unit, kind] of ESTIMATES) {
    const isTime = unit === "s";
    const value = s[isTime ? `${name}_s` : name];
    const std = s[isTime ? `${name}_std_s` : `${name}_std`];
    gauge(table, label, unit, value, std, bounds(kind, state.limits));
  }
  const verdict = `Window ${last.index}: ${last.verdict}` + (last.fault ? ` (${words(last.fault)})` : "");
  const evidence = s.evidence == null ? "" : `; likeliest sensor: ${words(String(s.hypothesis))}, evidence for a fault ${signed(s.evidence, 1)}`;
  const still = last.excited ? "" : "; the mixture hardly moved";
  element(body, "p", { className: "quiet", textContent: verdict + evidence + still + "." });
  pairs(body, (state.memory?.evidence ?? []).map(([fault, left]) => [words(fault), left]));
}

/** What is sound, and how far the gauge reaches. */
function bounds(kind, limits) {
  if (kind === "gain") return { low: limits.gain_sound, high: limits.gain_most, from: 0, to: 1.2 * limits.gain_most };
  if (kind === "offset") {
    const far = 2 * Math.max(Math.abs(limits.offset_low), Math.abs(limits.offset_high));
    return { low: limits.offset_low, high: limits.offset_high, from: -far, to: far };
  }
  return { low: -Infinity, high: limits[kind], from: 0, to: 3 * limits[kind] };
}

function gauge(table, label, unit, value, std, { low, high, from, to }) {
  const n = unit === "λ" ? 3 : 2;
  const with_unit = (text) => text + (unit === "s" ? " s" : "");
  const beyond = value != null && (value < low || value > high);
  const row = element(table, "div", { className: beyond ? "gauge beyond" : "gauge" });
  const edge = (v) => (low < 0 ? signed(v, n) : digits(v, n));
  const limit = low === -Infinity ? `≤ ${with_unit(digits(high, n))}` : `${edge(low)} to ${edge(high)}`;
  const text = value == null ? "–" : with_unit(unit === "λ" ? signed(value, n) : digits(value, n));
  element(row, "span", { className: "label", textContent: label });
  element(row, "span", { className: "quiet limit", textContent: limit });
  element(row, "span", { className: "number", textContent: (beyond ? "✕ " : "") + text });
  element(row, "span", { className: "quiet spread", textContent: std == null ? "" : `± ${digits(std, n)}` });
  const svg = shape(row, "svg", { viewBox: "0 0 100 10", preserveAspectRatio: "none", role: "img", "aria-label": `${label} ${text}, sound is ${limit}` });
  const x = (v) => (100 * (Math.min(Math.max(v, from), to) - from)) / (to - from);
  shape(svg, "rect", { x: 0, y: 3, width: 100, height: 4, class: "track" });
  shape(svg, "rect", { x: x(low), y: 3, width: x(high) - x(low), height: 4, class: "sound" });
  if (value != null && std != null) shape(svg, "rect", { x: x(value - 2 * std), y: 4, width: Math.max(x(value + 2 * std) - x(value - 2 * std), 0.1), height: 2, class: "spread" });
  for (const at of [low, high]) if (Math.abs(at) < Infinity) shape(svg, "rect", { x: x(at) - 0.15, y: 1, width: 0.3, height: 8, class: "limit" });
  if (value != null) shape(svg, "rect", { x: Math.max(0, Math.min(x(value) - 0.6, 98.8)), y: 0, width: 1.2, height: 10, rx: 0.5, class: "value" });
}

const WINDOW = ["#", "end", "mean", "std", "verdict", "fault", "paper"];
function windows(state, changed) {
  if (!changed.windows && !changed.limits) return;
  const { j_mu: mu, j_sigma: sigma } = state.limits;
  const body = fresh("windows");
  element(body, "p", { className: "quiet", textContent: `${state.window_samples} enabled samples each, newest first. Paper’s rule: |mean| ≥ Jμ ${digits(mu, 4)} and std ≥ Jσ ${digits(sigma, 4)}.` });
  if (!state.windows.length) return element(body, "p", { className: "quiet", textContent: "No window has been filled yet." });
  const scroll = element(body, "div", { className: "scroll", tabIndex: 0 });
  scroll.setAttribute("role", "region");
  scroll.setAttribute("aria-label", "Latest windows");
  O2.table(scroll, WINDOW, state.windows.slice(-SHOWN_WINDOWS).reverse().map((each) => [
    each.index, `${digits(each.end_ms / 1000, 1)} s`,
    [signed(each.mean, 4), Math.abs(each.mean) >= mu ? "over" : ""], [digits(each.std, 4), each.std >= sigma ? "over" : ""],
    [`${O2.SYMBOLS[each.verdict]} ${each.verdict}`, `mark ${each.verdict}`],
    [each.fault, ...each.also].filter(Boolean).map(words).join(" or "),
    [each.paper_failed ? "✕ failed" : "–", each.paper_failed ? "mark failed" : ""],
  ]));
}

function health(state, changed) {
  if (!changed.health) return;
  const entries = Object.entries(state.health).map(([name, value]) => [words(name), reading(value), kindOf(name, value)]);
  pairs(document.getElementById("health"), entries);
}

function reading(value) {
  if (Array.isArray(value)) return value.map((each) => words(String(each))).join(", ") || "none";
  if (typeof value === "boolean") return value ? "yes" : "no";
  if (typeof value === "number") return Number.isInteger(value) ? value.toLocaleString("en-GB") : digits(value, 2);
  return value == null ? "unknown" : words(String(value));
}

/** Whether a counter counts something bad, and has. */
function kindOf(name, value) {
  if (name === "state") return value === "active" ? "" : "bad";
  const counted = Array.isArray(value) ? value.length : typeof value === "number" ? value : 0;
  return FAULTLESS.has(name) ? "" : counted ? "bad" : "none";
}

let memoryText = "";
function memory(state, changed) {
  if (!changed.memory) return;
  const { tests, counts, behind } = state.memory;
  const text = JSON.stringify([tests, counts, behind]);
  if (text === memoryText) return;
  memoryText = text;
  const body = fresh("memory");
  O2.table(body, ["test", "since clearing", "in-use ratio"], tests.map((each) => [
    each.test, [each.complete ? "✓ complete" : "? not complete", `mark ${each.complete ? "passed" : "inconclusive"}`],
    `${each.numerator} / ${each.denominator}`,
  ])).className = "tests";
  pairs(body, [...Object.entries(counts), ...(behind ?? [])]);
}

function signals(state, changed) {
  if (!changed.now) return;
  pairs(document.getElementById("signals"), state.now.signals.map(([name, value, bad]) => [name, bad || value, bad && "bad"]));
}

export const panels = [conditions, codes, response, windows, health, memory, signals];
