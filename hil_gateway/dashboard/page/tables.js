// Everything on the page that is words and figures.
import { byId, fill, fixed, item, known, lapGap, lapTime, row, shape, short, signed, words } from "./format.js";

export function drawFigures({ row: now, place, lap, messages, ages }, limit_s) {
  const set = (id, text, fresh) => {
    byId(id).textContent = fresh ? text : "–"; // what has fallen silent says nothing of now
    byId(id).parentElement.classList.toggle("stale", !fresh);
  };
  const [car, estimate] = [ages.vehicle_state.alive, ages.estimate.alive];
  set("speed", fixed(known(now.speed) ? 3.6 * now.speed : null, 0), estimate);
  set("across", heading(place), estimate);
  byId("acrossof").textContent = place && !place.lacks ? `to the track, ± ${place.heading_std_deg.toFixed(1)}°` : "to the track";
  set("lateral", place ? `${place.lateral_m < 0 ? "R" : "L"} ${Math.abs(place.lateral_m).toFixed(1)} m` : "–", estimate);
  set("lap", String(lap.number), estimate);
  set("laptime", lapTime(lap.current_s), estimate);
  set("delta", lapGap(lap.delta_s), estimate);
  set("best", lapTime(lap.best_s), true);
  byId("overlimit").hidden = !limit_s;
  if (limit_s) set("ratio", ratio(lap.best_s, limit_s), true);
  set("linetime", lapTime(messages.race_line?.lap_time_s), ages.race_line.alive);
  set("grip", fixed(now.grip, 0, "%"), car && estimate);
  set("gear", fixed(now.gear, 0), car);
  set("engine", fixed(now.engine, 0), car);
  const bites = messages.applied?.limited ?? [];
  set("limit", ages.applied.alive ? bites.map(words).join(", ") || "none" : "–", ages.applied.alive);
  byId("limit").parentElement.classList.toggle("small", bites.length > 0);
}

function heading(place) {
  if (!place) return "–";
  return place.lacks ? "?" : `${signed(place.across_deg, 1, "")}`.trim() + "°";
}

export function drawHead({ state, phase, messages, ages }, recording) {
  byId("phase").textContent = phase.name.replaceAll("`", "");
  byId("next").textContent = recording ? "" : `to decide: ${phase.next.replaceAll("`", "")}`;
  const gateway = messages.gateway_status;
  const shown = recording ? "REPLAY" : state.name;
  if (byId("state").textContent !== shown) byId("state").textContent = shown;
  byId("state").className = `pill ${shown}`;
  const heard = gateway && ages.gateway_status.alive;
  byId("action").textContent = heard ? words(gateway.action) : "no word from the gateway";
  byId("action").className = heard ? `pill ${gateway.action}` : "pill";
  byId("why").textContent = [recording && state.name !== "LIVE" ? `at this moment ${state.name}` : "", recording ? "" : state.why, heard ? reason(gateway) : "", standing(messages.plan, gateway, ages), ages.estimate.alive ? "" : recording ? "no estimate" : "no estimate: hil estimator run"].filter(Boolean).join(" · ");
}

// Before it is armed the gateway says the same.
const standing = (plan, gateway, ages) => (gateway?.armed && plan && ages.plan.alive && plan.status === "not_moving" ? `not moving: ${plan.reason}` : "");

function reason(gateway) {
  if (gateway.action === "drive") return "";
  if (gateway.cause) return words(gateway.cause);
  if (!gateway.missing_for_crank.length) return "ready to be cranked by a person: hil gateway crank";
  if (gateway.missing_for_arming.length) return `before it can be armed: ${gateway.missing_for_arming.map((name) => gateway.advice[name] || words(name)).join(", ")}`;
  return "ready to be armed by a person";
}

// Both causes stay until the car is armed again; the text changes only when they do, so that it is read out once.
export function drawStop({ first, last }) {
  byId("stop").hidden = !first;
  const key = JSON.stringify([first, last]);
  if (!first || byId("stop").dataset.key === key) return;
  byId("stop").dataset.key = key;
  byId("stop").replaceChildren(...[first, ...(JSON.stringify(last) === JSON.stringify(first) ? [] : [last])].map((event, i) => {
    const p = document.createElement("p");
    const strong = document.createElement("b");
    strong.textContent = `${i ? "then" : "stopped"}: ${words(event.after)}, ${words(event.cause)}`;
    p.append(strong, ` ${measured(event)}${event.text}`);
    return p;
  }), note("Stays until the car is armed again. Before that: remove the cause, the car stands, a person arms."));
}

function note(text) {
  const p = document.createElement("p");
  p.className = "quiet";
  p.textContent = text;
  return p;
}

const measured = (event) => (known(event.measured) ? `(${short(event.measured)} ${event.unit}${known(event.limit) ? `, limit ${short(event.limit)} ${event.unit}` : ""}) ` : "");

const when = (t, origin) => (origin === null ? clockTime(t) : `${(t - origin).toFixed(1)} s`);

export function drawEvents(events, origin) {
  byId("events").replaceChildren(...events.slice(-120).reverse().map((event) => {
    const li = document.createElement("li");
    const time = document.createElement("span");
    time.textContent = when(event.t, origin);
    time.className = "kind";
    const what = document.createElement("span");
    what.className = { stop: "stopped", warning: "warned" }[event.severity] ?? "";
    const change = event.before && event.after !== event.before ? `${words(event.before)} → ${words(event.after)}` : words(event.after);
    what.textContent = `${event.kind} ${change}: ${measured(event)}${event.text}`;
    li.append(time, what);
    return li;
  }));
}

let offset_s = null;
export const setClock = (t) => { offset_s = Date.now() / 1000 - t; };
const clockTime = (t) => (offset_s === null ? "" : new Date(1000 * (t + offset_s)).toTimeString().slice(0, 8));

const ratio = (time_s, limit_s) => (known(time_s) ? (time_s / limit_s).toFixed(3) : "–");

export function drawLaps(laps, limit_s) {
  byId("lapratio").hidden = !limit_s;
  const best = Math.min(...laps.filter((lap) => !lap.marks.length).map((lap) => lap.time_s));
  const gap = (time_s) => (Number.isFinite(best) ? lapGap(time_s - best) : "–");
  fill("laps", laps.map((lap, i) => row(
    [[i + 1, ...lap.marks].join(" "), lapTime(lap.time_s), lap.sectors_s.map((s) => s.toFixed(2)).join("  "), lap.time_s === best ? "best" : gap(lap.time_s), ...(limit_s ? [ratio(lap.time_s, limit_s)] : [])],
    [], lap.time_s === best ? "bestlap" : "",
  )).reverse());
}

// One line for an effect that explains several channels.
export function drawAlerts(alerts) {
  if (!alerts.length) return byId("alerts").replaceChildren(item("nothing so far", "quiet"));
  byId("alerts").replaceChildren(...alerts.slice(0, 5).map((alert) => {
    const where = `${alert.channels.join(", ")}: ${alert.conditions.slice(0, 2).join("; ")}${alert.conditions.length > 2 ? ` and ${alert.conditions.length - 2} more` : ""}`;
    const head = alert.suspect ? `${words(alert.suspect)} suspected` : "no effect of the catalogue";
    return item(`${head}, up to ${alert.strength.toFixed(1)} × noise (${where})`);
  }));
}

export function drawTyres(tyres) {
  if (!tyres) return;
  byId("samples").textContent = `${tyres.samples} samples have passed the gates`;
  fill("belief", tyres.parameters.map((p) => row(
    [p.unit ? `${p.name}, ${p.unit}` : p.name, short(p.mean), short(p.std), bar(p.mean, p.std, p.first)], ["", "", "", "bar"],
  )));
}

// The grey mark is the first belief, the bar mean ± 2 std, on a scale of 0 to 2 of the first.
function bar(mean, std, first) {
  const at = (value) => Math.max(0, Math.min(100, (50 * value) / (first || 1)));
  const svg = shape("svg", { viewBox: "0 0 100 10", width: "100%", height: "12", preserveAspectRatio: "none" });
  svg.append(
    shape("line", { x1: 0, x2: 100, y1: 5, y2: 5, stroke: "var(--line)" }),
    shape("line", { x1: at(mean - 2 * std), x2: at(mean + 2 * std), y1: 5, y2: 5, stroke: "var(--accent)", "stroke-width": 4 }),
    shape("line", { x1: 50, x2: 50, y1: 0, y2: 10, stroke: "var(--quiet)" }),
    shape("line", { x1: at(mean), x2: at(mean), y1: 1, y2: 9, stroke: "var(--text)", "stroke-width": 1.5 }),
  );
  return svg;
}

export function drawModel({ model_revision: model, plan }, ages) {
  if (!model) return;
  const used = plan && ages.plan.alive ? (plan.revision === model.revision ? ", in use by the planner" : `, planner uses ${plan.revision}`) : "";
  byId("revision").textContent = `${model.revision}${used}`;
  const errors = Object.keys(model.provenance.error_after ?? {});
  const gain = errors.map((name) => `${name} ${short(model.provenance.error_before[name])} → ${short(model.provenance.error_after[name])}`);
  const effects = model.effects.map((e) => `${words(e.name)}: ${Object.entries(e.parameters).map(([n, v]) => `${n} ${short(v)}`).join(", ")}`);
  const lines = [...(effects.length ? effects : ["no effects added to the declared model"]), ...(gain.length ? [`held-out error: ${gain.join(", ")}`] : [])];
  byId("effects").replaceChildren(...lines.map((line) => item(line, effects.length ? "" : "quiet")));
}

// When which model came into force, and what it changed; the refinements of every minute are in the events.
export function drawRevisions(events, origin) {
  const kept = events.filter((event) => ["adoption", "learning"].includes(event.kind)).slice(-6).reverse();
  byId("revisions").replaceChildren(...kept.map((event) => item(`${when(event.t, origin)} ${event.kind === "learning" ? `${words(event.after)}: ` : ""}${event.text}`)));
}

export function drawAges(ages) {
  const age = (age_s) => (known(age_s) ? (age_s < 10 ? `${(1000 * age_s).toFixed(0)} ms` : `${age_s.toFixed(0)} s`) : "never");
  const rows = Object.entries(ages).filter(([name]) => name !== "playback");
  fill("ages", rows.map(([name, { age_s, alive }]) => row([words(name), age(age_s), alive ? "ok" : "old"], ["", "", alive ? "ok" : "old"], alive ? "" : "stale")));
}

export function drawSources({ vehicle_state: state }, ages) {
  if (!state) return;
  const fresh = ages.vehicle_state.alive;
  fill("sources", Object.entries(state.sources).map(([name, { age_s, valid }]) => row(
    [words(name), fixed(known(age_s) ? 1000 * age_s : null, 0, "ms"), !fresh ? "?" : valid ? "ok" : "bad"],
    ["", "", fresh && valid ? "ok" : "old"], fresh ? "" : "stale",
  )));
}

// Hidden until the car reports a tyre.
export function drawTyreReports({ tyres }, ages) {
  const reported = tyres && [...tyres.temperature, ...tyres.pressure].some(known);
  byId("tyrebox").hidden = !reported;
  if (!reported) return;
  fill("tyrestate", ["front left", "front right", "rear left", "rear right"].map((name, i) => row(
    [name, fixed(tyres.temperature[i], 0, "°C"), fixed(tyres.hottest[i], 0, "°C"), fixed(known(tyres.pressure[i]) ? tyres.pressure[i] / 1e5 : null, 2, "bar")],
    [], ages.tyres.alive ? "" : "stale",
  )));
}

export function drawStatus({ gateway_status: gateway, recorder_status: recorder, plan, vehicle_state: state }, ages, limits) {
  const rows = [];
  const add = (source, ...cells) => rows.push(row(cells, ["", "text"], ages[source].alive ? "" : "stale"));
  if (gateway) {
    add("gateway_status", "bus", `${gateway.bus}, ${words(gateway.bus_state)}`);
    add("gateway_status", "mode", gateway.mode);
    if (state) add("vehicle_state", "ct_state / sys_state", `${state.ct_state} / ${state.sys_state}`);
    add("gateway_status", "frames", `${gateway.frames_received} in, ${gateway.frames_lost} lost, ${gateway.counter_errors} counter errors`);
    add("gateway_status", "commands", `${gateway.commands_sent} sent, ${gateway.commands_limited} limited`);
    add("gateway_status", "loop p50 / p99", `${fixed(gateway.loop_latency_p50_ms, 1)} / ${fixed(gateway.loop_latency_p99_ms, 1)} ms of ${fixed(limits.latency_ms, 0)} allowed`);
  }
  if (plan) add("plan", "plan", ages.plan.alive ? (plan.reason ? `${plan.status}: ${plan.reason}` : `${plan.status}, ${fixed(plan.solve_ms, 1)} ms of ${fixed(limits.plan_ms, 0)} allowed`) : "no plan: the planner is silent");
  if (recorder) {
    add("recorder_status", "recorded", `${(recorder.bytes_written / 1e6).toFixed(1)} MB, ${recorder.lost} lost`);
    if (recorder.last_error) add("recorder_status", "recorder error", recorder.last_error);
  }
  fill("status", rows);
}
