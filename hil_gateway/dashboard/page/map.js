// The track with race line, corridor, plan, car and the line driven, coloured by speed or by grip used. The map's y axis points north, the screen's down.
import { byId, shape } from "./format.js";

const COLOURS = ["#3b6fd4", "#2b9cc4", "#2fb38a", "#8fbf3f", "#e0a030", "#e5534b"];
const FOLLOW_M = 220;
let whole = [0, 0, 1, 1];
let following = false;
let place = null;

const ring = (edge) => edge.x.map((x, i) => `${i ? "L" : "M"}${x} ${-edge.y[i]}`).join("") + "Z";

// A car's length and width where it stands.
const box = ([x, y, yaw]) => {
  const corners = [[2.4, 1], [2.4, -1], [-2.4, -1], [-2.4, 1]].map(([along, left]) => [x + along * Math.cos(yaw) - left * Math.sin(yaw), y + along * Math.sin(yaw) + left * Math.cos(yaw)]);
  return ring({ x: corners.map((c) => c[0]), y: corners.map((c) => c[1]) });
};

export function drawTrack(track) {
  const lane = track.pit_lane;
  const outline = ring(track.left) + ring(track.right);
  byId("lane").setAttribute("d", (lane ? ring({ x: lane.left.x.concat(lane.right.x.toReversed()), y: lane.left.y.concat(lane.right.y.toReversed()) }) : "") + (track.boxes ?? []).map(box).join(""));
  byId("road").setAttribute("d", outline);
  byId("edges").setAttribute("d", outline);
  byId("track").textContent = track.name.replaceAll("_", " ");
  byId("mapscale").textContent = `${(track.length_m / 1000).toFixed(2)} km`;
  const xs = track.left.x.concat(track.right.x);
  const ys = track.left.y.concat(track.right.y).map((y) => -y);
  const [x0, x1, y0, y1] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
  const margin = 0.03 * Math.max(x1 - x0, y1 - y0);
  whole = [x0 - margin, y0 - margin, x1 - x0 + 2 * margin, y1 - y0 + 2 * margin];
  look();
}

function look() {
  const box = following && place ? [place[0] - FOLLOW_M / 2, -place[1] - FOLLOW_M / 2, FOLLOW_M, FOLLOW_M] : whole;
  byId("map").setAttribute("viewBox", box.join(" "));
  byId("car").setAttribute("r", 0.012 * Math.max(box[2], box[3]));
  for (const mark of byId("marks").children) mark.setAttribute("r", 0.01 * Math.max(box[2], box[3]));
}

export function follow(wanted) {
  following = wanted;
  look();
}

// Where a source has fallen silent nothing of it is drawn as if it were now: no plan of a dead planner.
// Twice the deviation: an ellipse where the car may be, a wedge where it may point; all around where that is not known.
function drawSpread({ x, y, yaw, std, lacks }, length) {
  for (const [name, value] of Object.entries({ cx: x, cy: -y, rx: 2 * std[0], ry: 2 * std[1] })) byId("spread").setAttribute(name, value);
  const half = lacks ? Math.PI : Math.min(2 * std[2], Math.PI);
  const arc = Array.from({ length: 25 }, (_, i) => yaw + half * (i / 12 - 1));
  byId("wedge").setAttribute("d", `M${x} ${-y}${arc.map((a) => `L${x + length * Math.cos(a)} ${-y - length * Math.sin(a)}`).join("")}Z`);
}

export function drawCar({ estimate, plan }, ages) {
  byId("nose").style.display = estimate && ages.estimate.alive ? "" : "none";
  byId("map").classList.toggle("stale", !ages.estimate.alive);
  if (estimate) {
    place = [estimate.x, estimate.y];
    byId("car").setAttribute("cx", estimate.x);
    byId("car").setAttribute("cy", -estimate.y);
    const length = 2.5 * byId("car").getAttribute("r");
    const ends = { x1: estimate.x, y1: -estimate.y, x2: estimate.x + length * Math.cos(estimate.yaw), y2: -estimate.y - length * Math.sin(estimate.yaw) };
    for (const [name, value] of Object.entries(ends)) byId("nose").setAttribute(name, value);
    drawSpread(estimate, 3 * length);
    byId("nose").classList.toggle("guess", estimate.lacks !== "");
    if (following) look();
  }
  const shown = plan && ages.plan.alive;
  byId("plan").setAttribute("points", shown ? plan.x.map((x, i) => `${x},${-plan.y[i]}`).join(" ") : "");
}

// Race line and corridor are fetched when the server names another one; an empty name: nothing aims at one.
let lineName = "";
export async function drawLine(name) {
  if (name === lineName) return;
  lineName = name;
  const line = name ? await (await fetch(`line.json?name=${name}`)).json() : null;
  if (name !== lineName) return;
  byId("raceline").setAttribute("d", line ? ring(line) : "");
  byId("corridor").setAttribute("d", line ? ring(line.corridor.left) + ring(line.corridor.right) : "");
}

// Grip is a share: its scale is fixed, and the last colour begins where all that is believed to be there is used.
const SCALES = {
  speed: { text: "driven, km/h", factor: 3.6, top: (values) => Math.max(20, ...values.map((v) => v ?? 0)) },
  grip: { text: "driven, % of grip", factor: 1, top: () => 120 },
};

export function drawDriven(columns, from, to, by) {
  const { x, y } = columns;
  const values = columns[by];
  const top = SCALES[by].top(values.slice(from, to));
  const paths = COLOURS.map(() => "");
  for (let i = Math.max(from, 1); i < to; i += 1) {
    if (x[i] === null || x[i - 1] === null || values[i] === null) continue;
    const band = Math.min(COLOURS.length - 1, Math.max(0, Math.floor((COLOURS.length * values[i]) / top)));
    paths[band] += `M${x[i - 1]} ${-y[i - 1]}L${x[i]} ${-y[i]}`;
  }
  byId("driven").replaceChildren(...paths.map((d, i) => shape("path", { d, class: "driven", stroke: COLOURS[i] })));
  drawKey(top, SCALES[by]);
}

function drawKey(top, { text: name, factor }) {
  const steps = COLOURS.map((fill, i) => [fill, `${i ? "" : `${name} `}${Math.round((factor * top * i) / COLOURS.length)}`]);
  byId("mapkey").replaceChildren(...steps.map(([fill, text]) => {
    const key = document.createElement("span");
    const sample = document.createElement("i");
    sample.style.background = fill;
    key.append(sample, text);
    return key;
  }), legend("plan", "plan"), ...(lineName ? [legend("line", "race line"), legend("corridor", "corridor")] : []), legend("stop", "stop"), legend("alert", "alert"));
}

function legend(kind, text) {
  const key = document.createElement("span");
  const sample = document.createElement("i");
  sample.style.background = `var(--${{ plan: "accent", line: "text", corridor: "good", stop: "bad", alert: "warn" }[kind]})`;
  if (kind === "stop" || kind === "alert") sample.className = "dot";
  key.append(sample, text);
  return key;
}

export function drawMarks(events) {
  const placed = events.filter((event) => event.x !== null && event.x !== undefined);
  byId("marks").replaceChildren(...placed.map((event) => {
    const mark = shape("circle", { cx: event.x, cy: -event.y, class: `mark ${event.kind}` });
    mark.append(shape("title", {}));
    mark.firstChild.textContent = `${event.kind}: ${event.cause || event.after}: ${event.text}`;
    return mark;
  }));
  look();
}
