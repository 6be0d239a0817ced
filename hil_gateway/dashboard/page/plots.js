// g-g diagram and tyre curves on canvases.
import { byId, colour, known } from "./format.js";

const LARGEST_G = 4;

function context(id) {
  const canvas = byId(id);
  const ratio = window.devicePixelRatio || 1;
  const size = canvas.clientWidth;
  canvas.width = canvas.height = size * ratio;
  const c = canvas.getContext("2d");
  c.scale(ratio, ratio);
  c.font = "12px system-ui, sans-serif";
  return [c, size];
}

// Points: where the car was. Rings: each g. Dashed: what the tyres are believed to hold without downforce.
export function drawGg(columns, from, to, tyres) {
  const [c, size] = context("gg");
  const used = Math.max(1, ...columns.ay.slice(from, to).map((v) => Math.abs(v ?? 0)), ...columns.ax.slice(from, to).map((v) => Math.abs(v ?? 0)));
  const top = Math.min(Math.ceil(used + 0.2), LARGEST_G);
  const at = (g) => size / 2 + (g / top) * (size / 2 - 16);
  for (let g = 1; g <= top; g += 1) ring(c, size, at(g) - size / 2, "line", [], `${g} g`);
  const friction = tyres?.parameters.filter((p) => ["d", "df", "dr"].includes(p.symbol)).map((p) => p.mean);
  if (friction?.length) ring(c, size, at(Math.min(...friction)) - size / 2, "warn", [5, 4], "");
  c.fillStyle = colour("accent");
  for (let i = from; i < to; i += 1) {
    if (known(columns.ax[i]) && known(columns.ay[i])) c.fillRect(at(-columns.ay[i]) - 1, at(-columns.ax[i]) - 1, 2.5, 2.5);
  }
  const last = to - 1;
  if (known(columns.ay[last])) {
    c.fillStyle = colour("text");
    c.beginPath();
    c.arc(at(-columns.ay[last]), at(-columns.ax[last]), 5, 0, 7);
    c.fill();
  }
  c.fillStyle = colour("quiet");
  c.textAlign = "right";
  c.fillText("drive", size / 2 - 6, 12);
  c.fillText("brake", size / 2 - 6, size - 4);
  c.fillText("right", size - 2, size / 2 - 5);
  c.textAlign = "left";
  c.fillText("left", 2, size / 2 - 5);
}

function ring(c, size, radius, stroke, dash, text) {
  c.strokeStyle = colour(stroke);
  c.setLineDash(dash);
  c.beginPath();
  c.arc(size / 2, size / 2, radius, 0, 7);
  c.stroke();
  c.setLineDash([]);
  c.fillStyle = colour("quiet");
  c.fillText(text, size / 2 + 3, size / 2 - radius - 2);
}

export function drawCurves(tyres, columns, from, to) {
  const [c, size] = context("curve");
  if (!tyres) return;
  const { slip_deg: slip, front, rear } = tyres.curves;
  const bands = [front, rear].flatMap((axle) => axle.mean.map((m, i) => m + 2 * axle.std[i]));
  const top = Math.min(10, 1.15 * Math.max(0.1, ...bands)); // whatever a sender believes, the grid has few lines
  const [left, bottom] = [30, size - 34];
  const x = (deg) => left + (deg / slip[slip.length - 1]) * (size - left - 6);
  const y = (force) => bottom - (force / top) * (bottom - 8);
  c.strokeStyle = colour("line");
  c.fillStyle = colour("quiet");
  for (let force = 0; force <= top; force += 0.5) line(c, [[left, y(force)], [size - 4, y(force)]], force.toFixed(1), 2, y(force) + 4);
  for (let deg = 0; deg <= slip[slip.length - 1]; deg += 4) line(c, [[x(deg), bottom], [x(deg), 8]], `${deg}°`, x(deg) - (x(deg) > size - 20 ? 16 : 6), bottom + 14);
  axle(c, x, y, slip, front, "accent");
  axle(c, x, y, slip, rear, "warn");
  rug(c, x, columns.slip_front, from, to, bottom, "accent");
  rug(c, x, columns.slip_rear, from, to, bottom + 4, "warn");
  c.fillStyle = colour("accent");
  c.fillText("front", left + 4, size - 4);
  c.fillStyle = colour("warn");
  c.fillText("rear", left + 44, size - 4);
  c.fillStyle = colour("quiet");
  c.fillText("F/load ± 2 std", left + 78, size - 4);
}

function line(c, points, text, tx, ty) {
  c.beginPath();
  points.forEach(([px, py], i) => (i ? c.lineTo(px, py) : c.moveTo(px, py)));
  c.stroke();
  c.fillText(text, tx, ty);
}

function axle(c, x, y, slip, { mean, std }, stroke) {
  const edge = (sign) => mean.map((m, i) => [x(slip[i]), y(m + sign * 2 * std[i])]);
  c.fillStyle = c.strokeStyle = colour(stroke);
  c.globalAlpha = 0.22;
  c.beginPath();
  [...edge(1), ...edge(-1).reverse()].forEach(([px, py], i) => (i ? c.lineTo(px, py) : c.moveTo(px, py)));
  c.fill();
  c.globalAlpha = 1;
  c.lineWidth = 2;
  c.beginPath();
  mean.forEach((m, i) => (i ? c.lineTo(x(slip[i]), y(m)) : c.moveTo(x(slip[i]), y(m))));
  c.stroke();
  c.lineWidth = 1;
}

function rug(c, x, values, from, to, y, stroke) {
  c.fillStyle = colour(stroke);
  for (let i = from; i < to; i += 1) {
    if (known(values[i]) && Math.abs(values[i]) < 12) c.fillRect(x(Math.abs(values[i])), y - 3, 1.5, 3);
  }
}
