// Strip charts over one time axis: uPlot, one cursor, zoom by dragging, the whole history of the server.
import { byId, colour, fixed, known } from "./format.js";

const SHOWN_S = 60;
const CHARTS = [
  { title: "speed, km/h", height: 130, scale: 3.6, series: [["line_speed", "race line asks", "accent"], ["speed", "driven", "text"]] },
  { title: "grip used, %", height: 80, limit: "grip", series: [["grip", "of that believed", "text"]] },
  { title: "road-wheel angle, deg", height: 120, limit: "steer_deg", series: [["steer_asked", "asked", "warn"], ["steer_sent", "sent", "accent"], ["steer", "measured", "text"]] },
  { title: "accelerator, %", height: 95, series: [["accelerator_sent", "sent", "accent"], ["accelerator", "measured", "text"]] },
  { title: "front brake, bar", height: 95, series: [["brake_sent", "sent", "accent"], ["brake", "measured", "text"]] },
  { title: "specific force, g", height: 120, series: [["ax", "longitudinal", "accent"], ["ay", "lateral", "text"]] },
  { title: "not explained, m/s²", height: 80, series: [["residual_ax", "longitudinal", "accent"], ["residual_ay", "lateral", "text"]] },
  { title: "to best lap, s", height: 80, series: [["delta", "delta", "text"]] },
  { title: "plan and loop time, ms", height: 100, limit: "plan_ms", series: [["plan_ms", "plan", "text"], ["latency_ms", "loop p99", "accent"]] },
];
const plots = [];
let columns = null;
let origin = 0;
let view = null; // [from, to] in s, null: the newest SHOWN_S
let most = 6000;
let changed = () => {};

export function start(history, { limits, rate_hz: rate, recording }, onView) {
  columns = history;
  most = recording ? Infinity : 600 * rate;
  origin = recording ? recording.start_s : 0;
  changed = onView;
  view = recording ? [recording.start_s, recording.end_s] : null;
  build(limits);
  new ResizeObserver(() => plots.forEach((plot) => plot.setSize({ width: width(), height: plot.height }))).observe(byId("charts"));
}

// A tall screen is used: the charts together fill it.
const tallness = () => Math.min(Math.max((window.innerHeight - 500) / CHARTS.reduce((sum, { height }) => sum + height, 0), 1), 1.9);
const width = () => Math.max(byId("charts").clientWidth - 20, 200);

export function build(limits) {
  plots.splice(0).forEach((plot) => plot.destroy());
  CHARTS.forEach((chart, i) => plots.push(makePlot(chart, limits, i === CHARTS.length - 1)));
  redraw();
}

function makePlot(chart, limits, last) {
  const axis = { stroke: colour("quiet"), grid: { stroke: colour("line"), width: 1 }, ticks: { stroke: colour("line") }, font: "12px system-ui, sans-serif" };
  const series = chart.series.map(([, label, stroke]) => ({
    label, stroke: colour(stroke), width: 1.5, spanGaps: false, points: { show: false },
    value: (u, v) => fixed(v, 2),
  }));
  const bound = chart.limit ? limits[chart.limit] : null;
  const options = {
    width: width(), height: Math.round(chart.height * tallness()) + (last ? 24 : 0), title: "", legend: { live: true },
    scales: { x: { time: false }, y: { range: (u, low, high) => range(low, high, bound, chart) } },
    padding: [8, 18, last ? 0 : 8, 0],
    axes: [{ ...axis, show: last, size: 28, splits: (u, i, low, high, step) => ticks(low, high, step), values: (u, at) => at.map(label) }, { ...axis, size: 46, label: "", space: 26 }],
    series: [{ label: chart.title, value: (u, t) => (known(t) ? label(t) : "") }, ...series],
    cursor: { y: false, sync: { key: "time" }, drag: { x: true, y: false, setScale: false }, points: { size: 6 } },
    hooks: { draw: [(u) => drawLimits(u, bound)], setSelect: [zoomTo] },
  };
  const plot = new uPlot(options, [[], ...series.map(() => [])], byId("charts"));
  plot.over.addEventListener("dblclick", () => showAll());
  plot.chart = chart;
  return plot;
}

function ticks(low, high, step) {
  const zero = origin || (columns.t[columns.t.length - 1] ?? 0);
  const found = [];
  for (let t = zero + step * Math.ceil((low - zero) / step); t <= high; t += step) found.push(t);
  return found;
}

// Labels: seconds into a recording; live, seconds before now.
function label(t) {
  const last = columns.t[columns.t.length - 1] ?? 0;
  return origin ? `${+(t - origin).toFixed(2)} s` : `${+(t - last).toFixed(1)} s`;
}

function range(low, high, bound, chart) {
  if (!known(low)) return [0, 1];
  const shows = bound && bound > 0 && chart.limit === "steer_deg" ? Math.max(Math.abs(low), Math.abs(high)) > 0.6 * bound : bound && high > 0.4 * bound;
  if (shows) [low, high] = [chart.limit === "steer_deg" ? Math.min(low, -bound) : low, Math.max(high, bound)];
  const margin = Math.max(0.06 * (high - low), 0.02);
  return [low - margin, high + margin];
}

function drawLimits(u, bound) {
  if (!bound) return;
  const { ctx, bbox } = u;
  ctx.save();
  ctx.strokeStyle = colour("bad");
  ctx.setLineDash([6, 4]);
  ctx.beginPath();
  for (const value of [bound, -bound]) {
    const y = u.valToPos(value, "y", true);
    if (y < bbox.top || y > bbox.top + bbox.height) continue;
    ctx.moveTo(bbox.left, y);
    ctx.lineTo(bbox.left + bbox.width, y);
  }
  ctx.stroke();
  ctx.restore();
}

function zoomTo(u) {
  if (u.select.width < 4) return;
  const [from, to] = [u.posToVal(u.select.left, "x"), u.posToVal(u.select.left + u.select.width, "x")];
  u.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
  setView([from, to]);
}

export function setView(range) {
  view = range;
  changed(view);
  redraw();
}

export const showAll = () => setView(columns.t.length ? [columns.t[0], columns.t[columns.t.length - 1]] : null);
export const live = () => setView(null);
export const current = () => view ?? newest();

function newest() {
  const last = columns.t[columns.t.length - 1] ?? 0;
  return [last - SHOWN_S, last];
}

export function move(share) {
  const [from, to] = current();
  setView([from + share * (to - from), to + share * (to - from)]);
}

export function zoom(factor) {
  const [from, to] = current();
  const half = (factor * (to - from)) / 2;
  setView([(from + to) / 2 - half, (from + to) / 2 + half]);
}

export function add(newRow) {
  for (const name of Object.keys(columns)) {
    columns[name].push(newRow[name] ?? null);
    if (columns[name].length > most + 600) columns[name].splice(0, 600);
  }
}

// A gap in time breaks the line: rows of a silent source are null already, a missing row is not.
export function redraw() {
  const [from, to] = current();
  let first = columns.t.findIndex((t) => t >= from);
  if (first < 0) first = columns.t.length;
  let end = columns.t.findIndex((t) => t > to);
  if (end < 0) end = columns.t.length;
  const times = columns.t.slice(Math.max(first - 1, 0), end + 1);
  for (const plot of plots) {
    const scale = plot.chart.scale ?? 1;
    const data = plot.chart.series.map(([name]) => columns[name].slice(Math.max(first - 1, 0), end + 1).map((v) => (v === null ? null : scale * v)));
    plot.setData([times, ...data], false);
    plot.setScale("x", { min: from, max: to });
    if (!(plot.cursor.left >= 0)) plot.setLegend({ idx: newestShown(times, to) }, false); // no cursor: what is now
  }
}

function newestShown(times, to) {
  let at = times.length - 1;
  while (at > 0 && times[at] > to) at -= 1;
  return at;
}

export const history = () => columns;

export function cursorAt(t) {
  for (const plot of plots) plot.setCursor({ left: plot.valToPos(t, "x"), top: 1 }, false);
}

export const onClick = (act) => plots.forEach((plot) => plot.over.addEventListener("click", () => act(plot.posToVal(plot.cursor.left, "x"))));
