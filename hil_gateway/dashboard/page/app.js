"use strict";
// Draws what the event stream says; the page sends nothing back.

const WINDOW_S = 30;
const byId = (id) => document.getElementById(id);
const short = (value) => (Math.abs(value) >= 1000 ? value.toFixed(0) : value.toPrecision(3));
const fixed = (value, digits) => (value === null || value === undefined ? "–" : value.toFixed(digits));
const degrees = (radians) => (radians * 180) / Math.PI;

class Chart {
  constructor(id) {
    this.canvas = byId(id);
    this.title = this.canvas.dataset.title;
    this.span = Number(this.canvas.dataset.span);
    this.points = [];
  }

  add(t, value) {
    if (value === null || value === undefined) return;
    this.points.push([t, value]);
    while (this.points.length && this.points[0][0] < t - WINDOW_S) this.points.shift();
  }

  draw(now) {
    const ratio = window.devicePixelRatio || 1;
    const [w, h] = [this.canvas.clientWidth, this.canvas.clientHeight];
    this.canvas.width = w * ratio;
    this.canvas.height = h * ratio;
    const c = this.canvas.getContext("2d");
    c.scale(ratio, ratio);
    c.font = "11px system-ui, sans-serif";
    c.fillStyle = "#8795a5";
    c.fillText(this.title, 0, 11);
    const values = this.points.map((p) => p[1]);
    let [low, high] = values.length ? [Math.min(...values), Math.max(...values)] : [0, 1];
    const missing = Math.max(this.span - (high - low), 0) / 2; // noise is not drawn as large as a lap
    [low, high] = [low - missing, high + missing];
    const [left, top, right, bottom] = [38, 26, w - 2, h - 6];
    const y = (v) => bottom - ((v - low) / (high - low)) * (bottom - top);
    c.strokeStyle = "#2b3744";
    c.beginPath();
    for (const v of [low, (low + high) / 2, high]) {
      c.moveTo(left, y(v));
      c.lineTo(right, y(v));
      c.fillText(v.toFixed(this.span < 4 ? 1 : 0), 0, y(v) + 3);
    }
    c.stroke();
    c.strokeStyle = "#e4eaf0";
    c.lineWidth = 1.4;
    c.beginPath();
    this.points.forEach(([t, v], i) => {
      const x = right - ((now - t) / WINDOW_S) * (right - left);
      if (i) c.lineTo(x, y(v));
      else c.moveTo(x, y(v));
    });
    c.stroke();
  }
}

const charts = {
  speed: new Chart("chart-speed"), steer: new Chart("chart-steer"), ay: new Chart("chart-ay"), plan: new Chart("chart-plan"),
};

// The map's y axis points north, the screen's points down.
function drawTrack(track) {
  const ring = (edge) => edge.x.map((x, i) => `${i ? "L" : "M"}${x} ${-edge.y[i]}`).join("") + "Z";
  const outline = ring(track.left) + ring(track.right);
  byId("road").setAttribute("d", outline);
  byId("edges").setAttribute("d", outline);
  byId("track").textContent = track.name.replaceAll("_", " ");
  const xs = track.left.x.concat(track.right.x);
  const ys = track.left.y.concat(track.right.y).map((y) => -y);
  const [x0, x1, y0, y1] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
  const margin = 0.03 * Math.max(x1 - x0, y1 - y0);
  byId("map").setAttribute("viewBox", `${x0 - margin} ${y0 - margin} ${x1 - x0 + 2 * margin} ${y1 - y0 + 2 * margin}`);
  byId("car").setAttribute("r", 0.011 * Math.max(x1 - x0, y1 - y0));
}

function row(cells, classes = []) {
  const tr = document.createElement("tr");
  cells.forEach((cell, i) => {
    const td = document.createElement("td");
    if (cell instanceof Node) td.append(cell);
    else td.textContent = cell;
    if (classes[i]) td.className = classes[i];
    tr.append(td);
  });
  return tr;
}

const fill = (id, rows) => byId(id).querySelector("tbody").replaceChildren(...rows);

function shape(name, attributes) {
  const node = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  return node;
}

// Belief over the first one seen: the grey mark is that one, the bar mean +- 2 std, on a scale of 0 to 2 of it.
function beliefBar(mean, std, first) {
  const at = (value) => Math.max(0, Math.min(100, (50 * value) / (first || 1)));
  const svg = shape("svg", { viewBox: "0 0 100 10", width: "100%", height: "12", preserveAspectRatio: "none" });
  svg.append(
    shape("line", { x1: 0, x2: 100, y1: 5, y2: 5, stroke: "#2b3744" }),
    shape("line", { x1: at(mean - 2 * std), x2: at(mean + 2 * std), y1: 5, y2: 5, stroke: "#4aa3ff", "stroke-width": 4 }),
    shape("line", { x1: 50, x2: 50, y1: 0, y2: 10, stroke: "#8795a5" }),
    shape("line", { x1: at(mean), x2: at(mean), y1: 1, y2: 9, stroke: "#ffffff" }),
  );
  return svg;
}

function drawBelief(belief, prior) {
  if (!belief || !prior) return;
  byId("samples").textContent = `${belief.samples} samples`;
  fill("belief", belief.names.map((name, i) => row(
    [name, short(belief.mean[i]), short(belief.std[i]), beliefBar(belief.mean[i], belief.std[i], prior[i])],
    ["", "", "", "bar"],
  )));
}

function drawCar(now, { vehicle_state: state, estimate, plan }) {
  if (estimate) {
    byId("car").setAttribute("cx", estimate.x);
    byId("car").setAttribute("cy", -estimate.y);
    byId("speed").textContent = fixed(estimate.vx, 1);
    byId("steer").textContent = fixed(degrees(estimate.steer), 1);
    charts.speed.add(now, estimate.vx);
    charts.steer.add(now, degrees(estimate.steer));
  }
  if (state) {
    byId("ay").textContent = fixed(state.ay, 1);
    charts.ay.add(now, state.ay);
  }
  if (plan) {
    byId("plan").setAttribute("points", plan.x.map((x, i) => `${x},${-plan.y[i]}`).join(" "));
    byId("lap").textContent = plan.lap + 1;
    charts.plan.add(now, plan.solve_ms);
  }
}

// What is old is not what is: without word from the gateway nothing on the page says that it drives.
function drawAction(gateway, alive) {
  if (!gateway) return;
  if (!alive) return drawNoWord("no word from the gateway");
  byId("action").textContent = gateway.action.replaceAll("_", " ");
  byId("action").className = `pill ${gateway.action}`;
  const missing = gateway.missing_for_arming.length && !gateway.armed ? `missing: ${gateway.missing_for_arming.join(", ")}` : "";
  byId("cause").textContent = gateway.cause || missing;
}

function drawNoWord(text) {
  byId("action").textContent = text;
  byId("action").className = "pill";
  byId("cause").textContent = "";
}

function drawStatus({ gateway_status: gateway, recorder_status: recorder, plan, model_revision: model }) {
  const rows = [];
  if (gateway) {
    rows.push(
      ["bus", gateway.bus], ["bus state", gateway.bus_state.replaceAll("_", " ")], ["mode", gateway.mode],
      ["frames received", gateway.frames_received], ["frames lost", gateway.frames_lost],
      ["counter errors", gateway.counter_errors], ["commands sent", gateway.commands_sent],
      ["commands limited", gateway.commands_limited],
      ["latency p50 / p99", `${fixed(gateway.loop_latency_p50_ms, 1)} / ${fixed(gateway.loop_latency_p99_ms, 1)} ms`],
    );
  }
  if (plan) rows.push(["plan", plan.reason ? `${plan.status}: ${plan.reason}` : plan.status]);
  if (model) rows.push(["model revision", model.revision], ["effects", model.effects.map((e) => e.name).join(", ") || "none"]);
  if (recorder) {
    rows.push(["recorded", `${(recorder.bytes_written / 1e6).toFixed(1)} MB`], ["not recorded", recorder.lost]);
    if (recorder.last_error) rows.push(["recorder error", recorder.last_error]);
  }
  fill("status", rows.map((cells) => row(cells, ["", "text"])));
}

// Messages are looked at once a snapshot: an age is known no better than the time between two of them.
function drawAges(ages, step_s) {
  const age = (age_s) => (age_s === null ? "never" : age_s < step_s ? `< ${10 * Math.round(100 * step_s)} ms` : `${(1000 * age_s).toFixed(0)} ms`);
  fill("ages", Object.entries(ages).map(([name, { age_s, alive }]) => row(
    [name.replaceAll("_", " "), age(age_s), alive ? "ok" : "old"], ["", "", alive ? "ok" : "old"],
  )));
}

function drawAlerts(alerts) {
  if (!alerts.length) return;
  byId("alerts").replaceChildren(...alerts.map((alert) => {
    const li = document.createElement("li");
    const suspect = alert.suspected_effect ? ` (suspected: ${alert.suspected_effect})` : "";
    li.textContent = `${alert.channel}: ${alert.condition}, ${alert.strength.toFixed(1)} x noise${suspect}`;
    return li;
  }));
}

let shown_s = null;

function show(snapshot) {
  const now = snapshot.stamp_s;
  drawCar(now, snapshot.messages);
  drawAction(snapshot.messages.gateway_status, snapshot.ages.gateway_status.alive);
  drawStatus(snapshot.messages);
  drawBelief(snapshot.messages.belief, snapshot.prior);
  drawAges(snapshot.ages, shown_s === null ? 0 : now - shown_s);
  shown_s = now;
  drawAlerts(snapshot.alerts);
  Object.values(charts).forEach((chart) => chart.draw(now));
}

fetch("track.json").then((response) => response.json()).then(drawTrack);
const stream = new EventSource("events");
stream.onmessage = (event) => { byId("link").textContent = ""; show(JSON.parse(event.data)); };
stream.onerror = () => {
  byId("link").textContent = "trying again";
  drawNoWord("no connection to the dashboard process");
};
