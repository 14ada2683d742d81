// Follows the monitor's stream of events. Loads nothing but this page's own files.
import { Plots } from "./plots.js";
import { panels, digits, element, signed } from "./panels.js";

const SAMPLES = 6000, WINDOWS = 240; // as many as the server keeps
const SILENT_MS = 3000; // after which what is shown is old
const AGAIN_MS = 5000;

const $ = (id) => document.getElementById(id);
const state = { samples: [], windows: [], conditions: [], limits: {} };
const plots = new Plots($("plots"), state);
let heard = 0; // when the last message came
let phase = "connecting"; // connecting, open, lost, ended
let source = null;

function take(message, whole) {
  const { samples, windows, ...rest } = message;
  if (whole && heard && rest.run !== state.run) return location.reload(); // o2mon was started again
  if (whole) state.samples = state.windows = [];
  Object.assign(state, rest);
  if (samples.length) state.samples = state.samples.concat(samples).slice(-SAMPLES);
  if (windows.length) state.windows = state.windows.concat(windows).slice(-WINDOWS);
  heard = performance.now();
  phase = "open";
  document.body.classList.remove("waiting");
  show({ ...rest, windows: whole || windows.length });
}

function show(changed) {
  overview();
  if (!document.hidden) plots.update();
  for (const panel of panels) panel(state, changed);
  connection();
}

/** What is wrong, in words; the first that holds. */
function verdict() {
  const { memory, now } = state;
  const set = memory?.fault_flag ? memory.codes.filter((code) => code.state) : []; // not the monitor's own alone
  if (set.length) {
    const codes = set.map((each) => each.code).join(", ");
    const meanings = [...new Set(set.map((each) => each.meaning).filter(Boolean))].join("; ");
    return { kind: "failed", words: `Fault: ${codes}`, more: meanings && `${meanings[0].toUpperCase()}${meanings.slice(1)}.` };
  }
  if (!now) return { kind: "inconclusive", words: "Waiting for the first samples", more: "Nothing was received from the bus yet." };
  if (now.completed) return { kind: "passed", words: "No fault", more: "The response test has been completed in this driving cycle." };
  return { kind: "inconclusive", words: "Not judged yet", more: "The response test has not reached a decision in this driving cycle." };
}

function overview() {
  const { now, memory } = state;
  const { kind, words, more } = verdict();
  $("verdict").className = `verdict ${kind}`;
  put($("verdict-words"), words);
  put($("verdict-more"), more);
  put($("verdict-sure"), memory?.confidence ? `Confidence: ${memory.confidence}.` : "");
  document.title = (kind === "failed" ? `${words.replace("Fault: ", "✕ ")} – ` : "") + "Oxygen sensor monitor";
  put($("where"), [state.channel, state.model, state.version && `o2mon ${state.version}`].filter(Boolean).join(" · "));
  const bus = state.health?.state ?? "active";
  $("bus").hidden = bus === "active";
  put($("bus"), bus === "active" ? "" : `bus ${bus.replace(/^bus /, "")}`);
  if (!now) return;
  const residual = now.measured == null || now.predicted == null ? null : now.measured - now.predicted;
  const blocking = state.conditions.findIndex((condition, i) => !now.held[i]);
  const count = (verdict) => now.windows[verdict] ?? 0; // of the whole run
  const kinds = ["passed", "failed", "inconclusive"], counts = kinds.map((each) => `${O2.SYMBOLS[each]} ${count(each)}`);
  tile("Measured", digits(now.measured, 4), "measured");
  tile("Predicted", digits(now.predicted, 4), "predicted");
  tile("Residual", signed(residual, 4), "residual");
  tile("Judging", now.enabled ? "✓ yes" : "✕ no", now.enabled ? "good" : "",
    now.enabled ? `${Math.round((100 * now.enabled_samples) / now.samples)} % of samples` : `waits until ${state.conditions[blocking]?.what}: ${now.seen[blocking]}`);
  tile("Windows", String(kinds.map(count).reduce((a, b) => a + b)), "", counts.join("  "));
  tile("Lamp (MIL)", memory?.mil ? "● on" : "○ off", memory?.mil ? "bad" : "", memory?.fault_flag ? "fault flag set" : "fault flag not set");
}

const tiles = new Map();
function tile(name, value, kind = "", more = "") {
  if (!tiles.has(name)) {
    const box = element($("tiles"), "div");
    element(box, "dt", { textContent: name });
    tiles.set(name, { value: element(box, "dd"), more: element(box, "dd", { className: "quiet" }) });
  }
  const each = tiles.get(name);
  put(each.value, value);
  each.value.className = `value ${kind}`;
  put(each.more, more);
}

function put(node, text) {
  if (node.textContent !== text) node.textContent = text;
}

/** Says whether what is shown is of now, and greys it when it is not. */
function connection() {
  const silent = (performance.now() - heard) / 1000;
  const old = phase !== "open" || silent * 1000 > SILENT_MS;
  const age = heard && silent > 1 ? `, shown is ${silent < 90 ? `${Math.round(silent)} s` : `${Math.round(silent / 60)} min`} old` : "";
  const words = {
    connecting: "connecting",
    lost: `no connection, trying again${age}`,
    ended: `o2mon has ended${age}`,
    open: old ? `the monitor is silent${age}` : "live",
  }[phase];
  put($("connection"), words);
  $("connection").className = `pill ${old ? (phase === "ended" ? "ended" : "lost") : "live"}`;
  document.body.classList.toggle("old", old && heard > 0);
}

function connect() {
  source = new EventSource("events");
  source.addEventListener("snapshot", (event) => take(JSON.parse(event.data), true));
  source.addEventListener("message", (event) => take(JSON.parse(event.data), false));
  source.addEventListener("ended", () => {
    phase = "ended";
    connection();
  });
  source.addEventListener("error", () => {
    if (phase !== "ended") phase = heard || phase === "lost" ? "lost" : "connecting";
    if (source.readyState === EventSource.CLOSED) {
      phase = phase === "ended" ? phase : "lost";
      setTimeout(connect, AGAIN_MS); // refused: the browser does not try again by itself
    }
    connection();
  });
}

connect();
document.addEventListener("visibilitychange", () => document.hidden || plots.update());
setInterval(connection, 1000);
