"use strict";
// Two laps over distance: one axis, one cursor, the place of the cursor on the map.

const byId = (id) => document.getElementById(id);
const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
const COLOURS = ["accent", "warn"];
const CHARTS = [
  ["speed, km/h", "speed", 200], ["second behind first, s", null, 110], ["road-wheel angle, deg", "steer", 120],
  ["accelerator, %", "accelerator", 95], ["front brake, bar", "brake", 95], ["longitudinal, g", "ax", 105], ["lateral, g", "ay", 105],
];
const plots = [];

const width = () => Math.max(byId("charts").clientWidth - 24, 240);
const names = ["first", "second"];

function build() {
  plots.splice(0).forEach((plot) => plot.destroy());
  CHARTS.forEach(([title, channel, height], i) => plots.push(chart(title, channel, height, i === CHARTS.length - 1)));
}

function chart(title, channel, height, last) {
  const axis = { stroke: colour("quiet"), grid: { stroke: colour("line"), width: 1 }, ticks: { stroke: colour("line") }, font: "12px system-ui, sans-serif" };
  const lines = channel ? DATA.channels[channel] : [DATA.delta];
  const series = lines.map((_, i) => ({ label: channel ? names[i] : "gap", stroke: colour(channel ? COLOURS[i] : "text"), width: 1.6, value: (u, v) => (v === null ? "–" : v.toFixed(2)) }));
  return new uPlot({
    width: width(), height: height + (last ? 26 : 0), padding: [8, 18, last ? 0 : 8, 0],
    scales: { x: { time: false } },
    axes: [{ ...axis, show: last, size: 28, values: (u, at) => at.map((s) => `${s} m`) }, { ...axis, size: 48, space: 26 }],
    series: [{ label: title, value: (u, s) => (s === null ? "" : `${s.toFixed(0)} m`) }, ...series],
    cursor: { y: false, sync: { key: "s", scales: ["x", null] }, drag: { x: true, y: false } },
    hooks: { setCursor: [(u) => place(u.cursor.idx)], setScale: [(u, key) => key === "x" && align(u)] },
  }, [DATA.s, ...lines], byId("charts"));
}

// Zooming one chart zooms all.
let aligning = false;
function align(source) {
  if (aligning) return;
  aligning = true;
  const { min, max } = source.scales.x;
  plots.filter((plot) => plot !== source).forEach((plot) => plot.setScale("x", { min, max }));
  aligning = false;
}

function place(i) {
  if (i === null || i === undefined) return;
  const { x, y } = DATA.line[1];
  byId("at").setAttribute("cx", x[i]);
  byId("at").setAttribute("cy", -y[i]);
  const apart = Math.hypot(x[i] - DATA.line[0].x[i], y[i] - DATA.line[0].y[i]);
  byId("where").textContent = `${DATA.s[i].toFixed(0)} m: lines ${apart.toFixed(1)} m apart, second ${DATA.delta[i].toFixed(2)} s behind`;
}

function drawMap() {
  const { left, right, name } = DATA.track;
  const ring = (edge) => edge.x.map((x, i) => `${i ? "L" : "M"}${x} ${-edge.y[i]}`).join("") + "Z";
  for (const id of ["road", "edges"]) byId(id).setAttribute("d", ring(left) + ring(right));
  const xs = left.x.concat(right.x);
  const ys = left.y.concat(right.y).map((y) => -y);
  const [x0, x1, y0, y1] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
  byId("map").setAttribute("viewBox", `${x0 - 20} ${y0 - 20} ${x1 - x0 + 40} ${y1 - y0 + 40}`);
  byId("at").setAttribute("r", 0.012 * Math.max(x1 - x0, y1 - y0));
  DATA.line.forEach(({ x, y }, i) => {
    byId(`line${i}`).setAttribute("points", x.map((px, k) => `${px},${-y[k]}`).join(" "));
    byId(`line${i}`).style.stroke = colour(COLOURS[i]);
  });
  byId("track").textContent = name.replaceAll("_", " ");
}

function drawHead() {
  names.forEach((name, i) => {
    byId(name).textContent = DATA.titles[i];
    byId(name).style.background = colour(COLOURS[i]);
    byId(name).style.color = colour("ground");
  });
  const gap = DATA.times_s[1] - DATA.times_s[0];
  byId("gap").textContent = `second ${Math.abs(gap).toFixed(2)} s ${gap > 0 ? "slower" : "faster"}`;
  byId("sectors").querySelector("tbody").replaceChildren(...DATA.sectors_s[0].map((first, i) => {
    const tr = document.createElement("tr");
    const second = DATA.sectors_s[1][i];
    for (const text of [`${i + 1}`, first.toFixed(2), second.toFixed(2), `${second > first ? "+" : "−"}${Math.abs(second - first).toFixed(2)} s`]) {
      const td = document.createElement("td");
      td.textContent = text;
      tr.append(td);
    }
    return tr;
  }));
}

function setTheme(theme) {
  document.documentElement.dataset.theme = theme;
  byId("theme").textContent = theme === "light" ? "Dark" : "Light";
  build();
  drawMap();
  drawHead();
}

byId("theme").addEventListener("click", () => setTheme(document.documentElement.dataset.theme === "light" ? "dark" : "light"));
addEventListener("resize", () => plots.forEach((plot) => plot.setSize({ width: width(), height: plot.height })));
setTheme("light");
