// Draws what the server says, live or out of a recording; the page sends nothing that could act on the car.
import { byId } from "./format.js";
import * as charts from "./charts.js";
import * as map from "./map.js";
import { drawCurves, drawGg } from "./plots.js";
import * as tables from "./tables.js";

const MINUTE_S = 60;
const SILENT_MS = 2000;
let setup = null;
let newest = null;
let slow = null;
let paused = false;
let heard_ms = 0;
let drawn_ms = 0;

function show(snapshot) {
  newest = snapshot;
  tables.drawHead(snapshot, setup.recording);
  tables.drawFigures(snapshot, setup.lap_limit_s);
  tables.drawAges(snapshot.ages);
  tables.drawSources(snapshot.messages, snapshot.ages);
  tables.drawTyreReports(snapshot.messages, snapshot.ages);
  tables.drawStatus(snapshot.messages, snapshot.ages, setup.limits);
  tables.drawModel(snapshot.messages, snapshot.ages);
  map.drawCar(snapshot.messages, snapshot.ages);
}

function showSlow(part) {
  slow = part;
  tables.drawStop(part.stop);
  tables.drawEvents(part.events, setup.recording ? setup.recording.start_s : null);
  tables.drawLaps(part.laps, setup.lap_limit_s);
  tables.drawAlerts(part.alerts);
  tables.drawTyres(part.tyres);
  tables.drawRevisions(part.events, setup.recording ? setup.recording.start_s : null);
  map.drawMarks(part.events);
  map.drawLine(part.line);
  drawSlowPlots();
}

// The last minute before the moment shown for the diagrams; the line driven within the charts' view.
function drawSlowPlots() {
  const columns = charts.history();
  const t = newest ? newest.t : 0;
  const index = (at) => { const i = columns.t.findIndex((value) => value > at); return i < 0 ? columns.t.length : i; };
  drawGg(columns, index(t - MINUTE_S), index(t), slow?.tyres);
  drawCurves(slow?.tyres, columns, index(t - MINUTE_S), index(t));
  const [from, to] = setup.recording ? charts.current() : [t - 3 * MINUTE_S, t];
  map.drawDriven(columns, index(from), index(to), byId("colourby").value);
}

function lost(text) {
  heard_ms = 0;
  byId("state").textContent = "LOST";
  byId("state").className = "pill LOST";
  byId("action").textContent = text;
  byId("action").className = "pill";
  byId("why").textContent = "what is shown is old";
  document.querySelectorAll("#figures > div, #ages tr, #sources tr, #status tr").forEach((node) => node.classList.add("stale"));
  byId("map").classList.add("stale");
  byId("plan").setAttribute("points", "");
}

function listen() {
  const stream = new EventSource("events");
  stream.onmessage = (event) => {
    const snapshot = JSON.parse(event.data);
    heard_ms = Date.now();
    tables.setClock(snapshot.t);
    charts.add(snapshot.row);
    if (paused) return tables.drawHead(snapshot, null);
    show(snapshot);
    if (heard_ms - drawn_ms > 180) { drawn_ms = heard_ms; charts.redraw(); }
  };
  stream.addEventListener("slow", (event) => { if (paused) tables.drawStop(JSON.parse(event.data).stop); else showSlow(JSON.parse(event.data)); });
  stream.onerror = () => lost("no connection to the dashboard process");
  setInterval(() => { if (heard_ms && Date.now() - heard_ms > SILENT_MS) lost("the dashboard process has fallen silent"); }, 500);
}

// --- recordings: a moment is asked for by its time ---

const player = { t: 0, playing: false, busy: false, wanted: null };

async function seek(t) {
  player.t = Math.min(Math.max(t, setup.recording.start_s), setup.recording.end_s);
  byId("scrub").value = player.t - setup.recording.start_s;
  byId("clock").textContent = `${(player.t - setup.recording.start_s).toFixed(1)} s of ${(setup.recording.end_s - setup.recording.start_s).toFixed(1)} s`;
  charts.cursorAt(player.t);
  if (player.busy) { player.wanted = t; return; }
  player.busy = true;
  const { quick, slow: part } = await (await fetch(`at.json?t=${player.t}`)).json();
  player.busy = false;
  show(quick);
  showSlow(part);
  charts.cursorAt(player.t);
  if (player.wanted !== null) { const next = player.wanted; player.wanted = null; seek(next); }
}

function play(wanted) {
  player.playing = wanted;
  byId("play").textContent = wanted ? "Pause" : "Play";
  byId("play").setAttribute("aria-pressed", wanted);
}

function tick(step_s) {
  if (!player.playing) return;
  const [from, to] = byId("loop").checked ? charts.current() : [setup.recording.start_s, setup.recording.end_s];
  const next = player.t + step_s * Number(byId("rate").value);
  if (next <= to) seek(next);
  else if (byId("loop").checked) seek(from);
  else play(false);
}

function openRecording({ file, start_s: start, end_s: end, opens_s: opens }) {
  document.title = `${file} (recording)`;
  byId("player").hidden = false;
  byId("pause").hidden = true;
  byId("scrub").max = end - start;
  byId("scrub").addEventListener("input", () => seek(start + Number(byId("scrub").value)));
  byId("play").addEventListener("click", () => play(!player.playing));
  charts.onClick((t) => seek(t));
  setInterval(() => tick(0.1), 100);
  const at = Number(new URLSearchParams(location.search).get("t"));
  seek(at ? start + at : opens);
}

// --- buttons and keys ---

function setTheme(theme) {
  document.documentElement.dataset.theme = theme;
  byId("theme").textContent = theme === "light" ? "Dark" : "Light";
  try { localStorage.setItem("theme", theme); } catch { /* a browser that keeps nothing */ }
  if (setup) { charts.build(setup.limits); drawSlowPlots(); if (setup.recording) charts.onClick((t) => seek(t)); }
}

function toggle(id, act) {
  const on = byId(id).getAttribute("aria-pressed") !== "true";
  byId(id).setAttribute("aria-pressed", on);
  act(on);
}

function pause(on) {
  paused = on;
  byId("pause").textContent = on ? "Continue" : "Pause";
  if (on) charts.setView(charts.current());
  else charts.live();
}

const help = () => {
  const hidden = (byId("about").hidden = !byId("about").hidden);
  byId("help").setAttribute("aria-expanded", !hidden);
};
const themeNow = () => document.documentElement.dataset.theme ?? "dark";
const act = {
  pause: () => (setup.recording ? play(!player.playing) : toggle("pause", pause)),
  follow: () => toggle("follow", map.follow),
  theme: () => setTheme(themeNow() === "light" ? "dark" : "light"),
};
const KEYS = {
  " ": act.pause, f: act.follow, t: act.theme, "?": help, 0: () => charts.showAll(), Escape: () => (setup.recording ? charts.showAll() : charts.live()),
  ArrowLeft: () => (setup.recording ? seek(player.t - 1) : charts.move(-0.2)), ArrowRight: () => (setup.recording ? seek(player.t + 1) : charts.move(0.2)),
  "+": () => charts.zoom(0.5), "-": () => charts.zoom(2),
};

for (const id of ["pause", "follow", "theme"]) byId(id).addEventListener("click", act[id]);
byId("help").addEventListener("click", help);
byId("colourby").addEventListener("change", drawSlowPlots);
document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || ["INPUT", "SELECT", "BUTTON"].includes(event.target.tagName)) return;
  const action = KEYS[event.key];
  if (action) { event.preventDefault(); action(); }
});

async function begin() {
  let theme = null;
  try { theme = localStorage.getItem("theme"); } catch { /* as above */ }
  const asked = new URLSearchParams(location.search).get("theme");
  setTheme(asked ?? theme ?? (matchMedia("(prefers-color-scheme: light)").matches ? "light" : "dark"));
  const [fixedPart, history] = await Promise.all(["setup.json", "history.json"].map(async (name) => (await fetch(name)).json()));
  setup = fixedPart;
  map.drawTrack(setup.track);
  charts.start(history, setup, () => { if (slow) drawSlowPlots(); });
  if (setup.recording) openRecording(setup.recording);
  else listen();
}

begin();
